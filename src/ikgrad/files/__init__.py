"""Pose and joint files: CSV, NPY, NPZ and Parquet, read and written piece by piece, and runs that can be resumed.

A reader gives chunks of a known total; a writer takes chunks and puts the finished file in place in one move. Nothing
here prints, and nothing that exists is overwritten unless the caller says ``force=True``.
"""

from ikgrad.files.joints import JointFile, joint_writer, open_joints
from ikgrad.files.partial import PartialRun
from ikgrad.files.places import check_output
from ikgrad.files.poses import PoseFile, open_poses, pose_writer

__all__ = [
    "JointFile",
    "PartialRun",
    "PoseFile",
    "check_output",
    "joint_writer",
    "open_joints",
    "open_poses",
    "pose_writer",
]
