"""`python -m tools.quality_views`: render the truth of the quality gate (`tests/data/quality`) anew. Needs bpy.

Two people of the capture that the embedded weights were trained on, both also avatars of the library, in two expressions that
were held out of either, without hair, from the front and from a direction held out. Small, with samples enough that noise
does not count.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from grmm_core.controls.frame import Controls, resolve
from grmm_core.data.dataset import write_manifest, write_shot, write_subject
from grmm_core.data.types import HELD_OUT_EXPRESSION, Manifest, Shot, View
from grmm_core.geometry.camera import Camera
from grmm_core.head.open_head import load_open_head, load_people_model
from grmm_studio.scene import Studio
from grmm_studio.settings import STUDIO
from grmm_studio.shots import CLOSE_FOV, DISTANCE, HELD_OUT_CAMERAS, make_shot, ring_camera
from grmm_studio.subjects import draw_subject

FOLDER = Path(__file__).resolve().parent.parent / "tests" / "data" / "quality"


@dataclass(frozen=True)
class Settings:
    """How the views are made; stored in the manifest."""

    seed: int = 31  # of the embedded weights' capture
    people: tuple[int, ...] = (29, 30)  # default.grmm and beard.grmm
    shots: tuple[int, ...] = (6, 13)  # held out, see `grmm_studio.capture`
    size: int = 256
    samples: int = 128


def cameras(size: int) -> dict[str, Camera]:
    """The views of every shot by name: the face close by, and a camera that was held out."""
    face = Camera.orbit(size, size, -20.0, 6.0, DISTANCE, CLOSE_FOV, (0.0, 0.008, 0.055))
    return {"face": face, f"c{HELD_OUT_CAMERAS[0]:02d}": ring_camera(HELD_OUT_CAMERAS[0], size)}


def render(folder: Path, settings: Settings) -> None:
    """Write the views as a capture data set."""
    head, people = load_open_head(), load_people_model()
    subjects = [draw_subject(settings.seed, number, people) for number in settings.people]
    write_manifest(folder, Manifest("open_head", [subject.name for subject in subjects], asdict(settings) | {"studio": STUDIO}))
    studio = Studio(head, settings.size, settings.samples, subsurface=False)  # as the training pictures
    views = cameras(settings.size)
    for subject in subjects:
        write_subject(folder, subject.name, subject.shape, subject.to_json())
        studio.set_subject(subject)
        for number in settings.shots:
            plan = make_shot(settings.seed, subject.index, number, 1, settings.size)
            controls = resolve(Controls(aligned=plan.aligned, pose=plan.pose), head)
            studio.set_shot(controls.expression, controls.pose)
            pictures = [studio.render(camera, hair=False) for camera in views.values()]
            plain = [View(*view, f"{number:04d}_{i:02d}.png", "", HELD_OUT_EXPRESSION) for i, view in enumerate(views.items())]
            written = tuple(replace(view, bare=view) for view in plain)
            controls_of = (controls.aligned, controls.expression, controls.pose)
            write_shot(folder, Shot(subject.name, number, plan.kind, *controls_of, written, folder), pictures)
    studio.close()


def main() -> int:
    """Render into the tests' data, or elsewhere to compare."""
    parser = argparse.ArgumentParser(description="Render the truth of the quality gate.")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder (default: %(default)s)")
    parser.add_argument("--samples", type=int, default=Settings.samples, help="Cycles samples a pixel (default: %(default)s)")
    arguments = parser.parse_args()
    render(arguments.out, Settings(samples=arguments.samples))
    return 0


if __name__ == "__main__":
    sys.exit(main())
