"""Reading and writing images and depth maps."""

import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.array_file import read_array
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.input_file import check_picture_size, read_bytes
from coded_aperture_ros.frames.frame import PixelFormat
from coded_aperture_ros.frames.light import SRGB, Gamma, check_linear, pixels_from_linear
from coded_aperture_ros.frames.pictures import StoredPicture, decode_picture
from coded_aperture_ros.io.messages.frames import millimetres_from_depth

PICTURE_SUFFIXES = (
    ".png",
    ".tif",
    ".tiff",
    ".jpg",
    ".jpeg",
    ".bmp",
    ".webp",
    ".ppm",
    ".pgm",
    ".npy",
)
# Formats that are read, but not written.
_READ_SUFFIXES = (*PICTURE_SUFFIXES, ".pbm", ".pnm", ".pam", ".pfm")
# Of the pictures for display beside others, which are none of a camera.
DISPLAY_SUFFIX = ".picture.png"
_TIFF = (".tif", ".tiff")
_MILLIMETRE = 1e-3
# By default OpenCV 4.6 stores float colours in the lossy LogLuv form; 5 is LZW.
_ENCODING = dict.fromkeys(_TIFF, (cv2.IMWRITE_TIFF_COMPRESSION, 5))


def picture_files(folder: Path) -> list[Path]:
    """Paths of the pictures in a folder, sorted by name, without those for display.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_image(pathlib.Path(folder, "b.png"), np.zeros((4, 6)))
    ...     write_image(pathlib.Path(folder, "a.png"), np.zeros((4, 6)))
    ...     [path.name for path in picture_files(pathlib.Path(folder))]
    ['a.png', 'b.png']
    """
    return sorted(
        file
        for file in folder.iterdir()
        if file.suffix.lower() in _READ_SUFFIXES
        and not file.name.startswith(".")
        and not file.name.lower().endswith(DISPLAY_SUFFIX)
    )


def read_image(path: str | os.PathLike[str], gamma: Gamma = SRGB) -> FloatArray:
    """Image in linear light, float32 [h, w] or [h, w, 3].

    Parameters
    ----------
    path : str or path-like
        Any picture that OpenCV reads, Netpbm or PFM, or a `.npy` array [row, column] or
        [row, column, RGB].
    gamma : float or "srgb", optional
        Encoding of 8-bit pictures; 1.0 for those of sensors that are read out without a tone curve,
        which the commands take them for unless ``--gamma`` is given. 16-bit and float files are
        linear.

    Returns
    -------
    ndarray of float32, shape [h, w] or [h, w, 3]
        RGB, rows and columns as the file stores them: orientation is ignored. Integer files give 0
        to 1, of the largest value that the file names; float files keep their values and NaN.

    Raises
    ------
    InputError
        With the file's name: it is missing, empty, damaged, not one picture, or its numbers are not
        0 to 1.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "a.png")
    ...     write_image(file, np.full((4, 6), 0.25))
    ...     round(float(read_image(file)[0, 0]), 4)
    0.25
    """
    return PixelFormat(gamma).light(read_compressed(path)[0])


def read_compressed(path: str | os.PathLike[str]) -> tuple[NDArray, float]:
    """Pixels as stored (uint8, uint16 or float32), and the noise that compression has hidden.

    See `read_image` and `quantisation_sigma`.
    """
    path = Path(path)
    data = _read_data(path)
    stored = _decode(path, data)
    pixels = stored.pixels
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[:, :, 0]
    if pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] != 3) or not pixels.size:
        raise InputError(
            f"{path}: expected a picture [row, column] or [row, column, RGB], "
            f"got the shape {list(pixels.shape)}"
        )
    if pixels.dtype.kind == "f":
        with naming(path):
            check_linear(pixels)
        return pixels.astype(np.float32, copy=False), 0.0
    if pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: expected 8-bit, 16-bit or float pixels, got {pixels.dtype}")
    return _with_usual_white(pixels, stored.white), stored.compression_loss


def _with_usual_white(pixels: NDArray, white: int) -> NDArray:
    """Pixels of up to 8 bits whose white is 255, or of more bits in linear light, float32."""
    if white == np.iinfo(pixels.dtype).max:
        return pixels
    if pixels.dtype == np.uint8:
        return np.rint(pixels * np.float32(255 / white)).astype(np.uint8)
    # Floats: no option about the bits of 16-bit pixels applies to a file that says its own.
    return pixels * np.float32(1 / white)


