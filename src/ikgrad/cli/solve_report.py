"""What ``ikgrad solve`` says at the end, of a file or of a folder."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ikgrad.jobs.answers import Summary


def summary_rows(summary: Summary) -> list[list[str]]:
    """Rows of a table."""
    share = f" ({100 * summary.solved / summary.poses:.2f} %)" if summary.poses else ""
    rows = [["solved", f"{summary.solved:,} of {summary.poses:,}{share}"]]
    if summary.solutions > 1 and summary.poses:
        rows.append(["solutions found", f"{summary.found:,}, {summary.found / summary.poses:.2f} per pose"])
    rows += [[f"failed: {reason}", f"{number:,}"] for reason, number in summary.failed.most_common()]
    if summary.solved:
        worst = f"{summary.worst_position:.2g} m, {summary.worst_rotation:.2g} rad"
        rows.append(["worst errors of the solved", worst])
    return rows


def bad_targets(summary: Summary, repair: bool) -> list[str]:
    """Sentences about poses that are none."""
    lines = []
    worst = f"max |R^T R - I| up to {summary.worst_deviation:.3g}"
    if summary.not_finite:
        lines.append(f"{_poses(summary.not_finite)} not finite or have a number missing.")
    bent = summary.not_rigid - summary.mirrored
    if bent:
        advice = "; no rotation is near enough to repair them." if repair else "; --repair projects them."
        lines.append(f"{_poses(bent)} no rotation: {worst}{advice}")
    if summary.mirrored:
        lines.append(f"{_poses(summary.mirrored)} mirrored, or without 0 0 0 1 as last row (transposed?).")
    if summary.repaired:
        lines.append(f"{_poses(summary.repaired)} repaired: {worst}.")
    return lines


def _poses(number: int) -> str:
    return "1 pose is" if number == 1 else f"{number:,} poses are"


def summary_document(summary: Summary) -> dict[str, Any]:
    """The same for programs."""
    return {
        "poses": summary.poses,
        "solved": summary.solved,
        "solutions_found": summary.found,
        "failed": dict(summary.failed),
        "worst_position_error_m": summary.worst_position,
        "worst_rotation_error_rad": summary.worst_rotation,
        "invalid": {
            "not_finite": summary.not_finite,
            "no_rigid_transform": summary.not_rigid,
            "mirrored_or_wrong_last_row": summary.mirrored,
            "repaired": summary.repaired,
            "worst_deviation": summary.worst_deviation,
        },
    }
