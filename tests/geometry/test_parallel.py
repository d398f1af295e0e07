"""Work on several threads: order, errors, and when items are drawn."""

import threading
import time

import pytest

from jaxcap.parallel import parallel_map


def test_results_come_in_order_and_items_are_drawn_by_the_caller():
    drawn = []

    def items():
        for number in range(20):
            drawn.append(threading.get_ident())
            yield number

    def square(number):
        time.sleep(0.002 * (number % 3))
        return number**2

    assert list(parallel_map(square, items())) == [number**2 for number in range(20)]
    assert set(drawn) == {threading.get_ident()}


def test_the_first_is_done_alone_and_nothing_is_drawn_far_ahead():
    begun, drawn = [], []

    def items():
        for number in range(100):
            drawn.append(number)
            yield number

    results = parallel_map(lambda number: begun.append(number) or number, items())
    assert next(results) == 0
    assert begun == [0] and drawn == [0]
    next(results)
    assert len(drawn) < 50
    results.close()


def test_without_compilation_the_first_item_does_not_hold_up_the_others(monkeypatch):
    monkeypatch.setattr("jaxcap.parallel.os.cpu_count", lambda: 2)
    both = threading.Barrier(2, timeout=20)
    results = parallel_map(lambda number: both.wait() >= 0 and number, range(2), is_compiled=True)
    assert list(results) == [0, 1]


def test_an_error_is_raised_where_its_result_would_have_been():
    def work(number):
        if number == 3:
            raise ValueError("three")
        return number

    results = parallel_map(work, range(6))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="three"):
        next(results)
    assert list(parallel_map(work, [])) == []
