"""Exported inverters: the same numbers in other programs, and all that their users must know inside."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from support import block

import ikgrad as ik
from ikgrad.cli.main import main
from ikgrad.data import TaskStream
from ikgrad.errors import MissingExtraError
from ikgrad.export import Refined, export_inverter, read_metadata
from ikgrad.networks import IncrementInverter, UnrolledInverter
from ikgrad.resources import builtin_file
from ikgrad.solvers import damped


def make(name: str = "arm4", *, feedback: bool = False, dtype: torch.dtype = torch.float32) -> ik.Inverter:
    robot = ik.load_robot(name)
    q = ik.sample_configurations(robot, 200, seed=0)
    T = ik.forward_kinematics(robot, q)
    inverter = ik.Inverter(robot, feedback=feedback, hidden=(16,), encoding="quaternion", dtype=dtype)
    current = (q.to(dtype),) if feedback else ()
    return inverter.fit(T.to(dtype), q.to(dtype), *current)


def near(robot: ik.Robot, count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Joints, their poses, and joints beside."""
    q = ik.sample_configurations(robot, count, seed=3)
    generator = torch.Generator().manual_seed(1)
    beside = q + 0.05 * torch.randn(q.shape, generator=generator, dtype=torch.float64)
    return q, ik.forward_kinematics(robot, q), beside.clamp(robot.q_min, robot.q_max)


class Copy(torch.nn.Module):
    """Answers with the present joints."""

    def __init__(self, robot: ik.Robot, dtype: torch.dtype = torch.float64):
        super().__init__()
        self.robot, self.feedback, self.dtype = robot, True, dtype
        self.weight = torch.nn.Parameter(torch.ones((), dtype=dtype))

    def forward(self, T: torch.Tensor, q_current: torch.Tensor) -> torch.Tensor:
        return q_current + 0.0


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    inverter = make()
    return inverter, export_inverter(inverter, tmp_path_factory.mktemp("plain") / "arm.onnx")


@pytest.fixture(scope="module")
def refined(tmp_path_factory):
    robot = ik.load_robot("ur5e")
    copy = Copy(robot, torch.float32)
    return robot, export_inverter(copy, tmp_path_factory.mktemp("refined") / "ur5e.onnx", steps=1)


def run(path, *arguments: torch.Tensor) -> list[np.ndarray]:
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    return session.run(None, {node.name: x.numpy() for node, x in zip(session.get_inputs(), arguments, strict=True)})


@pytest.mark.parametrize("count", [0, 1, 2, 777])
def test_onnx_is_torch_for_any_batch(plain, count):
    inverter, done = plain
    _, T, _ = near(inverter.robot, count)
    (q,) = run(done.path, T.float())
    with torch.no_grad():
        np.testing.assert_allclose(q, inverter(T.float()).numpy(), rtol=0, atol=5e-6)
    assert done.difference is not None
    assert done.difference < 5e-6


def test_the_damped_steps_inside_reach_the_pose_and_measure_it(refined):
    robot, done = refined
    _, T, beside = near(robot, 500)
    q, position, rotation = run(done.path, T.float(), beside.float())
    reached = ik.forward_kinematics(robot, torch.from_numpy(q).double())
    e = ik.pose_error(reached, T.float().double())
    before = ik.pose_error(ik.forward_kinematics(robot, beside), T)[:, :3].norm(dim=1)
    assert np.median(position) < 0.1 * before.median()
    # the answer is rounded to float32 after it was measured
    np.testing.assert_allclose(position, e[:, :3].norm(dim=1), rtol=1e-3, atol=2e-6)
    np.testing.assert_allclose(rotation, e[:, 3:].norm(dim=1), rtol=1e-3, atol=2e-6)


@pytest.mark.parametrize("name", ["panda", "ur5e", "arm4", "kr210"])
def test_refined_steps_are_the_solvers(name):
    robot = ik.load_robot(name)
    _, T, beside = near(robot, 300)
    q, position, rotation = Refined(Copy(robot), steps=3)(T, beside)
    before = ik.pose_error(ik.forward_kinematics(robot, beside), T).norm(dim=1)
    after = ik.pose_error(ik.forward_kinematics(robot, q), T)
    torch.testing.assert_close(position, after[:, :3].norm(dim=1), rtol=1e-6, atol=1e-12)
    torch.testing.assert_close(rotation, after[:, 3:].norm(dim=1), rtol=1e-6, atol=1e-7)
    assert ((q >= robot.q_min) & (q <= robot.q_max)).all()
    assert after.norm(dim=1).median() < 1e-6 * before.median()
    judge = ik.solve_ik(robot, T, q0=beside, tol_pos=1e-3, tol_rot=1e-2)
    assert (judge.steps[after.norm(dim=1) < 1e-4] <= 3).double().mean() > 0.95


