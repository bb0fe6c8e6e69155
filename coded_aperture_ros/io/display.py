"""Pictures for display, beside files of linear light and of depth, which viewers show dark."""

import os
from pathlib import Path

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.frames.light import SRGB
from coded_aperture_ros.io.depth_picture import depth_picture
from coded_aperture_ros.io.picture_file import DISPLAY_SUFFIX, write_image


def display_path(path: str | os.PathLike[str]) -> Path:
    """Path of the picture for display beside a file.

    Examples
    --------
    >>> display_path("frames/coded.png").as_posix()
    'frames/coded.picture.png'
    """
    return Path(path).with_suffix(DISPLAY_SUFFIX)


def write_light_for_display(path: str | os.PathLike[str], light: FloatArray) -> None:
    """Write light as an 8-bit sRGB picture beside its file.

    Parameters
    ----------
    path : str or path-like
        File of the light, from which `display_path` makes the name.
    light : ndarray, float32 [rows, columns] or [rows, columns, RGB]
        Linear light, of which 0 to 1 is shown; NaN is black.

    Raises
    ------
    InputError
        With the file's name: it cannot be written.
    """
    write_image(display_path(path), light, bits=8, gamma=SRGB)


def write_depth_for_display(path: str | os.PathLike[str], depth_m: FloatArray) -> None:
    """Write a depth map in colours beside its file; see `write_light_for_display`."""
    write_image(display_path(path), depth_picture(depth_m))
