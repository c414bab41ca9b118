"""The misprints of the paper, each with what shows it."""

from __future__ import annotations

import re
from collections.abc import Mapping

import torch
from torch import Tensor

from ikgrad import optim
from ikgrad.collision import link_sphere_intersection
from ikgrad.config import TrajectoryConfig
from ikgrad.networks import MLP
from ikgrad.papers.printed import read_table
from ikgrad.papers.record import Erratum
from ikgrad.papers.trajectory.arm import VIA_TIMES, check_points, fitted_lengths, joint_places, links_through, point
from ikgrad.papers.trajectory.curves import coefficients, four_points
from ikgrad.papers.trajectory.matrix import COLUMNS, left_side_434, matrix_434
from ikgrad.papers.trajectory.networks import Ensemble
from ikgrad.papers.trajectory.spheres import SphereTest, heights_meet
from ikgrad.trajectory import via_point_trajectory

THRESHOLD_EPOCHS = 30  # of Levenberg-Marquardt, with thresholds fixed and trained


def errata(spheres: SphereTest, config: TrajectoryConfig) -> tuple[Erratum, ...]:
    """All of them, evidence computed."""
    wrong = next(row for row in check_points() if row.name == "destination_2")
    x, y, z = wrong.computed
    others = max(abs(x - wrong.printed[0]), abs(z - wrong.printed[2]))
    lengths = ", ".join(f"{length:.3f}" for length in fitted_lengths())
    gradient, threshold = hidden_delta_error(), thresholds(config)
    found = [
        (
            "Table 1, destination 2",
            "y = 16.67",
            "13.67",
            f"FK of the printed joints: y = {y:.4f}; x and z agree within {others:.4f}",
        ),
        (
            "link lengths",
            "missing",
            "10, 10, 10",
            f"least squares from three printed points: {lengths}; with 10 every coordinate is met within "
            f"{max(row.off for row in check_points()):.4f}",
        ),
        ("eq. (5), left side, rows 5 and 9", "velocities of the vias", "positions again", _left_side(config.tf)),
        (
            "eq. (5), rows 1 to 11",
            "13 entries",
            "14, a zero at the right end",
            f"padded so, no entry differs from the derivative of a monomial by more than {_matrix_error():g}; "
            f"det {torch.linalg.det(matrix_434(2.0, 5.0, 10.0)):.3g} for instants 2, 5, 10",
        ),
        ("tc, and time in segment 3", "tf - ta - tb; t - ta - tb", "tf - tb; t - tb", _last_segment(config.tf)),
        (
            "discriminant",
            "B^2 >= 4 A C",
            "B^2 >= A C",
            f"{spheres.segments:,} random lines: printed wrong {spheres.lines_wrong_printed:,} times, "
            f"corrected {spheres.lines_wrong}",
        ),
        (
            "extent of a link",
            "z between the z of its ends",
            "0 <= zeta <= 1",
            f"wrong for {spheres.heights_wrong:,} of {spheres.segments:,} random segments, falling ones and those "
            f"inside; of a level link it says nothing: {_level_links()}",
        ),
        (
            "zeta of a link through its far joint",
            "extent in zeta not given",
            "p + zeta (q - p)",
            f"as printed zeta is {_far_joint()} at the two ends of link 2",
        ),
        (
            "delta of a hidden unit",
            "sum over k = 1..1",
            "k = 1..3, the outputs",
            f"with one term the hidden gradient is off by {100 * gradient[0]:.0f} % of its size, with three by "
            f"{100 * gradient[1]:.0e} %, against autograd",
        ),
        (
            "thresholds",
            "never updated",
            "trained too",
            f"{THRESHOLD_EPOCHS} epochs of Levenberg-Marquardt, rms on the training set "
            f"{threshold[0]:.2f} unit with thresholds fixed, {threshold[1]:.2f} trained, {config.seeds} seeds, median",
        ),
        ("Table 1", "both paths", "lost: only its head is in the text", "nothing to hold our paths against"),
    ]
    return tuple(Erratum(number, *entry) for number, entry in enumerate(found, start=1))


def hidden_delta_error() -> tuple[float, float]:
    """Relative error of dE/dw of the hidden layer, with the printed sum over one output and with all three."""
    generator = torch.Generator().manual_seed(0)
    x, target = (torch.rand(64, k, dtype=torch.float64, generator=generator) for k in (5, 3))
    net = MLP((5, 30, 3), hidden="logistic", output="logistic")
    (0.5 * (net(x) - target).square().sum()).backward()
    _, hidden, y = (layer.detach() for layer in net.layers(x))
    delta = (y * (1 - y) * (target - y))[:, None]  # (N, 1, 3), the paper's delta_k
    exact = net.weights[0].grad
    assert exact is not None
    errors = []
    for terms in (1, 3):
        back = (delta[..., :terms] * net.weights[1].detach()[:, :terms]).sum(-1)
        ours = -x.mT @ (hidden * (1 - hidden) * back)
        errors.append(((ours - exact).norm() / exact.norm()).item())
    return errors[0], errors[1]


