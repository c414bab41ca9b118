"""A URDF's own meshes: found, read, coloured, put in place, or replaced with one line that says why."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

import ikgrad as ik
from ikgrad.view import Session, Viewer, arm_parts, export_page, start_server
from ikgrad.view.meshes import PLAIN, Look, read_look
from ikgrad.view.meshfile import Piece, UnreadableError, find_mesh, read_mesh, simplified
from ikgrad.view.scene import parts_to_draw
from ikgrad.view.shapes import Triangles

BOX = (0.1, 0.2, 0.3)


def urdf(visuals: dict[str, str]) -> str:
    """base - turn - upper - slide - tip, and a hand fixed to the tip with a finger that moves."""
    links = "".join(
        f"<link name='{name}'>{visuals.get(name, '')}</link>" for name in ("base", "upper", "tip", "hand", "finger")
    )
    limit = "<limit lower='-1' upper='1' effort='1' velocity='1'/>"
    return f"""<robot name='small'>
    <material name='sky'><color rgba='0 0.5 1 1'/></material>{links}
    <joint name='turn' type='revolute'><parent link='base'/><child link='upper'/><origin xyz='0 0 0.5'/>
      <axis xyz='0 0 1'/>{limit}</joint>
    <joint name='slide' type='prismatic'><parent link='upper'/><child link='tip'/><origin xyz='0.4 0 0'/>
      <axis xyz='1 0 0'/>{limit}</joint>
    <joint name='wrist' type='fixed'><parent link='tip'/><child link='hand'/><origin xyz='0 0 0.1'/></joint>
    <joint name='grip' type='prismatic'><parent link='hand'/><child link='finger'/><origin xyz='0 0.02 0'/>
      <axis xyz='0 1 0'/>{limit}</joint></robot>"""


def visual(geometry: str, *, origin: str = "", material: str = "") -> str:
    return f"<visual>{origin}<geometry>{geometry}</geometry>{material}</visual>"


def mesh(name: str, scale: str = "") -> str:
    return f"<mesh filename='{name}'{f' scale={scale!r}' if scale else ''}/>"


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., tuple[Path, ik.Robot]]:
    def make(**visuals: str) -> tuple[Path, ik.Robot]:
        path = tmp_path / "small.urdf"
        path.write_text(urdf(visuals))
        return path, ik.load_robot(path, tip="tip")

    return make


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    """A folder of descriptions with one package."""
    folder = tmp_path / "descriptions"
    (folder / "small" / "meshes").mkdir(parents=True)
    for kind in ("stl", "obj", "glb", "ply", "dae"):
        box = trimesh.creation.box(BOX)
        (folder / "small" / "meshes" / f"box.{kind}").write_bytes(as_bytes(box.export(file_type=kind)))
    return folder


def as_bytes(data: Any) -> bytes:
    return data.encode() if isinstance(data, str) else bytes(data)


def extent(mesh: Triangles) -> np.ndarray:
    return np.asarray(mesh.vertices, dtype=np.float64).max(axis=0) - np.asarray(mesh.vertices, dtype=np.float64).min(
        axis=0
    )


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("kind", ["stl", "obj", "glb", "ply", "dae"])
def test_every_kind_is_read_with_what_is_installed(stored: Path, kind: str):
    (piece,) = read_mesh(stored / "small" / "meshes" / f"box.{kind}")
    assert extent(piece.mesh) == pytest.approx(BOX, abs=1e-6)
    corners = piece.mesh.vertices[piece.mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((normals * corners.mean(axis=1)).sum(axis=1) > 0).all()  # outwards


def test_an_stl_keeps_its_edges_and_runs_smoothly_elsewhere(stored: Path, tmp_path: Path):
    (box,) = read_mesh(stored / "small" / "meshes" / "box.stl")
    assert len(box.mesh.vertices) == 24  # every corner three times
    ball = trimesh.creation.icosphere(subdivisions=3)
    (tmp_path / "ball.stl").write_bytes(as_bytes(ball.export(file_type="stl")))
    (smooth,) = read_mesh(tmp_path / "ball.stl")
    assert len(smooth.mesh.vertices) == len(ball.vertices)


def test_the_unit_of_a_dae_counts(stored: Path):
    path = stored / "small" / "meshes" / "box.dae"
    path.write_text(path.read_text().replace("<up_axis>", '<unit name="millimeter" meter="0.001"/><up_axis>'))
    (piece,) = read_mesh(path)
    assert extent(piece.mesh) == pytest.approx(np.multiply(BOX, 1e-3), abs=1e-9)


def test_a_file_gives_a_piece_for_each_of_its_colours(tmp_path: Path):
    scene = trimesh.Scene()
    for k, colour in enumerate([(255, 0, 0, 255), (0, 0, 255, 255)]):
        part = trimesh.creation.box((0.1, 0.1, 0.1))
        part.apply_translation((k, 0, 0))
        part.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.PBRMaterial(baseColorFactor=colour)
        )
        scene.add_geometry(part)
    (tmp_path / "two.glb").write_bytes(as_bytes(scene.export(file_type="glb")))
    pieces = read_mesh(tmp_path / "two.glb")
    assert {piece.colour for piece in pieces} == {(255, 0, 0), (0, 0, 255)}


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("x.blend", b"BLENDER", "of a kind that is not read"),
        ("x.stl", b"not a mesh", "x.stl"),
        ("x.dae", b"<COLLADA", "x.dae cannot be read"),
        ("x.obj", b"v 0 0 0\n", "x.obj"),
        ("x.glb", b"", "x.glb"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path: Path, name: str, content: bytes, words: str):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UnreadableError, match=words):
        read_mesh(tmp_path / name)


@pytest.mark.parametrize(
    "name",
    ["package://small/meshes/box.stl", "package://other/small/meshes/box.stl", "descriptions/small/meshes/box.stl",
     "../descriptions/small/meshes/box.stl", "small/meshes/box.stl", r"package://small\meshes\box.stl", "FILE"],
)  # fmt: skip
def test_a_mesh_is_found_however_it_is_named(stored: Path, name: str):
    path = stored / "small" / "meshes" / "box.stl"
    name = f"file://{path}" if name == "FILE" else name
    assert find_mesh(name, stored.parent, stored).samefile(path)
    if name.startswith("package://small"):
        assert find_mesh(name, stored.parent, stored / "small").samefile(path)  # the package itself


def test_a_mesh_outside_the_folder_is_not_opened(stored: Path, tmp_path: Path):
    (tmp_path / "secret.stl").write_text("solid")
    for name in ("../secret.stl", str(tmp_path / "secret.stl"), "secret.stl", "package://../secret.stl"):
        with pytest.raises(UnreadableError, match="is not under"):
            find_mesh(name, tmp_path, stored)
    (stored / "link.stl").symlink_to(tmp_path / "secret.stl")
    with pytest.raises(UnreadableError, match="is not under"):
        find_mesh("link.stl", tmp_path, stored)


def test_simplification_keeps_the_shape():
    ball = trimesh.creation.icosphere(subdivisions=5)
    piece = Piece(Triangles(np.asarray(ball.vertices), np.asarray(ball.faces)), None)
    small = simplified(piece, 0.1)
    assert 200 < len(small.mesh.faces) <= 0.1 * len(ball.faces)
    assert np.linalg.norm(small.mesh.vertices, axis=1) == pytest.approx(np.ones(len(small.mesh.vertices)), abs=1e-9)
    assert trimesh.Trimesh(*small.mesh).volume == pytest.approx(ball.volume, rel=0.1)


# ---------------------------------------------------------------- looks


def test_scale_origin_and_colour_are_those_of_the_urdf(make: Any, stored: Path):
    half_turn = "<origin xyz='1 2 3' rpy='0 0 1.5707963267948966'/>"
    path, robot = make(
        base=visual(mesh("package://small/meshes/box.stl", "2 1 1"), material="<material name='sky'/>"),
        upper=visual(mesh("package://small/meshes/box.obj"), origin=half_turn),
        tip=visual(mesh("package://small/meshes/box.stl", "-1 1 1")),
    )
    look = read_look(path, robot, stored)
    assert (look.missing, look.notes) == (frozenset(), ())
    base, upper, tip = look.visuals
    assert [v.link for v in look.visuals] == [robot.link_names.index(name) for name in ("base", "upper", "tip")]
    assert (extent(base.mesh), base.colour) == (pytest.approx((0.2, 0.2, 0.3)), (0, 128, 255))
    assert extent(upper.mesh) == pytest.approx((0.2, 0.1, 0.3))
    assert upper.mesh.vertices.mean(axis=0) == pytest.approx((1, 2, 3))
    assert tip.colour == PLAIN
    a, b, c = tip.mesh.vertices.astype(np.float64)[tip.mesh.faces].transpose(1, 0, 2)
    assert (a * np.cross(b, c)).sum() > 0  # mirrored, and still outwards


def test_bodies_are_drawn_and_so_is_what_hangs_on_the_arm(make: Any, tmp_path: Path):
    path, robot = make(
        base=visual("<box size='1 2 3'/>"),
        upper=visual("<cylinder radius='0.1' length='2'/>"),
        hand=visual("<sphere radius='0.3'/>", material="<material name='m'><color rgba='1 0 0 1'/></material>"),
        finger=visual("<box size='0.01 0.01 0.01'/>"),
    )
    look = read_look(path, robot, tmp_path)
    sizes = {v.colour: extent(v.mesh) for v in look.visuals if v.link == 2}
    assert extent(look.visuals[0].mesh) == pytest.approx((1, 2, 3))
    assert extent(look.visuals[1].mesh) == pytest.approx((0.2, 0.2, 2), abs=1e-3)
    assert sizes[(255, 0, 0)] == pytest.approx((0.6, 0.6, 0.6), abs=1e-2)
    finger = next(v for v in look.visuals if v.link == 2 and v.colour == PLAIN)
    assert finger.mesh.vertices.mean(axis=0) == pytest.approx((0, 0.02, 0.1), abs=1e-6)  # in the frame of the tip


def test_from_another_base_every_mesh_is_where_it_was(make: Any, stored: Path):
    """The chain the other way round: meshes move with their own links."""
    visuals = {name: visual(mesh("box.stl")) for name in ("base", "upper", "tip", "hand")}
    path, robot = make(**visuals)
    back = ik.load_robot(path, base="hand", tip="base")
    q = torch.tensor([0.3, 0.2], dtype=torch.float64)

    def middles(robot: ik.Robot, q: torch.Tensor) -> np.ndarray:
        look = read_look(path, robot, stored / "small" / "meshes")
        poses = ik.link_poses(robot, q).numpy()
        base = poses[list(robot.link_names).index("base")]
        each = [poses[v.link] @ np.array([*part, 1.0]) for v in look.visuals for part in split(v.mesh)]
        return np.array(sorted((np.linalg.inv(base) @ x)[:3].round(6).tolist() for x in each))

    assert middles(back, q.flip(0)) == pytest.approx(middles(robot, q), abs=1e-5)


def split(mesh: Triangles) -> list[np.ndarray]:
    """Middles of the boxes of 24 corners that were put together."""
    return [part.mean(axis=0) for part in np.split(mesh.vertices.astype(np.float64), len(mesh.vertices) // 24)]


def test_a_link_without_its_mesh_is_a_capsule_and_one_line_says_so(make: Any, stored: Path):
    path, robot = make(
        base=visual(mesh("package://small/meshes/box.stl")),
        upper=visual(mesh("package://small/meshes/lost.stl")),
        tip=visual(mesh("package://small/meshes/gone.stl")),
    )
    look = read_look(path, robot, stored)
    assert look.missing == {1, 2}
    assert look.notes == (
        f"upper: 'package://small/meshes/lost.stl' is not under {stored} (and 1 more); drawn as capsules",
    )
    drawn = {part.link for part in parts_to_draw(robot, look)}
    assert drawn == {1, 2}
    assert len(parts_to_draw(robot, None)) == len(arm_parts(robot)) > len(parts_to_draw(robot, look))
    assert parts_to_draw(robot, Look((), frozenset(), ())) == ()


def test_too_many_triangles_become_fewer_and_one_line_says_so(make: Any, tmp_path: Path):
    path, robot = make(base=visual("<sphere radius='0.3'/>"), upper=visual("<sphere radius='0.3'/>"))
    look = read_look(path, robot, tmp_path, most_faces=1000)
    assert sum(len(v.mesh.faces) for v in look.visuals) <= 1000
    assert look.notes == ("2,560 triangles are more than 1,000 and were made fewer",)


def test_no_folder_and_no_meshes_are_mistakes(make: Any, stored: Path):
    path, robot = make()
    with pytest.raises(ik.ConfigError, match="names no meshes for the links of this arm; leave --meshes out"):
        read_look(path, robot, stored)
    with pytest.raises(ik.ConfigError, match="no such folder"):
        read_look(path, robot, stored / "nothing")


# ---------------------------------------------------------------- on the page


def test_meshes_move_with_the_arm_and_turn_grey_with_it(make: Any, stored: Path, tmp_path: Path):
    pytest.importorskip("viser")
    from ikgrad.view.scene import MISSED

    path, robot = make(base=visual(mesh("box.stl")), upper=visual(mesh("box.stl"), material="<material name='sky'/>"))
    look = read_look(path, robot, stored / "small" / "meshes")
    viewer = Viewer(start_server(port=0), Session(robot), look=look)
    try:
        arm = viewer.stage.arm
        assert len(arm._painted) == 2
        T = viewer.session.T_target.clone()
        T[:3, 3] += 5
        viewer.follow(T)
        assert {tuple(node.color) for node, _ in arm._painted} == {MISSED}
        viewer.session.reset()
        viewer.joints_changed()
        assert {tuple(node.color) for node, _ in arm._painted} == {PLAIN, (0, 128, 255)}
        places = ik.link_poses(robot, viewer.session.q)[list(arm._frames), :3, 3]
        assert np.allclose([frame.position for frame in arm._frames.values()], places)
    finally:
        viewer.close()
    page = export_page(tmp_path / "page.html", Session(robot), look=look)
    assert page.stat().st_size > 100_000
