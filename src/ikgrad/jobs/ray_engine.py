"""The engine for many machines: actors on a Ray cluster, each fed name by name.

The cluster is one that exists (``address``), one that this process is already connected to, or one that is started on
this machine for the job and stopped after it. The actors do not get our code sent: every machine has the same ikgrad
installed, and sees the same folders.

Plain actors, not ``ray.data``: what goes out are names and what comes back are records, the poses never pass through
Ray. For that a data pipeline only adds to the bill, which ``python scripts/bench_scale.py --overhead`` prints: the time
beyond that of the work itself, for local processes, these actors and `map_batches` of Ray Data.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import signal
import socket
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from types import ModuleType
from typing import Any

from ikgrad import __version__
from ikgrad.errors import ConfigError, DataError
from ikgrad.extras import need
from ikgrad.jobs.local import STRIKES
from ikgrad.jobs.task import Record, Task
from ikgrad.jobs.worker import portable

STORE = 80 * 2**20  # bytes for the objects of a cluster of ours: Ray's least; records are small
PATIENCE = 5.0  # seconds for a cluster to accept a connection


def run_ray(
    task: Task, names: Sequence[str], *, workers: int, threads: int, address: str | None = None
) -> Generator[Record, None, None]:
    """Do partitions with actors of a Ray cluster; a `KeyboardInterrupt` or an error stops all of them.

    A worker that dies is restarted by Ray and gets its partition again. Workers for which the cluster has no room yet
    join in when there is some.

    Args:
        task: what is done.
        names: the partitions.
        workers: actors at most; never more than there are partitions.
        threads: cores that each actor takes, and threads that it uses.
        address: ``auto`` (a cluster of which this machine is part), ``HOST:PORT`` of its head, or None for a cluster
            of our own on this machine. Ignored where this process is already connected to one.

    Yields:
        A record for each name, in order of completion.

    Raises:
        MissingExtraError: ray is not installed.
        ConfigError: nothing answers at ``address``, the cluster is too small for one worker, or
            its machines have another ikgrad.
        IkgradError, OSError: what the task raised.
        DataError: a partition ended its worker again and again.
    """
    if workers < 1 or threads < 1:
        raise ConfigError(f"workers and threads must be at least 1, got {workers} and {threads}")
    if not names:
        return
    workers = min(workers, len(names))
    with _cluster(address, cores=workers * threads) as ray:
        crew = _Crew(ray, task, workers=workers, threads=threads)
        try:
            yield from crew.work(names)
        finally:
            crew.end()


# ---------------------------------------------------------------- the cluster

# Read when ray is imported or a connection is made. Else it prints remarks about workers to stdout whatever it is told,
# and stacks of its own at SIGTERM.
QUIET = {
    "RAY_DEDUP_LOGS_SKIP_REGEX": ".",
    "RAY_DISABLE_FAILURE_SIGNAL_HANDLER": "1",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # no GPU is touched; else a FutureWarning says how that will change
}
# And, for a cluster of our own: it listens on the loop-back address only, as it does anyway where the name says.
LOCAL = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}


@contextlib.contextmanager
def _cluster(address: str | None, *, cores: int) -> Iterator[ModuleType]:
    """A connection for as long as the block lasts; one that was there before stays."""
    with _environment({**QUIET, **(LOCAL if address is None else {})}):
        ray = need("ray", extra="distributed", what="Ray clusters")
    if ray.is_initialized():
        yield ray
        return
    with _kept_terminal(), _own_cluster(ray, cores) if address is None else _joined_cluster(ray, address):
        yield ray


@contextlib.contextmanager
def _own_cluster(ray: ModuleType, cores: int) -> Iterator[None]:
    """A cluster of this machine that leaves nothing behind.

    Its files are in ``/tmp``, since names of sockets are short and those of other folders for such files may be long.
    """
    inherited = {
        **QUIET,
        **LOCAL,
        "PYTHONPATH": os.pathsep.join(os.path.abspath(path) for path in sys.path),
        "OMP_WAIT_POLICY": "passive",
        "RAY_USAGE_STATS_ENABLED": "0",
    }
    place = "/tmp" if os.path.isdir("/tmp") else None
    with tempfile.TemporaryDirectory(prefix="ikgrad-ray-", dir=place, ignore_cleanup_errors=True) as folder:
        try:
            with _environment(inherited):
                ray.init(
                    address="local",
                    num_cpus=cores,
                    num_gpus=0,
                    include_dashboard=False,
                    object_store_memory=STORE,
                    log_to_driver=False,
                    logging_level=logging.ERROR,
                    _temp_dir=folder,
                )
            yield
        finally:
            with contextlib.suppress(
                AttributeError
            ):  # no public way; politely asked, this process takes a second to end
                ray._private.worker._global_node.kill_monitor(check_alive=False)
            ray.shutdown()


@contextlib.contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """More environment variables for a while."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _joined_cluster(ray: ModuleType, address: str) -> Iterator[None]:
    """A connection to a cluster that somebody else runs."""
    if address != "auto":
        _check_that_it_answers(address)
    try:
        try:
            with _environment(QUIET):
                ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        except (ray.exceptions.RayError, ConnectionError, RuntimeError, ValueError) as error:
            hint = "a cluster with a token needs RAY_AUTH_MODE=token in the environment here, too"
            raise ConfigError(f"no Ray cluster to work with at '{address}': {_first_line(error)} ({hint})") from error
        yield
    finally:
        ray.shutdown()


