"""A whole benchmark: robots, protocol and peers by name, one `Report` at the end."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

from ikgrad.bench.environment import environment
from ikgrad.bench.ik import Plan, bench_ik
from ikgrad.bench.kinematics import JOBS, Memory, bench_kinematics
from ikgrad.bench.path import bench_paths
from ikgrad.bench.peers import PEERS, peers
from ikgrad.bench.peers.base import Peer
from ikgrad.bench.peers.ours import Ikgrad
from ikgrad.bench.processes import bench_cold, bench_stream, file_kinds
from ikgrad.bench.protocols import PROTOCOLS, Protocol
from ikgrad.bench.race import Advance
from ikgrad.bench.records import Cell, Report
from ikgrad.errors import ConfigError, UnknownNameError
from ikgrad.robot import Robot, load_robot

ROWS = 100_000  # of fk and jacobian, unless asked otherwise


@dataclass(frozen=True)
class Request:
    """What is wanted, as people say it.

    Attributes:
        command: ik, fk or jacobian.
        robots: built-in names or URDF files.
        protocol: of ik.
        peers: names, ``all`` or ``none``; nothing: the protocol's own choice.
        plan: sizes and budgets; rows of 0 are the protocol's own.
    """

    command: str
    robots: tuple[str, ...]
    protocol: str = "tight"
    peers: tuple[str, ...] = ()
    plan: Plan = field(default_factory=lambda: Plan(rows=0))

    def resolve(self) -> Job:
        """Look everything up before any work is done.

        Raises:
            UnknownNameError: no such robot, protocol or peer.
            ConfigError: the protocol cannot do what is asked.
        """
        if self.protocol not in PROTOCOLS:
            raise UnknownNameError("protocol", self.protocol, PROTOCOLS)
        protocol = PROTOCOLS[self.protocol]
        rows = self.plan.rows or (protocol.rows if self.command == "ik" else ROWS)
        if max(self.plan.batches) > rows:
            raise ConfigError(f"a batch of {max(self.plan.batches)} is more than the {rows} rows; give more --rows")
        if self.command == "ik" and any(self.plan.batches) and (protocol.one_by_one or protocol.make is None):
            raise ConfigError(f"protocol '{protocol.name}' has batch sizes of its own; leave --batch out")
        jobs = JOBS.get(self.command, ("ik",))
        wanted = self.peers or (protocol.peers if self.command == "ik" else ("all",))
        chosen = {peer.name: peer for job in jobs for peer in peers(wanted, job)}
        robots = tuple((name, load_robot(name)) for name in self.robots)
        plan = Plan(**{**asdict(self.plan), "rows": rows})
        return Job(self, protocol, plan, robots, tuple(chosen.values()))


@dataclass(frozen=True)
class Job:
    """A request with everything looked up; `run` does it."""

    request: Request
    protocol: Protocol
    plan: Plan
    robots: tuple[tuple[str, Robot], ...]
    peers: tuple[Peer, ...]

    @property
    def turns(self) -> int:
        """About how many turns there will be, for a progress bar."""
        solvers = 1 + len(self.peers)
        if self.request.command != "ik":
            each = self.plan.turns(solvers + 1) * len(JOBS[self.request.command])
        elif self.protocol.name == "stream":
            each = len(self.plan.threads) * len(file_kinds())
        elif self.protocol.name == "cold":
            each = self.plan.rows + 1
        else:
            each = self.plan.turns(solvers + (self.protocol.paths is not None))
        return each * len(self.robots)

    def run(self, advance: Advance = lambda _: None) -> Report:
        """Everything, robot by robot.

        Args:
            advance: called with 1 after every turn of a solver.
        """
        cells: list[Cell] = []
        for source, robot in self.robots:
            cells += self._one(robot, source, advance)
        title = self.protocol.says if self.request.command == "ik" else f"{self.request.command}, float64"
        seen = {cell.solver for cell in cells if cell.missing is None}
        solvers: list[type[Peer]] = [Ikgrad, *PEERS, Memory]
        return Report(
            job=self.request.command,
            title=title,
            cells=tuple(cells),
            environment=environment(peer.package for peer in PEERS if peer.name in seen),
            settings={**asdict(self.request), "plan": asdict(self.plan)},
            solvers={solver.name: solver.settings for solver in solvers if solver.name in seen},
        )

    def _one(self, robot: Robot, source: str, advance: Advance) -> list[Cell]:
        plan, others = self.plan, self.peers
        if self.request.command != "ik":
            extra = (Memory(),) if self.request.peers != ("none",) else ()
            return bench_kinematics(robot, self.request.command, plan, (*others, *extra), advance=advance)
        if self.protocol.name == "stream":
            return bench_stream(robot, self.protocol, plan, source=source, advance=advance)
        if self.protocol.name == "cold":
            return bench_cold(robot, plan, source=source, advance=advance)
        if self.protocol.paths is not None:
            return bench_paths(robot, self.protocol, plan, others, advance=advance)
        return bench_ik(robot, self.protocol, plan, others, advance=advance)


def run(request: Request, advance: Advance = lambda _: None) -> Report:
    """Resolve a request and do it."""
    return request.resolve().run(advance)
