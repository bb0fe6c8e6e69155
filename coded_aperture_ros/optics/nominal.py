"""Nominal blur sizes of measured PSFs that come without any."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.optics.psf import PsfStack

# Range and largest step of nominal sizes, px: what refinement network and check of fit know.
_SMALLEST_PX = 1.0
_LARGEST_PX = 22.0
_LARGEST_STEP_PX = 0.8
_FEWEST_LEVELS = 5
# Least range, px, and least share of the variance of the measured widths that a straight line
# explains, for sizes that are those of the PSFs and not only their order.
_LEAST_SPAN_PX = 3.0
_LEAST_EXPLAINED = 0.9


def widths_px(psfs: FloatArray) -> DoubleArray:
    """Width of the square with the spread of each PSF about its centre of light [L], px.

    Parameters
    ----------
    psfs : ndarray, float32 [L, k, k]
        May be slightly negative.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> widths_px(render_psf_stack(Mask("open", [[1.0]]), [5.0, 9.0]).psfs).round(1).tolist()
    [5.2, 9.1]
    """
    light = np.maximum(psfs.astype(np.float64), 0)
    light /= light.sum(axis=(1, 2), keepdims=True)
    along = np.arange(psfs.shape[-1]) - psfs.shape[-1] // 2
    spread = np.zeros(len(psfs))
    for profile in (light.sum(axis=1), light.sum(axis=2)):
        spread += profile @ along**2 - (profile @ along) ** 2
    return np.asarray(np.sqrt(6 * spread))


def grows_evenly(stack: PsfStack) -> bool:
    """Whether the PSFs grow or shrink as those of a mask do, so that widths are blur sizes.

    Nearly equally from level to level or, where depths are known, with the inverse depth. Those of
    a phase mask do not.
    """
    width, line = _line(stack)
    explained = 1 - float(np.var(width - line)) / max(float(np.var(width)), 1e-9)
    return bool(
        explained >= _LEAST_EXPLAINED and line.min() > 0 and np.ptp(_fitted(line)) >= _LEAST_SPAN_PX
    )


def with_nominal_sizes(stack: PsfStack) -> PsfStack:
    """Stack with blur sizes in px, marked as nominal; itself if it has sizes, or too few levels.

    Where PSFs grow evenly, sizes are those of a straight line through their widths, over the level
    or the inverse depth, reduced as far as the refinement needs; negative where PSFs shrink with
    the depth. Else, as for most phase masks, sizes stand for the order of the levels only: equal
    steps, in the direction of the widths and about their mean as far as the range allows. Fewer
    than five levels do not reach over the range that the refinement needs.

    Parameters
    ----------
    stack : PsfStack

    Examples
    --------
    >>> import dataclasses
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> known = render_psf_stack(Mask.named("disc"), [4.0, 4.6, 5.2, 5.8, 6.4, 7.0, 7.6, 8.2])
    >>> unknown = dataclasses.replace(known, blur_sizes_px=range(8), in_pixels=False)
    >>> with_nominal_sizes(unknown).blur_sizes_px.round(1).tolist()
    [3.7, 4.2, 4.7, 5.2, 5.7, 6.2, 6.7, 7.2]
    """
    if stack.in_pixels or len(stack) < _FEWEST_LEVELS:
        return stack
    width, line = _line(stack)
    if grows_evenly(stack):
        sizes = _fitted(line)
        if stack.depths_m is not None and np.diff(stack.depths_m)[0] * np.diff(line)[0] < 0:
            sizes = -sizes
    else:
        sizes = _equal_steps(len(stack), float(width.mean()), shrinks=line[-1] < line[0])
    return dataclasses.replace(stack, blur_sizes_px=sizes, in_pixels=True, nominal=True)


def _line(stack: PsfStack) -> tuple[DoubleArray, DoubleArray]:
    """Widths of the PSFs [L], px, and the straight line through them."""
    width = widths_px(stack.psfs)
    along = np.arange(len(stack)) if stack.depths_m is None else 1 / stack.depths_m
    return width, np.asarray(np.polyval(np.polyfit(along, width, 1), along), np.float64)


def _fitted(line: DoubleArray) -> DoubleArray:
    """Sizes [L], px, reduced in proportion until range and steps are what the network knows."""
    step_px = float(np.abs(np.diff(line)).max())
    scales = _LARGEST_STEP_PX / max(step_px, 1e-9), _LARGEST_PX / float(line.max())
    return line * min(1.0, *scales)


def _equal_steps(count: int, mean_px: float, shrinks: bool) -> DoubleArray:
    """Equally spaced sizes about a mean as far as the range allows [count], px."""
    span = min(_LARGEST_STEP_PX * (count - 1), _LARGEST_PX - _SMALLEST_PX)
    middle = np.clip(mean_px, _SMALLEST_PX + span / 2, _LARGEST_PX - span / 2)
    ends = middle - span / 2, middle + span / 2
    return np.linspace(*(ends[::-1] if shrinks else ends), count)
