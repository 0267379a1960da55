"""Recordings as programs other than Live Link Face write them: layouts, names, units, encodings."""

from __future__ import annotations

import json

import numpy as np
import pytest

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import FileFormatError
from grmm_core.formats import format_to_read, read_performance

JAW = ARKIT_NAMES.index("jawOpen")
PASCAL = [name[0].upper() + name[1:] for name in ARKIT_NAMES]


def curves(count, seed=0):
    """Weights [count, 52] within 0..1."""
    rng = np.random.default_rng(seed)
    return (0.5 + 0.5 * np.sin(np.arange(count)[:, None] * rng.uniform(0.02, 0.2, 52) + rng.uniform(0, 6, 52))).round(5)


@pytest.mark.parametrize("index_column", [False, True])
def test_audio2face_3d_csv(tmp_path, index_column):
    """As NVIDIA's client writes it; some of its versions have a column of row numbers without a name first."""
    weights = curves(40)
    names = ["timeCode", *(f"blendShapes.{name}" for name in PASCAL), "emotion.joy"]
    rows = [[f"{i / 30:.6f}", *map(str, row), "0.3"] for i, row in enumerate(weights)]
    if index_column:
        names, rows = ["", *names], [[str(i), *row] for i, row in enumerate(rows)]
    path = tmp_path / "animation_frames.csv"
    path.write_text("\n".join(",".join(row) for row in [names, *rows]) + "\n")
    assert format_to_read(path, "performance").name == "audio2face"
    performance = read_performance(path)
    assert performance.weights == pytest.approx(weights, abs=1e-6)
    assert performance.fps == 30
    assert performance.times == pytest.approx(np.arange(40) / 30, abs=1e-5)
    assert performance.head_rotation is None
    assert performance.warnings == []


FACS = """
    browLowerL browLowerR innerBrowRaiserL innerBrowRaiserR outerBrowRaiserL outerBrowRaiserR eyesLookLeft eyesLookRight
    eyesLookUp eyesLookDown eyesCloseL eyesCloseR eyesUpperLidRaiserL eyesUpperLidRaiserR squintL squintR cheekRaiserL
    cheekRaiserR cheekPuffL cheekPuffR noseWrinklerL noseWrinklerR jawDrop jawDropLipTowards jawThrust jawSlideLeft
    jawSlideRight mouthSlideLeft mouthSlideRight dimplerL dimplerR lipCornerPullerL lipCornerPullerR lipCornerDepressorL
    lipCornerDepressorR lipStretcherL lipStretcherR upperLipRaiserL upperLipRaiserR lowerLipDepressorL lowerLipDepressorR
    chinRaiser lipPressor pucker funneler lipSuck
"""


def test_the_46_shapes_of_audio2face_become_arkits(tmp_path):
    assert len(FACS.split()) == 46
    path = tmp_path / "a2f.json"
    weights = np.eye(46).tolist()
    path.write_text(
        json.dumps({"exportFps": 60, "numPoses": 46, "numFrames": 46, "facsNames": FACS.split(), "weightMat": weights})
    )
    performance = read_performance(path)
    assert performance.fps == 60
    assert performance.weights.any(1).all(), "every one of them moves something"

    def given(name):
        row = performance.weights[FACS.split().index(name)]
        return {ARKIT_NAMES[i]: float(row[i]) for i in np.flatnonzero(row)}

    assert given("jawDrop") == {"jawOpen": 1.0}
    assert given("eyesCloseR") == {"eyeBlinkRight": 1.0}
    assert given("eyesLookLeft") == {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0}
    assert given("innerBrowRaiserL") == {"browInnerUp": 0.5}
    together = given("jawDropLipTowards")
    assert together["jawOpen"] == together["mouthClose"], "the lips stay closed"
    assert any("46 own shapes" in sentence for sentence in performance.warnings)


@pytest.mark.parametrize("layout", ["python", "javascript", "faces", "bare map"])
def test_mediapipe_results(tmp_path, layout):
    """A list of categories for each frame, as its Python and its JavaScript name them, with and without a list of faces."""
    weights, key = curves(20), "category_name" if layout in ("python", "faces") else "categoryName"
    frames = []
    for i, row in enumerate(weights):
        pairs = [("_neutral", 0.0), *zip(ARKIT_NAMES, map(float, row), strict=True)]
        categories = [{"index": k, "score": value, key: name, "displayName": ""} for k, (name, value) in enumerate(pairs)]
        face = {"categories": categories, "headIndex": -1, "headName": ""}
        frames.append({
            "python": categories,
            "faces": {"timestamp_ms": 1000 + 40 * i, "face_blendshapes": [categories]},
            "javascript": {"faceBlendshapes": [face], "timestamp": 40 * i},
            "bare map": {"timeMs": 40 * i, "categories": categories},
        }[layout])  # fmt: skip
    if layout == "javascript":
        frames[7] = {"faceBlendshapes": [], "timestamp": 280}
    if layout == "faces":
        frames[7] = {"timestamp_ms": 1280, "face_blendshapes": []}
    path = tmp_path / "mediapipe.json"
    path.write_text(json.dumps(frames))
    performance = read_performance(path, fps=25 if layout == "python" else None)
    seen = np.arange(20) != 7
    assert performance.weights[seen] == pytest.approx(weights[seen], abs=1e-6)
    assert performance.fps == 25
    assert performance.duration == pytest.approx(19 / 25)
    if layout in ("javascript", "faces"):
        assert any("1 of 20 frames had no valid weights" in sentence for sentence in performance.warnings)
    if layout != "python":
        assert any("read as milliseconds" in sentence for sentence in performance.warnings)


