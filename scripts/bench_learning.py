"""What each idea is worth when an inverter learns: joint regression, pose loss, present joints, teacher, solver steps.

    python scripts/bench_learning.py [--robots panda ur5e] [--minutes 2] [--seeds 0 1] [--json FILE] [--picture FILE]

Every stage trains a network of its own for the same time on the local task (targets within 0.5 rad a joint of the
present joints), then answers 20,000 rows of it that no training has seen, raw and after one, two and three damped
steps. The last two rows begin at the present joints, and at four such steps from there, without a network. ``--json``
also keeps what is finished, so that the same command goes on after a stop.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import torch
from torch import Tensor

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.evaluation import measure
from ikgrad.evaluation.table import number
from ikgrad.networks import IncrementInverter, UnrolledInverter
from ikgrad.solvers.damped import damped_steps
from ikgrad.training import EndlessTraining, PoseLoss
from ikgrad.training.endless import LOSSES

TEST_SEED = 2**31 - 1  # no training of this script draws from it
STEPS = (0, 1, 2, 3)


class PoseOnly(IncrementInverter):
    """The same network without the present joints: every increment starts from the middle of the joints' ranges."""

    def iterates(self, T: Tensor, q_current: Tensor) -> list[Tensor]:
        """One answer, the same for all present joints."""
        low, high = self.robot.sampling_range
        return super().iterates(T, ((low + high) / 2).to(q_current).expand_as(q_current))


class JointLoss(PoseLoss):
    """Squared distance to the label, as in plain regression."""

    def __call__(self, robot: ik.Robot, q: Tensor, T: Tensor, label: Tensor | None = None) -> Tensor:
        """Mean over rows."""
        assert label is not None
        return (q - label).square().sum(-1).mean()


@dataclass(frozen=True)
class Stage:
    """A way to learn: the family, where labels come from, the loss."""

    family: Callable[..., IncrementInverter]
    loss: PoseLoss
    label: str = "made"


ROOT, LOG = LOSSES[IncrementInverter], LOSSES[UnrolledInverter]
STAGES = {
    "pose only, joint regression": Stage(PoseOnly, JointLoss()),
    "pose only, pose loss": Stage(PoseOnly, ROOT),
    "present joints, joint regression": Stage(IncrementInverter, JointLoss()),
    "present joints, regression to the solver's": Stage(IncrementInverter, JointLoss(), "solver"),
    "present joints, pose loss": Stage(IncrementInverter, ROOT),
    "four rounds of step and network, pose loss": Stage(UnrolledInverter, LOG),
}
PLAIN = {"no network": 0, "four steps, no network": 4}


def main() -> None:
    """Train what is missing, then print one table a robot."""
    options = _options()
    torch.set_num_threads(1)
    found: dict[str, Any] = {}
    if options.json and Path(options.json).exists():
        found = json.loads(Path(options.json).read_text())
    for name in options.robots:
        robot = ik.load_robot(name)
        for seed in options.seeds:
            for title in (*STAGES, *PLAIN):
                key = f"{name}|{seed}|{options.minutes:g}|{title}"
                if key in found:
                    continue
                found[key] = _errors(robot, title, seed, options.minutes, options.rows)
                print(key, [f"{step['position_mm'][0]:.3g}" for step in found[key]], flush=True)
                if options.json:
                    _write(Path(options.json), found)
    for name in options.robots:
        print("", *_table(name, found, options), sep="\n")
    if options.picture:
        from ikgrad import plots

        plots.save_figure(_picture(found, options), options.picture)


def _errors(robot: ik.Robot, title: str, seed: int, minutes: float, rows: int) -> list[dict[str, Any]]:
    """Train one stage; its errors after 0, 1, 2 and 3 steps."""
    T, _, q_current = TaskStream(robot, batch_size=rows, seed=TEST_SEED).batch(0)
    if title in PLAIN:
        start = damped_steps(robot, T, q_current, steps=PLAIN[title]).q
    else:
        stage = STAGES[title]
        inverter = stage.family(robot, seed=seed)
        stream = TaskStream(robot, seed=seed, label=stage.label)  # type: ignore[arg-type]
        EndlessTraining(inverter, stream, minutes=minutes, loss=stage.loss).run()
        with torch.no_grad():
            start = inverter(T, q_current)
    return [asdict(measure(robot, damped_steps(robot, T, start, steps=count).q, T)) for count in STEPS]


def _table(name: str, found: Mapping[str, Any], options: argparse.Namespace) -> list[str]:
    """Markdown: medians over the seeds."""
    lines = [
        f"{name}, {options.minutes:g} min a network, one thread, {options.rows:,} rows, {len(options.seeds)} seed(s);",
        "median / 95th percentile of the answer, the share within 1 mm and 0.01 rad, so many steps later",
        "",
        "| stage | position [mm] | rotation [deg] | " + " | ".join(f"+ {count}" for count in STEPS) + " |",
        "|" + "---|" * (3 + len(STEPS)),
    ]
    for title in (*STAGES, *PLAIN):
        runs = _runs(name, title, found, options)
        mm, deg = (
            " / ".join(number(median(run[0][key][k] for run in runs)) for k in (0, 1))
            for key in ("position_mm", "rotation_deg")
        )
        shares = [f"{100 * median(run[k]['close'] for run in runs):.2f} %" for k in range(len(STEPS))]
        lines.append(f"| {title} | {mm} | {deg} | " + " | ".join(shares) + " |")
    return lines


def _picture(found: Mapping[str, Any], options: argparse.Namespace) -> Any:
    """Median position error against steps, one panel a robot."""
    from ikgrad.plots.style import FAINT, INK, PALETTE, new_figure, styled

    with styled():
        figure = new_figure((4.6 * len(options.robots) + 3.2, 4.6))
        panels = figure.subplots(1, len(options.robots), sharey=True, squeeze=False)[0]
        for axes, name in zip(panels, options.robots, strict=True):
            for colour, title in zip((*PALETTE[:6], FAINT, INK), (*STAGES, *PLAIN), strict=True):
                runs = _runs(name, title, found, options)
                middle = [median(run[k]["position_mm"][0] for run in runs) for k in range(len(STEPS))]
                most = [median(run[k]["position_mm"][1] for run in runs) for k in range(len(STEPS))]
                dash = "--" if title in PLAIN else "-"
                axes.plot(STEPS, middle, dash, color=colour, marker="o", label=title)
                axes.plot(STEPS, most, dash, color=colour, marker="^", linewidth=0.8, markersize=4)
            axes.set(title=name, yscale="log", xlabel="damped steps after the answer", xticks=STEPS, ylim=(1e-9, 1e3))
        panels[0].set_ylabel("position error [mm]")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right center", title="dots: median\ntriangles: 95th percentile")
    return figure


def _runs(name: str, title: str, found: Mapping[str, Any], options: argparse.Namespace) -> list[Any]:
    return [found[f"{name}|{seed}|{options.minutes:g}|{title}"] for seed in options.seeds]


def _write(path: Path, found: Mapping[str, Any]) -> None:
    temporary = path.with_suffix(".part")
    temporary.write_text(json.dumps(found, indent=1) + "\n")
    os.replace(temporary, path)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=["panda", "ur5e"])
    parser.add_argument("--minutes", type=float, default=2.0, help="of training, each")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    parser.add_argument("--rows", type=int, default=20_000, help="to measure on")
    parser.add_argument("--json", help="file for the numbers, and to go on from")
    parser.add_argument("--picture", help="PNG or SVG")
    return parser.parse_args()


if __name__ == "__main__":
    main()
