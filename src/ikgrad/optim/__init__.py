"""Training rules as ordinary `torch.optim.Optimizer` classes: any `nn.Module`, groups, closures, schedulers.

    optimizer = ik.optim.DeltaBarDelta(network.parameters(), lr=0.05)

`LevenbergMarquardt` takes a closure that returns residuals; see there. `Backprop`, `DeltaBarDelta` and `Quickprop` are
the classical rules. Their conventions: every weight is treated by itself, so nothing depends on the shape of a
parameter, and S networks stacked along a leading dimension are trained as S independent ones (sum their losses, do not
average them).
Whether a rule works per pattern, in random order or per batch is up to the data that the gradient was taken of; the
paper's gradient is a *sum* over patterns. Equation numbers are those of Yildirim and Eski, "A OP Artificial Neural
Network Inverse Kinematic Solution for Accurate Robot Path Control" (2006). g is dE/dw, dw a change of a weight.
"""

from __future__ import annotations

from ikgrad.optim.backprop import Backprop
from ikgrad.optim.delta_bar_delta import DeltaBarDelta
from ikgrad.optim.levenberg_marquardt import LevenbergMarquardt
from ikgrad.optim.quickprop import Quickprop

__all__ = ["Backprop", "DeltaBarDelta", "LevenbergMarquardt", "Quickprop"]
