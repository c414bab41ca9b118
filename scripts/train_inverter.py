"""Train an inverter that starts from the present joints, on samples made on the fly, and measure it.

    python scripts/train_inverter.py panda --family unrolled --minutes 15 --threads 2 --save inverters/panda
    python scripts/train_inverter.py arm.urdf --tip tool0 --family increment --minutes 15
    python scripts/train_inverter.py panda --family unrolled --load inverters/panda       # measure only

Prints the curve while it learns, then one table for the local and one for the global task, each with plain damped steps
beside the inverter. With ``--json FILE`` also as a record.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import torch

import ikgrad as ik
from ikgrad.data import TaskStream
from ikgrad.evaluation import evaluate
from ikgrad.networks import IncrementInverter, UnrolledInverter, load_inverter
from ikgrad.training import EndlessTraining, load_checkpoint, save_checkpoint

FAMILIES = {"increment": IncrementInverter, "unrolled": UnrolledInverter}
TEST_SEED = 2**31 - 1  # no training of this script draws from it


def main() -> None:
    """Train or load, then measure."""
    options = _options()
    torch.set_num_threads(options.threads)
    robot = ik.load_robot(options.robot, base=options.base, tip=options.tip)
    stream = TaskStream(robot, batch_size=options.batch, spread=options.spread or None, seed=options.seed)
    inverter = load_inverter(options.load, robot=robot) if options.load else _train(robot, stream, options)
    if options.save:
        inverter.save(options.save, force=True)
    records = []
    for spread in (0.5, None):
        found = evaluate(inverter, TaskStream(robot, batch_size=options.count, spread=spread, seed=TEST_SEED))
        print("", *found.lines(), sep="\n", flush=True)
        records.append(found.record())
    if options.json:
        Path(options.json).write_text(json.dumps(records, indent=1) + "\n")


def _train(robot: ik.Robot, stream: TaskStream, options: argparse.Namespace) -> torch.nn.Module:
    settings = {name: getattr(options, name) for name in ("width", "depth", "rounds") if getattr(options, name)}
    inverter = FAMILIES[options.family](robot, seed=options.seed, **settings)
    training = EndlessTraining(inverter, stream, minutes=options.minutes, lr=options.lr)
    checkpoint = Path(options.checkpoint) if options.checkpoint else None
    if checkpoint and checkpoint.exists():
        training.load_state_dict(load_checkpoint(checkpoint))
    rows_a_second = _speed(stream)
    print(f"{inverter}\n{options.minutes:g} min, {options.threads} threads; stream {rows_a_second:,.0f} samples/s")
    print("step, seconds, median / 95th [mm], median / 95th [deg]")

    def watch(training: EndlessTraining) -> None:
        now = training.history[-1]
        mm, deg = (" / ".join(f"{x:.3g}" for x in pair) for pair in (now.position_mm, now.rotation_deg))
        print(f"{now.step}, {now.seconds:.0f}, {mm}, {deg}", flush=True)
        if checkpoint:
            save_checkpoint(checkpoint, training.state_dict())

    training.run(watch=watch)
    return inverter


def _speed(stream: TaskStream) -> float:
    """Samples a second, one batch of 65,536 after another."""
    large = replace(stream, batch_size=65536)
    large.batch(0)
    begun = time.perf_counter()
    large.batch(1)
    return 65536 / (time.perf_counter() - begun)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", help="built-in name or URDF file")
    parser.add_argument("--base")
    parser.add_argument("--tip")
    parser.add_argument("--family", choices=FAMILIES, default="unrolled")
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--batch", type=int, default=1024)
    parser.add_argument("--lr", type=float, default=0.016)
    parser.add_argument("--spread", type=float, default=0.5, help="rad a joint; 0: the global task")
    parser.add_argument("--width", type=int)
    parser.add_argument("--depth", type=int)
    parser.add_argument("--rounds", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=20000, help="rows to measure on")
    parser.add_argument("--save", help="folder for the inverter")
    parser.add_argument("--load", help="measure this inverter instead of training one")
    parser.add_argument("--checkpoint", help="file to go on from, written at every point of the curve")
    parser.add_argument("--json", help="file for the tables")
    return parser.parse_args()


if __name__ == "__main__":
    main()
