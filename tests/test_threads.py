from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from synchronizar.estimation.register import register
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate
from synchronizar.threads import one_blas_thread


def blas_threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


def test_blas_has_one_thread_within_and_what_it_had_afterwards() -> None:
    before = blas_threads()
    with one_blas_thread():
        assert set(blas_threads()) <= {1}
        assert np.linalg.inv(np.eye(3)).sum() == 3.0
    assert blas_threads() == before


def test_who_fails_within_gives_the_threads_back() -> None:
    before = blas_threads()
    with pytest.raises(KeyError), one_blas_thread():
        raise KeyError
    assert blas_threads() == before


def test_a_registration_computes_on_one_thread() -> None:
    seen: list[int] = []
    recording = simulate(Scene(users=2, seconds=4.0)).recording
    register(recording, model="rigid", progress=lambda _: seen.extend(blas_threads()))
    assert seen
    assert set(seen) == {1}
