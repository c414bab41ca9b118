"""Beyond the paper: its rules and those of today on three problems, epochs and seconds to a given error."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad import optim
from ikgrad.kinematics import forward_kinematics
from ikgrad.networks import MLP, MinMax
from ikgrad.papers.puma.path import path_data
from ikgrad.robot import load_robot
from ikgrad.training import Batches, Training

SEEDS = 3
SECONDS = 15.0  # for each rule and stack of networks
Progress = Callable[[str, int, int], None]
Parameters = Iterable[torch.nn.Parameter]


@dataclass(frozen=True)
class Problem:
    """Patterns, scaled to [0, 1], and the error to be reached.

    Attributes:
        title: what it is.
        x: (N, inputs) training inputs.
        y: (N, outputs) training targets.
        test: inputs and targets to judge by.
        hidden: logistic units.
        target_percent: root mean square error, in percent of a joint's range.
    """

    title: str
    x: Tensor
    y: Tensor
    test: tuple[Tensor, Tensor]
    hidden: int
    target_percent: float


@dataclass(frozen=True)
class Contender:
    """A rule and how it is used.

    Attributes:
        name: shown in the table.
        make: parameters and number of patterns -> optimizer.
        batch_size: patterns a step; None: all.
        shuffle: a new random order every epoch.
        stacked: whether the networks may learn in one stack; a line search must have each for itself.
    """

    name: str
    make: Callable[[Parameters, int], torch.optim.Optimizer]
    batch_size: int | None = None
    shuffle: bool = False
    stacked: bool = True


@dataclass(frozen=True)
class RaceRow:
    """How a rule did on a problem.

    Attributes:
        rule: its name.
        stacked: "at once" or "one by one".
        seeds: networks.
        reached: networks that came to the error.
        epochs: the median network's epochs to it; None unless half of them came there.
        seconds: wall time of all networks together until then.
        final_percent: the median error at the end.
        total_epochs: of the run.
        total_seconds: of the run.
    """

    rule: str
    stacked: str
    seeds: int
    reached: int
    epochs: float | None
    seconds: float | None
    final_percent: float
    total_epochs: int
    total_seconds: float


@dataclass(frozen=True)
class Race:
    """All rules on one problem."""

    title: str
    target_percent: float
    rows: tuple[RaceRow, ...]


# Rates by trial on (b) and (c), 6 s each: per pattern 0.05, 0.2, 0.5, the latter two alike; for the sum over n patterns
# k / n with k = 0.45 (the paper's rate on its nine poses), 2, 5, 20, 50; Adam 0.001, 0.003, 0.01, 0.03.
CONTENDERS = (
    Contender("OBP", lambda p, n: optim.Backprop(p, 0.2, momentum=0.5), batch_size=1),
    Contender("OBPR", lambda p, n: optim.Backprop(p, 0.2, momentum=0.5), batch_size=1, shuffle=True),
    Contender("BBP", lambda p, n: optim.Backprop(p, 5.0 / n, momentum=0.5)),
    Contender("DBD", lambda p, n: optim.DeltaBarDelta(p, 0.45 / n, kappa=0.09 / n, momentum=0.5)),
    Contender("QP", lambda p, n: optim.Quickprop(p, 0.45 / n)),
    Contender("Rprop", lambda p, n: torch.optim.Rprop(p, 0.01)),
    Contender("Adam, batches of 64", lambda p, n: torch.optim.Adam(p, 0.03), batch_size=64, shuffle=True),
    Contender(
        "L-BFGS",
        lambda p, n: torch.optim.LBFGS(p, max_iter=20, history_size=20, line_search_fn="strong_wolfe"),
        stacked=False,
    ),
    Contender("Levenberg-Marquardt", lambda p, n: optim.LevenbergMarquardt(p, members=SEEDS)),
)


def run_races(progress: Progress | None = None, *, seconds: float = SECONDS) -> tuple[Race, ...]:
    """Every contender on every problem, at most so many seconds each.

    Args:
        progress: called as ``progress(label, done, total)`` after every run.
        seconds: limit of a run.
    """
    problems = (nine_poses(), puma_branch(), four_joint_arm())
    total, done = len(problems) * len(CONTENDERS), 0
    races = []
    for problem in problems:
        rows = []
        for contender in CONTENDERS:
            if progress is not None:
                progress(f"races: {contender.name}", done, total)
            rows.append(_run(problem, contender, seconds))
            done += 1
        races.append(Race(problem.title, problem.target_percent, tuple(rows)))
    return tuple(races)


def nine_poses() -> Problem:
    """(a) The path of the paper, corrected; judged on the nine poses themselves."""
    data = path_data("corrected")
    x, y = MinMax(3).fit(data.p)(data.p), MinMax(6).fit(data.q)(data.q)
    return Problem("(a) nine poses of the path, 3-10-6", x, y, (x, y), hidden=10, target_percent=0.5)


def puma_branch() -> Problem:
    """(b) 2,000 poses of one branch of the PUMA 560 (left shoulder, elbow up, no flip); 500 unseen ones to judge by."""
    centre = torch.tensor([35.0, -45.0, 165.0, 0.0, 60.0, 35.0], dtype=torch.float64)
    return _box("puma560", centre, half_width=30.0, title="(b) 2,000 poses of a PUMA's branch, 12-20-6", target=4.0)


def four_joint_arm() -> Problem:
    """(c) The 4-DOF arm about the middle of its paper's destinations; the same numbers of poses."""
    centre = torch.tensor([45.0, 25.0, 25.0, 25.0], dtype=torch.float64)
    return _box("arm4", centre, half_width=20.0, title="(c) 2,000 poses of the 4-DOF arm, 12-20-4", target=5.0)


