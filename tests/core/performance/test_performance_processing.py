"""Cleaning performances: time, gain, calibration, smoothing, keys, retargeting, and round trips through every format."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import FileFormatError, ShapeError
from grmm_core.formats import read_performance, write_performance
from grmm_core.geometry.rotations import euler_to_matrix
from grmm_core.performance import (
    REGIONS,
    CleanOptions,
    Performance,
    apply_gain,
    calibrate_neutral,
    clamp,
    clean,
    find_neutral_frames,
    resample,
    shift,
    smooth,
    to_arkit,
    to_expression,
    trim,
)
from grmm_core.performance.curves import reduce_curves
from grmm_core.performance.retarget import bounded_least_squares
from grmm_core.performance.smoothing import noise_level, smooth_curves

BLINK, JAW = ARKIT_NAMES.index("eyeBlinkLeft"), ARKIT_NAMES.index("jawOpen")


def largest_error(times, values, curves):
    return max(np.abs(curve.evaluate(times) - values[:, k]).max() for k, curve in enumerate(curves))


def jitter(values):
    """Root mean square of the second difference of curves [T, N]: what the eye sees as trembling, [N]."""
    return np.sqrt(np.mean(np.diff(values.astype(np.float64), 2, axis=0) ** 2, axis=0))


def key_count(performance, interpolation="bezier"):
    curves = reduce_curves(performance.times, performance.weights, 0.01, interpolation)
    return sum(curve.times.size for curve in curves)


def talk(fps=60.0, seconds=10.0, seed=0):
    """Speech-like weights: syllables on the jaw with sudden closures, blinks of a tenth of a second, slow brows."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(fps * seconds)) / fps
    weights = np.zeros((t.size, 52))
    for column in range(52):
        weights[:, column] = 0.15 + 0.1 * np.sin(rng.uniform(0.5, 3) * t + rng.uniform(0, 6))
    weights[:, JAW] = 0.3 + 0.25 * np.sin(2 * np.pi * 3.1 * t)
    for closure in np.arange(0.7, seconds, 1.3):
        weights[:, JAW] *= 1 - np.exp(-(((t - closure) / 0.02) ** 2))
    weights[:, BLINK] = 0.05
    for blink in np.arange(0.9, seconds, 2.1):
        weights[:, BLINK] += 0.9 * np.clip(1 - np.abs(t - blink) / 0.07, 0, 1)
    head = np.stack([0.1 * np.sin(t), 0.2 * np.sin(0.7 * t), 0.05 * np.cos(t)], 1)
    return Performance(t, weights.astype(np.float32), fps, "test", ARKIT_NAMES, head_rotation=head)


def test_resampling_up_and_back_keeps_the_frames():
    performance = talk(30)
    back = resample(resample(performance, 60), 30)
    assert back.frame_count == performance.frame_count
    assert back.weights == pytest.approx(performance.weights, abs=1e-6)
    assert back.head_rotation == pytest.approx(performance.head_rotation, abs=1e-9)


def test_a_lower_rate_keeps_the_height_of_blinks_and_the_depth_of_closures():
    performance = talk(60)
    plain, kept = resample(performance, 24, keep_peaks=False), resample(performance, 24)
    lost = []
    for column, sign in ((BLINK, 1), (JAW, -1)):
        for start in np.arange(0.5, 9, 2.1):
            extremes = [
                (sign * p.weights[(p.times > start) & (p.times < start + 2.1), column]).max()
                for p in (performance, plain, kept)
            ]
            assert extremes[2] >= extremes[0] - 0.04
            lost.append(extremes[0] - extremes[1])
    assert max(lost) > 0.1, "otherwise plain interpolation would do"
    assert np.abs(kept.weights - plain.weights)[:, 0].max() == 0, "slow curves are not touched"


def test_gaps_in_time_are_bridged():
    performance = talk(30)
    keep = np.ones(300, bool)
    keep[100:160] = False
    changes = {name: getattr(performance, name)[keep] for name in ("times", "weights", "head_rotation")}
    gappy = replace(performance, **changes)
    even = resample(gappy, 30)
    assert even.frame_count == 300
    assert np.diff(even.times) == pytest.approx(1 / 30)
    assert even.weights[130, 0] == pytest.approx((performance.weights[99, 0] + performance.weights[160, 0]) / 2, abs=0.02)


def test_shift_and_trim():
    performance = talk(30)
    assert shift(performance, -1.5).times[0] == -1.5
    part = trim(performance, 2.0, 3.0)
    assert part.frame_count == 31
    assert part.times[0] == 0
    assert np.array_equal(part.weights, performance.weights[60:91])
    with pytest.raises(ShapeError, match=r"lasts 9\.97 s"):
        trim(performance, 20, 30)
    with pytest.raises(ShapeError, match="frame rate"):
        resample(performance, 0)


