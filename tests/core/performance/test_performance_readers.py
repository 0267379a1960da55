"""Performance files: what is read from each layout, and what is said about bad ones."""

from __future__ import annotations

import contextlib
import io
import json
import zipfile

import numpy as np
import pytest

from grmm_core.controls.names import ARKIT_NAMES, JOINT_NAMES
from grmm_core.errors import FileAccessError, FileFormatError, GrmmError
from grmm_core.formats import read_performance, write_performance
from grmm_core.geometry.rotations import axis_angle_to_matrix, euler_to_matrix
from grmm_core.performance import Performance

ANGLES = [f"{part}{axis}" for part in ("Head", "LeftEye", "RightEye") for axis in ("Yaw", "Pitch", "Roll")]
PASCAL = [name[0].upper() + name[1:] for name in ARKIT_NAMES]


def smooth_weights(count, seed=0):
    """Weights [count, 52] in 0..1 with every shape different."""
    rng = np.random.default_rng(seed)
    phase, speed = rng.uniform(0, 6, 52), rng.uniform(0.02, 0.2, 52)
    return (0.5 + 0.5 * np.sin(np.arange(count)[:, None] * speed + phase)).round(5)


def timecode(frame, fps=60, start=3600 * 16 + 47 * 60 + 39, fraction=0.125):
    total = start * fps + frame
    seconds, count = divmod(total, fps)
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}:{count + fraction:06.3f}"


def write_csv(path, weights, angles=None, columns=None, codes=None):
    """A Live Link Face file; `columns` reorders or drops columns by name."""
    names = ["Timecode", "BlendShapeCount", *PASCAL, *ANGLES]
    angles = np.zeros((len(weights), 9)) if angles is None else angles
    codes = codes or [timecode(i) for i in range(len(weights))]
    lines = [",".join(columns or names)]
    for code, row, turn in zip(codes, weights, angles, strict=True):
        cells = dict(zip(names, [code, "61", *map(repr, map(float, row)), *map(repr, map(float, turn))], strict=True))
        lines.append(",".join(cells[name] for name in columns or names))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_arkit_json_with_times_keeps_order_of_names(tmp_path):
    weights = smooth_weights(30)
    order = np.random.default_rng(1).permutation(52)
    document = {
        "names": [ARKIT_NAMES[i] for i in order],
        "metadata": {"fps": 24},
        "frames": [{"weights": list(row[order]), "time": i / 24} for i, row in enumerate(weights)],
    }
    path = tmp_path / "a.json"
    path.write_text(json.dumps(document))
    performance = read_performance(path)
    assert performance.weights == pytest.approx(weights, abs=1e-6)
    assert performance.fps == 24
    assert performance.times == pytest.approx(np.arange(30) / 24)
    assert performance.warnings == []
    assert len(performance.recorded_shapes) == 52


@pytest.mark.parametrize("layout", ["maps", "audio2face", "list", "rows"])
def test_arkit_json_variants_give_the_same_weights(tmp_path, layout):
    weights = smooth_weights(8)
    maps = [dict(zip(ARKIT_NAMES, map(float, row), strict=True)) for row in weights]
    document = {
        "maps": {"fps": 60, "frames": [{"blendShapes": m, "timestamp": 5 + i / 60} for i, m in enumerate(maps)]},
        "audio2face": {"exportFps": 60, "facsNames": list(ARKIT_NAMES), "weightMat": weights.tolist()},
        "list": [{"time": i / 60, **m} for i, m in enumerate(maps)],
        "rows": {"fps": 60, "frames": weights.tolist()},
    }[layout]
    path = tmp_path / "a.json"
    path.write_text(json.dumps(document), encoding="utf-8-sig")
    performance = read_performance(path)
    assert performance.weights == pytest.approx(weights, abs=1e-6)
    assert performance.fps == 60
    assert performance.times[0] == 0


def test_arkit_json_underscored_and_missing_names_are_said(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"fps": 30, "names": ["eyeBlink_L", "_neutral", "jawOpen"], "frames": [[0.5, 1, 1.5]] * 4}))
    performance = read_performance(path)
    assert performance.weights[0, ARKIT_NAMES.index("eyeBlinkLeft")] == 0.5
    assert performance.recorded_shapes == ("eyeBlinkLeft", "jawOpen")
    assert any("browDownLeft" in w and "stay at zero" in w for w in performance.warnings)
    assert any("jawOpen (1.50 to 1.50)" in w for w in performance.warnings)