@pytest.mark.parametrize(("unit", "said"), [(1.0, None), (1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_units_of_time_stamps_are_recognised_and_said(tmp_path, unit, said):
    frames = [{"time": 1.7e9 * unit + i / 60 * unit, "weights": [0.5] * 52} for i in range(60)]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"names": list(ARKIT_NAMES), "frames": frames}))
    performance = read_performance(path)
    assert performance.frame_count == 60
    assert performance.duration == pytest.approx(59 / 60, rel=1e-3)
    assert round(performance.fps) == 60
    assert [sentence for sentence in performance.warnings if "time stamps" in sentence] == (
        [f"The time stamps are {performance_step(unit)} apart and were read as {said}."] if said else []
    )


def performance_step(unit):
    times = 1.7e9 * unit + np.arange(60) / 60 * unit
    return f"{float(np.median(np.diff(times))):g}"


def test_time_stamps_that_count_frames(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"fps": 48, "frames": [{"time": i, "jawOpen": i / 100} for i in range(50)]}))
    performance = read_performance(path)
    assert performance.times == pytest.approx(np.arange(50) / 48)
    assert any("count frames; 48 frames per second" in sentence for sentence in performance.warnings)


FACE_CAP_NAMES = [
    name[:-4] + "_L" if name.endswith("Left") and name not in ("jawLeft", "mouthLeft") else
    name[:-5] + "_R" if name.endswith("Right") and name not in ("jawRight", "mouthRight") else name
    for name in ARKIT_NAMES
]  # fmt: skip


def test_face_cap(tmp_path):
    weights = curves(30)
    lines = ["info,made by the test", "bs," + ",".join(FACE_CAP_NAMES)]
    for i, row in enumerate(weights):
        turn = [10.0 * np.sin(i / 9), 20.0, -5.0]
        lines.append(",".join(map(str, ["k", round(i * 1000 / 60), 0.1, 0.2, 0.3, *turn, 1.0, 2.0, 3.0, 4.0, *row])))
    path = tmp_path / "take.txt"
    path.write_text("\n".join(lines))
    assert format_to_read(path, "performance").name == "face-cap"
    performance = read_performance(path)
    assert performance.weights == pytest.approx(weights, abs=1e-6)
    assert performance.duration == pytest.approx(29 / 60, abs=1e-3)
    assert performance.head_rotation[3] == pytest.approx(np.deg2rad([10.0 * np.sin(3 / 9), 20.0, -5.0]))
    assert read_performance(path, flip_yaw=True).head_rotation[3, 1] == pytest.approx(-np.deg2rad(20.0))
    path.write_text("\n".join([lines[0], lines[1], lines[2] + ",1", lines[3][:40]]))
    with pytest.raises(FileFormatError, match="line 4"):
        read_performance(path)


def live_link(weights, point=".", separator=",", trailing=""):
    lines = [separator.join(["Timecode", "BlendShapeCount", *PASCAL, "HeadYaw"]) + trailing]
    for i, row in enumerate(weights):
        cells = [f"10:00:{i // 60:02d}:{i % 60:02d}.000", "61", *(f"{v:.5f}".replace(".", point) for v in row), f"0{point}25"]
        lines.append(separator.join(cells) + trailing)
    return "\r\n".join(lines) + "\r\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize(
    ("point", "separator", "trailing"), [(".", ",", ""), (",", ";", ""), (",", "\t", ""), (".", ",", ",,")]
)
def test_tables_of_other_countries_and_programs(tmp_path, encoding, point, separator, trailing):
    weights = curves(70)
    path = tmp_path / "take.csv"
    path.write_bytes(live_link(weights, point, separator, trailing).encode(encoding))
    performance = read_performance(path)
    assert performance.weights == pytest.approx(weights, abs=1e-6)
    assert performance.head_rotation[0, 1] == pytest.approx(-0.25)
    assert performance.warnings == []


def test_decimal_commas_between_commas_are_named(tmp_path):
    path = tmp_path / "take.csv"
    path.write_text(live_link(curves(5), ",", ","))
    with pytest.raises(FileFormatError, match="decimal commas need semicolons"):
        read_performance(path)


def test_json_in_utf_16(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(json.dumps({"fps": 30, "names": ["jawOpen"], "frames": [[0.5]] * 3}).encode("utf-16"))
    assert read_performance(path).weights[0, JAW] == 0.5


def test_percentages_are_scaled_and_said_and_glitches_are_not(tmp_path):
    weights = curves(70)
    path = tmp_path / "take.csv"
    path.write_text(live_link(100 * weights))
    performance = read_performance(path)
    assert performance.weights == pytest.approx(weights, abs=1e-5)
    assert any("percentages" in sentence for sentence in performance.warnings)
    weights[10, JAW] = 7.0
    path.write_text(live_link(weights))
    performance = read_performance(path)
    assert performance.weights[10, JAW] == pytest.approx(7.0)
    assert not any("percentages" in sentence for sentence in performance.warnings)
