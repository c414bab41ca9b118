"""Settings of the papers' studies: flat frozen dataclasses, one a command of ``ikgrad reproduce``."""

from __future__ import annotations

import dataclasses
from typing import Literal

from ikgrad.config.loading import require


@dataclasses.dataclass(frozen=True)
class AppsConfig:
    """Settings of the KR 210 study, ``ikgrad reproduce apps``.

    Attributes:
        preset: settings of the seven motions: ``"reproduces"`` gives the paper's tables, ``"printed"`` is what the
            paper says it used.
        tol_pos: a pose counts as reached below this position error [m].
        tol_rot: and below this rotation error [rad].
        newton_max_steps: step limit of Newton-Raphson.
        learning_rates: the learning rates compared, on the plain sum of squares.
        learning_rate_max_steps: step limit of that comparison.
        random_starts: pairs of a random start and a random reachable pose; 0 leaves that part out.
        random_max_steps: step limit of APPS there.
        seed: seed of these pairs.
    """

    preset: Literal["reproduces", "printed"] = "reproduces"
    tol_pos: float = 1e-4
    tol_rot: float = 1e-4
    newton_max_steps: int = 100
    learning_rates: tuple[float, ...] = (1.0, 0.5, 0.1, 0.05, 0.01)
    learning_rate_max_steps: int = 6000
    random_starts: int = 1000
    random_max_steps: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        for key in ("tol_pos", "tol_rot", "newton_max_steps", "learning_rate_max_steps", "random_max_steps"):
            require(getattr(self, key) > 0, key, "must be positive", getattr(self, key))
        require(self.random_starts >= 0, "random_starts", "must not be negative", self.random_starts)
        require(self.seed >= 0, "seed", "must not be negative", self.seed)
        good = len(self.learning_rates) > 0 and min(self.learning_rates) > 0
        require(good, "learning_rates", "must be one or more positive numbers", list(self.learning_rates))


@dataclasses.dataclass(frozen=True)
class RuleConfig:
    """A training rule of the PUMA 560 study and the network that it trains, ``configs/puma_*.yaml``.

    Attributes:
        name: shown in tables.
        rule: which optimizer of `ikgrad.optim`.
        order: a step after every pattern, in ``fixed`` or in ``random`` order, or one step an epoch for the whole
            ``batch``.
        lr: eta.
        momentum: alpha; quickprop has none.
        kappa: of delta-bar-delta, what a rate gains in a step.
        phi: of delta-bar-delta, what part a rate loses.
        theta: of delta-bar-delta, memory of the trace.
        mu: of quickprop, largest growth of a step.
        max_step: of quickprop, cap on the change of a weight.
        literal: quickprop as eq. (58) is printed.
        hidden: units of each hidden layer.
        activation: of the hidden layers.
        output: activation of the last layer.
        low: where the smallest value of an input or output column goes.
        high: where the largest goes.
        bound: first weights are uniform in +-bound.
    """

    name: str = "OBP"
    rule: Literal["backprop", "delta_bar_delta", "quickprop"] = "backprop"
    order: Literal["fixed", "random", "batch"] = "fixed"
    lr: float = 0.05
    momentum: float = 0.0
    kappa: float = 0.01
    phi: float = 0.1
    theta: float = 0.7
    mu: float = 1.75
    max_step: float = 0.1
    literal: bool = False
    hidden: tuple[int, ...] = (10,)
    activation: str = "logistic"
    output: str = "logistic"
    low: float = 0.0
    high: float = 1.0
    bound: float = 0.5

    def __post_init__(self) -> None:
        for key in ("lr", "mu", "max_step", "bound"):
            require(getattr(self, key) > 0, key, "must be positive", getattr(self, key))
        for key in ("momentum", "phi", "theta"):
            require(0 <= getattr(self, key) < 1, key, "must be in [0, 1)", getattr(self, key))
        require(self.kappa >= 0, "kappa", "must not be negative", self.kappa)
        good = len(self.hidden) > 0 and min(self.hidden) > 0
        require(good, "hidden", "must be one or more positive numbers", list(self.hidden))
        require(self.low < self.high, "low", f"must be below high, {self.high}", self.low)
        require(
            self.rule != "quickprop" or self.momentum == 0, "momentum", "does not exist in quickprop", self.momentum
        )


