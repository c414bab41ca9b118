"""Trajectories around obstacles: via points moved by Gauss-Newton steps whose gradients come from autograd.

found = ik.optimize_trajectory(robot, q_start, q_goal, obstacles, link_radius=0.06)

curve     a path as a linear function of its points     problem   what a path costs, and the gradient of that
descent   damped steps, every row by itself             starts    the straight line, and detours from it
optimize  the door: `optimize_trajectory`               result    what it returns, and why rows fail
checks    where bad input is refused
"""

from __future__ import annotations

from ikgrad.planning.optimize import optimize_trajectory
from ikgrad.planning.result import OptimizedTrajectory, PlanReason

__all__ = ["OptimizedTrajectory", "PlanReason", "optimize_trajectory"]
