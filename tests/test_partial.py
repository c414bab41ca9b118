"""Runs that can be stopped and gone on with."""

import numpy as np
import pytest

from ikgrad.errors import DataError
from ikgrad.files import PartialRun

MANIFEST = {"seed": 0, "mask": None, "tolerance": 1e-6}


def part(k):
    return {"q": np.full((3, 2), float(k)), "reason": np.array(["converged"] * 3)}


def test_parts_come_back(tmp_path):
    output = tmp_path / "q.csv"
    run = PartialRun.open(output, MANIFEST)
    for k in (0, 3):
        run.save(k, part(k))
    again = PartialRun.open(output, MANIFEST, resume=True)
    assert again.folder == tmp_path / "q.csv.partial"
    assert again.finished == {0, 3}
    loaded = again.load(3)
    assert list(loaded) == ["q", "reason"]
    assert np.array_equal(loaded["q"], part(3)["q"])
    assert loaded["reason"].tolist() == ["converged"] * 3
    again.discard()
    assert list(tmp_path.iterdir()) == []


def test_resume_without_parts_begins(tmp_path):
    assert PartialRun.open(tmp_path / "q.csv", MANIFEST, resume=True).finished == set()


def test_resume_refuses_other_settings_and_names_them(tmp_path):
    output = tmp_path / "q.csv"
    PartialRun.open(output, MANIFEST).save(0, part(0))
    message = r"cannot go on with other settings: seed was 0, is 1; solver was None, is Apps\(\); --force starts anew"
    with pytest.raises(DataError, match=message):
        PartialRun.open(output, {**MANIFEST, "seed": 1, "solver": "Apps()"}, resume=True)
    assert PartialRun.open(output, MANIFEST, resume=True).finished == {0}


def test_an_unfinished_run_is_not_thrown_away_silently(tmp_path):
    output = tmp_path / "q.csv"
    PartialRun.open(output, MANIFEST).save(0, part(0))
    with pytest.raises(DataError, match="holds an unfinished run; --resume goes on with it, --force starts anew"):
        PartialRun.open(output, MANIFEST)
    assert PartialRun.open(output, MANIFEST, force=True).finished == set()


def test_stopped_before_the_manifest_was_there_begins_anew(tmp_path):
    (tmp_path / "q.csv.partial").mkdir()
    run = PartialRun.open(tmp_path / "q.csv", MANIFEST, resume=True)
    assert (run.folder / "manifest.json").exists()


@pytest.mark.parametrize("text", ["", "[]", "{"])
def test_a_damaged_manifest_is_refused(tmp_path, text):
    run = PartialRun.open(tmp_path / "q.csv", MANIFEST)
    run.save(0, part(0))
    (run.folder / "manifest.json").write_text(text)
    with pytest.raises(DataError, match=r"manifest\.json: cannot be read"):
        PartialRun.open(tmp_path / "q.csv", MANIFEST, resume=True)


def test_a_damaged_part_is_named(tmp_path):
    run = PartialRun.open(tmp_path / "q.csv", MANIFEST)
    run.save(0, part(0))
    path = run.folder / "part-000000.npz"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(DataError, match=r"part-000000\.npz"):
        run.load(0)


def test_discard_touches_nothing_of_others(tmp_path):
    run = PartialRun.open(tmp_path / "q.csv", MANIFEST)
    run.save(0, part(0))
    (run.folder / "notes.txt").write_text("mine")
    with pytest.raises(DataError, match="cannot be removed"):
        run.discard()
    assert [path.name for path in run.folder.iterdir()] == ["notes.txt"]