def test_errors_are_those_of_the_rounded_joints():
    robot = ik.load_robot("panda")
    _, T, beside = near(robot, 50)
    q, position, _ = Refined(Copy(robot, torch.float32), steps=8)(T.float(), beside.float())
    missing = (ik.forward_kinematics(robot, q.double())[:, :3, 3] - T.float().double()[:, :3, 3]).norm(dim=-1)
    assert q.dtype == position.dtype == torch.float32
    assert missing.median() > 1e-9, "rounding to float32 must be seen"
    torch.testing.assert_close(position.double(), missing, rtol=0.05, atol=1e-10)


def test_half_a_turn_is_measured_as_such():
    robot = ik.load_robot("ur5e")
    q, T, _ = near(robot, 40)
    for turn in (torch.pi, torch.pi - 1e-5, 2.0, 1e-3):
        goal = T.clone()
        c, s = np.cos(turn), np.sin(turn)
        goal[:, :3, :3] = T[:, :3, :3] @ torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float64)
        _, _, rotation = Refined(Copy(robot), steps=0)(goal, q)
        torch.testing.assert_close(rotation, torch.full_like(rotation, turn), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("steps", [None, 0])
def test_a_pt2_file_is_torch(tmp_path, steps):
    inverter = make(feedback=True, dtype=torch.float64)
    done = export_inverter(inverter, tmp_path / "arm.pt2", steps=steps)
    assert done.difference is not None
    assert done.difference < 1e-12
    assert read_metadata(done.path) == json.loads(json.dumps(done.metadata))


def test_the_file_says_what_its_user_must_know(plain):
    inverter, done = plain
    metadata = read_metadata(done.path)
    robot = inverter.robot
    assert metadata["robot"] == {
        "name": "arm4",
        "fingerprint": robot.fingerprint,
        "joint_names": list(robot.joint_names),
        "joint_units": ["rad"] * 4,
        "base": robot.base,
        "tip": robot.tip,
    }
    assert metadata["inputs"]["T"].endswith("row-major homogeneous matrices [m]")
    assert "3 x 3 matrices" in metadata["quaternions"]
    onnx.checker.check_model(done.path)
    assert [node.name for node in onnx.load(done.path).graph.output] == ["q"]
    assert b"site-packages" not in done.path.read_bytes()
    assert str(Path(ik.__file__).parent).encode() not in done.path.read_bytes()


def test_nothing_is_overwritten(plain):
    inverter, done = plain
    before = done.path.read_bytes()
    with pytest.raises(ik.DataError, match=r"arm\.onnx: exists already"):
        export_inverter(inverter, done.path)
    assert done.path.read_bytes() == before
    assert list(done.path.parent.iterdir()) == [done.path]


def test_a_graph_that_differs_is_not_kept(tmp_path, monkeypatch):
    monkeypatch.setattr("ikgrad.export.files._difference", lambda *_: 0.5)
    with pytest.raises(ik.DataError, match=r"the exported graph differs from torch by 0\.5; it was not kept"):
        export_inverter(make(), tmp_path / "arm.pt2")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "steps", "error", "text"),
    [
        ("arm.pt", None, ik.DataError, r"unknown kind of file '\.pt' \(known: \.onnx, \.pt2\)"),
        ("none/arm.onnx", None, ik.DataError, r"the folder .* does not exist; create it first"),
        ("arm.onnx", -1, ik.ConfigError, "steps must not be negative, got -1"),
    ],
)
def test_mistakes(tmp_path, name, steps, error, text):
    with pytest.raises(error, match=text):
        export_inverter(make(), tmp_path / name, steps=steps)
    assert list(tmp_path.iterdir()) == []


def taught(family: type[IncrementInverter], robot: ik.Robot, **options: int) -> IncrementInverter:
    """An inverter whose last layer says something, without a training."""
    inverter = family(robot, **options)
    with torch.no_grad():
        inverter.network.layers[-1].bias.normal_(std=0.02, generator=torch.Generator().manual_seed(1))  # type: ignore[operator]
    return inverter


