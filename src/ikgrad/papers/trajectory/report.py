"""The study as tables for people: plain cells, to be printed by the command line or shown in a notebook."""

from __future__ import annotations

import torch
from torch import Tensor

from ikgrad.papers.record import Cells, Table, checks_table, misprints_table
from ikgrad.papers.trajectory.arm import DESTINATIONS, REACH, VIA_TIMES, printed_destinations, trajectories
from ikgrad.papers.trajectory.networks import RULES
from ikgrad.papers.trajectory.obstacle import CENTER, RADIUS
from ikgrad.papers.trajectory.patterns import TEST_INSTANTS
from ikgrad.papers.trajectory.study import TrajectoryStudy

EVERY = 10  # instants of Table 1


def report(study: TrajectoryStudy) -> list[Table]:
    """All tables, in the order of the paper."""
    return [
        points(study),
        curves(study),
        networks(study),
        *(table1(study, k) for k in range(len(DESTINATIONS))),
        links(study),
        obstacle(study),
        random_spheres(study),
        sphere_test(study),
        misprints_table(study.errata),
        checks_table(study.checks),
    ]


def points(study: TrajectoryStudy) -> Table:
    """The printed points against forward kinematics."""
    rows = [
        (
            row.name,
            _vector(row.joints_deg, "g"),
            _vector(row.printed, ".2f"),
            _vector(row.computed, ".4f"),
            f"{row.printed_off:.4f}",
            f"{row.off:.4f}",
        )
        for row in study.points
    ]
    columns: Cells = ("point", "joints [deg]", "printed", "FK, links of 10", "off", "off, corrected")
    return Table("Points of Table 1: largest difference of a coordinate [unit]", columns, tuple(rows), left=1)


def curves(study: TrajectoryStudy) -> Table:
    """Eq. (5) and its solution."""
    rows = [
        (
            row.destination,
            f"{row.residual:.1e}",
            f"{row.vias:.1e}",
            f"{row.velocity_jump:.1e}",
            f"{row.acceleration_jump:.1e}",
            *(f"{off:.4f}" for off in row.hand_off),
            f"{row.lowest_deg:.1f} to {row.highest_deg:.1f}",
        )
        for row in study.curves
    ]
    columns: Cells = ("4-3-4 curve to", "residual of eq. (5)", "vias [rad]", "jump of velocity", "of acceleration")
    columns += ("hand off, t = 2", "t = 5", "joint values [deg]")
    title = f"The two trajectories, instants {VIA_TIMES[0]:g}, {VIA_TIMES[1]:g} and tf = {study.config.tf:g} s"
    return Table(title, columns, tuple(rows))


def networks(study: TrajectoryStudy) -> Table:
    """Errors of all networks on the unseen destinations."""
    rows: list[Cells] = []
    for rule in RULES:
        for result in study.networks[rule].values():
            worst = result.worst.amax(-1)
            rows.append(
                (
                    rule,
                    result.target,
                    f"{result.hidden}",
                    f"{result.epochs:,}",
                    f"{result.seconds:.0f}",
                    *(_spread(result.worst[:, k]) for k in range(2)),
                    f"{100 * worst.max() / REACH:.2f}",
                    _spread(result.rms),
                    _spread(result.train_max),
                )
            )
    columns: Cells = ("rule", "place", "hidden", "epochs", "time of all [s]", "destination 1", "destination 2")
    columns += ("worst, % of reach", "rms", "on the training set")
    config = study.config
    title = (
        f"Largest error of a coordinate along the unseen destinations [unit]; paper: 0.3. Median and range of "
        f"{config.seeds} seeds, each learnt from {config.destinations} other destinations"
    )
    return Table(title, columns, tuple(rows), left=2)


