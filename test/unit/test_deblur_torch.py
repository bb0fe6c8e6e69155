"""Deblurring on PyTorch gives what NumPy gives."""

import numpy as np
import pytest
from deblur_scene import assert_adjoint, levin_basis, levin_stack
from scipy import ndimage, signal

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.deblur.operator import SpreadingBlur

torch = pytest.importorskip("torch", reason="needs PyTorch")
DEVICES = pytest.mark.parametrize(
    "backend",
    [
        "torch",
        pytest.param(
            "cuda",
            marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device"),
        ),
    ],
)
SHAPE = (90, 110)


@pytest.fixture(scope="module")
def stack():
    return levin_stack()


@pytest.fixture(scope="module")
def blur():
    """A slant with a square in front of it."""
    blur = np.tile(np.linspace(5, 11, SHAPE[1], dtype=np.float32), (SHAPE[0], 1))
    blur[30:60, 40:70] = 2.5
    return blur


@DEVICES
def test_operator_is_that_of_numpy(blur, backend):
    from coded_aperture_ros.deblur.torch_blur import TorchBlur

    basis = levin_basis()
    expected = SpreadingBlur(basis, blur)
    found = TorchBlur(basis, blur, "cuda" if backend == "cuda" else "cpu")
    assert (found.shape, found.scene_shape) == (expected.shape, expected.scene_shape)
    random = np.random.default_rng(0)
    scene = random.random(expected.scene_shape, np.float32)
    frame = random.random(SHAPE, np.float32)
    blurred = found.to_numpy(found.forward(found.array(scene)))
    spread = found.to_numpy(found.adjoint(found.array(frame)))
    assert blurred == pytest.approx(expected.forward(scene), abs=2e-5)
    assert spread == pytest.approx(expected.adjoint(frame), abs=2e-5)
    assert_adjoint(found)
    for (share, power), (own_share, own_power) in zip(
        found.ranges(4), expected.ranges(4), strict=True
    ):
        assert found.to_numpy(share) == pytest.approx(own_share, abs=1e-5)
        assert found.to_numpy(power) == pytest.approx(own_power, abs=1e-4)


@DEVICES
@pytest.mark.parametrize("colour", [False, True])
def test_frame_is_deblurred_alike(stack, blur, backend, colour):
    random = np.random.default_rng(1)
    sharp = ndimage.zoom(random.random((13, 15)), 10, order=0)
    coded = signal.convolve(sharp, stack.psfs[5], mode="same")[: SHAPE[0], : SHAPE[1]]
    if colour:
        coded = np.dstack([coded, 0.8 * coded, coded**2])
    coded = (coded + random.normal(0, 0.002, coded.shape)).astype(np.float32)
    results = []
    for one in ("numpy", backend):
        deblurrer = Deblurrer(stack, DeblurConfig(method="cg", backend=one))
        results.append(deblurrer.deblur(coded, blur, 0.002))
        deblurrer.close()
    assert results[0].dtype == results[1].dtype == np.float32
    assert results[1] == pytest.approx(results[0], abs=2e-3)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_missing_device_is_named():
    with pytest.raises(InputError, match="backend: PyTorch finds no CUDA device here"):
        DeblurConfig(backend="cuda")
