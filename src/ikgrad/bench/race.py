"""Time several solvers in turns (A B C A B C ...), so that a busy machine is busy for everybody."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ikgrad.bench.statistics import Interval, median_interval, paired_ratio

Advance = Callable[[int], None]
Work = Callable[[slice], "np.ndarray | None"]


@dataclass(eq=False)
class Runner:
    """One solver in the race.

    Attributes:
        name: for messages.
        work: does the rows of a slice and returns their answers.
        rows: how many rows there are.
        batch: rows a call.
        everything: do every row once, whatever it takes; others do what fits into the budget.
        seconds: seconds a row, a number for every round.
        calls: seconds a row, a number for every call.
        took: first row, last row and seconds of every call that gave answers.
        answers: of every call, by its first row; of the last one where rows were done again.
    """

    name: str
    work: Work
    rows: int
    batch: int
    everything: bool = False
    seconds: list[float] = field(default_factory=list)
    calls: list[float] = field(default_factory=list)
    took: list[tuple[int, int, float]] = field(default_factory=list)
    answers: dict[int, np.ndarray] = field(default_factory=dict)
    _next: int = 0
    _share: int = 1

    def warm_up(self, budget: float, rounds: int) -> None:
        """First calls compile and fill caches; then some calls say how many rows fit into a round.

        A round has at least one whole batch: in smaller ones a solver would look slower than it is.
        """
        most = self.rows if self.everything else max(1, self.rows // rounds)
        batch = min(self.batch, most)
        probe = batch if batch > 1 else min(most, 8)
        for _ in range(2):
            timed = list(self._calls(0, probe))
        row = sum(took for _, _, took, _ in timed) / probe
        fits = int(budget / rounds / max(row, 1e-9))
        self._share = min(max(fits, batch), most)

    def turn(self) -> None:
        """One round: some rows, in batches."""
        first = self._next if self._next + self._share <= self.rows else 0
        self._next = first + self._share
        self.seconds.append(self._run(first, first + self._share) / self._share)

    def finish(self) -> None:
        """Do the rows that no round has done, if every row is wanted."""
        done = np.zeros(self.rows, dtype=bool)
        for first, answer in self.answers.items():
            done[first : first + len(answer)] = True
        while self.everything and not done.all():
            first = int(np.argmin(done))
            last = min(first + self.batch, self.rows)
            self._run(first, last)
            done[first:last] = True

    def _run(self, first: int, last: int) -> float:
        total = 0.0
        for begin, end, took, answer in self._calls(first, last):
            total += took
            self.calls.append(took / (end - begin))
            if answer is not None:
                self.took.append((begin, end, took))
                self.answers[begin] = answer
        return total

    def _calls(self, first: int, last: int) -> Iterator[tuple[int, int, float, np.ndarray | None]]:
        """First and last row, seconds and answers of each call."""
        for start in range(first, last, self.batch):
            end = min(start + self.batch, last)
            begin = time.perf_counter()
            answer = self.work(slice(start, end))
            yield start, end, time.perf_counter() - begin, answer

    def gathered(self, width: int) -> tuple[np.ndarray, np.ndarray]:
        """(k,) row numbers that were done and (k, width) their answers, each row once."""
        done = np.zeros(self.rows, dtype=bool)
        q = np.full((self.rows, width), np.nan)
        for first, answer in self.answers.items():
            done[first : first + len(answer)] = True
            q[first : first + len(answer)] = answer
        return np.flatnonzero(done), q[done]

    @property
    def interval(self) -> Interval:
        """Seconds a row: median over the rounds."""
        return median_interval(self.seconds)

    def ratio_to(self, other: Runner) -> Interval:
        """How many times slower than another in the same race."""
        return paired_ratio(self.seconds, other.seconds)


def race(runners: Sequence[Runner], *, rounds: int, budget: float, advance: Advance = lambda _: None) -> None:
    """Warm everybody up, then let them run in turns.

    Args:
        runners: who takes part; they keep their timings.
        rounds: how often each has its turn.
        budget: seconds for each solver, all rounds together.
        advance: called with 1 after every turn.
    """
    for runner in runners:
        runner.warm_up(budget, rounds)
    for _ in range(rounds):
        for runner in runners:
            runner.turn()
            advance(1)
    for runner in runners:
        runner.finish()