def thresholds(config: TrajectoryConfig) -> tuple[float, float]:
    """Median rms of the hand on the training set with thresholds as first drawn, and trained [unit]."""
    rms = []
    for fixed in (True, False):
        ensemble = Ensemble("hand", "Levenberg-Marquardt", config)
        network = ensemble.network
        network.biases.requires_grad_(not fixed)
        ensemble.training.optimizer = optim.LevenbergMarquardt(
            [p for p in network.parameters() if p.requires_grad], members=config.seeds
        )
        ensemble.training.run(THRESHOLD_EPOCHS, record=())
        rms.append(ensemble.train_rms().quantile(0.5).item())
    return rms[0], rms[1]


def printed_matrix(values: Mapping[str, float]) -> Tensor:
    """(14, 14) eq. (5) as printed, rows padded, with numbers for ta, tab and tc."""
    rows = read_table("trajectory_matrix_434")
    return torch.tensor([[_entry(row[name], values) for name in COLUMNS] for row in rows], dtype=torch.float64)


def _entry(text: str, values: Mapping[str, float]) -> float:
    """A cell such as ``12*ta^2``."""
    found = re.fullmatch(r"(?:(-?\d+)\*?)?(?:([a-z]+)(?:\^(\d))?)?", text)
    assert found is not None, text
    factor, name, power = found.groups()
    return float(factor or 1) * (values[name] ** int(power or 1) if name else 1.0)


def _matrix_error() -> float:
    ta, tb, tf = 2.0, 5.0, 8.0
    return (printed_matrix({"ta": ta, "tab": tb - ta, "tc": tf - tb}) - matrix_434(ta, tb, tf)).abs().max().item()


def _left_side(tf: float) -> str:
    """Jumps of the fourth joint if rows 5 and 9 get velocities, the true ones, the most favourable reading."""
    points = four_points("destination_1")
    left = left_side_434(points.mT).mT.clone()
    left[[4, 8]] = via_point_trajectory(points, [0.0, *VIA_TIMES, tf]).velocity(list(VIA_TIMES))
    C = torch.linalg.solve(matrix_434(*VIA_TIMES, tf), left)
    jumps = (C[[5, 9]] - points[1:3]).abs().rad2deg()[:, 3].tolist()
    return f"the rows give b0 and c0; with the true velocities joint 4 jumps by {jumps[0]:.0f} and {jumps[1]:.0f} deg"


def _last_segment(tf: float) -> str:
    """Where the printed local time begins segment 3, whose polynomial is right."""
    ta, tb = VIA_TIMES
    points = four_points("destination_1")
    c = coefficients(via_point_trajectory(points, [0.0, ta, tb, tf]))[9:]
    powers = torch.tensor([(-ta) ** k for k in range(5)], dtype=torch.float64)
    jump = (powers @ c - points[2]).abs().max().rad2deg().item()
    return (
        f"ta and tb are instants: the segment lasts {tf - tb:g} s, printed {tf - ta - tb:g}; its time would begin at "
        f"{-ta:g}, a jump of {jump:.0f} deg at tb"
    )


def _level_links() -> str:
    """A level link and a sphere beyond its end."""
    link = torch.tensor([[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]], dtype=torch.float64)  # link 1 at t = 0
    found = link_sphere_intersection(link, torch.tensor([[25.0, 0.0, 0.0]]).double(), torch.tensor([2.0]).double())
    claimed = bool(heights_meet(link, found.enter, found.leave)[0, 0])
    apart = found.enter.item() * 10.0 - 10.0
    return f"at t = 0 it {'meets' if claimed else 'misses'} a sphere {apart:g} units beyond its end"


def _far_joint() -> str:
    """Parameters of joints 3 and 4 on x = p_4 + (p_4 - p_3) zeta."""
    p, q = links_through(joint_places(point("via_1")))[1]
    d = q - p
    zetas = [((end - q) @ d / (d @ d)).item() for end in (p, q)]
    return " and ".join(f"{zeta + 0.0:.0f}" for zeta in zetas)


__all__ = ["errata", "hidden_delta_error", "printed_matrix", "thresholds"]
