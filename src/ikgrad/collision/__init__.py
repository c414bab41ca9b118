"""Links against obstacles: exact signed distances, a penalty for `solve_ik`, and proofs for whole motions.

A robot's links are segments from joint origin to joint origin, or capsules where they are given a radius; obstacles
are spheres or capsules. All distances are between surfaces and signed: negative is how deep one is in the other, with
one sign for all of it, so that ``distance <= 0`` is contact.
"""

from ikgrad.collision.distance import sphere_link_distance
from ikgrad.collision.intersection import Intersection, link_sphere_intersection
from ikgrad.collision.links import link_pairs, link_segments
from ikgrad.collision.motions import FunctionMotion, PolynomialMotion, SampledMotion
from ikgrad.collision.obstacles import Capsules, Obstacles, Spheres
from ikgrad.collision.residual import clearance_residual
from ikgrad.collision.sweep import check_motion
from ikgrad.collision.verdict import MotionCheck

__all__ = [
    "Capsules",
    "FunctionMotion",
    "Intersection",
    "MotionCheck",
    "Obstacles",
    "PolynomialMotion",
    "SampledMotion",
    "Spheres",
    "check_motion",
    "clearance_residual",
    "link_pairs",
    "link_segments",
    "link_sphere_intersection",
    "sphere_link_distance",
]
