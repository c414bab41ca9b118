"""A robot: one open chain from a base link to a tip link, frozen; see `ikgrad.segments` for the form of a chain."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from ikgrad.errors import RobotError, ShapeError, UnknownNameError
from ikgrad.resources import builtin_file, builtin_names
from ikgrad.segments import MOVING, Geometry, Segment, Tables, Variable, fold, is_pose, segment_limits

if TYPE_CHECKING:
    import pytorch_kinematics as pk
    from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False)
class Robot:
    """An open kinematic chain. Made by `load_robot` or `Robot.from_dh`, never changed.

    Attributes:
        name: name of the robot.
        base: link in which poses are given.
        segments: the chain from base to tip.
        variables: the joints that ``q`` holds, in order.
        device: device of ``q_min``, ``q_max`` and ``chain``.
        dtype: their dtype; float64 unless `to` was called.
        geometry: joint origins and tool that replace those of the segments, see `with_geometry`.
    """

    name: str
    base: str
    segments: tuple[Segment, ...]
    variables: tuple[Variable, ...]
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    dtype: torch.dtype = torch.float64
    geometry: Geometry | None = None
    _tables: dict[Any, Tables] = field(default_factory=dict, repr=False)

    @property
    def tip(self) -> str:
        """Link whose pose forward kinematics gives."""
        return next(s.link for s in reversed(self.segments) if s.link is not None)

    @property
    def dof(self) -> int:
        """Number of joint variables n."""
        return len(self.variables)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joint variables, in the order of ``q``."""
        return tuple(v.name for v in self.variables)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Links on the way from base to tip, both included, in the order of `link_poses`."""
        return (self.base, *(s.link for s in self.segments if s.link is not None))

    @cached_property
    def q_min(self) -> Tensor:
        """(n,) lower limits [rad or m], -inf where there is none."""
        return torch.tensor([v.q_min for v in self.variables], dtype=self.dtype, device=self.device)

    @cached_property
    def q_max(self) -> Tensor:
        """(n,) upper limits [rad or m], +inf where there is none."""
        return torch.tensor([v.q_max for v in self.variables], dtype=self.dtype, device=self.device)

    @cached_property
    def revolute(self) -> Tensor:
        """(n,) bool, True where the variable is an angle."""
        return torch.tensor([v.kind == "revolute" for v in self.variables], device=self.device)

    @cached_property
    def sampling_range(self) -> tuple[Tensor, Tensor]:
        """(n,) and (n,): the limits, with -pi..pi for unlimited angles and -1 m..1 m for unlimited slides."""
        span = torch.where(self.revolute, torch.pi, 1.0).to(self.q_min)
        return self.q_min.where(self.q_min.isfinite(), -span), self.q_max.where(self.q_max.isfinite(), span)

    @cached_property
    def chain(self) -> pk.SerialChain:
        """The same chain as a ``pytorch_kinematics.SerialChain`` of this dtype and device.

        Its joint vector is `expand` (q): the same as q unless there are mimic joints.
        """
        from ikgrad.pk_chain import build_chain

        return build_chain(self)

    @cached_property
    def fingerprint(self) -> str:
        """Hash of all that a joint vector means: names, order, limits, geometry, base and tip."""
        segments = [(s.link, np.asarray(s.origin).tolist(), *s[3:]) for s in self.segments]
        new = None if self.geometry is None else [t.tolist() for t in self.geometry]
        text = json.dumps([self.base, self.tip, [list(v) for v in self.variables], segments, new])
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @cached_property
    def reach_bound(self) -> float:
        """A distance from the first moving frame's origin that the tip can never exceed [m].

        The sum of the lengths of all later links, by the triangle inequality (so not the tightest); inf if a slide
        has no limit.
        """
        return self.wrist_bound + float(self.tables().tool[:3, 3].norm())

    @cached_property
    def wrist_bound(self) -> float:
        """The same for the origin of the last moving frame [m]."""
        tables = self.tables()
        length = float(tables.origins[1:, :3, 3].norm(dim=-1).sum())
        for segment in self.segments:
            if segment.kind == "prismatic":
                length += max(abs(x) for x in segment_limits(self.variables, segment))
        return length

    @cached_property
    def length(self) -> float:
        """A length that makes metres and radians comparable: the reach bound, or 1 m if that is infinite or 0."""
        return self.reach_bound if 0 < self.reach_bound < float("inf") else 1.0

    @cached_property
    def typical_length(self) -> float:
        """A quarter of the summed link lengths [m], 1 m if there are none: what damped steps divide lengths by."""
        tables = self.detach().tables()
        links = float(tables.origins[1:, :3, 3].norm(dim=-1).sum() + tables.tool[:3, 3].norm())
        return links / 4 if links > 0 else 1.0

    @property
    def requires_grad(self) -> bool:
        """True if gradients with respect to the `geometry` are wanted."""
        return self.geometry is not None and any(t.requires_grad for t in self.geometry)

    @cached_property
    def periodic(self) -> Tensor:
        """(n,) bool, True where adding 2 pi to the variable changes no pose (not so for a mimic joint's 0.5 q)."""
        turns = [True] * self.dof
        for segment in self.segments:
            if segment.kind in MOVING:
                whole = segment.kind == "revolute" and float(segment.multiplier).is_integer()
                turns[segment.variable] = turns[segment.variable] and whole
        return torch.tensor(turns, device=self.device)

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, {self.dof} joints, {self.base!r} -> {self.tip!r})"

    def tables(self, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu") -> Tables:
        """The chain as tensors of a dtype and device (kept after the first call)."""
        key = (dtype, torch.device(device))
        if key not in self._tables:
            home = (torch.float64, torch.device("cpu"))
            full = self._tables[home] if self._tables else self._tables.setdefault(home, fold(self.segments))
            self._tables[key] = Tables(*(t.to(device, dtype) if t.is_floating_point() else t.to(device) for t in full))
        before = self._tables[key]
        if self.geometry is None:
            return before
        origins, tool = (t.to(device, dtype) for t in self.geometry)
        link_offset = torch.cat([before.link_offset[:-1], tool[None]])
        return before._replace(origins=origins, tool=tool, link_offset=link_offset)

    def expand(self, q: Tensor) -> Tensor:
        """Joint values of every moving segment, mimic joints included: (..., n) -> (..., m)."""
        tables = self.tables(dtype=q.dtype, device=q.device)
        return tables.multiplier * q[..., tables.variable] + tables.offset

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Robot:
        """The same robot with limits and chain on another device or of another dtype; itself if that is no change.

        Functions follow the dtype and device of their tensors, so this is needed for ``chain``, ``q_min`` and
        ``q_max`` only.
        """
        device = self.device if device is None else torch.device(device)
        if (device, dtype or self.dtype) == (self.device, self.dtype):
            return self  # the tables that kernels keep for a robot are then found again
        return replace(self, device=device, dtype=dtype or self.dtype, _tables=self._tables)

    def with_tool(self, T_flange_tool: ArrayLike | Tensor, *, name: str = "tool") -> Robot:
        """The same robot with a tool: the tip moves to a frame fixed in the present tip.

        Args:
            T_flange_tool: (4, 4) pose of the tool in the present tip.
            name: name of the new tip link.

        Example:
            >>> import ikgrad as ik, torch
            >>> gripper = torch.eye(4); gripper[2, 3] = 0.1034
            >>> ik.load_robot("panda").with_tool(gripper).tip
            'tool'
        """
        origin = torch.as_tensor(T_flange_tool, dtype=torch.float64).detach().cpu().numpy().copy()
        if origin.shape != (4, 4):
            raise ShapeError(f"T_flange_tool must have shape (4, 4), got {origin.shape}")
        if not is_pose(origin):
            raise RobotError(f"T_flange_tool of robot '{self.name}' is not a rigid transform:\n{origin}")
        while name in self.link_names:
            name += "_"
        segment = Segment(f"{name}_joint", name, origin)
        return replace(self, segments=(*self.segments, segment), _tables={})

    def with_geometry(self, *, origins: Tensor | None = None, tool: Tensor | None = None) -> Robot:
        """The same robot with other link parameters, through which gradients flow.

        The chain is A_k = origins_k motion_k(q), T = A_1 ... A_m tool, over the m moving joints (fixed links folded
        in): ``robot.tables().origins`` and ``.tool`` are the present values. Links other than the tip keep their
        place in the moving frame that carries them. ``chain`` has the new values, detached.

        Args:
            origins: (m, 4, 4) joint origins, q = 0.
            tool: (4, 4) from the last moving frame to the tip.

        Example:
            >>> import ikgrad as ik, torch
            >>> robot = ik.load_robot("ur5e")
            >>> tool = robot.tables().tool.clone().requires_grad_()
            >>> T = ik.forward_kinematics(robot.with_geometry(tool=tool), torch.zeros(6).double())
            >>> torch.autograd.grad(T[2, 3], tool)[0][1, 3]
            tensor(1., dtype=torch.float64)
        """
        now = self.tables()
        new = Geometry(now.origins if origins is None else origins, now.tool if tool is None else tool)
        for name, value, shape in (("origins", new.origins, now.origins.shape), ("tool", new.tool, now.tool.shape)):
            if value.shape != shape:
                raise ShapeError(
                    f"{name} must have shape {tuple(shape)} for robot '{self.name}', got {tuple(value.shape)}"
                )
        return replace(self, geometry=new)

    def detach(self) -> Robot:
        """The same robot with its `geometry` cut off from autograd; itself if there is nothing to cut."""
        if self.geometry is None or not self.requires_grad:
            return self
        return replace(self, geometry=Geometry(*(t.detach() for t in self.geometry)))

    @staticmethod
    def from_dh(
        rows: Sequence[Mapping[str, Any] | Sequence[float]],
        *,
        convention: str,
        q_min: ArrayLike | None = None,
        q_max: ArrayLike | None = None,
        name: str = "robot",
    ) -> Robot:
        """A robot from Denavit-Hartenberg rows, see `ikgrad.dh.from_dh`."""
        from ikgrad.dh import from_dh

        return from_dh(rows, convention=convention, q_min=q_min, q_max=q_max, name=name)


def load_robot(name_or_path: str | Path, *, base: str | None = None, tip: str | None = None) -> Robot:
    """A built-in robot by name, or any URDF file.

    The file is parsed in float64; meshes are not opened and ``package://`` is not followed.

    Args:
        name_or_path: built-in name (``ikgrad robots`` lists them) or path of a URDF file.
        base: link in which poses are given; default: the root link.
        tip: link whose pose is solved for; default: the only leaf link. Base and tip may be any two links.

    Raises:
        UnknownNameError: no such robot, file or link.
        RobotError: the file cannot be read or describes no usable chain; several leaves and no ``tip``.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("panda")
        >>> robot.dof, robot.base, robot.tip
        (7, 'panda_link0', 'panda_link8')
    """
    path = Path(name_or_path)
    looks_like_file = path.suffix != "" or len(path.parts) > 1 or path.is_file()
    if str(name_or_path) in builtin_names("urdf"):
        path = builtin_file("urdf", str(name_or_path))
    elif not looks_like_file:
        raise UnknownNameError("robot", str(name_or_path), [*builtin_names("urdf"), "or the path of a URDF file"])
    from ikgrad.urdf import read_urdf

    return read_urdf(path, base=base, tip=tip)
