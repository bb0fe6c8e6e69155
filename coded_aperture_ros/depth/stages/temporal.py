"""Costs of a video's past frames, carried along the best matches of texture."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, constant, filters, namespace, zeros
from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Block, Plan, Stage, Work
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import bounded_cost

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "temporal_frames"
# Default of `temporal_frames` for nodes and bags, whose frames are those of a video: how fast past
# frames fade. The network counts what is left of them half (`_PAST_WEIGHT` of its decoder).
VIDEO_FRAMES = 4.0

# Samples per patch distance at which frames are compared, and the largest shift in samples each
# way: motion of less than a patch distance between two frames is followed.
_SAMPLES = 2
_REACH = 2
# Standard deviation of the Gaussian that patches are compared with, in patch distances.
_SIGMA = 1.0
# tau_1 of thesis eq. 8.9, as a share of the local variance of the frame.
_BANDWIDTH = 0.1
# Largest cost of all past frames, natural logarithm.
_LARGEST_PAST_COST = 20.0
# Largest difference of the past cost between neighbouring levels, natural logarithm: surfaces come
# nearer and go away from frame to frame.
_DRIFT = 4.0
# Weight of each shift of -2 to 2 samples for the previous patch, the same and the next.
_SHIFT_TO_PATCHES = np.array(
    [[1, 0.5, 0, 0, 0], [0, 0.5, 1, 0.5, 0], [0, 0, 0, 0.5, 1]], np.float32
)


@dataclasses.dataclass(frozen=True)
class Config:
    """Weight of past frames."""

    temporal_frames: float = option(
        0.0,
        "Frames of a video after which what was seen has lost most of its weight; 0: every frame "
        "for itself.",
        within=(0.0, 1000.0),
        parameter="temporal.frames",
        daily=True,
    )


def make(plan: Plan, config: Config) -> Stage:
    """Stage of a video's frames."""
    return Temporal(config.temporal_frames)


class Temporal(Stage):
    """Adds the costs of past frames, and of later ones where they are known."""

    name = "temporal"

    def __init__(self, frames: float) -> None:
        self._frames = frames
        self._filter = TemporalFilter(frames)

    def __call__(self, work: Work) -> None:
        """Set the cost by the frame, or the mean of equal frames, and those before it."""
        observation = work.observation
        work.fused_cost = self._filter.add(
            work.frame_cost.volume, work.grey, observation.grid, observation.noise.least
        )

    def both_ways(self, block: Block) -> None:
        """Add up the costs of the frames before and after each."""
        later = TemporalFilter(self._frames)
        carried_back = [_add(later, work) for work in reversed(block.works)][::-1]
        finished = block.works[: block.finished]
        for work, after in zip(finished, carried_back, strict=False):
            together = _add(self._filter, work) + after - bounded_cost(work.frame_cost.volume)
            together -= namespace(together).amin(together, -1, keepdims=True)
            work.fused_cost = together

    def reset(self) -> None:
        """Forget the past frames."""
        self._filter.reset()


def _add(costs: "TemporalFilter", work: Work) -> FloatArray:
    observation = work.observation
    return costs.add(
        work.frame_cost.volume, work.observation.grey, observation.grid, observation.noise.least
    )


class TemporalFilter:
    """Adds up the costs of a video's frames, along the best matches between them.

    The thesis couples the depths of pixels ``p`` of one frame and ``q`` of another by the weights
    (eq. 8.11)::

        W(p, t_0, q, t) = exp(-|t - t_0| / tau_2) exp(-G * |g_t0(p) - g_t(q)|^2 / tau_1)

    Here they carry the cost of every level, not a depth that was made of it: what one frame leaves
    open the next may decide, and what it gets wrong by a small difference of costs weighs little.
    The sum over all past frames is a recursion over the last one, as ``exp(-|t - t_0| / tau_2)``
    is. There is no flow: several places of the last frame may match, or none, where an object has
    moved away. There the past is forgotten, as far around as windows see it. ``tau_2`` is `frames`:
    the number of frames after which costs have lost most of their weight, > 0.
    """

    def __init__(self, frames: float) -> None:
        self._keep = float(np.exp(-1 / frames))
        self._past: FloatArray | None = None
        self._samples: FloatArray | None = None

    def reset(self) -> None:
        """Forget the past."""
        self._past = self._samples = None

    def add(
        self, volume: FloatArray, grey: FloatArray, grid: PatchGrid, noise: float
    ) -> FloatArray:
        """Cost of every level by a frame and those before it [rows, columns, L]; the least is 0.

        Parameters
        ----------
        volume : ndarray, float32 [rows, columns, L]
            Cost by the frame alone.
        grey : ndarray, float32 [height, width]
            The frame, linear light.
        grid : PatchGrid
        noise : float
            Standard deviation of the noise of `grey`.
        """
        samples = _sampled(grey, grid)
        xp, cv = namespace(volume), filters(volume)
        total = xp.moveaxis(bounded_cost(volume), -1, 0)
        if self._past is not None and self._samples is not None:
            variance = 2 * (noise * _SAMPLES / grid.stride_px) ** 2
            weights, match = _matches(samples, self._samples, variance)
            # A patch's cost depends on its whole window: the past counts only if all of it still
            # matches. Otherwise moving objects would leave their costs behind.
            match = cv.erode(match, _window(grid))
            past = _gathered(self._past, weights)
            xp.minimum(past[1:], past[:-1] + _DRIFT, out=past[1:])
            xp.minimum(past[:-1], past[1:] + _DRIFT, out=past[:-1])
            past *= self._keep * match
            total += past
        total -= xp.amin(total, 0)
        self._past = xp.clip(total, None, _LARGEST_PAST_COST)
        self._samples = samples
        fused: FloatArray = xp.moveaxis(total, 0, -1)
        return fused


