"""Deblurring by the closed forms and their network on PyTorch: the same as by NumPy and OpenCV."""

import numpy as np
import pytest

from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.optics import Mask, render_psf_stack

RANDOM = np.random.default_rng(0)
SAME = 1e-5
# Levels with equal distances, and with others.
SIZES_PX = np.linspace(2, 12, 21), np.append(np.linspace(2, 8, 13), [9.5, 12])


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch", reason="needs PyTorch")


@pytest.fixture(params=["torch", "cuda"])
def backend(request, torch):
    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip("needs a CUDA device")
    return request.param


def frame_and_map(shape):
    """Return a frame, and a map of three surfaces with a hole where nothing is known."""
    blur = np.full(shape[:2], 4, np.float32)
    blur[: shape[0] // 2] = 9
    blur[shape[0] // 4 : shape[0] // 2, 10:40] = 2.5
    blur[-20:, -30:] = np.nan
    return RANDOM.uniform(0.1, 0.9, shape).astype(np.float32), blur


@pytest.mark.parametrize("shape", [(96, 128, 3), (96, 128), (101, 75, 3)])
@pytest.mark.parametrize("sizes_px", SIZES_PX)
def test_pictures_are_those_of_the_processor(backend, shape, sizes_px):
    stack = render_psf_stack(Mask.named("levin"), sizes_px)
    frame, blur = frame_and_map(shape)
    found, expected = (
        Deblurrer(stack, DeblurConfig(**own)).deblur(frame, blur, noise=0.003)
        for own in ({"backend": backend}, {"network": "opencv"})
    )
    assert found.shape == shape and found.dtype == np.float32
    assert np.abs(found - expected).max() < SAME


def test_frames_of_a_video_take_turns_with_noise_and_size(backend):
    """Filters that are kept on the device are those of a frame's noise and size."""
    stack = render_psf_stack(Mask.named("levin"), SIZES_PX[0])
    on_device, usual = (
        Deblurrer(stack, DeblurConfig(**own))
        for own in ({"backend": backend}, {"network": "opencv"})
    )
    for shape, noise in (((96, 128), 0.001), ((80, 96), 0.001), ((96, 128), 0.01)) * 2:
        frame, blur = frame_and_map(shape)
        found, expected = (each.deblur(frame, blur, noise) for each in (on_device, usual))
        assert np.abs(found - expected).max() < SAME


def test_iterations_begin_with_what_the_device_found(backend):
    stack = render_psf_stack(Mask.named("levin"), SIZES_PX[0])
    frame, blur = frame_and_map((96, 128))
    config = {"method": "cg", "iterations": 2}
    found, expected = (
        Deblurrer(stack, DeblurConfig(**config, **own)).deblur(frame, blur, noise=0.003)
        for own in ({"backend": backend}, {"network": "opencv"})
    )
    assert np.abs(found - expected).max() < 1e-3


def test_another_backend_makes_new_filters(backend):
    stack = render_psf_stack(Mask.named("levin"), SIZES_PX[0])
    frame, blur = frame_and_map((96, 128))
    deblurrer = Deblurrer(stack, DeblurConfig(network="opencv"))
    before = deblurrer.deblur(frame, blur, noise=0.003)
    deblurrer.reconfigure(DeblurConfig(backend=backend))
    assert np.abs(deblurrer.deblur(frame, blur, noise=0.003) - before).max() < SAME


def test_a_frame_without_light_stays_as_it_is(backend):
    stack = render_psf_stack(Mask.named("levin"), SIZES_PX[0])
    deblurrer = Deblurrer(stack, DeblurConfig(backend=backend))
    blur = np.full((64, 64), 5, np.float32)
    assert (deblurrer.deblur(np.zeros((64, 64), np.float32), blur, noise=0.003) == 0).all()


def test_a_frame_stays_on_its_device(torch):
    """PyTorch without a GPU knows on which device results would be."""
    from torch._subclasses.fake_tensor import FakeTensorMode

    from coded_aperture_ros.core.tensors import constants, filters
    from coded_aperture_ros.deblur.blend import Blend
    from coded_aperture_ros.deblur.blend.on_device.blend import DeviceBlend

    stack = render_psf_stack(Mask.named("levin"), SIZES_PX[0])
    caches = constants._copied, filters._matrix, filters._border
    try:
        with FakeTensorMode():
            for cache in caches:
                cache.cache_clear()
            blend = DeviceBlend(stack, 10, Workers(), "cuda")
            channels = [torch.empty(101, 75, device="cuda") for _ in range(3)]
            known = torch.empty(101, 75, device="cuda", dtype=torch.bool)
            found = Blend._blended(blend, channels, channels[0], known, 0.003, 0.003)
    finally:
        for cache in caches:
            cache.cache_clear()
    assert [str(each.device) for each in found] == ["cuda:0"] * 3
    assert {tuple(each.shape) for each in found} == {(101, 75)}