def test_cleaning_in_one_call_is_the_steps_in_order():
    performance = talk(60)
    options = CleanOptions(
        start=1.0, end=8.0, neutral=range(60, 70), gains={"jaw": 1.5, "mouth": 12.0}, smoothing=0.4, fps=24, offset=2.0
    )
    seen = []
    cleaned = clean(performance, options, seen.append)
    steps = trim(calibrate_neutral(performance, range(60, 70)), 1.0, 8.0)
    steps = shift(apply_gain(resample(smooth(resample(steps, 60, keep_peaks=False), 0.4), 24), options.gains), 2.0)
    assert cleaned.weights == pytest.approx(steps.weights, abs=1e-6)
    assert cleaned.times == pytest.approx(steps.times)
    assert seen[-1] == 1.0
    assert any("they were limited" in w for w in cleaned.warnings)
    assert performance.warnings == []
    untouched = clean(performance, CleanOptions())
    assert np.array_equal(untouched.weights, performance.weights)
    assert clean(performance, CleanOptions(neutral="auto")).weights.mean() < performance.weights.mean()


def test_every_shape_is_in_one_region():
    assert sorted(i for region in REGIONS.values() for i in region) == list(range(52))


def test_gain_acts_on_its_region_only():
    performance = talk(30, 2)
    louder = apply_gain(performance, {"jaw": 3.0, "head": 0.5, "eyeBlinkLeft": 0.0})
    assert louder.weights[:, JAW] == pytest.approx(np.minimum(performance.weights[:, JAW] * 3, 1))
    assert not louder.weights[:, BLINK].any()
    others = [i for i in range(52) if i not in REGIONS["jaw"] and i != BLINK]
    assert np.array_equal(louder.weights[:, others], performance.weights[:, others])
    assert louder.head_rotation == pytest.approx(performance.head_rotation / 2)
    with pytest.raises(ShapeError, match="no region 'ears'"):
        apply_gain(performance, {"ears": 1.0})


def test_calibration_puts_the_resting_face_at_zero_and_keeps_full_expressions():
    performance = talk(30)
    rest, full = slice(50, 60), 200
    performance.weights[rest] = np.linspace(0, 0.4, 52)
    performance.weights[full] = 1.0
    performance.head_rotation[rest] = [0.2, -0.1, 0.05]
    calibrated = calibrate_neutral(performance, range(50, 60))
    assert np.abs(calibrated.weights[rest]).max() < 1e-6
    assert calibrated.weights[full] == pytest.approx(np.ones(52))
    assert np.abs(calibrated.head_rotation[55]).max() < 1e-9
    relative = euler_to_matrix(performance.head_rotation[55]).T @ euler_to_matrix(performance.head_rotation[120])
    assert euler_to_matrix(calibrated.head_rotation[120]) == pytest.approx(relative)
    with pytest.raises(ShapeError, match="at least one"):
        calibrate_neutral(performance, [])
    with pytest.raises(ShapeError, match="0 to 299"):
        calibrate_neutral(performance, [300])


def test_neutral_frames_are_the_calm_ones():
    performance = talk(30)
    performance.weights[140:160] = 0.01
    assert set(find_neutral_frames(performance, 10)) <= set(range(138, 162))


def test_smoothing_takes_jitter_and_leaves_blinks_and_closures():
    clean = talk(30)
    noise = 0.006
    noisy = replace(clean, weights=clean.weights + np.random.default_rng(1).normal(0, noise, clean.weights.shape))
    smoothed = smooth(noisy, 0.5)
    slow = [i for i in range(52) if i not in (BLINK, JAW)]
    assert jitter(smoothed.weights[:, slow]).mean() < 0.25 * jitter(noisy.weights[:, slow]).mean()
    error = np.sqrt(np.mean((smoothed.weights - clean.weights)[:, slow] ** 2))
    assert error < 0.6 * noise
    for column, sign in ((BLINK, 1), (JAW, -1)):
        curve = sign * clean.weights[:, column].astype(float)
        middle = curve[1:-1]
        peaks = 1 + np.flatnonzero((middle > curve[:-2]) & (middle >= curve[2:]) & (middle > np.quantile(curve, 0.97)))
        assert peaks.size >= 3
        lost = sign * (clean.weights[peaks, column] - smoothed.weights[peaks, column])
        assert lost.max() < 4 * noise


