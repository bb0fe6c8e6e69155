"""Loops that numba compiles, against what NumPy does without it."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.depth.decoders.network.cells import draw
from coded_aperture_ros.depth.decoders.network.network import add_up, gather_squares
from coded_aperture_ros.depth.decoders.network.probabilities import REACH, describe
from coded_aperture_ros.depth.decoders.semi_global import add_best_paths
from coded_aperture_ros.depth.levels import look_up
from coded_aperture_ros.likelihood.sliding import fold, slide

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


@pytest.mark.parametrize(
    ("window_px", "stride_px", "highest"), [(12, 4, 6), (12, 5, 3), (16, 24, 5), (8, 8, 4)]
)
def test_both_forms_slide_the_same(window_px, stride_px, highest):
    """With and without the highest frequency of all, overlap, and gaps between windows."""
    pytest.importorskip("numba")
    rows = np.zeros((2, window_px + 2 * stride_px + window_px, 16), np.float32)
    rows[:, window_px:] = RANDOM.standard_normal(rows[:, window_px:].shape)
    angle = (
        2 * np.pi / window_px * np.outer(np.arange(window_px // 2 + 1), np.arange(window_px + 3))
    )
    waves = np.stack([np.cos(angle), np.sin(angle)]).astype(np.float32)
    window = (0.5 - 0.5 * np.cos(angle[1, :window_px])).astype(np.float32)
    places = np.arange(2 * (highest + 1)).reshape(2, -1)
    places[0, 1] = places[1, highest] = -1
    found = [np.full((2 * (highest + 1), 3, 9), 7, np.float32) for _ in range(3)]
    for form, products in zip((slide, slide.plain, slide.loop), found, strict=True):
        sums = np.full((window_px // 2 + 3, 2, 32), 7, np.float32)
        buffers = np.zeros((8, 32), np.float32), sums, np.zeros((2, 16), np.float32)
        described = window, np.float32(-0.25), np.float32(0.5)
        form(rows, waves, described, stride_px, places, buffers, products)
        left_out = [1, 2 * highest + 1]
        assert (products[left_out] == 7).all() and (np.delete(products, left_out, 0) != 7).all()
    for products in found[1:]:
        assert products == pytest.approx(found[0], rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("rows", [(0, 8), (0, 2), (2, 6), (6, 8)])
def test_both_forms_add_up_the_same(rows):
    pytest.importorskip("numba")
    (first, end), columns = rows, 6
    cells = RANDOM.random((16, end - first, columns), dtype=np.float32)
    squares = RANDOM.random((3, 20, 4, columns // 2), dtype=np.float32)
    costs = RANDOM.random((3, 8, columns), dtype=np.float32)
    sizes = [np.zeros((4, 16, 2 * columns), np.float32) for _ in range(3)]
    for form, size in zip((add_up, add_up.plain, add_up.loop), sizes, strict=True):
        form(cells, squares, costs, first, size)
        outside = np.ones(size.shape, bool)
        outside[:3, 2 * first : 2 * end] = False
        assert (size[outside] == 0).all() and (size[~outside] != 0).all()
    for size in sizes[1:]:
        assert size == pytest.approx(sizes[0], abs=1e-6)


def test_half_cells_have_what_their_cell_and_square_say():
    """Each by another number: the column of a half-cell, of a cell, and the size."""
    cells = np.arange(4, dtype=np.float32)[:, None, None] * np.ones((1, 2, 4), np.float32)
    squares = np.zeros((1, 16, 1, 2), np.float32)
    squares[0, :, 0] = 10 * np.arange(16)[:, None]
    size = np.zeros((1, 4, 8), np.float32)
    add_up(cells, squares, np.full((1, 2, 4), 0.5, np.float32), 0, size)
    half, of_square = np.rint(size[0] + 0.5) % 10, (size[0] + 0.5) // 10
    assert half[:2, :2].tolist() == [[0, 1], [2, 3]] == half[2:, 6:].tolist()
    assert of_square[:2, :4].tolist() == [[0, 4, 1, 5], [8, 12, 9, 13]]
    assert of_square[2:, :4].tolist() == [[2, 6, 3, 7], [10, 14, 11, 15]]


def test_both_forms_put_cells_in_the_same_squares():
    pytest.importorskip("numba")
    cells, channels = RANDOM.random((5, 4, 6), dtype=np.float32), np.array([3, 0, 3])
    squares = [np.empty((3, 4, 2, 3), np.float32) for _ in range(3)]
    forms = gather_squares, gather_squares.plain, gather_squares.loop
    for form, found in zip(forms, squares, strict=True):
        form(cells, channels, found)
    for found in squares[1:]:
        assert np.array_equal(found, squares[0])
    assert squares[0][1, 3, 1, 2] == cells[0, 3, 5]


def test_without_numba_numpy_does_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    called = []
    Compiled(lambda: called.append("loop"), lambda: called.append("plain"))()
    assert called == ["plain"]


LOOPS = """
from types import FunctionType
from constants import SHARE
from functions import multiplied
from coded_aperture_ros.core.compiled import Compiled
def loop(values):
    for index in range(values.size):
        values[index] = multiplied(SHARE)
