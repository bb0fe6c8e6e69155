"""Two textured planes, one before the other: what blur identification does at an occluding edge."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.thesis.stair import (
    LARGEST_BLUR_PX,
    LEVELS,
    SMALLEST_BLUR_PX,
    area_psf_width,
    blur_stack,
    check_frame_options,
    crops_generator,
    level_error,
    with_noise,
)
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.optics import Mask, PsfStack

SHAPE = (320, 480)
NEAR_EDGE_PX = 16.0


@dataclasses.dataclass(frozen=True, eq=False)
class TwoPlanes:
    """A coded frame of two planes and its truth.

    Attributes
    ----------
    coded : ndarray, float32 [rows, columns]
        With noise.
    level : ndarray, float32 [rows, columns]
        True level as a pinhole in the middle of the aperture sees it; fractional index into the
        stack.
    edge_distance_px : ndarray, float32 [rows, columns]
        Distance of every pixel's centre from the occluding edge.
    stack : PsfStack
        The PSFs of all levels.
    noise : float
        Standard deviation of the noise that was added.
    """

    coded: NDArray[np.float32]
    level: NDArray[np.float32]
    edge_distance_px: NDArray[np.float32]
    stack: PsfStack
    noise: float


def composite(
    mask: Mask,
    front: NDArray[np.floating],
    opacity: NDArray[np.floating],
    back: NDArray[np.floating],
    front_blur_px: float,
    back_blur_px: float,
) -> NDArray[np.float32]:
    """Render two planes through an aperture, with exact occlusion.

    A point ``u`` of the aperture, in units of the mask's extent from its centre, sees a plane of
    blur size ``s`` displaced by ``s u``. Each point sees the front where that is opaque and else
    the back, and the frame is the mean over the aperture, weighted with the transmission ``T``::

        g(x) = integral T(u) [ a(x - s1 u) f(x - s1 u) + (1 - a(x - s1 u)) b(x - s2 u) ] du

    Pictures are constant within a pixel, as in `thesis.stair.area_psf_stack`. So the
    integrand changes only where ``s1 u`` or ``s2 u`` passes the border between two pixels; between
    those places the integral is the exact overlap with the mask's cells. Without an edge this is
    the convolution with that PSF.

    Parameters
    ----------
    front, opacity, back : ndarray of float, shape [rows, columns]
        Sharp pictures of the planes, and where the front is: 1 opaque, 0 nothing there.
    front_blur_px, back_blur_px : float
        Blur sizes; signed.

    Returns
    -------
    ndarray, float32 [rows - 2 r, columns - 2 r]
        Without the border of `reach_px` in which something outside of the pictures would count.
    """
    _check_shapes(front, opacity, back)
    reach = reach_px(front_blur_px, back_blur_px)
    rows, columns = (length - 2 * reach for length in front.shape)
    if min(rows, columns) < 1:
        raise InputError(f"pictures of {list(front.shape)} px are not larger than the blur")
    cells = mask.transmission.astype(np.float64)
    extent = max(cells.shape)
    vertical, over_rows = _displacements(front_blur_px, back_blur_px, cells.shape[0], extent)
    horizontal, over_columns = _displacements(front_blur_px, back_blur_px, cells.shape[1], extent)
    weights = over_rows @ cells @ over_columns.T
    weights /= weights.sum()

    lit = (front * opacity).astype(np.float32)
    clear = (1 - opacity).astype(np.float32)
    behind = back.astype(np.float32)
    coded = np.zeros((rows, columns), np.float64)

    def part(down: int, right: int) -> tuple[slice, slice]:
        return slice(reach - down, reach - down + rows), slice(
            reach - right, reach - right + columns
        )

    for i, j in np.argwhere(weights):
        (down1, down2), (right1, right2) = vertical[i], horizontal[j]
        here, there = part(down1, right1), part(down2, right2)
        coded += weights[i, j] * (lit[here] + clear[here] * behind[there])
    return coded.astype(np.float32)


def _check_shapes(
    front: NDArray[np.floating], opacity: NDArray[np.floating], back: NDArray[np.floating]
) -> None:
    if not front.shape == opacity.shape == back.shape:
        raise InputError(
            "front, opacity and back: expected one shape, got "
            f"{list(front.shape)}, {list(opacity.shape)} and {list(back.shape)}"
        )


def reach_px(*blur_sizes_px: float) -> int:
    """Return how far, in pixels, the largest of the blurs reaches to each side."""
    return max(area_psf_width(size) for size in blur_sizes_px) // 2


def _displacements(
    front_blur_px: float, back_blur_px: float, cells: int, extent: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Cut one axis of the aperture into pieces of one displacement in whole pixels for each plane.

    Returns
    -------
    (ndarray of int [pieces, 2], ndarray of float64 [pieces, cells])
        Displacement of front and back in each piece, and its overlap with each of the mask's
        cells.
    """
    half = cells / extent / 2
    cell_edges = (np.arange(cells + 1) - cells / 2) / extent
    cuts = [-half, half]
    for size in (front_blur_px, back_blur_px):
        if abs(size) > 1:  # a smaller plane stays within its pixel
            last = int(np.ceil(abs(size)))
            borders = (np.arange(-last, last + 1) + 0.5) / size
            cuts.extend(borders[np.abs(borders) < half])
    edges = np.unique(cuts)
    middles = (edges[:-1] + edges[1:]) / 2
    sizes = np.array([front_blur_px, back_blur_px])
    displacements = np.rint(middles[:, None] * sizes).astype(np.intp)
    covered = np.clip(edges[:, None], cell_edges[None, :-1], cell_edges[None, 1:])
    return displacements, np.diff(covered, axis=0)