def test_nan_rows_are_interpolated_and_said_and_many_are_refused(tmp_path):
    weights = smooth_weights(20)
    rows = [[float("nan")] * 52 if i in (4, 5) else list(row) for i, row in enumerate(weights)]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"fps": 30, "names": ARKIT_NAMES, "frames": rows}))
    performance = read_performance(path)
    assert performance.weights[4] == pytest.approx(weights[3] + (weights[6] - weights[3]) / 3, abs=1e-5)
    assert any(w.startswith("2 of 20 frames had no valid weights (the first is frame 4)") for w in performance.warnings)
    path.write_text(json.dumps({"fps": 30, "names": ARKIT_NAMES, "frames": [[None] * 52] * 11 + rows[6:15]}))
    with pytest.raises(FileFormatError, match="11 of its 20 frames"):
        read_performance(path)


def test_live_link_columns_are_found_by_name_in_any_order_and_case(tmp_path):
    weights, angles = smooth_weights(90), np.random.default_rng(2).uniform(-0.4, 0.4, (90, 9))
    plain = read_performance(write_csv(tmp_path / "a.csv", weights, angles))
    names = ["Timecode", "BlendShapeCount", *PASCAL, *ANGLES]
    shuffled = list(np.random.default_rng(3).permutation(names))
    path = write_csv(tmp_path / "b.csv", weights, angles, shuffled)
    header, _, rest = path.read_text().partition("\n")
    path.write_text(header.lower() + "\n" + rest)
    other = read_performance(path)
    assert plain.weights == pytest.approx(weights, abs=1e-6)
    assert np.array_equal(plain.weights, other.weights)
    assert np.array_equal(plain.head_rotation, other.head_rotation)
    assert plain.fps == other.fps == 60
    assert plain.times == pytest.approx(np.arange(90) / 60)
    assert plain.timecodes[0] == "16:47:39:00.125"
    assert plain.warnings == []


def test_live_link_heads_turn_as_in_the_engine_of_the_apps_maker(tmp_path):
    """Derived in docs/formats.md: yaw to the subject's right, pitch down, roll to the left shoulder are positive."""
    nose, ear = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])  # forward, and the subject's left
    for column, along, component in ((0, nose, 0), (1, nose, 1), (2, ear, 1)):
        angles = np.zeros((70, 9))
        angles[:, column] = 0.3
        path = write_csv(tmp_path / "a.csv", smooth_weights(70), angles)
        turned = {}
        for option in ("", "landscape", "flip_yaw", "flip_pitch", "flip_roll"):
            turn = euler_to_matrix(read_performance(path, **({option: True} if option else {})).head_rotation[0])
            turned[option] = float((turn @ along)[component])
        assert turned[""] == pytest.approx(-np.sin(0.3), abs=1e-6)
        flipped = {"flip_yaw", "landscape"} if column == 0 else {"flip_pitch", "landscape"} if column == 1 else {"flip_roll"}
        for option, value in turned.items():
            assert np.sign(value) == (1 if option in flipped else -1), (column, option)


def test_live_link_angles_compose_as_yaw_of_pitch_of_roll(tmp_path):
    angles = np.tile(np.linspace(0.1, 0.9, 9), (70, 1))
    found = read_performance(write_csv(tmp_path / "a.csv", smooth_weights(70), angles)).head_rotation
    yaw, pitch, roll = angles[0, :3]
    wanted = euler_to_matrix(np.array([0, -yaw, 0])) @ euler_to_matrix(np.array([pitch, 0, 0]))
    assert euler_to_matrix(found[0]) == pytest.approx(wanted @ euler_to_matrix(np.array([0, 0, -roll])), abs=1e-6)


def test_live_link_eye_signs_follow_the_look_shapes(tmp_path):
    weights, angles = np.zeros((100, 52)), np.zeros((100, 9))
    swing = np.sin(np.arange(100) / 9)
    for side, out in (("Left", swing), ("Right", -swing)):
        weights[:, ARKIT_NAMES.index(f"eyeLookOut{side}")] = np.maximum(out, 0)
        weights[:, ARKIT_NAMES.index(f"eyeLookIn{side}")] = np.maximum(-out, 0)
        weights[:, ARKIT_NAMES.index(f"eyeLookDown{side}")] = np.maximum(np.cos(np.arange(100) / 5), 0)
    for sign in (1, -1):
        angles[:, 3] = angles[:, 6] = sign * 0.4 * swing
        angles[:, 4] = angles[:, 7] = -sign * 0.2 * np.cos(np.arange(100) / 5)
        performance = read_performance(write_csv(tmp_path / "a.csv", weights, angles))
        for eye in (performance.left_eye_rotation, performance.right_eye_rotation):
            assert eye[:, 1] == pytest.approx(0.4 * swing)  # positive yaw looks to the subject's left
            assert eye[:, 0] == pytest.approx(0.2 * np.cos(np.arange(100) / 5))  # positive pitch looks down


