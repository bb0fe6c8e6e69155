"""Point-spread functions of an ideal thin lens with diffraction, in light of one wavelength.

With the mask's coordinate x in units of its extent M, the field at u pixels beside the chief ray is
the scalar diffraction integral of the mask's amplitude t(x) and of the defocus (J. W. Goodman,
Introduction to Fourier Optics, 3rd ed., eq. 6-33 and 6-34)::

    U(u) = integral of t(x) exp(i pi (S |x|^2 - 2 x u) / q) dx,    PSF = |U|^2

with the blur size S and ``q = wavelength f_px / M``, the wavelength times the f-number, both in
pixels. The mask sits at the lens.
"""

import numpy as np
import scipy.special
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.optics.mask import Mask

# Half waves of defocus at the mask's edge below which the phase is that in focus.
_MIN_DEFOCUS = 1e-3
# Tails of a PSF are cut off where this share of the light lies beyond, or at this distance.
_LOST_SHARE = 0.02
_MAX_TAIL_PX = 8
# Points of the integral over a pixel beyond what the finest fringes need, for 6 digits.
_EXTRA_QUADRATURE_POINTS = 5


def scatter_length_px(mask: Mask, diffraction_px: float) -> float:
    """Length l of a mask's diffraction tails, px: beyond d px lies a share of l / d of the light.

    ``q P / (2 pi^2 A)`` of perimeter P and area A of the openings, the tail of every diffraction
    pattern: for a slit of width w, ``q / (pi^2 w)``. `diffraction_px` is q.
    """
    grid = np.pad(mask.transmission.astype(np.float64), 1)
    perimeter = sum(np.abs(np.diff(grid, axis=axis)).sum() for axis in (0, 1))
    # Cells are 1 / n of the extent wide.
    per_area = perimeter / grid.sum() * max(mask.transmission.shape)
    return float(diffraction_px * per_area / (2 * np.pi**2))


def diffraction_tail_px(mask: Mask, diffraction_px: float) -> int:
    """Pixels by which a PSF with diffraction is wider on each side than the geometric one."""
    return min(int(np.ceil(scatter_length_px(mask, diffraction_px) / _LOST_SHARE)), _MAX_TAIL_PX)


def diffracted_psf(
    mask: Mask,
    blur_size_px: float,
    width_px: int,
    diffraction_px: float,
    centre_px: tuple[float, float] = (0.0, 0.0),
    part: Mask | None = None,
) -> DoubleArray:
    """Light of each pixel, float64 [width_px, width_px], as a share of all light.

    The field of a square cell is a product of two Fresnel integrals, so that it is exact; the
    intensity between neighbouring pixels is shared between them as in `render_psf`, by Gauss's
    rule with points enough for its fringes.

    Parameters
    ----------
    mask, blur_size_px, width_px, centre_px
        As in `render_psf`.
    diffraction_px : float
        ``q`` above, px, more than 0.
    part : Mask, optional
        Some of the mask's cells. The result is then the light through them, ``Re(U_part* U)``:
        summed over all parts it is the PSF; of one part it may be negative in places.
    """
    count = int(np.ceil(np.pi / (2 * diffraction_px))) + _EXTRA_QUADRATURE_POINTS
    nodes, weights = np.polynomial.legendre.leggauss(count)
    # From before the first pixel to beyond the last; of what lies between two, each has a share.
    gaps, towards = width_px + 1, (nodes + 1) / 2
    places = (np.arange(gaps)[:, None] - (width_px + 1) / 2 + towards).ravel()
    before, beyond = weights / 2 * (1 - towards), weights / 2 * towards
    amplitude = np.sqrt(mask.transmission.astype(np.float64))
    # A row of the grid is not as long as the extent where the grid is higher than wide.
    cell, (down, across) = 1 / max(amplitude.shape), amplitude.shape
    rows, columns = (
        _slit_fields(
            (np.arange(cells + 1) - cells / 2) * cell, places - beside, blur_size_px, diffraction_px
        )
        for cells, beside in zip((down, across), centre_px, strict=True)
    )
    chosen = amplitude if part is None else np.sqrt(part.transmission.astype(np.float64))
    light = np.zeros((width_px + 2, width_px))
    across_whole = amplitude @ columns.T
    across_chosen = chosen @ columns.T
    # A row of gaps at a time: all points together can take gigabytes.
    for gap, row_fields in enumerate(rows.reshape(gaps, count, down)):
        whole = row_fields @ across_whole
        passed = whole if part is None else row_fields @ across_chosen
        intensity = (passed.conj() * whole).real.reshape(count, gaps, count)
        of_pixels = (intensity @ beyond)[:, :-1] + (intensity @ before)[:, 1:]
        light[gap] += before @ of_pixels
        light[gap + 1] += beyond @ of_pixels
    light = light[1:-1]
    # Parseval's theorem: the integral of |U|^2 is q^2 times that of t^2.
    return light / (diffraction_px**2 * float((amplitude**2).sum()) * cell**2)


def _slit_fields(
    edges: DoubleArray, u: DoubleArray, size_px: float, q: float
) -> NDArray[np.complex128]:
    """Field of each slit between neighbouring edges [n + 1] at positions u, [u, n].

    Without a phase that all slits share at a position and, for negative sizes, without the
    conjugate: the intensity does not depend on them.
    """
    frequency = u[:, None] / q
    curvature = size_px / q
    if abs(curvature) < _MIN_DEFOCUS:
        middle = (edges[1:] + edges[:-1]) / 2
        width = np.diff(edges)
        return width * np.sinc(width * frequency) * np.exp(-2j * np.pi * middle * frequency)
    scale = np.sqrt(2 * abs(curvature))
    sine, cosine = scipy.special.fresnel(scale * (edges - frequency / curvature))
    return np.diff(cosine + 1j * sine, axis=1) / scale
