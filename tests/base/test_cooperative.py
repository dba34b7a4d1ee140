from __future__ import annotations

from synchronizar.cooperative import Cooperative, finish


def counting(to: int, done: list[int]) -> Cooperative[str]:
    for n in range(to):
        done.append(n)
        yield
    return f"{to} portions"


def test_all_portions_that_are_left_are_done_and_the_result_is_told() -> None:
    done: list[int] = []
    work = counting(3, done)
    next(work)
    assert done == [0]
    assert finish(work) == "3 portions"
    assert done == [0, 1, 2]


def test_work_without_portions_is_done_at_once() -> None:
    assert finish(counting(0, [])) == "0 portions"
