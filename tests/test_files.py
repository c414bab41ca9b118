"""Pose and joint files: every kind there and back, and one clear line for everything that is wrong with one."""

import re
import sys

import numpy as np
import pytest
import torch

import ikgrad as ik
from ikgrad.errors import DataError, MissingExtraError
from ikgrad.files import check_output, joint_writer, open_joints, open_poses, pose_writer
from ikgrad.files.places import in_one_move
from ikgrad.files.poses import COLUMNS, from_matrices, from_quaternions
from ikgrad.rotations import nearest_rotation

HEADER = ",".join(COLUMNS)
GOOD = "0.5,0,0.3,0,1,0,0"
KINDS = [".csv", ".npy", ".npz", ".parquet"]


@pytest.fixture(scope="module")
def robot():
    return ik.load_robot("panda")


@pytest.fixture(scope="module")
def poses(robot):
    return ik.forward_kinematics(robot, ik.sample_configurations(robot, 100, seed=0))


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def read_poses(path, **settings):
    return torch.cat([targets.T for targets in open_poses(path, **settings).chunks(7)])


def read_csv(path):
    return read_poses(path)


# ---------------------------------------------------------------- there and back


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("chunk", [1, 7, 100, 1000])
def test_poses_come_back_whatever_the_chunks(tmp_path, poses, kind, chunk):
    path = tmp_path / f"poses{kind}"
    with pose_writer(path) as writer:
        for part in poses.split(chunk):
            writer.append(part)
    file = open_poses(path)
    assert file.total == 100
    sizes = [len(targets.T) for targets in file.chunks(30)]
    assert sizes == [30, 30, 30, 10]
    torch.testing.assert_close(read_poses(path), poses, rtol=0, atol=1e-15 if kind[1:3] == "np" else 1e-14)


@pytest.mark.parametrize("kind", [".csv", ".npz", ".parquet"])
def test_joints_come_back_exactly(tmp_path, robot, kind):
    q = ik.sample_configurations(robot, 50, seed=1)
    results = {
        "row": np.arange(50),
        "solution": np.zeros(50, dtype=int),
        "q": q.numpy(),
        "position_error_m": np.full(50, np.nan),
        "success": np.arange(50) % 2 == 0,
        "reason": np.array(["converged", "joint_limits"] * 25),
    }
    path = tmp_path / f"q{kind}"
    with joint_writer(path, robot) as writer:
        for k in range(0, 50, 20):
            writer.append({name: column[k : k + 20] for name, column in results.items()})
    file = open_joints(path, robot)
    assert file.total == 50
    assert torch.equal(torch.cat(list(file.chunks(9))), q)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_chunks_give_the_same_bytes(tmp_path, poses, kind):
    for name in ("a", "b"):
        with pose_writer(tmp_path / f"{name}{kind}") as writer:
            writer.append(poses[:60])
            writer.append(poses[60:])
    assert (tmp_path / f"a{kind}").read_bytes() == (tmp_path / f"b{kind}").read_bytes()


def test_npz_of_joints_is_plain_numpy(tmp_path, robot):
    with joint_writer(tmp_path / "q.npz", robot) as writer:
        writer.append({"q": np.zeros((3, 7)), "success": np.array([True, False, True])})
    with np.load(tmp_path / "q.npz") as archive:
        assert archive["joint_names"].tolist() == list(robot.joint_names)
        assert archive["q"].shape == (3, 7)
        assert archive["success"].tolist() == [True, False, True]


def test_csv_columns_may_be_in_any_order(tmp_path):
    path = write(tmp_path / "p.csv", "qw,qx,qy,qz,x_m,y_m,z_m\n0,1,0,0,1,2,3\n")
    assert read_csv(path)[0, :3, 3].tolist() == [1, 2, 3]


def test_csv_of_other_programs_is_read(tmp_path):
    text = f"\ufeff{HEADER.replace(',', ', ')}\r\n{GOOD}\r\n\r\n" + '"0.5", 0,0.3,0,1.0e0,0,0\r\n  \r\n'
    path = tmp_path / "p.csv"
    path.write_bytes(text.encode())
    assert open_poses(path).total == 2
    assert torch.equal(*read_csv(path))


def test_joints_are_found_by_name(tmp_path):
    robot = ik.load_robot("arm4")
    names = robot.joint_names
    path = write(tmp_path / "q.csv", f"reason,{','.join(names[::-1])}\nconverged,4,3,2,1\n")
    assert next(open_joints(path, robot).chunks()).tolist() == [[1, 2, 3, 4]]
    np.savez(tmp_path / "q.npz", q=[[4.0, 3, 2, 1]], joint_names=names[::-1])
    assert next(open_joints(tmp_path / "q.npz", robot).chunks()).tolist() == [[1, 2, 3, 4]]


