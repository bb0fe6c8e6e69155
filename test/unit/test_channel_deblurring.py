"""All-in-focus frames whose colour channels have PSFs of their own."""

import dataclasses

import cv2
import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer, make_deblurrer
from coded_aperture_ros.deblur.several import ChannelDeblurrer
from coded_aperture_ros.likelihood.bank import learn_bank
from coded_aperture_ros.optics import Mask, PsfStack, render_psf_stack

SIZES = np.linspace(3, 9, 7)
LEVEL = 4


@pytest.fixture(scope="module")
def stack():
    """PSFs of three masks, one for each channel."""
    colours = [render_psf_stack(Mask.named(name), SIZES).psfs for name in ("levin", "zhou", "disc")]
    return PsfStack(SIZES, np.mean(colours, axis=0), channel_psfs=np.stack(colours))


@pytest.fixture(scope="module")
def scene(stack):
    """Sharp and coded colour picture of a plane."""
    random = np.random.default_rng(1)
    sharp = cv2.GaussianBlur(random.random((96, 128, 3), np.float32), (0, 0), 1.5)
    sharp = (0.5 + 2 * (sharp - 0.5)).clip(0, 1)
    coded = [
        cv2.filter2D(sharp[..., channel], -1, psfs[LEVEL, ::-1, ::-1].copy())
        for channel, psfs in enumerate(stack.channel_psfs)
    ]
    noise = 0.001 * random.standard_normal(sharp.shape, np.float32)
    return sharp, (np.stack(coded, axis=-1) + noise).clip(0, 1)


def error(found, sharp):
    return float(np.sqrt(np.mean((found - sharp)[16:-16, 16:-16] ** 2)))


@pytest.mark.parametrize("method", ["fast", "inverse", "cg"])
def test_each_channel_is_deblurred_with_its_own_psfs(stack, scene, method):
    sharp, coded = scene
    config = DeblurConfig(method=method)
    size_px = np.full(coded.shape[:2], SIZES[LEVEL], np.float32)
    plain = Deblurrer(dataclasses.replace(stack, channel_psfs=None), config)
    own = ChannelDeblurrer(stack, config)
    with_mean, with_own = (error(one.deblur(coded, size_px, 0.001), sharp) for one in (plain, own))
    for one in (plain, own):
        one.close()
    assert with_own < 0.85 * with_mean


def test_a_frame_without_colour_has_the_psfs_of_the_mean(stack, scene):
    grey = np.ascontiguousarray(scene[1].mean(axis=-1))
    size_px = np.full(grey.shape, SIZES[LEVEL], np.float32)
    plain = Deblurrer(dataclasses.replace(stack, channel_psfs=None))
    own = ChannelDeblurrer(stack)
    assert np.array_equal(own.deblur(grey, size_px, 0.001), plain.deblur(grey, size_px, 0.001))
    for one in (plain, own):
        one.close()


def test_the_bank_decides(stack, scene):
    plain = dataclasses.replace(stack, channel_psfs=None)
    found = [make_deblurrer(learn_bank(one)) for one in (stack, plain)]
    assert [type(one) for one in found] == [ChannelDeblurrer, Deblurrer]
    size_px = np.full(scene[1].shape[:2], SIZES[LEVEL], np.float32)
    sharp = found[0].deblur(scene[1], size_px, 0.001)
    assert found[0].uncertainty(scene[1], sharp, size_px, 0.001).std_dev.shape == sharp.shape[:2]
    other = DeblurConfig(method="inverse")
    found[0].reconfigure(other)
    assert found[0].config == other
    for one in found:
        one.close()


def test_a_stack_of_one_psf_is_refused(stack):
    with pytest.raises(InputError, match="channel_psfs"):
        ChannelDeblurrer(dataclasses.replace(stack, channel_psfs=None))