@pytest.mark.parametrize(("encoding", "steps"), [("rotation_vector", 1), ("roll_pitch_yaw", None)])
def test_float64_files_keep_all_digits(encoding: str, steps: int | None, tmp_path: Path):
    """Runtimes have no arc functions in float64, and the exporter would round bounds that are numbers to float32."""
    robot = ik.load_robot("ur5e")
    q, T, current = near(robot, 1000)
    inverter = ik.Inverter(robot, feedback=True, hidden=(8,), encoding=encoding).fit(T, q, current)
    done = export_inverter(inverter, tmp_path / "arm.onnx", steps=steps)
    session = onnxruntime.InferenceSession(done.path, providers=["CPUExecutionProvider"])
    answers = session.run(None, {"T": T.numpy(), "q_current": current.numpy()})
    with torch.no_grad():
        wanted = (inverter(T, current),) if steps is None else Refined(inverter, steps=steps)(T, current)
    for answer, value in zip(answers, wanted, strict=True):
        assert np.abs(answer - value.numpy()).max() < 1e-11
    assert done.difference is not None
    assert done.difference < 1e-11


@pytest.fixture(params=["panda", "ur5e", "kr210", "denso_vp6242", "zoo"])
def arm(request: pytest.FixtureRequest, zoo_path: Path) -> ik.Robot:
    """Four arms, and a chain with a slide, mimic joints and a joint without limits."""
    return ik.load_robot(zoo_path, tip="hand") if request.param == "zoo" else ik.load_robot(request.param)


@pytest.mark.parametrize("spread", [0.5, None], ids=["local", "global"])
@pytest.mark.parametrize("family", [IncrementInverter, UnrolledInverter])
def test_what_is_drawn_computes_what_the_kernels_compute(arm, family, spread, monkeypatch):
    T, _, q_current = TaskStream(arm, batch_size=1000, spread=spread, seed=4).batch(0)
    inverter = taught(family, arm)
    with torch.no_grad():
        compiled = inverter(T, q_current)
        monkeypatch.setattr(damped, "_compiled", None)  # nothing here may call it
        monkeypatch.setattr(damped, "no_transform", lambda: False)
        drawn = inverter(T, q_current)
    assert float((drawn - compiled).abs().max()) < 1e-9


