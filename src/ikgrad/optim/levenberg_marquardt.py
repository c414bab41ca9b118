"""Levenberg-Marquardt: a damped Gauss-Newton step on the residuals of the whole batch."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.optim.optimizer import ParamsT

from ikgrad.errors import ShapeError, TrainingError
from ikgrad.optim.normal_equations import NormalEquations, normal_equations
from ikgrad.optim.rule import require

_MU_LEAST = 1e-20  # below, a long run of successes would take mu to 0, from where no factor leads back


class LevenbergMarquardt(torch.optim.Optimizer):
    r"""Least squares by damped Gauss-Newton steps; the closure returns the residuals, not their loss.

    With the residuals r of the batch and J = dr/dw, each step solves for d and tries ``w + d``::

        (J^T J + mu I) d = -J^T r
        r^T r falls:  keep w + d, mu <- mu / decrease
        else:         w as it was, bit for bit, mu <- increase mu, solve again, until mu > mu_max

    Small mu is Gauss-Newton, large mu a short step down the gradient. Made for full batches and up to some thousand
    weights: time and memory grow with the square of their number, but J is never held whole.

    Args:
        params: parameters, one group of them, real, of one dtype and on one device. Take float64: J^T J squares the
            condition of J.
        mu: damping at the start, above 0.
        decrease: divides mu after a success, at least 1.
        increase: multiplies mu after a failure, above 1.
        mu_max: a step gives up when mu would exceed it.
        members: S networks stacked along the first dimension of every parameter and of the residuals, each depending
            on its own parameters alone. They are S problems solved side by side, with their own mu, success and end.
            None: one problem.

    Attributes:
        tries: (S,) steps tried in the last call, S = 1 without members.

    Source:
        Levenberg, Quarterly of Applied Mathematics 2 (1944); Marquardt, SIAM Journal 11 (1963); for networks, Hagan
        and Menhaj, Training feedforward networks with the Marquardt algorithm, IEEE Transactions on Neural Networks 5
        (1994). The defaults are the stock settings of MATLAB's fitting tool, which Almusawi, Duelger and Kapucu (2016)
        used.

    Differences:
        Marquardt scales the damping by the diagonal of J^T J; here it is mu I, as in Hagan and Menhaj. The tool also
        stops at a small gradient and on validation: the first is left out because it depends on the units of r, the
        second belongs to the training loop.

    Example:
        >>> t = torch.linspace(0, 1, 50, dtype=torch.float64)
        >>> w = torch.nn.Parameter(torch.tensor([1.0, -1.0], dtype=torch.float64))
        >>> optimizer = LevenbergMarquardt([w])
        >>> for _ in range(8):
        ...     loss = optimizer.step(lambda: w[0] * torch.exp(w[1] * t) - 3 * torch.exp(-2 * t))
        >>> [round(x, 9) for x in w.tolist()]
        [3.0, -2.0]
    """

    wants_residuals = True  # a training loop may ask

    def __init__(
        self,
        params: ParamsT,
        *,
        mu: float = 1e-3,
        decrease: float = 10.0,
        increase: float = 10.0,
        mu_max: float = 1e10,
        members: int | None = None,
    ):
        super().__init__(params, dict(mu=mu, decrease=decrease, increase=increase, mu_max=mu_max, members=members))
        self.tries = torch.zeros(members or 1, dtype=torch.int64)

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Take the one group of parameters; all weights share one system of equations, so there is no second.

        Raises:
            ValueError: a second group, a setting that makes no sense, or parameters that do not fit together.
        """
        if self.param_groups:
            raise ValueError("LevenbergMarquardt takes one group of parameters; they share one system of equations")
        _check_settings({**self.defaults, **param_group})
        super().add_param_group(param_group)
        _check_params(self.param_groups[0]["params"], self.param_groups[0]["members"])

    @property
    def mu(self) -> Tensor:
        """Damping of the next step, (S,) for members, else (); above ``mu_max`` after a step that gave up."""
        mu = self._mu()
        return mu.clone() if self.param_groups[0]["members"] is not None else mu[0].clone()

    @property
    def stopped(self) -> Tensor:
        """Whether the last step gave up and left the weights as they were, (S,) for members, else ()."""
        return self.mu > self.param_groups[0]["mu_max"]

    @torch.no_grad()
    def step(self, closure: Callable[[], Tensor]) -> Tensor:  # type: ignore[override]
        """Move to weights with a smaller sum of squares, or stay.

        A step after one that gave up begins with ``mu_max``.

        Args:
            closure: computes the residuals anew, with a graph: any shape, the batch first (after S, for members). It
                is called once, and once for every try; it has to give the same answer for the same weights. It neither
                squares nor calls ``backward``, and the ``.grad`` of parameters is not touched.

        Returns:
            r^T r at the weights that the step leaves, (S,) for members, else ().

        Raises:
            ShapeError: the residuals are a single number (perhaps a loss), none, complex, or not (S, ...) for members.
            RuntimeError: the residuals do not depend on the parameters, or a gradient is sparse.
            TrainingError: the residuals at the present weights, or their derivatives, are not finite. Of members that
                holds when it is true of all; single ones count as stopped.
        """
        members = self.param_groups[0]["members"]
        params = [p for p in self.param_groups[0]["params"] if p.requires_grad]
        residuals = self._evaluate(closure)
        if not (params and residuals.requires_grad):
            raise RuntimeError("the residuals do not depend on the parameters; compute them with a graph")
        loss = residuals.detach().reshape(members or 1, -1).square().sum(1)
        system = _DampedSystem(normal_equations(residuals, params, members))
        del residuals  # and its graph, before the factorisation needs memory
        usable = loss.isfinite() & system.usable
        if not usable.any():
            raise TrainingError(
                "the residuals or their derivatives are not finite at the present weights, from where no step leads; "
                f"look at the data and the first weights (sum of squares: {loss.max().item():g})"
            )
        loss = self._descend(closure, params, system, loss, usable)
        return loss if members is not None else loss[0]

    def _descend(
        self, closure: Callable[[], Tensor], params: list[Tensor], system: _DampedSystem, loss: Tensor, usable: Tensor
    ) -> Tensor:
        """Try steps, with mu growing, until every problem has had a success or gives up."""
        group, mu = self.param_groups[0], self._mu()
        mu.clamp_(_MU_LEAST, group["mu_max"])
        mu[~usable] = math.inf
        best = [p.clone() for p in params]
        pending = usable
        self.tries = torch.zeros_like(usable, dtype=torch.int64)
        try:
            while pending.any():
                d, solved = system.solve(mu, last=pending & (mu * group["increase"] > group["mu_max"]))
                trying = pending & solved
                self.tries += trying
                better = torch.zeros_like(pending)
                if trying.any():
                    self._assign(params, [b + x for b, x in zip(best, d, strict=True)], trying)
                    r = self._evaluate(closure).detach()
                    new_loss = r.reshape(len(mu), -1).square().sum(1)
                    better = trying & (new_loss < loss)
                    loss = torch.where(better, new_loss, loss)
                    self._assign(best, params, better)
                    self._assign(params, best, ~better)
                mu[better] /= group["decrease"]
                pending = pending & ~better
                mu[pending] *= group["increase"]
                pending = pending & (mu <= group["mu_max"])
        finally:
            self._assign(params, best, torch.ones_like(usable))
        return loss

    def _assign(self, targets: list[Tensor], sources: list[Tensor], where: Tensor) -> None:
        """Copy, exactly, the sources of those problems for which ``where`` (S,) holds."""
        for target, source in zip(targets, sources, strict=True):
            stacked = self.param_groups[0]["members"] is not None
            mask = where.reshape(-1, *[1] * (target.ndim - 1)) if stacked else where.reshape(())
            target.copy_(torch.where(mask, source, target))

    def _mu(self) -> Tensor:
        """(S,) state; it sits with the first parameter, as in L-BFGS, so that `state_dict` finds it."""
        group = self.param_groups[0]
        first = group["params"][0]
        if "mu" not in self.state[first]:
            self.state[first]["mu"] = first.new_full((group["members"] or 1,), group["mu"], requires_grad=False)
        return self.state[first]["mu"]

    def _evaluate(self, closure: Callable[[], Tensor]) -> Tensor:
        with torch.enable_grad():
            r = closure()
        members = self.param_groups[0]["members"]
        if not isinstance(r, Tensor):
            raise ShapeError(f"the closure must return the residuals as a tensor, got {type(r).__name__}")
        if r.ndim == 0 or r.numel() == 0 or r.is_complex():
            got = f"{'complex ' * r.is_complex()}shape {tuple(r.shape)}"
            raise ShapeError(f"the closure must return the real residuals (N, ...), not their loss; got {got}")
        if members is not None and r.shape[0] != members:
            raise ShapeError(
                f"the residuals of {members} members must have shape ({members}, ...), got {tuple(r.shape)}"
            )
        return r


