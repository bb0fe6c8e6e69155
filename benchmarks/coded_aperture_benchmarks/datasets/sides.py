"""How well the side of the focal plane is found, and what its mistakes cost in depth.

Beside the estimator for both sides an oracle is asked, which knows the side of every pixel: an
estimator for each side, of which the right one counts.
"""

import dataclasses
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from coded_aperture_benchmarks.thesis.stair import check_frame_options, crops_generator, with_noise
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator
from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask, render_psf
from coded_aperture_ros.simulation import render_coded_frame

# The side of less blur is not scored: it matters little, and of no blur there is none.
SMALLEST_BLUR_PX = 2.0
REACH_PX = 20.0
PLANE_SIZE = (240, 320)
_FOCUS_M = 2.0
_FOCAL_LENGTH_PX = 1000.0
_RIGHT_WITHIN = 0.10


@dataclasses.dataclass(frozen=True, eq=False)
class SideFrame:
    """A coded frame that is focused within its scene.

    Attributes
    ----------
    coded : ndarray, float32 [rows, columns] or [rows, columns, 3]
        With noise.
    blur_size_px : ndarray, float32 [rows, columns]
        True, signed.
    depth_m : ndarray, float32 [rows, columns]
        True.
    """

    coded: NDArray[np.float32]
    blur_size_px: NDArray[np.float32]
    depth_m: NDArray[np.float32]


def focused_between(
    mask: Mask,
    near_m: float,
    far_m: float,
    size: tuple[int, int],
    reach_px: float = REACH_PX,
    focal_length_px: float = _FOCAL_LENGTH_PX,
) -> Camera:
    """Return a camera whose blur is as large at the near end of a depth range as at the far one.

    Parameters
    ----------
    near_m, far_m : float
        Ends of the range.
    size : (int, int)
        Rows and columns of the image.
    reach_px : float, optional
        Blur size at both ends.
    """
    focus_m = 2 / (1 / near_m + 1 / far_m)
    extent_mm = 1e3 * reach_px / (focal_length_px * (1 / focus_m - 1 / far_m))
    rows, columns = size
    return Camera(focal_length_px, focus_m, columns, rows, mask, extent_mm, side="both")


def plane_camera(mask: Mask) -> tuple[Camera, float, float]:
    """Return the camera that planes are seen with, and the ends of its range, m."""
    near_m, far_m = 2 / 3 * _FOCUS_M, 2 * _FOCUS_M
    return focused_between(mask, near_m, far_m, PLANE_SIZE), near_m, far_m


def make_planes_on_both_sides(
    camera: Camera, textures: Textures, sizes_px: NDArray[np.float64], sigma: float, seed: int = 0
) -> Iterator[SideFrame]:
    """Make a frame with a plane of its own texture for every signed blur size.

    Parameters
    ----------
    sizes_px : ndarray of float
    sigma : float
        Noise behind an open aperture; divided by the mask's open fraction.
    seed : int, optional
        The same seed gives the same crops for every mask.
    """
    check_frame_options(sigma, 1, "plane")
    rows, columns = camera.image_height, camera.image_width
    width = max(len(render_psf(camera.mask, size)) for size in sizes_px) - 1
    shape = rows + width, columns + width
    crops = textures.crops(len(sizes_px), *shape, crops_generator(seed))
    for number, (size, crop) in enumerate(zip(sizes_px, crops, strict=True)):
        psf = render_psf(camera.mask, size, width + 1)
        coded = fftconvolve(crop, psf, mode="valid")
        noisy, _ = with_noise(coded, camera.mask, sigma, seed + 1000 * (number + 1))
        depth = float(camera.depth_m(size))
        yield SideFrame(
            noisy,
            np.full((rows, columns), size, np.float32),
            np.full((rows, columns), depth, np.float32),
        )


def make_scene_on_both_sides(
    sharp: NDArray[np.float32],
    depth_m: NDArray[np.float32],
    camera: Camera,
    sigma: float,
    seed: int = 0,
) -> SideFrame:
    """Render a scene with a camera that is focused within it; see `render_coded_frame`."""
    check_frame_options(sigma, 1, "scene")
    coded, _ = with_noise(render_coded_frame(sharp, depth_m, camera), camera.mask, sigma, seed)
    return SideFrame(coded, camera.blur_size_px(depth_m).astype(np.float32), depth_m)


