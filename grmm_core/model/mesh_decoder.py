"""Phi_mesh: learned displacements of the mesh's vertices, eq. 5-11.

Used by `grmm` only.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from .config import JOINTS_OF_MESH_DECODER, METRES_PER_MM, GRMMConfig

SLOPE = 0.2  # of the leaky rectifiers, as in the map decoders


class MeshDecoder(nn.Module):
    """Identity and expression displacements of every vertex; exactly zero before training.

    Args:
        config: Sizes.
        z_id, z_exp: Lengths of the codes (they differ from the configuration's without residuals).
        face_mask: M_face, 1 where expression may move a vertex, 0 on teeth, [V].
    """

    def __init__(self, config: GRMMConfig, z_id: int, z_exp: int, face_mask: Tensor) -> None:
        super().__init__()
        hidden, rank, outputs = config.mesh_hidden, config.mesh_rank or config.mesh_hidden, 3 * len(face_mask)
        self.alpha_exp = config.alpha_exp
        self.register_buffer("face_mask", face_mask.to(torch.float32)[:, None], persistent=False)  # [V, 1]
        self.shared = nn.Sequential(
            nn.Linear(z_id + JOINTS_OF_MESH_DECODER, hidden),
            nn.LeakyReLU(SLOPE),
            nn.Linear(hidden, hidden),
            nn.LeakyReLU(SLOPE),
        )
        self.film = nn.Sequential(
            nn.Linear(config.alpha_exp, hidden), nn.LeakyReLU(SLOPE), nn.Linear(hidden, 2 * (hidden + z_exp))
        )
        self.identity = _head(hidden, rank, outputs)
        self.expression = _head(hidden + z_exp, rank, outputs)

    def base(self, z_id: Tensor, neck: Tensor, jaw: Tensor) -> Tensor:
        """f_base of eq. 5 from z_id [..., Z] and axis-angle rotations [..., 3] in radians: [..., hidden]."""
        features: Tensor = self.shared(torch.cat([z_id, neck, jaw], -1))
        return features

    def modulate(self, base: Tensor, z_exp: Tensor, alpha_exp: Tensor) -> Tensor:
        """Feature-wise linear modulation, eq. 7-9.

        Args:
            base: f_base, [..., hidden].
            z_exp: [..., Y].
            alpha_exp: Expression coefficients, [..., E]; the first `config.alpha_exp` are read, missing ones are zero.

        Returns:
            f_exp + gamma * f_exp + beta, [..., hidden + Y].
        """
        features = torch.cat([base, z_exp], -1)  # eq. 7
        missing = self.alpha_exp - alpha_exp.shape[-1]
        alpha_exp = nn.functional.pad(alpha_exp, (0, missing))  # a negative pad crops
        gamma, beta = self.film(alpha_exp).chunk(2, -1)  # eq. 8
        return features + gamma * features + beta  # eq. 9

    def forward(self, z_id: Tensor, z_exp: Tensor, neck: Tensor, jaw: Tensor, alpha_exp: Tensor) -> Tensor:
        """Displacements v_delta_id + M_face v_delta_exp of eq. 6, 10, 11.

        Args:
            z_id: [..., Z].
            z_exp: [..., Y].
            neck: Axis-angle vectors, radians, [..., 3].
            jaw: As `neck`.
            alpha_exp: [..., E].

        Returns:
            [..., V, 3] metres.
        """
        base = self.base(z_id, neck, jaw)
        identity = self.identity(base).unflatten(-1, (-1, 3))  # eq. 6
        expression = self.expression(self.modulate(base, z_exp, alpha_exp)).unflatten(-1, (-1, 3))  # eq. 10
        return (identity + self.face_mask * expression) * METRES_PER_MM  # decoders work in millimetres


def _head(inputs: int, rank: int, outputs: int) -> nn.Sequential:
    last = nn.Linear(rank, outputs)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(inputs, rank), nn.LeakyReLU(SLOPE), last)
