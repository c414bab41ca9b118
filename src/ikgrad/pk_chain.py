"""A `Robot` as a chain of pytorch-kinematics: frames, joints and links made from the segments, in float64."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from ikgrad.segments import MOVING, Segment, segment_limits

if TYPE_CHECKING:
    import pytorch_kinematics as pk

    from ikgrad.robot import Robot


def build_chain(robot: Robot) -> pk.SerialChain:
    """Frames, joints and links of pytorch-kinematics from the segments (its own URDF reader is not used)."""
    import pytorch_kinematics as pk
    from pytorch_kinematics.frame import Frame, Joint, Link

    root = parent = Frame(robot.base, Link(robot.base))
    for k, segment in enumerate(robot.segments if robot.geometry is None else _with_new_geometry(robot)):
        name = segment.link or f"{segment.joint}/{k}"
        joint = Joint(
            name=f"{segment.joint}/{k}" if segment.link is None else segment.joint,
            offset=pk.Transform3d(matrix=torch.from_numpy(np.array(segment.origin)), dtype=torch.float64),
            joint_type=segment.kind,
            axis=segment.axis,
            dtype=torch.float64,
            limits=segment_limits(robot.variables, segment) if segment.kind in MOVING else None,
        )
        frame = Frame(name, Link(name), joint)
        parent.add_child(frame)
        parent = frame
    full = pk.chain.Chain(root, dtype=torch.float64)
    chain = pk.SerialChain(full, parent.name, robot.base, dtype=torch.float64)
    return chain.to(dtype=robot.dtype, device=robot.device)


def _with_new_geometry(robot: Robot) -> list[Segment]:
    """The moving segments and the tool with the origins of ``robot.geometry``."""
    tables = robot.tables()
    moving = [s for s in robot.segments if s.kind in MOVING]
    origins = [*tables.origins.detach().numpy(), tables.tool.detach().numpy()]
    names = [s._replace(link=None) for s in moving] + [Segment("tool_joint", robot.tip, np.eye(4))]
    return [s._replace(origin=origin) for s, origin in zip(names, origins, strict=True)]
