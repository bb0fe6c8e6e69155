"""Measured PSFs of several depths, centred and interpolated to a stack."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.centre import (
    CentredPsf,
    PsfAt,
    centred_by_outline,
    centred_on_mask,
)
from coded_aperture_ros.calibration.stack import equally_spaced_stack
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.optics import Camera, Mask, PsfStack


@dataclasses.dataclass(frozen=True, eq=False)
class MeasuredPsfs:
    """PSFs of one camera at some depths.

    Attributes
    ----------
    centred : list of CentredPsf
        One for each picture, in the pictures' order.
    expected_px : ndarray of float64, shape [N], or None
        Blur sizes that the camera file has for the depths.
    stack : PsfStack
        Equally spaced blur sizes: those of the camera file where there is one.
    """

    centred: list[CentredPsf]
    expected_px: NDArray[np.float64] | None
    stack: PsfStack


def expected_sizes_px(
    camera: Camera | None, depths_m: Sequence[float] | None
) -> NDArray[np.float64] | None:
    """Return the camera's signed blur sizes at depths; None if either is not known.

    Raises
    ------
    InputError
        If a depth cannot be seen.
    """
    if depths_m is None:
        return None
    depths = np.asarray(depths_m, np.float64)
    if not ((depths > 0) & np.isfinite(depths)).all():
        raise InputError("depths: expected distances of more than 0 m")
    if camera is None:
        return None
    sizes = camera.blur_size_px(depths)
    if not np.isfinite(sizes).all():
        raise InputError("depths: the mask is farther away than one of them")
    return sizes


def centred_stack(
    measured: Sequence[PsfAt],
    names: Sequence[str],
    camera: Camera | None = None,
    mask: Mask | None = None,
    depths_m: Sequence[float] | None = None,
    levels: int | None = None,
) -> MeasuredPsfs:
    """Centre measured PSFs, find their blur sizes, and interpolate between them.

    Parameters
    ----------
    measured : sequence of callable
        As `DotPsf.at` and `PairPsf.at`, one for each depth.
    names : sequence of str
        What to call each in messages.
    camera : Camera, optional
        Its mask centres the PSFs; with depths, it says how large their blur is.
    mask : Mask, optional
        In place of the camera's. Without any, the outline of the widest PSF is the mask's extent.
    depths_m : sequence of float, optional
    levels : int, optional
        Of the stack; by default one for each PSF.

    Raises
    ------
    InputError
        Naming the picture.
    """
    mask = camera.mask if mask is None and camera is not None else mask
    expected = expected_sizes_px(camera, depths_m)
    if mask is None:
        centred = centred_by_outline(measured)
    else:
        centred = []
        for number, (at, name) in enumerate(zip(measured, names, strict=True)):
            try:
                known = None if expected is None else float(expected[number])
                centred.append(centred_on_mask(at, mask, known))
            except InputError as error:
                raise InputError(f"{name}: {error}") from error
    sizes = np.array([one.blur_size_px for one in centred]) if expected is None else expected
    psfs = [one.psf for one in centred]
    return MeasuredPsfs(
        centred, expected, equally_spaced_stack(psfs, sizes, levels, depths_m, mask)
    )
