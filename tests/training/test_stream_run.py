"""`ik.train` on a stream: what it learns, writes and refuses, and how it goes on after a kill at any write."""

from __future__ import annotations

import json
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import torch
from support import ZOO, cut_off_at_every_write, weights_of

import ikgrad as ik
from ikgrad.config import StreamConfig
from ikgrad.training import EndlessTraining
from ikgrad.training.train import StreamResult

QUICK: dict[str, Any] = {"robot": "ur5e", "model": "increment", "width": 16, "steps": 12, "batch_size": 64, "checks": 4}


def errors(folder: Path) -> list[str]:
    """history.csv without the seconds, which no two runs have in common."""
    lines = (folder / "history.csv").read_text().splitlines()
    return [",".join(cell for i, cell in enumerate(line.split(",")) if i != 2) for line in lines]


def stopped(folder: Path, after: int = 5, **options: Any) -> Path:
    """A run that Ctrl-C ended."""

    def stop(now: Any) -> None:
        if now.steps == after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ik.train(**{**QUICK, **options}, out=folder, progress=stop)
    return folder


# ---------------------------------------------------------------- learning


@pytest.mark.parametrize("model", ["unrolled", "increment"])
def test_both_models_learn_for_a_time_or_some_steps(model: str):
    result = ik.train(robot="ur5e", model=model, width=32, batch_size=256, steps=60)
    (curve,) = result.curves
    assert result.inverter.family == model
    assert result.members[0].steps == 60
    assert result.members[0].best.loss < curve[0].loss
    timed = ik.train(robot="ur5e", model=model, width=16, batch_size=64, minutes=0.3 / 60, checks=2)
    assert timed.members[0].seconds >= 0.3


def test_members_have_seeds_of_their_own_and_learn_what_they_learn_alone():
    both = ik.train(**QUICK, seed=5, members=2)
    alone = ik.train(**QUICK, seed=6)
    assert [member.seed for member in both.members] == [5, 6]
    assert [check.loss for check in both.curves[1]] == [check.loss for check in alone.curves[0]]
    assert both.inverter is both.inverters[both.members[0].best.loss > both.members[1].best.loss]


@pytest.mark.parametrize(
    "options",
    [
        {"labels": "solver", "pose_weight": 0.0, "joint_weight": 1.0},
        {"loss_shape": "square", "loss_delta": 0.1, "limit_weight": 0.0},
        {"spread": None},
        {"activation": "tanh", "depth": 2},
        {"model": "unrolled", "rounds": 2, "damping": 0.05},
    ],
)
def test_settings_reach_the_training(options: dict[str, Any]):
    usual, other = ik.train(**QUICK), ik.train(**{**QUICK, **options})
    assert usual.curves[0][-1].loss != other.curves[0][-1].loss
    assert other.inverter.settings().items() >= {k: v for k, v in options.items() if k in ("rounds", "depth")}.items()


def test_plain_regression_of_joints_looks_at_labels_alone():
    from ikgrad.data import TaskStream
    from ikgrad.training import PoseLoss

    robot = ik.load_robot("ur5e")
    T, label, q = TaskStream(robot, batch_size=20).batch(0)
    loss = PoseLoss(pose=0.0, limits=0.0, joints=1.0)
    assert float(loss(robot, q, T, label)) == pytest.approx(float(((q - label).square().sum(-1) + 1e-4).sqrt().mean()))


def test_a_robot_object_and_one_without_limits(zoo_path: Path, tmp_path: Path):
    robot = ik.load_robot(zoo_path, tip="hand")
    result = ik.train(**{**QUICK, "robot": robot}, out=tmp_path / "run")
    assert ik.load_inverter(tmp_path / "run" / "model", robot=robot).robot.fingerprint == robot.fingerprint
    path = tmp_path / "free.urdf"
    path.write_text(FREE)
    result = ik.train(**{**QUICK, "robot": str(path), "model": "unrolled"})
    assert not result.inverter.robot.q_max.isfinite().any()
    assert all(check.rotation_deg[1] < 180 for check in result.curves[0])


