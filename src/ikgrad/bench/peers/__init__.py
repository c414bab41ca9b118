"""The packages that ours is compared with, each behind one small adapter."""

from __future__ import annotations

from collections.abc import Sequence

from ikgrad.bench.peers.base import Peer
from ikgrad.bench.peers.eaik import Eaik
from ikgrad.bench.peers.ikpy import IkPy
from ikgrad.bench.peers.pinocchio import Pinocchio
from ikgrad.bench.peers.pytorch_kinematics import PytorchKinematics
from ikgrad.bench.peers.roboticstoolbox import RoboticsToolbox, RoboticsToolboxDefaults
from ikgrad.bench.peers.ssik import Ssik
from ikgrad.bench.peers.tracik import TracIK
from ikgrad.errors import UnknownNameError

PEERS: tuple[type[Peer], ...] = (
    RoboticsToolbox,
    RoboticsToolboxDefaults,
    PytorchKinematics,
    TracIK,
    Eaik,
    Ssik,
    IkPy,
    Pinocchio,
)


def peers(names: Sequence[str], job: str) -> list[Peer]:
    """Adapters by name; ``all`` stands for those that can do the job, ``none`` for nobody.

    Raises:
        UnknownNameError: there is no adapter of that name.
    """
    known = {peer.name: peer for peer in PEERS}
    for name in names:
        if name not in known and name not in ("all", "none"):
            raise UnknownNameError("peer", name, [*known, "all", "none"])
    chosen = [name for name, peer in known.items() if name in names or ("all" in names and job in peer.jobs)]
    return [known[name]() for name in chosen]
