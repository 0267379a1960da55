"""A constant sparse matrix applied to differentiable dense data.

Interpolation from vertices to texels, and from coarse maps to texels, is linear with fixed weights. Keeping the matrix and
its transpose in compressed rows makes the forward and the backward pass one sparse product each, which on a CPU is several
times faster than gathers whose gradients scatter. Used by `texels` and `decoders`.
"""

from __future__ import annotations

import warnings
from typing import Any

import torch
from torch import Tensor, nn

from .layout import Entries, compressed_rows

with warnings.catch_warnings():
    # Torch says once a process that compressed rows are in beta. Making the first matrix here keeps that from the user.
    warnings.simplefilter("ignore")
    torch.sparse_csr_tensor(torch.tensor([0, 0]), torch.zeros(0, dtype=torch.int64), torch.zeros(0), (1, 1))


class FixedSparse(nn.Module):
    """y = A x with A constant.

    Args:
        entries: Of A.
        shape: Rows and columns of A.
    """

    starts: Tensor
    columns: Tensor
    values: Tensor
    t_starts: Tensor
    t_columns: Tensor
    t_values: Tensor

    def __init__(self, entries: Entries, shape: tuple[int, int]) -> None:
        super().__init__()
        self.shape = shape
        rows, columns, values = entries
        forward, backward = compressed_rows(entries, shape), compressed_rows((columns, rows, values), shape[::-1])
        for prefix, matrix in (("", forward), ("t_", backward)):
            self.register_buffer(f"{prefix}starts", torch.from_numpy(matrix.starts), persistent=False)
            self.register_buffer(f"{prefix}columns", torch.from_numpy(matrix.columns), persistent=False)
            self.register_buffer(f"{prefix}values", torch.from_numpy(matrix.values), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return A x for x [..., columns, C]: [..., rows, C]."""
        forward = (self.starts, self.columns, self.values)
        backward = (self.t_starts, self.t_columns, self.t_values)
        several = x.ndim > 2
        lead, channels = x.shape[:-2], x.shape[-1]
        flat = x.flatten(0, -3).transpose(0, 1).flatten(1) if several else x  # one product for all: [columns, B C]
        result: Tensor = _Apply.apply(flat, forward, backward, self.shape)
        return result.unflatten(1, (-1, channels)).transpose(0, 1).unflatten(0, lead) if several else result


class _Apply(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, matrix: tuple[Tensor, ...], transposed: tuple[Tensor, ...], shape: tuple[int, int]
    ) -> Tensor:
        ctx.transposed = transposed
        ctx.shape = shape
        return _product(matrix, shape, x)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        rows, columns = ctx.shape
        return _product(ctx.transposed, (columns, rows), gradients[0]), None, None, None


def _product(matrix: tuple[Tensor, ...], shape: tuple[int, int], x: Tensor) -> Tensor:
    starts, columns, values = matrix
    sparse = torch.sparse_csr_tensor(starts, columns, values.to(x.dtype), shape, check_invariants=False)
    return sparse @ x.contiguous()