FREE = """<robot name="free"><link name="a"/><link name="b"/><link name="c"/>
<joint name="1" type="continuous"><parent link="a"/><child link="b"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/></joint>
<joint name="2" type="continuous"><parent link="b"/><child link="c"/><origin xyz="0.5 0 0"/><axis xyz="0 1 0"/></joint>
</robot>"""


def test_progress_tells_where_it_stands():
    seen: list[Any] = []
    ik.train(**QUICK, members=2, progress=seen.append)
    assert [now.steps for now in seen] == [*range(13), *range(12, 25)]
    assert [now.member for now in seen] == [0] * 13 + [1] * 13
    assert seen[0].share == 0.0
    assert seen[-1].share == 1.0
    assert seen[-1].left == 0.0
    assert all(a.share <= b.share for a, b in pairwise(seen))


# ---------------------------------------------------------------- the run folder


def test_a_run_folder_holds_everything(tmp_path: Path):
    result = ik.train(**QUICK, seed=3, out=tmp_path / "runs" / "x")
    assert isinstance(result, StreamResult)
    assert {path.name for path in result.folder.iterdir()} == {"config.yaml", "run.json", "history.csv", "model"}
    report = json.loads((result.folder / "run.json").read_text())
    assert report["state"] == "finished"
    assert report["seed"] == report["members"][0]["seed"] == 3
    assert report["network"] == result.inverter.settings()
    assert report["robot"]["fingerprint"] == result.inverter.robot.fingerprint
    lines = (result.folder / "history.csv").read_text().splitlines()
    assert lines[0].startswith("step,member,seconds,loss,position_median_mm,position_95_mm,")
    assert [line.split(",")[0] for line in lines[1:]] == ["0", "3", "6", "9", "12"]
    again = ik.train(result.folder / "config.yaml")
    assert again.config == result.config == StreamConfig(**QUICK, seed=3)
    stored = ik.load_inverter(result.folder / "model").state_dict()
    assert all(torch.equal(stored[name], value) for name, value in again.inverter.state_dict().items())


def test_a_finished_run_is_read_back(tmp_path: Path):
    result = ik.train(**QUICK, members=2, out=tmp_path / "run")
    seen: list[Any] = []
    again = ik.train(**QUICK, members=2, out=tmp_path / "run", resume=True, progress=seen.append)
    assert seen == []
    assert again.members == result.members
    assert again.curves == result.curves


def test_a_run_that_is_cut_off_at_any_write_goes_on_to_the_same_weights(tmp_path: Path, monkeypatch):
    options = {**QUICK, "members": 2, "steps": 2, "checks": 2}
    whole = ik.train(**options, out=tmp_path / "whole").folder

    def train(folder: Path) -> object:
        return ik.train(**options, out=folder, checkpoint_seconds=0.0)

    n = 0
    for folder in cut_off_at_every_write(train, tmp_path, monkeypatch):
        n += 1
        resumed = ik.train(**options, out=folder, resume=True)
        assert weights_of(resumed.folder) == weights_of(whole)
        assert errors(folder) == errors(whole)
        assert not any(path.name.startswith(".") or path.name == "checkpoint" for path in folder.iterdir())
    assert n >= 10  # report, settings, checkpoints with history, weights


def test_ctrl_c_leaves_a_checkpoint_and_a_budget_of_time_goes_on_with_the_time_left(tmp_path: Path):
    folder = stopped(tmp_path / "run")
    seen: list[int] = []
    ik.train(**QUICK, out=folder, resume=True, progress=lambda now: seen.append(now.steps))
    assert seen == list(range(6, 13))
    timed = {"steps": None, "minutes": 0.6 / 60}
    spent = json_of_checkpoint(stopped(tmp_path / "timed", **timed))
    result = ik.train(**{**QUICK, **timed}, out=tmp_path / "timed", resume=True)
    assert 0 < spent < 0.6 <= result.members[0].seconds < 0.6 + 0.5
    assert result.curves[0][0].step == 0


def json_of_checkpoint(folder: Path) -> float:
    """Seconds of training that a checkpoint holds."""
    from ikgrad.training import load_checkpoint

    return load_checkpoint(folder / "checkpoint")["trainings"][0]["progress"]["seconds"]


