"""Distances: exact against independent oracles, differentiable to the last corner, and honest about bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck, gradgradcheck

import ikgrad as ik
from ikgrad.collision import Capsules, Spheres, sphere_link_distance
from ikgrad.collision.distance import plain_distance, segment_distance

SHAPES: list[tuple[int, ...]] = [(), (1,), (3, 1, 2), (0,)]
ORIGIN = torch.zeros(1, 3, dtype=torch.float64)
LINK = torch.tensor([[[0.0, 0, 0], [1, 0, 0]]], dtype=torch.float64)  # along x


def draw(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def scene(
    batch: tuple[int, ...] = (), *, links: int = 3, spheres: int = 5, seed: int = 0
) -> tuple[Tensor, Tensor, Tensor]:
    """Random links, centres and radii."""
    radii = 0.1 + draw(spheres, seed=seed + 2).abs()
    return draw(*batch, links, 2, 3, seed=seed), draw(spheres, 3, seed=seed + 1), radii


def by_hand(link: np.ndarray, center: np.ndarray, radius: float) -> np.longdouble:
    """Distance in extended precision, case by case."""
    p, q = (x.astype(np.longdouble) - center.astype(np.longdouble) for x in link)
    along, square = -p @ (q - p), (q - p) @ (q - p)
    nearest = p if along <= 0 else q if along >= square else p + along / square * (q - p)
    return np.sqrt(nearest @ nearest) - np.longdouble(radius)


@pytest.mark.parametrize("batch", SHAPES)
@pytest.mark.parametrize("spheres", [1, 3, 8, 9])
def test_kernel_and_torch_agree_with_extended_precision(batch: tuple[int, ...], spheres: int):
    links, centers, radii = scene(batch, spheres=spheres)
    for out in (sphere_link_distance(links, centers, radii), plain_distance(links, centers, radii, torch.tensor(0.0))):
        assert out.shape == (*batch, 3, spheres)
        rows = zip(links.reshape(-1, 2, 3), out.reshape(-1, spheres), strict=True)
        for link, row in rows:
            wanted = [by_hand(link.numpy(), o.numpy(), r) for o, r in zip(centers, radii.tolist(), strict=True)]
            np.testing.assert_allclose(row.numpy(), np.array(wanted, dtype=float), rtol=0, atol=4e-15)


@pytest.mark.parametrize("far", [0.0, 1e3, 1e6])
def test_nothing_cancels_far_from_the_origin(far: float):
    links, centers, radii = scene(links=20, spheres=20)
    links, centers = links + far, centers + far  # rounds: the oracle sees the rounded numbers
    out = sphere_link_distance(links, centers, radii).numpy()
    wanted = [[by_hand(x.numpy(), o.numpy(), float(r)) for o, r in zip(centers, radii, strict=True)] for x in links]
    np.testing.assert_allclose(out, np.array(wanted, dtype=float), rtol=0, atol=4e-15)


def test_float32_is_computed_in_float64_and_rounded_once():
    links, centers, radii = (x.float() for x in scene((50,)))
    out = sphere_link_distance(links, centers, radii)
    assert out.dtype == torch.float32
    wanted = sphere_link_distance(links.double(), centers.double(), radii.double()).float()
    assert torch.equal(out, wanted)


def test_rows_do_not_depend_on_the_batch_or_the_threads():
    links, centers, radii = scene((700,), spheres=100)
    whole = sphere_link_distance(links, centers, radii)
    torch.set_num_threads(2)
    try:
        assert torch.equal(sphere_link_distance(links, centers, radii), whole)
    finally:
        torch.set_num_threads(1)
    assert torch.equal(sphere_link_distance(links[123], centers, radii), whole[123])
    assert torch.equal(sphere_link_distance(links, centers[40:47], radii[40:47]), whole[..., 40:47])


def test_spheres_may_differ_from_row_to_row():
    links, _, radii = scene((4,))
    centers = draw(4, 5, 3, seed=9)
    out = sphere_link_distance(links, centers, radii)
    for row in range(4):
        torch.testing.assert_close(out[row], sphere_link_distance(links[row], centers[row], radii), rtol=0, atol=1e-14)


def test_a_link_radius_is_subtracted_link_by_link():
    links, centers, radii = scene((6,))
    plain, thickness = sphere_link_distance(links, centers, radii), torch.tensor([0.1, 0.0, 0.3], dtype=torch.float64)
    torch.testing.assert_close(sphere_link_distance(links, centers, radii, link_radius=0.2), plain - 0.2)
    thick = sphere_link_distance(links, centers, radii, link_radius=thickness)
    torch.testing.assert_close(thick, plain - thickness[:, None])


PLACES = {
    "beside": (0.4, 0.3, 0.2),
    "before the first end": (-0.5, 0.2, 0.1),
    "beyond the second end": (1.7, 0.2, -0.4),
    "level with the first end": (0.0, 0.3, 0.1),
    "level with the second end": (1.0, -0.2, 0.3),
    "on the line beyond the end": (1.5, 0.0, 0.0),
    "inside the capsule": (0.5, 0.01, 0.0),
    "very near the link": (0.5, 1e-5, 0.0),
}
SMOOTH = [place for place in PLACES if "level" not in place]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("obstacles", [False, True], ids=["links", "everything"])
def test_gradients_also_at_end_caps(place: str, obstacles: bool):
    center = torch.tensor([PLACES[place]], dtype=torch.float64, requires_grad=obstacles)
    radius = torch.tensor([0.1], dtype=torch.float64, requires_grad=obstacles)
    thickness = torch.tensor([0.05], dtype=torch.float64, requires_grad=obstacles)
    link = LINK.clone().requires_grad_()

    def f(link: Tensor, center: Tensor, radius: Tensor, thickness: Tensor) -> Tensor:
        return sphere_link_distance(link, center, radius, link_radius=thickness)

    eps = 1e-9 if place == "very near the link" else 1e-6
    assert gradcheck(f, (link, center, radius, thickness), eps=eps, atol=2e-4 if eps < 1e-6 else 1e-6)


@pytest.mark.parametrize("place", [p for p in SMOOTH if p != "very near the link"])
def test_second_derivatives_where_smooth(place: str):
    center = torch.tensor([PLACES[place]], dtype=torch.float64)
    radius = torch.tensor([0.1], dtype=torch.float64)
    eps = 1e-8 if place == "inside the capsule" else 1e-6
    tolerance = dict(eps=eps, atol=1e-2, rtol=1e-3) if eps < 1e-6 else dict(eps=eps, atol=1e-5)
    assert gradgradcheck(lambda x: sphere_link_distance(x, center, radius), LINK.clone().requires_grad_(), **tolerance)
    moving = [x.clone().requires_grad_() for x in (LINK, center, radius)]
    assert gradgradcheck(lambda *x: sphere_link_distance(*x), moving, **tolerance)


@pytest.mark.parametrize("length", [0.0, 1e-300, 1e-170, 1e-17, 1e-15, 1e-9])
@pytest.mark.parametrize("offset", [0.0, 1e-12, 0.4])
@pytest.mark.parametrize("moving", [False, True], ids=["links", "everything"])
def test_short_links_and_touching_centres_have_finite_gradients(length: float, offset: float, moving: bool):
    link = torch.tensor([[[0.2, 0, 0], [0.2, 0, length]]], dtype=torch.float64, requires_grad=True)
    center = torch.tensor([[0.2, offset, 0.0]], dtype=torch.float64, requires_grad=moving)
    out = sphere_link_distance(link, center, torch.tensor([0.1], dtype=torch.float64))
    assert float(out.detach()) == pytest.approx(offset - 0.1, abs=1e-15)
    (first,) = torch.autograd.grad(out, link, create_graph=True)
    assert bool(first.isfinite().all())
    pull = torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64) if offset > 0 else torch.zeros(3, dtype=torch.float64)
    torch.testing.assert_close(first[0].sum(dim=0), pull, rtol=0, atol=1e-6)
    (second,) = torch.autograd.grad(first.sum(), link)
    assert bool(second.isfinite().all())


def test_kernel_gradient_equals_that_of_torch():
    links, centers, radii = scene((40,), spheres=13)
    grad, grads = draw(40, 3, 13, seed=5), []
    for f in (sphere_link_distance, lambda *x: plain_distance(*x, torch.tensor(0.0))):
        x = links.clone().requires_grad_()
        grads.append(torch.autograd.grad(f(x, centers, radii), x, grad)[0])
    torch.testing.assert_close(grads[0], grads[1], rtol=0, atol=1e-13)


def test_transforms_of_torch_func_see_through():
    links, centers, radii = scene((6,))
    whole = sphere_link_distance(links, centers, radii)
    torch.testing.assert_close(torch.func.vmap(lambda x: sphere_link_distance(x, centers, radii))(links), whole)
    J = torch.func.vmap(torch.func.jacrev(lambda x: sphere_link_distance(x, centers, radii)))(links)
    x = links.clone().requires_grad_()
    (g,) = torch.autograd.grad(sphere_link_distance(x, centers, radii).sum(), x)
    torch.testing.assert_close(J.sum(dim=(1, 2)), g)


def dense_segment_distance(a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> float:
    """Smallest distance over a fine grid on the first segment to the second, then over a finer grid around it."""
    low, high = 0.0, 1.0
    for _ in range(6):
        s = torch.linspace(low, high, 400, dtype=torch.float64)[:, None]
        x, e = a + s * (b - a), d - c
        t = ((x - c) @ e / (e @ e)).clamp(0, 1)[:, None]
        gap = (x - c - t * e).norm(dim=-1)
        best, step = float(s[gap.argmin()]), (high - low) / 399
        low, high = max(0.0, best - step), min(1.0, best + step)
    return float(gap.min())


@pytest.mark.parametrize("tilt", [1.0, 1e-3, 1e-6, 1e-9, 0.0])
def test_distance_between_segments_equals_a_dense_search(tilt: float):
    ends = draw(200, 4, 3, seed=3)
    if tilt < 1:
        ends[:, 3] = ends[:, 2] + (ends[:, 1] - ends[:, 0]) * draw(200, 1, seed=4) + tilt * ends[:, 3]
    out = segment_distance(*ends.unbind(1))
    wanted = torch.tensor([dense_segment_distance(*row) for row in ends], dtype=torch.float64)
    torch.testing.assert_close(out, wanted, rtol=0, atol=1e-9)


def test_crossing_segments_touch_however_flat_the_angle():
    for angle in (1.0, 1e-4, 1e-8, 1e-12):
        a, b = torch.tensor([[-1.0, -angle, 0.0], [1.0, angle, 0.0]], dtype=torch.float64)
        c, d = torch.tensor([[-1.0, angle, 0.0], [1.0, -angle, 0.0]], dtype=torch.float64)
        assert float(segment_distance(a, b, c, d)) < 1e-15


def test_capsule_gradients_and_spheres_as_short_capsules():
    links, centers, radii = scene((3,))
    short = Capsules(centers[:, None].expand(-1, 2, 3), radii)
    torch.testing.assert_close(short.distance(links, 0.1), Spheres(centers, radii).distance(links, 0.1))
    ends = draw(2, 2, 3, seed=7)
    x = draw(2, 2, 3, seed=8).requires_grad_()
    assert gradcheck(lambda x: Capsules(ends, radii[:2]).distance(x), x)
    assert gradgradcheck(lambda x: Capsules(ends, radii[:2]).distance(x), x, atol=1e-4)
    parallel = LINK.clone().requires_grad_()
    out = Capsules(LINK + torch.tensor([0.0, 0.5, 0.0]), radii[:1]).distance(parallel)
    assert bool(torch.autograd.grad(out.sum(), parallel)[0].isfinite().all())


def good() -> dict[str, Tensor | float]:
    return dict(links=LINK.clone(), centers=ORIGIN.clone().repeat(2, 1), radii=torch.ones(2, dtype=torch.float64))


BAD = [
    ("links", torch.zeros(2, 3), ik.ShapeError, r"links must have shape \(\.\.\., L, 2, 3\), got \(2, 3\)"),
    ("links", torch.zeros(1, 2, 3, dtype=torch.int64), ik.ShapeError, "links must be a floating-point tensor, got"),
    ("links", [[0.0]], ik.ShapeError, "links must be a floating-point tensor, got list"),
    ("links", LINK * math.nan, ik.ConfigError, r"links must be finite, but links\[0, 0, 0\] is nan \(and 5 more\)"),
    ("centers", torch.zeros(2, 2).double(), ik.ShapeError, r"centers must have shape \(\.\.\., K, 3\), got \(2, 2\)"),
    ("centers", torch.zeros(0, 3).double(), ik.ShapeError, r"no obstacles: centers has shape \(0, 3\)"),
    ("centers", torch.tensor([[0, 0, 0], [0, math.inf, 0]]).double(), ik.ConfigError, r"but centers\[1, 1\] is inf$"),
    ("centers", torch.zeros(2, 3), ik.ShapeError, "centers must have the dtype and device of links, torch.float64"),
    ("radii", torch.ones(3).double(), ik.ShapeError, r"radii must have shape \(\.\.\., 2\) for centers of"),
    ("radii", torch.tensor([1.0, 0.0]).double(), ik.ConfigError, r"radii must be positive, but radii\[1\] is 0$"),
    ("radii", torch.tensor([-2.0, 1.0]).double(), ik.ConfigError, r"radii must be positive, but radii\[0\] is -2$"),
    ("radii", torch.tensor([1.0, math.nan]).double(), ik.ConfigError, r"radii must be finite, but radii\[1\] is nan"),
    ("link_radius", -0.1, ik.ConfigError, "link_radius must be a finite number that is not negative, got -0.1"),
    ("link_radius", torch.tensor([0.1, 0.2]).double(), ik.ShapeError, r"link_radius must have shape \(\) or"),
    ("link_radius", torch.tensor([-0.1]).double(), ik.ConfigError, r"link_radius must not be negative, but"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value", "error", "text"), BAD)
def test_bad_input_is_named(name: str, value: object, error: type[Exception], text: str):
    arguments = good() | {name: value}
    with pytest.raises(error, match=text):
        sphere_link_distance(**arguments)  # type: ignore[arg-type]


def test_obstacles_are_checked_when_they_are_made():
    with pytest.raises(ik.ConfigError, match=r"radii\[0\] is -1"):
        Spheres(ORIGIN, torch.tensor([-1.0]))
    with pytest.raises(ik.ShapeError, match=r"ends must have shape \(\.\.\., K, 2, 3\), got \(1, 3\)"):
        Capsules(ORIGIN, torch.tensor([1.0]))
    with pytest.raises(ik.ShapeError, match=r"no obstacles: ends has shape \(0, 2, 3\)"):
        Capsules(torch.zeros(0, 2, 3), torch.zeros(0))
    with pytest.raises(ik.ConfigError, match=r"ends\[0, 1, 2\] is nan"):
        Capsules(torch.tensor([[[0.0, 0, 0], [0, 0, math.nan]]]), torch.tensor([1.0]))
