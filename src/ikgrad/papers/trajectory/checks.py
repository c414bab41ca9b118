"""What is claimed about the reproduction, each claim judged on the numbers of this very run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ikgrad.config import TrajectoryConfig
from ikgrad.papers.record import Check
from ikgrad.papers.trajectory.arm import REACH, PointRow
from ikgrad.papers.trajectory.curves import CurveRow
from ikgrad.papers.trajectory.networks import NetworkResult, Rule
from ikgrad.papers.trajectory.obstacle import RandomRow, VerdictRow
from ikgrad.papers.trajectory.spheres import SphereTest

PRINTED_DIGITS = 0.005  # half of the last printed digit [unit]
BARS: dict[Rule, float] = {"per-pattern": 0.3, "Levenberg-Marquardt": 0.15}  # [unit]


def check(
    points: Sequence[PointRow],
    curves: Sequence[CurveRow],
    scipy: float | None,
    hands: Mapping[Rule, NetworkResult],
    verdicts: Sequence[VerdictRow],
    random: Sequence[RandomRow],
    spheres: SphereTest,
) -> tuple[Check, ...]:
    """The claims that this run can judge: those on errors of networks need the epochs of the default settings."""
    return (
        *_kinematics(points, curves),
        *_curves(curves, scipy),
        *_networks(hands),
        *_obstacle(verdicts, random, hands),
        *_spheres(spheres),
    )


def is_full(result: NetworkResult) -> bool:
    """Whether a hand's network was trained for as long as the claims on it suppose."""
    usual = TrajectoryConfig()
    return result.epochs >= (usual.epochs if result.rule == "per-pattern" else usual.lm_epochs)


def _kinematics(points: Sequence[PointRow], curves: Sequence[CurveRow]) -> Iterator[Check]:
    off = max(row.off for row in points)
    yield Check(
        f"FK of the {len(points)} printed points within {PRINTED_DIGITS} of Table 1, corrected",
        off <= PRINTED_DIGITS,
        f"{off:.4f}; as printed {max(row.printed_off for row in points):.4f}",
    )
    hand = [max(row.hand_off[k] for row in curves) for k in range(2)]
    yield Check(
        f"the hand passes both specific points within {PRINTED_DIGITS} at t = 2 and 5, both destinations",
        max(hand) <= PRINTED_DIGITS,
        f"{hand[0]:.4f} and {hand[1]:.4f}",
    )


def _curves(curves: Sequence[CurveRow], scipy: float | None) -> Iterator[Check]:
    residual, vias = max(row.residual for row in curves), max(row.vias for row in curves)
    yield Check("eq. (5), 14 equations a joint: residual below 1e-9", residual < 1e-9, f"{residual:.1e}")
    yield Check("vias met below 1e-9 rad", vias < 1e-9, f"{vias:.1e} rad")
    v, a = max(row.velocity_jump for row in curves), max(row.acceleration_jump for row in curves)
    yield Check("velocity and acceleration continuous below 1e-8", max(v, a) < 1e-8, f"{v:.1e} rad/s, {a:.1e} rad/s^2")
    if scipy is not None:
        yield Check(
            "scipy's solution of eq. (5), clamped cubic and quintic spline: ours within 1e-9, two derivatives too",
            scipy < 1e-9,
            f"{scipy:.1e}",
        )


def _networks(hands: Mapping[Rule, NetworkResult]) -> Iterator[Check]:
    for rule, result in hands.items():
        if not is_full(result):
            continue
        worst, bar = result.worst.amax(-1), BARS[rule]
        good, seeds = int((worst <= bar).sum()), len(worst)
        yield Check(
            f"{rule}: hand within {bar:g} unit on both unseen destinations, every seed",
            good == seeds,
            f"{good} of {seeds} seeds; {worst.min():.3f} to {worst.max():.3f} unit, at most "
            f"{100 * worst.max() / REACH:.2f} % of the reach",
        )


def _obstacle(
    verdicts: Sequence[VerdictRow], random: Sequence[RandomRow], hands: Mapping[Rule, NetworkResult]
) -> Iterator[Check]:
    if not all(map(is_full, hands.values())):
        return
    for row in random:
        yield Check(
            f"{row.rule}: random spheres enlarged by the largest link error miss no contact",
            row.missed_grown == 0,
            f"by {row.grown:.2f} unit: {row.missed_grown} of {row.touching:,}; not enlarged {row.missed:,}",
        )
    right = sum(row.seeds_agreeing for row in verdicts)
    seeds = len(next(iter(hands.values())).worst)
    yield Check(
        "the obstacle: verdict on the whole trajectory as by true links, both rules and destinations, every seed",
        right == seeds * len(verdicts),
        f"{right} of {seeds * len(verdicts)}",
    )


def _spheres(spheres: SphereTest) -> Iterator[Check]:
    yield Check(
        f"sphere test against the exact distance, {spheres.segments:,} random segments: none differs",
        spheres.wrong == 0 and spheres.lines_wrong == 0,
        f"{spheres.wrong} segments, {spheres.lines_wrong} lines",
    )
    yield Check(
        "the printed discriminant does not hold",
        spheres.lines_wrong_printed > 0,
        f"wrong for {spheres.lines_wrong_printed:,} of the {spheres.lines:,} lines that meet",
    )


__all__ = ["BARS", "PRINTED_DIGITS", "check", "is_full"]
