"""Settings of inverters that learn from an endless stream of samples."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

from ikgrad.config.loading import require
from ikgrad.config.settings import TrainingSettings

_OF_UNROLLED = ("rounds", "damping")


@dataclasses.dataclass(frozen=True)
class StreamConfig(TrainingSettings):
    """An inverter that starts from the present joints, and how it learns, ``configs/inverter.yaml``.

    Attributes:
        robot: built-in name, or path of a URDF file.
        base: link in which poses are given; null: the root link.
        tip: link whose pose is meant; null: the only leaf link.
        model: unrolled: damped steps of the chain's own Jacobian, corrected by a network; increment: a plain network;
            classic: a network with settings of its own, see TrainConfig.
        width: units of each hidden layer; null: 128 for unrolled, 160 for increment.
        depth: hidden layers; null: 2 for unrolled, 4 for increment.
        activation: of the hidden layers: gelu, silu, relu, tanh, logistic or linear.
        rounds: of unrolled, each one damped step and one correction; null: 4.
        damping: of the steps of unrolled; null: 0.1.
        spread: how far targets lie from the present joints, rad a joint (slides: times a typical length of the arm);
            null: anywhere in the limits.
        labels: made: the joints that a target was made from; solver: those that Levenberg-Marquardt reaches from the
            present ones. Only joint_weight looks at them.
        pose_weight: of the pose error in the loss; 0: not learned from.
        joint_weight: of the distance to the label in the loss.
        limit_weight: of half the squared distance beyond the limits in the loss.
        loss_shape: of the pose error: square, root or log; null: log for unrolled, root for increment.
        loss_delta: pose error below which the loss is flat, in rad or typical lengths; null: 0.001 for log, else 0.02.
        minutes: of training, each member.
        steps: of the optimizer, in the place of minutes.
        batch_size: rows a step, over all processes.
        lr: largest learning rate.
        checks: points of the curve.
        seed: of the first weights and of the samples.
        members: inverters, with seeds of their own from 'seed' on, one after the other.
        test_rows: fresh rows that the command measures the result on.
        device: cpu, cuda or cuda:1; samples are made on the CPU always.
        threads: of each process on the CPU; null: as torch is set.
        tensorboard: also write events for TensorBoard.
    """

    robot: str = ""
    base: str | None = None
    tip: str | None = None
    model: Literal["unrolled", "increment"] = "unrolled"
    width: int | None = None
    depth: int | None = None
    activation: str = "gelu"
    rounds: int | None = None
    damping: float | None = None
    spread: float | None = 0.5
    labels: Literal["made", "solver"] = "made"
    pose_weight: float = 1.0
    joint_weight: float = 0.0
    limit_weight: float = 0.5
    loss_shape: Literal["square", "root", "log"] | None = None
    loss_delta: float | None = None
    minutes: float = 15.0
    steps: int | None = None
    batch_size: int = 1024
    lr: float = 0.016
    checks: int = 40
    seed: int = 0
    members: int = 1
    test_rows: int = 20_000
    device: str = "cpu"
    threads: int | None = None
    tensorboard: bool = False

    def __post_init__(self) -> None:
        counts = ("width", "depth", "rounds", "steps", "batch_size", "checks", "test_rows", "threads")
        positive = ("damping", "spread", "loss_delta", "minutes", "lr")
        self._check_shared(counts=counts, positive=positive, seeds_end=2**30 - 1, end_says="2^30 - 2")
        for key in ("pose_weight", "joint_weight", "limit_weight"):
            value = getattr(self, key)
            require(0 <= value < float("inf"), key, "must be a finite weight, 0 or more", value)
        learns = self.pose_weight > 0 or self.joint_weight > 0
        require(
            learns, "pose_weight", "and joint_weight must not both be 0: there is nothing to learn", self.pose_weight
        )
        for key in _OF_UNROLLED:
            value = getattr(self, key)
            require(self.model == "unrolled" or value is None, key, "belongs to model unrolled", value)

    def shape(self) -> dict[str, Any]:
        """Arguments of the inverter that differ from its own defaults."""
        given = {key: getattr(self, key) for key in ("width", "depth", "activation", *_OF_UNROLLED)}
        return {key: value for key, value in given.items() if value is not None}


__all__ = ["StreamConfig"]
