"""The folder of a run: settings, history, checkpoint, weights, and a report; every file in it appears whole.

config.yaml     all settings, as resolved
run.json        state, seeds, robot, versions, machine, and in the end epochs, times and test errors
history.csv     errors along the training
evaluation.json what the result is worth on fresh rows, where `ikgrad train` measured it
model/          the inverter, see `ikgrad.networks.storage`; model-0/, model-1/ ... for several members
checkpoint      there while the run is unfinished; all that it needs to go on
tensorboard/    events, when asked
"""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ikgrad.config.training import AnyConfig
from ikgrad.errors import DataError
from ikgrad.files.partial import differences
from ikgrad.files.places import in_one_move
from ikgrad.networks import save_inverter
from ikgrad.networks.storage import AnyInverter
from ikgrad.training.checkpoint import load_checkpoint, save_checkpoint
from ikgrad.training.jobs import Job

FORMAT = "ikgrad run 1"
CONFIG, REPORT, HISTORY, CHECKPOINT, EVENTS = "config.yaml", "run.json", "history.csv", "checkpoint", "tensorboard"
EVALUATION = "evaluation.json"
RUNNING, FINISHED = "running", "finished"


class RunFolder:
    """A folder for one run; nothing is made before `begin`."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._job: dict[str, Any] = {}

    @property
    def checkpoint(self) -> Path:
        """Where an unfinished run stands."""
        return self.path / CHECKPOINT

    @property
    def events(self) -> Path:
        """Of TensorBoard."""
        return self.path / EVENTS

    def check(self, *, resume: bool, force: bool, job: Job | None = None) -> bool:
        """Refuse a place that cannot be used, before any work is done.

        Args:
            resume: go on with the run that is there.
            force: replace it.
            job: of torchrun. A run that it began itself is gone on with, whatever the other two say.

        Returns:
            Whether to go on with what is there.

        Raises:
            DataError: it is no folder, holds something else, cannot be written to, or holds a run and neither
                ``resume`` nor ``force`` is given.
        """
        if self.path.exists() and not self.path.is_dir():
            raise DataError(f"{self.path}: is a file, not a folder")
        if job is not None:
            self._job = {"job": job.record()}
            resume = self._is_begun_by(job) or resume
        if self._has_content():
            if not (self.path / REPORT).is_file():
                raise DataError(f"{self.path}: exists and holds no training run; choose another name")
            if not (resume or force):
                raise DataError(f"{self.path}: {self._what_is_there()}")
        parent = next(folder for folder in (self.path.absolute(), *self.path.absolute().parents) if folder.exists())
        try:  # asking the file system is surer than reading permission bits
            with tempfile.TemporaryFile(dir=parent):
                pass
        except OSError as error:
            raise DataError(f"{self.path}: the folder '{parent}' is not writable: {error.strerror}") from error
        return resume

    def open(self, manifest: Mapping[str, Any], config: AnyConfig, *, resume: bool) -> dict[str, Any] | None:
        """Begin a run, or go on with the one that is there.

        Args:
            manifest: all that the result depends on, as flat values under readable names.
            config: the settings.
            resume: go on, if there is something to go on with.

        Returns:
            The state that the last checkpoint holds; None to begin.

        Raises:
            DataError: the run that is there is another one, has failed, or its files are damaged.
        """
        report = self.report() if resume and (self.path / REPORT).exists() else None
        if report is None:
            self._begin(manifest, config)
            return None
        self._compare(report["manifest"], manifest)
        if report["state"] not in (RUNNING, FINISHED):
            raise DataError(f"{self.path}: this run has ended: {report['state']}; --force starts anew")
        self._sweep()
        if self._job and report["state"] == RUNNING:
            with self._writing():
                self._write_report({**report, **self._job})  # from now on it is this job's
        if not self.checkpoint.exists():
            return None
        state = load_checkpoint(self.checkpoint)
        self._compare(state["manifest"], manifest)
        return state

    def report(self) -> dict[str, Any]:
        """What run.json says.

        Raises:
            DataError: it cannot be read, or is damaged.
        """
        path = self.path / REPORT
        try:
            report = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise DataError(f"{path}: cannot be read: {error.strerror}") from error
        except ValueError as error:
            raise DataError(f"{path}: is damaged, so the run cannot go on; --force starts anew") from error
        if not isinstance(report, dict) or report.get("format") != FORMAT or not {"state", "manifest"} <= report.keys():
            raise DataError(f"{path}: is no run of this version of ikgrad (wanted: format '{FORMAT}')")
        return report

    def save_state(self, state: Mapping[str, Any], history: str) -> None:
        """Write the checkpoint, and the history so far, as CSV, for who looks on."""
        with self._writing():
            save_checkpoint(self.checkpoint, dict(state))
            self._write(HISTORY, history)

    def finish(self, report: Mapping[str, Any], inverters: Mapping[Path, AnyInverter], history: str) -> None:
        """Write weights, history and report; then the checkpoint has nothing more to say and goes."""
        with self._writing():
            for folder, inverter in inverters.items():
                save_inverter(inverter, folder, force=True)
            self._write(HISTORY, history)
            self._write_report({**report, **self._job})
            self.checkpoint.unlink(missing_ok=True)

    def models(self, members: int) -> list[Path]:
        """The folder of every member's weights."""
        return [self.path / "model"] if members == 1 else [self.path / f"model-{k}" for k in range(members)]

    def history(self) -> list[list[str]]:
        """The rows of history.csv without their heading.

        Raises:
            DataError: it cannot be read.
        """
        try:
            text = (self.path / HISTORY).read_text(encoding="utf-8")
        except OSError as error:
            raise DataError(f"{self.path / HISTORY}: cannot be read: {error.strerror}") from error
        return [line.split(",") for line in text.split()[1:]]

    def keep_evaluation(self, records: Sequence[Mapping[str, Any]]) -> None:
        """Write what the result was measured to be worth."""
        with self._writing():
            self._write(EVALUATION, json.dumps(list(records), indent=1) + "\n")

    def _begin(self, manifest: Mapping[str, Any], config: AnyConfig) -> None:
        with self._writing():
            self.path.mkdir(parents=True, exist_ok=True)
            self._clear()
            self._write_report({"format": FORMAT, "state": RUNNING, "manifest": dict(manifest), **self._job})
            self._write(CONFIG, config.to_yaml())

    def _is_begun_by(self, job: Job) -> bool:
        try:
            return job.began(self.report().get("job"))
        except DataError:
            return False

    def _compare(self, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
        differs = differences(before, now)
        if differs:
            raise DataError(f"{self.path}: cannot go on with other settings: {'; '.join(differs)}; --force starts anew")

    def _what_is_there(self) -> str:
        if self.checkpoint.exists():
            return "holds an unfinished run; --resume goes on with it, --force starts anew"
        return "holds a run already; it is replaced with --force only"

    def _has_content(self) -> bool:
        return self.path.exists() and any(not _is_left_over(path) for path in self.path.iterdir())

    def _clear(self) -> None:
        """Remove the files of a run; what else somebody put there stays."""
        for path in [self.path / name for name in (HISTORY, CHECKPOINT, CONFIG, EVALUATION)]:
            path.unlink(missing_ok=True)
        for folder in [self.events, *self.path.glob("model"), *self.path.glob("model-*")]:
            shutil.rmtree(folder, ignore_errors=True)
        self._sweep()

    def _sweep(self) -> None:
        """Remove what a kill in the middle of writing left."""
        for path in list(self.path.iterdir()):
            if _is_left_over(path):
                shutil.rmtree(path) if path.is_dir() else path.unlink()

    def _write_report(self, report: Mapping[str, Any]) -> None:
        self._write(REPORT, json.dumps(dict(report), indent=1, allow_nan=False) + "\n")

    def _write(self, name: str, text: str) -> None:
        with in_one_move(self.path / name, force=True) as temporary:
            temporary.write_text(text, encoding="utf-8")

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """A failing disk: one line, and what is left to go on with."""
        try:
            yield
        except (OSError, DataError) as error:
            text = str(error) if isinstance(error, DataError) else f"{self.path}: cannot write: {error.strerror}"
            kept = "; the checkpoint before is kept, --resume goes on from there" if self.checkpoint.exists() else ""
            raise DataError(text + kept) from error


def _is_left_over(path: Path) -> bool:
    return path.name.startswith(".") and (".tmp" in path.name or path.suffix == ".old")


__all__ = ["FINISHED", "RunFolder"]