@dataclasses.dataclass(frozen=True)
class PumaConfig:
    """Settings of the PUMA 560 study, ``ikgrad reproduce puma``.

    Attributes:
        epochs: of every rule; 111111 are the paper's one million presentations of a pattern, 1000000 its N.
        seeds: networks of every rule, with first weights of their own.
        literal_epochs: of eq. (58) as printed.
        rules: the rules; default: the five of the paper, ``configs/puma_*.yaml``.
    """

    epochs: int = 111_111
    seeds: int = 16
    literal_epochs: int = 2000
    rules: tuple[RuleConfig, ...] = ()

    def __post_init__(self) -> None:
        for key in ("epochs", "seeds", "literal_epochs"):
            require(getattr(self, key) > 0, key, "must be positive", getattr(self, key))
        names = [rule.name for rule in self.rules]
        require(len(set(names)) == len(names), "name", "must differ between the rules", names)


@dataclasses.dataclass(frozen=True)
class DensoConfig:
    """Settings of the Denso VP6242 study, ``ikgrad reproduce denso``.

    Attributes:
        seeds: networks of each kind on the smooth path (scheme B) and in the cube (scheme D).
        traditional_epochs: of the traditional network on the smooth path; 121 is the paper's.
        feedback_epochs: of the feedback network there; 68 is the paper's.
        epochs: of all networks on the other schemes.
        cure_epochs: of every remedy of the closed loop.
        final_epochs: of the network that is recommended for it; 80 and more are judged.
        ticks: of every closed loop; 20000 and more are judged.
        cure_seed: the first seed of the remedies and their paths; another one repeats them with fresh seeds.
    """

    seeds: int = 10
    traditional_epochs: int = 121
    feedback_epochs: int = 68
    epochs: int = 300
    cure_epochs: int = 40
    final_epochs: int = 80
    ticks: int = 20_000
    cure_seed: int = 0

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if key != "cure_seed":
                require(value > 0, key, "must be positive", value)
        require(self.cure_seed >= 0, "cure_seed", "must not be negative", self.cure_seed)


@dataclasses.dataclass(frozen=True)
class TrajectoryConfig:
    """Settings of the 4-DOF trajectory study, ``ikgrad reproduce trajectory``; the paper prints none of them.

    Attributes:
        tf: end time of every trajectory, after the second via at 5 [s].
        seeds: networks of each kind, each with destinations, first weights and an order of patterns of its own.
        destinations: random destinations in a training set.
        hidden: units of the network that answers with the hand.
        joint_hidden: units of those that answer with joint 3 or joint 4.
        epochs: per pattern, of the hand's network.
        joint_epochs: per pattern, of the two others.
        lr: alpha of the per-pattern rule; a tenth of it for the last fifth of the epochs.
        margin: how far beyond the data the range of a logistic output reaches [unit].
        time_range: the time goes to +-this, the angles to +-1.
        lm_epochs: of Levenberg-Marquardt, of the hand's network.
        joint_lm_epochs: of Levenberg-Marquardt, of the two others.
        segments: random segments of the sphere test.
    """

    tf: float = 8.0
    seeds: int = 5
    destinations: int = 60
    hidden: int = 30
    joint_hidden: int = 20
    epochs: int = 10_000
    joint_epochs: int = 4000
    lr: float = 2.0
    margin: float = 2.0
    time_range: float = 4.0
    lm_epochs: int = 400
    joint_lm_epochs: int = 50
    segments: int = 1_000_000

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if key not in ("tf", "margin"):
                require(value > 0, key, "must be positive", value)
        require(5.0 < self.tf < float("inf"), "tf", "must come after the second via at 5 s", self.tf)
        require(self.margin >= 0, "margin", "must not be negative", self.margin)


__all__ = ["AppsConfig", "DensoConfig", "PumaConfig", "RuleConfig", "TrajectoryConfig"]
