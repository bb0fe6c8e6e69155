"""Arithmetic that is written once: what another backend of arrays would have to offer."""

import re
from pathlib import Path

import numpy as np
import pytest

# What is taken beside the array API standard: forms of its functions by the names of both NumPy and
# PyTorch (their `min`, `max` and `concat` differ), and functions that `core.tensors.functions` has.
BESIDE = {
    *("amin", "amax", "concatenate", "ascontiguousarray", "copy", "einsum", "outer", "nan_to_num"),
    *("interp", "bincount", "median", "cumsum"),
}


def names(checkout):
    """Return the functions that are taken from the namespace of an argument."""
    files = (Path(checkout) / "coded_aperture_ros").rglob("*.py")
    return {name for file in files for name in re.findall(r"\bxp\.(\w+)\b", file.read_text())}


def test_arithmetic_for_all_arrays_goes_by_the_standard_but_for_a_few_functions(checkout):
    standard = pytest.importorskip("array_api_strict")
    used = names(checkout)
    assert len(used) > 30
    assert {name for name in used if not hasattr(standard, name)} == BESIDE


def test_numpy_and_pytorch_have_all_functions(checkout):
    pytest.importorskip("torch", reason="needs PyTorch")
    from coded_aperture_ros.core.tensors import functions

    for name in names(checkout) - {"fft"}:
        assert hasattr(np, name), name
        assert getattr(functions, name) is not None
