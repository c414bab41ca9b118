"""Largest and smallest values of polynomials on [0, 1], batched, to rounding.

The roots of a polynomial lie between those of its derivative, at most one in each gap. So from the highest derivative
down, every gap is halved until Newton's rule is safe; no root is missed and none has to be guessed. A gap without a
change of sign ends at one of its own ends, which does no harm: the value there is a value of the polynomial.
"""

from __future__ import annotations

import torch
from torch import Tensor

# A place that is wrong by e costs e^2 of the curvature. 2^-16 is a start from which three Newton steps reach rounding;
# where two roots nearly meet and Newton is slow, slope and curvature are so small that e^3 counts, 4e-15 at once.
_HALVINGS, _NEWTON_STEPS = 16, 3


def extremes(coefficients: Tensor) -> tuple[Tensor, Tensor]:
    """Smallest and largest value on [0, 1].

    Gradients are exact: where the extremum lies inside, the slope vanishes, and so does what its place contributes.

    Args:
        coefficients: (..., d + 1) ascending powers, float64.

    Returns:
        (...) and (...)

    Example:
        >>> import torch
        >>> extremes(torch.tensor([0.0, 1.0, -1.0]).double())  # u - u^2
        (tensor(0., dtype=torch.float64), tensor(0.2500, dtype=torch.float64))
    """
    values = polynomial(coefficients, _candidates(coefficients.detach()))
    return values.amin(dim=-1), values.amax(dim=-1)


def polynomial(coefficients: Tensor, u: Tensor) -> Tensor:
    """Horner's rule: (..., d + 1) ascending at (..., k) places."""
    value = coefficients[..., -1:] + torch.zeros_like(u)
    for c in reversed(coefficients[..., :-1].unbind(-1)):
        value = torch.addcmul(c[..., None], value, u)
    return value


def derivative(coefficients: Tensor) -> Tensor:
    """(..., d) coefficients of the derivative, ascending."""
    return coefficients[..., 1:] * torch.arange(1, coefficients.shape[-1]).to(coefficients)


@torch.no_grad()
def _candidates(coefficients: Tensor) -> Tensor:
    """(..., d + 1) places in rising order, 0 and 1 among them, with every place where the slope changes its sign."""
    slopes = [coefficients]
    while slopes[-1].shape[-1] > 2:
        slopes.append(derivative(slopes[-1]))
    ends = torch.tensor([0.0, 1.0]).to(coefficients).expand(*coefficients.shape[:-1], 2)
    places = ends
    for slope in reversed(slopes[1:]):
        roots = _roots(slope, places[..., :-1], places[..., 1:])
        places = torch.cat([ends[..., :1], roots, ends[..., 1:]], dim=-1)
    return places


def _roots(coefficients: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """The root in every gap (low, high), or one of its ends if the sign does not change."""
    linear = coefficients.shape[-1] == 2  # Newton's first step is exact
    if not linear:
        low, high = _halve(coefficients, low, high)
    root, tangent = (low + high) / 2, derivative(coefficients)
    for _ in range(1 if linear else _NEWTON_STEPS):
        rise = polynomial(tangent, root)
        step = polynomial(coefficients, root) / torch.where(rise == 0, torch.ones_like(rise), rise)
        root = torch.minimum(torch.maximum(root - step, low), high)
    return root


def _halve(coefficients: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Gaps 2^-16 as wide with the change of sign still inside."""
    side = polynomial(coefficients, low) < 0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        before = (polynomial(coefficients, middle) < 0) == side
        low, high = torch.where(before, middle, low), torch.where(before, high, middle)
    return low, high
