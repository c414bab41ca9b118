"""Yildirim and Eski (2006): five training rules for the inverse kinematics of a PUMA 560."""
