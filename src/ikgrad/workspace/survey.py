"""`reachability`, and the same step by step for those who stop and go on."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ikgrad.errors import ConfigError, ShapeError
from ikgrad.robot import Robot
from ikgrad.workspace.bounds import reach
from ikgrad.workspace.grid import ball
from ikgrad.workspace.orientations import even_rotations
from ikgrad.workspace.result import WorkspaceMap
from ikgrad.workspace.search import Search, distinct
from ikgrad.workspace.tally import Columns, Tally

STARTS = 16


def reachability(
    robot: Robot,
    *,
    cell: float = 0.02,
    orientations: int | Tensor = 50,
    mask: Tensor | Sequence[float] | None = None,
    starts: int = STARTS,
    solutions: int = 0,
    tol_pos: float = 1e-6,
    tol_rot: float = 1e-6,
    seed: int = 0,
    watch: Callable[[int, int], None] | None = None,
) -> WorkspaceMap:
    """Where the tip gets to, in how many orientations, and how well it can move there.

    The reach of the arm is cut into cubic cells, and every orientation is tried at the centre of every cell:

    1. What `ikgrad.workspace.bounds` rules out is out of reach for certain and needs no search.
    2. The rest is solved from ``starts`` starts a pose, as in `ikgrad.solve_ik`, joint limits included.
    3. Where that fails and a neighbouring cell was reached in the same orientation, its joints are one more start; this
       goes on from cell to cell until nothing new is reached.

    A pose counts as reached if forward kinematics confirms it. A pose that is neither reached nor ruled out may be
    missed: the page on workspaces has how often. Memory grows with the cells, not with the orientations. The work runs
    on the CPU, on ``torch.get_num_threads()`` threads; their number changes no bit of the map.

    Args:
        robot: the robot, n joint variables.
        cell: edge of a cell [m]; centres are multiples of it in the base.
        orientations: how many, see `ikgrad.workspace.even_rotations`; or (O, 3, 3) rotations of your own.
        mask: six zeros or ones as in `ikgrad.solve_ik`, the first three 1. With (1, 1, 1, 0, 0, 0) the orientation does
            not matter and one is enough: it is the only one tried.
        starts: starts of the solver for a pose.
        solutions: further random starts a reached pose to count different solutions with; 0: they are not counted.
            Only for robots with as many joints as the mask has directions; others have endlessly many.
        tol_pos: largest position error of a pose that counts as reached [m].
        tol_rot: largest rotation error [rad].
        seed: of random starts.
        watch: called after each orientation with the number done and the number of all.

    Raises:
        ConfigError: a setting makes no sense, the robot has fewer joints than the mask has directions, a slide
            has no limits, or there would be too many cells.
        ShapeError: ``orientations`` are no rotations.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("ur5e")
        >>> found = ik.reachability(robot, cell=0.2, orientations=8)
        >>> found
        WorkspaceMap('ur5e', 474 cells of 0.2 m, 8 orientations, 3.62 m^3 reached)
        >>> bool((found.share + found.unreachable <= 1).all())
        True
    """
    survey = Survey(
        robot, cell=cell, orientations=orientations, mask=mask, starts=starts, solutions=solutions, tol_pos=tol_pos,
        tol_rot=tol_rot, seed=seed,
    )  # fmt: skip
    while not survey.finished:
        survey.step()
        if watch is not None:
            watch(survey.done, len(survey.rotations))
    return survey.result()


class Survey:
    """A map in the making, one orientation a step; arguments as in `reachability`.

    Example:
        >>> import ikgrad as ik
        >>> survey = Survey(ik.load_robot("arm4"), cell=5.0, mask=(1, 1, 1, 0, 0, 0))
        >>> while not survey.finished:
        ...     survey.step()
        >>> bool(survey.result().share.max() == 1)
        True
    """

    def __init__(
        self,
        robot: Robot,
        *,
        cell: float = 0.02,
        orientations: int | Tensor = 50,
        mask: Tensor | Sequence[float] | None = None,
        starts: int = STARTS,
        solutions: int = 0,
        tol_pos: float = 1e-6,
        tol_rot: float = 1e-6,
        seed: int = 0,
    ):
        _check_positive(cell=cell, starts=starts, tol_pos=tol_pos, tol_rot=tol_rot)
        weights = _check_mask(robot, mask, solutions)
        rotations = even_rotations(orientations) if isinstance(orientations, int) else _check_rotations(orientations)
        self.rotations = rotations if weights[3:].any() else rotations[:1]
        bounds = reach(robot)
        if not math.isfinite(bounds.tip.most):
            raise ConfigError(f"robot '{robot.name}' has a slide without limits, so its reach has no end")
        grid = ball(bounds.shoulder, bounds.tip.most, cell)
        self.search = Search(robot, grid, weights, starts, tol_pos, tol_rot, seed)
        self.solutions = solutions
        self.tally = Tally.empty(len(grid), robot.dof)
        self.done = 0

    @property
    def finished(self) -> bool:
        """True if no orientation is left."""
        return self.done == len(self.rotations)

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.search.grid)

    def step(self) -> None:
        """Search all cells for the next orientation."""
        rotation = self.rotations[self.done].numpy()
        layer = self.search.layer(rotation)
        cells = np.flatnonzero(layer.reached)
        dexterity = self.search.dexterity(layer.q[cells], rotation)
        solutions = np.ones(len(cells), dtype=np.int64)
        if self.solutions:
            solutions = distinct(self.search, cells, rotation, layer.q[cells], self.solutions)
        self.tally.add(self.done, layer, cells, dexterity, solutions)
        self.done += 1

    def manifest(self) -> dict[str, Any]:
        """All that the map depends on, for `ikgrad.files.PartialRun`."""
        from ikgrad import __version__

        search = self.search
        return {
            "ikgrad version": __version__,
            "robot fingerprint": search.robot.fingerprint,
            "cell": search.grid.cell,
            "orientations": np.round(self.rotations.numpy(), 12).ravel().tolist(),
            "mask": search.mask.tolist(),
            "starts": search.starts,
            "solutions": self.solutions,
            "tol_pos": search.tol_pos,
            "tol_rot": search.tol_rot,
            "seed": search.seed,
        }

    def state(self) -> Columns:
        """What is known so far, to be given to `restore`; a row a cell."""
        return {**asdict(self.tally), "done": np.full(self.cells, self.done, dtype=np.int32)}

    def restore(self, state: Columns) -> None:
        """Go on from a `state` of the same question."""
        self.tally = Tally(**{name: value for name, value in state.items() if name != "done"})
        self.done = int(state["done"][0])

    def result(self) -> WorkspaceMap:
        """The map; every orientation must be done."""
        tally, search, all_ = self.tally, self.search, len(self.rotations)
        mean = tally.solutions / np.maximum(tally.reached, 1)
        return WorkspaceMap(
            robot=search.robot,
            cell=search.grid.cell,
            orientations=self.rotations,
            mask=tuple(search.mask.tolist()),
            centres=torch.from_numpy(search.grid.centres),
            share=torch.from_numpy(tally.reached / all_),
            unreachable=torch.from_numpy(1 - tally.tried / all_),
            condition=torch.from_numpy(tally.condition),
            manipulability=torch.from_numpy(tally.manipulability),
            q=torch.from_numpy(tally.q),
            orientation=torch.from_numpy(tally.orientation.astype(np.int64)),
            solutions_mean=torch.from_numpy(mean) if self.solutions else None,
            solutions_most=torch.from_numpy(tally.most.astype(np.int64)) if self.solutions else None,
        )


def _check_positive(**settings: float) -> None:
    for name, value in settings.items():
        if not 0 < value < math.inf:
            raise ConfigError(f"{name} must be positive, got {value}")


def _check_mask(robot: Robot, mask: Tensor | Sequence[float] | None, solutions: int) -> np.ndarray:
    """(6,) ones and zeros that fit the robot."""
    weights = np.ones(6) if mask is None else np.asarray(mask, dtype=np.float64)
    if weights.shape != (6,) or not np.isin(weights, (0, 1)).all():
        raise ConfigError(f"mask must hold six zeros or ones, got {mask}")
    if not weights[:3].all():
        raise ConfigError("the first three of mask must be 1: a map tells which positions are reached")
    directions = int(weights.sum())
    if robot.dof < directions:
        raise ConfigError(
            f"robot '{robot.name}' has {robot.dof} joints, too few for poses with {directions} directions; "
            "give a mask with fewer, such as 1,1,1,0,0,0 for positions alone"
        )
    if solutions < 0:
        raise ConfigError(f"solutions must not be negative, got {solutions}")
    if solutions and robot.dof > directions:
        raise ConfigError(
            f"robot '{robot.name}' has {robot.dof} joints for {directions} directions and so endlessly many "
            "solutions of a pose; leave solutions out"
        )
    return weights


def _check_rotations(orientations: Tensor) -> Tensor:
    if orientations.ndim != 3 or orientations.shape[1:] != (3, 3) or not len(orientations):
        raise ShapeError(f"orientations must be a number or have shape (O, 3, 3), got {tuple(orientations.shape)}")
    R = orientations.detach().to("cpu", torch.float64)
    off = (R @ R.mT - torch.eye(3, dtype=torch.float64)).abs().amax(dim=(1, 2)).nan_to_num(math.inf)
    bad = torch.nonzero((off > 1e-6) | (torch.linalg.det(R.nan_to_num(0.0)) <= 0)).flatten().tolist()
    if bad:
        raise ShapeError(f"orientations[{bad[0]}] is no rotation: |R R^T - 1| is {float(off[bad[0]]):.3g}")
    return R
