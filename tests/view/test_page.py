"""The page itself: a browser is played by a websocket that sends what viser's client would send."""

from __future__ import annotations

import base64
import re
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

import ikgrad as ik
from ikgrad.collision import Spheres
from ikgrad.rotations import quat_wxyz_from_matrix
from ikgrad.view import Motion, Session, Viewer, export_page, start_server

viser = pytest.importorskip("viser")
pytestmark = pytest.mark.timeout(120)


class Browser:
    """Somebody with the page open."""

    def __init__(self, port: int):
        import msgspec
        from websockets.sync.client import connect

        self._pack = msgspec.msgpack.encode
        protocol = f"viser-v{viser.__version__}"
        self._socket = connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None)
        self.send(
            "ViewerCameraMessage", wxyz=(1, 0, 0, 0), position=(2, 0, 1), fov=1.0, near=0.01, far=100.0,
            image_height=600, image_width=800, look_at=(0, 0, 0), up_direction=(0, 0, 1),
        )  # fmt: skip

    def send(self, kind: str, **fields: Any) -> None:
        self._socket.send(self._pack({"type": kind, **fields}))

    def drag(self, T: torch.Tensor) -> None:
        wxyz, position = quat_wxyz_from_matrix(T[:3, :3]).tolist(), T[:3, 3].tolist()
        self.send("TransformControlsUpdateMessage", name="/target", wxyz=wxyz, position=position, owner="")

    def drop(self) -> None:
        self.send("TransformControlsDragEndMessage", name="/target", owner="")

    def use(self, control: Any, value: Any) -> None:
        self.send("GuiUpdateMessage", uuid=control._impl.uuid, updates={"value": value})

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def make() -> Iterator[Callable[..., Viewer]]:
    open_ones: list[Viewer] = []

    def make(robot: ik.Robot, **extras: Any) -> Viewer:
        viewer = Viewer(start_server(port=0), Session(robot), **extras)
        open_ones.append(viewer)
        return viewer

    yield make
    for viewer in open_ones:
        viewer.close()


@pytest.fixture
def browser() -> Iterator[Callable[[Viewer], Browser]]:
    open_ones: list[Browser] = []

    def browser(viewer: Viewer) -> Browser:
        open_ones.append(Browser(viewer.server.get_port()))
        return open_ones[-1]

    yield browser
    for one in open_ones:
        one.close()


def eventually(true: Callable[[], bool]) -> None:
    """Until the message has come through; fails after 30 s."""
    end = time.monotonic() + 30
    while not true():
        assert time.monotonic() < end, "the page did not come to that"
        time.sleep(0.01)


def shown(viewer: Viewer, arm: Any) -> torch.Tensor:
    """(links, 3) positions of the drawn frames that the arm has."""
    return torch.stack([torch.from_numpy(frame.position) for frame in arm._frames.values()])


def expected(viewer: Viewer, arm: Any, q: torch.Tensor) -> torch.Tensor:
    return ik.link_poses(viewer.session.robot, q)[list(arm._frames), :3, 3]


# ---------------------------------------------------------------- the scene


def test_every_robot_has_a_page(robot: ik.Robot, make: Callable[..., Viewer]):
    viewer = make(robot)
    q = viewer.session.q
    assert torch.allclose(shown(viewer, viewer.stage.arm), expected(viewer, viewer.stage.arm, q))
    for slider, value, unit in zip(
        viewer._controls.joints._sliders, q.tolist(), viewer._controls.joints._units, strict=True
    ):
        assert slider.value == pytest.approx(value / unit, abs=0.051 if unit != 1 else 6e-4)
        assert slider.min * unit >= float(robot.sampling_range[0].min()) - 1e-9


