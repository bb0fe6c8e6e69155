"""BLAS: kernels and threads are what they should be, and the slow reference is noticed."""

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


FLAGS = "fpu avx2 avx512f avx512dq avx512ifma avx512cd avx512bw avx512vl"
CPU = "processor\t: {}\nvendor_id\t: {}\ncpu family\t: {}\nmodel name\t: A: B\nflags\t\t: {}\n\n"


@pytest.fixture
def kernels(tmp_path, monkeypatch):
    """Kernels that are set for the processor that a text describes; None: the library chooses."""

    def choose(text):
        path = tmp_path / "cpuinfo"
        path.write_text(text)
        set_blas_variables(path)
        return os.environ.get("OPENBLAS_CORETYPE")

    for name in ("OPENBLAS_CORETYPE", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    return choose


def test_zen_5_uses_its_vectors(kernels):
    text = "".join(CPU.format(number, "AuthenticAMD", 26, FLAGS) for number in range(2))
    assert kernels(text) == "SkylakeX"
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"


@pytest.mark.parametrize(
    "text",
    [
        CPU.format(0, "AuthenticAMD", 25, FLAGS),
        CPU.format(0, "AuthenticAMD", 26, "fpu avx2 avx512f"),
        CPU.format(0, "GenuineIntel", 26, FLAGS),
        "processor\t: 0\nBogoMIPS\t: 108.00\nFeatures\t: fp asimd\nCPU implementer\t: 0x41\n",
        "",
    ],
)
def test_of_other_processors_the_library_knows_best(kernels, text):
    assert kernels(text) is None


def test_the_user_chooses(kernels, monkeypatch, tmp_path):
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Haswell")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    assert kernels(CPU.format(0, "AuthenticAMD", 26, FLAGS)) == "Haswell"
    assert os.environ["OPENBLAS_NUM_THREADS"] == "2"
    set_blas_variables(tmp_path / "missing")


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
