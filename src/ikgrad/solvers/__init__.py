"""Inverse kinematics: one call (`solve`), one loop (`loop`), one file per method, one result type (`solution`)."""
