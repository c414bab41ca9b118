"""`ik.train`: what it learns, what it writes, what it refuses, and how it goes on after a kill at any write."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
import torch
from support import ZOO, cut_off_at_every_write, weights_of

import ikgrad as ik
from ikgrad.config import TrainConfig
from ikgrad.training import run as run_module
from ikgrad.training import run_folder
from ikgrad.training.losses import LOSSES
from ikgrad.training.memory import available_memory
from ikgrad.training.optimizers import make_optimizer, optimizer_names, side_by_side

BOX = {"scheme": "joint_box", "count": 120, "half_width": 0.3}
QUICK: dict[str, Any] = {"model": "classic", "robot": "denso_vp6242", "hidden": (5,), "data": BOX, "epochs": 4}
ADAM: dict[str, Any] = {**QUICK, "optimizer": "Adam", "lr": 0.01, "batch_size": 20}


# ---------------------------------------------------------------- learning


@pytest.mark.parametrize("name", optimizer_names())
def test_every_optimizer_lowers_the_error(name: str):
    lr = {"levenberg_marquardt": None, "LBFGS": 0.1, "Adadelta": 1.0, "Rprop": 0.01, "backprop": 0.1, "SGD": 0.1}
    result = ik.train(**{**QUICK, "epochs": 8}, optimizer=name, lr=lr.get(name, 0.01))
    (curve,) = result.curves
    assert curve.train[-1] < curve.train[0]


def test_members_have_seeds_and_samples_of_their_own():
    result = ik.train(**QUICK, seed=5, members=3)
    assert [member.seed for member in result.members] == [5, 6, 7]
    alone = ik.train(**QUICK, seed=6)
    assert torch.allclose(alone.curves[0].train, result.curves[1].train, rtol=1e-6)
    assert alone.members[0].test.joint_mse == pytest.approx(result.members[1].test.joint_mse, rel=1e-6)
    assert result.inverter is result.inverters[min(range(3), key=lambda k: result.members[k].best_loss)]


def test_a_scheme_with_a_seed_gives_all_members_the_same_samples(tmp_path: Path):
    result = ik.train(**{**QUICK, "data": {**BOX, "seed": 9}}, members=2, out=tmp_path / "run")
    other = ik.train(**{**QUICK, "data": {**BOX, "seed": 9}}, seed=1)
    assert result.members[1].test.joint_mse == pytest.approx(other.members[0].test.joint_mse, rel=1e-6)


def test_optimizers_that_mix_weights_train_one_member_after_the_other():
    assert not side_by_side("LBFGS")
    both = ik.train(**QUICK, optimizer="LBFGS", lr=0.1, members=2)
    alone = ik.train(**QUICK, optimizer="LBFGS", lr=0.1, seed=1)
    assert torch.equal(both.curves[1].train, alone.curves[0].train)


def test_the_kept_weights_are_those_of_the_smallest_validation_error():
    result = ik.train(**{**QUICK, "epochs": 60, "hidden": (20,)})
    best = int(result.curves[0].validation.argmin())
    assert result.members[0].best_epoch == result.curves[0].epochs[best] < 60
    assert result.members[0].best_loss == result.curves[0].validation[best]


def test_patience_ends_the_training():
    result = ik.train(**{**QUICK, "epochs": 200, "hidden": (20,)}, patience=3)
    assert result.members[0].epochs == result.members[0].best_epoch + 3 < 200


def test_objects_in_the_place_of_names(tmp_path: Path):
    robot = ik.load_robot("ur5e")
    data = ik.data.generate(robot, ik.data.JointBox(count=100), validation=0.2, test=0.1)
    result = ik.train(model="classic", robot=robot, data=data, epochs=2, out=tmp_path / "run")
    assert result.members[0].test.rows == 10
    assert ik.load_inverter(tmp_path / "run" / "model").robot.fingerprint == robot.fingerprint
    saved = data.save(tmp_path / "data.safetensors")
    again = ik.train(model="classic", robot="ur5e", data=str(saved), epochs=2)
    assert torch.equal(result.curves[0].train, again.curves[0].train)


def test_float32_stays_float32():
    assert ik.train(**ADAM, dtype="float32").inverter.dtype == torch.float32


def test_progress_tells_where_it_stands():
    seen = []
    result = ik.train(**QUICK, members=2, progress=seen.append)
    assert [now.done for now in seen] == [1, 2, 3, 4]
    assert seen[-1].total == 4
    assert seen[-1].train == pytest.approx(sum(curve.train[-1].item() for curve in result.curves) / 2)


def test_the_losses_of_the_settings_are_those_there_are():
    assert set(get_args(get_type_hints(TrainConfig)["loss"])) == set(LOSSES)


# ---------------------------------------------------------------- the run folder


def test_a_run_folder_holds_everything(tmp_path: Path):
    result = ik.train(**QUICK, seed=3, out=tmp_path / "runs" / "x")
    folder = result.folder
    assert {path.name for path in folder.iterdir()} == {"config.yaml", "run.json", "history.csv", "model"}
    report = json.loads((folder / "run.json").read_text())
    assert report["state"] == "finished"
    assert report["seed"] == 3
    assert report["robot"]["fingerprint"] == ik.load_robot("denso_vp6242").fingerprint
    assert report["versions"]["torch"] == torch.__version__
    assert report["rows"] == {"train": 84, "validation": 18, "test": 18}
    assert report["members"][0]["test"]["joint_mse"] == result.members[0].test.joint_mse
    assert (folder / "history.csv").read_text().splitlines()[0] == "epoch,member,train,validation"
    assert ik.train(folder / "config.yaml").members == result.members
    inverter = ik.load_inverter(folder / "model")
    T = ik.forward_kinematics(inverter.robot, torch.zeros(6, dtype=torch.float64))
    assert torch.equal(inverter(T), result.inverter(T))


def test_a_finished_run_is_read_back(tmp_path: Path):
    result = ik.train(**QUICK, members=2, out=tmp_path / "run")
    seen = []
    again = ik.train(**QUICK, members=2, out=tmp_path / "run", resume=True, progress=seen.append)
    assert seen == []
    assert again.members == result.members
    assert torch.equal(again.curves[1].validation, result.curves[1].validation)


@pytest.mark.parametrize("options", [QUICK, {**ADAM, "members": 2}], ids=["levenberg_marquardt", "adam"])
def test_a_run_that_is_cut_off_at_any_write_goes_on_to_the_same_weights(options, tmp_path: Path, monkeypatch):
    whole = ik.train(**options, out=tmp_path / "whole").folder

    def train(folder: Path) -> object:
        return ik.train(**options, out=folder, checkpoint_seconds=0.0)

    n = 0
    for folder in cut_off_at_every_write(train, tmp_path, monkeypatch):
        n += 1
        resumed = ik.train(**options, out=folder, resume=True)
        assert weights_of(resumed.folder) == weights_of(whole)
        assert (folder / "history.csv").read_text() == (whole / "history.csv").read_text()
        assert not any(path.name.startswith(".") or path.name == "checkpoint" for path in folder.iterdir())
    assert n >= 12  # report, settings, checkpoints with history, weights


def test_what_a_kill_leaves_is_swept_away(tmp_path: Path):
    folder = stopped(tmp_path / "run")
    (folder / ".checkpoint.17.tmp").write_text("half")
    (folder / ".model.17.tmp").mkdir()
    ik.train(**QUICK, out=folder, resume=True)
    assert {path.name for path in folder.iterdir()} == {"config.yaml", "run.json", "history.csv", "model"}


def stopped(folder: Path, after: int = 2, **options: Any) -> Path:
    """A run that Ctrl-C ended."""

    def stop(now: Any) -> None:
        if now.done == after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ik.train(**{**QUICK, **options}, out=folder, progress=stop)
    return folder


def test_ctrl_c_leaves_a_checkpoint(tmp_path: Path):
    folder = stopped(tmp_path / "run")
    assert len((folder / "history.csv").read_text().splitlines()) == 3
    seen = []
    ik.train(**QUICK, out=folder, resume=True, progress=lambda now: seen.append(now.done))
    assert seen == [3, 4]
    assert weights_of(folder) == weights_of(ik.train(**QUICK, out=tmp_path / "whole").folder)


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"robot": "dneso_vp6242"}, ik.UnknownNameError, "unknown robot 'dneso_vp6242'; did you mean 'denso_vp6242'"),
        ({"activation": "tahn"}, ik.UnknownNameError, "unknown activation 'tahn'; did you mean 'tanh'"),
        ({"encoding": "quaternoin"}, ik.UnknownNameError, "pose encoding 'quaternoin'; did you mean 'quaternion'"),
        ({"optimizer": "adam"}, ik.UnknownNameError, "unknown optimizer 'adam'; did you mean 'Adam'"),
        ({"optimizer": "SparseAdam"}, ik.UnknownNameError, "unknown optimizer 'SparseAdam'"),
        ({"optimizer": "backprop"}, ik.ConfigError, "lr must be given: optimizer 'backprop'"),
        ({"lr": 0.1}, ik.ConfigError, "lr must be null: optimizer 'levenberg_marquardt' has no learning rate, got 0.1"),
        ({"optimizer_options": {"mue": 1}}, ik.ConfigError, "unknown key 'mue'; did you mean 'mu'"),
        ({"optimizer_options": {"lr": 1}}, ik.ConfigError, "give the learning rate as lr"),
        ({"optimizer_options": {"mu": -1}}, ik.ConfigError, "refuses its settings: Invalid mu: -1"),
        ({"optimizer_options": {"mu": "x"}}, ik.ConfigError, "'levenberg_marquardt' refuses its settings"),
        ({"data": {"scheme": "jointbox"}}, ik.UnknownNameError, "sampling scheme 'jointbox'; did you mean 'joint_box'"),
        ({"data": {**BOX, "cuont": 3}}, ik.ConfigError, "data: scheme 'joint_box': unknown key 'cuont'; did you mean"),
        ({"data": {**BOX, "count": "x"}}, ik.ConfigError, "data: scheme 'joint_box': key 'count' must be of type int"),
        ({"data": {**BOX, "count": 0}}, ik.DataError, "count must be at least 1, got 0; an empty data set"),
        ({"data": {**BOX, "test": "x"}}, ik.ConfigError, "data: key 'test' must be a number, got 'x'"),
        ({"data": {**BOX, "test": 0.9}}, ik.ConfigError, "validation and test must be shares that leave some rows"),
        ({"data": {**BOX, "home": [0.0]}}, ik.ConfigError, "home must hold 6 values"),
        ({"data": {**BOX, "count": 2, "test": 0.8, "validation": 0}}, ik.DataError, "no rows are left for training"),
        ({"data": "none.safetensors"}, ik.DataError, "none.safetensors: no such file"),
        ({"resume": True}, ik.ConfigError, "resume needs out"),
        ({"tensorboard": True}, ik.ConfigError, "tensorboard needs out"),
        ({"bounded": True, "robot": "zoo.urdf", "tip": "hand"}, ik.RobotError, "bounded needs limits, but turn"),
    ],
)
def test_wrong_settings_are_refused(options, error, message, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("zoo.urdf").write_text(ZOO)
    with pytest.raises(error, match=message):
        ik.train(**{**QUICK, **options})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hidden": (10**6,)}, r"12-1000000-6 needs about [\d,.]+ GiB, most of it for J\^T J of 19,000,006 weights"),
        (
            {"hidden": (10**6,)},
            "but there are 1.0 GiB of memory; try fewer hidden units, or another optimizer such as A",
        ),
        ({"hidden": (10**9,), "optimizer": "Adam"}, "most of it for activations of 120 rows"),
        ({"hidden": (10**5,) * 2, "optimizer": "Adam"}, "most of it for 10,002,000,006 weights, but there are 1.0 GiB"),
        ({"data": {**BOX, "count": 10**10}}, "most of it for 10,000,000,000 rows of data.*try fewer rows"),
        ({"members": 10**5}, "100000 members needs about"),
    ],
)
def test_what_does_not_fit_in_memory_is_refused_before_it_is_made(options, message, monkeypatch, tmp_path: Path):
    monkeypatch.setattr(run_module, "available_memory", lambda device: 2**30)
    with pytest.raises(ik.ConfigError, match=message):
        ik.train(**{**QUICK, "feedback": True, **options}, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_saved_data_set_that_does_not_fit_in_memory_is_refused(monkeypatch, tmp_path: Path):
    robot = ik.load_robot("denso_vp6242")
    path = ik.data.generate(robot, ik.data.JointBox(count=5000)).save(tmp_path / "d.safetensors")
    monkeypatch.setattr(run_module, "available_memory", lambda device: 2**20)
    with pytest.raises(ik.ConfigError, match="5,000 rows"):
        ik.train(**{**QUICK, "data": str(path)}, optimizer="Adam")


def test_there_is_some_memory():
    assert available_memory() > 2**20


def test_data_of_another_robot_are_refused(tmp_path: Path):
    path = ik.data.generate(ik.load_robot("ur5e"), ik.data.JointBox(count=20)).save(tmp_path / "d.safetensors")
    with pytest.raises(ik.RobotError, match=r"data of robot 'ur5e' with fingerprint \w+, not of 'denso_vp6242' with"):
        ik.train(**{**QUICK, "data": str(path)})


@pytest.mark.parametrize("column", ["T", "q", "q_current"])
def test_data_that_are_not_finite_are_refused(column: str):
    robot = ik.load_robot("denso_vp6242")
    data = ik.data.generate(robot, ik.data.JointBox(count=40))
    getattr(data.samples, column)[data.part.tolist().index(0)] = torch.nan
    with pytest.raises(ik.DataError, match="is nan; the data must be finite"):
        ik.train(model="classic", robot=robot, data=data, feedback=True, epochs=1)


def test_a_loss_that_is_not_finite_ends_the_run_and_keeps_the_last_good_weights(tmp_path: Path):
    folder = tmp_path / "run"
    huge = {**ADAM, "optimizer": "SGD", "lr": 1e4, "activation": "relu", "epochs": 50}
    with pytest.raises(ik.TrainingError, match=r"not finite after epoch \d+, step \d+; .* kept in .*model"):
        ik.train(**huge, out=folder)
    inverter = ik.load_inverter(folder / "model")
    assert all(parameter.isfinite().all() for parameter in inverter.parameters())
    assert json.loads((folder / "run.json").read_text())["state"].startswith("failed: the loss is not finite")
    with pytest.raises(ik.DataError, match=r"this run has ended: failed: the loss .*; --force starts anew"):
        ik.train(**huge, out=folder, resume=True)


def test_levenberg_marquardt_without_a_way_on_says_in_which_epoch(tmp_path: Path, monkeypatch):
    from ikgrad.optim import LevenbergMarquardt

    step, calls = LevenbergMarquardt.step, []

    def fail(self: Any, closure: Any) -> Any:
        calls.append(1)
        return step(self, closure if len(calls) < 3 else lambda: closure() * torch.nan)

    monkeypatch.setattr(LevenbergMarquardt, "step", fail)
    with pytest.raises(
        ik.TrainingError, match=r"epoch 3: the residuals or their derivatives are not finite.*epoch 2; kept in"
    ):
        ik.train(**QUICK, out=tmp_path / "run")
    assert ik.load_inverter(tmp_path / "run" / "model")


def test_one_member_that_diverges_does_not_stop_the_others():
    result = ik.train(**{**ADAM, "optimizer": "SGD", "lr": 100.0, "activation": "relu", "epochs": 30}, members=6)
    lost = [member.diverged_at > 0 for member in result.members]
    assert any(lost)
    assert not all(lost)
    assert all(parameter.isfinite().all() for inverter in result.inverters for parameter in inverter.parameters())


def test_an_existing_run_is_not_overwritten(tmp_path: Path):
    folder = ik.train(**QUICK, out=tmp_path / "run").folder
    before = weights_of(folder)
    with pytest.raises(ik.DataError, match="holds a run already; it is replaced with --force only"):
        ik.train(**QUICK, seed=1, out=folder)
    assert weights_of(folder) == before
    (folder / "notes.txt").write_text("mine")
    ik.train(**QUICK, seed=1, members=2, out=folder, force=True)
    assert {path.name for path in folder.iterdir()} == {
        "config.yaml",
        "run.json",
        "history.csv",
        "model-0",
        "model-1",
        "notes.txt",
    }


def test_an_unfinished_run_is_not_overwritten(tmp_path: Path):
    with pytest.raises(ik.DataError, match="holds an unfinished run; --resume goes on with it, --force starts anew"):
        ik.train(**QUICK, out=stopped(tmp_path / "run"))


def test_a_folder_of_something_else_is_never_touched(tmp_path: Path):
    (tmp_path / "mine.txt").write_text("mine")
    for force in (False, True):
        with pytest.raises(ik.DataError, match="exists and holds no training run; choose another name"):
            ik.train(**QUICK, out=tmp_path, force=force)
    with pytest.raises(ik.DataError, match="is a file, not a folder"):
        ik.train(**QUICK, out=tmp_path / "mine.txt")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"hidden": (6,), "seed": 4},
            r"cannot go on with other settings: hidden was \[5\], is \[6\]; seed was 0, is 4",
        ),
        ({"data": {**BOX, "half_width": 0.2}}, r"data was .*; content of the data was"),
    ],
)
def test_another_run_cannot_go_on(options, message, tmp_path: Path):
    folder = stopped(tmp_path / "run")
    with pytest.raises(ik.DataError, match=message):
        ik.train(**{**QUICK, **options}, out=folder, resume=True)
    assert (folder / "checkpoint").is_file()


def test_a_changed_robot_or_data_file_cannot_go_on(tmp_path: Path):
    path = tmp_path / "zoo.urdf"
    path.write_text(ZOO)
    options = {"robot": str(path), "tip": "hand"}
    folder = stopped(tmp_path / "run", **options)
    path.write_text(ZOO.replace('xyz="0 0 0.4"', 'xyz="0 0 0.5"'))
    with pytest.raises(ik.DataError, match=r"other settings: robot fingerprint was \w+, is \w+; content of"):
        ik.train(**{**QUICK, **options}, out=folder, resume=True)


@pytest.mark.parametrize("damage", ["truncated", "changed", "empty"])
def test_a_damaged_checkpoint_is_refused(damage: str, tmp_path: Path):
    folder = stopped(tmp_path / "run")
    content = (folder / "checkpoint").read_bytes()
    middle = len(content) // 2
    changed = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    (folder / "checkpoint").write_bytes({"truncated": content[:-5], "changed": changed, "empty": b""}[damage])
    message = (
        "is not a checkpoint of this version" if damage == "empty" else "the checkpoint is truncated or was changed"
    )
    with pytest.raises(ik.DataError, match=message):
        ik.train(**QUICK, out=folder, resume=True)


@pytest.mark.parametrize("content", ["{", "[]", '{"format": "another"}'])
def test_a_damaged_report_is_refused(content: str, tmp_path: Path):
    folder = stopped(tmp_path / "run")
    (folder / "run.json").write_text(content)
    with pytest.raises(ik.DataError, match=r"run\.json: is (damaged|no run of this version)"):
        ik.train(**QUICK, out=folder, resume=True)


def test_a_full_disk_ends_the_run_and_keeps_the_checkpoint_before(tmp_path: Path, monkeypatch):
    def full(path: Path, content: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    folder = stopped(tmp_path / "run")
    before = (folder / "checkpoint").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        text = (
            "checkpoint: cannot write the checkpoint: No space left on device; the checkpoint before is kept, --resume"
        )
        with pytest.raises(ik.DataError, match=text):
            ik.train(**QUICK, out=folder, resume=True, checkpoint_seconds=0.0)
    assert (folder / "checkpoint").read_bytes() == before
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", lambda handle: full(Path(), b""))
        with pytest.raises(ik.DataError, match="No space left on device; the checkpoint before is kept"):
            ik.train(**QUICK, out=folder, resume=True)
    assert weights_of(ik.train(**QUICK, out=folder, resume=True).folder)


def test_a_place_that_cannot_be_written_to_is_refused_before_the_work(tmp_path: Path, monkeypatch):
    def refuse(*arguments: Any, **options: Any) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(run_folder.tempfile, "TemporaryFile", refuse)
    seen: list[object] = []
    with pytest.raises(ik.DataError, match=r"run: the folder '.*' is not writable: Read-only file system"):
        ik.train(**QUICK, out=tmp_path / "run", progress=seen.append)
    assert seen == []


def test_tampered_weights_and_weights_of_another_robot_are_refused(tmp_path: Path):
    model = ik.train(**QUICK, out=tmp_path / "run").folder / "model"
    with pytest.raises(ik.RobotError, match=r"these weights are for robot 'denso_vp6242' .* joint names"):
        ik.load_inverter(model, robot=ik.load_robot("ur5e"))
    path = model / "model.safetensors"
    content = bytearray(path.read_bytes())
    content[-3] ^= 1
    path.write_bytes(content)
    for read in (ik.load_inverter, lambda folder: ik.train(**QUICK, out=folder.parent, resume=True)):
        with pytest.raises(ik.DataError, match="the weights are truncated or were changed since they were saved"):
            read(model)


def test_a_missing_gpu_is_one_line(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ik.ConfigError, match="device 'cuda': torch sees no CUDA device here; take cpu"):
        ik.train(**QUICK, device="cuda")


def test_optimizer_options_reach_the_optimizer():
    make = make_optimizer("levenberg_marquardt", options={"mu": 0.5})
    optimizer = make([torch.nn.Parameter(torch.zeros(2, 1, 1))], 2)
    assert (optimizer.defaults["mu"], optimizer.defaults["members"]) == (0.5, 2)


# ---------------------------------------------------------------- TensorBoard


def test_tensorboard_that_is_missing_is_named_with_its_extra(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ik.MissingExtraError, match=r"events need tensorboard; pip install 'ikgrad\[train\]'"):
        ik.train(**QUICK, tensorboard=True, out=tmp_path / "run")


def test_events_are_the_curves_also_after_a_kill(tmp_path: Path):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    folder = stopped(tmp_path / "run", tensorboard=True)
    result = ik.train(**QUICK, tensorboard=True, out=folder, resume=True)
    events = accumulator.EventAccumulator(str(folder / "tensorboard" / "seed-0"))
    events.Reload()
    for name, curve in (("train", result.curves[0].train), ("validation", result.curves[0].validation)):
        scalars = events.Scalars(f"loss/{name}")
        assert [event.step for event in scalars] == [1, 2, 3, 4]
        assert torch.allclose(torch.tensor([event.value for event in scalars]), curve.float())
