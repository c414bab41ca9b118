"""The IK protocols: what is asked, how close is close enough, and where that comes from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from ikgrad.bench import targets
from ikgrad.robot import Robot


@dataclass(frozen=True)
class Protocol:
    """How solvers are compared.

    Attributes:
        name: what ``--protocol`` calls it.
        says: what it asks, for the table's title.
        rows: poses, unless ``--rows`` says otherwise.
        tol_pos: [m]
        tol_rot: [rad]
        make: poses from robot, rows and seed; None where the protocol has its own runner.
        paths: joint-space paths from robot, number, points and seed.
        one_by_one: every pose is a call of its own, for everybody.
        from_middle: solvers start in the middle of the range; else they draw their own starts.
        cap: an answer that took longer counts as none [s].
        peers: whom it is run with unless ``--peers`` says otherwise.
    """

    name: str
    says: str
    rows: int
    tol_pos: float = 1e-6
    tol_rot: float = 1e-6
    make: Callable[[Robot, int, int], Tensor] | None = targets.reachable
    paths: Callable[[Robot, int, int, int], Tensor] | None = None
    one_by_one: bool = False
    from_middle: bool = False
    cap: float | None = None
    peers: tuple[str, ...] = ("all",)


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        Protocol("tight", "random reachable poses, cold, 1e-6 m and 1e-6 rad, inside the limits", 100_000),
        Protocol(
            "tracik",
            "after TRAC-IK: random configurations, 1e-5, start in the middle of the range, one pose a call, 5 ms cap",
            10_000,
            tol_pos=1e-5,
            tol_rot=1e-5,
            one_by_one=True,
            from_middle=True,
            cap=5e-3,
        ),
        Protocol(
            "curobo",
            "after cuRobo and PyRoki: random reachable poses, cold, 5 mm and 0.05 rad, inside the limits",
            10_000,
            tol_pos=5e-3,
            tol_rot=0.05,
        ),
        Protocol(
            "singular",
            "poses whose configuration has a smallest singular value below 1e-3, cold, 1e-6 m and 1e-6 rad",
            10_000,
            make=targets.singular,
        ),
        Protocol(
            "unreachable",
            "poses 0.2 m to 2 m outside the workspace; whatever is counted as solved is wrong",
            10_000,
            make=targets.unreachable,
            peers=("none",),
        ),
        Protocol(
            "single",
            "random reachable poses, cold, 1e-6 m and 1e-6 rad, one pose a call",
            1_000,
            one_by_one=True,
        ),
        Protocol(
            "path",
            "smooth paths clear of limits and singularities, 1,000 points each; start = the last answer",
            100,
            make=None,
            paths=targets.clear_paths,
            peers=("none",),
        ),
        Protocol(
            "path-wild",
            "smooth paths through most of the joint ranges, singularities included; start = the last answer",
            100,
            make=None,
            paths=targets.smooth_paths,
            peers=("none",),
        ),
        Protocol("stream", "poses in a file through `ikgrad solve`, in a process of its own", 1_000_000, make=None),
        Protocol("cold", "first solve in a fresh process, beyond `import torch`", 5, make=None),
    )
}