def test_live_link_rows_without_a_face_and_gaps_and_midnight(tmp_path):
    weights = smooth_weights(120)
    frames = [i for i in range(150) if not 60 <= i < 90]
    codes = [timecode(i, start=86399) for i in frames]
    codes = [code.replace("24:", "00:", 1) if code.startswith("24:") else code for code in codes]
    path = write_csv(tmp_path / "a.csv", weights, codes=codes)
    lines = path.read_text().splitlines()
    lines[11] = f"{codes[10]},0"
    path.write_text("\r\n".join(lines))
    performance = read_performance(path)
    assert performance.times == pytest.approx(np.array(frames) / 60, abs=1e-6)
    assert performance.weights[10] == pytest.approx((weights[9] + weights[11]) / 2, abs=1e-5)
    assert any("1 of 120 frames had no valid weights (the first is frame 10)" in w for w in performance.warnings)
    assert any("1 gaps in time; the longest is 0.52 s at 0.98 s" in w for w in performance.warnings)


def test_live_link_repeated_and_unordered_frames_are_cleaned(tmp_path):
    weights = smooth_weights(70)
    codes = [timecode(i) for i in range(70)]
    codes[20] = codes[19]
    codes[40], codes[41] = codes[41], codes[40]
    performance = read_performance(write_csv(tmp_path / "a.csv", weights, codes=codes))
    assert performance.frame_count == 69
    assert (np.diff(performance.times) > 0).all()
    assert performance.weights[39] == pytest.approx(weights[41], abs=1e-6)
    assert len(performance.warnings) == 3


def test_controls_take_weights_and_head_rotation_once(tmp_path):
    angles = np.zeros((70, 9))
    angles[:, 0] = 0.2
    performance = read_performance(write_csv(tmp_path / "a.csv", smooth_weights(70), angles))
    controls = performance.controls(5)
    assert controls.aligned[:52] == pytest.approx(performance.weights[5])
    assert controls.pose[JOINT_NAMES.index("neck")] == pytest.approx([0.0, -0.2, 0.0])
    assert not controls.pose[3:].any(), "the look shapes already turn the eyes"
    assert performance.controls(5, head_joint="root").pose[0] == pytest.approx([0.0, -0.2, 0.0])


def flame_arrays(count=12, expressions=100):
    rng = np.random.default_rng(4)
    rotations = {name: rng.normal(size=(count, 3)) * 0.3 for name in ("rotation", "neck_pose", "jaw_pose", "translation")}
    return {
        "expr": rng.normal(size=(count, expressions)).astype(np.float32),
        "eyes_pose": rng.normal(size=(count, 6)) * 0.2,
        "shape": rng.normal(size=300).astype(np.float32),
        "static_offset": rng.normal(size=(1, 5143, 3)).astype(np.float32) * 1e-3,
        "dynamic_offset": np.zeros((count, 5143, 3), np.float32),
        **rotations,
    }


def test_flame_npz_rotations_are_the_same_turns(tmp_path):
    arrays = flame_arrays()
    np.savez_compressed(tmp_path / "flame_param.npz", **arrays)
    performance = read_performance(tmp_path / "flame_param.npz", fps=30)
    assert performance.head_model == "flame"
    assert np.array_equal(performance.expression, arrays["expr"])
    assert performance.static_offset.shape == (5143, 3)
    for ours, theirs in (("head_rotation", "rotation"), ("neck_rotation", "neck_pose"), ("jaw_rotation", "jaw_pose")):
        assert euler_to_matrix(getattr(performance, ours)) == pytest.approx(axis_angle_to_matrix(arrays[theirs]), abs=1e-9)
    assert euler_to_matrix(performance.right_eye_rotation) == pytest.approx(axis_angle_to_matrix(arrays["eyes_pose"][:, 3:]))
    controls = performance.controls(3)
    assert controls.expression == pytest.approx(arrays["expr"][3])
    assert controls.pose[0] == pytest.approx(performance.head_rotation[3], abs=1e-6)
    assert controls.pose[1] == pytest.approx(performance.neck_rotation[3], abs=1e-6)
    assert controls.pose[2] == pytest.approx(performance.jaw_rotation[3])


