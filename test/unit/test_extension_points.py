"""A regulariser and a likelihood method from outside, as docs/architecture.md explains."""

import dataclasses
import inspect

import numpy as np
import pytest
from scipy import ndimage
from textures import blurred_texture

from coded_aperture_ros import DepthEstimator, FramePipeline, learn_bank
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import Cost
from coded_aperture_ros.likelihood.bank import LearnConfig
from coded_aperture_ros.optics import Mask, PsfStack, render_psf_stack

LEVEL = 5


def smoothed_by_median(volume, own, brightness, stride_px):
    """Regularise: the median of the best levels of nine patches."""
    best = volume.argmin(axis=-1).astype(np.float32)
    return ndimage.median_filter(best, size=3, mode="nearest")


def sharpness(grey, grid):
    """Return the logarithm of curvature over slope, squares added up over every patch."""
    slope = ndimage.gaussian_gradient_magnitude(grey, 1.5) ** 2
    curvature = ndimage.gaussian_laplace(grey, 1.5) ** 2
    size = (grid.window_px, grid.window_px)
    starts = np.s_[:: grid.stride_px, :: grid.stride_px]
    slope, curvature = (
        np.lib.stride_tricks.sliding_window_view(of_pixels, size)[starts].sum(axis=(2, 3))
        for of_pixels in (slope, curvature)
    )
    return np.log(curvature / slope)


@dataclasses.dataclass(frozen=True)
class SharpnessModel:
    """A toy: the more blur, the less curvature for the same slope. It knows nothing of masks."""

    stack: PsfStack
    window_px: int = 48
    stride_px: int = 16
    fattening: float = 0.0
    noise: float = 0.0
    mask_digest: str = ""
    learned_from: str = "textures of our own"

    def for_view(self, camera):
        return self

    def plan(self, shape, stride_px, backend="numpy", threads=1):
        grid = PatchGrid.covering(shape, self.window_px, stride_px)
        seen = [sharpness(blurred_texture(psf, size=256, seed=9), grid) for psf in self.stack.psfs]
        return SharpnessLikelihood(grid, np.array([(one.mean(), one.std()) for one in seen]))


@dataclasses.dataclass(frozen=True)
class SharpnessLikelihood:
    """The sharpness of a level's patches is normally distributed."""

    grid: PatchGrid
    levels: np.ndarray

    def cost(self, grey, noise, usable=None, prior=None):
        mean, deviation = self.levels.T
        found = sharpness(grey, self.grid)[: self.grid.rows, : self.grid.columns, None]
        volume = 0.5 * ((found - mean) / deviation) ** 2 + np.log(deviation)
        volume -= volume.min(axis=-1, keepdims=True)
        if usable is not None:
            volume[~usable] = 0
        return Cost(volume.astype(np.float32))

    def close(self):
        pass


@pytest.fixture(scope="module")
def stack():
    return render_psf_stack(Mask.named("levin"), np.linspace(3.0, 13.0, 9))


@pytest.fixture(scope="module")
def frame(stack):
    return blurred_texture(stack.psfs[LEVEL], size=192)


def test_they_are_short():
    for parts in ([smoothed_by_median], [sharpness, SharpnessModel, SharpnessLikelihood]):
        assert sum(len(inspect.getsourcelines(part)[0]) for part in parts) < 60


def test_a_regulariser_of_ones_own_chooses_the_levels(stack, frame):
    bank = learn_bank(stack, LearnConfig(window_px=32, rank=32))
    config = DepthConfig(regularize="none")
    alone = DepthEstimator(bank, config).estimate(frame).level
    ours = DepthEstimator(bank, config, regularize=smoothed_by_median).estimate(frame).level
    assert np.abs(ours - LEVEL).mean() < np.abs(alone - LEVEL).mean()
    assert np.median(ours) == LEVEL


def test_a_likelihood_method_of_ones_own_goes_through_the_pipeline(stack):
    pipeline = FramePipeline(SharpnessModel(stack))
    for level in (1, 3, 5):
        frame = blurred_texture(stack.psfs[level], size=192, seed=level)
        result = pipeline(frame)
        assert result.level.shape == pipeline.deblur(frame, result).shape == frame.shape
        assert np.median(result.level) == pytest.approx(level, abs=1.5)
    pipeline.close()