def test_dragging_the_target_moves_the_arm(make: Callable[..., Viewer], browser: Callable[[Viewer], Browser]):
    robot = ik.load_robot("ur5e")
    viewer = make(robot)
    page = browser(viewer)
    q = viewer.session.home + 0.1
    T = ik.forward_kinematics(robot, q)
    page.drag(T)
    eventually(lambda: torch.allclose(viewer.session.q, q, atol=1e-4))
    eventually(lambda: viewer._controls.words.content == "**Target:** reached")
    eventually(
        lambda: torch.allclose(shown(viewer, viewer.stage.arm), expected(viewer, viewer.stage.arm, q), atol=1e-4)
    )
    eventually(lambda: "solutions found" in viewer._controls.count.content)
    drawn = [ghost for ghost in viewer.stage.ghosts if ghost._root.visible]
    assert len(drawn) == int(re.search(r"\d+", viewer._controls.count.content)[0]) - 1  # the arm itself is one of them
    tip = ik.forward_kinematics(robot, viewer.session.q)[:3, 3]
    for ghost in drawn:
        last = list(ghost._frames).index(max(ghost._frames))
        assert float((shown(viewer, ghost)[last] - tip).norm()) < 0.3  # the same wrist or flange


def test_a_target_out_of_reach_is_explained_and_the_ghosts_go(
    make: Callable[..., Viewer], browser: Callable[[Viewer], Browser]
):
    viewer = make(ik.load_robot("ur5e"))
    page = browser(viewer)
    eventually(lambda: any(ghost._root.visible for ghost in viewer.stage.ghosts))
    T = viewer.session.T_target.clone()
    T[:3, 3] *= 10
    page.drag(T)
    page.drop()
    eventually(lambda: viewer._controls.words.content.startswith("**Target not met:** out of reach"))
    eventually(lambda: viewer.worker.wait(0.0))
    assert not any(ghost._root.visible for ghost in viewer.stage.ghosts)
    assert viewer.stage.target.position == pytest.approx(T[:3, 3].tolist())  # the target stays where it was put


def test_a_slider_turns_one_joint_and_takes_the_target_along(
    panda: ik.Robot, make: Callable[..., Viewer], browser: Callable[[Viewer], Browser]
):
    viewer = make(panda)
    page, home = browser(viewer), viewer.session.home
    page.use(viewer._controls.joints._sliders[1], 20.0)
    eventually(lambda: abs(float(viewer.session.q[1]) - 0.34906585) < 1e-6)
    others = [0, 2, 3, 4, 5, 6]
    assert torch.equal(viewer.session.q[others], home[others])  # not rounded to what the sliders show
    eventually(lambda: viewer.worker.wait(0.0))
    T = ik.forward_kinematics(panda, viewer.session.q)
    assert viewer.stage.target.position == pytest.approx(T[:3, 3].tolist())
    page.use(viewer._controls.reset, True)
    eventually(lambda: torch.equal(viewer.session.q, home))


def test_the_orientation_can_be_left_free(
    panda: ik.Robot, make: Callable[..., Viewer], browser: Callable[[Viewer], Browser]
):
    viewer = make(panda)
    page = browser(viewer)
    T = viewer.session.T_target.clone()
    T[:3, :3] = T[:3, :3] @ torch.diag(torch.tensor([1.0, -1.0, -1.0]).double())
    viewer.session.ask_orientation(False)
    page.drag(T)
    eventually(lambda: viewer._controls.words.content == "**Target:** reached")
    assert float((ik.forward_kinematics(panda, viewer.session.q) - T)[:3, :3].abs().max()) > 0.1


def test_other_solutions_and_shadows_can_be_left_out(
    make: Callable[..., Viewer], browser: Callable[[Viewer], Browser], caplog: pytest.LogCaptureFixture
):
    viewer = make(ik.load_robot("ur5e"))
    page = browser(viewer)
    eventually(lambda: any(ghost._root.visible for ghost in viewer.stage.ghosts))
    page.use(viewer._controls.ghosts, False)
    page.use(viewer._controls.shadows, False)
    eventually(lambda: not any(ghost._root.visible for ghost in viewer.stage.ghosts))
    assert viewer._controls.count.content == ""
    page.drag(ik.forward_kinematics(viewer.session.robot, viewer.session.home + 0.05))
    eventually(lambda: viewer.worker.wait(0.0) and not viewer._controls.shadows.value)
    assert not any(ghost._root.visible for ghost in viewer.stage.ghosts)
    assert caplog.text == ""  # the worker writes there what went wrong


