"""Every rule on every small problem with a known minimum: the loss falls and the minimum is reached."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from ikgrad.optim import Backprop, DeltaBarDelta, LevenbergMarquardt, Quickprop


def vector(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def bowl(w: Tensor) -> Tensor:
    return w - vector(1.0, -2.0, 3.0)


def valley(w: Tensor) -> Tensor:
    """Quadratic with condition number 100 along the axes."""
    return vector(100.0, 10.0, 1.0).sqrt() * w


def tilted_valley(w: Tensor) -> Tensor:
    """Condition number 20, turned by 45 degrees: harder for rules that treat each weight by itself."""
    return torch.stack([math.sqrt(20.0) * (w[0] - w[1]), w[0] + w[1] - 2.0])


def rosenbrock(w: Tensor) -> Tensor:
    return math.sqrt(2.0) * torch.stack([1.0 - w[0], 10.0 * (w[1] - w[0].square())])


def logistic_regression(w: Tensor) -> Tensor:
    """Yes in one case of four at x = -1 and in three of four at x = +1; the minimum is at (0, ln 3).

    A cross entropy is no square, but positive, so that its root can stand for a residual.
    """
    x = vector(-1, -1, -1, -1, 1, 1, 1, 1)
    yes = vector(1, 0, 0, 0, 1, 1, 1, 0)
    return (2.0 * torch.nn.functional.binary_cross_entropy_with_logits(w[0] + w[1] * x, yes, reduction="none")).sqrt()


def xor(w: Tensor) -> Tensor:
    """A 2-4-1 logistic network, its 17 weights in one vector."""
    x, y = torch.tensor([[0, 0], [0, 1], [1, 0], [1, 1]]).double(), torch.tensor([[0], [1], [1], [0]]).double()
    hidden = torch.sigmoid(x @ w[:8].reshape(2, 4) + w[8:12])
    return torch.sigmoid(hidden @ w[12:16, None] + w[16]) - y


@dataclass(frozen=True)
class Problem:
    """Half a sum of squares: where it starts and ends, the rate that suits its curvature, how close it must come."""

    residuals: Callable[[Tensor], Tensor]
    start: Tensor
    lr: float
    steps: int
    least: float = 0.0
    place: Tensor | None = None
    tol: float = 1e-12

    def loss(self, w: Tensor) -> Tensor:
        return 0.5 * self.residuals(w).square().sum()


PROBLEMS = [
    # On quadratics 1e-12 is reached by hundreds of steps of linear convergence; the place is then known to 1e-6.
    Problem(bowl, vector(0, 0, 0), 0.2, 300, place=vector(1, -2, 3)),
    Problem(valley, vector(1, 1, 1), 0.01, 300, place=vector(0, 0, 0)),
    Problem(tilted_valley, vector(-1, 2), 0.02, 300, place=vector(1, 1)),
    # The curved valley has a condition number of 2500 at its end; first-order rules creep.
    Problem(rosenbrock, vector(-1.2, 1), 0.0005, 10_000, place=vector(1, 1), tol=1e-4),
    # The least loss, 4 (2 ln 4 - 1.5 ln 3) = 4.5, is known to rounding: 1e-12 is ten times that.
    Problem(logistic_regression, vector(0.5, -1), 0.2, 300, 8 * math.log(4) - 6 * math.log(3), vector(0, math.log(3))),
    # The minimum lies at infinite weights; 1e-3 means that every answer is within 0.05 of 0 or 1.
    Problem(xor, torch.linspace(-1, 1, 17).double().sin() * vector(*[1, -0.5] * 8, 1), 1.0, 3000, tol=1e-3),
]

# kappa goes with lr: the rate may double in twenty steps. The cap of Quickprop is in units of the weights.
RULES = {
    "backprop": lambda p, lr: Backprop(p, lr, momentum=0.8),
    "delta-bar-delta": lambda p, lr: DeltaBarDelta(p, lr / 2, kappa=lr / 20, phi=0.3),
    "quickprop": lambda p, lr: Quickprop(p, lr / 2),
    "levenberg-marquardt": lambda p, lr: LevenbergMarquardt(p),  # damping finds its own rate
}


def train(problem: Problem, rule: Callable[..., torch.optim.Optimizer]) -> Tensor:
    w = torch.nn.Parameter(problem.start.clone())
    optimizer = rule([w], problem.lr)
    for _ in range(problem.steps):
        if getattr(optimizer, "wants_residuals", False):
            optimizer.step(lambda: problem.residuals(w))
            continue
        optimizer.zero_grad()
        problem.loss(w).backward()
        optimizer.step()
    return w.detach()


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES.keys())
@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda p: p.residuals.__name__)
def test_the_minimum_is_reached(problem: Problem, rule: Callable[..., torch.optim.Optimizer]):
    w = train(problem, rule)
    assert problem.least < problem.loss(problem.start)
    assert abs(problem.loss(w).item() - problem.least) < problem.tol
    if problem.place is not None:  # curvature is at least 0.4 at every minimum, so the place is known to 3 sqrt(tol)
        torch.testing.assert_close(w, problem.place, rtol=0.0, atol=3.0 * math.sqrt(problem.tol))


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES.keys())
@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda p: p.residuals.__name__)
def test_the_loss_falls_from_the_first_steps(problem: Problem, rule: Callable[..., torch.optim.Optimizer]):
    few = Problem(problem.residuals, problem.start, problem.lr, 5)
    assert problem.loss(train(few, rule)) < problem.loss(problem.start)
