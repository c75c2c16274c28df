"""The linear algebra library has one thread while logs run side by side, and its own after."""

from __future__ import annotations

import threading

import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

from cellwise.threads import one_blas_thread

TWO = 2


def threads() -> set[int]:
    libraries = ThreadpoolController().select(user_api="blas").info()
    assert libraries
    return {library["num_threads"] for library in libraries}


@pytest.fixture(autouse=True)
def two_threads():
    import scipy.linalg  # noqa: F401

    before = {library["num_threads"] for library in ThreadpoolController().info()}
    threadpool_limits(TWO, user_api="blas")
    if threads() != {TWO}:
        pytest.skip("a linear algebra library that keeps its number of threads")
    yield
    threadpool_limits(max(before), user_api="blas")


def test_one_inside_and_as_before_after():
    assert one_blas_thread(threads)() == {1}
    assert threads() == {TWO}


def test_as_before_after_an_error():
    @one_blas_thread
    def fails():
        raise ValueError("on purpose")

    with pytest.raises(ValueError, match="on purpose"):
        fails()
    assert threads() == {TWO}


def test_a_call_within_a_call_leaves_the_outer_one_its_limit():
    @one_blas_thread
    def outer():
        one_blas_thread(threads)()
        return threads()

    assert outer() == {1}
    assert threads() == {TWO}


def test_another_thread_after_this_one():
    """The library lets one thread at a time say how many it has."""
    seen = []
    one_blas_thread(threads)()
    other = threading.Thread(target=lambda: seen.append(one_blas_thread(threads)()))
    other.start()
    other.join(10.0)
    assert seen == [{1}]
    assert threads() == {TWO}