@pytest.mark.parametrize(
    "family",
    [pytest.param(IncrementInverter, marks=pytest.mark.slow), pytest.param(UnrolledInverter, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("steps", [None, 2])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_files_of_every_family_for_every_arm(arm, family, steps, dtype, tmp_path):
    inverter = taught(family, arm)
    both(inverter, export_inverter(inverter, tmp_path / "arm.onnx", steps=steps, dtype=dtype).path, steps, dtype)


def both(inverter: IncrementInverter, path: Path, steps: int | None, dtype: torch.dtype) -> None:
    """The file against torch with its kernels, for several batch sizes."""
    model = inverter if steps is None else Refined(inverter, steps=steps)
    for count in (0, 1, 7, 1000):
        T, _, q_current = TaskStream(inverter.robot, batch_size=max(count, 1), seed=count).batch(0)
        T, q_current = T[:count].to(dtype), q_current[:count].to(dtype)
        got = run(path, T, q_current)
        with torch.no_grad():
            answer = model(T, q_current)
        wanted = (answer,) if steps is None else answer
        assert len(got) == len(wanted)
        for ours, theirs in zip(got, wanted, strict=True):
            assert ours.dtype == theirs.numpy().dtype
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=5e-6)


@pytest.fixture(scope="module")
def unrolled(zoo_path, tmp_path_factory) -> tuple[UnrolledInverter, Path]:
    """One file for many tests, since drawing takes seconds: one round and one step for the zoo."""
    inverter = taught(UnrolledInverter, ik.load_robot(zoo_path, tip="hand"), rounds=1, width=16)
    return inverter, export_inverter(inverter, tmp_path_factory.mktemp("zoo") / "zoo.onnx", steps=1).path


def test_an_inverter_that_holds_the_chain_is_torch_for_any_batch(unrolled):
    both(*unrolled, 1, torch.float32)


def test_an_increment_is_torch_for_any_batch(tmp_path):
    inverter = taught(IncrementInverter, ik.load_robot("ur5e"), width=16)
    both(inverter, export_inverter(inverter, tmp_path / "a.onnx", dtype=torch.float64).path, None, torch.float64)


def test_a_file_of_a_family_says_what_is_float32_and_what_the_joints_are(unrolled):
    inverter, path = unrolled
    metadata = read_metadata(path)
    assert metadata["robot"]["fingerprint"] == inverter.robot.fingerprint
    assert metadata["robot"]["joint_units"] == ["rad", "m", "rad"]
    assert metadata["family"] == "unrolled"
    assert (metadata["dtype"], metadata["network_dtype"], metadata["chain_dtype"]) == ("float32", "float32", "float64")
    assert metadata["inputs"]["q_current"] == "(batch, 3) present joints, in the order of joint_names"
    assert list(metadata["outputs"]) == ["q", "position_error", "rotation_error"]


def test_a_pt2_file_of_a_family_is_exact(tmp_path):
    inverter = taught(UnrolledInverter, ik.load_robot("denso_vp6242"), rounds=2)
    done = export_inverter(inverter, tmp_path / "arm.pt2", dtype=torch.float64)
    assert done.difference < 1e-9
    T, _, q_current = TaskStream(inverter.robot, batch_size=7).batch(0)
    program = torch.export.load(done.path).module()
    with torch.no_grad():
        torch.testing.assert_close(program(T, q_current), inverter(T, q_current), rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("family", "dtype", "text"),
    [
        ("classic", torch.float64, r"dtype must be torch\.float32, that of the inverter, got torch\.float64"),
        ("unrolled", torch.float16, r"dtype must be torch\.float32 or torch\.float64, got torch\.float16"),
    ],
)
def test_dtypes_that_an_inverter_does_not_take_are_refused(tmp_path, family, dtype, text):
    inverter = make() if family == "classic" else UnrolledInverter(ik.load_robot("arm4"))
    with pytest.raises(ik.ConfigError, match=text):
        export_inverter(inverter, tmp_path / "a.onnx", dtype=dtype)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("package", ["onnx", "onnxscript"])
def test_a_missing_package_is_named_with_the_extra(tmp_path, monkeypatch, package):
    block(monkeypatch, package)
    with pytest.raises(MissingExtraError, match=rf"ONNX files need {package}; pip install 'ikgrad\[export\]'"):
        export_inverter(make(), tmp_path / "arm.onnx")


@pytest.mark.parametrize("name", ["a.onnx", "a.pt2"])
def test_files_of_others_are_refused(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"not a graph")
    with pytest.raises(ik.DataError, match=f"{name}: (cannot be read|has no metadata)"):
        read_metadata(path)
    with pytest.raises(ik.DataError, match="cannot be read"):
        read_metadata(tmp_path / f"none.{name[2:]}")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved")
    make(dtype=torch.float64).save(folder / "mine")
    return folder


def test_the_command_writes_a_file_and_says_how_well_it_agrees(saved, capsys):
    out = saved / "arm.pt2"
    assert main(["export", str(saved / "mine"), str(out)]) == 0
    assert re.fullmatch(
        r"arm4 -> .*arm\.pt2 \(joints differ from torch by \S+ at most, on 1,000 poses\)\n", capsys.readouterr().out
    )
    assert main(["export", str(saved / "mine"), str(out), "--steps", "1", "--force", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["damped_steps"] == 1
    assert printed["difference"] < 1e-9
    assert read_metadata(out)["robot"] == printed["robot"]


def test_the_commands_mistakes(saved, tmp_path, capsys):
    urdf = tmp_path / "other.urdf"
    urdf.write_text(builtin_file("urdf", "arm4").read_text().replace('xyz="10 0 0"', 'xyz="11 0 0"'))
    (tmp_path / "run" / "model-0").mkdir(parents=True)
    cases = [
        ([str(tmp_path), "a.onnx"], "holds no trained inverter"),
        ([str(tmp_path / "run"), "a.onnx"], "holds 1 members; name one, such as"),
        ([str(saved / "mine"), "a.txt"], "unknown kind of file '.txt'"),
        ([str(saved / "mine"), str(tmp_path / "a.pt2"), "--robot", "ur5e"], "not for 'ur5e'"),
        (
            [str(saved / "mine"), str(tmp_path / "a.pt2"), "--robot", str(urdf)],
            "what differs: geometry of joint_",
        ),
    ]
    for arguments, text in cases:
        assert main(["export", *arguments]) == 2
        err = capsys.readouterr().err
        assert text in err
        assert err.count("\n") == 1
