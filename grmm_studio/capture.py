"""Running a capture job: which person and shot is next, render, write.

Several processes of one machine can share a folder, by claims on its pieces; several machines share it as a cluster, whose
scheduler hands the pieces out. The order interleaves people: rounds of a few shots of everybody, so that a capture that is
cut short still has everybody. Imports bpy through `scene`, with the first shot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from grmm_core.controls.frame import Controls, resolve
from grmm_core.data.claims import claim
from grmm_core.data.dataset import shot_record, write_shot, write_subject
from grmm_core.data.layers import ALBEDO, LIGHT_PREFIX, NORMAL, PART_LAYER
from grmm_core.data.types import Picture, Shot, View
from grmm_core.errors import ConfigError
from grmm_core.files.access import TEMPORARY_PATTERN
from grmm_core.geometry.camera import Camera
from grmm_core.head.open_head import load_open_head, load_people_model
from grmm_core.jobs.cluster import Cluster
from grmm_core.jobs.progress import ProgressCallback, Reporter, Share
from grmm_core.jobs.stages import CAPTURE

from .lights import RIG, draw_light, lights_named
from .mesh import region_vertices
from .settings import CaptureSettings, check_settings, open_job, planned_shot, subject_name
from .shots import MOUTH, around, view_split
from .subjects import Subject, draw_subject

if TYPE_CHECKING:
    from .scene import Studio

ROUND = 4  # shots of everybody before anybody's next ones
# Blender's images of a person cannot be removed one by one (see `materials.Nodes.image`), so the studio is built anew after so
# many people; each takes about 100 MB. A person who comes back must then be prepared again, which takes some seconds.
PEOPLE_IN_STUDIO = 24


@dataclass(frozen=True)
class Outcome:
    """How a job stands when this process has nothing left to do.

    Attributes:
        made: Shots that this process made.
        complete: Shots that are complete, by whomever.
        total: Shots of the job.
    """

    made: int
    complete: int
    total: int

    @property
    def in_work(self) -> int:
        """Shots that other processes hold; to be made again where those end early."""
        return self.total - self.complete


def job_order(subjects: int, shots: int) -> Iterator[tuple[int, range]]:
    """Pieces of work in order: person and shot numbers."""
    for start in range(0, shots, ROUND):
        for index in range(subjects):
            yield index, range(start, min(start + ROUND, shots))


@dataclass(frozen=True)
class Piece:
    """Some shots of one person.

    Attributes:
        folder: Of the data set.
        settings: Of the job.
        threads: Of the process that renders it.
        index: Number of the person.
        numbers: Of the shots.
    """

    folder: Path
    settings: CaptureSettings
    threads: int
    index: int
    numbers: Sequence[int]

    @property
    def name(self) -> str:
        """Of the person."""
        return subject_name(self.settings.seed, self.index)

    @property
    def records(self) -> list[Path]:
        """Files that are there when the shots are complete."""
        return [shot_record(self.folder, self.name, number) for number in self.numbers]

    def missing(self) -> Iterator[int]:
        """Numbers of shots that are not complete when it is their turn."""
        return (number for number, record in zip(self.numbers, self.records, strict=True) if not record.exists())

    @property
    def complete(self) -> bool:
        """Whether nothing is missing."""
        return next(self.missing(), None) is None


def run_job(
    folder: Path, settings: CaptureSettings, threads: int = 2, progress: ProgressCallback | None = None,
    only: Sequence[int] = (), cluster: Cluster | None = None,
) -> Outcome:  # fmt: skip
    """Render what is missing.

    Args:
        folder: Of the data set.
        settings: What to render.
        threads: Of each process.
        progress: Called after every shot, on a cluster after every piece, with one of its pictures.
        only: Numbers of the people to render now; everybody when empty.
        cluster: Where to render; None for this process.

    Returns:
        What was made, and how the job stands.

    Raises:
        ConfigError: Bad settings. FileAccessError: The folder is not writable or the disk is full.
        SessionError: The cluster failed.
    """
    if threads < 1:
        raise ConfigError("--threads must be at least 1.")
    check_settings(settings, only)
    open_job(folder, settings)
    order = job_order(settings.subjects, settings.shots)
    people = [(index, numbers) for index, numbers in order if not only or index in only]
    shown = [
        (index, [number for number in numbers if planned_shot(settings, index, number).cameras]) for index, numbers in people
    ]
    pieces = [Piece(folder, settings, threads, index, numbers) for index, numbers in shown if numbers]
    records = [record for piece in pieces for record in piece.records]
    report = Reporter(CAPTURE, progress)

    def complete() -> int:  # by all processes
        return sum(record.exists() for record in records)

    def said(what: str, picture: Path) -> None:
        done = complete()
        report("shots", done / len(records), f"{done}/{len(records)} {what}", str(picture))

    report("shots", complete() / len(records))
    made = _render_here(pieces, said) if cluster is None else _render_there(pieces, said, cluster)
    outcome = Outcome(made, complete(), len(records))
    if not outcome.in_work:
        _tidy(folder, {piece.name for piece in pieces})
    return outcome


def _render_there(pieces: Sequence[Piece], said: Callable[[str, Path], None], cluster: Cluster) -> int:
    """Render what is missing on a cluster; returns the number of shots."""
    made, wanted = 0, [piece for piece in pieces if not piece.complete]
    for number, pictures in cluster.run(render_piece, wanted):
        made += len(pictures)
        for picture in pictures[-1:]:
            said(f"{wanted[number].name} up to shot {wanted[number].numbers[-1]}", picture)
    cluster.everywhere(leave_studio)
    return made


def _render_here(pieces: Sequence[Piece], said: Callable[[str, Path], None]) -> int:
    """Render what no other process of this machine has claimed; returns the number of shots."""
    made, before = 0, -1
    try:
        # again until nothing more is ours: a process that held a piece may have died in the meantime
        while pieces and made > before:
            before, held = made, []
            for piece in pieces:
                if piece.complete:
                    continue
                with claim(piece.folder / "locks" / f"{piece.name}_{piece.numbers[0]:04d}.lock") as mine:
                    if not mine:
                        held.append(piece)
                        continue
                    for number in piece.missing():
                        picture = _studio_for(piece).shoot(piece.index, number)
                        made += 1
                        said(f"{piece.name} shot {number}", picture)
            pieces = held
    finally:
        leave_studio()
    return made


def render_piece(piece: Piece, report: Share) -> list[Path]:
    """Render the shots of a piece that are missing, on a worker of a cluster; returns a picture of each."""
    return [_studio_for(piece).shoot(piece.index, number) for number in piece.missing()]


_worker: _Worker | None = None  # of this process


def _studio_for(piece: Piece) -> _Worker:
    global _worker
    job = (piece.folder, piece.settings, piece.threads)
    if _worker is None or _worker.job != job:
        leave_studio()
        _worker = _Worker(*job)
    return _worker


def leave_studio() -> None:
    """Remove this process's studio and its temporary files."""
    global _worker
    if _worker is not None:
        _worker.close()
    _worker = None


