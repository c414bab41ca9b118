"""Ang, Tang, Mashohor, Arrifin 2014: a network for trajectory and forward kinematics at once, on a 4-DOF arm.

Full title: *Solving Continuous Trajectory and Forward Kinematics Simultaneously Based on ANN*.

    arm       the printed points, trajectories to destinations, places of the joints
    matrix    eq. (5), the 14 equations of a 4-3-4 trajectory, as printed and as corrected
    curves    eq. (5) solved, against its conditions and against scipy
    patterns  what the networks see            networks  two rules, three places of the arm, over seeds
    obstacle  predicted links and a sphere     spheres   the sphere test on random segments
    errata, checks, study, report, figures     what ``ikgrad reproduce trajectory`` shows
"""
