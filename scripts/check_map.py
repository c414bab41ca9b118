"""Check a map of `ikgrad map` against brute force by other means than made it.

1. Cells are drawn at random, and every orientation is tried in each: first by `solve_ik` in plain torch operations,
   from many random starts and another seed, then, where that fails, by the compiled `solve_ik` with all its 300
   starts. The map itself used the compiled solver with few starts, and its neighbours' joints. Every answer is
   measured, a sample of them by yourdfpy.
2. The joints that the map names are taken at their word: yourdfpy says where they bring the tip, and the condition
   number is computed anew from a Jacobian of yourdfpy's joint frames.

    ikgrad map --robot panda -o panda_map.parquet
    python scripts/check_map.py panda_map.parquet --robot panda
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
import yourdfpy

import ikgrad as ik
from ikgrad.resources import builtin_file
from ikgrad.workspace import even_rotations

TOLERANCE = 1e-6  # [m] and [rad]


def main() -> None:
    """Draw cells, solve them, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("map", help="Parquet file of `ikgrad map`")
    parser.add_argument("--robot", default="panda", help="built-in name or URDF file, one branch only")
    parser.add_argument("--cells", type=int, default=1000)
    parser.add_argument("--orientations", type=int, default=50, help="of the map")
    parser.add_argument("--starts", type=int, default=40, help="random starts in torch")
    parser.add_argument("--seed", type=int, default=12345, help="of the draw and of the starts")
    args = parser.parse_args()
    robot, rotations = ik.load_robot(args.robot), even_rotations(args.orientations)
    table = pq.read_table(args.map).to_pydict()
    names = [f"best_{name}" for name in robot.joint_names]
    rows = np.random.default_rng(args.seed).choice(len(table["x_m"]), args.cells, replace=False)
    cells = {name: np.array(column)[rows] for name, column in table.items()}
    centres = torch.from_numpy(np.stack([cells[name] for name in ("x_m", "y_m", "z_m")], axis=1))
    print(f"{args.cells:,} of {len(table['x_m']):,} cells, {args.orientations} orientations each, {robot.name}")
    arm = Arm(Path(args.robot) if Path(args.robot).exists() else builtin_file("urdf", args.robot), robot)
    reached = brute_force(robot, arm, centres, rotations, args)
    compare(cells, reached.numpy().sum(axis=1), reached.shape[1])
    witnesses(arm, robot, cells, np.stack([cells[name] for name in names], axis=1), centres, rotations)


class Arm:
    """Forward kinematics and joint frames by yourdfpy alone."""

    def __init__(self, path: Path, robot: ik.Robot):
        self.urdf = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
        self.names, self.base, self.tip = robot.joint_names, robot.base, robot.tip

    def pose(self, q: np.ndarray) -> np.ndarray:
        """(4, 4) of the tip."""
        self.urdf.update_cfg(dict(zip(self.names, q, strict=True)))
        return np.array(self.urdf.get_transform(self.tip, self.base))

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """(6, n) [linear; angular] in the base, from where the joints' axes are."""
        p, columns = self.pose(q)[:3, 3], []
        for name in self.names:
            joint = self.urdf.joint_map[name]
            T = np.array(self.urdf.get_transform(joint.child, self.base))
            axis = T[:3, :3] @ np.array(joint.axis)
            slides = joint.type == "prismatic"
            columns.append(np.r_[axis, 0, 0, 0] if slides else np.r_[np.cross(axis, p - T[:3, 3]), axis])
        return np.array(columns).T


def brute_force(robot: ik.Robot, arm: Arm, centres: torch.Tensor, rotations: torch.Tensor, args: Any) -> torch.Tensor:
    """(cells, orientations) bool."""
    T = torch.eye(4, dtype=torch.float64).repeat(len(centres), len(rotations), 1, 1)
    T[..., :3, :3], T[..., :3, 3] = rotations, centres[:, None]
    T = T.flatten(0, 1)
    begin = time.perf_counter()
    plain = ik.LevenbergMarquardt(compiled=False, max_starts=args.starts)
    pieces = [ik.solve_ik(robot, part, solver=plain, seed=args.seed, limits=True) for part in T.split(10_000)]
    q, met = torch.cat([piece.q for piece in pieces]), torch.cat([piece.success for piece in pieces])
    seconds = time.perf_counter() - begin
    found = f"{int(met.sum()):,} of {len(T):,} poses reached, {seconds:.0f} s"
    print(f"torch, {args.starts} random starts: {found}", flush=True)
    rest = torch.nonzero(~met).flatten()
    again = ik.solve_ik(robot, T[rest], seed=args.seed + 1)
    q[rest], met[rest] = again.q, again.success
    print(f"compiled, 300 starts, on the rest: {int(again.success.sum()):,} more", flush=True)
    worst = 0.0
    for k in torch.nonzero(met).flatten()[:: max(1, int(met.sum()) // 5000)].tolist():
        worst = max(worst, float(np.abs(arm.pose(q[k].numpy()) - T[k].numpy()).max()))
    print(f"5,000 of the answers, by yourdfpy: poses off by {worst:.2g} at most")
    assert worst < 2 * TOLERANCE
    return met.view(len(centres), len(rotations))


def compare(cells: dict[str, np.ndarray], reached: np.ndarray, orientations: int) -> None:
    """Shares side by side."""
    ours, certain = np.rint(cells["share"] * orientations), np.rint(cells["unreachable"] * orientations)
    off = reached - ours
    print(f"poses reached: map {int(ours.sum()):,}, brute force {int(reached.sum()):,}")
    print(f"cells with the same share: {100 * np.mean(off == 0):.1f} %")
    print(f"largest difference: {np.abs(off).max():.0f} of {orientations} poses")
    missed, found = int(off.clip(0).sum()), int((-off).clip(0).sum())
    print(f"at least {missed} poses missed by the map, {found} by brute force")
    miss = off.clip(0).sum() / max(reached.sum(), 1)
    print(f"miss rate of the map: {1e6 * miss:.0f} of a million reached poses")
    print(f"certain claims broken: {int((reached > orientations - certain).sum())} cells")


def witnesses(arm: Arm, robot: ik.Robot, cells: dict[str, np.ndarray], q: Any, centres: Any, rotations: Any) -> None:
    """The joints that the map names: pose and condition number by yourdfpy and numpy."""
    scale = np.r_[np.full(3, 1 / robot.typical_length), np.ones(3)]
    position, rotation, condition, manipulability = 0.0, 0.0, 0.0, 0.0
    named = np.flatnonzero(cells["best_orientation"] >= 0)
    for k in named:
        T = arm.pose(q[k])
        R = rotations[cells["best_orientation"][k]].numpy()
        position = max(position, float(np.linalg.norm(T[:3, 3] - centres[k].numpy())))
        rotation = max(rotation, float(np.linalg.norm(T[:3, :3] - R) / np.sqrt(2)))
        s = np.linalg.svd(scale[:, None] * arm.jacobian(q[k]), compute_uv=False)
        condition = max(condition, abs(s[0] / s[-1] / cells["condition"][k] - 1))
        manipulability = max(manipulability, s.prod() - cells["manipulability"][k])
    print(f"joints of {len(named):,} cells: off by {position:.2g} m and {rotation:.2g} rad at most")
    print(f"condition numbers: off by {condition:.2g} of their value at most")
    assert position < 1.01 * TOLERANCE
    assert rotation < 1.01 * TOLERANCE
    assert condition < 1e-6
    assert manipulability < 1e-9, "a largest manipulability is smaller than that of the joints named"


if __name__ == "__main__":
    main()
