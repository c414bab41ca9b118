"""What people and programs see: tables, one JSON document, notes and progress."""

from __future__ import annotations

import contextlib
import json
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from types import TracebackType
from typing import Any

PATIENCE = 2.0  # seconds before progress is shown
INTERVAL = 5.0  # seconds between lines where there is no terminal


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, with a sentence about what became of the work."""


@contextlib.contextmanager
def stop_between_steps() -> Iterator[Callable[[], None]]:
    """Ctrl-C waits for the next call of the function that is yielded; a second one does not wait."""
    pressed = False

    def remember(*_: object) -> None:
        nonlocal pressed
        pressed = True
        signal.signal(signal.SIGINT, before)

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, remember)
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], *, right: Sequence[int] = ()
) -> None:
    """A table on stdout; columns listed in ``right`` are flush right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_header=any(columns))
    for k, name in enumerate(columns):
        table.add_column(Text(name), justify="right" if k in right else "left")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    print(title, flush=True)
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 160, highlight=False).print(table)


def print_json(document: Any) -> None:
    """One JSON document on stdout; what is not finite becomes null."""
    print(json.dumps(finite(document), indent=1, allow_nan=False))


def finite(value: Any) -> Any:
    """The same with null for numbers that JSON does not know."""
    if isinstance(value, dict):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def note(text: str) -> None:
    """One line on stderr."""
    print(f"ikgrad: {' '.join(text.split())}", file=sys.stderr, flush=True)


class Progress:
    """Progress on stderr for work that takes over two seconds: a bar on a terminal, else a line every few seconds.

    Args:
        what: what is being done.
        total: how much there is to do.
        unit: of what.

    Example:
        with Progress("solve", 1000, "poses") as progress:
            progress.advance(100)
    """

    def __init__(self, what: str, total: int, unit: str):
        self.what, self.total, self.unit = what, total, unit
        self.done = 0
        self._skipped = 0
        self._start = time.monotonic()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def advance(self, count: int) -> None:
        """So much more was done."""
        self.done += count

    def skip(self, count: int) -> None:
        """So much was there already and says nothing about the rate."""
        self.done += count
        self._skipped += count

    @property
    def rate(self) -> float:
        """Units per second so far."""
        return (self.done - self._skipped) / max(time.monotonic() - self._start, 1e-9)

    def __enter__(self) -> Progress:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        if self._stop.wait(PATIENCE):
            return
        if sys.stderr.isatty():
            self._bar()
        else:
            self._lines()

    def _lines(self) -> None:
        while True:
            note(f"{self.what}: {self.state()}")
            if self._stop.wait(INTERVAL):
                return

    def _bar(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn
        from rich.progress import Progress as Bar

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %  {task.fields[speed]}"),
        )
        with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(self.what, total=self.total, speed="")
            while not self._stop.wait(0.2):
                bar.update(task, completed=self.done, speed=self.speed())

    def state(self) -> str:
        """How far it has come, for a line of text."""
        return f"{self.done:,} of {self.total:,} {self.unit}, {self.speed()}"

    def speed(self) -> str:
        """How fast it goes and how long it will take, for the end of a bar."""
        if self.done <= self._skipped:
            return "starting"
        left = (self.total - self.done) / self.rate
        rate = f"{self.rate:,.0f}" if self.rate >= 10 else f"{self.rate:.2g}"
        return f"{rate} {self.unit}/s, {duration(left)} left"


def duration(seconds: float) -> str:
    """A time span as people say it.

    Example:
        >>> duration(3.21), duration(75), duration(7300)
        ('3.2 s', '1 min 15 s', '2 h 1 min')
    """
    if seconds < 10:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes == 0:
        return f"{rest} s"
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
