"""What may keep a feedback inverter on its path: other data, another form, other losses. One function trains each.

All work on S networks side by side, of one hidden layer, by Levenberg-Marquardt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn

from ikgrad.data import DataSet
from ikgrad.kinematics import forward_kinematics, pose_error
from ikgrad.networks import MLP, Inverter
from ikgrad.optim import LevenbergMarquardt
from ikgrad.papers.denso.arm import TOOL, denso
from ikgrad.papers.denso.networks import Counter, data_digest
from ikgrad.papers.resume import Watch
from ikgrad.training.inverters import InverterTraining
from ikgrad.training.loop import Objective
from ikgrad.training.losses import Loss, joint

INCREASE = 3.0  # of the damping after a failure; the stock 10 needs several times as many epochs
FARTHEST_GUESS = 0.1  # rad; a rollout that is farther off teaches nothing and is started anew


class StepInverter(Inverter):
    """A feedback inverter whose network says by how much to move: ``q = q_current + s_q (MLP)``, s_q without offset."""

    increment = True

    def answer(self, features: Tensor) -> Tensor:
        """(..., n) joint values for `features`."""
        n = self.robot.dof
        return features[..., -n:] + self.output_scale.span / 2 * self.network(self.input_scale(features))


def train(
    inverters: Sequence[Inverter],
    data: Sequence[DataSet],
    epochs: int,
    *,
    loss: Loss = joint,
    count: Counter | None = None,
    checkpoint: Path | None = None,
) -> float:
    """Train inverters side by side and keep the weights that are best on the validation rows.

    Args:
        inverters: S of one make; the scaling is taken from the data.
        data: one data set each.
        epochs: how long.
        loss: what to make small.
        count: called with S after every epoch.
        checkpoint: file that is kept up to date every few seconds and at the end; read first if it exists.

    Returns:
        Seconds that it took.

    Raises:
        DataError: the checkpoint is of other settings, or damaged.
    """
    training = InverterTraining(inverters, data, loss=loss, optimizer=_gentle)
    settings = {
        "inverter": type(inverters[0]).__name__,
        "sizes": list(inverters[0].network.sizes),
        "epochs": epochs,
        "seeds": [each.recipe["seed"] for each in data],
        "data": data_digest(data),
    }
    each = None if count is None else lambda done: count(done * len(data))
    with Watch(training.training, settings, checkpoint, count=each) as watch:
        training.run(epochs, after_epoch=watch)
    training.finish(best=True)
    return watch.seconds


def _gentle(parameters: Sequence[nn.Parameter], members: int) -> LevenbergMarquardt:
    return LevenbergMarquardt(parameters, members=members, increase=INCREASE)


def pose_loss(inverters: Sequence[Inverter]) -> Objective:
    """Errors of the pose instead of the joints, through FK: ``[p - p*; 0.17 m log(R R*^T)]``, all in metres.

    Near a singularity the joints may be wrong where the pose is not; this loss does not pay for it.
    """
    low, half = _output(inverters)

    def residuals(stack: nn.Module, x: Tensor, y: Tensor) -> Tensor:
        with torch.no_grad():
            wanted = forward_kinematics(denso_arm, low + half * (y + 1))
        e = pose_error(forward_kinematics(denso_arm, low + half * (stack(x) + 1)), wanted)
        return torch.cat([e[..., :3], TOOL * e[..., 3:]], dim=-1)

    denso_arm = inverters[0].robot
    return residuals


def increment_loss(inverters: Sequence[Inverter]) -> Objective:
    """Errors of the joints of `StepInverter`."""
    low, half = _output(inverters)
    present = _present(inverters)

    def residuals(stack: nn.Module, x: Tensor, y: Tensor) -> Tensor:
        return present(x) + half * stack(x) - (low + half * (y + 1))

    return residuals


def contraction(weight: float, *, seed: int = 0) -> Loss:
    r"""Errors of the joints, and a price on how much of an error in the present joints comes back in the answer.

    Each row has one more residual a joint, ``weight * (dq_out/dq_current) v``, with one fixed random direction v a
    row, normal with covariance I: the mean of its square is ``weight^2 |dq_out/dq_current|^2`` (Frobenius). So
    ``weight`` is in radians: the size of the errors that shall die out.

    Args:
        weight: [rad].
        seed: of the directions.
    """

    def make(inverters: Sequence[Inverter]) -> Objective:
        low, half = _output(inverters)
        skip, n = bool(getattr(inverters[0], "increment", False)), half.shape[-1]
        span = torch.stack([i.input_scale.span[-n:] for i in inverters])[:, None]
        slope = torch.where(span > 0, 2 / span, 0.0)
        present = _present(inverters) if skip else None

        def residuals(stack: nn.Module, x: Tensor, y: Tensor) -> Tensor:
            assert isinstance(stack, MLP)
            v = torch.randn(x.shape[-2], n, dtype=x.dtype, generator=torch.Generator().manual_seed(seed))
            v = (span > 0) * v
            step = torch.cat([x.new_zeros(*x.shape[:-1], x.shape[-1] - n), slope * v], dim=-1)
            answer, change = tangent(stack, x, step)
            q, turn = half * answer, half * change
            if present is None:
                q = low + half + q
            else:
                q, turn = present(x) + q, v + turn
            return torch.cat([q - (low + half * (y + 1)), weight * turn], dim=-1)

        return residuals

    return make


def tangent(stack: MLP, x: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """The answer of stacked networks, and its derivative in direction v, exact up to rounding.

    A linear layer's derivative is written as the difference of two of its answers, ``L(y + v) - L(y)``. So the graph
    holds linear layers alone, which is the form of which `optim.LevenbergMarquardt` makes J^T J fast.

    Args:
        stack: S networks with hidden layers of tanh and a linear output.
        x: (S, B, inputs)
        v: (S, B, inputs)

    Returns:
        Both (S, B, outputs).
    """
    assert (stack.hidden, stack.output) == ("tanh", "linear")
    last = len(stack.weights) - 1
    for k, (weight, bias) in enumerate(zip(stack.weights, stack.biases, strict=True)):
        z = torch.baddbmm(bias, x, weight)
        v = torch.baddbmm(bias, x + v, weight) - z
        x = z if k == last else z.tanh()
        v = v if k == last else (1 - x.square()) * v
    return x, v


@torch.no_grad()
def add_rollouts(inverters: Sequence[Inverter], data: Sequence[DataSet], steps: int, *, seed: int) -> list[DataSet]:
    """Data sets of a path in which half of the present joints are where the inverters' own answers have led.

    Every row starts from its true present joints, and a random number of ticks along the path, 1 to ``steps``, later
    the joints reached are present joints of the row that is due then. Rows keep their poses, their wanted joints and
    their part. Where a rollout has gone astray, the old present joints stay.

    Args:
        inverters: one for each data set.
        data: in the order of a closed path.
        steps: longest rollout.
        seed: of what is drawn.
    """
    return [
        _with_rollouts(inverter, d, steps, torch.Generator().manual_seed(seed + 1000 * k))
        for k, (inverter, d) in enumerate(zip(inverters, data, strict=True))
    ]


def _with_rollouts(inverter: Inverter, data: DataSet, steps: int, generator: torch.Generator) -> DataSet:
    T, wanted, present = data.samples
    before = wanted.roll(1, 0)  # where the arm should be, when row k is due
    pick = torch.randint(1, 2 * steps + 1, (len(T),), generator=generator)  # one of two rows keeps its present joints
    q, found = before, present.clone()
    for tick in range(1, steps + 1):  # q[k] is where a rollout is that began at row k - tick
        q = inverter(T.roll(1, 0), q.roll(1, 0))
        good = (pick == tick) & ((q - before).abs().amax(-1) < FARTHEST_GUESS)
        found[good] = q[good]
    return replace(data, samples=data.samples._replace(q_current=found))


def _output(inverters: Sequence[Inverter]) -> tuple[Tensor, Tensor]:
    """(S, 1, n) lowest joints of the scale, and half its width."""
    scales = [inverter.output_scale for inverter in inverters]
    low, span = (torch.stack([getattr(s, name) for s in scales])[:, None] for name in ("minimum", "span"))
    return low, span / 2


def _present(inverters: Sequence[Inverter]) -> Callable[[Tensor], Tensor]:
    """Present joints (S, B, n) from scaled inputs."""
    n = inverters[0].robot.dof
    scales = [inverter.input_scale for inverter in inverters]
    low, span = (torch.stack([getattr(s, name)[-n:] for s in scales])[:, None] for name in ("minimum", "span"))
    return lambda x: low + span / 2 * (x[..., -n:] + 1)


def make(kind: type[Inverter], seeds: Sequence[int], hidden: int, *, feedback: bool = True) -> list[Inverter]:
    """Inverters of the arm with one hidden layer, first weights by seed."""
    return [kind(denso(), feedback=feedback, hidden=(hidden,), seed=seed) for seed in seeds]


__all__ = [
    "StepInverter",
    "Loss",
    "add_rollouts",
    "contraction",
    "increment_loss",
    "make",
    "pose_loss",
    "tangent",
    "train",
]