def test_smoothing_is_symmetric_in_time_and_bounded():
    values = np.random.default_rng(2).normal(size=(200, 5)).cumsum(0)
    assert smooth_curves(values[::-1], 9)[::-1] == pytest.approx(smooth_curves(values, 9))
    assert (np.abs(smooth_curves(values, 9) - values) <= 4.5 * noise_level(values) + 1e-12).all()
    assert np.array_equal(smooth(talk(30), 0).weights, talk(30).weights)
    constant = np.full((50, 2), 0.3)
    assert smooth_curves(constant, 9) == pytest.approx(constant)
    with pytest.raises(ShapeError, match="strength"):
        smooth(talk(30), 2)


@pytest.mark.parametrize("interpolation", ["linear", "bezier"])
@pytest.mark.parametrize("error", [0.002, 0.01, 0.05])
def test_reduced_keys_stay_within_the_stated_error(interpolation, error):
    performance = talk(60, 20)  # longer than one block of frames
    rng = np.random.default_rng(3)
    values = np.concatenate([performance.weights, rng.normal(0, 0.3, (1200, 3)), rng.normal(0, 0.05, (1200, 2)).cumsum(0)], 1)
    values = values.astype(np.float64)
    curves = reduce_curves(performance.times, values, error, interpolation)
    assert largest_error(performance.times, values, curves) <= error
    assert all((np.diff(curve.times) > 0).all() for curve in curves)
    assert all(np.isin(curve.times, performance.times).all() for curve in curves)
    single = np.array([curve.values.astype(np.float32).astype(np.float64) for curve in curves[:1]])
    assert np.isfinite(single).all()


def test_reduction_on_uneven_frames_and_short_ones():
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(0.01, 0.2, 300))
    values = np.stack([np.sin(times), np.full(300, 0.2), rng.normal(size=300)], 1)
    for interpolation in ("linear", "bezier"):
        curves = reduce_curves(times, values, 0.01, interpolation)
        assert largest_error(times, values, curves) <= 0.01
        assert curves[1].times.size == 1
        for count in (1, 2, 3):
            few = reduce_curves(times[:count], values[:count], 0.01, interpolation)
            assert largest_error(times[:count], values[:count], few) <= 0.01


def test_handles_lie_at_thirds_so_that_time_is_linear_along_a_segment():
    performance = talk(30)
    (curve,) = reduce_curves(performance.times, performance.weights[:, [ARKIT_NAMES.index("jawOpen")]], 0.01)
    third = np.diff(curve.times) / 3
    assert curve.right[:-1, 0] - curve.times[:-1] == pytest.approx(third)
    assert curve.times[1:] - curve.left[1:, 0] == pytest.approx(third)


def test_reduction_saves_keys():
    performance = talk(60)
    assert key_count(performance) < 0.1 * performance.weights.size
    assert key_count(performance) < 0.6 * key_count(performance, "linear")
    with pytest.raises(ShapeError, match="positive error"):
        reduce_curves(performance.times, performance.weights, 0.0)


@pytest.mark.parametrize("extension", [".json", ".csv"])
def test_round_trip_of_arkit_formats(tmp_path, extension):
    performance = clamp(talk(60, 3))
    performance.left_eye_rotation = performance.head_rotation * 0.3
    performance.right_eye_rotation = performance.head_rotation * 0.2
    path = tmp_path / f"a{extension}"
    write_performance(path, performance)
    back = read_performance(path)
    assert back.weights == pytest.approx(performance.weights, abs=2e-7)
    assert back.times == pytest.approx(performance.times, abs=2e-5)
    assert back.fps == 60
    assert back.head_rotation == pytest.approx(performance.head_rotation, abs=1e-7)
    if extension == ".json":
        assert back.right_eye_rotation == pytest.approx(performance.right_eye_rotation, abs=1e-7)
    else:
        assert np.abs(back.left_eye_rotation) == pytest.approx(np.abs(performance.left_eye_rotation), abs=1e-7)
        assert len(path.read_text().splitlines()[0].split(",")) == 63


def test_round_trip_of_flame_parameters(tmp_path):
    rng = np.random.default_rng(5)
    names = ("head_rotation", "neck_rotation", "jaw_rotation", "left_eye_rotation")
    turns = {name: rng.normal(0, 0.3, (40, 3)) for name in names}
    performance = Performance(
        np.arange(40) / 25,
        np.zeros((40, 52)),
        25.0,
        expression=rng.normal(size=(40, 100)).astype(np.float32),
        shape=rng.normal(size=300).astype(np.float32),
        translation=rng.normal(size=(40, 3)),
        static_offset=rng.normal(size=(5023, 3)).astype(np.float32),
        head_model="flame",
        **turns,
    )
    write_performance(tmp_path / "a.npz", performance)
    back = read_performance(tmp_path / "a.npz")
    assert np.array_equal(back.expression, performance.expression)
    assert np.array_equal(back.static_offset, performance.static_offset)
    assert back.fps == 25
    for name in turns:
        assert euler_to_matrix(getattr(back, name)) == pytest.approx(euler_to_matrix(getattr(performance, name)), abs=1e-6)