class _DampedSystem:
    """``(H + mu I) d = -g`` for S problems; H is kept, and one factor beside it."""

    def __init__(self, equations: NormalEquations):
        self.equations = equations
        self.diagonal = equations.matrix.diagonal(dim1=-2, dim2=-1).clone()
        self.factor = torch.empty_like(equations.matrix).mT  # LAPACK wants columns; anything else costs a copy
        self.info = self.diagonal.new_empty(len(self.diagonal), dtype=torch.int32)

    @property
    def usable(self) -> Tensor:
        """(S,) whether all numbers are finite; no entry is larger than the diagonal allows."""
        return self.equations.gradient.isfinite().all(1) & self.diagonal.isfinite().all(1)

    def solve(self, mu: Tensor, *, last: Tensor) -> tuple[list[Tensor], Tensor]:
        """A step for each parameter, and (S,) whether it could be found.

        Rounding can make a nearly singular matrix indefinite, which more damping cures. Where there will be no more,
        ``last`` (S,), the eigenvalues are put right instead; that takes ten times as long.
        """
        H, g = self.equations.matrix, self.equations.gradient
        self.factor.copy_(H)
        self.factor.diagonal(dim1=-2, dim2=-1).add_(mu[:, None])
        torch.linalg.cholesky_ex(self.factor, out=(self.factor, self.info))
        solved = self.info == 0
        d = -torch.cholesky_solve(g.unsqueeze(2), self.factor).squeeze(2)
        for k in (last & ~solved).nonzero().flatten().tolist():
            values, vectors = torch.linalg.eigh(H[k])
            d[k] = -vectors @ (vectors.mT @ g[k] / (values.clamp(min=0.0) + mu[k]))
            solved[k] = True
        return self.equations.split(d), solved


def _check_settings(group: dict[str, Any]) -> None:
    require(0.0 < group["mu"] < math.inf, "mu", group["mu"])
    require(1.0 <= group["decrease"] < math.inf, "decrease", group["decrease"])
    require(1.0 < group["increase"] < math.inf, "increase", group["increase"])
    require(group["mu"] <= group["mu_max"] < math.inf, "mu_max", group["mu_max"])
    members = group["members"]
    require(members is None or (isinstance(members, int) and members >= 1), "members", members)


def _check_params(params: list[Tensor], members: int | None) -> None:
    if any(p.is_complex() for p in params):
        raise ValueError(
            "LevenbergMarquardt does not support complex parameters; optimize their real and imaginary parts"
        )
    kinds = {(p.dtype, p.device) for p in params}
    if len(kinds) > 1:
        raise ValueError(
            f"LevenbergMarquardt needs parameters of one dtype on one device, got {sorted(map(str, kinds))}"
        )
    for p in params:
        if members is not None and p.shape[:1] != (members,):
            raise ValueError(f"parameters of {members} members must have shape ({members}, ...), got {tuple(p.shape)}")
