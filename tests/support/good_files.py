"""One good file of every kind that is read, with its reader: what `tests/fuzz.py` and the tests damage.

`KINDS` maps a name to a function that makes the file in an empty folder. Files are small: damage is found by reading many.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from avatar_files import cap4d_bytes, flame_track, lam_archive
from flame_files import flame_fields, write_flame_pickle
from foreign_data import flame_like_head, write_nersemble, write_renderme, write_vhap
from fuzzing import Good
from grmm_files import make_avatar
from mesh_files import seamed_mesh
from PIL import Image
from splat_files import make_cloud, ply_bytes, splat_rows

from grmm_core.avatar import load_avatar, save_avatar
from grmm_core.cli import main
from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.data.dataset import CaptureDataset, write_manifest, write_shot, write_subject
from grmm_core.data.readers import open_dataset
from grmm_core.data.types import Manifest, Picture, Shot, View
from grmm_core.errors import GrmmError
from grmm_core.fitting.folder import REQUEST_FILE, interrupted_request
from grmm_core.fitting.request import FitRequest
from grmm_core.formats import read_performance, read_splats, write_mesh, write_performance, write_splats
from grmm_core.formats.avatars.cap4d import read_cap4d
from grmm_core.formats.avatars.gaussian_avatars import GaussianAvatar, read_gaussian_avatar, write_gaussian_avatar
from grmm_core.formats.avatars.lam import read_lam
from grmm_core.formats.meshes.gltf_mesh import read_gltf_mesh
from grmm_core.geometry.camera import Camera
from grmm_core.head.flame import read_landmark_embedding
from grmm_core.head.flame_file import read_flame_file, read_flame_masks
from grmm_core.performance import Performance
from grmm_core.photo.load import load_photo

Maker = Callable[[Path], Good]
DATA = Path(__file__).resolve().parents[1] / "data" / "formats"
COUNT = 40  # splats


# --- splats, meshes, avatars ------------------------------------------------------------------------------------------


def _splats(name: str, degree: int = 0, **options: Any) -> Maker:
    def make(folder: Path) -> Good:
        write_splats(folder / name, make_cloud(COUNT, degree), **options)
        return Good(folder / name, read_splats)

    return make


def _text_ply(folder: Path) -> Good:
    (folder / "a.ply").write_bytes(ply_bytes(splat_rows(10), "ascii"))
    return Good(folder / "a.ply", read_splats)


def _copied(name: str) -> Maker:
    def make(folder: Path) -> Good:
        shutil.copy(DATA / name, folder / name)
        return Good(folder / name, read_splats)

    return make


def _sog_folder(folder: Path) -> Good:
    """The parts of a SOG file beside one another."""
    write_splats(folder / "a.sog", make_cloud(COUNT))
    shutil.unpack_archive(folder / "a.sog", folder / "parts", "zip")
    return Good(folder / "parts" / "meta.json", read_splats, tuple(sorted((folder / "parts").iterdir())))


def _gltf_mesh(folder: Path) -> Good:
    write_mesh(folder / "a.glb", *seamed_mesh())
    return Good(folder / "a.glb", read_gltf_mesh)


def _gaussian_avatar(folder: Path) -> Good:
    cloud = replace(make_cloud(COUNT), binding=np.arange(COUNT, dtype=np.int32))
    write_gaussian_avatar(folder, GaussianAvatar(cloud, flame_track(2)))
    return Good(folder, read_gaussian_avatar, (folder / "point_cloud.ply", folder / "flame_param.npz"))


def _cap4d(folder: Path) -> Good:
    (folder / "a.ply").write_bytes(cap4d_bytes()[0])
    return Good(folder / "a.ply", read_cap4d)


def _lam(folder: Path) -> Good:
    lam_archive(folder / "a.zip")
    (folder / "a.glb").unlink(missing_ok=True)
    return Good(folder / "a.zip", read_lam)


# --- performances -----------------------------------------------------------------------------------------------------


def _recorded(name: str) -> Maker:
    def make(folder: Path) -> Good:
        turns = {part: np.full((20, 3), 0.1) for part in ("head_rotation", "left_eye_rotation", "right_eye_rotation")}
        performance = Performance(np.arange(20) / 30, np.full((20, 52), 0.25), 30.0, recorded_shapes=ARKIT_NAMES, **turns)
        write_performance(folder / name, performance)
        return Good(folder / name, read_performance)

    return make


def _flame_track(folder: Path) -> Good:
    write_performance(folder / "a.npz", flame_track())
    return Good(folder / "a.npz", read_performance)


def _table(name: str, header: list[str], first: Callable[[int], list[Any]], comma: str = ",", encoding: str = "utf-8") -> Maker:
    def make(folder: Path) -> Good:
        rows = [header, *([*first(i), *[0.25] * len(ARKIT_NAMES)] for i in range(20))]
        text = "\n".join(comma.join(str(cell).replace(".", "," if comma == ";" else ".") for cell in row) for row in rows)
        (folder / name).write_text(text, encoding)
        return Good(folder / name, read_performance)

    return make


def _mediapipe(folder: Path) -> Good:
    categories = [{"categoryName": name, "score": 0.25} for name in ARKIT_NAMES]
    frames = [{"timestamp": 33 * i, "faceBlendshapes": [{"categories": categories}]} for i in range(4)]
    (folder / "a.json").write_text(json.dumps(frames))
    return Good(folder / "a.json", read_performance)


# --- heads, weights, avatars, fits ------------------------------------------------------------------------------------


def _grmm(folder: Path) -> Good:
    save_avatar(make_avatar(), folder / "a.grmm")
    return Good(folder / "a.grmm", load_avatar)


def _weights(folder: Path) -> Good:
    import torch
    from model_fixtures import SHAPES, small_head

    from grmm_core.model.config import PRESETS
    from grmm_core.model.grmm import GRMM
    from grmm_core.model.weights import load_weights, save_weights
    from grmm_core.model.weights_file import WeightsInfo

    torch.manual_seed(0)
    head = small_head()
    model = GRMM(head, PRESETS["tiny"])
    rng = np.random.default_rng(0)
    info = WeightsInfo(
        "test", "", "", model.config, people=("a", "b"), z_id=rng.random((2, 6)), shapes=rng.random((2, SHAPES)),
        default_z_id=rng.random(6), default_shape=rng.random(SHAPES),
    )  # fmt: skip
    save_weights(folder / "a.safetensors", model, info)
    return Good(folder / "a.safetensors", functools.partial(load_weights, head=head))


@functools.cache
def _small_flame() -> dict[str, Any]:
    """FLAME's arrays with one expression only and in half precision, to keep the file small."""
    fields = flame_fields()
    return fields | {name: fields[name][..., :301].astype(np.float16) for name in ("shapedirs", "posedirs")}


