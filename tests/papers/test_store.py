"""Stored studies: they come back as they were, and no file can ask for anything but records of this package."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from ikgrad.config import AppsConfig
from ikgrad.errors import DataError
from ikgrad.papers.record import Check
from ikgrad.papers.store import load_study, save_study
from ikgrad.solvers.solution import Reason


def test_every_kind_of_value_comes_back(tmp_path: Path):
    odd = {"a": (1, 2.5, None, True, float("inf")), "b": [torch.arange(3), np.eye(2)], "c": Reason.converged}
    record = Check("claim", True, json.dumps([1]))
    nested = Check(AppsConfig(random_starts=7), record, odd)  # type: ignore[arg-type]
    save_study(nested, tmp_path / "study.npz")
    back: Any = load_study(tmp_path / "study.npz")
    assert back.claim == AppsConfig(random_starts=7)
    assert back.holds == record
    assert back.measured["a"] == odd["a"]
    assert back.measured["c"] is Reason.converged
    assert back.measured["b"][0].tolist() == [0, 1, 2]
    assert isinstance(back.measured["b"][1], np.ndarray)


def test_what_cannot_be_stored_is_refused(tmp_path: Path):
    with pytest.raises(TypeError, match="cannot store set"):
        save_study(Check("a", True, {1}), tmp_path / "study.npz")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "of",
    ["os:system", "subprocess:Popen", "ikgrad.papers.store:save_study", "ikgrad.nothing:Check", "ikgrad.errors:No"],
)
def test_a_file_gets_nothing_but_records(of: str, tmp_path: Path):
    path = tmp_path / "study.npz"
    np.savez(path, study=np.array(json.dumps({"$": "record", "of": of, "fields": {}})))
    with pytest.raises(DataError, match=r"study\.npz: is no study of this version of ikgrad; reproduce it anew"):
        load_study(path)


def test_files_that_are_no_study(tmp_path: Path):
    with pytest.raises(DataError, match="no such file"):
        load_study(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("text")
    with pytest.raises(DataError, match="is no study"):
        load_study(tmp_path / "text.npz")
