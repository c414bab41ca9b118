"""Sampling schemes: each keeps what it promises, and refuses what it cannot draw."""

from __future__ import annotations

import pytest
import torch

import ikgrad as ik
from ikgrad.data import SCHEMES, Cube, Helix, JointBox, Samples, Scheme, SmoothPath, generate

ROBOT = ik.load_robot("denso_vp6242")
HOME = tuple(torch.tensor([0.0, 90.0, 180.0, 0.0, -90.0, 0.0]).double().deg2rad().tolist())
SMALL = [
    JointBox(home=HOME, count=300),
    SmoothPath(home=HOME, count=300),
    Helix(home=HOME, count=300),
    Cube(home=HOME, count=300),
]


def draw(scheme: Scheme, robot: ik.Robot = ROBOT) -> Samples:
    return generate(robot, scheme).samples


@pytest.mark.parametrize("scheme", SMALL, ids=lambda scheme: scheme.NAME)
def test_poses_are_exactly_those_of_the_joints(scheme: Scheme):
    samples = draw(scheme)
    assert samples.q.shape == samples.q_current.shape == (300, 6)
    assert torch.equal(ik.forward_kinematics(ROBOT, samples.q), samples.T)


@pytest.mark.parametrize("scheme", SMALL, ids=lambda scheme: scheme.NAME)
def test_the_same_seed_gives_the_same_rows(scheme: Scheme):
    first, second = generate(ROBOT, scheme), generate(ROBOT, scheme)
    assert first.to_bytes() == second.to_bytes()
    other = generate(ROBOT, type(scheme)(**{**vars(scheme), "seed": 1}))
    assert not torch.equal(other.part, first.part)
    assert torch.equal(other.samples.q, first.samples.q) == isinstance(scheme, Helix)


@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("robot", ["panda", "ur5e"])
def test_every_scheme_works_for_other_arms(name: str, robot: str):
    arm = ik.load_robot(robot)
    home = {"panda": (0.0, 0.0, 0.0, -1.6, 0.0, 1.6, 0.8), "ur5e": (0.0, -1.3, 1.6, -1.9, -1.57, 0.0)}[robot]
    assert draw(SCHEMES[name](home=home, count=40), arm).q.isfinite().all()


def test_the_box_and_its_noise_fill_their_widths():
    samples = draw(JointBox(home=HOME, count=4000, half_width=0.3, noise=0.05))
    for values, width in ((samples.q - torch.tensor(HOME).double(), 0.3), (samples.q_current - samples.q, 0.05)):
        assert values.abs().max() <= width
        assert values.abs().amax(0).min() > 0.99 * width
        assert (values.mean(0).abs() < 0.05 * width).all()


def test_an_empty_home_is_the_middle_of_the_range():
    q = draw(JointBox(count=50, half_width=0.0)).q
    assert torch.allclose(q, (ROBOT.q_min + ROBOT.q_max) / 2)


def test_the_path_is_the_printed_sine_with_the_sample_before():
    scheme = SmoothPath(home=HOME, count=400, amplitude=0.2, cycles=(1.0, 2.0))
    samples = draw(scheme)
    assert torch.equal(samples.q_current[1:], samples.q[:-1])
    whole = torch.cat([samples.q_current[:1], samples.q]) - torch.tensor(HOME).double()
    spectrum = torch.fft.rfft(whole, dim=0).abs()
    assert spectrum.argmax(0).tolist() == [1, 2, 2, 2, 2, 2]  # whole turns over 401 points, the last number goes on
    assert torch.allclose(spectrum.amax(0), torch.tensor(0.2 * 401 / 2).double())


def test_noise_on_the_path_moves_the_present_joints_only():
    clean, noisy = draw(SmoothPath(home=HOME, count=400)), draw(SmoothPath(home=HOME, count=400, noise=0.01))
    assert torch.equal(clean.q, noisy.q)
    assert 0.0099 < (noisy.q_current - clean.q_current).abs().max() <= 0.01


