"""`python -m tools.film_picture -o FILE`: one photo and one voice become a film, through Blender, as a user would make it.

The photo of the tests is fitted (preset *fast*); flite (Debian's package of that name) says the sentence. A fresh Blender with
the built extension adds the avatar, imports the voice, lights the head by three area lamps and a world and renders frames with
F12's operator. Drawn are the photo and these frames.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from grmm_core.avatar import load_avatar
from grmm_core.fitting.result import photo_camera
from grmm_core.fitting.track import frame_of

from .build_extension import build
from .people_pictures import sheet

PHOTO = Path(__file__).resolve().parent.parent / "tests" / "data" / "photos" / "astronaut.jpg"
SENTENCE = "I was made of one photograph, and of one recorded voice. Every hair can be combed."
VOICE, SIZE, SHOWN, COLUMNS, QUALITY = "slt", 360, 7, 4, 88
LAMPS = (  # metres from the head, watts, metres, color: key, rim, fill
    ((0.6, -0.95, 0.45), 19.0, 0.8, (1.0, 0.9, 0.8)), ((-0.8, 0.6, 0.5), 22.0, 0.4, (0.8, 0.88, 1.0)),
    ((-0.8, -0.8, 0.1), 3.5, 0.9, (0.9, 0.95, 1.0)),
)  # fmt: skip
WORLD = (0.035, 0.04, 0.05)
NEARER = 1.18  # than a portrait
FIRST = 12  # frame of the first picture: before it nothing is said


def film(avatar: Path, voice: Path, folder: Path) -> list[Path]:
    """Render frames that are evenly spread over the sentence; runs in a process with bpy. Returns them in order."""
    os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp(prefix="grmm-film-", dir=folder)
    import bpy
    from mathutils import Vector

    bpy.ops.wm.read_homefile(use_empty=True)
    extension = build(folder / "extension")
    bpy.ops.extensions.package_install_files(filepath=str(extension), repo="user_default", enable_on_install=True)
    scene = bpy.context.scene
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    bpy.ops.grmm.add_head(person="FILE", filepath=str(avatar))
    bpy.ops.grmm.import_voice(filepath=str(voice), set_range=True)
    bpy.ops.grmm.portrait_camera()
    scene.camera.data.lens *= NEARER
    scene.render.engine, scene.view_settings.view_transform = "GRMM", "Standard"  # as the extension sets up a new scene
    head = next(item for item in scene.objects if "jawOpen" in dict(item))
    head.grmm.lighting = "SCENE"
    place = head.matrix_world.translation
    for where, watts, side, color in LAMPS:
        lamp = bpy.data.lights.new("Lamp", "AREA")
        lamp.energy, lamp.size, lamp.color = watts, side, color
        item = bpy.data.objects.new("Lamp", lamp)
        item.location = place + Vector(where)
        item.rotation_euler = (-Vector(where)).to_track_quat("-Z", "Y").to_euler()
        scene.collection.objects.link(item)
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*WORLD, 1.0)
    files = []
    for number in np.linspace(FIRST, scene.frame_end - FIRST, SHOWN).round().astype(int):
        scene.frame_set(int(number))
        scene.render.filepath = str(folder / f"{number:04d}.png")
        begin = time.monotonic()
        bpy.ops.render.render(write_still=True)
        print(f"frame {number}: {time.monotonic() - begin:.1f} s", flush=True)
        files.append(Path(scene.render.filepath))
    return files


def main(arguments: Sequence[str]) -> int:
    """Run; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("-o", "--output", type=Path, required=True, help="picture to write")
    parser.add_argument("--photo", type=Path, default=PHOTO, help="of whom (default: the tests' photo)")
    parser.add_argument("--avatar", type=Path, help="the photo's avatar, instead of fitting it")
    parser.add_argument("--flite", default="flite", help="the program")
    parser.add_argument("--film", type=Path, nargs=2, help=argparse.SUPPRESS)  # in Blender's process: avatar, folder
    args = parser.parse_args(arguments)
    if args.film:
        avatar, folder = args.film
        film(avatar, folder / "voice.wav", folder)
        sys.stdout.flush()
        os._exit(0)  # the wheel now and then waits forever in a destructor of its own
    if shutil.which(args.flite) is None:
        print(f"There is no program {args.flite}; install flite (on Debian: apt-get install flite).")
        return 1
    with tempfile.TemporaryDirectory(prefix="grmm-film-") as made:
        folder, avatar = Path(made), args.avatar or Path(made) / "person.grmm"
        subprocess.run([args.flite, "-voice", VOICE, "-t", SENTENCE, "-o", str(folder / "voice.wav")], check=True)
        run = [sys.executable, "-m"]
        if args.avatar is None:
            subprocess.run([*run, "grmm_core", "fit", str(args.photo), "-o", str(avatar), "--preset", "fast"], check=True)
        subprocess.run([*run, "tools.film_picture", "-o", str(args.output), "--film", str(avatar), str(folder)], check=True)
        left, top, side = frame_of(photo_camera(load_avatar(avatar)))
        photo = Image.open(args.photo).convert("RGB")
        side = min(side, *photo.size)
        left, top = (min(max(at, 0), most - side) for at, most in zip((left, top), photo.size, strict=True))
        square = photo.crop((left, top, left + side, top + side)).resize((SIZE, SIZE), Image.Resampling.LANCZOS)
        tiles = [np.asarray(square), *(np.asarray(Image.open(path).convert("RGB")) for path in sorted(folder.glob("*.png")))]
        sheet(tiles, COLUMNS).save(args.output, quality=QUALITY)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
