"""``ikgrad doctor``: is everything there, and does it work?"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from ikgrad.cli import checkup
from ikgrad.cli.parsing import Commands, example
from ikgrad.cli.terminal import print_json, print_table

DESCRIPTION = """\
look at versions, threads, the cache of compiled kernels, GPUs and optional packages, and solve 100 poses: all of them
must be solved, in the expected number of steps, with errors measured by code that had no part in solving.

A missing extra is no fault; the line that installs it is shown. Exit status 1 if something is broken."""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "doctor",
        help="check the installation, with one solve",
        description=DESCRIPTION,
        epilog=example("ikgrad doctor\nikgrad doctor --json"),
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Look, solve, print."""
    report = examine()
    if args.json:
        print_json(report)
    else:
        _print(report)
    return 0 if report["ok"] else 1


def examine() -> dict[str, Any]:
    """The whole report as one record; what cannot even be looked at is a problem, not an end."""
    problems: list[str] = []

    def look(what: str, at: Callable[[], Any]) -> Any:
        try:
            return at()
        except Exception as error:  # whatever is broken here is what was asked for
            problems.append(f"{what}: {type(error).__name__}: {' '.join(str(error).split())}")
            return None

    found = look("packages", checkup.packages)
    report: dict[str, Any] = {
        "system": checkup.system(),
        "packages": {p.name: {"version": p.version, "wanted": p.wanted} for p in found or [] if p.extra is None},
        "extras": checkup.missing_extras(found or []),
        "threads": look("threads", checkup.threads),
        "gpu": look("GPU", checkup.gpu),
        "kernel_cache": look("kernel cache", checkup.kernel_cache),
        "solve": look("solve", checkup.solve),
    }
    if found is not None:
        problems += checkup.problems_of_packages(found)
    if report["solve"] is not None:
        problems += checkup.problems_of_solve(report["solve"])
    return {"ok": not problems, "problems": problems, **report}


def _print(report: dict[str, Any]) -> None:
    rows = [
        [title, line]
        for title, lines in (
            ("versions", _versions(report)),
            ("threads", _threads(report["threads"])),
            ("kernel cache", _cache(report["kernel_cache"])),
            ("GPU", _gpu(report["gpu"])),
            ("extras", _extras(report["extras"])),
            ("solve", _solve(report["solve"])),
        )
        for title, line in zip([title, *[""] * len(lines)], lines, strict=False)
    ]
    print_table("ikgrad doctor", ["", ""], rows)
    for problem in report["problems"]:
        print(f"broken: {problem}")
    if report["ok"]:
        print("Everything that is needed works.")


def _versions(report: dict[str, Any]) -> list[str]:
    machine = report["system"]
    needed = [f"{name} {found['version'] or 'missing'}" for name, found in report["packages"].items()]
    half = (len(needed) + 1) // 2
    lines = [", ".join(needed[:half]), ", ".join(needed[half:])]
    return [f"ikgrad {machine['ikgrad']}, Python {machine['python']}, {machine['platform']}", *filter(None, lines)]


def _threads(found: dict[str, Any] | None) -> list[str]:
    if found is None:
        return ["unknown"]
    policy = ", ".join(f"{key}={value}" for key, value in found.items() if key.isupper() and value)
    return [f"{found['torch']} of torch on {found['cores']} cores" + (f"; {policy}" if policy else "")]


def _cache(found: dict[str, Any] | None) -> list[str]:
    if found is None:
        return ["unknown"]
    if found["folder"] is None:
        return ["no folder can be written: kernels compile in every process; set NUMBA_CACHE_DIR to one that can"]
    warm = f"warm, kernels: {found['kernels']}, {_megabytes(found['bytes'])}"
    lines = [f"{found['folder']}: {warm if found['kernels'] else 'cold, the first solve compiles for half a minute'}"]
    if found["other_versions"]:
        size = _megabytes(found["other_bytes"])
        lines.append(f"folders of other versions beside it: {found['other_versions']}, {size}; they may be deleted")
    return lines


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB"


def _gpu(found: dict[str, Any] | None) -> list[str]:
    if found is None:
        return ["unknown"]
    if found["devices"]:
        return [f"{', '.join(found['devices'])} (CUDA {found['cuda']})"]
    build = f"for CUDA {found['cuda']}" if found["cuda"] else "without CUDA"
    return [f"none; torch {found['torch']} is built {build}"]


def _extras(extras: dict[str, list[str]]) -> list[str]:
    return [
        f"[{name}] is there" if not missing else f"[{name}] lacks {', '.join(missing)}: pip install 'ikgrad[{name}]'"
        for name, missing in sorted(extras.items())
    ] or ["unknown"]


def _solve(found: dict[str, Any] | None) -> list[str]:
    if found is None:
        return ["failed"]
    return [
        f"{found['solved']} of {found['poses']} poses of {found['robot']}, {found['mean_steps']:.2f} steps a pose, "
        f"largest error {found['position_error_m']:.1e} m, {found['rotation_error_rad']:.1e} rad",
        f"first call {found['first_seconds']:.2f} s, then {1e3 * found['seconds']:.2f} ms",
    ]
