"""The slow reference BLAS of apt is noticed, and nothing else is mistaken for it."""

import pytest

from coded_aperture_ros.core.blas import SLOW_BLAS_WARNING, slow_blas_warning

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