def test_numpy_files_of_any_layout_are_read(tmp_path, poses):
    single = poses.float()
    np.save(tmp_path / "f.npy", np.asfortranarray(single.numpy()))
    np.save(tmp_path / "b.npy", poses.numpy().astype(">f8"))
    np.savez_compressed(tmp_path / "c.npz", whatever=poses.numpy())
    np.savez(tmp_path / "d.npz", other=np.zeros(3), poses=poses.numpy())
    assert torch.equal(read_poses(tmp_path / "f.npy"), single.double())
    for name in ("b.npy", "c.npz", "d.npz"):
        assert torch.equal(read_poses(tmp_path / name), poses)


def test_parquet_of_pandas_kind_is_read(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet

    columns = {name: pa.array([0.0, None], pa.float32()) for name in COLUMNS} | {"qw": pa.array([1, 1])}
    pa.parquet.write_table(pa.table(columns), tmp_path / "p.parquet")
    T = read_poses(tmp_path / "p.parquet")
    assert torch.equal(T[0], torch.eye(4, dtype=torch.float64))
    assert not T[1].isfinite().all()


@pytest.mark.parametrize("rows_a_group", [10_000, 1_000_000])
def test_parquet_is_read_piece_by_piece_whatever_its_row_groups(tmp_path, rows_a_group: int):
    import pyarrow as pa
    import pyarrow.parquet

    random, path = np.random.default_rng(0), tmp_path / "p.parquet"
    columns = {name: random.random(400_000) for name in COLUMNS}
    pa.parquet.write_table(pa.table(columns), path, row_group_size=rows_a_group, use_dictionary=False)
    del columns
    before, most, rows = pa.total_allocated_bytes(), 0, 0
    for targets in open_poses(path).chunks(5_000):
        most = max(most, pa.total_allocated_bytes() - before)
        rows += len(targets.T)
    assert rows == 400_000
    assert 0 < most < path.stat().st_size / 2


# ---------------------------------------------------------------- bad values are rows, not errors


def test_missing_numbers_and_nan_make_an_invalid_row(tmp_path):
    path = write(tmp_path / "p.csv", f"{HEADER}\n{GOOD}\nnan,0,0,1,0,0,0\n,0,0,1,0,0,0\n0,inf,0,1,0,0,0\n")
    [targets] = open_poses(path).chunks()
    assert targets.T.isfinite().all(dim=-1).all(dim=-1).tolist() == [True, False, False, False]
    assert targets.deviation.isnan().tolist() == [False, True, True, True]


def test_quaternions_are_normalised_within_a_thousandth():
    rows = torch.zeros(4, 7, dtype=torch.float64)
    rows[:, 3] = torch.tensor([1.0005, 1.002, 2.0, 0.0])
    plain, repaired = from_quaternions(rows), from_quaternions(rows, repair=True)
    assert plain.T.isfinite().flatten(1).all(dim=1).tolist() == [True, False, False, False]
    assert repaired.T.isfinite().flatten(1).all(dim=1).tolist() == [True, True, True, False]
    assert torch.equal(repaired.T[2], torch.eye(4, dtype=torch.float64))
    torch.testing.assert_close(plain.deviation[2], torch.tensor(15.0, dtype=torch.float64))


def test_deviation_says_by_how_much_and_repair_projects(poses):
    bent = poses[:5].clone()
    bent[1, :3, :3] *= 1.01
    bent[2, 0, 0] = torch.nan
    bent[3, :3, 0] *= -1  # mirrored
    bent[4] = bent[4].mT.clone()  # transposed: the position is in the last row
    before = bent.clone()
    plain, repaired = from_matrices(bent), from_matrices(bent, repair=True)
    assert plain.deviation[0] < 1e-12
    torch.testing.assert_close(plain.deviation[1].item(), 1.01**2 - 1)
    assert plain.deviation[2].isnan()
    assert plain.deviation[3:].isinf().all()
    assert torch.equal(repaired.T[0], poses[0])
    torch.testing.assert_close(repaired.T[1, :3, :3], nearest_rotation(bent[1, :3, :3]))
    torch.testing.assert_close(repaired.T[1], poses[1])
    assert torch.equal(repaired.T[3:], bent[3:])
    assert torch.equal(bent.nan_to_num(9), before.nan_to_num(9))


def test_singular_matrices_are_not_repaired():
    zero = torch.zeros(1, 4, 4, dtype=torch.float64)
    zero[0, 3, 3] = 1
    assert torch.equal(from_matrices(zero, repair=True).T, zero)


# ---------------------------------------------------------------- bad files

BAD_CSV = {
    "": "p.csv: is empty; expected the header x_m,y_m,z_m,qw,qx,qy,qz",
    HEADER: "p.csv: has a header but no rows",
    f"{HEADER}\n\n  \n": "p.csv: has a header but no rows",
    f"{GOOD}\n{GOOD}\n": "p.csv, line 1: the header is missing; expected x_m,",
    f"{HEADER}\n{GOOD}\n\n0.5,0,abc,0,1,0,0\n": "p.csv, line 4, column 'z_m': expected a number, got 'abc'",
    f"{HEADER}\n0.5,0,1_0,0,1,0,0\n": "line 2, column 'z_m': expected a number, got '1_0'",
    f"{HEADER}\n{GOOD}\n0.5,0,0.3,0,1,0\n": "p.csv, line 3: expected 7 values, got 6",
    f"{HEADER}\n{GOOD},9\n": "p.csv, line 2: expected 7 values, got 8",
    f"{HEADER}\n{GOOD.replace(',', ';')}\n": "p.csv, line 2: expected 7 values, got 1",
    f"{HEADER[:-3]}\n{GOOD[:-2]}\n": "p.csv, line 1: column 'qz' is missing (expected x_m,",
    f"{HEADER},note\n{GOOD},1\n": "p.csv, line 1: unknown column 'note' (expected",
    f"{HEADER.replace('x_m', 'x_mm')}\n{GOOD}\n": "line 1: unknown column 'x_mm'; did you mean 'x_m'?",
    f"{HEADER},qw\n{GOOD},1\n": "line 1: column 'qw' is there twice",
    f"{HEADER.replace(',', ';')}\n{GOOD}\n": "with commas between, got 'x_m;y_m;z_m;qw;qx;qy;qz'",
    "\x7fELF\x00\x01\n\x00": "p.csv, line 1: ",
}


@pytest.mark.parametrize("text", BAD_CSV)
def test_bad_csv_is_one_clear_line(tmp_path, text):
    path = write(tmp_path / "p.csv", text)
    with pytest.raises(DataError, match=re.escape(BAD_CSV[text])) as caught:
        read_csv(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


def test_bytes_that_are_no_text_are_named(tmp_path):
    path = tmp_path / "p.csv"
    path.write_bytes(f"{HEADER}\n".encode() + b"0.5,\xff\xfe,0.3,0,1,0,0\n")
    with pytest.raises(DataError, match="line 2, column 'y_m': expected a number"):
        read_csv(path)


BAD_ARRAYS = {
    "vector.npy": (np.zeros(4), "expected shape (N, 4, 4), got (4,)"),
    "one.npy": (np.eye(4), "expected shape (N, 4, 4), got (4, 4)"),
    "three.npy": (np.zeros((5, 3, 3)), "expected shape (N, 4, 4), got (5, 3, 3)"),
    "scalar.npy": (np.float64(1), "expected shape (N, 4, 4), got ()"),
    "none.npy": (np.zeros((0, 4, 4)), "has no rows"),
    "text.npy": (np.full((1, 4, 4), "a"), "expected real numbers, got <U1"),
    "complex.npy": (np.zeros((1, 4, 4), complex), "expected real numbers, got complex128"),
    "object.npy": (np.full((1, 4, 4), None), "expected real numbers, got object"),
}


@pytest.mark.parametrize("name", BAD_ARRAYS)
def test_bad_arrays_are_one_clear_line(tmp_path, name):
    array, message = BAD_ARRAYS[name]
    np.save(tmp_path / name, array)
    with pytest.raises(DataError, match=re.escape(message)):
        open_poses(tmp_path / name)


def test_npz_must_say_which_array(tmp_path):
    np.savez(tmp_path / "p.npz", a=np.zeros(3), b=np.zeros(3))
    with pytest.raises(DataError, match=r"p\.npz: expected an array 'poses', or only one; it has a, b"):
        open_poses(tmp_path / "p.npz")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("damage", ["truncated", "rubbish", "empty"])
def test_damaged_files_are_data_errors(tmp_path, poses, kind, damage):
    path = tmp_path / f"p{kind}"
    with pose_writer(path) as writer:
        writer.append(poses)
    data = path.read_bytes()
    path.write_bytes({"truncated": data[: len(data) - 55], "rubbish": b"rubbish" * 30, "empty": b""}[damage])
    with pytest.raises(DataError) as caught:
        read_poses(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_flipped_byte_in_npz_is_found(tmp_path, poses):
    path = tmp_path / "p.npz"
    np.savez_compressed(path, poses=poses.numpy())
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))
    with pytest.raises(DataError, match=r"p\.npz: is not a readable \.npz file"):
        read_poses(path)


def test_parquet_with_wrong_columns(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet

    columns = {name: pa.array([0.0]) for name in COLUMNS}
    path = tmp_path / "p.parquet"
    for change, message in [
        ({"qw": pa.array(["one"])}, "column 'qw' must hold numbers, got string"),
        ({"qv": pa.array([1.0])}, "unknown column 'qv'"),
    ]:
        pa.parquet.write_table(pa.table(columns | change), path)
        with pytest.raises(DataError, match=re.escape(message)):
            open_poses(path)
    pa.parquet.write_table(pa.table(columns).slice(0, 0), path)
    with pytest.raises(DataError, match="has columns but no rows"):
        open_poses(path)


@pytest.mark.parametrize("use", [open_poses, lambda path: pose_writer(path).__enter__()])
def test_parquet_without_pyarrow_says_what_to_install(tmp_path, monkeypatch, use):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    path = tmp_path / "p.parquet"
    if use is open_poses:
        path.touch()
    with pytest.raises(
        MissingExtraError, match=re.escape("p.parquet: Parquet files need pyarrow; pip install 'ikgrad[data]'")
    ):
        use(path)


def test_places_that_are_no_files(tmp_path):
    for path, message in [
        (tmp_path / "none.csv", "no such file"),
        (tmp_path / "p.txt", r"unknown kind of file '\.txt' \(known: \.csv, \.npy, \.npz, \.parquet\)"),
        (tmp_path, "unknown kind of file ''"),
    ]:
        with pytest.raises(DataError, match=message):
            open_poses(path)
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(DataError, match="is a folder, not a file"):
        open_poses(tmp_path / "folder.csv")


def test_joint_files_must_fit_the_robot(tmp_path, robot):
    path = write(tmp_path / "q.csv", "panda_joint1,panda_jiont2\n1,2\n")
    with pytest.raises(DataError, match="unknown column 'panda_jiont2'; did you mean 'panda_joint2'"):
        open_joints(path, robot)
    np.save(tmp_path / "q.npy", np.zeros((3, 6)))
    with pytest.raises(DataError, match=re.escape("expected shape (N, 7), got (3, 6)")):
        open_joints(tmp_path / "q.npy", robot)
    np.savez(tmp_path / "q.npz", q=np.zeros((3, 7)))
    with pytest.raises(DataError, match="'joint_names' is missing"):
        open_joints(tmp_path / "q.npz", robot)


def test_a_joint_named_like_a_result_needs_npz(tmp_path):
    rows = [{"theta": 0, "d": 0, "a": 1, "alpha": 0}]
    robot = ik.Robot.from_dh(rows, convention="standard")
    from dataclasses import replace

    robot = replace(robot, variables=(robot.variables[0]._replace(name="steps"),))
    with pytest.raises(DataError, match=r"joint 'steps' is named like a column of results; write a \.npz"):
        joint_writer(tmp_path / "q.csv", robot).__enter__()
    with joint_writer(tmp_path / "q.npz", robot) as writer:
        writer.append({"q": np.zeros((1, 1))})
    assert open_joints(tmp_path / "q.npz", robot).total == 1


# ---------------------------------------------------------------- outputs appear whole or not at all


@pytest.mark.parametrize("kind", KINDS)
def test_an_error_leaves_nothing_behind(tmp_path, poses, kind):
    path = tmp_path / f"p{kind}"
    path.write_text("precious")
    with pytest.raises(KeyboardInterrupt), pose_writer(path, force=True) as writer:  # noqa: PT012
        writer.append(poses)
        raise KeyboardInterrupt
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "precious"


def test_what_appears_meanwhile_is_not_overwritten(tmp_path):
    path = tmp_path / "a.csv"
    with pytest.raises(DataError, match="exists already"), in_one_move(path) as temporary:  # noqa: PT012
        temporary.write_text("new")
        path.write_text("old")
    assert path.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_outputs_are_checked_before_the_work(tmp_path):
    kinds = [".csv"]
    old = write(tmp_path / "old.csv", "x")
    for path, message in [
        (tmp_path / "none" / "a.csv", "the folder '.*none' does not exist; create it first"),
        (tmp_path / "a.xls", r"unknown kind of file '\.xls' \(known: \.csv\)"),
        (old, "exists already; it is overwritten with --force only"),
    ]:
        with pytest.raises(DataError, match=message):
            check_output(path, kinds)
    assert check_output(old, kinds, force=True) == old
    with pytest.raises(DataError, match="is the input"):
        check_output(old, kinds, force=True, inputs=[old])


def test_a_folder_that_is_not_writable_is_refused(tmp_path, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("ikgrad.files.places.tempfile.TemporaryFile", refuse)  # root may write anywhere
    with pytest.raises(DataError, match="is not writable: Permission denied"):
        check_output(tmp_path / "a.csv", [".csv"])
