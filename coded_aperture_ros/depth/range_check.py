"""Whether depths from elsewhere are metres within the range of a model's levels."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.levels import depths_are_measured
from coded_aperture_ros.likelihood import BlurLevels
from coded_aperture_ros.optics import Camera

# Depths so far outside of the range, as a factor, are as good as within.
_MARGIN = 1.25
# With a smaller share of the depths within the range, they are taken for those of another unit.
_HARDLY_ANY = 0.02
# With a larger share, a unit explains them.
_MOST = 0.5
_UNITS = {"mm": 1e-3, "cm": 1e-2, "0.1 mm": 1e-4, "feet": 0.3048}


def blur_sizes_px(
    model: BlurLevels, camera: Camera | None, depth_m: FloatArray
) -> FloatArray | None:
    """Signed blur size [px] of every pixel of a depth map; None if depths are not known.

    Parameters
    ----------
    model : BlurLevels
        Its measured depths take precedence over the camera, as in `Levels`.
    camera : Camera or None
    depth_m : ndarray, float32 [rows, columns]
        Metres, of the whole image; NaN where unknown.

    Returns
    -------
    ndarray, float32 [rows, columns], or None
        NaN where the depth is.

    References
    ----------
    Martinello 2012, eq. 3.28.
    """
    if camera is None or depths_are_measured(model):
        return model.stack.interpolate_blur_size(depth_m)
    return np.asarray(camera.blur_map_px(depth_m), np.float32)


def depth_range_m(model: BlurLevels, camera: Camera | None) -> tuple[float, float] | None:
    """Nearest and farthest depth of a model's levels, m; None if depths are not known.

    Parameters
    ----------
    model : BlurLevels
        Its measured depths take precedence over the camera, as in `Levels`.
    camera : Camera or None
    """
    depths_m = model.stack.depths_m
    if camera is not None and not depths_are_measured(model):
        depths_m = camera.depth_m(model.stack.blur_sizes_px)
    if depths_m is None:
        return None
    depths_m = np.asarray(depths_m)
    real = depths_m[depths_m > 0]
    return (float(real.min()), float(real.max())) if real.size else None


def range_complaint(depth_m: FloatArray, range_m: tuple[float, float]) -> str:
    """One line if hardly any depth is within a range; empty if enough are, or none is known.

    Parameters
    ----------
    depth_m : ndarray
        What should be metres. Values that are not finite, or not positive, do not count.
    range_m : (float, float)
        Nearest and farthest, m.

    Examples
    --------
    >>> range_complaint(np.array([2.5, 30.0, np.nan]), (2.0, 5.0))
    ''
    >>> print(range_complaint(np.array([250.0, 480.0, np.nan]), (2.0, 5.0)))
    none of the depths (252.3 to 477.7) is within the range of 2 to 5 m: give them in metres, ...
    """
    known = depth_m[np.isfinite(depth_m) & (depth_m > 0)]
    if not known.size:
        return ""
    share = _share_within(known, range_m)
    if share >= _HARDLY_ANY:
        return ""
    near_m, far_m = range_m
    low, high = np.percentile(known, [1, 99])
    found = f"only {share:.1%}" if share else "none"
    line = (
        f"{found} of the depths ({low:.4g} to {high:.4g}) is within the range of {near_m:.3g} to "
        f"{far_m:.3g} m: give them in metres"
    )
    values = {unit: known * factor for unit, factor in _UNITS.items()}
    with np.errstate(over="ignore"):  # of depths that are next to nothing
        values["1/m (inverse depth)"] = 1 / known
    likely = [unit for unit, metres in values.items() if _share_within(metres, range_m) > _MOST]
    return f"{line}, they seem to be in {likely[0]}" if likely else line


def check_depth_range(model: BlurLevels, camera: Camera | None, depth_m: FloatArray) -> None:
    """Raise `InputError` if hardly any depth is one that a model has a level for."""
    range_m = depth_range_m(model, camera)
    complaint = "" if range_m is None else range_complaint(depth_m, range_m)
    if complaint:
        raise InputError(f"depth: {complaint}")


def checked_blur_sizes_px(
    model: BlurLevels, camera: Camera | None, depth_m: FloatArray
) -> FloatArray:
    """Signed blur size [px] of every pixel of a depth map; see `blur_sizes_px`.

    Raises
    ------
    InputError
        If no depth is known, or what blur it has, or hardly any is one of the model's levels.
    """
    sizes_px = blur_sizes_px(model, camera, depth_m)
    if sizes_px is None:
        raise InputError(
            "depth: neither the bank nor a camera says what blur a depth has: give the camera"
        )
    if not np.isfinite(sizes_px).any():
        raise InputError("depth: no depth is known in the whole frame")
    check_depth_range(model, camera, depth_m)
    return sizes_px


def _share_within(depth_m: FloatArray, range_m: tuple[float, float]) -> float:
    near_m, far_m = range_m
    within = (depth_m >= near_m / _MARGIN) & (depth_m <= far_m * _MARGIN)
    return float(np.mean(within))
