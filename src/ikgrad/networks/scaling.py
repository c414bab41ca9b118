"""Scaling of inputs and outputs, kept in the model: a network sees numbers near one, its user sees SI units."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ikgrad.errors import DataError, ShapeError


class MinMax(nn.Module):
    r"""Maps the range of every column of some data to one common range.

    ``s = low + (x - min) (high - low) / (max - min)``. A column that never changes has no range: it goes to ``low`` and
    comes back as its constant, whatever a network says.
    The numbers are buffers: they move with the model and are saved with it.

    Args:
        columns: number of columns; `fit` sets their ranges, which are [0, 1] until then.
        low: where the smallest value goes.
        high: where the largest value goes.
        dtype: of the buffers.

    Example:
        >>> data = torch.tensor([[1.0, 5.0], [3.0, 5.0]])
        >>> scale = MinMax(2, low=-1.0, high=1.0, dtype=torch.float32).fit(data)
        >>> scale(data).tolist()
        [[-1.0, -1.0], [1.0, -1.0]]
        >>> scale.inverse(torch.tensor([0.0, 0.7])).tolist()
        [2.0, 5.0]
    """

    minimum: Tensor
    span: Tensor

    def __init__(self, columns: int, *, low: float = 0.0, high: float = 1.0, dtype: torch.dtype = torch.float64):
        super().__init__()
        if not low < high:
            raise ValueError(f"low must be below high, got {low} and {high}")
        self.low, self.high = low, high
        self.register_buffer("minimum", torch.zeros(columns, dtype=dtype))
        self.register_buffer("span", torch.ones(columns, dtype=dtype))

    @torch.no_grad()
    def fit(self, data: Tensor) -> MinMax:
        """Take the ranges of ``data`` (..., columns), over all rows; returns itself.

        Raises:
            ShapeError: another number of columns.
            DataError: no rows, or a value that is not finite.
        """
        if data.shape[-1:] != self.minimum.shape:
            raise ShapeError(f"data must have shape (..., {len(self.minimum)}), got {tuple(data.shape)}")
        rows = data.reshape(-1, data.shape[-1])
        if len(rows) == 0:
            raise DataError("cannot take the range of no rows")
        if not rows.isfinite().all():
            row, column = (~rows.isfinite()).nonzero()[0].tolist()
            raise DataError(f"row {row}, column {column} is {rows[row, column].item()}; a range needs finite values")
        self.minimum.copy_(rows.amin(0))
        self.span.copy_(rows.amax(0) - rows.amin(0))
        return self

    def forward(self, x: Tensor) -> Tensor:
        """Scaled values, same shape as ``x`` (..., columns)."""
        span = torch.where(self.span > 0.0, self.span, 1.0)
        share = torch.where(self.span > 0.0, (x - self.minimum) / span, 0.0)
        return self.low + share * (self.high - self.low)

    def inverse(self, s: Tensor) -> Tensor:
        """Values in their own units from scaled ones; the same shape."""
        return self.minimum + (s - self.low) * (self.span / (self.high - self.low))


__all__ = ["MinMax"]
