"""Small data sets of exactly the structure of VHAP exports, RenderMe-360 and NeRSemble, and a head with FLAME's sizes."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from model_fixtures import small_head
from PIL import Image

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.rotations import axis_angle_to_matrix
from grmm_core.head import HeadModel

WIDTH, HEIGHT = 32, 24
JAW_OPEN = ARKIT_NAMES.index("jawOpen")
GL = np.diag([1.0, -1.0, -1.0, 1.0])


def flame_like_head() -> HeadModel:
    """A sphere with FLAME's numbers of components and joints, off the origin as FLAME's are."""
    head = small_head()
    rng = np.random.default_rng(1)
    count = head.vertex_count
    arkit = np.zeros((len(ARKIT_NAMES), 100), np.float32)
    arkit[:, : len(ARKIT_NAMES)] = np.eye(len(ARKIT_NAMES)) * 1.5
    arkit[JAW_OPEN] = 0.0  # FLAME opens the mouth with its jaw
    pose = np.zeros((len(ARKIT_NAMES), 5, 3), np.float32)
    pose[JAW_OPEN, 2, 0] = 0.4
    regressor = np.zeros((5, count), np.float32)
    regressor[np.arange(5), [40, 10, 41, 90, 120]] = 1.0
    return replace(
        head, name="flame2023", shape_dirs=rng.normal(0, 0.002, (count, 3, 300)).astype(np.float32),
        expression_dirs=rng.normal(0, 0.002, (count, 3, 100)).astype(np.float32), J_regressor=regressor,
        shape_names=tuple(map(str, range(300))), expression_names=tuple(map(str, range(100))),
        expression_pose=np.zeros((100, 5, 3), np.float32), arkit_to_expression=arkit, arkit_pose=pose,
    )  # fmt: skip


def world_camera(number: int) -> Camera:
    camera = Camera.orbit(WIDTH, HEIGHT, yaw=30.0 * number, pitch=10.0, distance=0.9, fov=25.0)
    return replace(camera, cx=15.2, cy=12.9, fx=camera.fx * 1.1)


def png(value: int, channels: str = "RGB") -> bytes:
    buffer = io.BytesIO()
    shape = (HEIGHT, WIDTH) if channels == "L" else (HEIGHT, WIDTH, len(channels))
    Image.fromarray(np.full(shape, value, np.uint8), channels).save(buffer, "PNG")
    return buffer.getvalue()


def flame_parameters(seed: int, expression: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """VHAP's keys for one moment, leading dimension 1."""
    rng = np.random.default_rng(seed)
    values = {name: rng.normal(0, 0.15, (1, 3)).astype(np.float32) for name in ("rotation", "neck_pose", "jaw_pose")}
    values |= {"translation": rng.normal(0, 0.05, (1, 3)), "eyes_pose": rng.normal(0, 0.1, (1, 6))}
    values |= {"shape": rng.normal(size=300), "expr": rng.normal(size=(1, 100)) if expression is None else expression[None]}
    values["shape"] = np.random.default_rng(0).normal(size=300)  # one person
    return values


def write_vhap(folder: Path) -> Path:
    """Two moments of one person, two cameras; the third moment is the test split."""
    (folder / "flame_param").mkdir(parents=True)
    (folder / "images").mkdir()
    (folder / "fg_masks").mkdir()
    splits: dict[str, list[dict]] = {"train": [], "val": [], "test": []}
    for moment in range(3):
        name = f"{moment:05d}"
        np.savez(folder / "flame_param" / f"{name}.npz", static_offset=np.zeros((1, 5143, 3)), **flame_parameters(moment))
        for number in range(2):
            camera = world_camera(number)
            (folder / "images" / f"{name}_{number:02d}.png").write_bytes(png(100 + 10 * moment + number))
            (folder / "fg_masks" / f"{name}_{number:02d}.png").write_bytes(png(51, "L"))
            frame = {
                "timestep_index": moment, "timestep_id": name, "camera_index": number, "camera_id": f"cam{number}",
                "cx": camera.cx, "cy": camera.cy, "fl_x": camera.fx, "fl_y": camera.fy, "h": HEIGHT, "w": WIDTH,
                "transform_matrix": (np.linalg.inv(camera.world_to_camera) @ GL).tolist(),
                "file_path": f"images/{name}_{number:02d}.png", "fg_mask_path": f"fg_masks/{name}_{number:02d}.png",
                "flame_param_path": f"flame_param/{name}.npz",
            }  # fmt: skip
            splits["test" if moment == 2 else "val" if number else "train"].append(frame)
    for split, frames in splits.items():
        (folder / f"transforms_{split}.json").write_text(json.dumps({"frames": frames, "h": HEIGHT, "w": WIDTH}))
    return folder


