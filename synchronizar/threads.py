"""BLAS held to one thread.

Matrices here are small: OpenBLAS's threads wait for each other longer than they compute, at the price of a whole core.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _controller() -> ThreadpoolController:
    """Of the libraries that are loaded; finding them takes a millisecond, numpy's is there before anybody asks."""
    import numpy as np  # noqa: F401 - the library is numpy's

    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS has one thread within; as a decorator, during a call. Afterwards it has as many as before."""
    with _controller().limit(limits=1, user_api="blas"):
        yield