def _flame(protocol: int | None) -> Maker:
    def make(folder: Path) -> Good:
        path = folder / ("flame.npz" if protocol is None else "flame.pkl")
        if protocol is None:
            np.savez(path, **_small_flame())
        else:
            write_flame_pickle(path, _small_flame(), protocol)
        return Good(path, read_flame_file)

    return make


def _landmarks(folder: Path) -> Good:
    np.savez(folder / "a.npz", lmk_face_idx=np.arange(68), lmk_b_coords=np.full((68, 3), 1.0 / 3.0))
    return Good(folder / "a.npz", read_landmark_embedding)


def _pickled(values: dict[str, Any], read: Callable[[Path], object]) -> Maker:
    def make(folder: Path) -> Good:
        (folder / "a.pkl").write_bytes(pickle.dumps(values, 2))
        return Good(folder / "a.pkl", read)

    return make


def _fit_request(folder: Path) -> Good:
    request = FitRequest((folder / "a.jpg",), folder / "a.grmm")
    (folder / REQUEST_FILE).write_text(json.dumps(request.to_json()))
    return Good(folder / REQUEST_FILE, lambda path: interrupted_request(path.parent / "a.grmm", path.parent))


# --- photos and data sets ---------------------------------------------------------------------------------------------


def _photo(name: str) -> Maker:
    def make(folder: Path) -> Good:
        y, x = np.mgrid[0:96, 0:80]
        exif = Image.Exif()
        exif[0x0112] = 6
        picture = np.stack([2 * x, 2 * y, 255 - x - y], axis=2).astype(np.uint8)
        Image.fromarray(picture).save(folder / name, exif=exif)
        return Good(folder / name, load_photo)

    return make


def _read_all(dataset: CaptureDataset) -> None:
    for subject in dataset.subjects:
        dataset.shape(subject)
    for shot in dataset.shots:
        for view in shot.views:
            dataset.picture(shot, view)


def _dataset(write: Callable[[Path], object]) -> Maker:
    def make(folder: Path) -> Good:
        write(folder / "data")
        head = flame_like_head()
        files = tuple(sorted(path for path in (folder / "data").rglob("*") if path.is_file()))
        return Good(folder / "data", lambda path: _read_all(open_dataset(path, head)), files)

    return make


def write_capture(folder: Path) -> None:
    """A person, one shot, one view."""
    folder.mkdir()
    g = np.random.default_rng(0)
    write_manifest(folder, Manifest("open_head", ["anna"], {"seed": 3}, []))
    write_subject(folder, "anna", g.normal(size=300), {"age": 30})
    view = View("c01", Camera.orbit(24, 24, 20, 5, 1.0, 20), "0002_00.png", "0002_00_z.png", "train")
    aligned, expression, pose = g.random(60, np.float32), g.random(100, np.float32), g.random((5, 3), np.float32)
    mask = (g.random((24, 24)) > 0.4).astype(np.float32)
    picture = Picture(g.random((24, 24, 3), np.float32), mask, (mask * 1.1).astype(np.float32))
    write_shot(folder, Shot("anna", 2, "mix", aligned, expression, pose, (view,), folder), [picture])


# --- the command line -------------------------------------------------------------------------------------------------


