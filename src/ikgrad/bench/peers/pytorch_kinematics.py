"""pytorch-kinematics: the torch package that our chains are built with."""

from __future__ import annotations

import numpy as np
import torch

from ikgrad.bench.peers.base import Peer, Question, check_same_robot, foreign
from ikgrad.bench.peers.chain import limited, z_chain
from ikgrad.robot import Robot

RETRIES = 10  # starts that run side by side for every pose
PASSES = 4  # poses without a solution are given this many sets of starts


class PytorchKinematics(Peer):
    """``PseudoInverseIK`` in float64, its retries in batch, and again for the poses that are left."""

    name = "pytorch-kinematics"
    package = "pytorch-kinematics"
    module = "pytorch_kinematics"
    jobs = frozenset({"ik", "fk", "fk_backward", "jacobian"})
    batched = True
    settings = (
        f"PseudoInverseIK float64, {RETRIES} retries, clamp_to_limits, early stopping ('all'), failed rows up to "
        f"{PASSES} times; forward_kinematics_tensor and jacobian_tensor"
    )

    def check(self, robot: Robot) -> None:
        """It has no mimic joints."""
        z_chain(robot)

    def prepare(self, robot: Robot, question: Question) -> None:
        """Our chain, with finite limits: infinite ones make it answer NaN."""
        pk = foreign("pytorch_kinematics")
        robot = limited(robot)
        self._chain, self._transform, self._low, self._high = robot.chain, pk.Transform3d, robot.q_min, robot.q_max
        self._tip = self._chain._serial_eef_frame_idx
        generator = torch.Generator().manual_seed(question.seed)
        span = robot.q_max - robot.q_min
        self._solvers = [
            pk.PseudoInverseIK(
                self._chain,
                pos_tolerance=question.tol_pos,
                rot_tolerance=question.tol_rot,
                retry_configs=robot.q_min + span * torch.rand(RETRIES, robot.dof, generator=generator).double(),
                early_stopping_any_converged=True,
                early_stopping_no_improvement="all",
                clamp_to_limits=True,
                enforce_joint_limits=False,  # wraps and refines afterwards; after clamped steps that only costs time
            )
            for _ in range(PASSES)
        ]
        check_same_robot(self, robot)

    def solve(self, T: np.ndarray, q0: np.ndarray | None) -> np.ndarray:
        """Cold only: `PseudoInverseIK` takes no start for each pose apart from its retries."""
        target = torch.from_numpy(np.ascontiguousarray(T))
        q = torch.full((len(T), len(self._low)), torch.nan, dtype=torch.float64)
        left = torch.arange(len(T))
        for solver in self._solvers:
            answer = solver.solve(self._transform(matrix=target[left], dtype=torch.float64))
            every = answer.solutions
            good = answer.converged & ((every >= self._low) & (every <= self._high)).all(dim=-1)
            best = good.int().argmax(dim=1)
            rows = torch.arange(len(left))
            q[left] = every[rows, best]
            left = left[~good[rows, best]]
            if not len(left):
                break
        return q.numpy()

    def fk(self, q: np.ndarray) -> np.ndarray:
        """The tensor call: faster than ``forward_kinematics(...).get_matrix()``."""
        with torch.no_grad():
            return self._chain.forward_kinematics_tensor(torch.from_numpy(q))[self._tip].numpy()

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """The whole batch in one call."""
        with torch.no_grad():
            return self._chain.jacobian_tensor(torch.from_numpy(q)).numpy()

    def fk_backward(self, q: np.ndarray) -> np.ndarray:
        """With its analytical backward, which is its fastest."""
        leaf = torch.from_numpy(q).requires_grad_()
        self._chain.forward_kinematics_tensor(leaf)[self._tip].sum().backward()
        assert leaf.grad is not None
        return leaf.grad.numpy()