def _check_that_it_answers(address: str) -> None:
    """Ray itself would try for a long time, and say much."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit():
        raise ConfigError(f"the address of a Ray cluster is 'auto' or HOST:PORT, got '{address}'")
    try:
        socket.create_connection((host.strip("[]"), int(port)), PATIENCE).close()
    except (OSError, OverflowError) as error:
        start = f"start one there with 'ray start --head --port {port}', or leave the address out to use this machine"
        raise ConfigError(f"no Ray cluster answers at {address} ({error}); {start}") from error


@contextlib.contextmanager
def _kept_terminal() -> Iterator[None]:
    """Ray's logger is quiet, and SIGTERM does afterwards what it did before."""
    logger, main = logging.getLogger("ray"), threading.current_thread() is threading.main_thread()
    level, handler = logger.level, signal.getsignal(signal.SIGTERM)
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)
        if main:
            signal.signal(signal.SIGTERM, handler)


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


# ---------------------------------------------------------------- the actors


class _Worker:
    """One actor: a process with a task of its own.

    What goes wrong is a value, since Ray wraps what is raised. The task comes with every call, as a reference inside a
    list: a restarted actor has to load it again, and another one only hands the reference on.
    """

    def __init__(self, threads: int, version: str):
        self._threads, self._version = threads, version
        self._task: Task | None = None

    def begin(self, shipped: list[Any]) -> Exception | None:
        """Load the task."""
        try:
            self._load(shipped)
        except Exception as error:  # whatever it is, the driver has to know
            return portable(error)
        return None

    def do(self, shipped: list[Any], name: str) -> Record | Exception:
        """Do a partition."""
        try:
            return self._load(shipped)(name)
        except Exception as error:  # as above
            return portable(error)

    def _load(self, shipped: list[Any]) -> Task:
        if self._task is None:
            import ray

            if self._version != __version__:
                where = f"{socket.gethostname()} in the Ray cluster has ikgrad {__version__}"
                raise ConfigError(f"{where}, this machine {self._version}; install the same on both")
            for library in ("OMP", "MKL", "OPENBLAS"):  # read when torch and numpy are loaded, by the next line
                os.environ[f"{library}_NUM_THREADS"] = str(self._threads)
            task = pickle.loads(ray.get(shipped[0]))
            if "torch" in sys.modules:
                sys.modules["torch"].set_num_threads(self._threads)
            task.warm_up()
            self._task = task
        return self._task


class _Crew:
    """The driver's side: which actor has what to do.

    One partition at a time for each. A second one in hand would save a message's way, a millisecond or two, and would
    be tried again, and counted as a strike, whenever the first one ends the worker.
    """

    def __init__(self, ray: ModuleType, task: Task, *, workers: int, threads: int):
        self._ray = ray
        cores = ray.cluster_resources().get("CPU", 0)
        if cores < threads:
            raise ConfigError(
                f"the Ray cluster has {cores:.0f} cores, but one worker is to have {threads} threads; give it fewer"
            )
        self._shipped = [ray.put(pickle.dumps(task))]
        actor = ray.remote(num_cpus=threads, max_restarts=-1, max_task_retries=STRIKES - 1)(_Worker)
        self._actors = [actor.remote(threads, __version__) for _ in range(workers)]

    def work(self, names: Sequence[str]) -> Iterator[Record]:
        """Records as they come; names go to actors that have begun, never to those that still wait for room."""
        left, missing = deque(names), len(names)
        running: dict[Any, tuple[Any, str | None]] = {
            actor.begin.remote(self._shipped): (actor, None) for actor in self._actors
        }
        while missing:
            [ready], _ = self._ray.wait(list(running))
            actor, name = running.pop(ready)
            outcome = self._outcome(ready, name)
            if isinstance(outcome, Exception):
                raise outcome
            if left:
                following = left.popleft()
                running[actor.do.remote(self._shipped, following)] = (actor, following)
            else:  # its room may be what another, restarted one is waiting for
                self._ray.kill(actor)
            if outcome is not None:
                missing -= 1
                yield outcome

    def _outcome(self, ready: Any, name: str | None) -> Record | Exception | None:
        try:
            return self._ray.get(ready)
        except self._ray.exceptions.RayActorError as error:
            if name is None:
                return ConfigError(f"a worker of the Ray cluster cannot start; {_last_line(error)}")
            return DataError(
                f"partition '{name}': {STRIKES} workers died over it, one after the other "
                "(killed, maybe for want of memory)"
            )

    def end(self) -> None:
        """Stop the actors at once; finished partitions are on disk."""
        for actor in self._actors:
            self._ray.kill(actor)


def _last_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[-1].strip()
