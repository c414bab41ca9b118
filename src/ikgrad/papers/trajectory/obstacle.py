"""Link lines from two predicted joints each, and what the sphere test says of them and of the true links."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ikgrad.collision import PolynomialMotion, Spheres, check_motion, link_sphere_intersection, sphere_link_distance
from ikgrad.papers.trajectory.arm import DESTINATIONS, arm, links_through, printed_destinations, trajectories
from ikgrad.papers.trajectory.networks import NetworkResult, Rule

CENTER, RADIUS = (12.0, 7.0, 17.0), 2.0  # ours: on the way to destination 1, not on that to destination 2
RANDOM, LEAST, MOST = 500, 1.0, 4.0  # random spheres, and their radii


@dataclass(frozen=True)
class LinkResult:
    """The three links by one rule, joined from the answers of three networks of a seed.

    Attributes:
        rule: how the networks were trained.
        truth: (2, T, 3, 2, 3) both ends of every link by forward kinematics.
        predicted: (S, 2, T, 3, 2, 3) by the networks.
        shown: the seed to show, that in the middle by its largest error.
    """

    rule: Rule
    truth: Tensor
    predicted: Tensor
    shown: int

    @property
    def errors(self) -> Tensor:
        """(S, 2, T, 3) largest distance of a point of the predicted link from the same point of the true one.

        The difference of the two is linear along the link, so that it is largest at an end.
        """
        return (self.predicted - self.truth).norm(dim=-1).amax(-1)

    @property
    def worst(self) -> Tensor:
        """(S, 3) of every link."""
        return self.errors.amax((1, 2))

    @property
    def lengths(self) -> Tensor:
        """(S, 2, T, 3) of the predicted links; the true ones are 10."""
        return (self.predicted[..., 1, :] - self.predicted[..., 0, :]).norm(dim=-1)


@dataclass(frozen=True)
class VerdictRow:
    """The obstacle against one trajectory, sampled at the test instants.

    Attributes:
        destination: of the trajectory.
        rule: of the networks, those of the seed to show.
        proof: what `ikgrad.collision.check_motion` proves of the whole true motion: ``"free"`` or ``"touches"``.
        contact: true first contact [s]; infinite where free.
        true_count: instants at which a true link meets the sphere.
        predicted_count: the same of the predicted links.
        differing: pairs of instant and link for which the verdicts differ.
        pairs: of how many.
        true_clearance: smallest true distance at the instants, negative inside.
        predicted_clearance: of the predicted links.
        seeds_agreeing: seeds whose verdict on the whole trajectory is the true one.
    """

    destination: str
    rule: Rule
    proof: str
    contact: float
    true_count: int
    predicted_count: int
    differing: int
    pairs: int
    true_clearance: float
    predicted_clearance: float
    seeds_agreeing: int


@dataclass(frozen=True)
class RandomRow:
    """Verdicts on random spheres, over both trajectories, all instants, links and seeds.

    Attributes:
        rule: of the networks.
        verdicts: how many were compared.
        touching: of them, true contacts.
        missed: contacts that the predicted links do not have.
        false: contacts that they alone have.
        farthest: largest true distance from the surface, inside or out, at which a verdict was wrong [unit].
        grown: what the radii were then enlarged by: the largest link error, rounded up [unit].
        missed_grown: contacts missed after that.
        false_grown: false contacts after that.
    """

    rule: Rule
    verdicts: int
    touching: int
    missed: int
    false: int
    farthest: float
    grown: float
    missed_grown: int
    false_grown: int


def predicted_links(results: Mapping[str, NetworkResult]) -> LinkResult:
    """Join the answers of the networks for joint 3, joint 4 and the hand, seed by seed.

    Args:
        results: place to result, all by the same rule.
    """
    parts = [results[name] for name in ("joint 3", "joint 4", "hand")]
    truth, predicted = (
        links_through(torch.stack(places, dim=-2))
        for places in ([part.truth for part in parts], [part.answers for part in parts])
    )
    return LinkResult(parts[0].rule, truth, predicted, results["hand"].median_seed)


def obstacle() -> Spheres:
    """The obstacle of the study."""
    return Spheres(torch.tensor([CENTER], dtype=torch.float64), torch.tensor([RADIUS], dtype=torch.float64))


def meets(links: Tensor) -> Tensor:
    """(..., 3) whether links (..., 3, 2, 3) meet the obstacle, by the corrected quadratic."""
    ball = obstacle()
    return link_sphere_intersection(links, ball.centers, ball.radii).link_meets[..., 0]


def verdicts(links: LinkResult, tf: float) -> tuple[VerdictRow, ...]:
    """One row a destination."""
    curves = trajectories(printed_destinations(), tf)
    check = check_motion(arm(), PolynomialMotion(curves.times, curves.coefficients), obstacle())
    true, predicted = meets(links.truth), meets(links.predicted)
    true_distance, predicted_distance = (obstacle().distance(x)[..., 0] for x in (links.truth, links.predicted))
    agree = predicted.flatten(2).any(-1) == true.flatten(1).any(-1)  # (S, 2)
    seed = links.shown
    return tuple(
        VerdictRow(
            name,
            links.rule,
            "free" if bool(check.free[k]) else "touches" if bool(check.touches[k]) else "within the tolerance",
            contact=check.time[k].item(),
            true_count=int(true[k].any(-1).sum()),
            predicted_count=int(predicted[seed, k].any(-1).sum()),
            differing=int((true[k] != predicted[seed, k]).sum()),
            pairs=true[k].numel(),
            true_clearance=true_distance[k].min().item(),
            predicted_clearance=predicted_distance[seed, k].min().item(),
            seeds_agreeing=int(agree[:, k].sum()),
        )
        for k, name in enumerate(DESTINATIONS)
    )


def random_spheres(links: LinkResult, *, seed: int = 0) -> RandomRow:
    """Random spheres about the arm's way: how often are predicted links judged otherwise than true ones?

    A verdict can be wrong only where the surface is nearer to the true link than the link's error, so that spheres
    enlarged by that error miss nothing.
    """
    generator = torch.Generator().manual_seed(seed)
    low, high = links.truth.reshape(-1, 3).aminmax(dim=0)
    unit = torch.rand(RANDOM, 4, dtype=torch.float64, generator=generator)
    centers, radii = low + unit[:, :3] * (high - low), LEAST + unit[:, 3] * (MOST - LEAST)
    true = sphere_link_distance(links.truth.flatten(0, 2), centers, radii)
    grown = _round_up(links.errors.max().item())
    counts, farthest = torch.zeros(6, dtype=torch.int64), 0.0
    for each in links.predicted:
        found = sphere_link_distance(each.flatten(0, 2), centers, radii)
        wrong = (found <= 0) != (true <= 0)
        farthest = max(farthest, true[wrong].abs().amax().item() if bool(wrong.any()) else 0.0)
        hit = true <= 0
        tallies = [torch.ones_like(hit), hit, hit & (found > 0), ~hit & (found <= 0)]
        tallies += [hit & (found > grown), ~hit & (found <= grown)]
        counts += torch.stack([tally.sum() for tally in tallies])
    total, touching, missed, false, missed_grown, false_grown = counts.tolist()
    return RandomRow(links.rule, total, touching, missed, false, farthest, grown, missed_grown, false_grown)


def _round_up(value: float) -> float:
    """To a hundredth."""
    return (int(100 * value) + 1) / 100


__all__ = [
    "CENTER",
    "RADIUS",
    "LinkResult",
    "RandomRow",
    "VerdictRow",
    "meets",
    "obstacle",
    "predicted_links",
    "random_spheres",
    "verdicts",
]
