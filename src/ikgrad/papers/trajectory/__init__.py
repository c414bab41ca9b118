"""Ang, Tang, Mashohor, Arrifin 2014: a network for trajectory and forward kinematics at once, on a 4-DOF arm.

Full title: *Solving Continuous Trajectory and Forward Kinematics Simultaneously Based on ANN*.

    matrix    eq. (5), the 14 equations of a 4-3-4 trajectory, as printed and as corrected
"""
