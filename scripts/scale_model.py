"""What bulk inverse kinematics costs past this machine: a model of four numbers, and a plan for any count of poses.

    python scripts/scale_model.py [--plan 1e9 1e12] [--cores 1000] [--micros 1.24] [--bytes-in 56] [--bytes-out 73] ...

The defaults for core time and bytes are of one run of scripts/bench_scale.py, which measures them anew, prints this
plan from them and checks the model against its own runs. Prices and the network are assumptions: give your own.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

HOUR, MONTH = 3600.0, 730 * 3600.0


@dataclass(frozen=True)
class Cost:
    """``seconds = start + poses * pose / workers``.

    Attributes:
        start: seconds from the command to its end with no poses at all: imports, processes, kernels.
        pose: core seconds of a pose: read, solve, write.
        bytes_in: of a pose, on disk.
        bytes_out: of its joints, on disk.
    """

    start: float
    pose: float
    bytes_in: float
    bytes_out: float

    def seconds(self, poses: float, workers: int) -> float:
        """Predicted wall time."""
        return self.start + poses * self.pose / workers


@dataclass(frozen=True)
class Assumptions:
    """What no run on one machine can tell.

    Attributes:
        cores: at work at the same time.
        core_hour: price of one for an hour [USD].
        gb_month: price of storage [USD].
        months: for which inputs and outputs are kept.
        link: network rate of a machine to the storage [Gbit/s].
        rows: poses of a partition.
        note_bytes: of the record of a partition; its place in the manifest takes as much.
    """

    cores: int = 1000
    core_hour: float = 0.04
    gb_month: float = 0.023
    months: float = 1.0
    link: float = 10.0
    rows: int = 250_000
    note_bytes: float = 600.0


@dataclass(frozen=True)
class Plan:
    """What a count of poses takes."""

    poses: float
    core_hours: float
    hours: float  # with all cores
    terabytes: float
    money_cores: float  # [USD]
    money_storage: float  # [USD]
    fed_cores: float  # so many cores of one machine keep its network busy
    partitions: float
    notes: float  # bytes of records, likewise of the manifest


def fit(runs: Iterable[tuple[float, float]], *, bytes_in: float, bytes_out: float) -> Cost:
    """The line through two runs with one worker.

    Args:
        runs: (poses, seconds), the two of them.
        bytes_in: of a pose.
        bytes_out: of its joints.

    Example:
        >>> fit([(100, 3.0), (1100, 5.0)], bytes_in=56, bytes_out=73)
        Cost(start=2.8, pose=0.002, bytes_in=56, bytes_out=73)
    """
    (few, short), (many, long) = sorted(runs)
    pose = (long - short) / (many - few)
    return Cost(short - few * pose, pose, bytes_in, bytes_out)


def plan(cost: Cost, poses: float, given: Assumptions) -> Plan:
    """What so many poses take. ``start`` is left out: it is seconds.

    Example:
        >>> a = plan(Cost(3.0, 3.6e-6, 60, 65), 1e9, Assumptions(cores=10, core_hour=0.05))
        >>> a.core_hours, a.hours, a.terabytes, a.money_cores, a.partitions
        (1.0, 0.1, 0.125, 0.05, 4000.0)
    """
    core_hours = poses * cost.pose / HOUR
    total = poses * (cost.bytes_in + cost.bytes_out)
    partitions = poses / given.rows
    return Plan(
        poses,
        core_hours,
        core_hours / given.cores,
        total / 1e12,
        core_hours * given.core_hour,
        total / 1e9 * given.gb_month * given.months,
        given.link / 8 * 1e9 * cost.pose / (cost.bytes_in + cost.bytes_out),
        partitions,
        partitions * given.note_bytes,
    )


def table(cost: Cost, counts: Sequence[float], given: Assumptions) -> str:
    """The plan, as Markdown."""
    plans = [plan(cost, count, given) for count in counts]
    rows = [
        ("core hours", [f"{p.core_hours:,.3g}" for p in plans]),
        (f"hours on {given.cores:,} cores", [f"{p.hours:,.3g}" for p in plans]),
        (f"cores, {given.core_hour} USD an hour", [f"{p.money_cores:,.3g} USD" for p in plans]),
        ("poses and joints on disk", [f"{p.terabytes:,.3g} TB" for p in plans]),
        (
            f"storage, {given.gb_month} USD a GB and month, {given.months:g} month(s)",
            [f"{p.money_storage:,.3g} USD" for p in plans],
        ),
        (f"cores that fill {given.link:g} Gbit/s", [f"{p.fed_cores:,.0f}" for p in plans]),
        (f"partitions of {given.rows:,} poses", [f"{p.partitions:,.0f}" for p in plans]),
        ("records, likewise the manifest", [f"{p.notes / 1e6:,.3g} MB" for p in plans]),
    ]
    head = ["", *[f"{count:.0e} poses".replace("e+0", "e").replace("e+", "e") for count in counts]]
    lines = [head, ["---"] * len(head), *[[name, *cells] for name, cells in rows]]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def add_assumptions(parser: argparse.ArgumentParser) -> None:
    """Options for `Assumptions`."""
    default = Assumptions()
    parser.add_argument("--plan", type=float, nargs="+", default=[1e9, 1e12], metavar="N", help="poses to plan for")
    parser.add_argument("--cores", type=int, default=default.cores)
    parser.add_argument("--core-hour", type=float, default=default.core_hour, metavar="USD")
    parser.add_argument("--gb-month", type=float, default=default.gb_month, metavar="USD")
    parser.add_argument("--months", type=float, default=default.months)
    parser.add_argument("--link", type=float, default=default.link, metavar="GBIT/S")
    parser.add_argument("--rows", type=int, default=default.rows, help="poses of a partition")


def assumptions(args: argparse.Namespace, note_bytes: float = Assumptions.note_bytes) -> Assumptions:
    """From the options."""
    return Assumptions(args.cores, args.core_hour, args.gb_month, args.months, args.link, args.rows, note_bytes)


def main() -> None:
    """Print the plan."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--micros", type=float, default=1.24, help="core microseconds of a pose")
    parser.add_argument("--bytes-in", type=float, default=56.0)
    parser.add_argument("--bytes-out", type=float, default=73.0)
    add_assumptions(parser)
    args = parser.parse_args()
    print(table(Cost(0.0, args.micros * 1e-6, args.bytes_in, args.bytes_out), args.plan, assumptions(args)))


if __name__ == "__main__":
    main()
