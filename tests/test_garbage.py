"""The garbage collector is put to rest and comes back, whatever happens."""

import gc

import pytest

from ikgrad.garbage import no_collection


def test_the_collector_comes_back_also_after_an_error():
    def fail() -> None:
        with no_collection(), no_collection():
            assert not gc.isenabled()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert gc.isenabled()


def test_a_collector_that_was_off_stays_off():
    gc.disable()
    try:
        with no_collection():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_overlapping_blocks_leave_the_collector_on():
    first, second = no_collection(), no_collection()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    second.__exit__(None, None, None)
    assert gc.isenabled()
