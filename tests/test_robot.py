"""Robots from URDF files and DH rows: the chain is what the file says, and bad files are refused in one line."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import torch
import yourdfpy
from support import BUILTIN, ZOO

import ikgrad as ik
from ikgrad.resources import builtin_file


def oracle_pose(path: Path, robot: ik.Robot, q: torch.Tensor) -> np.ndarray:
    urdf = yourdfpy.URDF.load(str(path), load_meshes=False, filename_handler=yourdfpy.filename_handler_null)
    urdf.update_cfg(dict(zip(robot.joint_names, q.tolist(), strict=True)))
    return urdf.get_transform(robot.tip, robot.base)


@pytest.mark.parametrize("name", BUILTIN)
def test_fk_of_built_in_robots_equals_yourdfpy(name: str):
    robot = ik.load_robot(name)
    for q in ik.sample_configurations(robot, 20, seed=1):
        expected = oracle_pose(builtin_file("urdf", name), robot, q)
        np.testing.assert_allclose(ik.forward_kinematics(robot, q).numpy(), expected, rtol=0, atol=1e-12 * robot.length)


def hand_chain(q: dict[str, float]) -> np.ndarray:
    """The zoo by hand, with the chain of mimic joints that yourdfpy does not follow to its end."""
    import trimesh.transformations as tra

    def joint(xyz, rpy, motion=np.eye(4)):
        return tra.compose_matrix(translate=xyz, angles=rpy) @ motion

    follow = -0.5 * q["turn"] + 0.25
    parts = [
        joint([0.1, 0.2, 0.3], [0.3, -0.2, 0.9]),
        joint([0, 0, 0.4], [0.1, 0, 0], tra.rotation_matrix(q["turn"], [1, 2, 2])),
        joint([0.2, 0, 0], [0, 0.5, 0], tra.translation_matrix(q["slide"] * np.array([0, -0.6, 0.8]))),
        joint([0, 0.05, 0], [0, 0, 0.7]),
        joint([0, 0, 0.3], [0, 0, 0], tra.rotation_matrix(follow, [1, 0, 0])),
        joint([0, 0.2, 0.1], [-1, 0, 0], tra.rotation_matrix(2 * follow, [0, 1, 0])),
        joint([0, 0, 0.2], [0, 0, 0], tra.rotation_matrix(q["wrist"], [0, 0, -1])),
        joint([0, 0, 0.1], [0, np.pi / 2, 0]),
    ]
    return np.linalg.multi_dot(parts)


def test_mimic_chains_slides_and_skew_axes(zoo_path: Path):
    robot = ik.load_robot(zoo_path, tip="hand")
    assert robot.joint_names == ("turn", "slide", "wrist")
    assert robot.q_min.tolist() == [-np.inf, -0.1, -2.0]
    assert robot.q_max.tolist() == [np.inf, 0.5, 1.5]
    assert robot.periodic.tolist() == [False, False, True]  # turn moves `follow` by half an angle
    for q in ik.sample_configurations(robot, 10, seed=2):
        named = dict(zip(robot.joint_names, q.tolist(), strict=True))
        np.testing.assert_allclose(ik.forward_kinematics(robot, q).numpy(), hand_chain(named), rtol=0, atol=1e-14)


def test_a_master_on_another_branch_is_still_a_variable(zoo_path: Path):
    robot = ik.load_robot(zoo_path, tip="finger")
    assert robot.joint_names == ("turn", "slide", "wrist")
    q = torch.tensor([0.3, 0.2, 1.0], dtype=torch.float64)
    expected = oracle_pose(zoo_path, robot, q)
    np.testing.assert_allclose(ik.forward_kinematics(robot, q).numpy(), expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("base", "tip"), [("c", "finger"), ("hand", "world"), ("d", "a"), ("finger", "hand")])
def test_any_two_links_can_be_base_and_tip(zoo_path: Path, base: str, tip: str):
    robot = ik.load_robot(zoo_path, base=base, tip=tip)
    assert (robot.base, robot.tip) == (base, tip)
    full = {name: ik.load_robot(zoo_path, tip=name) for name in (base, tip) if name != "world"}
    values = {"turn": 0.4, "slide": 0.25, "wrist": -0.7}

    def world_pose(link: str) -> torch.Tensor:
        if link == "world":
            return torch.eye(4, dtype=torch.float64)
        q = torch.tensor([values[name] for name in full[link].joint_names], dtype=torch.float64)
        return ik.forward_kinematics(full[link], q)

    q = torch.tensor([values[name] for name in robot.joint_names], dtype=torch.float64)
    expected = torch.linalg.inv(world_pose(base)) @ world_pose(tip)
    torch.testing.assert_close(ik.forward_kinematics(robot, q), expected, rtol=0, atol=1e-14)
    chain = robot.chain.forward_kinematics(robot.expand(q)[None]).get_matrix()[0]
    torch.testing.assert_close(chain, expected, rtol=0, atol=1e-14)


def test_chain_is_a_float64_serial_chain_of_pytorch_kinematics(robot: ik.Robot):
    import pytorch_kinematics as pk

    assert isinstance(robot.chain, pk.SerialChain)
    assert robot.chain.dtype == torch.float64
    q = ik.sample_configurations(robot, 5, seed=3)
    T = robot.chain.forward_kinematics(robot.expand(q)).get_matrix()
    torch.testing.assert_close(T, ik.forward_kinematics(robot, q), rtol=1e-14, atol=1e-14)


def test_to_changes_limits_and_chain_but_not_the_robot(panda: ik.Robot):
    single = panda.to(dtype=torch.float32)
    assert single.q_min.dtype == torch.float32
    assert single.chain.dtype == torch.float32
    assert panda.q_min.dtype == torch.float64
    assert panda.chain.dtype == torch.float64
    assert single.fingerprint == panda.fingerprint


def test_with_tool_moves_the_tip(robot: ik.Robot):
    q = ik.sample_configurations(robot, 3, seed=0)
    tool = ik.forward_kinematics(robot, q[0])
    held = robot.with_tool(tool)
    assert held.tip == "tool"
    torch.testing.assert_close(ik.forward_kinematics(held, q), ik.forward_kinematics(robot, q) @ tool)
    assert held.with_tool(tool).tip == "tool_"
    assert held.fingerprint != robot.fingerprint


def test_with_tool_refuses_what_is_no_rigid_transform(panda: ik.Robot):
    with pytest.raises(ik.RobotError, match="not a rigid transform"):
        panda.with_tool(2 * torch.eye(4))
    with pytest.raises(ik.ShapeError, match=r"must have shape \(4, 4\), got \(3, 3\)"):
        panda.with_tool(torch.eye(3))


def test_fingerprint_follows_the_meaning_of_q(zoo_path: Path, tmp_path: Path):
    original = ik.load_robot(zoo_path, tip="hand").fingerprint
    assert ik.load_robot(zoo_path, tip="hand").fingerprint == original
    for before, after in (('upper="1.5"', 'upper="1.4"'), ('xyz="0 0 0.4"', 'xyz="0 0 0.41"'), ('"turn"', '"Turn"')):
        changed = tmp_path / "changed.urdf"
        changed.write_text(ZOO.replace(before, after))
        assert ik.load_robot(changed, tip="hand").fingerprint != original
    assert ik.load_robot(zoo_path, tip="e").fingerprint != original
    cosmetic = tmp_path / "cosmetic.urdf"
    cosmetic.write_text(ZOO.replace('<robot name="zoo">', '<robot name="zoo"><!-- a note -->'))
    assert ik.load_robot(cosmetic, tip="hand").fingerprint == original


# --- Denavit-Hartenberg -------------------------------------------------------------------------------------------


def dh_rows(alpha, a, d):
    return [dict(alpha=x, a=y, d=z) for x, y, z in zip(alpha, a, d, strict=True)]


def test_modified_dh_gives_the_kr210_of_the_file():
    half = np.pi / 2
    rows = dh_rows([np.pi, half, 0, -half, half, -half], [0, 0.35, 1.15, 0.041, 0, 0], [-0.675, 0, 0, -1.2, 0, -0.215])
    robot, built_in = ik.Robot.from_dh(rows, convention="modified"), ik.load_robot("kr210")
    q = ik.sample_configurations(built_in, 10, seed=0)
    torch.testing.assert_close(ik.forward_kinematics(robot, q), ik.forward_kinematics(built_in, q))
    assert robot.q_min.tolist() == [-np.inf] * 6


def test_standard_dh_gives_the_ur5e_of_the_file():
    half = np.pi / 2
    rows = dh_rows([half, 0, 0, half, -half, 0], [0, -0.425, -0.3922, 0, 0, 0], [0.1625, 0, 0, 0.1333, 0.0997, 0.0996])
    robot, built_in = ik.Robot.from_dh(rows, convention="standard"), ik.load_robot("ur5e")
    q = ik.sample_configurations(built_in, 10, seed=0)
    torch.testing.assert_close(ik.forward_kinematics(robot, q), ik.forward_kinematics(built_in, q))


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_dh_slides_and_offsets(convention: str):
    rows = [dict(theta=0.3, d=0.2, a=0.5, alpha=0.7), dict(kind="prismatic", theta=-0.4, d=0.1, a=0.2, alpha=-1.1)]
    robot = ik.Robot.from_dh(rows, convention=convention, q_min=[-1, 0], q_max=[1, 0.6])
    q = torch.tensor([0.8, 0.35], dtype=torch.float64)

    def matrix(theta, d, a, alpha):
        rz = np.array([[np.cos(theta), -np.sin(theta), 0], [np.sin(theta), np.cos(theta), 0], [0, 0, 1]])
        rx = np.array([[1, 0, 0], [0, np.cos(alpha), -np.sin(alpha)], [0, np.sin(alpha), np.cos(alpha)]])
        z, x = np.eye(4), np.eye(4)
        z[:3, :3], z[2, 3] = rz, d
        x[:3, :3], x[0, 3] = rx, a
        return z @ x if convention == "standard" else x @ z

    expected = matrix(0.3 + 0.8, 0.2, 0.5, 0.7) @ matrix(-0.4, 0.1 + 0.35, 0.2, -1.1)
    np.testing.assert_allclose(ik.forward_kinematics(robot, q).numpy(), expected, atol=1e-15)


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        (dict(rows=[], convention="standard"), ik.RobotError, "has no DH rows"),
        (dict(rows=[dict(a=1)], convention="craig"), ik.UnknownNameError, "unknown convention 'craig'.*modified"),
        (dict(rows=[(1, 2, 3)], convention="standard"), ik.RobotError, r"row 1 must be four numbers.*got \(1, 2, 3\)"),
        (dict(rows=[dict(b=1)], convention="standard"), ik.RobotError, "DH row 1 must be four numbers"),
        (dict(rows=[dict(kind="ball")], convention="standard"), ik.RobotError, "kind 'ball', allowed are revolute"),
        (dict(rows=[dict(a=np.nan)], convention="standard"), ik.RobotError, "not finite"),
        (dict(rows=[dict(a=1)], convention="standard", q_min=[0, 1]), ik.ShapeError, r"q_min must have shape \(1,\)"),
        (dict(rows=[dict(a=1)], convention="standard", q_min=[1], q_max=[0]), ik.RobotError, "joint_1 are swapped"),
    ],
)
def test_bad_dh_rows_are_refused(arguments: dict, error: type, text: str):
    with pytest.raises(error, match=text):
        ik.Robot.from_dh(arguments.pop("rows"), **arguments)


# --- files that cannot be used ------------------------------------------------------------------------------------


def urdf(*joints: str, links: str = "abc") -> str:
    body = "".join(f'<link name="{link}"/>' for link in links)
    return f'<robot name="bad">{body}{"".join(joints)}</robot>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = "") -> str:
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>' if "limit" not in inside else ""
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{limit}{inside}</joint>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a readable URDF"),
        ("this is no XML", "not a readable URDF"),
        ("<robot name='x'>", "not a readable URDF|has no"),
        (urdf(joint("j", "a", "b"), '<xacro:hand name="h"/>'), r"is a xacro file; expand it first: xacro bad\.urdf > "),
        (urdf(), "has no joints"),
        (urdf(joint("j", "a", "b"), joint("j", "b", "c")), "joint name 'j' is used more than once"),
        (urdf(joint("j", "a", "b"), links="aab"), "link name 'a' is used more than once"),
        (urdf(joint("j", "a", "x")), "joint 'j' refers to link 'x', which does not exist"),
        (urdf(joint("j", "a", "b"), joint("k", "b", "a")), "cycle"),
        (urdf(joint("j", "a", "c"), joint("k", "b", "c")), "two parent joints, 'j' and 'k'"),
        (urdf(joint("j", "a", "b"), joint("k", "b", "c"), joint("l", "c", "b")), "two parent joints|cycle"),
        (urdf(joint("j", "a", "b"), joint("k", "c", "d"), links="abcd"), "more than one root link: a, c"),
        (urdf(joint("j", "a", "b"), joint("k", "a", "c")), r"2 leaf links below 'a'; choose one with tip=.* b, c"),
        (urdf(joint("j", "a", "b", "fixed"), links="ab"), "no moving joint between base 'a' and tip 'b'"),
        (urdf(joint("j", "a", "b", "planar"), links="ab"), "joint 'j' is of kind 'planar'.*revolute, continuous"),
        (
            urdf(joint("j", "a", "b", inside='<limit lower="1" upper="-1"/>'), links="ab"),
            "joint 'j' has limits 1 to -1: swapped",
        ),
        (urdf(joint("j", "a", "b", inside='<axis xyz="0 0 0"/>'), links="ab"), "which has no direction"),
        (urdf(joint("j", "a", "b", inside='<axis xyz="nan 0 1"/>'), links="ab"), "which has no direction"),
        (urdf(joint("j", "a", "b", inside='<origin xyz="inf 0 1"/>'), links="ab"), "origin that is not finite"),
        (urdf(joint("j", "a", "b", inside='<mimic joint="x"/>'), links="ab"), "mimics joint 'x', which does not exist"),
        (urdf(joint("j", "a", "b", inside='<mimic joint="j"/>'), links="ab"), "joint 'j' mimics itself"),
    ],
)
def test_unusable_urdf_files_are_refused_in_one_line(tmp_path: Path, caplog, text: str, message: str):
    path = tmp_path / "bad.urdf"
    path.write_text(text)
    with pytest.raises(ik.RobotError, match=message) as caught, caplog.at_level(logging.DEBUG):
        ik.load_robot(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert not caplog.records


def test_the_parser_logs_nothing_even_when_it_recovers(tmp_path: Path, caplog):
    path = tmp_path / "odd.urdf"
    path.write_text(urdf(joint("j", "a", "b"), links="ab").replace("<robot", "<!-- x --><robot") + "\n<!-- end")
    with caplog.at_level(logging.DEBUG):
        assert ik.load_robot(path).dof == 1
    assert not caplog.records


def test_what_xacro_left_in_comments_does_no_harm(tmp_path: Path):
    path = tmp_path / "expanded.urdf"
    path.write_text(urdf(joint("j", "a", "b"), "<!-- <xacro:hand/> -->", links="ab"))
    assert ik.load_robot(path).dof == 1


def test_unknown_names_come_with_the_nearest_match(zoo_path: Path):
    with pytest.raises(ik.UnknownNameError, match=r"unknown robot 'pandaa'; did you mean 'panda'\? \(known: arm4"):
        ik.load_robot("pandaa")
    with pytest.raises(ik.UnknownNameError, match=r"unknown link of zoo\.urdf 'hnad'; did you mean 'hand'"):
        ik.load_robot(zoo_path, tip="hnad")
    with pytest.raises(ik.RobotError, match="no such file"):
        ik.load_robot("no/such/arm.urdf")


def test_a_joint_without_limits_is_unlimited(tmp_path: Path):
    path = tmp_path / "free.urdf"
    inside = '<limit effort="1" velocity="1"/>'
    path.write_text(urdf(joint("j", "a", "b", inside=inside), joint("k", "b", "c", "continuous")))
    robot = ik.load_robot(path)
    assert robot.q_min.tolist() == [-np.inf, -np.inf]
    q = ik.sample_configurations(robot, 500, seed=0)
    assert -np.pi < float(q.min()) < -3
    assert 3 < float(q.max()) <= np.pi


def test_meshes_and_packages_are_not_followed(tmp_path: Path):
    visual = '<visual><geometry><mesh filename="package://nowhere/x.dae"/></geometry></visual>'
    text = urdf(joint("j", "a", "b"), links="ab").replace('<link name="b"/>', f'<link name="b">{visual}</link>')
    path = tmp_path / "mesh.urdf"
    path.write_text(text)
    assert ik.load_robot(path).dof == 1


def test_to_its_own_dtype_and_device_is_the_robot_itself(panda: ik.Robot):
    assert panda.to() is panda
    assert panda.to("cpu", torch.float64) is panda
    half = panda.to(dtype=torch.float32)
    assert half is not panda
    assert half.to(dtype=torch.float32) is half