def test_another_method_is_chosen_and_apps_goes_on_by_itself(
    panda: ik.Robot, make: Callable[..., Viewer], browser: Callable[[Viewer], Browser]
):
    viewer = make(panda)
    page = browser(viewer)
    page.use(viewer._controls.method, "APPS")
    eventually(lambda: viewer.session.method is viewer.methods["APPS"])
    T = ik.forward_kinematics(panda, viewer.session.home + 0.05)
    page.drag(T)
    eventually(lambda: "APPS is on its way after " in viewer._controls.words.content)
    q = viewer.session.q
    eventually(lambda: not torch.equal(viewer.session.q, q))
    page.use(viewer._controls.reset, True)
    eventually(lambda: torch.equal(viewer.session.q, viewer.session.home))
    eventually(lambda: viewer.worker.wait(0.0))
    assert torch.equal(viewer.session.q, viewer.session.home)  # it does not go on to a target of before


def test_the_browser_that_asks_gets_a_page_of_what_is_shown(
    make: Callable[..., Viewer], browser: Callable[..., Browser]
):
    robot = ik.load_robot("arm4")
    q = torch.linspace(0, 0.3, 5).double()[:, None] + Session(robot).home
    viewer = make(robot, motion=Motion("q", q))
    page = browser(viewer)
    eventually(lambda: len(viewer.server.get_clients()) == 1)
    sent: list[tuple[str, bytes]] = []
    (client,) = viewer.server.get_clients().values()
    client.send_file_download = lambda name, content, **_: sent.append((name, content))
    page.use(viewer._controls.save, True)
    eventually(lambda: len(sent) == 1)
    page.use(viewer._controls.motion._slider, 3)
    eventually(lambda: torch.equal(viewer.session.q, q[3]))
    page.use(viewer._controls.save, True)
    eventually(lambda: len(sent) == 2)
    viewer.drag(ik.forward_kinematics(robot, viewer.session.home - 0.2))
    page.use(viewer._controls.race._start, True)
    eventually(lambda: viewer._contest is not None)
    page.use(viewer._controls.save, True)
    eventually(lambda: len(sent) == 3)
    assert [name for name, _ in sent] == ["arm4-pose.html", "arm4-motion.html", "arm4-race.html"]
    assert all(b"__VISER_EMBED_DATA__" in content for _, content in sent)
    eventually(lambda: viewer._controls.save.label == "Save as HTML")


# ---------------------------------------------------------------- methods, motions, obstacles


def test_a_race_shows_an_arm_for_every_method_and_goes_away_again(
    panda: ik.Robot, make: Callable[..., Viewer], browser: Callable[[Viewer], Browser]
):
    from ikgrad.view.race import inverter_for

    spheres = Spheres(torch.tensor([[0.6, 0.0, 0.3]]).double(), torch.tensor([0.1]).double())
    viewer = make(panda, inverter=inverter_for(panda), spheres=spheres)
    page, session = browser(viewer), viewer.session
    page.drag(ik.forward_kinematics(panda, session.home + 0.05))
    page.use(viewer._controls.race._start, True)
    eventually(
        lambda: viewer._contest is not None and len(viewer._contest.arms) == 4 and viewer._race_player is not None
    )
    assert not viewer.stage.arm._root.visible
    assert not viewer.stage.balls[0].visible
    assert viewer._controls.race.words.content.count("steps") >= 3
    player = viewer._race_player
    last = player._count - 1
    eventually(lambda: player._slider.value == last and not player._playing)  # it plays to its end
    for arm, run in zip(viewer._contest.arms, viewer._contest.runs, strict=True):
        assert torch.allclose(shown(viewer, arm), expected(viewer, arm, run.q[-1]))
    page.use(player._slider, 0)
    first = viewer._contest.arms[0]
    eventually(lambda: torch.allclose(shown(viewer, first), expected(viewer, first, session.home)))
    page.use(viewer._controls.race._close, True)
    eventually(lambda: viewer._contest is None and viewer.stage.arm._root.visible)
    eventually(lambda: viewer.stage.balls[0].visible)
    assert viewer.server.scene.get_handle_by_name("/race/0") is None


