"""Eq. (5) against the printed table, the four points of the arm, and the general solver."""

from __future__ import annotations

import re

import pytest
import torch
from torch import Tensor

import ikgrad as ik
from ikgrad.papers.printed import find_row, numbers, read_table
from ikgrad.papers.trajectory.matrix import COLUMNS, ROWS, left_side_434, matrix_434

INSTANTS = [(2.0, 5.0, 8.0), (2.0, 5.0, 10.0), (0.3, 0.35, 4.0)]
JOINTS = ("theta1_deg", "theta2_deg", "theta3_deg", "theta4_deg")
POINTS = ("start", "via_1", "via_2", "destination_1", "destination_2")


def joints(point: str) -> Tensor:
    """(4,) [rad] of Table 1."""
    return torch.tensor(numbers(find_row("trajectory_table1", point=point), *JOINTS), dtype=torch.float64).deg2rad()


def corrected(point: str) -> Tensor:
    """(3,) coordinates of Table 1; those of the start are not printed."""
    row = find_row("trajectory_table1", point=point)
    return torch.tensor(numbers(row, "x_printed_unit", "y_corrected_unit", "z_printed_unit"), dtype=torch.float64)


def hand(q: Tensor) -> Tensor:
    return ik.forward_kinematics(ik.load_robot("arm4"), q)[..., :3, 3]


def four_points(destination: str) -> Tensor:
    return torch.stack([joints(p) for p in ("start", "via_1", "via_2", destination)])  # (4 points, 4 joints)


def stacked(trajectory: ik.Trajectory) -> Tensor:
    """(14, n): a0 ... a4, b0 ... b3, c0 ... c4."""
    a, b, c = trajectory.coefficients
    return torch.cat([a, b[:4], c])


def printed_entry(text: str, values: dict[str, float]) -> float:
    """A cell such as ``12*ta^2``."""
    found = re.fullmatch(r"(?:(-?\d+)\*?)?(?:([a-z]+)(?:\^(\d))?)?", text)
    assert found is not None
    factor, name, power = found.groups()
    return float(factor or 1) * (values[name] ** int(power or 1) if name else 1.0)


@pytest.mark.parametrize("instants", INSTANTS)
def test_the_matrix_is_the_printed_one_in_every_entry(instants: tuple[float, float, float]):
    ta, tb, tf = instants
    values = {"ta": ta, "tab": tb - ta, "tc": tf - tb}
    table = read_table("trajectory_matrix_434")
    printed = [[printed_entry(row[column], values) for column in COLUMNS] for row in table]
    torch.testing.assert_close(matrix_434(*instants), torch.tensor(printed, dtype=torch.float64), rtol=1e-15, atol=0)


def test_both_left_sides_are_those_of_the_table():
    table = read_table("trajectory_matrix_434")
    assert [row.printed for row in ROWS] == [row["left_side_printed"] for row in table]
    assert [row.corrected for row in ROWS] == [row["left_side_corrected"] for row in table]
    assert len({row.label for row in ROWS}) == 14
    assert ROWS[4].label == "position at via 1, from after"


def test_the_determinant_is_that_of_an_independent_derivation():
    assert float(torch.linalg.det(matrix_434(2.0, 5.0, 10.0))) == pytest.approx(3.41e9, rel=1e-3)


@pytest.mark.parametrize("instants", INSTANTS)
@pytest.mark.parametrize("destination", ["destination_1", "destination_2"])
def test_the_general_solver_solves_eq_5(instants: tuple[float, float, float], destination: str):
    points = four_points(destination)
    M, left = matrix_434(*instants), left_side_434(points.mT).mT
    C = stacked(ik.via_point_trajectory(points, [0.0, *instants]))
    assert float((M @ C - left).abs().max()) < 1e-9
    theirs = torch.linalg.solve(M, left)
    torch.testing.assert_close(C, theirs, rtol=1e-9, atol=1e-10)


def test_the_printed_left_side_misses_the_vias():
    """Velocities in rows 5 and 9 become positions of b0 and c0: the curve jumps at both vias."""
    points = four_points("destination_1")
    M, left = matrix_434(2.0, 5.0, 8.0), left_side_434(points.mT).mT
    velocity = ik.via_point_trajectory(points, [0.0, 2.0, 5.0, 8.0]).velocity([2.0, 5.0])
    as_printed = left.clone()
    as_printed[4], as_printed[8] = velocity  # the most favourable reading: the true velocities
    C = torch.linalg.solve(M, as_printed)
    for row, point in ((5, 1), (9, 2)):
        assert float((C[row] - points[point]).abs().max().rad2deg()) > 5.0
    right = torch.linalg.solve(M, left)
    torch.testing.assert_close(right[[5, 9]], points[1:3], rtol=0, atol=1e-9)


def test_the_printed_duration_of_the_last_segment_ends_elsewhere():
    """tc = tf - ta - tb is 1 where the segment lasts 3; at tf = ta + tb there is no solution at all."""
    points = four_points("destination_1")
    wrong = matrix_434(2.0, 5.0, 5.0 + (8.0 - 2.0 - 5.0))
    C = torch.linalg.solve(wrong, left_side_434(points.mT).mT)[9:]
    end = sum(c * 3.0**i for i, c in enumerate(C))
    assert float((end - points[3]).abs().max()) > 1.0
    with pytest.raises(ik.ConfigError, match="instants must rise, 0 < ta < tb < tf, got 2, 5, 5"):
        matrix_434(2.0, 5.0, 5.0)


@pytest.mark.parametrize("point", POINTS[1:])
def test_fk_of_the_points_is_the_corrected_table(point: str):
    torch.testing.assert_close(hand(joints(point)), corrected(point), rtol=0, atol=0.005)


def test_fk_of_the_start_is_the_stretched_arm_and_one_printed_coordinate_is_wrong():
    torch.testing.assert_close(hand(joints("start")), torch.tensor([30.0, 0.0, 0.0]).double(), rtol=0, atol=1e-12)
    (printed,) = numbers(find_row("trajectory_table1", point="destination_2"), "y_printed_unit")
    assert float(hand(joints("destination_2"))[1]) - printed == pytest.approx(-3.0, abs=0.005)


@pytest.mark.parametrize("destination", ["destination_1", "destination_2"])
@pytest.mark.parametrize("tf", [7.0, 8.0, 10.0])
def test_the_hand_passes_the_two_specific_points(destination: str, tf: float):
    trajectory = ik.via_point_trajectory(four_points(destination), [0.0, 2.0, 5.0, tf])
    path = hand(trajectory.position([2.0, 5.0, tf]))
    wanted = torch.stack([corrected(p) for p in ("via_1", "via_2", destination)])
    torch.testing.assert_close(path, wanted, rtol=0, atol=0.005)


@pytest.mark.parametrize(("tf", "highest"), [(8.0, 72.0), (7.0, 78.0), (10.0, 68.0)])
def test_joint_values_stay_in_the_range_noted_for_the_end_time(tf: float, highest: float):
    points = torch.stack([four_points(d) for d in ("destination_1", "destination_2")])
    low, high = ik.via_point_trajectory(points, [0.0, 2.0, 5.0, tf]).extremes()
    assert float(low.min().rad2deg()) > -1.0
    assert float(high.max().rad2deg()) == pytest.approx(highest, abs=1.0)


def test_the_first_segment_changes_with_the_destination():
    first = [
        ik.via_point_trajectory(four_points(d), [0.0, 2.0, 5.0, 8.0]).position(1.0)
        for d in ("destination_1", "destination_2")
    ]
    assert float((first[0] - first[1]).abs().max().rad2deg()) > 0.1
