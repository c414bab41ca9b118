"""``ikgrad bench``: ours and other packages on the same poses, judged alike."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ikgrad.cli.parsing import Commands, count, example, positive, seed
from ikgrad.cli.terminal import Progress, print_json, print_table

if TYPE_CHECKING:
    from ikgrad.bench.records import Cell, Report
    from ikgrad.bench.statistics import Interval

COMMANDS = {
    "ik": "inverse kinematics",
    "fk": "forward kinematics, alone and with its gradient",
    "jacobian": "Jacobians",
}
DESCRIPTION = """\
{what}: ours and other packages in turns (A B C A B C ...) on the same {rows}.

{judged} A ratio says how many times slower than ikgrad in the same run, with its 95 %
bootstrap interval. Peers that are not installed are left out: pip install 'ikgrad[bench]'."""
JUDGED = "Every answer of everybody is judged by the same forward kinematics and the same limits."
AGREE = "Results must agree."


def add(commands: Commands) -> None:
    """Add the command and what it measures."""
    text = "measure speed and success beside other packages"
    parser = commands.add_parser(
        "bench", help=text, description=text, epilog=example("ikgrad bench ik --robot panda --rows 10000")
    )
    jobs = parser.add_subparsers(dest="job", metavar="JOB", required=True, title="jobs")
    for name, what in COMMANDS.items():
        rows, judged = ("poses", JUDGED) if name == "ik" else ("configurations", AGREE)
        job = jobs.add_parser(
            name,
            help=what,
            description=DESCRIPTION.format(what=what, rows=rows, judged=judged),
            epilog=example(
                f"ikgrad bench {name} --robot panda --threads 1 2 --peers roboticstoolbox\n"
                f"ikgrad bench {name} --robot panda ur5e arm.urdf --rows 10000 --batch 1 100 10000 --peers none --json"
            ),
        )
        if name == "ik":
            job.add_argument("--protocol", default="tight", metavar="NAME", help=PROTOCOLS_HELP)
        _add_options(job)
        job.set_defaults(run=run)


PROTOCOLS_HELP = (
    "tight (default; 1e-6 m and rad, cold), tracik (1e-5, one pose a call, 5 ms cap), curobo (5 mm and 0.05 rad), "
    "singular, unreachable, single (one pose a call), path (start = last answer), stream (a file through `ikgrad "
    "solve`), cold (first solve in a fresh process)"
)


def _add_options(job: argparse.ArgumentParser) -> None:
    job.add_argument(
        "--robot", nargs="+", default=["panda"], metavar="ROBOT", help="built-in names or URDF files (panda)"
    )
    job.add_argument("--rows", type=count, metavar="N", help="rows (the protocol's own; 100000 for fk and jacobian)")
    job.add_argument("--batch", type=count, nargs="+", metavar="N", help="rows a call of ours (all)")
    job.add_argument("--threads", type=count, nargs="+", default=[1], metavar="N", help="numbers of threads (1)")
    job.add_argument(
        "--peers", nargs="+", metavar="NAME", help="packages by name, all, or none (all; the protocol may differ)"
    )
    job.add_argument("--seconds", type=positive, default=20.0, metavar="S", help="time for each peer, a race (20)")
    job.add_argument("--rounds", type=count, default=9, metavar="N", help="turns of each solver (9)")
    job.add_argument("--seed", type=seed, default=0, help="of the rows and of random starts (default 0)")
    job.add_argument("--json", action="store_true", help="print one JSON document")
    job.add_argument("--out", metavar="FILE", help="also write the JSON document to a file")
    job.add_argument("--force", action="store_true", help="overwrite FILE")


def run(args: argparse.Namespace) -> int:
    """Look everything up, run, print."""
    from ikgrad.files.places import check_output, in_one_move

    path: Path | None = check_output(args.out, (".json",), force=args.force) if args.out else None
    from ikgrad.bench.ik import Plan
    from ikgrad.bench.run import Request

    plan = Plan(
        rows=args.rows or 0,
        batches=tuple(args.batch or (0,)),
        threads=tuple(args.threads),
        rounds=args.rounds,
        seconds=args.seconds,
        seed=args.seed,
    )
    protocol = args.protocol if args.job == "ik" else "tight"
    job = Request(args.job, tuple(args.robot), protocol, tuple(args.peers or ()), plan).resolve()
    with Progress("bench", job.turns, "turns") as progress:
        report = job.run(progress.advance)
    if path is not None:
        with in_one_move(path, force=args.force) as temporary:
            temporary.write_text(json.dumps(report.to_json(), indent=1) + "\n")
    if args.json:
        print_json(report.to_json())
    else:
        _print(report)
    return 0


def _print(report: Report) -> None:
    measured = [cell for cell in report.cells if cell.missing is None]
    columns = [column for column in _columns(report) if any(column[1](cell) for cell in measured)]
    rows = [[show(cell) for _, show in columns] for cell in measured]
    text = {"robot", "solver", "job"}
    right = [k for k, (name, _) in enumerate(columns) if name not in text]
    print_table(f"ikgrad bench {report.job}: {report.title}", [name for name, _ in columns], rows, right=right)
    missing: dict[str, list[str]] = {}
    for cell in report.cells:
        if cell.missing is not None:
            robots = missing.setdefault(f"{cell.solver}: {cell.missing}", [])
            robots += [cell.robot] if cell.robot not in robots else []
    for reason, robots in missing.items():
        print(f"n/a  {reason} ({', '.join(robots)})")
    for name, settings in report.solvers.items():
        print(f"{name}: {settings}")
    _print_environment(report)


def _print_environment(report: Report) -> None:
    place = report.environment
    versions = ", ".join(f"{name} {number}" for name, number in place["versions"].items())
    load = f", load {place['load_average'][0]:.1f}" if place["load_average"] else ""
    print(f"{place['cpu']}, {place['cores']} cores{load}, Python {place['python']}, {place['date']}; {versions}")


def _columns(report: Report) -> Sequence[tuple[str, Callable[[Cell], str]]]:
    """Name and text of each column; a column without any text is not shown."""
    return [
        ("robot", lambda c: c.robot),
        ("job", lambda c: c.job if c.job in ("fk", "fk_backward", "jacobian") else ""),
        ("batch", lambda c: f"{c.batch:,}"),
        ("threads", lambda c: str(c.threads)),
        ("solver", lambda c: c.solver),
        ("rows", lambda c: f"{c.rows:,}"),
        ("solved", _solved),
        ("outside", lambda c: f"{c.outside:,}" if c.outside else ""),
        ("late", lambda c: f"{c.late:,}" if c.late else ""),
        ("us a row [95 %]", lambda c: _times(c.mean) if c.job != "cold" else ""),
        ("median us", lambda c: _each(c, c.median)),
        ("95th us", lambda c: _each(c, c.percentile_95)),
        ("times ours [95 %]", _ratio),
        ("mm 50/95 %", lambda c: _errors(c, "position_mm") if _loose(report) else ""),
        ("deg 50/95 %", lambda c: _errors(c, "rotation_deg") if _loose(report) else ""),
        ("our reasons", lambda c: ", ".join(f"{n:,} {r}" for r, n in c.reasons.items() if r != "converged")),
        ("s [95 %]", lambda c: _seconds(c.mean) if c.job == "cold" and c.mean is not None else ""),
        *((name, _extra(key)) for key, name in EXTRAS.items()),
    ]


EXTRAS = {
    "largest_jump": "largest jump",
    "jumps_above_0.2": "jumps > 0.2",
    "avoidable_jumps": "avoidable",
    "largest_change_of_the_path": "path's own",
    "peak_memory_mb": "peak MB",
    "seconds": "seconds",
    "solve_poses_per_second": "poses/s",
    "import_torch_seconds": "import torch s",
}


def _extra(key: str) -> Callable[[Cell], str]:
    return lambda cell: f"{cell.extra[key]:,.4g}" if key in cell.extra and cell.extra[key] < 1e4 else _big(cell, key)


def _big(cell: Cell, key: str) -> str:
    return f"{cell.extra[key]:,.0f}" if key in cell.extra else ""


def _loose(report: Report) -> bool:
    return report.settings["protocol"] == "curobo"


def _solved(cell: Cell) -> str:
    if cell.success is None:
        return ""
    share = 100 * cell.success
    failed = cell.rows - (cell.solved or 0)
    return f"{share:.4g} % (-{failed:,})" if 0 < failed < cell.rows else f"{share:.0f} %"


def _digits(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _times(interval: Interval | None) -> str:
    if interval is None:
        return ""
    if interval.low == interval.high:
        return _digits(1e6 * interval.value)
    return f"{_digits(1e6 * interval.value)} [{_digits(1e6 * interval.low)}-{_digits(1e6 * interval.high)}]"


def _each(cell: Cell, seconds: float | None) -> str:
    """Spread of single poses; of whole batches it would say nothing new."""
    alone = cell.batch == 1 and cell.job == "ik" and not cell.extra
    return _digits(1e6 * seconds) if alone and seconds is not None else ""


def _seconds(interval: Interval) -> str:
    if interval.low == interval.high:
        return f"{interval.value:.2f}"
    return f"{interval.value:.2f} [{interval.low:.2f}-{interval.high:.2f}]"


def _ratio(cell: Cell) -> str:
    if cell.ratio is None or (cell.solver == "ikgrad" and cell.ratio.value == 1):
        return ""
    return f"{_digits(cell.ratio.value)} [{_digits(cell.ratio.low)}-{_digits(cell.ratio.high)}]"


def _errors(cell: Cell, kind: str) -> str:
    """Percentiles; JSON has more of them, and all digits."""
    values = (cell.errors[f"{kind}_p{part}"] for part in (50, 95))
    return " / ".join(f"{value:.2g}" if value >= 1e-3 else "0" for value in values)
