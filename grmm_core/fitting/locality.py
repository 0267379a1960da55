"""L_loc of eq. 20: near the fitted codes the tuned decoders must decode what the frozen ones do (after PTI, Roich et al. 2022).

Called by `decoder_stage`. Imports torch.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from ..model.grmm import GRMM, Attributes
from ..model.inputs import ModelInputs
from .code_stage import CodePrior, Codes
from .objective import decode
from .photo_targets import FitView

LOCALITY_WEIGHT = 0.1  # lambda_loc of eq. 20
LOCALITY_DISTANCE = 0.5
"""Distance of the random codes from the fitted ones: this times the mean distance of two training people in z_id, and times
the mean length of the aligned expressions' codes in z_exp. Half of the codes keep the fitted z_id: other expressions of the
same person."""
LOCALITY_CODES = 8  # drawn once; their frozen attributes are kept


class Locality:
    """L_loc: mean absolute difference of decoded attributes, tuned against frozen, at random codes."""

    def __init__(self, model: GRMM, prior: CodePrior, codes: Codes, view: FitView, seed: int = 0) -> None:
        generator = torch.Generator().manual_seed(seed)
        fitted = codes.inputs(model, view)
        z_exp = fitted.z_exp
        id_distance, exp_distance = code_distances(model, prior)
        self.view = view
        self.bank: list[tuple[ModelInputs[Tensor], Attributes]] = []
        for number in range(LOCALITY_CODES):
            draw_id = torch.randn(len(prior.directions), generator=generator).to(z_exp)
            z_id = codes.z_id if number % 2 else _towards(codes.z_id, prior.code(draw_id), id_distance)
            if model.aligned_codes is None:
                towards = torch.randn(len(z_exp), generator=generator).to(z_exp)
            else:
                pick = torch.randint(len(model.aligned_codes), (1,), generator=generator)
                towards = model.aligned_codes[int(pick)].detach()
            near = replace(fitted, z_id=z_id, z_exp=_towards(z_exp, towards, exp_distance))
            with torch.no_grad():
                self.bank.append((near, decode(model, near, view.camera)))

    def __call__(self, tuned: GRMM, step: int) -> Tensor:
        """The loss at one of the codes, in turn."""
        near, frozen = self.bank[step % len(self.bank)]
        found = decode(tuned, near, self.view.camera)
        pairs = [
            (found.offsets, frozen.offsets), (torch.sigmoid(found.logits), torch.sigmoid(frozen.logits)),
            (found.colors, frozen.colors), (found.features, frozen.features),
        ]  # fmt: skip
        return torch.stack([(a - b).abs().mean() for a, b in pairs if a.numel()]).sum()


def code_distances(model: GRMM, prior: CodePrior) -> tuple[float, float]:
    """Distances in z_id and z_exp at which locality is asked for."""
    spread = (2.0 * prior.directions.square().sum()) ** 0.5  # of two draws, root mean square
    length = 1.0 if model.aligned_codes is None else float(model.aligned_codes.detach().norm(dim=1).mean())
    return LOCALITY_DISTANCE * float(spread), LOCALITY_DISTANCE * length


def _towards(start: Tensor, target: Tensor, distance: float) -> Tensor:
    offset = target - start
    return start + offset * (distance / offset.norm().clamp(min=1e-6))


def tunable_copy(model: GRMM, networks: Sequence[str]) -> GRMM:
    """A model some of whose decoder networks are its own and need gradients; everything else is shared."""
    own = {id(p) for name in networks for p in getattr(model.decoders, name).parameters()}
    memo: dict[int, object] = {id(p): p for p in model.parameters() if id(p) not in own}
    memo |= {id(value): value for value in model.buffers()}
    memo[id(model.head_model)] = model.head_model
    tuned = copy.deepcopy(model, memo)
    for name in networks:
        getattr(tuned.decoders, name).requires_grad_(True)
    return tuned
