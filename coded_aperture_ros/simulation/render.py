"""Coded frame from a sharp image and its depth map: space-varying blur with occlusion.

The scene is cut into layers of equal blur size. Each pixel is shared between the two layers that
enclose its blur size, so that slanted surfaces blur smoothly. The layers are composed from front
to back; a layer is seen through the gaps of the layers in front of it. Light through different
parts of the aperture passes an occluding edge in different places, so the aperture is cut into
blocks, each composed on its own: within a small block the share of a layer that is covered says
nearly all about which part is covered.
"""

import dataclasses
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera, Mask, psf_width, render_psf
from coded_aperture_ros.optics.diffraction import diffracted_psf, diffraction_tail_px
from coded_aperture_ros.optics.wavefront import field_tangents
from coded_aperture_ros.simulation.hidden import Surface, fill_unknown, hidden_surface

# Layers closer than this in blur size belong to one surface and do not occlude one another. It
# must exceed what a slanted surface changes within the reach of a PSF.
_SURFACE_GAP_PX = 1.4
_MIN_COVERAGE = 1e-3
# Parts of the image with a PSF each, for a wavefront.
_ROWS = 6
_COLUMNS = 8
# Rendered around each part, beyond its PSF, for occlusions.
_SURFACE_MARGIN_PX = 24


