"""Load every URDF file below some folders and compare forward kinematics with yourdfpy's own.

    python scripts/survey_urdfs.py FOLDER [FOLDER ...]

For each file: every leaf link as the tip, 20 random configurations, mimic joints included. Exit status 1 if a file
that yourdfpy reads does not load for a stated reason other than "no joints", or if a pose differs by more than 1e-10.
"""

from __future__ import annotations

import argparse
import collections
import logging
import sys
from pathlib import Path

import numpy as np
import torch
import yourdfpy

import ikgrad as ik

TOLERANCE = 1e-10  # [m] and entries of R, relative to the size of the robot where that exceeds 1 m


def main() -> int:
    """Survey all files and print one line for each that does not load or differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    files = sorted(path for folder in parser.parse_args().folders for path in folder.rglob("*.urdf"))
    logging.disable(logging.CRITICAL)
    outcome: collections.Counter[str] = collections.Counter()
    chains, worst = 0, 0.0
    for path in files:
        try:
            oracle = load(path)
        except Exception as error:  # whatever the parser runs into
            outcome["not read by yourdfpy"] += 1
            print(f"not read by yourdfpy: {path}: {type(error).__name__}: {error}")
            continue
        try:
            number, difference = compare(path, oracle)
        except ik.IkgradError as error:
            outcome[f"refused, {str(error).split(': ', 1)[1].split(' (')[0].split(' between')[0]}"] += 1
            print(f"refused: {error}")
            continue
        chains, worst = chains + number, max(worst, difference)
        outcome["loaded" if difference <= TOLERANCE else "differs"] += 1
        if difference > TOLERANCE:
            print(f"differs by {difference:.3g}: {path}")
    print(f"{len(files)} files: {dict(outcome)}; {chains} chains compared, largest difference {worst:.3g}")
    return int(outcome["differs"] > 0)


def load(path: Path) -> yourdfpy.URDF:
    """The file as yourdfpy sees it, with its scene graph for forward kinematics."""
    return yourdfpy.URDF.load(str(path), load_meshes=False, filename_handler=yourdfpy.filename_handler_null)


def compare(path: Path, oracle: yourdfpy.URDF) -> tuple[int, float]:
    """Number of chains in a file and the largest difference of any pose."""
    parents = {joint.parent for joint in oracle.robot.joints}
    leaves = [link.name for link in oracle.robot.links if link.name not in parents]
    number, worst, refused = 0, 0.0, None
    for leaf in leaves:
        try:
            robot = ik.load_robot(path, tip=leaf)
        except ik.RobotError as error:
            refused = error
            continue
        number += 1
        for q in ik.sample_configurations(robot, 20, seed=0):
            oracle.update_cfg(dict(zip(robot.joint_names, q.tolist(), strict=True)))
            expected = oracle.get_transform(robot.tip, robot.base)
            actual = ik.forward_kinematics(robot, q).numpy()
            worst = max(worst, np.abs(actual - expected).max() / max(1.0, np.abs(expected).max()))
    if number == 0 and refused is not None:
        raise refused
    return number, worst


if __name__ == "__main__":
    torch.set_num_threads(1)
    sys.exit(main())
