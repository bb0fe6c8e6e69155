"""Loops that numba compiles, against what NumPy does without it."""

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.depth.paths import add_best_paths
from coded_aperture_ros.depth.refine.layout import _put_in_squares, subtract_enlarged
from coded_aperture_ros.likelihood.products import products_of_transforms

RANDOM = np.random.default_rng(0)


def paths(function, shape, strength=1.0):
    rows, columns, _ = shape
    random = np.random.default_rng(1)
    volume = random.exponential(3.0, shape).astype(np.float32)
    weights = random.uniform(0, strength, (rows - 1, columns)).astype(np.float32)
    total = np.zeros(shape, np.float32)
    function(volume, weights, np.float32(4), np.float32(22), total)
    return total


@pytest.mark.parametrize("shape", [(9, 7, 12), (1, 5, 3), (6, 1, 2), (4, 4, 1)])
@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_both_forms_find_the_same_paths(shape, strength):
    pytest.importorskip("numba")
    compiled, plain = (
        paths(form, shape, strength) for form in (add_best_paths, add_best_paths.plain)
    )
    assert compiled == pytest.approx(plain, abs=1e-4)
    assert paths(add_best_paths.loop, shape, strength) == pytest.approx(plain, abs=1e-4)


@pytest.mark.parametrize("unpaired", [1, 2])
def test_both_forms_multiply_the_same_transforms(unpaired):
    pytest.importorskip("numba")
    parts = RANDOM.standard_normal((2 * 5 + unpaired, 2 * 33), dtype=np.float32)
    used = np.array([33, 30, 20, 7, 0, 33, 3, 0, 0, 1, 33, 12][: len(parts)])
    found = [np.empty(used.sum(), np.float32) for _ in range(3)]
    forms = products_of_transforms, products_of_transforms.plain, products_of_transforms.loop
    for form, products in zip(forms, found, strict=True):
        form(parts, 5, used, products)
    for products in found[1:]:
        assert products == pytest.approx(found[0], rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("shape", [(3, 4, 6), (2, 2, 2), (1, 1, 1)])
def test_both_forms_subtract_the_same(shape):
    pytest.importorskip("numba")
    costs = RANDOM.random(shape, dtype=np.float32)
    sizes = [np.ones((shape[0], 2 * shape[1], 2 * shape[2]), np.float32) for _ in range(3)]
    forms = subtract_enlarged, subtract_enlarged.plain, subtract_enlarged.loop
    for form, size in zip(forms, sizes, strict=True):
        form(costs, size)
    for size in sizes[1:]:
        assert size == pytest.approx(sizes[0], abs=1e-6)


def test_both_forms_put_cells_in_the_same_squares():
    pytest.importorskip("numba")
    values = RANDOM.random((3, 2, 4, 6), dtype=np.float32)
    squares = [np.empty((2, 3, 4, 2, 3), np.float32) for _ in range(3)]
    forms = _put_in_squares, _put_in_squares.plain, _put_in_squares.loop
    for form, found in zip(forms, squares, strict=True):
        form(values, found)
    for found in squares[1:]:
        assert np.array_equal(found, squares[0])


def test_without_numba_numpy_does_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    called = []
    Compiled(lambda: called.append("loop"), lambda: called.append("plain"))()
    assert called == ["plain"]


class Numba:
    """Compiles nothing, and fails where it is told to."""

    def __init__(self, fails):
        self.asked, self.fails = [], fails

    def njit(self, cache, **_):
        self.asked.append(cache)

        def compiled(loop):
            def run():
                if self.fails(cache):
                    raise EOFError("Ran out of input")
                loop()

            return run

        return compiled


@pytest.mark.parametrize(
    ("fails", "asked", "expected"),
    [
        (lambda cache: False, [True], "loop"),
        (lambda cache: cache, [True, False], "loop"),
        (lambda cache: True, [True, False], "plain"),
    ],
)
def test_what_numba_cannot_do_is_done_all_the_same(monkeypatch, caplog, fails, asked, expected):
    numba = Numba(fails)
    monkeypatch.setitem(sys.modules, "numba", numba)
    called = []
    compiled = Compiled(lambda: called.append("loop"), lambda: called.append("plain"))
    compiled()
    compiled()
    assert (numba.asked, called) == (asked, [expected] * 2)
    assert ("more slowly" in caplog.text) == (expected == "plain")


def test_what_numba_cannot_do_later_is_done_all_the_same(monkeypatch):
    """Arrays of another layout are compiled anew, when another file of the folder may be broken."""
    numba = Numba(lambda cache: False)
    monkeypatch.setitem(sys.modules, "numba", numba)
    called = []
    compiled = Compiled(lambda: called.append("loop"), lambda: called.append("plain"))
    compiled()
    for numba.fails in (lambda cache: cache, lambda cache: True):
        compiled()
    assert numba.asked == [True, True, False, True, False]
    assert called == ["loop", "loop", "plain"]


def test_threads_that_call_first_compile_once(monkeypatch):
    numba = Numba(lambda cache: False)
    monkeypatch.setitem(sys.modules, "numba", numba)
    called = []
    compiled = Compiled(lambda: called.append("loop"), lambda: called.append("plain"))
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: compiled(), range(8)))
    assert numba.asked == [True] and called == ["loop"] * 8
