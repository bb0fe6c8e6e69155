"""BLAS: its threads are what they should be, and the slow reference is noticed."""

import os

import numpy as np
import pytest

from coded_aperture_ros.core.blas import (
    SLOW_BLAS_WARNING,
    _thread_functions,
    one_blas_thread,
    set_blas_variables,
    slow_blas_warning,
)

LINE = "7f0e52a00000-7f0e52a9d000 r-xp 00002000 fe:00 1234    {}\n"
LIB = "/usr/lib/x86_64-linux-gnu"


@pytest.mark.parametrize(
    "library",
    [f"{LIB}/blas/libblas.so.3.12.0", "/usr/lib/aarch64-linux-gnu/blas/libblas.so.3.10.1"],
)
def test_the_reference_is_noticed(tmp_path, library):
    maps = tmp_path / "maps"
    maps.write_text(LINE.format("/usr/bin/python3.12") + LINE.format(library))
    assert slow_blas_warning(maps) == SLOW_BLAS_WARNING


@pytest.mark.parametrize(
    "library",
    [
        f"{LIB}/openblas-pthread/libblas.so.3",
        f"{LIB}/openblas-pthread/libopenblasp-r0.3.26.so",
        f"{LIB}/blis-openmp/libblas.so.3",
        f"{LIB}/atlas/libblas.so.3.10.3",
        "/home/a/.venv/lib/python3.12/site-packages/numpy.libs/libscipy_openblas64_-8fb3d286.so",
    ],
)
def test_fast_ones_are_not(tmp_path, library):
    maps = tmp_path / "maps"
    maps.write_text(LINE.format(library))
    assert slow_blas_warning(maps) is None


def test_a_system_without_memory_maps(tmp_path):
    assert slow_blas_warning(tmp_path / "missing") is None


def test_this_process_is_readable():
    assert slow_blas_warning() in (None, SLOW_BLAS_WARNING)
    assert "sudo apt install libopenblas0" in SLOW_BLAS_WARNING


@pytest.mark.parametrize(("chosen", "expected"), [(None, "1"), ("2", "2")])
def test_the_user_chooses_the_threads(monkeypatch, chosen, expected):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", chosen or "")
    if chosen is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    set_blas_variables()
    assert os.environ["OPENBLAS_NUM_THREADS"] == expected


def test_one_thread_until_all_have_left():
    np.linalg.norm([1.0])  # loads it
    if not _thread_functions():
        pytest.skip("needs OpenBLAS")
    counts = [count() for count, _ in _thread_functions()]

    @one_blas_thread
    def inside():
        with one_blas_thread:
            pass
        return [count() for count, _ in _thread_functions()]

    try:
        for _, limit in _thread_functions():
            limit(2)
        assert inside() == [1] * len(counts)
        assert [count() for count, _ in _thread_functions()] == [2] * len(counts)
    finally:
        for (_, limit), before in zip(_thread_functions(), counts, strict=True):
            limit(before)