def _window(grid: PatchGrid) -> NDArray[np.uint8]:
    """Neighbourhood of patches that a cost depends on: its window, and one patch of motion."""
    side = 2 * round(grid.window_px / (2 * grid.stride_px)) + 3
    return np.ones((side, side), np.uint8)


def _sampled(grey: FloatArray, grid: PatchGrid) -> FloatArray:
    """Frame at `_SAMPLES` pixels per patch distance, float32 [samples down, samples right]."""
    first = (grid.window_px - grid.stride_px) // 2
    top, left = max(grid.top + first, 0), max(grid.left + first, 0)
    bottom, right = top + grid.rows * grid.stride_px, left + grid.columns * grid.stride_px
    size = (_SAMPLES * grid.columns, _SAMPLES * grid.rows)
    cv = filters(grey)
    samples: FloatArray = cv.resize(grey[top:bottom, left:right], size, interpolation=cv.INTER_AREA)
    return samples


def _matches(
    present: FloatArray, last: FloatArray, variance: float
) -> tuple[FloatArray, FloatArray]:
    """Weights of the last frame's neighbouring patches for each patch, and its best match.

    Returns
    -------
    weights : ndarray, float32 [3, 3, rows, columns]
        From one patch up to one down, and left to right; the sum is 1.
    match : ndarray, float32 [rows, columns]
        Similarity of the best place, 0 to 1.
    """
    xp, cv = namespace(present), filters(present)
    spread = _smoothed(present * present) - _smoothed(present) ** 2
    bandwidth = variance + _BANDWIDTH * xp.clip(spread, 0, None)
    around = cv.copyMakeBorder(last, *[_REACH] * 4, cv.BORDER_REPLICATE)
    distance = _distances(around, present)
    distance -= variance
    xp.clip(distance, 0, None, out=distance)
    distance /= -bandwidth
    alike = xp.exp(distance, out=distance)
    match = xp.amax(alike, 0)
    to_patches = constant(np.kron(_SHIFT_TO_PATCHES, _SHIFT_TO_PATCHES), alike)  # [9, shifts]
    weights = (to_patches @ alike.reshape(len(alike), -1)).reshape(-1, *match.shape)
    weights /= xp.clip(weights.sum(axis=0), 1e-12, None)
    return weights.reshape(3, 3, *match.shape), match


def _distances(around: FloatArray, present: FloatArray) -> FloatArray:
    """Mean squared difference of every shift, smoothed, of every patch [shifts, rows, columns].

    `around` is the last frame with a border of `_REACH`.
    """
    xp, (height, width) = namespace(present), present.shape
    shifts = [divmod(shift, 2 * _REACH + 1) for shift in range((2 * _REACH + 1) ** 2)]
    shifted = [around[i : i + height, j : j + width] for i, j in shifts]
    if xp is not np:  # few large operations
        differences = xp.stack(shifted, -1) - present[..., None]
        of_shifts: FloatArray = xp.moveaxis(_smoothed(differences**2), -1, 0)
        return of_shifts
    difference = np.empty_like(present)
    distance = []
    for each in shifted:
        np.subtract(each, present, out=difference)
        np.multiply(difference, difference, out=difference)
        distance.append(_smoothed(difference))
    return np.stack(distance)


def _smoothed(samples: FloatArray) -> FloatArray:
    """Gaussian mean around every patch [rows, columns]."""
    size = samples.shape[1] // _SAMPLES, samples.shape[0] // _SAMPLES
    cv = filters(samples)
    of_patches = cv.resize(samples, size, interpolation=cv.INTER_AREA)
    smoothed: FloatArray = cv.GaussianBlur(of_patches, (0, 0), _SIGMA)
    return smoothed


def _gathered(past: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted mean of the neighbours' costs [L, rows, columns]."""
    xp, (levels, rows, columns) = namespace(past), past.shape
    around = zeros((levels, rows + 2, columns + 2), past)
    around[:, 1:-1, 1:-1] = past
    around[:, 0], around[:, -1] = around[:, 1], around[:, -2]
    around[:, :, 0], around[:, :, -1] = around[:, :, 1], around[:, :, -2]
    gathered, part = xp.zeros_like(past), xp.empty_like(past)
    for i in range(3):
        for j in range(3):
            xp.multiply(around[:, i : i + rows, j : j + columns], weights[i, j], out=part)
            gathered += part
    return gathered