def test_events_are_the_curves_also_after_a_kill(tmp_path: Path):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    folder = stopped(tmp_path / "run", tensorboard=True)
    result = ik.train(**QUICK, tensorboard=True, out=folder, resume=True)
    events = accumulator.EventAccumulator(str(folder / "tensorboard" / "seed-0"))
    events.Reload()
    found = events.Scalars("position/median_mm")
    assert [event.step for event in found] == [check.step for check in result.curves[0]]


# ---------------------------------------------------------------- refusals


def test_a_loss_that_is_not_finite_keeps_the_last_good_weights(tmp_path: Path, monkeypatch):
    learn = EndlessTraining._learn

    def spoil(self: EndlessTraining) -> None:
        if self.step == 7:
            self.inverter.network.layers[0].weight.data[:] = torch.nan
        learn(self)

    monkeypatch.setattr(EndlessTraining, "_learn", spoil)
    with pytest.raises(
        ik.TrainingError, match=r"not finite in step 8; the best weights are back\..* kept in .*model-0$"
    ):
        ik.train(**QUICK, members=2, out=tmp_path / "run")
    inverter = ik.load_inverter(tmp_path / "run" / "model-0")
    assert all(parameter.isfinite().all() for parameter in inverter.parameters())
    report = json.loads((tmp_path / "run" / "run.json").read_text())
    assert report["state"].startswith("failed: the loss is not finite in step 8")
    assert [member["steps"] for member in report["members"]] == [7]
    with pytest.raises(ik.DataError, match=r"this run has ended: failed: the loss .*; --force starts anew"):
        ik.train(**QUICK, members=2, out=tmp_path / "run", resume=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 10**7}, r"needs about .*, most of it for .* weights, but there are .*; try fewer hidden units"),
        ({"batch_size": 10**12}, r"most of it for .* rows.*; try fewer"),
        ({"members": 10**8}, r"most of it for 100,000,000 members, .*; try fewer members"),
        ({"threads": 10**6}, r"threads must be at most \d+, the processors of this machine, got 1000000"),
        ({"device": "cuda"}, "device 'cuda': torch sees no CUDA device here; take cpu"),
        ({"activation": "gleu"}, "unknown activation 'gleu'; did you mean 'gelu'"),
        ({"robot": "ur5"}, "unknown robot 'ur5'; did you mean 'ur5e'"),
        ({"tip": "tool"}, "unknown link .* 'tool'; did you mean 'tool0'"),
        ({"tensorboard": True}, "tensorboard needs out, a run folder to write the events to"),
    ],
)
def test_what_cannot_work_is_refused_before_the_work(options, message, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    seen: list[Any] = []
    with pytest.raises(ik.IkgradError, match=message):
        ik.train(**{**QUICK, **options}, progress=seen.append)
    assert seen == []


def test_another_run_cannot_go_on(tmp_path: Path):
    folder = stopped(tmp_path / "run")
    with pytest.raises(ik.DataError, match="cannot go on with other settings: width was 16, is 17; seed was 0, is 4"):
        ik.train(**{**QUICK, "width": 17, "seed": 4}, out=folder, resume=True)
    path = tmp_path / "zoo.urdf"
    path.write_text(ZOO)
    folder = stopped(tmp_path / "zoo", robot=str(path), tip="hand")
    path.write_text(ZOO.replace('xyz="0 0 0.4"', 'xyz="0 0 0.5"'))
    with pytest.raises(ik.DataError, match=r"other settings: robot fingerprint was \w+, is \w+"):
        ik.train(**{**QUICK, "robot": str(path), "tip": "hand"}, out=folder, resume=True)


def test_a_damaged_history_is_named(tmp_path: Path):
    folder = ik.train(**QUICK, out=tmp_path / "run").folder
    (folder / "history.csv").unlink()
    with pytest.raises(ik.DataError, match=r"history\.csv: cannot be read: No such file"):
        ik.train(**QUICK, out=folder, resume=True)


def test_results_are_plain_values():
    result = ik.train(**QUICK)
    assert json.loads(json.dumps(asdict(result.members[0])))["best"]["step"] == result.members[0].best.step