def make_two_planes(
    mask: Mask,
    textures: Textures,
    front_blur_px: float,
    back_blur_px: float,
    sigma: float = 0.001,
    seed: int = 0,
    levels: int = LEVELS,
    shape: tuple[int, int] = SHAPE,
) -> TwoPlanes:
    """Render two planes with a straight vertical edge in the middle; the front is on the left.

    Parameters
    ----------
    textures : Textures
        Both planes show crops of it.
    front_blur_px, back_blur_px : float
        Within the stack's 7 to 30 px. They need not be the size of a level.
    sigma : float, optional
        Noise (standard deviation) behind an open aperture; divided by the mask's open fraction.
    seed : int, optional
        The same seed gives the same crops, and the same noise up to its strength, for every mask
        and pair of blur sizes.
    levels : int, optional
        Of the stack.
    shape : (int, int), optional
        Rows and columns of the frame.
    """
    for size in (front_blur_px, back_blur_px):
        if not SMALLEST_BLUR_PX <= size <= LARGEST_BLUR_PX:
            raise InputError(
                f"blur size: expected {SMALLEST_BLUR_PX:g} to {LARGEST_BLUR_PX:g} px, got {size:g}"
            )
    check_frame_options(sigma, min(shape), "frame")
    rows, columns = shape
    # Of the largest blur that there is, so that the crops are the same for all blur sizes.
    margin = reach_px(LARGEST_BLUR_PX)
    front, back = textures.crops(2, rows + 2 * margin, columns + 2 * margin, crops_generator(seed))
    excess = margin - reach_px(front_blur_px, back_blur_px)
    inner = slice(excess, front.shape[0] - excess), slice(excess, front.shape[1] - excess)
    middle = margin + columns // 2
    opacity = np.zeros_like(front)
    opacity[:, :middle] = 1
    coded = composite(mask, front[inner], opacity[inner], back[inner], front_blur_px, back_blur_px)
    noisy, noise = with_noise(coded, mask, sigma, seed)
    stack = blur_stack(mask, levels)
    level = np.interp([front_blur_px, back_blur_px], stack.blur_sizes_px, np.arange(levels))
    from_edge = (np.arange(columns) + 0.5 - columns // 2).astype(np.float32)
    across = np.where(from_edge < 0, level[0], level[1]).astype(np.float32)
    return TwoPlanes(
        coded=noisy,
        level=np.broadcast_to(across, shape),
        edge_distance_px=np.broadcast_to(np.abs(from_edge), shape),
        stack=stack,
        noise=noise,
    )


@dataclasses.dataclass(frozen=True)
class TwoPlaneError:
    """Mean |estimated - true| level: everywhere, near the edge (16 px), and beyond."""

    everywhere: float
    near_edge: float
    beyond: float


def two_plane_error(level: NDArray[np.floating], truth: TwoPlanes) -> TwoPlaneError:
    """Score estimated levels, NaN where unknown; see `level_error` for what that counts.

    Parameters
    ----------
    level : ndarray of float, shape [rows, columns]
    """
    levels = len(truth.stack)
    everywhere = level_error(level, truth.level, levels).mean
    near = truth.edge_distance_px <= NEAR_EDGE_PX
    return TwoPlaneError(
        everywhere,
        *(level_error(level[part], truth.level[part], levels).mean for part in (near, ~near)),
    )
