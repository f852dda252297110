"""Results that several threads ask for are found once."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest

from hmkcta.support.once import Once


def test_who_asks_meanwhile_waits_for_the_first() -> None:
    results, begun, go_on = Once[str](2), Event(), Event()

    def slow() -> str:
        begun.set()
        assert go_on.wait(timeout=30)
        return "found by the first"

    def never() -> str:
        raise AssertionError("it is being found")

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(results.get, "key", slow)
        assert begun.wait(timeout=30)
        second = pool.submit(results.get, "key", never)
        go_on.set()
        assert first.result() == second.result() == "found by the first"


def test_an_error_is_raised_to_all_who_ask() -> None:
    results = Once[int](2)

    def failing() -> int:
        raise ZeroDivisionError

    for find in (failing, lambda: 1):
        with pytest.raises(ZeroDivisionError):
            results.get("key", find)


def test_what_was_not_asked_for_lately_is_found_again() -> None:
    results, found = Once[int](2), list[int]()

    def ask(key: int) -> int:
        return results.get(key, lambda: found.append(key) or key)

    assert [ask(key) for key in (1, 2, 1, 3, 1, 2)] == [1, 2, 1, 3, 1, 2]
    assert found == [1, 2, 3, 2]