def test_writing_says_what_is_wrong(tmp_path):
    with pytest.raises(FileFormatError, match=r"'\.bvh'"):
        write_performance(tmp_path / "a.bvh", talk(30, 1))
    with pytest.raises(ShapeError, match="retarget"):
        write_performance(tmp_path / "a.npz", talk(30, 1))
    bad = talk(30, 1)
    bad.weights[3, 3] = np.nan
    with pytest.raises(ShapeError, match="not finite"):
        write_performance(tmp_path / "a.json", bad)
    assert list(tmp_path.iterdir()) == []


class ToyHead:
    """52 shapes of 200 vertices in a mixed basis of 60 components; component 3 also turns the jaw."""

    def __init__(self, seed=6):
        rng = np.random.default_rng(seed)
        self.expression_dirs = rng.normal(0, 0.003, (200, 3, 60))
        self.expression_pose = np.zeros((60, 5, 3))
        self.expression_pose[3, 2, 0] = 0.4
        self.expression_pose[7, 3, 1] = 0.3
        self.arkit_to_expression = np.concatenate([np.eye(52), 0.3 * rng.normal(size=(52, 8))], 1)
        self.arkit_pose = np.zeros((52, 5, 3))
        self.landmarks68, self.shape_count = None, 0


def test_retargeting_to_a_head_and_back_restores_the_weights():
    head, performance = ToyHead(), clamp(talk(30, 4))
    there = to_expression(performance, head)
    assert not there.weights.any()
    assert there.jaw_rotation[:, 0] == pytest.approx(0.4 * performance.weights[:, 3], abs=1e-6)
    back = to_arkit(replace(there, jaw_rotation=None), head)
    assert back.weights == pytest.approx(performance.weights, abs=3e-3)
    assert any("up to 0 %" in w or "up to 1 %" in w for w in back.warnings)


def test_retargeting_on_the_open_head():
    from grmm_core.head import arkit_gain, load_open_head

    head, performance = load_open_head(), clamp(talk(30, 2))
    there = to_expression(performance, head)
    frame = 17
    direct = head.vertices(np.zeros(0), there.expression[frame], np.zeros((5, 3)))
    shapes = performance.weights[frame] * arkit_gain(head, np.zeros(0)) @ head.arkit_to_expression
    assert direct == pytest.approx(head.vertices(np.zeros(0), shapes, np.zeros((5, 3))), abs=1e-6)
    assert there.jaw_rotation[:, 0].max() > 0.05, "the jaw part of jawOpen is carried by the joint"
    back = to_arkit(replace(there, jaw_rotation=None), head)
    moved = (back.weights - performance.weights) @ head.arkit_to_expression
    assert np.abs(np.einsum("te,vce->tvc", moved[::10], head.expression_dirs)).max() < 2e-4  # metres


def test_bounded_least_squares_matches_an_independent_solver():
    rng = np.random.default_rng(7)
    basis = rng.normal(size=(12, 30))
    wanted = rng.normal(0, 1.5, (9, 12)) @ basis
    ours = bounded_least_squares(basis @ basis.T, wanted @ basis.T)
    for row, target in zip(ours, wanted, strict=True):
        theirs = optimize.lsq_linear(basis.T, target, (0, 1)).x
        assert row == pytest.approx(theirs, abs=2e-3)


@pytest.mark.slow
def test_ten_minutes_at_sixty_frames_per_second_are_read_cleaned_and_reduced(tmp_path):
    part = talk(60, 60)
    long = Performance(np.arange(36000) / 60, np.tile(part.weights, (10, 1)), 60, recorded_shapes=ARKIT_NAMES)
    long.weights += np.random.default_rng(11).normal(0, 0.002, long.weights.shape).astype(np.float32)
    write_performance(tmp_path / "a.csv", long)
    seen = []
    performance = read_performance(tmp_path / "a.csv", progress=seen.append)
    performance = calibrate_neutral(performance, find_neutral_frames(performance))
    performance = resample(smooth(performance), 24)
    curves = reduce_curves(performance.times, performance.weights, 0.01, progress=seen.append)
    assert len(curves) == 52
    assert len(seen) > 10