class SideEstimators:
    """An estimator for both sides of the focal plane, and an oracle of the side.

    Parameters
    ----------
    camera : Camera
        With `side: both`.
    near_m, far_m : float
        Depth range, with the focus within it.
    levels : int
        Of both sides; each side by itself has half of them.
    progress : callable, optional
        Wraps the iteration over levels, as ``tqdm.tqdm`` does.
    """

    def __init__(
        self,
        camera: Camera,
        near_m: float,
        far_m: float,
        levels: int,
        config: DepthConfig,
        progress: Progress = iter,
    ) -> None:
        self.threshold = config.confidence_threshold
        everywhere = dataclasses.replace(config, confidence_threshold=0.0)

        def estimator(side: str, nearest_m: float, farthest_m: float, count: int) -> DepthEstimator:
            of_side = dataclasses.replace(camera, side=side)
            bank = learn_bank_for_camera(of_side, nearest_m, farthest_m, count, progress=progress)
            return DepthEstimator(bank, everywhere, of_side)

        focus_m, half = camera.focus_distance_m, (levels + 1) // 2
        self.both = estimator("both", near_m, far_m, levels)
        self.far = estimator("far", focus_m, far_m, half)
        self.near = estimator("near", near_m, focus_m, half)
        steps = np.diff(self.both.model.stack.blur_sizes_px)
        self.step_px = float(np.abs(steps).mean())

    def estimate(self, frame: SideFrame) -> "SideEstimates":
        """Estimate a frame without and with the knowledge of the side."""
        both = self.both.estimate(frame.coded)
        beyond = frame.blur_size_px > 0
        by_side = [
            estimator.estimate(frame.coded) if part.any() else both
            for estimator, part in ((self.far, beyond), (self.near, ~beyond))
        ]
        return SideEstimates(
            frame,
            both,
            np.where(beyond, by_side[0].blur_size_px, by_side[1].blur_size_px),
            np.where(beyond, _depth(by_side[0]), _depth(by_side[1])),
        )


def _depth(estimate: DepthEstimate) -> NDArray[np.float32]:
    return estimate.blur_size_px if estimate.depth_m is None else estimate.depth_m


@dataclasses.dataclass(frozen=True, eq=False)
class SideEstimates:
    """Estimates of one frame at every pixel: of both sides, and by the oracle of the side."""

    frame: SideFrame
    both: DepthEstimate
    oracle_size_px: NDArray[np.float32]
    oracle_depth_m: NDArray[np.float32]


@dataclasses.dataclass(frozen=True)
class SideScore:
    """What was found of frames whose scenes lie on both sides.

    Attributes
    ----------
    right : float
        Share of the pixels on the right side; where the true blur is at least
        `SMALLEST_BLUR_PX`, as the next three.
    confident : float
        Share of the pixels whose depth is confident.
    confident_right, confident_said : float
        Share of these on the right side, and their mean confidence of the side.
    level_error, oracle_level_error : float
        Mean error of the signed level, and that of the oracle; all pixels.
    confident_level_error, oracle_confident_level_error : float
        The same of the confident pixels of both sides' estimator.
    depth_error, oracle_depth_error : float
        Median relative depth error of the confident pixels.
    within, oracle_within : float
        Share of the confident pixels with a depth right to 10 %.
    """

    right: float
    confident: float
    confident_right: float
    confident_said: float
    level_error: float
    oracle_level_error: float
    confident_level_error: float
    oracle_confident_level_error: float
    depth_error: float
    oracle_depth_error: float
    within: float
    oracle_within: float

    @staticmethod
    def of(estimates: list[SideEstimates], step_px: float, threshold: float) -> "SideScore":
        """Score the estimates of frames.

        Parameters
        ----------
        step_px : float
            Blur size from level to level.
        threshold : float
            Confidence from which a depth counts as known.
        """
        truth = _pixels(e.frame.blur_size_px for e in estimates)
        depth = _pixels(e.frame.depth_m for e in estimates)
        size = _pixels(e.both.blur_size_px for e in estimates)
        confidence = _pixels(e.both.confidence for e in estimates)
        # Where nothing is known, nothing is on the right side, and the focus is scored.
        right = np.sign(size) == np.sign(truth)
        size = np.where(np.isfinite(size), size, 0)
        oracle = np.nan_to_num(_pixels(e.oracle_size_px for e in estimates), nan=0.0)
        known = (confidence >= threshold) & (confidence > 0)
        sided = np.abs(truth) >= SMALLEST_BLUR_PX
        said = _pixels(np.asarray(e.both.values("side")) for e in estimates)
        errors = [np.abs(each - truth) / step_px for each in (size, oracle)]
        relative = [
            np.abs(each - depth)[known] / depth[known]
            for each in (
                _pixels(_depth(e.both) for e in estimates),
                _pixels(e.oracle_depth_m for e in estimates),
            )
        ]
        return SideScore(
            right=_mean(right[sided]),
            confident=_mean(known[sided]),
            confident_right=_mean(right[sided & known]),
            confident_said=_mean(said[sided & known]),
            level_error=_mean(errors[0]),
            oracle_level_error=_mean(errors[1]),
            confident_level_error=_mean(errors[0][known]),
            oracle_confident_level_error=_mean(errors[1][known]),
            depth_error=_median(relative[0]),
            oracle_depth_error=_median(relative[1]),
            within=_mean(relative[0] <= _RIGHT_WITHIN),
            oracle_within=_mean(relative[1] <= _RIGHT_WITHIN),
        )


def _pixels(maps: Iterable[NDArray[Any]]) -> NDArray[Any]:
    return np.concatenate([np.ravel(each) for each in maps])


def _mean(values: NDArray[Any]) -> float:
    return float(values.mean()) if values.size else float("nan")


def _median(values: NDArray[Any]) -> float:
    return float(np.nanmedian(values)) if values.size else float("nan")
