"""What is claimed about the reproduction, each claim judged on the numbers of this very run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch

from ikgrad.kinematics import forward_kinematics
from ikgrad.papers.denso.arm import MatrixRow, denso, tool_down_ik
from ikgrad.papers.denso.networks import median
from ikgrad.papers.denso.schemes import BoxRow, PathStudy, TrackStudy
from ikgrad.papers.record import Check

TRACK_BAR_MM = 0.35
FULL_TRACK = 300  # epochs from which the claim on the helix is made


def check(
    matrices: Sequence[MatrixRow], path: PathStudy, boxes: Sequence[BoxRow], track: TrackStudy
) -> tuple[Check, ...]:
    """The claims that this run can judge: those on errors need the paper's epochs."""
    return (*_kinematics(matrices), *_path(path), *_boxes(boxes), *_track(track))


def round_trip_m() -> float:
    """Largest position error of `tool_down_ik` over 10,000 points within +-6 cm of home [m]."""
    unit = torch.rand(10_000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    p = torch.tensor([0.21, 0.0, 0.24], dtype=torch.float64) + 0.06 * (2 * unit - 1)
    q = tool_down_ik(p)
    reached = q.isfinite().all(-1)
    T = forward_kinematics(denso(), q[reached])
    return (T[:, :3, 3] - p[reached]).norm(dim=-1).max().item()


def _kinematics(matrices: Sequence[MatrixRow]) -> Iterator[Check]:
    home = next(row for row in matrices if row.name == "T_Home" and row.at == "q_home")
    yield Check("FK(q_home) = printed T_home within 1e-12", home.difference < 1e-12, f"{home.difference:.1e}")
    off = max(row.difference for row in matrices if row.name in {f"A_{k}" for k in range(1, 6)})
    yield Check("printed A_1 to A_5 are those at q = 0", off == 0.0, f"largest difference {off:g}")
    error = round_trip_m()
    yield Check("closed form, gripper down: FK of it within 1e-9 m", error < 1e-9, f"{error:.1e} m")


def _path(path: PathStudy) -> Iterator[Check]:
    seeds = len(path.traditional.mse)
    if (path.traditional.epochs, path.feedback.epochs) != (121, 68):
        return
    a, b = path.traditional.mse, path.feedback.mse
    inside = bool(((a >= 5e-6) & (a <= 3e-5)).all())
    yield Check(
        f"B: traditional MSE at 121 epochs within 5e-6 to 3e-5, {seeds} seeds",
        inside,
        f"{a.min():.2g} to {a.max():.2g}, median {median(a):.3g}",
    )
    yield Check(
        f"B: feedback MSE at 68 epochs, median of {seeds} seeds below 1e-7",
        bool(median(b) < 1e-7),
        f"median {median(b):.3g}, {b.min():.2g} to {b.max():.2g}",
    )
    ratio = (median(a) / median(b)).item()
    yield Check("B: ratio of the medians at least 50", ratio >= 50, f"{ratio:.0f}; by seed from {(a / b).min():.0f}")
    least = path.feedback.regression.min().item()
    yield Check("B: R of every feedback network at least 0.9999", least >= 0.9999, f"{least:.6f}")
    lost = int((path.lost_at >= 0).sum())
    yield Check(
        "B: in closed loop the feedback network leaves its own training path by over 10 mm (a negative result)",
        lost == seeds,
        f"{lost} of {seeds} seeds, worst errors {path.drift_mm.min():.0f} to {path.drift_mm.max():.0f} mm",
    )


def _boxes(boxes: Sequence[BoxRow]) -> Iterator[Check]:
    row = next(row for row in boxes if row.box_deg == 10.0)
    ratio = row.traditional / row.feedback[2]
    yield Check(
        "A: in the +-10 deg box with +-2 deg the gain is below 2 (a negative result)",
        ratio < 2.0,
        f"{ratio:.2f} times ({row.traditional:.2g} against {row.feedback[2]:.2g}; copying {row.copy[2]:.2g})",
    )


def _track(track: TrackStudy) -> Iterator[Check]:
    if track.feedback.epochs < FULL_TRACK:
        return
    for what, errors in (("one-step", track.one_step_mm), ("closed loop", track.closed_mm)):
        worst = errors["feedback"].amax(-1)
        good = int((worst <= TRACK_BAR_MM).sum())
        yield Check(
            f"D: helix within {TRACK_BAR_MM} mm an axis, {what}, median seed",
            bool(median(worst) <= TRACK_BAR_MM),
            f"median {median(worst):.3f} mm, {worst.min():.3f} to {worst.max():.3f}; {good} of {len(worst)} seeds",
        )


__all__ = ["check", "round_trip_m"]