def run_command(words: list[str]) -> None:
    """Run a command in this process.

    Raises:
        GrmmError: What it said on exit code 1 or 2.
        AssertionError: It said more than a sentence, an internal error, or ran out of memory.
    """
    out, said = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(said):
        code = main(words)
    text = said.getvalue().strip()
    if "Traceback" in text or "Internal error" in text or "not enough memory" in text or code not in (0, 1, 2):
        raise AssertionError(f"exit code {code}: {text[-2000:]}")
    if code == 2:  # argparse shows the usage first, and then what is wrong
        raise GrmmError(f"{text.splitlines()[-1][:200]}.")
    if code == 1:
        raise GrmmError(text)


def _command(make: Maker) -> Maker:
    """`grmm info` of a file of another kind."""

    def made(folder: Path) -> Good:
        good = make(folder)
        return Good(good.path, lambda path: run_command(["info", str(path), "--json"]), good.victims)

    return made


def _words(*words: str) -> Maker:
    """A command line, a word on each line of a file, which ends before the model is loaded: its avatar is missing."""

    def make(folder: Path) -> Good:
        (folder / "words.txt").write_text("\n".join(words))

        def run(path: Path) -> None:
            with contextlib.chdir(path.parent):
                run_command(path.read_bytes().decode("utf-8", "surrogateescape").split("\n"))

        return Good(folder / "words.txt", run)

    return make


KINDS: dict[str, Maker] = {
    "ply": _splats("a.ply", 1),
    "text ply": _text_ply,
    "compressed ply": _copied("playcanvas.compressed.ply"),
    "splat": _splats("a.splat"),
    "ksplat": _copied("level_2.ksplat"),
    "spz 2": _splats("a.spz", 1, version=2),
    "spz 3": _splats("a.spz", 1),
    "spz 4": _splats("a.spz", 1, version=4),
    "sog": _splats("a.sog"),
    "sog folder": _sog_folder,
    "gltf splats": _splats("a.glb", 1),
    "gltf mesh": _gltf_mesh,
    "gaussian avatars folder": _gaussian_avatar,
    "cap4d": _cap4d,
    "lam": _lam,
    "arkit json": _recorded("a.json"),
    "live link csv": _recorded("a.csv"),
    "decimal commas": _table("a.csv", ["Timecode", *ARKIT_NAMES], lambda i: [f"00:00:00:{i:02d}.000"], ";"),
    "audio2face csv": _table("a.csv", ["timeCode", *(f"blendShapes.{n}" for n in ARKIT_NAMES)], lambda i: [i / 30]),
    "utf-16 csv": _table("a.csv", ["timeCode", *(f"blendShapes.{n}" for n in ARKIT_NAMES)], lambda i: [i / 30], ",", "utf-16"),
    "face cap": _table("a.txt", ["bs", *ARKIT_NAMES], lambda i: ["k", 33 * i, *[0.5] * 10]),
    "mediapipe json": _mediapipe,
    "flame npz": _flame_track,
    "grmm": _grmm,
    "weights": _weights,
    "flame pickle 0": _flame(0),
    "flame pickle 2": _flame(2),
    "flame model npz": _flame(None),
    "flame masks": _pickled({"face": np.arange(9), "neck": np.arange(4)}, read_flame_masks),
    "landmarks npz": _landmarks,
    "landmarks pickle": _pickled(
        {"lmk_face_idx": np.arange(68), "lmk_b_coords": np.full((68, 3), 1 / 3)}, read_landmark_embedding
    ),
    "fit request": _fit_request,
    "photo png": _photo("a.png"),
    "photo jpeg": _photo("a.jpg"),
    "photo tiff": _photo("a.tif"),
    "photo webp": _photo("a.webp"),
    "capture": _dataset(write_capture),
    "vhap": _dataset(write_vhap),
    "renderme": _dataset(write_renderme),
    "nersemble": _dataset(write_nersemble),
    "grmm info ply": _command(_splats("a.ply")),
    "grmm info sog": _command(_splats("a.sog")),
    "grmm info json": _command(_recorded("a.json")),
    "grmm info grmm": _command(_grmm),
    "grmm info folder": _command(_gaussian_avatar),
    "grmm render": _words(
        "render", "missing.grmm", "-o", "a.png", "--size", "64x48", "--set", "jawOpen=0.5", "jaw.x=0.1", "--yaw", "20",
        "--background", "1,0.5,0", "--passes", "rgb,depth", "--lod", "1", "--threads", "2",
    ),
    "grmm export": _words(
        "export", "missing.grmm", "-o", "a.spz", "--spz-version", "4", "--sh-degree", "1", "--set", "laugh=1", "--lod", "2",
    ),
    "grmm fit": _words("fit", "missing.jpg", "-o", "a.grmm", "--preset", "fast", "--face", "1", "--mask", "m.png", "--resume"),
}  # fmt: skip
"""In the order in which a run goes through them."""
LARGE = ("flame pickle 0", "flame pickle 2", "flame model npz", "weights", "nersemble", "renderme")
"""Kinds that take long to read: `make test` reads fewer of them."""