def test_emoca_codes_are_padded_and_said(tmp_path):
    rng = np.random.default_rng(5)
    arrays = {"expcode": rng.normal(size=(6, 50)), "posecode": rng.normal(size=(6, 6)) * 0.1}
    arrays["shapecode"] = rng.normal(size=(6, 100))
    np.savez(tmp_path / "codes.npz", **arrays)
    performance = read_performance(tmp_path / "codes.npz")
    assert performance.expression.shape == (6, 100)
    assert not performance.expression[:, 50:].any()
    assert any("50 of FLAME's 100 expression coefficients" in w for w in performance.warnings)
    assert euler_to_matrix(performance.jaw_rotation) == pytest.approx(axis_angle_to_matrix(arrays["posecode"][:, 3:]))


def npy_header(shape, dtype="<f4"):
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize(
    ("member", "reason"),
    [
        (npy_header((1 << 40, 100)), "claims"),
        (npy_header((2, 100), "|O") + b"0" * 4000, "damaged|objects"),
        (npy_header((3, 7)) + bytes(84 * 4), r"expression has shape \(3, 7\)|1 .*"),
        (b"\x93NUMPY\x09\x00", "damaged"),
        (npy_header("(" * 5000), "damaged"),
    ],
)
def test_hostile_arrays_are_refused_without_allocating(tmp_path, member, reason):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("expr.npy", member)
    if "expression" in reason:  # seven coefficients are few, but allowed
        assert read_performance(tmp_path / "a.npz").expression.shape == (3, 100)
        return
    with pytest.raises(FileFormatError, match=reason):
        read_performance(tmp_path / "a.npz")