class WithFunction(Compiled):
    def _made(self, compiles):
        functions = {"multiplied": compiles(multiplied)}
        return compiles(FunctionType(loop.__code__, loop.__globals__ | functions))
compiled = WithFunction(loop, loop)
"""
ASK = "import numpy, loops; values = numpy.zeros(1); loops.compiled(values); print(values[0])"


def test_stored_code_follows_constants_and_functions_of_other_files(tmp_path):
    pytest.importorskip("numba")
    (tmp_path / "loops.py").write_text(LOOPS)
    for share, factor, said_share in (
        ("0.25", 2, "0.5"),
        ("0.75", 2, "1.5"),
        ("0.75", 2, "1.5"),
        ("0.75", 3, "2.25"),
    ):
        (tmp_path / "constants.py").write_text(f"import numpy\nSHARE = numpy.float32({share})")
        (tmp_path / "functions.py").write_text(f"def multiplied(x):\n    return {factor} * x\n")
        paths = os.pathsep.join([str(tmp_path), *sys.path])
        said = subprocess.run(
            [sys.executable, "-B", "-c", ASK],
            env={**os.environ, "PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
            capture_output=True,
            text=True,
            check=True,
        )
        assert said.stdout.strip() == said_share
    assert len(list((tmp_path / "cache").rglob("loops.*.nbi"))) == 1  # it was stored


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
    assert ("which is slower" in caplog.text) == (expected == "plain")


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


@pytest.mark.parametrize("stride_px", [8, 5, 20])
def test_both_forms_fold_the_same_windows(stride_px):
    """The halves of 3 windows, also where there are gaps between these."""
    pytest.importorskip("numba")
    pixels = RANDOM.random((4, 2 * stride_px + 12), dtype=np.float32)
    found = [np.full((2, 6, 5, 16), 7, np.float32) for _ in range(3)]
    for form, folded in zip((fold, fold.plain, fold.loop), found, strict=True):
        form(pixels, stride_px, 3, folded)
    for folded in found:
        assert np.array_equal(folded, found[0])
        assert (folded[:, :, 4:] == 7).all() and (folded[..., 3:] == 7).all()
    window = pixels[2, stride_px : stride_px + 12]
    assert np.array_equal(found[0][1, :, 2, 1], window[1:7] - window[:5:-1])


@pytest.mark.parametrize(("first", "shape"), [((0, 0), (40, 56)), ((5, 7), (33, 41))])
def test_both_forms_draw_the_same(first, shape):
    pytest.importorskip("numba")
    values = np.pad(RANDOM.random((10, 14), dtype=np.float32), 1, mode="edge")
    quarters = RANDOM.integers(0, values.size, (20, 28))
    maps = [np.empty(shape, np.float32) for _ in range(3)]
    for one_surface in (0.0, 0.9, 2.0):
        for form, drawn in zip((draw, draw.plain, draw.loop), maps, strict=True):
            form(values, quarters, np.float32(one_surface), first, drawn)
        for drawn in maps[1:]:
            assert drawn == pytest.approx(maps[0], abs=1e-6)


def test_both_forms_describe_the_same():
    pytest.importorskip("numba")
    padded = np.zeros((12 + 2 * REACH, 50), np.float32)
    padded[REACH:-REACH] = np.exp(-RANDOM.exponential(3, (12, 50)))
    sizes_px = np.arange(2, 8, 0.5, dtype=np.float32)
    found = []
    for form in (describe, describe.plain, describe.loop):
        found.append(
            (np.empty((4, 50), np.float32), np.empty(50, np.intp), np.empty((50, 5), np.float32))
        )
        form(padded, sizes_px, *found[-1])
    for results in found[1:]:
        for one, other in zip(results, found[0], strict=True):
            assert one == pytest.approx(other, abs=1e-5)


def test_both_forms_look_up_the_same_depths():
    """Where nothing is known, and where tables have no depth or an infinite one, too."""
    pytest.importorskip("numba")
    level = np.append(RANDOM.uniform(0, 4, 60), [0, 4]).astype(np.float32)
    deviation = RANDOM.random(62, dtype=np.float32)
    sizes, depths, per_level = RANDOM.random((3, 4 * 128 + 1), dtype=np.float32)
    depths[:100] = per_level[:100] = np.inf
    depths[-100:] = per_level[-100:] = np.nan
    found = [tuple(np.empty(62, np.float32) for _ in range(4)) for _ in range(3)]
    for form, maps in zip((look_up, look_up.plain, look_up.loop), found, strict=True):
        form(level, deviation, level % 1 < 0.2, (sizes, depths, per_level), maps)
    for maps in found[1:]:
        assert np.allclose(maps, found[0], rtol=1e-6, atol=0, equal_nan=True)