def render_coded_frame(
    image: NDArray,
    depth_m: NDArray,
    camera: Camera,
    *,
    layer_spacing_px: float = 0.5,
    aperture_blocks: int = 3,
    supersampling: int = 1,
) -> FloatArray:
    """Frame of a coded-aperture camera, without noise, float32.

    Parameters
    ----------
    image : ndarray, shape [h, w] or [h, w, 3]
        The sharp scene, linear light.
    depth_m : ndarray, shape [h, w]
        m; in front of or beyond the focal plane. Unknown (NaN) depth is taken from the farther
        known neighbour, left or right.
    camera : Camera
        Its focal length in pixels must be that of the frame; its image size is not used.
    layer_spacing_px : float, optional
        Distance between layers in blur size, px.
    aperture_blocks : int, optional
        Blocks of the aperture in each direction. More blocks are more exact around occluding edges,
        and slower.
    supersampling : int, optional
        Samples of `image` and `depth_m` along each side of a pixel of the frame, at which light is
        blurred before each pixel takes the mean of its own. With 1, what is between the pixels is
        as PSFs interpolate it, which banks do, too: blur of less than 4 px is told more easily then
        than a sensor tells it.

    Returns
    -------
    ndarray of float32, [h / supersampling, w / supersampling] or the same with 3 channels
        Linear light. Without supersampling, a scene in one plane is exactly the image convolved
        with `render_psf`, with the image's edges replicated; with diffraction, but for the tails
        that the blocks' PSFs lack. With a wavefront, each part of the image has the PSF of its
        middle, and light does not fall off.

    Raises
    ------
    InputError
        If the shapes differ or are no multiples of `supersampling`, a depth is not positive, or no
        depth is known.

    References
    ----------
    Martinello 2012, chapter 3.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(1000.0, 2.0, 64, 48, Mask.named("levin"), mask_extent_mm=10.0)
    >>> sharp = np.full((48, 64), 0.5, np.float32)
    >>> coded = render_coded_frame(sharp, np.full((48, 64), 3.0), camera)
    >>> coded.shape, round(float(coded.mean()), 3)
    ((48, 64), 0.5)
    """
    _check(image, depth_m, layer_spacing_px, aperture_blocks, supersampling)
    fine = camera.scaled(supersampling)
    blur_size_px = _blur_sizes(fill_unknown(depth_m), fine)
    colours = np.asarray(image, dtype=np.float32).reshape(*depth_m.shape, -1)
    distances = supersampling * layer_spacing_px, supersampling * _SURFACE_GAP_PX
    render = partial(_compose if camera.wavefront is None else _compose_parts, camera=fine)
    light = render(colours, blur_size_px, distances_px=distances, blocks=aperture_blocks)
    rows, columns = (length // supersampling for length in depth_m.shape)
    samples = light.reshape(rows, supersampling, columns, supersampling, -1)
    return samples.mean(axis=(1, 3)).reshape(rows, columns, *image.shape[2:])


def _compose_parts(
    colours: FloatArray,
    blur_size_px: FloatArray,
    camera: Camera,
    distances_px: tuple[float, float],
    blocks: int,
) -> FloatArray:
    """Frame of a camera whose PSF changes over the image, in parts with a PSF each."""
    frame, (rows, columns) = np.empty_like(colours), blur_size_px.shape
    margin = psf_width(np.abs(blur_size_px).max()) + _SURFACE_MARGIN_PX
    tangents = field_tangents(camera.intrinsics.resized(columns, rows), _ROWS, _COLUMNS)
    for tangent, (row, column) in zip(tangents, np.ndindex(_ROWS, _COLUMNS), strict=True):
        top = row * rows // _ROWS
        bottom = (row + 1) * rows // _ROWS
        left = column * columns // _COLUMNS
        right = (column + 1) * columns // _COLUMNS
        above = max(0, top - margin)
        before = max(0, left - margin)
        around = np.s_[above : bottom + margin, before : right + margin]
        part = _compose(
            colours[around], blur_size_px[around], camera, distances_px, blocks, tangent
        )
        inside = part[top - above : bottom - above, left - before : right - before]
        frame[top:bottom, left:right] = inside
    return frame


def _compose(
    colours: FloatArray,
    blur_size_px: FloatArray,
    camera: Camera,
    distances_px: tuple[float, float],
    blocks: int,
    tangent: DoubleArray | None = None,
) -> FloatArray:
    """Frame, or a part of one whose PSFs are those at a tangent of the wavefront.

    `distances_px` are those in blur size between layers, and between surfaces.
    """
    spacing_px, gap_px = distances_px
    visible = Surface(blur_size_px, colours)
    # How far behind an occluder's edge the light that just passes it can come from.
    reach_px = int(np.ceil(np.ptp(blur_size_px) / 2)) + 1
    hidden = hidden_surface(visible, gap_px, reach_px)
    layers = list(_layers(visible, hidden, spacing_px, gap_px))
    total = np.zeros((*colours.shape[:2], colours.shape[2] + 1), dtype=np.float32)
    for block in _blocks(camera.mask, blocks):
        passed = 1.0
        if tangent is not None and camera.wavefront is not None:
            passed = camera.wavefront.transmitted_share(block, tangent)
        if passed > _MIN_COVERAGE:
            psf = partial(_kernel, block, camera, tangent=tangent)
            share = passed * block.open_fraction / camera.mask.open_fraction
            total += _through_block(layers, psf, share, colours.shape[:2])
    # Where no light comes through a block, the others make up for it; where none comes at all,
    # the sharp scene is the best guess.
    found = total[..., -1:]
    return np.divide(total[..., :-1], found, out=colours.copy(), where=found > _MIN_COVERAGE)


@dataclasses.dataclass(frozen=True)
class _Layer:
    """Premultiplied colours and coverage of a layer, [rows, columns, channels + 1], cut out.

    Layers whose numbers differ by less than `surface_gap` belong to one surface.
    """

    number: int
    surface_gap: int
    blur_size_px: float
    light: FloatArray
    top: int
    left: int


def _check(
    image: NDArray, depth_m: NDArray, spacing_px: float, blocks: int, supersampling: int
) -> None:
    if image.ndim not in (2, 3) or image.shape[:2] != depth_m.shape or not image.size:
        raise InputError(
            "image and depth must be of one size: "
            f"got the shapes {list(image.shape)} and {list(depth_m.shape)}"
        )
    if not np.isfinite(image).all():
        raise InputError("image: all pixels must be finite")
    if not np.isfinite(spacing_px) or spacing_px <= 0:
        raise InputError(f"layer spacing: expected more than 0 px, got {spacing_px!r}")
    if blocks < 1:
        raise InputError(f"aperture blocks: expected at least 1, got {blocks!r}")
    if supersampling < 1 or any(length % supersampling for length in depth_m.shape):
        raise InputError(
            f"supersampling: expected a divisor of the image's height and width, "
            f"{list(depth_m.shape)}, got {supersampling!r}"
        )


def _blur_sizes(depth_m: NDArray, camera: Camera) -> FloatArray:
    blur_size_px = camera.blur_map_px(depth_m)
    # A NaN, of a point behind the mask, fails this comparison too.
    fits = np.abs(blur_size_px) <= max(depth_m.shape)
    if not fits.all():
        raise InputError(
            f"depth {depth_m[~fits].min():g} m is too near the lens: its blur is wider than the "
            "image; check the unit of the depth map and the camera's focus"
        )
    return blur_size_px.astype(np.float32)


def _layers(
    visible: Surface, hidden: Surface, spacing_px: float, gap_px: float
) -> Iterator[_Layer]:
    """Layers of both surfaces, front (smallest signed blur size) first."""
    # The hidden surface repeats blur sizes of the visible one, so these two bounds hold for both.
    first = float(visible.blur_size_px.min())
    last = float(visible.blur_size_px.max())
    count = int(np.ceil((last - first) / spacing_px)) + 1
    step = (last - first) / max(count - 1, 1)
    surface_gap = max(1, round(gap_px / step)) if step else 1
    for number, size in enumerate(np.linspace(first, last, count)):
        share = [_share(surface.blur_size_px, size, step) for surface in (visible, hidden)]
        covered = (share[0] > 0) | (share[1] > 0)
        rows = np.flatnonzero(covered.any(axis=1))
        columns = np.flatnonzero(covered.any(axis=0))
        if not rows.size:
            continue
        box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        colours = share[0][box][..., None] * visible.colours[box]
        colours += share[1][box][..., None] * hidden.colours[box]
        coverage = (share[0] + share[1])[box][..., None]
        light = np.concatenate([colours, coverage], axis=2)
        yield _Layer(number, surface_gap, float(size), light, int(rows[0]), int(columns[0]))


def _share(blur_size_px: NDArray, size: float, step: float) -> FloatArray:
    """Share of each pixel in a layer: 1 at the layer's blur size, 0 at its neighbours'."""
    if step == 0:
        return np.isfinite(blur_size_px).astype(np.float32)
    share = np.maximum(0, 1 - np.abs(blur_size_px - np.float32(size)) / np.float32(step))
    return np.nan_to_num(share, nan=0.0, copy=False)


def _blocks(mask: Mask, count: int) -> Iterator[Mask]:
    """Masks of the same grid, each open in one block only."""
    grid = mask.transmission
    for rows in np.array_split(np.arange(grid.shape[0]), min(count, grid.shape[0])):
        for columns in np.array_split(np.arange(grid.shape[1]), min(count, grid.shape[1])):
            block = np.zeros_like(grid)
            block[np.ix_(rows, columns)] = grid[np.ix_(rows, columns)]
            if block.any():
                yield Mask(mask.name, block)


def _through_block(
    layers: list[_Layer], psf: Callable[[float], FloatArray], share: float, shape: tuple[int, ...]
) -> FloatArray:
    """Premultiplied colours and weight of the light through a block [rows, columns, channels + 1].

    `psf` returns the block's PSF for a blur size, and `share` is its part of the light. The weight
    is the share; it falls to zero where no surface is known that light comes from: next to steep
    steps a block may look past the visible surface and its hidden continuation.
    """
    height, width = shape
    total = np.zeros((height, width, layers[0].light.shape[2]), dtype=np.float32)
    # Coverage by the layers that are in front by more than the surface gap.
    occluded = np.zeros((height, width), dtype=np.float32)
    recent: deque[tuple[int, tuple[slice, slice], FloatArray]] = deque()
    for layer in layers:
        while recent and recent[0][0] <= layer.number - layer.surface_gap:
            _, region, coverage = recent.popleft()
            occluded[region] += coverage
        region, blurred = _blur(layer, psf(layer.blur_size_px), height, width)
        blurred *= np.maximum(0, 1 - occluded[region])[..., None]
        total[region] += blurred
        recent.append((layer.number, region, blurred[..., -1]))
    lit: FloatArray = np.maximum(total[..., -1:], _MIN_COVERAGE)
    return total * (np.float32(share) / lit)


def _blur(
    layer: _Layer, kernel: FloatArray, height: int, width: int
) -> tuple[tuple[slice, slice], FloatArray]:
    """Region of the blurred layer in the frame, and the blurred layer."""
    # OpenCV correlates; turned by 180 degrees, the kernel convolves.
    kernel = kernel[::-1, ::-1]
    reach = len(kernel) // 2
    rows, columns = layer.light.shape[:2]
    bottom = layer.top + rows
    right = layer.left + columns
    top = max(0, layer.top - reach)
    left = max(0, layer.left - reach)
    region = slice(top, min(height, bottom + reach)), slice(left, min(width, right + reach))
    # Nothing around the layer, but beyond the frame's edges it goes on as at the edge.
    margins = (layer.top - top, region[0].stop - bottom, layer.left - left, region[1].stop - right)
    padded = cv2.copyMakeBorder(layer.light, *margins, cv2.BORDER_CONSTANT, value=0)
    return region, _correlate(padded, kernel)


def _kernel(
    block: Mask, camera: Camera, blur_size_px: float, tangent: DoubleArray | None
) -> FloatArray:
    """PSF of a block; with diffraction, its contribution to that of the whole mask."""
    if tangent is not None:
        return camera.field_psf(block, blur_size_px, tangent)
    q = camera.psf_diffraction_px
    if not q:
        return render_psf(block, blur_size_px)
    width = psf_width(blur_size_px) + 2 * diffraction_tail_px(camera.mask, q)
    psf = diffracted_psf(camera.mask, blur_size_px, width, q, part=block)
    return (psf / psf.sum()).astype(np.float32)


def _correlate(light: FloatArray, kernel: FloatArray) -> FloatArray:
    """Correlation with a centred kernel, of which only the non-zero part is computed."""
    rows = np.flatnonzero(kernel.any(axis=1))
    columns = np.flatnonzero(kernel.any(axis=0))
    part = np.ascontiguousarray(kernel[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])
    reach = len(kernel) // 2
    padded = cv2.copyMakeBorder(light, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    # OpenCV refuses an anchor outside the kernel, so the shift is made by cutting out the result.
    filtered = cv2.filter2D(padded, -1, part, anchor=(0, 0))
    height, width = light.shape[:2]
    return filtered[rows[0] : rows[0] + height, columns[0] : columns[0] + width]