def table1(study: TrajectoryStudy, destination: int) -> Table:
    """Table 1 of this run: theoretical path and the networks' answers; the body of the printed one is lost."""
    tf = study.config.tf
    shown = range(0, TEST_INSTANTS, EVERY)
    t = torch.linspace(0.0, tf, TEST_INSTANTS, dtype=torch.float64)
    q = trajectories(printed_destinations(), tf).position(t)[destination].rad2deg()
    results = [study.networks[rule]["hand"] for rule in RULES]
    paths = [results[0].truth[destination], *(r.answers[r.median_seed, destination] for r in results)]
    rows = []
    for k in shown:
        off = (f"{(path[k] - paths[0][k]).abs().max():.3f}" for path in paths[1:])
        rows.append(
            (f"{t[k]:.1f}", _vector(q[k].tolist(), ".2f"), *(_vector(p[k].tolist(), ".2f") for p in paths), *off)
        )
    columns: Cells = ("time [s]", "joints [deg]", "theoretical", *(f"{rule}" for rule in RULES), "off", "off")
    title = (
        f"Table 1, {DESTINATIONS[destination]}: its body is lost in the text, ours is printed; hand of the median seed"
    )
    return Table(title, columns, tuple(rows))


def links(study: TrajectoryStudy) -> Table:
    """Link lines from two predicted joints each."""
    rows = []
    for rule, result in study.links.items():
        lengths = result.lengths
        rows.append(
            (rule, *(_spread(result.worst[:, k]) for k in range(3)), f"{lengths.min():.2f} to {lengths.max():.2f}")
        )
    title = "Link lines from two predicted joints: largest distance of a point from where it is [unit], all seeds"
    return Table(title, ("rule", "link 1", "link 2", "link 3", "predicted lengths (10)"), tuple(rows))


def obstacle(study: TrajectoryStudy) -> Table:
    """The obstacle against both trajectories."""
    rows = [
        (
            row.rule,
            row.destination,
            _proof(row.proof, row.contact),
            f"{row.true_count}",
            f"{row.predicted_count}",
            f"{row.differing} of {row.pairs}",
            f"{row.true_clearance:.3f}",
            f"{row.predicted_clearance:.3f}",
            f"{row.seeds_agreeing} of {study.config.seeds}",
        )
        for row in study.verdicts
    ]
    columns: Cells = (
        "rule",
        "trajectory to",
        "the whole motion",
        "instants touching: true",
        "predicted",
        "verdicts that differ",
    )
    columns += ("clearance: true", "predicted", "seeds with the true verdict")
    title = f"Obstacle at {_vector(CENTER, 'g')}, radius {RADIUS:g}: {TEST_INSTANTS} instants, three links"
    return Table(title, columns, tuple(rows), left=3)


def random_spheres(study: TrajectoryStudy) -> Table:
    """Verdicts on random spheres."""
    rows = [
        (
            row.rule,
            *(f"{count:,}" for count in (row.verdicts, row.touching, row.missed, row.false)),
            f"{row.farthest:.3f}",
            f"{row.grown:.2f}",
            f"{row.missed_grown:,}",
            f"{row.false_grown:,}",
        )
        for row in study.random
    ]
    columns: Cells = (
        "rule",
        "verdicts",
        "contacts",
        "missed",
        "false",
        "farthest wrong [unit]",
        "enlarged by",
        "missed",
        "false",
    )
    return Table("Random spheres against predicted links: both trajectories, all seeds", columns, tuple(rows))


def sphere_test(study: TrajectoryStudy) -> Table:
    """The quadratic, corrected and as printed."""
    s = study.spheres
    rows = (
        ("link: corrected quadratic, 0 <= zeta <= 1", f"{s.touching:,}", f"{s.wrong:,}"),
        ("link: z between the z of its ends, as printed", f"{s.touching:,}", f"{s.heights_wrong:,}"),
        ("line: B^2 >= A C", f"{s.lines:,}", f"{s.lines_wrong:,}"),
        ("line: B^2 >= 4 A C, as printed", f"{s.lines:,}", f"{s.lines_wrong_printed:,}"),
    )
    return Table(f"Sphere test against the exact distance, {s.segments:,} random segments", ("", "meet", "wrong"), rows)


def _vector(values: tuple[float, ...] | list[float], form: str) -> str:
    return "(" + ", ".join(f"{value + 0.0:{form}}" for value in values) + ")"


def _spread(values: Tensor) -> str:
    return f"{values.quantile(0.5):.3f} ({values.min():.3f} to {values.max():.3f})"


def _proof(proof: str, contact: float) -> str:
    return proof if proof == "free" else f"{proof} at {contact:.2f} s"


__all__ = ["report"]