def write_renderme(folder: Path, distortion: float = 0.0) -> Path:
    """One actor with parts e0 (two frames) and a hair part without FLAME."""
    import h5py

    for part, frames in (("e0", 2), ("h0", 1)):
        paths = {kind: folder / kind / "0026" / f"0026_{part}_{kind}.smc" for kind in ("raw", "anno")}
        for path in paths.values():
            path.parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(paths["raw"], "w") as raw, h5py.File(paths["anno"], "w") as anno:
            for file in (raw, anno):
                file.attrs["actor_id"], file.attrs["performance_part"] = "0026", part
                cameras = file.create_group("Camera")
                cameras.attrs["num_device"], cameras.attrs["num_frame"] = 2, frames
                cameras.attrs["resolution"] = np.array([HEIGHT, WIDTH])
            for number in range(2):
                camera, name = world_camera(number), f"{number:02d}"
                k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
                anno[f"Calibration/{name}/K"], anno[f"Calibration/{name}/D"] = k, np.array([distortion, 0, 0, 0, 0])
                anno[f"Calibration/{name}/RT"] = np.linalg.inv(camera.world_to_camera)
                for frame in range(frames):
                    raw[f"Camera/{name}/color/{frame}"] = np.frombuffer(png(60 + 20 * frame + number), np.uint8)
                    anno[f"Camera/{name}/mask/{frame}"] = np.frombuffer(png(255), np.uint8)
            if part.startswith("e"):
                flame = anno.create_group("FLAME")
                flame.attrs["num_frame"] = frames
                for frame in range(frames):
                    p = flame_parameters(frame)
                    values = {
                        "global_pose": p["rotation"][0], "neck_pose": p["neck_pose"][0], "jaw_pose": p["jaw_pose"][0],
                        "left_eye_pose": p["eyes_pose"][0, :3], "right_eye_pose": p["eyes_pose"][0, 3:],
                        "trans": p["translation"][0], "shape": p["shape"][:100], "exp": p["expr"][0, :50],
                    }  # fmt: skip
                    for name, value in values.items():
                        flame[f"{frame}/{name}"] = value
    return folder


SERIALS = ("222200037", "222200046")
SCALE = 1.3


def write_nersemble(folder: Path, frames: int = 3) -> Path:
    """The benchmark's person 393 with a training and a test sequence, two cameras."""
    person = folder / "mono_flame_avatar" / "393"
    cameras = {serial: world_camera(number) for number, serial in enumerate(SERIALS)}
    (person / "calibration").mkdir(parents=True)
    values = {
        "world_2_cam": {serial: camera.world_to_camera.tolist() for serial, camera in cameras.items()},
        "intrinsics": {serial: [[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]] for serial, c in cameras.items()},
    }
    (person / "calibration" / "camera_params.json").write_text(json.dumps(values))
    for sequence in ("EXP-4-lips", "FREE"):
        base = person / "sequences" / sequence
        for name in ("images", "alpha_maps", "tracking"):
            (base / name).mkdir(parents=True)
        for serial in SERIALS:
            write_video(base / "images" / f"cam_{serial}.mp4", [40 + 50 * i for i in range(frames)])
            write_video(base / "alpha_maps" / f"cam_{serial}.mp4", [255] * frames)
        every = [flame_parameters(i) for i in range(frames)]
        rotation = np.concatenate([p["rotation"] for p in every])
        tracks = {"expression": "expr", "jaw": "jaw_pose", "neck": "neck_pose", "eyes": "eyes_pose"}
        tracks["translation"] = "translation"
        np.savez(
            base / "tracking" / "flame2023_tracking.npz", shape=every[0]["shape"][None], frames=np.arange(frames),
            rotation=rotation, rotation_matrices=axis_angle_to_matrix(rotation), scale=np.full((1, 1), SCALE),
            **{ours: np.concatenate([p[theirs] for p in every]) for ours, theirs in tracks.items()},
        )  # fmt: skip
    return folder


def write_video(path: Path, values: list[int]) -> None:
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=24)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for value in values:
            frame = av.VideoFrame.from_ndarray(np.full((HEIGHT, WIDTH, 3), value, np.uint8), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