def _box(robot: str, centre_deg: Tensor, *, half_width: float, title: str, target: float) -> Problem:
    """Joints uniform in a box, all on one branch of solutions; position and rotation matrix as inputs."""
    generator = torch.Generator().manual_seed(0)
    share = torch.rand(2500, len(centre_deg), dtype=torch.float64, generator=generator)  # the targets, scaled to [0, 1]
    T = forward_kinematics(load_robot(robot), (centre_deg + half_width * (2.0 * share - 1.0)).deg2rad())
    features = torch.cat([T[:, :3, 3], T[:, :3, :3].flatten(1)], -1)
    x = MinMax(12).fit(features[:2000])(features)
    return Problem(title, x[:2000], share[:2000], (x[2000:], share[2000:]), hidden=20, target_percent=target)


def _run(problem: Problem, contender: Contender, seconds: float) -> RaceRow:
    groups = [list(range(SEEDS))] if contender.stacked else [[seed] for seed in range(SEEDS)]
    runs = [_Run(problem, contender, group, seconds / len(groups)) for group in groups]
    error = torch.cat([run.final for run in runs])
    epochs = torch.cat([run.epochs_to_target for run in runs])
    reached = epochs.isfinite()
    half = 2 * int(reached.sum()) > SEEDS
    if contender.stacked:
        spent = runs[0].seconds_to_target.median().item()
    else:
        spent = sum(run.seconds_to_target.item() for run in runs)
    return RaceRow(
        contender.name,
        "at once" if contender.stacked else "one by one",
        SEEDS,
        int(reached.sum()),
        epochs.median().item() if half else None,
        spent if half and spent < torch.inf else None,
        error.median().item(),
        sum(run.epochs for run in runs) // len(runs),
        sum(run.seconds for run in runs),
    )


class _Run:
    """A stack of networks trained until all reach the error, or time is up."""

    def __init__(self, problem: Problem, contender: Contender, seeds: Sequence[int], seconds: float):
        members = len(seeds)
        sizes = (problem.x.shape[-1], problem.hidden, problem.y.shape[-1])
        network = MLP(sizes, hidden="logistic", output="logistic", members=members, seeds=seeds, bound=0.5)
        orders = [10_000 + seed for seed in seeds] if contender.shuffle else None
        x, y = (data.expand(members, *data.shape) for data in (problem.x, problem.y))
        data = Batches(x.contiguous(), y.contiguous(), batch_size=contender.batch_size, shuffle=orders)
        optimizer = contender.make(network.parameters(), len(problem.x))
        self.training = Training(network, optimizer, data)
        self.test = Batches(*(data.expand(members, *data.shape).contiguous() for data in problem.test))
        self.target = problem.target_percent
        self.epochs_to_target = torch.full((members,), torch.inf)
        self.seconds_to_target = torch.full((members,), torch.inf)
        self.seconds = 0.0
        self.final = torch.full((members,), torch.inf)
        self._race(seconds)

    @property
    def epochs(self) -> int:
        """Passes over the data; a line search makes several a step."""
        for state in self.training.optimizer.state.values():
            return int(state.get("func_evals", self.training.epoch))
        return self.training.epoch

    def _race(self, limit: float) -> None:
        while self.seconds < limit and not self.epochs_to_target.isfinite().all():
            start = time.perf_counter()
            more = max(1, self.training.epoch // 20)  # epochs to the target are known within 5 %
            self.training.run(self.training.epoch + more, record=())
            self.seconds += time.perf_counter() - start
            self.final = 100.0 * self.training.mean_squared_error(self.test).sqrt()
            new = (self.final <= self.target) & self.epochs_to_target.isinf()
            self.epochs_to_target[new] = float(self.epochs)
            self.seconds_to_target[new] = self.seconds


__all__ = ["Race", "RaceRow", "run_races"]
