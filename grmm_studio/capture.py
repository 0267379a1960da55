"""Running a capture job: which person and shot is next, render, write. Several processes can share one folder.

The order interleaves people: rounds of a few shots of everybody, so that a capture that is cut short
still has everybody. Imports bpy through `scene`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from grmm_core.camera import Camera
from grmm_core.controls import Controls, resolve
from grmm_core.data.dataset import (
    HELD_OUT_CAMERA,
    HELD_OUT_EXPRESSION,
    HELD_OUT_PERSON,
    TRAIN,
    Manifest,
    Picture,
    Shot,
    View,
    read_manifest,
    shot_record,
    write_manifest,
    write_shot,
    write_subject,
)
from grmm_core.data.jobs import TimeLeft, claim
from grmm_core.errors import ConfigError
from grmm_core.head.open_head import load_open_head, load_people_model

from .shots import HELD_OUT_CAMERAS, expression_pool, make_shot
from .subjects import Subject, draw_subject

ROUND = 4  # shots of everybody before anybody's next ones
HELD_OUT_EVERY = 12  # one person of so many is held out
HELD_OUT_SHOTS = (6, 13)  # numbers modulo 15: expressions that are not trained on


@dataclass(frozen=True)
class CaptureSettings:
    """What makes a capture; stored in its manifest, and the same for all processes of a job.

    Attributes:
        subjects, shots, views: People, shots a person, views a shot.
        size: Picture side in pixels.
        samples: Cycles samples a pixel.
        seed: Seed of everything.
        expressions: "all" or names.
        varied_light: Another light for every shot.
        subsurface: Light scattering in the skin (slower).
        depth: Write depth maps.
    """

    subjects: int = 24
    shots: int = 12
    views: int = 4
    size: int = 384
    samples: int = 4
    seed: int = 0
    expressions: str = "all"
    varied_light: bool = False
    subsurface: bool = False
    depth: bool = True


@dataclass(frozen=True)
class Progress:
    """Sent after every shot: pieces done and in all, seconds left, what was done."""

    done: int
    total: int
    seconds_left: float
    text: str


def held_out(index: int) -> bool:
    """Whether a person is held out from training."""
    return index % HELD_OUT_EVERY == HELD_OUT_EVERY - 1


def view_split(subject: int, number: int, camera_name: str) -> str:
    """Split of a view: held-out people, then expressions, then cameras, then training."""
    if held_out(subject):
        return HELD_OUT_PERSON
    if number % 15 in HELD_OUT_SHOTS:
        return HELD_OUT_EXPRESSION
    if camera_name in {f"c{i:02d}" for i in HELD_OUT_CAMERAS}:
        return HELD_OUT_CAMERA
    return TRAIN


def job_order(subjects: int, shots: int) -> Iterator[tuple[int, range]]:
    """Pieces of work in order: person and shot numbers."""
    for start in range(0, shots, ROUND):
        for index in range(subjects):
            yield index, range(start, min(start + ROUND, shots))


def open_job(folder: Path, settings: CaptureSettings) -> None:
    """Write the manifest of a new capture, or check that the existing one is the same.

    Raises:
        ConfigError: The folder holds a capture of other settings.
    """
    values = asdict(settings)
    if (folder / "dataset.json").exists():
        known = read_manifest(folder).settings
        for key, value in values.items():
            if known.get(key) != value:
                raise ConfigError(
                    f"{folder} holds a capture with {key} {known.get(key)}, not {value}; use the same or another folder."
                )
        return
    names = [subject_name(settings.seed, i) for i in range(settings.subjects)]
    write_manifest(folder, Manifest("open_head", names, values, [n for i, n in enumerate(names) if held_out(i)]))


def subject_name(seed: int, index: int) -> str:
    """Name of a person, as `Subject.name`."""
    return f"s{seed:04d}_{index:04d}"


def run_job(
    folder: Path, settings: CaptureSettings, threads: int = 2, report: Callable[[Progress], None] = lambda _: None,
    only: Sequence[int] = (),
) -> int:  # fmt: skip
    """Render what is missing.

    Args:
        folder: Of the data set.
        settings: What to render.
        threads: Of this process.
        report: Called after every shot.
        only: Numbers of the people to render now; everybody when empty.

    Returns:
        The number of shots that this process made.

    Raises:
        ConfigError: Bad settings. FileAccessError: The folder is not writable or the disk is full.
    """
    if min(settings.subjects, settings.shots, settings.views, settings.size, settings.samples) < 1:
        raise ConfigError("Subjects, shots, cameras, size and samples must be at least 1.")
    absent = [index for index in only if not 0 <= index < settings.subjects]
    if absent:
        raise ConfigError(f"There is no person {absent[0]} here; choose from 0 to {settings.subjects - 1}.")
    pool = expression_pool(settings.expressions)
    open_job(folder, settings)
    pieces = [piece for piece in job_order(settings.subjects, settings.shots) if not only or piece[0] in only]
    left = TimeLeft(sum(len(numbers) for _, numbers in pieces))
    worker = _Worker(folder, settings, threads, pool)
    made = 0
    try:
        for index, numbers in pieces:
            name = subject_name(settings.seed, index)
            with claim(folder / "locks" / f"{name}_{numbers.start:04d}.lock") as mine:
                for number in numbers:
                    record = shot_record(folder, name, number)
                    work = mine and not record.exists()
                    if work:
                        worker.shoot(index, number)
                        made += 1
                    left.step(work)
                    if work:
                        report(Progress(left.done, left.total, left.seconds, f"{name} shot {number}"))
    finally:
        worker.close()
    return made


class _Worker:
    """The studio of this process, started with the first shot."""

    def __init__(self, folder: Path, settings: CaptureSettings, threads: int, pool: tuple[str, ...]) -> None:
        self.folder, self.settings, self.threads, self.pool = folder, settings, threads, pool
        self.head = load_open_head()
        self.people = load_people_model()
        self._studio = None
        self._subject: Subject | None = None

    def shoot(self, index: int, number: int) -> None:
        """Render and write one shot."""
        from .scene import Studio

        s = self.settings
        if self._studio is None:
            self._studio = Studio(self.head, s.size, s.samples, s.varied_light, s.subsurface, self.threads)
        if self._subject is None or self._subject.index != index:
            self._subject = draw_subject(s.seed, index, self.people)
            self._studio.set_subject(self._subject)
            write_subject(self.folder, self._subject.name, self._subject.shape, self._subject.to_json())
        plan = make_shot(s.seed, index, number, s.views, s.size, self.pool)
        controls = resolve(Controls(aligned=plan.aligned, pose=plan.pose), self.head)
        self._studio.set_shot(controls.expression, controls.pose, light_seed=s.seed * 1000003 + index * 1009 + number)
        pictures = []
        for camera in plan.cameras:
            rgb, mask, depth = self._studio.render(camera)
            pictures.append(Picture(rgb, mask, depth if s.depth else None))
        views = tuple(
            self._view(index, number, i, name, camera)
            for i, (name, camera) in enumerate(zip(plan.camera_names, plan.cameras, strict=True))
        )
        shot = Shot(
            self._subject.name, number, plan.kind, controls.aligned, controls.expression, controls.pose, views, self.folder
        )
        write_shot(self.folder, shot, pictures)

    def close(self) -> None:
        """Remove temporary files."""
        if self._studio is not None:
            self._studio.close()

    def _view(self, index: int, number: int, i: int, name: str, camera: Camera) -> View:
        stem = f"{number:04d}_{i:02d}"
        return View(
            name, camera, f"{stem}.png", f"{stem}_z.png" if self.settings.depth else "", view_split(index, number, name)
        )
