"""Folders of input: what is read, what is refused, and how it is shared out."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikgrad.errors import ConfigError, DataError
from ikgrad.files.poses import COLUMNS
from ikgrad.jobs.partitions import LONGEST, Shard, list_names, look_at


@given(count=st.integers(1, 300), partitions=st.integers(0, 700))
def test_every_partition_belongs_to_exactly_one_shard(count: int, partitions: int):
    names = [f"{k:04d}" for k in range(partitions)]
    shares = [Shard(index, count).of(names) for index in range(1, count + 1)]
    assert sorted(name for share in shares for name in share) == names
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


@given(index=st.integers(-2, 12), count=st.integers(-2, 12))
def test_a_shard_is_i_of_n(index: int, count: int):
    text = f"{index}/{count}"
    if 1 <= index <= count:
        assert Shard.parse(text) == Shard(index, count)
    else:
        with pytest.raises(ConfigError, match="expected a shard i/N with i from 1 to N"):
            Shard.parse(text)


@pytest.mark.parametrize(
    "text", ["", "1", "a/b", "1/2/3", "1 / 2", "1.0/2", "+1/2", "\u0661/\u0662", "1/" + 5000 * "9"]
)
def test_what_is_no_shard(text: str):
    with pytest.raises(ConfigError, match="expected a shard i/N"):
        Shard.parse(text)


def folder_of(tmp_path: Path, *names: str) -> Path:
    for name in names:
        (tmp_path / name).write_bytes(b"")
    return tmp_path


def test_names_are_sorted_and_what_readers_pass_over_is_passed_over(tmp_path: Path):
    odd = ["b 2.parquet", "a'\"\n.parquet", "ü.parquet", "$(x).parquet", "-o.parquet", "c.d.parquet"]
    folder = folder_of(tmp_path, *odd, "_job.json", ".part.parquet", "_SUCCESS", "notes.txt", "_q.csv")
    (folder / "_records").mkdir()
    (folder / ".cache").mkdir()
    assert list_names(folder) == sorted(name.removesuffix(".parquet") for name in odd)


@pytest.mark.skipif(os.name != "posix", reason="names are bytes there only")
def test_a_name_that_is_no_text_is_a_name(tmp_path: Path):
    path = os.path.join(os.fsencode(tmp_path), b"\xff.parquet")
    try:
        Path(os.fsdecode(path)).write_bytes(b"")
    except OSError:
        pytest.skip("this file system wants text")
    assert list_names(tmp_path) == ["\udcff"]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ([], r"holds no \.parquet files"),
        (["notes.txt", "_a.parquet"], r"holds no \.parquet files"),
        (["a.parquet", "b.csv"], r"b\.csv: a folder holds partitions named NAME\.parquet only"),
        (["a.parquet", "b.PARQUET"], r"b\.PARQUET: a folder holds"),
        (["x" * (LONGEST + 1) + ".parquet"], f"is longer than {LONGEST} bytes"),
    ],
)
def test_folders_that_are_refused(tmp_path: Path, names, said):
    with pytest.raises(DataError, match=said):
        list_names(folder_of(tmp_path, *names))


def test_folders_inside_are_refused(tmp_path: Path):
    (tmp_path / "more").mkdir()
    with pytest.raises(DataError, match="more: is a folder inside; partitions lie side by side"):
        list_names(folder_of(tmp_path, "a.parquet"))
    with pytest.raises(DataError, match="none: no such folder"):
        list_names(tmp_path / "none")


@pytest.mark.parametrize("content", [b"", b"PAR1", b"x,y\n1,2\n" * 9, b"\0" * 999])
def test_what_is_not_parquet(tmp_path: Path, content: bytes):
    (tmp_path / "a.parquet").write_bytes(content)
    with pytest.raises(DataError, match=r"a\.parquet: is not a readable Parquet file"):
        look_at(tmp_path / "a.parquet", COLUMNS)


def test_wrong_columns(tmp_path: Path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"x_m": [1.0], "y": [2.0]}), tmp_path / "a.parquet")
    with pytest.raises(DataError, match=r"a\.parquet: unknown column 'y'"):
        look_at(tmp_path / "a.parquet", COLUMNS)
