"""A constant sparse matrix applied to differentiable dense data.

Interpolation from vertices to texels, and from coarse maps to texels, is linear with fixed weights. Keeping the matrix and
its transpose in compressed rows makes the forward and the backward pass one sparse product each, which on a CPU is several
times faster than gathers whose gradients scatter. Used by `texels` and `decoders`.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

with warnings.catch_warnings():
    # Torch says once a process that compressed rows are in beta. Making the first matrix here keeps that from the user.
    warnings.simplefilter("ignore")
    torch.sparse_csr_tensor(torch.tensor([0, 0]), torch.zeros(0, dtype=torch.int64), torch.zeros(0), (1, 1))


class FixedSparse(nn.Module):
    """y = A x with A constant.

    Args:
        rows, columns: Positions of the entries, [E]; repeated positions add up.
        values: Entries, [E].
        shape: Rows and columns of A.
    """

    def __init__(self, rows: np.ndarray, columns: np.ndarray, values: np.ndarray, shape: tuple[int, int]) -> None:
        super().__init__()
        self.shape = shape
        rows, columns, values = _merge(rows, columns, values, shape)
        for prefix, (r, c, v), count in (
            ("", (rows, columns, values), shape[0]),
            ("t_", _by_row(columns, rows, values), shape[1]),
        ):
            starts = np.zeros(count + 1, np.int64)
            np.cumsum(np.bincount(r, minlength=count), out=starts[1:])
            self.register_buffer(f"{prefix}starts", torch.from_numpy(starts.astype(np.int32)), persistent=False)
            self.register_buffer(f"{prefix}columns", torch.from_numpy(c.astype(np.int32)), persistent=False)
            self.register_buffer(f"{prefix}values", torch.from_numpy(v.astype(np.float32)), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return A x for x [columns, C]: [rows, C]."""
        forward = (self.starts, self.columns, self.values)
        backward = (self.t_starts, self.t_columns, self.t_values)
        result: Tensor = _Apply.apply(x, forward, backward, self.shape)
        return result


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


def _by_row(rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    order = np.lexsort((columns, rows))
    return rows[order], columns[order], values[order]


def _merge(
    rows: np.ndarray, columns: np.ndarray, values: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sort by row and column and add up entries at the same position."""
    keys, inverse = np.unique(rows.astype(np.int64) * shape[1] + columns.astype(np.int64), return_inverse=True)
    summed = np.bincount(inverse.reshape(-1), weights=values.astype(np.float64), minlength=len(keys))
    return keys // shape[1], keys % shape[1], summed