def _tidy(folder: Path, names: Iterable[str]) -> None:
    """Remove files that killed processes were writing; nobody writes these people any more."""
    for name in names:
        for path in (folder / "shots" / name).glob(TEMPORARY_PATTERN):
            path.unlink(missing_ok=True)


class _Worker:
    """The studio of this process, built with the first shot, and anew after many people."""

    def __init__(self, folder: Path, settings: CaptureSettings, threads: int) -> None:
        self.job = self.folder, self.settings, self.threads = folder, settings, threads
        check_settings(settings)
        self.head = load_open_head()
        self.people = load_people_model()
        self._studio: Studio | None = None
        self._subject: Subject | None = None
        self._met: set[int] = set()  # people whom the present studio has prepared

    def shoot(self, index: int, number: int) -> Path:
        """Render and write one shot; returns the file of its first picture."""
        from .scene import Studio

        s = self.settings
        if index not in self._met and len(self._met) >= PEOPLE_IN_STUDIO:
            self.close()
        if self._studio is None:
            self._studio = Studio(self.head, s.size, s.samples, s.subsurface, s.layers, self.threads)
        studio, subject = self._studio, self._subject
        if subject is None or subject.index != index:
            self._met.add(index)
            self._subject = subject = draw_subject(s.seed, index, self.people)
            studio.set_subject(subject)
            write_subject(self.folder, subject.name, subject.shape, subject.to_json(), studio.groom)
        plan = planned_shot(s, index, number)
        controls = resolve(Controls(aligned=plan.aligned, pose=plan.pose), self.head)
        light = draw_light(s.seed * 1000003 + index * 1009 + number) if s.varied_light else RIG
        posed = studio.set_shot(controls.expression, controls.pose, light)
        if s.framing == MOUTH:
            mouth = posed[region_vertices(self.head, "lips")].mean(0)
            plan = replace(plan, cameras=tuple(around(camera, mouth) for camera in plan.cameras))
        pictures, views = [], []
        for i, (name, camera) in enumerate(zip(plan.camera_names, plan.cameras, strict=True)):
            pictures.append(self._picture(studio, camera, number))
            views.append(self._view(index, number, i, name, camera))
        shot = Shot(
            subject.name, number, plan.kind, controls.aligned, controls.expression, controls.pose, tuple(views),
            self.folder, studio.displacement, light.to_json(),
        )  # fmt: skip
        write_shot(self.folder, shot, pictures)
        return shot_record(self.folder, shot.subject, number).with_name(views[0].image)

    def _picture(self, studio: Studio, camera: Camera, number: int) -> Picture:
        s = self.settings
        looks = [False] if self._only_bare(number) else [True, False] if s.bare else [True]
        pictures = []
        for hair in looks:
            picture = studio.render(camera, hair)
            for name, light in lights_named(s.lights).items():
                picture.layers[LIGHT_PREFIX + name] = studio.render(camera, hair, light).rgb
            pictures.append(replace(picture, depth=picture.depth if s.depth else None))
        return replace(pictures[0], bare=pictures[-1] if s.bare else None)

    def _only_bare(self, number: int) -> bool:
        return self.settings.bare == "only" or (self.settings.bare == "rest" and number > 0)

    def close(self) -> None:
        """Remove the studio and its temporary files; the next shot makes another."""
        if self._studio is not None:
            self._studio.close()
        self._studio, self._subject = None, None
        self._met.clear()

    def _view(self, index: int, number: int, i: int, name: str, camera: Camera) -> View:
        s, split = self.settings, view_split(index, number, name)
        names = [LIGHT_PREFIX + light for light in lights_named(s.lights)]
        if s.layers:
            names += [PART_LAYER, ALBEDO, NORMAL]

        def files(stem: str, bare: View | None) -> View:
            layers = {layer: f"{stem}_{layer}.png" for layer in names}
            return View(name, camera, f"{stem}.png", f"{stem}_z.png" if s.depth else "", split, layers, bare)

        stem = f"{number:04d}_{i:02d}"
        if not s.bare:
            return files(stem, None)
        bare = files(f"{stem}_bare", None)
        return replace(bare, bare=bare) if self._only_bare(number) else files(stem, bare)
