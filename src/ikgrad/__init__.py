"""Differentiable kinematics on PyTorch: FK, IK and exact gradients for whole tensors of poses, for any URDF.

    import ikgrad as ik

Conventions, everywhere: ``...`` is any number of batch dimensions; ``q`` is (..., n), a pose (..., 4, 4), a Jacobian
(..., 6, n); metres, radians, seconds; ``T_a_b`` is the pose of frame b in frame a; quaternions name their order
(``quat_wxyz``). Results have the dtype and device of the inputs. Names are imported on first use.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_HOME = {
    "IkgradError": "errors",
    "ShapeError": "errors",
    "UnknownNameError": "errors",
    "RobotError": "errors",
    "ConfigError": "errors",
    "DataError": "errors",
    "ConvergenceError": "errors",
    "MissingExtraError": "errors",
    "TrainingError": "errors",
    "CollisionError": "errors",
    "PlanningError": "errors",
    "Robot": "robot",
    "load_robot": "robot",
    "forward_kinematics": "kinematics",
    "link_poses": "kinematics",
    "jacobian": "kinematics",
    "pose_error": "kinematics",
    "sample_configurations": "data",
    "via_point_trajectory": "trajectory",
    "Trajectory": "trajectory",
    "solve_ik": "solvers.solve",
    "IKSolution": "solvers.solution",
    "Reason": "solvers.solution",
    "Apps": "solvers.apps",
    "NewtonRaphson": "solvers.newton",
    "LevenbergMarquardt": "solvers.levenberg",
    "Puma560ClosedForm": "solvers.closed_form",
    "puma560_ik": "solvers.puma560",
    "sphere_link_distance": "collision.distance",
    "optimize_trajectory": "planning.optimize",
    "OptimizedTrajectory": "planning.result",
    "PlanReason": "planning.result",
    "reachability": "workspace.survey",
    "WorkspaceMap": "workspace.result",
    "Inverter": "networks.inverter",
    "IncrementInverter": "networks.local",
    "UnrolledInverter": "networks.local",
    "evaluate": "evaluation",
    "load_inverter": "networks.storage",
    "export_inverter": "export.files",
    "train": "training.train",
}

_MODULES = ("collision", "data", "optim", "workspace")  # modules of their own, so that ik.optim reads like torch.optim

__all__ = [*_HOME, *_MODULES, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"ikgrad.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'ikgrad' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"ikgrad.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
