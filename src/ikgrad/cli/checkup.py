"""What ``ikgrad doctor`` looks at: facts as plain records, and what is wrong with them as sentences.

Versions come from the packages' metadata and not from importing them, so that a broken package is reported, too.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROBOT, POSES = "panda", 100
STEPS = (4.0, 6.0)  # mean steps a pose; 4.71 where it was written, and rounding differs between processors
CLOSE = 1.001e-6  # [m, rad] what the solver promises, and the rounding of a second opinion


class Package(NamedTuple):
    """A package that this one needs, always or for an extra."""

    name: str
    wanted: str
    version: str | None  # None: not there
    good: bool
    extra: str | None  # None: always needed


def packages() -> list[Package]:
    """What the installed metadata of this package asks for, beside what is there; empty in a bare checkout."""
    try:
        wanted = importlib.metadata.requires("ikgrad") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return list(_compare(wanted))


def _compare(wanted: list[str]) -> Iterator[Package]:
    from packaging.requirements import Requirement

    for line in wanted:
        need = Requirement(line)
        extra = line.rpartition("extra == ")[2].strip("'\" ") if "extra ==" in line else None
        if need.marker is not None and not need.marker.evaluate({"extra": extra or ""}):
            continue  # for other systems
        try:
            version: str | None = importlib.metadata.version(need.name)
        except importlib.metadata.PackageNotFoundError:
            version = None
        good = version is not None and need.specifier.contains(version, prereleases=True)
        yield Package(need.name, str(need.specifier), version, good, extra)


def system() -> dict[str, Any]:
    """Interpreter and machine."""
    from ikgrad import __version__

    return {"ikgrad": __version__, "python": platform.python_version(), "platform": platform.platform()}


def threads() -> dict[str, Any]:
    """Cores that this process may use, and what says how many are used."""
    import torch

    may = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    names = ("OMP_NUM_THREADS", "OMP_WAIT_POLICY")
    return {"cores": may, "torch": torch.get_num_threads(), **{name: os.environ.get(name) for name in names}}


def kernel_cache() -> dict[str, Any]:
    """Where compiled kernels lie, before anything is compiled; folders beside it belong to other versions."""
    from ikgrad.engine.cache import cache_folder

    folder = cache_folder()
    if folder is None:
        return {"folder": None, "kernels": 0, "bytes": 0, "other_versions": 0, "other_bytes": 0}
    others = [path for path in folder.parent.iterdir() if path.is_dir() and path != folder]
    return {
        "folder": str(folder),
        "kernels": len(list(folder.glob("*.nbc"))),
        "bytes": _size(folder),
        "other_versions": len(others),
        "other_bytes": sum(map(_size, others)),
    }


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir() if path.is_file())


def gpu() -> dict[str, Any]:
    """What torch sees."""
    import torch

    names = [torch.cuda.get_device_name(k) for k in range(torch.cuda.device_count())]
    return {"torch": torch.__version__, "cuda": torch.version.cuda, "devices": names}


def solve() -> dict[str, Any]:
    """Solve 100 poses of `panda`, and measure the errors by code that had no part in it."""
    from ikgrad.data import sample_configurations
    from ikgrad.kinematics import forward_kinematics, plain_forward_kinematics, pose_error
    from ikgrad.robot import load_robot
    from ikgrad.solvers.solve import solve_ik

    robot = load_robot(ROBOT)
    T = forward_kinematics(robot, sample_configurations(robot, POSES, seed=0))
    seconds = []
    for _ in range(2):  # the first may compile
        begin = time.perf_counter()
        solution = solve_ik(robot, T)
        seconds.append(time.perf_counter() - begin)
    error = pose_error(plain_forward_kinematics(robot, solution.q), T)
    return {
        "robot": ROBOT,
        "poses": POSES,
        "solved": int(solution.success.sum()),
        "mean_steps": solution.steps.double().mean().item(),
        "position_error_m": error[:, :3].norm(dim=-1).max().item(),
        "rotation_error_rad": error[:, 3:].norm(dim=-1).max().item(),
        "first_seconds": seconds[0],
        "seconds": seconds[1],
    }


def problems_of_packages(found: list[Package]) -> list[str]:
    """Packages that are always needed and missing, or of another version than they may be."""
    if not found:
        return ["ikgrad is not installed as a package; pip install . in its folder does that"]
    return [
        f"{p.name} {p.version or 'is missing'}{', ' if p.version else '; '}needs {p.wanted or 'any version'}; "
        f"pip install '{p.name}{p.wanted}'"
        for p in found
        if not p.good and p.extra is None
    ]


def problems_of_solve(found: dict[str, Any]) -> list[str]:
    """What a healthy machine does not show."""
    said = []
    if found["solved"] < found["poses"]:
        said.append(f"only {found['solved']} of {found['poses']} poses of {ROBOT} were solved")
    if not STEPS[0] <= found["mean_steps"] <= STEPS[1]:
        said.append(f"{found['mean_steps']:.2f} steps a pose on {ROBOT}, expected {STEPS[0]:g} to {STEPS[1]:g}")
    if not max(found["position_error_m"], found["rotation_error_rad"]) <= CLOSE:
        error = f"{found['position_error_m']:.2g} m, {found['rotation_error_rad']:.2g} rad"
        said.append(f"compiled kernels and torch disagree: an answer is off by {error}, expected 1e-6")
    return said


def missing_extras(found: list[Package]) -> dict[str, list[str]]:
    """Extra to its packages that are missing or too old; extras that are complete have an empty list."""
    extras: dict[str, list[str]] = {}
    for package in found:
        if package.extra not in (None, "dev"):
            extras.setdefault(str(package.extra), [])
            if not package.good:
                extras[str(package.extra)].append(package.name)
    return extras
