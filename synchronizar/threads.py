"""BLAS held to one thread.

Matrices here are small: OpenBLAS's threads wait for each other longer than they compute, at the price of a whole core.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import LibController, ThreadpoolController


@cache
def _libraries() -> list[LibController]:
    """Those that are loaded; finding them takes a millisecond, numpy's is there before anybody asks."""
    import numpy as np  # noqa: F401 - the library is numpy's

    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS has one thread within; as a decorator, during a call. Afterwards it has as many as before."""
    before = [(library, threads) for library in _libraries() if (threads := library.get_num_threads()) != 1]
    try:
        for library, _ in before:
            library.set_num_threads(1)
        yield
    finally:
        for library, threads in before:
            library.set_num_threads(threads)
