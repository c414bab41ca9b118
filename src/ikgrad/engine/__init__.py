"""Compiled CPU kernels behind `forward_kinematics`, `jacobian` and `solve_ik`: numpy arrays in, numpy arrays out."""

from ikgrad.engine.kinematics import fk, fk_vjp, jacobian
from ikgrad.engine.solve import Solved, solve
from ikgrad.engine.tables import PackedChain, pack

__all__ = ["PackedChain", "Solved", "fk", "fk_vjp", "jacobian", "pack", "solve"]
