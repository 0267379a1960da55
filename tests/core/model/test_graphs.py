"""Replayed functions with a stand-in for the capture: what is proven without a graphics card."""

from __future__ import annotations

import pytest
import torch

from grmm_core.compute.graphs import SHAPES_KEPT, Replayed


class Recorder:
    """Captures as CUDA does: replays read the captured inputs and write the captured outputs."""

    def __init__(self):
        self.captures, self.replays = 0, 0

    def __call__(self, function, inputs):
        self.captures += 1
        outputs = function(*inputs)

        def replay():
            self.replays += 1
            for mine, new in zip(outputs, function(*inputs), strict=True):
                mine.copy_(new)

        return replay, outputs


def double_and_sum(x, y):
    return 2 * x, x + y


def test_replays_read_new_inputs_and_give_fresh_tensors():
    recorder = Recorder()
    replayed = Replayed(double_and_sum, recorder, ("cpu",))
    kept = []
    with torch.no_grad():
        for k in range(4):
            x, y = torch.full((3,), float(k)), torch.ones(3)
            kept.append((x, y, replayed(x, y)))
    assert (recorder.captures, recorder.replays) == (1, 4)
    for x, y, outputs in kept:  # later replays must not reach into earlier results
        torch.testing.assert_close(outputs, double_and_sum(x, y))


def test_other_shapes_are_captured_anew_and_old_ones_dropped():
    recorder = Recorder()
    replayed = Replayed(double_and_sum, recorder, ("cpu",))
    with torch.no_grad():
        for _ in range(2):
            for size in range(1, SHAPES_KEPT + 2):
                x = torch.rand(size)
                torch.testing.assert_close(replayed(x, x), double_and_sum(x, x))
    assert recorder.captures == 2 * (SHAPES_KEPT + 1)


def test_what_cannot_be_captured_is_called_plainly_from_then_on():
    calls = []

    def refuse(function, inputs):
        calls.append(1)
        raise RuntimeError("operation not permitted when stream is capturing")

    replayed = Replayed(double_and_sum, refuse, ("cpu",))
    x = torch.rand(3)
    with torch.no_grad():
        for _ in range(3):
            torch.testing.assert_close(replayed(x, x), double_and_sum(x, x))
    assert len(calls) == 1


def test_other_devices_and_gradients_are_left_alone():
    recorder = Recorder()
    x = torch.rand(3)
    with torch.no_grad():
        Replayed(double_and_sum, recorder)(x, x)
    with_gradients = Replayed(double_and_sum, recorder, ("cpu",))
    leaf = x.clone().requires_grad_()
    assert with_gradients(leaf, x)[0].requires_grad
    assert recorder.captures == 0


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_on_a_graphics_card():
    replayed = Replayed(double_and_sum)
    with torch.no_grad():
        for k in range(3):
            x = torch.full((5,), float(k), device="cuda")
            torch.testing.assert_close(replayed(x, x), double_and_sum(x, x))