def test_zip_bomb_is_refused_by_its_stated_size(tmp_path):
    stated = 2 << 30
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("expr.npy", npy_header((stated // 400, 100)) + bytes(1 << 20))
    data = bytearray((tmp_path / "a.npz").read_bytes())
    directory = data.rindex(b"PK\x01\x02")
    data[directory + 24 : directory + 28] = (stated + 128).to_bytes(4, "little")
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(FileFormatError, match="more than the"):
        read_performance(tmp_path / "a.npz")


def test_pickled_arrays_do_not_run(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (open, (str(tmp_path / "ran"), "w"))

    np.savez(tmp_path / "a.npz", expr=np.array([Bomb()], object))
    with pytest.raises(FileFormatError, match="Python objects"):
        read_performance(tmp_path / "a.npz")
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.json", b"{", "not JSON"),
        ("a.json", b"[" * 100000, "not JSON"),
        ("a.json", b"{}", "no list of frames"),
        ("a.json", b'{"frames": [{"weights": [1, 2]}]}', "no list of names"),
        ("a.json", b'{"names": ["x"], "frames": [[1]]}', "none of its names"),
        ("a.json", b'{"names": ["jawOpen"], "frames": [[1, 2]]}', "frame 0 has 2 weights for 1 names"),
        ("a.json", b'{"names": ["jawOpen"], "frames": [["x"]]}', "not a number"),
        ("a.json", b'{"names": ["jawOpen"], "frames": [[[1, 2]]]}', "not a number"),
        ("a.json", b'{"names": ["jawOpen"], "frames": [[1e999]]}', "no finite"),
        ("a.csv", b"", "does not name columns"),
        ("a.csv", b"a,b\n1,2\n", "none of its names is an ARKit shape"),
        ("a.csv", b"Timecode,JawOpen\n", "no frames"),
        ("a.csv", b"Timecode,JawOpen\nyesterday,0.5\n", "not of the form"),
        ("a.csv", b"Timecode,JawOpen\n00:00:00:01.0,0.5,7\n", "3 cells for 2 columns"),
        ("a.csv", b"Timecode,JawOpen\n00:00:00:01.0,x\n", "no finite weights"),
        ("a.csv", b"Timecode,JawOpen\n\0\xff", "not text"),
        ("a.npz", b"PK\x03\x04 nothing", "damaged"),
        ("a.bvh", b"HIERARCHY", "not a performance that can be read"),
    ],
)
def test_bad_files_give_one_sentence(tmp_path, name, content, reason):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileFormatError, match=reason) as caught:
        read_performance(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert str(tmp_path / name) in str(caught.value)


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(FileAccessError, match="does not exist"):
        read_performance(tmp_path / "none.csv")
    with pytest.raises(FileAccessError, match="folder"):
        read_performance(tmp_path)
    with pytest.raises(GrmmError):
        read_performance("a\0b.json")


def test_progress_rises_and_cancel_passes_through(tmp_path):
    from grmm_core.errors import CancelledError

    path = write_csv(tmp_path / "a.csv", smooth_weights(4500))
    seen = []
    read_performance(path, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0

    def cancel(_):
        raise CancelledError("stop")

    with pytest.raises(CancelledError):
        read_performance(path, progress=cancel)


def test_truncated_real_layouts_never_show_a_traceback(tmp_path):
    csv_data = write_csv(tmp_path / "a.csv", smooth_weights(5)).read_bytes()
    buffer = io.BytesIO()
    np.savez(buffer, **{k: v for k, v in flame_arrays(2).items() if k != "dynamic_offset"})
    rows = {"fps": 30, "names": ARKIT_NAMES, "frames": smooth_weights(3).tolist()}
    for name, data in (("a.csv", csv_data), ("a.npz", buffer.getvalue()), ("a.json", json.dumps(rows).encode())):
        for part in np.linspace(0, len(data) - 1, 60).astype(int):
            (tmp_path / name).write_bytes(data[:part])
            with contextlib.suppress(GrmmError):  # anything else fails the test
                read_performance(tmp_path / name)


@pytest.mark.slow
def test_ten_minutes_at_sixty_frames_per_second(tmp_path):
    path = write_csv(tmp_path / "a.csv", np.tile(smooth_weights(3600), (10, 1)))
    assert read_performance(path).duration == pytest.approx(600, abs=0.1)


def test_cap4d_fits_keep_rotations_and_movement(tmp_path):
    """Keys as CAP4D's `fit.npz` has them: 150 and 65 coefficients, one rotation for both eyes."""
    rng = np.random.default_rng(4)
    arrays = {name: rng.normal(0, 0.2, (7, 3)).astype(np.float32) for name in ("rot", "tra", "eye_rot", "neck_rot", "jaw_rot")}
    arrays |= {"expr": rng.normal(size=(7, 65)), "shape": rng.normal(size=150), "fx": np.ones((1, 1)), "extr": np.eye(4)[None]}
    np.savez(tmp_path / "fit.npz", **arrays)
    found = read_performance(tmp_path / "fit.npz")
    assert found.expression[:, :65] == pytest.approx(arrays["expr"], abs=1e-6)
    for name, key in (
        ("head_rotation", "rot"), ("neck_rotation", "neck_rot"), ("jaw_rotation", "jaw_rot"),
        ("left_eye_rotation", "eye_rot"), ("right_eye_rotation", "eye_rot"),
    ):  # fmt: skip
        assert euler_to_matrix(getattr(found, name)) == pytest.approx(axis_angle_to_matrix(arrays[key]), abs=1e-5)
    assert found.translation == pytest.approx(arrays["tra"])
    assert any("CAP4D" in sentence for sentence in found.warnings)


@pytest.mark.parametrize("rate", [12.0, 23.976, 24.0, 26.0, 60.0, 120.0, 300.0])
@pytest.mark.parametrize(("first", "seconds"), [(0.0, 0.4), (0.8, 0.4), (3.0, 2.5)])
def test_a_recording_of_any_rate_and_length_is_written_so_that_its_times_come_back(tmp_path, rate, first, seconds):
    """Ten frames of 24 a second had come back as four."""
    count = round(seconds * rate)
    weights = np.zeros((count, 52), np.float32)
    weights[:, ARKIT_NAMES.index("jawOpen")] = np.linspace(0.0, 0.5, count)
    path = tmp_path / "take.csv"
    write_performance(path, Performance(first + np.arange(count) / rate, weights, rate, recorded_shapes=ARKIT_NAMES))
    again = read_performance(path)
    assert again.frame_count == count
    np.testing.assert_allclose(again.times - again.times[0], np.arange(count) / rate, atol=1e-4)
    assert again.fps == pytest.approx(rate, rel=0.01)