def test_the_helix_keeps_its_shape_and_the_orientation_of_home():
    samples = draw(Helix(home=HOME, count=300, centre=(0.2, 0.01, 0.23), radius_x=0.05, radius_y=0.03, turns=2.0))
    p = samples.T[:, :3, 3] - torch.tensor([0.2, 0.01, 0.23]).double()
    assert torch.allclose((p[:, 0] / 0.05) ** 2 + (p[:, 1] / 0.03) ** 2, torch.ones(300).double(), atol=1e-9)
    assert torch.allclose(p[:, 2].diff(), torch.full((299,), 0.08 / 300).double(), atol=1e-11)
    assert torch.allclose(samples.T[:, :3, :3], torch.diag(torch.tensor([-1.0, 1.0, -1.0])).double(), atol=1e-11)
    assert torch.equal(samples.q_current[1:], samples.q[:-1])


def test_points_nearby_lie_within_the_range_of_distances():
    samples = draw(Cube(home=HOME, count=2000, half_width=0.03, nearest=0.002, farthest=0.01))
    p, nearby = (ik.forward_kinematics(ROBOT, q)[:, :3, 3] for q in (samples.q, samples.q_current))
    distance = (p - nearby).norm(dim=-1)
    assert 0.002 - 1e-9 < distance.min() < 0.0021
    assert 0.0099 < distance.max() < 0.01 + 1e-9
    assert (p - torch.tensor([0.21, 0.0, 0.24]).double()).abs().max() <= 0.03 + 1e-9


def test_points_out_of_reach_are_refused_with_the_place():
    message = r"helix: \d+ of 41 points cannot be reached by robot 'denso_vp6242' .* the first at \(\S+, \S+, \S+\) m"
    with pytest.raises(ik.DataError, match=message):
        draw(Helix(home=HOME, count=40, radius_x=0.3))


def test_points_on_two_branches_are_refused():
    samples = draw(Cube(home=HOME, count=5))
    from ikgrad.data.schemes import _refuse_jumps

    _refuse_jumps(samples.q, samples.q_current, "cube")
    flipped = samples.q_current.clone()
    flipped[3, 4] *= -1
    with pytest.raises(
        ik.DataError, match=r"cube: joints of neighbouring points differ by up to [23]\.\d\d; the points"
    ):
        _refuse_jumps(samples.q, flipped, "cube")


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: JointBox(count=0), ik.DataError, "count must be at least 1, got 0; an empty data set teaches nothing"),
        (lambda: JointBox(noise=float("nan")), ik.ConfigError, "noise must be finite, got nan"),
        (lambda: Cube(centre=(0.1, float("inf"), 0.2)), ik.ConfigError, "centre must be finite, got inf"),
        (lambda: draw(JointBox(home=(1.0, 2.0))), ik.ConfigError, "home must hold 6 values for robot 'denso_vp6242'"),
        (lambda: draw(Cube(home=HOME, centre=(0.1, 0.2))), ik.ConfigError, "centre must hold three coordinates"),
        (lambda: draw(Cube(home=HOME, nearest=0.02)), ik.ConfigError, "nearest must be between 0 and farthest, 0.01"),
        (lambda: draw(SmoothPath(cycles=())), ik.ConfigError, "cycles must hold at least one number"),
    ],
)
def test_settings_without_sense_are_refused(make, error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        make()


def test_a_cube_beyond_reach_is_refused_or_drawn_anew():
    with pytest.raises(ik.DataError, match=r"cube: \d+ of 2000 points cannot be reached by robot 'denso_vp6242'"):
        draw(Cube(home=HOME, count=1000, half_width=0.07))
    samples = draw(Cube(home=HOME, count=1000, half_width=0.07, redraw=True))
    assert samples.q.shape == (1000, 6)
    with pytest.raises(ik.DataError, match="cube: 20 of 20 points cannot be reached"):
        draw(Cube(home=HOME, count=10, centre=(2.0, 0.0, 0.0), redraw=True))