def write_image(
    path: str | os.PathLike[str], image: NDArray, bits: int | None = None, gamma: Gamma = SRGB
) -> None:
    """Write an image; the suffix decides the format.

    Parameters
    ----------
    path : str or path-like
        `.npy` and `.tif` store float32 unless `bits` is given; other formats store integers.
    image : ndarray, shape [h, w] or [h, w, 3]
        Linear light, RGB; or 8-bit pixels, which are stored unchanged.
    bits : {8, 16}, optional
        By default 16 for PNG, and 8 for formats that hold no more. Viewers show 16 bits dark, for
        they are linear: use 8 for pictures that people look at.
    gamma : float or "srgb", optional
        Encoding of 8-bit pictures; 1.0 for linear light. Wider ones are linear.

    Raises
    ------
    InputError
        With the file's name: it cannot be written, or the format is unknown.

    Examples
    --------
    See `read_image`.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in PICTURE_SUFFIXES:
        raise InputError(f"{path}: unknown picture format, use one of {' '.join(PICTURE_SUFFIXES)}")
    if suffix == ".npy" or (suffix in _TIFF and bits is None and image.dtype != np.uint8):
        image = image.astype(np.float32)
    elif image.dtype != np.uint8:
        bits = bits or (16 if suffix == ".png" else 8)
        image = pixels_from_linear(image, bits, gamma if bits == 8 else 1.0)
    _write(path, image)


def read_depth(path: str | os.PathLike[str], metres_per_unit: float | None = None) -> FloatArray:
    """Depth map in metres, float32 [h, w]; NaN where the file has 0, a negative number or NaN.

    Parameters
    ----------
    path : str or path-like
        16-bit PNG in millimetres, or float TIFF or `.npy` in metres.
    metres_per_unit : float, optional
        Unit of the file, if it is another.

    Raises
    ------
    InputError
        With the file's name: it is missing, or not a depth map.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "depth.png")
    ...     write_depth(file, np.array([[1.5, np.nan]]))
    ...     read_depth(file).round(3).tolist()
    [[1.5, nan]]
    """
    pixels = _decode(Path(path), _read_data(Path(path))).pixels
    if pixels.ndim != 2 or not pixels.size:
        raise InputError(
            f"{path}: expected a depth map [row, column], got the shape {list(pixels.shape)}"
        )
    if metres_per_unit is None:
        if pixels.dtype == np.uint8:
            raise InputError(f"{path}: 8-bit depth has no usual unit: give 16 bits in mm")
        metres_per_unit = _MILLIMETRE if pixels.dtype.kind in "ui" else 1.0
    if not 0 < metres_per_unit < np.inf:
        raise InputError(f"metres per unit: expected a positive number, got {metres_per_unit!r}")
    depth = pixels.astype(np.float32) * np.float32(metres_per_unit)
    return np.where(depth > 0, depth, np.float32(np.nan))


def write_depth(path: str | os.PathLike[str], depth_m: NDArray) -> None:
    """Write a depth map: 16-bit millimetres to `.png`, float metres to `.tif` and `.npy`.

    Parameters
    ----------
    path : str or path-like
    depth_m : ndarray [h, w]
        m. For NaN, infinity and depths beyond 65.535 m see `millimetres_from_depth`.

    Raises
    ------
    InputError
        With the file's name: it cannot be written, or the format is unknown.

    Examples
    --------
    See `read_depth`.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in (".npy", *_TIFF):
        _write(path, depth_m.astype(np.float32))
    elif suffix == ".png":
        _write(path, millimetres_from_depth(depth_m))
    else:
        raise InputError(f"{path}: unknown depth format, use .npy, .tif or .png")


def _read_data(path: Path) -> bytes:
    data = read_bytes(path, path)
    if not data:
        raise InputError(f"cannot read {path}: the file is empty")
    return data


def _decode(path: Path, data: bytes) -> StoredPicture:
    """Picture of a file as stored."""
    if path.suffix.lower() == ".npy":
        array = _array_of(path, data)
        white = np.iinfo(array.dtype).max if array.dtype.kind in "ui" else 1
        return StoredPicture(array, white)
    with naming(f"cannot read {path}"):
        return decode_picture(data)


def _array_of(path: Path, data: bytes) -> NDArray:
    try:
        array = read_array(data)
    except ValueError as error:
        raise InputError(f"cannot read {path}: truncated, or not a .npy array") from error
    if array.dtype.kind not in "uif":
        raise InputError(f"cannot read {path}: expected one numeric array")
    if array.ndim > 1:
        with naming(f"cannot read {path}"):
            check_picture_size(*array.shape[:2])
    return array.astype(array.dtype.newbyteorder("="))


def _write(path: Path, pixels: NDArray) -> None:
    suffix = path.suffix.lower()
    with atomic_output(path) as temporary:
        if suffix == ".npy":
            with temporary.open("wb") as file:
                np.save(file, pixels)
            return
        if pixels.ndim == 3:
            pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
        try:
            written = cv2.imwrite(str(temporary), pixels, _ENCODING.get(suffix, ()))
        except cv2.error as error:
            raise InputError(f"cannot write {path}: {error.err}") from error
        if not written:
            raise InputError(f"cannot write {path}: the picture could not be encoded")