def test_a_motion_is_played_to_its_end_and_can_be_held(
    panda: ik.Robot, make: Callable[..., Viewer], browser: Callable[[Viewer], Browser]
):
    q = torch.linspace(0, 1, 50).double()[:, None] * 0.3 + Session(panda).home
    viewer = make(panda, motion=Motion("joints.csv", q))
    page, player = browser(viewer), viewer._controls.motion
    page.use(player._speed, 240)
    page.use(player._button, True)
    eventually(lambda: torch.equal(viewer.session.q, q[-1]))
    eventually(lambda: player._slider.value == 49 and not player._playing)
    page.use(player._slider, 7)
    eventually(lambda: torch.equal(viewer.session.q, q[7]))
    page.use(player._speed, 1)
    page.use(player._button, True)
    eventually(lambda: player._playing)
    assert player._button.label == "Pause"
    page.use(player._button, True)
    eventually(lambda: not player._playing)


def test_contact_is_said_and_coloured(
    panda: ik.Robot, make: Callable[..., Viewer], browser: Callable[[Viewer], Browser]
):
    from ikgrad.view.scene import BLUE, VERMILLION

    tip = ik.forward_kinematics(panda, Session(panda).home)[:3, 3]
    viewer = make(panda, spheres=Spheres(tip[None], torch.tensor([0.05]).double()))
    assert "contact: -" in viewer._controls.clearance.content
    assert tuple(viewer.stage.balls[0].color) == VERMILLION
    browser(viewer).use(viewer._controls.joints._sliders[0], -100.0)
    eventually(lambda: "free: " in viewer._controls.clearance.content)
    assert tuple(viewer.stage.balls[0].color) == BLUE


# ---------------------------------------------------------------- server and exported page


def test_the_server_prints_nothing_and_listens_on_this_machine_only(capsys: pytest.CaptureFixture[str]):
    from ikgrad.view.server import stop_server

    server = start_server(port=0)
    assert server.get_host() == "127.0.0.1"
    assert server.request_share_url() is None
    stop_server(server)
    assert capsys.readouterr() == ("", "")


def test_a_port_in_use_is_refused_not_replaced():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ik.ConfigError, match=f"cannot listen on 127.0.0.1, port {port}: .*another --port"):
            start_server(port=port)


def test_an_unknown_host_is_refused():
    with pytest.raises(ik.ConfigError, match=r"cannot listen on no\.such\.host\.invalid"):
        start_server(host="no.such.host.invalid", port=0)


def recording(page: Path) -> dict[str, Any]:
    """What an exported page plays."""
    import msgspec
    import zstandard

    text = page.read_text(encoding="utf-8")
    data = base64.b64decode(re.search(r'__VISER_EMBED_DATA__="([^"]+)"', text)[1])
    inner = zstandard.ZstdDecompressor().decompress(data[8:], max_output_size=int.from_bytes(data[:8], "little"))
    return msgspec.msgpack.decode(inner[8 : 8 + int.from_bytes(inner[:8], "little")])


def test_an_exported_pose_holds_arm_target_and_other_solutions(tmp_path: Path):
    page = export_page(tmp_path / "page.html", Session(ik.load_robot("ur5e")))
    found = recording(page)
    names = {message.get("name") for _, message in found["messages"]}
    assert {"/arm", "/target", "/floor", "/ghosts/1"} <= names
    assert found["durationSeconds"] == 0
    with pytest.raises(ik.DataError, match="exists already"):
        export_page(page, Session(ik.load_robot("ur5e")))
    export_page(page, Session(ik.load_robot("arm4")), force=True)


def test_an_exported_motion_lasts_a_second_for_thirty_rows(panda: ik.Robot, tmp_path: Path):
    q = torch.linspace(0, 0.5, 60).double()[:, None] + Session(panda).home
    spheres = Spheres(torch.tensor([[0.6, 0.0, 0.3]]).double(), torch.tensor([0.1]).double())
    page = export_page(tmp_path / "page.html", Session(panda), motion=Motion("q", q), spheres=spheres)
    found = recording(page)
    assert found["durationSeconds"] == pytest.approx(2.0)
    assert len({time for time, _ in found["messages"]}) == 60
    assert "/obstacles/1" in {message.get("name") for _, message in found["messages"]}


def test_a_page_goes_into_html_files_only(tmp_path: Path):
    with pytest.raises(ik.DataError, match=r"unknown kind of file '\.png'"):
        export_page(tmp_path / "page.png", Session(ik.load_robot("arm4")))
