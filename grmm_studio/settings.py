"""What makes a capture, and its manifest: the same for all processes of a job.

Used by `capture`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from grmm_core.data.dataset import read_manifest, write_manifest
from grmm_core.data.types import SPLITS, Manifest
from grmm_core.errors import ConfigError

from .lights import lights_named
from .shots import MAX_CAMERAS, MOUTH, Shot, expression_pool, held_out, make_mouth_shot, make_shot, view_split

STUDIO = 11  # raise whenever the pictures of a seed change: a capture is not continued with others
UNNUMBERED_STUDIO = 2  # of captures from before the number was recorded
MAX_SHOTS = 10_000  # their numbers have four digits in file names
FRAMINGS = ("", MOUTH)  # values of `CaptureSettings.framing`
TWINS_OF = ("", "all", "rest", "only")  # values of `CaptureSettings.bare`


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
        bare: Views without hair: "" none, "all" a twin of each view, "rest" a twin of the neutral shot's views, and nothing
            but the bare head in other shots (what trains the skin, at a third of the cost), "only" nothing but the bare head.
        layers: Write part masks, albedo and normals.
        lights: More lights in which every view is shown: "all" or names of `lights.SETUPS`; empty: none.
        splits: Render views of these splits only, names of `data.types.SPLITS` with commas; empty: all. So the held-out views
            of a noisy capture are rendered again with more samples.
        framing: "" heads and faces; "mouth" open mouths from near, with expressions of their own (`make_mouth_shot`).
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
    bare: str = ""
    layers: bool = False
    lights: str = ""
    splits: str = ""
    framing: str = ""

    def wants(self, index: int, number: int, camera_name: str) -> bool:
        """Whether a view is of the splits to render."""
        return not self.splits or view_split(index, number, camera_name) in self.splits.split(",")


def check_settings(settings: CaptureSettings, only: Sequence[int] = ()) -> tuple[str, ...]:
    """Check everything before a folder is touched; returns the expressions that may be used. Raises `ConfigError`."""
    s = settings
    if min(s.subjects, s.shots, s.size, s.samples) < 1:
        raise ConfigError("--subjects, --shots, --size and --samples must be at least 1.")
    if s.shots > MAX_SHOTS:
        raise ConfigError(f"--shots {s.shots} is not possible; use at most {MAX_SHOTS}.")
    if not 1 <= s.views <= MAX_CAMERAS:
        raise ConfigError(f"--cameras {s.views} is not possible; use 1 to {MAX_CAMERAS}.")
    if s.bare not in TWINS_OF:
        raise ConfigError(f"--bare {s.bare} is not possible; use all, rest or only.")
    if s.framing not in FRAMINGS:
        raise ConfigError(f"--framing {s.framing} is not possible; use {MOUTH}, or leave it out.")
    if s.seed < 0:
        raise ConfigError(f"--seed {s.seed} is not possible; use 0 or more.")
    unknown = [name for name in s.splits.split(",") if s.splits and name not in SPLITS]
    if unknown:
        raise ConfigError(f"There is no split {unknown[0]!r} for --splits; use {', '.join(SPLITS)}.")
    absent = [index for index in only if not 0 <= index < s.subjects]
    if absent:
        raise ConfigError(f"There is no person {absent[0]} for --only; choose from 0 to {s.subjects - 1}.")
    lights_named(s.lights)
    return expression_pool(s.expressions)


def open_job(folder: Path, settings: CaptureSettings) -> None:
    """Write the manifest of a new capture, or check that the existing one is the same.

    Raises:
        ConfigError: The settings are not possible, or the folder holds a capture of others or of another studio.
    """
    check_settings(settings)
    values = asdict(settings)
    if (folder / "dataset.json").exists():
        known = read_manifest(folder).settings
        studio = known.get("studio", UNNUMBERED_STUDIO)
        if studio != STUDIO:
            raise ConfigError(
                f"{folder} holds a capture of studio {studio}, and this is studio {STUDIO}, whose pictures differ; "
                "use another folder."
            )
        for key, value in values.items():
            was = known.get(key, getattr(CaptureSettings, key))  # a capture of before the setting has its default
            if was != value:
                difference = _difference(key, was, value)
                raise ConfigError(f"{folder} holds a capture {difference}; use the same or another folder.")
        return
    values["studio"] = STUDIO
    names = [subject_name(settings.seed, i) for i in range(settings.subjects)]
    write_manifest(folder, Manifest("open_head", names, values, [n for i, n in enumerate(names) if held_out(i)]))


def _difference(key: str, known: object, wanted: object) -> str:
    """What differs, in the words of the command line."""
    if key == "depth":
        key, known, wanted = "no_depth", not known, not wanted
    option = "--cameras" if key == "views" else "--" + key.replace("_", "-")
    if isinstance(wanted, bool):
        return f"without {option}" if wanted else f"with {option}"
    return f"with {option} {known}, not {wanted}"


def subject_name(seed: int, index: int) -> str:
    """Name of a person, as `Subject.name`."""
    return f"s{seed:04d}_{index:04d}"


def planned_shot(settings: CaptureSettings, index: int, number: int) -> Shot:
    """A shot with the cameras that are to be rendered."""
    s = settings
    if s.framing == MOUTH:
        plan = make_mouth_shot(s.seed, index, number, s.views, s.size)
    else:
        plan = make_shot(s.seed, index, number, s.views, s.size, expression_pool(s.expressions))
    kept = [i for i, name in enumerate(plan.camera_names) if s.wants(index, number, name)]
    return replace(plan, cameras=tuple(plan.cameras[i] for i in kept), camera_names=tuple(plan.camera_names[i] for i in kept))
