"""Threads, forks and interrupts."""

import os
import threading

import numpy as np
import pytest

from ikgrad import engine
from ikgrad.data import sample_configurations
from ikgrad.engine.parallel import for_chunks


def test_every_row_is_done_once():
    for rows in (0, 1, 99, 100, 101, 1234):
        seen = np.zeros(rows, dtype=int)

        def work(a, b, seen=seen):
            seen[a:b] += 1

        for_chunks(work, rows, 10, 4)
        assert (seen == 1).all()


def test_callers_may_ask_for_different_numbers_of_threads_at_once():
    failures = []

    def call(count):
        try:
            for _ in range(200):
                for_chunks(lambda a, b: None, 40, 1, count)
        except RuntimeError as error:
            failures.append(error)

    callers = [threading.Thread(target=call, args=(count,)) for count in (2, 3, 4, 5)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert not failures


def test_an_interrupt_stops_all_threads():
    calls = []

    def work(a, b):
        calls.append(a)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        for_chunks(work, 1000, 1, 2)
    assert len(calls) <= 2


def test_several_python_threads_may_call_at_once(panda):
    chain, q = engine.pack(panda), sample_configurations(panda, 9000, seed=0).numpy()
    T = engine.fk(chain, q)
    expected, results = engine.solve(chain, T).q, [None] * 6

    def call(i):
        results[i] = engine.solve(chain, T, threads=2).q

    threads = [threading.Thread(target=call, args=(i,)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for result in results:
        np.testing.assert_array_equal(result, expected)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_child_can_call(panda):
    chain, q = engine.pack(panda), sample_configurations(panda, 9000, seed=0).numpy()
    expected = engine.fk(chain, q, threads=2)
    child = os.fork()
    if child == 0:
        os._exit(0 if np.array_equal(engine.fk(chain, q, threads=2), expected) else 1)
    assert os.waitpid(child, 0)[1] == 0
