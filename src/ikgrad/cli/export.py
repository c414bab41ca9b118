"""``ikgrad export``: a trained inverter as one file for other programs."""

from __future__ import annotations

import argparse

from ikgrad.cli.inverters import add_inverter_options, load
from ikgrad.cli.parsing import Commands, example
from ikgrad.cli.terminal import print_json

DESCRIPTION = """\
a trained inverter as one file: ONNX (.onnx, needs the extra 'export') or torch.export (.pt2), by suffix.

Inputs are T (batch, 4, 4), and q_current (batch, n) for an inverter that looks at the present joints; scaling and
kinematics are inside. With --steps K the graph also takes K damped least-squares steps and measures the errors by
forward kinematics. The chain is evaluated in float64 whatever --dtype says. The file holds joint names, units, frames
and the fingerprint of the robot; it is compared with torch before it is kept."""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "export",
        help="a trained inverter as an ONNX or torch.export file",
        description=DESCRIPTION,
        epilog=example("ikgrad export panda panda.onnx\nikgrad export runs/denso denso.onnx --steps 2"),
    )
    add_inverter_options(parser)
    parser.add_argument("output", metavar="FILE", help="what to write, .onnx or .pt2")
    parser.add_argument("--steps", type=int, metavar="K", help="damped steps and the check inside the graph")
    parser.add_argument("--dtype", choices=("float32", "float64"), help="of inputs and outputs (the inverter's own)")
    parser.add_argument("--force", action="store_true", help="overwrite FILE")
    parser.add_argument("--json", action="store_true", help="print the file's metadata as one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the file."""
    import torch

    from ikgrad.export import export_inverter
    from ikgrad.export.files import SUFFIXES
    from ikgrad.files.places import check_output

    check_output(args.output, SUFFIXES, force=args.force)
    dtype = getattr(torch, args.dtype) if args.dtype else None
    done = export_inverter(load(args), args.output, steps=args.steps, dtype=dtype, force=args.force)
    if args.json:
        print_json({"output": str(done.path), "difference": done.difference, **done.metadata})
        return 0
    compared = "not compared: that needs onnxruntime; pip install 'ikgrad[export]'"
    if done.difference is not None:
        compared = f"joints differ from torch by {done.difference:.2g} at most, on 1,000 poses"
    kind = "" if args.steps is None else f", {args.steps} damped steps and the check inside"
    print(f"{done.metadata['robot']['name']}{kind} -> {done.path} ({compared})")
    return 0
