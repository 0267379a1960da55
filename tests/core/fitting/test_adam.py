"""Fitting's own Adam against torch's, and what it is for."""

from __future__ import annotations

import subprocess
import sys

import torch

from grmm_core.fitting.adam import Adam

IMPORTS_NO_COMPILER = """
import sys, torch
from grmm_core.fitting.adam import Adam
value = torch.ones(3, requires_grad=True)
adam = Adam([{"params": [value], "lr": 0.1}])
value.sum().backward()
adam.step()
sys.exit("torch._dynamo" in sys.modules)
"""


def test_steps_are_torchs_to_the_last_bit():
    generator = torch.Generator().manual_seed(0)
    ours, theirs = (torch.linspace(-1, 1, 12).reshape(4, 3).requires_grad_() for _ in range(2))
    still = torch.ones(2, requires_grad=True)
    settings = {"betas": (0.9, 0.98), "eps": 1e-12}
    adam = Adam([{"params": [ours, still], "lr": 0.01, "peak": 0.01}], **settings)
    reference = torch.optim.Adam([{"params": [theirs], "lr": 0.01}], **settings)
    for turn in range(6):
        gradient = torch.randn(4, 3, generator=generator) * 10.0**-turn
        for parameter, optimiser in ((ours, adam), (theirs, reference)):
            optimiser.zero_grad()
            parameter.grad = gradient.clone()
            optimiser.param_groups[0]["lr"] = 0.01 / (turn + 1)
            optimiser.step()
    assert torch.equal(ours, theirs)
    assert set(adam.state[ours]) == {"step", "exp_avg", "exp_avg_sq"}
    assert still not in adam.state
    assert torch.equal(still, torch.ones(2))


def test_a_step_imports_no_compiler():
    assert subprocess.run([sys.executable, "-c", IMPORTS_NO_COMPILER], timeout=120).returncode == 0
