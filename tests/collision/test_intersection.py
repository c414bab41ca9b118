"""The corrected quadratic against exact distances, and the misprint caught by counting."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

import ikgrad as ik
from ikgrad.collision import link_sphere_intersection, sphere_link_distance

ROWS = 1_000_000


def pairs(rows: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """One link and one sphere a row, sized so that about a third of them meet."""
    generator = torch.Generator().manual_seed(seed)
    x = 2 * torch.rand(rows, 3, 3, dtype=torch.float64, generator=generator) - 1
    radii = 0.05 + torch.rand(rows, 1, dtype=torch.float64, generator=generator)
    return x[:, None, :2], x[:, 2:], radii


def line_distance(links: Tensor, centers: Tensor) -> Tensor:
    """Distance of the centre from the infinite line, by removing the part along the line (another way than ours)."""
    p, q = links.unbind(-2)
    u = (q - p) / (q - p).norm(dim=-1, keepdim=True)
    w = centers - p
    return (w - (w * u).sum(dim=-1, keepdim=True) * u).norm(dim=-1)


def test_a_million_random_segments_agree_with_the_exact_distance():
    links, centers, radii = pairs(ROWS)
    found = link_sphere_intersection(links, centers, radii)
    touching = sphere_link_distance(links, centers, radii) <= 0
    assert int((found.link_meets != touching).sum()) == 0
    assert 0.2 < float(touching.double().mean()) < 0.8
    assert int((found.line_meets != (line_distance(links, centers) <= radii[:, 0, None])[..., None]).sum()) == 0


def test_the_printed_discriminant_is_wrong_and_the_corrected_one_is_not():
    links, centers, radii = pairs(20_000, seed=1)
    truth = (line_distance(links, centers) <= radii)[..., None]
    printed = link_sphere_intersection(links, centers, radii, literal=True)
    corrected = link_sphere_intersection(links, centers, radii)
    assert int((corrected.line_meets != truth).sum()) == 0
    assert int((printed.line_meets != truth).sum()) > 1000
    # B^2 >= 4 A C asks for more where C > 0 and is always met where C <= 0, so it can only miss
    assert bool((printed.line_meets <= corrected.line_meets).all())


def test_roots_lie_on_the_surface_and_in_order():
    links, centers, radii = pairs(10_000, seed=2)
    found = link_sphere_intersection(links, centers, radii)
    p, q = links.unbind(-2)
    for zeta in (found.enter, found.leave):
        x = p + zeta * (q - p)
        off = ((x - centers).norm(dim=-1) - radii)[found.line_meets[..., 0]]
        scale = 3 * (1 + zeta[found.line_meets].abs())
        assert float((off / scale).abs().max()) < 1e-13
    assert bool((found.enter <= found.leave)[found.line_meets].all())
    assert bool(found.enter[~found.line_meets].isnan().all())
    assert bool(found.leave[~found.line_meets].isnan().all())


def link(*ends: tuple[float, float, float]) -> Tensor:
    return torch.tensor([ends], dtype=torch.float64)


UNIT = torch.zeros(1, 3, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
CASES = [
    ("through", link((-2, 0, 0), (2, 0, 0)), 0.25, 0.75, True, True),
    ("ends inside", link((-0.5, 0, 0), (0.5, 0, 0)), -0.5, 1.5, True, True),
    ("one end inside", link((0, 0, 0), (2, 0, 0)), -0.5, 0.5, True, True),
    ("points at it but stops short", link((-3, 0, 0), (-2, 0, 0)), 2.0, 4.0, True, False),
    ("behind it", link((2, 0, 0), (3, 0, 0)), -3.0, -1.0, True, False),
    ("grazes", link((-1, 1, 0), (1, 1, 0)), 0.5, 0.5, True, True),
    ("misses", link((-1, 1.5, 0), (1, 1.5, 0)), math.nan, math.nan, False, False),
    ("a level link", link((-2, 0.5, 0), (2, 0.5, 0)), 0.5 - 3**0.5 / 8, 0.5 + 3**0.5 / 8, True, True),
    ("a point inside", link((0.5, 0, 0), (0.5, 0, 0)), math.nan, math.nan, False, True),
    ("a point outside", link((1.5, 0, 0), (1.5, 0, 0)), math.nan, math.nan, False, False),
    ("starts on the surface, tangent", link((0, 1, 0), (1, 1, 0)), 0.0, 0.0, True, True),
]  # fmt: skip


@pytest.mark.parametrize(("name", "links", "enter", "leave", "line", "meets"), CASES, ids=[case[0] for case in CASES])
def test_cases_with_known_answers(name: str, links: Tensor, enter: float, leave: float, line: bool, meets: bool):
    found = link_sphere_intersection(links, *UNIT)
    assert (bool(found.line_meets), bool(found.link_meets)) == (line, meets)
    torch.testing.assert_close(found.enter.item(), enter, equal_nan=True)
    torch.testing.assert_close(found.leave.item(), leave, equal_nan=True)


def test_a_link_radius_makes_it_the_test_for_capsules():
    links, centers, radii = pairs(5_000, seed=3)
    thick = link_sphere_intersection(links, centers, radii, link_radius=0.2).link_meets
    assert torch.equal(thick, sphere_link_distance(links, centers, radii, link_radius=0.2) <= 0)


def test_small_roots_keep_their_digits():
    """A sphere near one end of a line 1e8 times as long: the textbook formula loses all digits of the small root."""
    links = link((0, 0, 0), (1e8, 0, 0))
    found = link_sphere_intersection(links, torch.tensor([[2.0, 0, 0]]).double(), torch.tensor([1.0]).double())
    assert found.enter.item() * 1e8 == pytest.approx(1.0, rel=1e-15)
    assert found.leave.item() * 1e8 == pytest.approx(3.0, rel=1e-15)


def test_roots_are_differentiable_where_the_line_crosses_and_finite_elsewhere():
    def roots(links: Tensor, centers: Tensor, radii: Tensor) -> Tensor:
        found = link_sphere_intersection(links, centers, radii)
        return torch.stack([found.enter, found.leave])

    through = CASES[0][1].clone().requires_grad_(), UNIT[0].clone().requires_grad_(), UNIT[1].clone().requires_grad_()
    assert gradcheck(roots, through)
    for _, links, *_ in CASES:
        x = links.clone().requires_grad_()
        out = roots(x, *UNIT)
        (g,) = torch.autograd.grad(out.nan_to_num().sum(), x)
        assert bool(g.isfinite().all())


def test_bad_input_is_refused_here_too():
    with pytest.raises(ik.ConfigError, match=r"radii\[0\] is 0"):
        link_sphere_intersection(CASES[0][1], UNIT[0], torch.zeros(1).double())
    with pytest.raises(ik.ShapeError, match="links must have shape"):
        link_sphere_intersection(torch.zeros(2, 3), *UNIT)
