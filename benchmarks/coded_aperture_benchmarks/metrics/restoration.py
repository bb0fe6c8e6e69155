"""How close a deblurred picture is to the sharp one, and to the coded frame that it came from."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.metrics.errors import psnr_db

# Side of the windows that structural similarity is measured in: scikit-image's default.
_SSIM_WINDOW_PX = 7
# How far around a pixel the range of the truth is taken for ringing, px, and from which range on.
_RINGING_PX, _LEAST_STEP = 12, 0.1
# Passes what alternates from pixel to pixel along rows and columns both, and white noise with its
# variance unchanged; blurred texture has next to nothing there.
_ALTERNATING = (np.array([1, -2, 1]) / np.sqrt(6)).astype(np.float32)
# Turns the median absolute deviation of a normal distribution into its standard deviation.
_MAD_TO_STD = 1.4826


def deblurring_error(image: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """Return the error of thesis tables 6.5 to 6.8, ``sqrt(|f - f*|^2 + |grad f - grad f*|^2)``.

    The thesis does not say how its norms are scaled. Of a picture of 4875 x 125 pixels, sums of
    squares would be in the hundreds at least where it prints 0.2, so both norms are read as means
    over the pixels, and the gradient as forward differences to the next row and to the next
    column, whose squares add up. An error that is white noise of standard deviation s so has the
    value 2.2 s, a constant error its own size.

    Intensities are measured with 1 = full scale. Those of a stair are in the scale of its
    textures: grey values as picture files store them, not linear light.

    Parameters
    ----------
    image, truth : ndarray of float, shape [rows, columns]
        At least two pixels each way; intensities, 0 to 1.
    """
    _check_shapes(image, truth)
    if image.ndim != 2 or min(image.shape) < 2:
        raise InputError(
            f"expected grey pictures of at least 2 x 2 pixels, got the shape {list(image.shape)}"
        )
    difference = np.asarray(image, np.float64) - truth
    parts = (difference, np.diff(difference, axis=0), np.diff(difference, axis=1))
    return float(np.sqrt(sum(np.mean(part**2) for part in parts)))


@dataclasses.dataclass(frozen=True)
class PictureScore:
    """How much a picture is like the true one.

    Attributes
    ----------
    psnr_db : float
        Peak signal-to-noise ratio, of all channels together; infinite for equal pictures.
    ssim : float
        Mean structural similarity, at most 1.
    pixels : int
        How many it was measured over; both are NaN for none.
    """

    psnr_db: float
    ssim: float
    pixels: int


def picture_score(
    image: NDArray[np.floating], truth: NDArray[np.floating], part: NDArray[np.bool_] | None = None
) -> PictureScore:
    """Compare a picture with the true one.

    Parameters
    ----------
    image, truth : ndarray of float, shape [rows, columns] or [rows, columns, channels]
        Intensities, 0 to 1; at least 7 rows and columns.
    part : ndarray of bool, shape [rows, columns], optional
        The pixels that count; all by default. The windows of structural similarity have 7 pixels a
        side: those within 3 pixels of the border are left out of it, and those of a part see a
        little of what is beyond it.
    """
    _check_shapes(image, truth)
    if min(image.shape[:2]) < _SSIM_WINDOW_PX:
        raise InputError(
            f"expected pictures of at least {_SSIM_WINDOW_PX} x {_SSIM_WINDOW_PX} pixels, "
            f"got the shape {list(image.shape)}"
        )
    try:
        from skimage.metrics import structural_similarity
    except ImportError as error:
        raise missing_scikit_image("structural similarity") from error
    part = np.ones(image.shape[:2], bool) if part is None else part
    _, similarity = structural_similarity(
        np.asarray(image, np.float64),
        np.asarray(truth, np.float64),
        win_size=_SSIM_WINDOW_PX,
        data_range=1.0,
        channel_axis=None if image.ndim == 2 else -1,
        full=True,
    )
    margin = _SSIM_WINDOW_PX // 2
    inside = (slice(margin, -margin), slice(margin, -margin))
    similar = similarity[inside][part[inside]]
    return PictureScore(
        psnr_db=psnr_db(image[part], truth[part]),
        ssim=float(similar.mean()) if similar.size else float("nan"),
        pixels=int(np.count_nonzero(part)),
    )


def overshoot(
    image: NDArray[np.floating], truth: NDArray[np.floating], part: NDArray[np.bool_]
) -> float:
    """Return how far a picture rings beyond what is around each pixel in the true one.

    Over- and undershoots are relative to the range of the truth within 12 px, where that is at
    least a tenth of full scale; the mean of the worst hundredth of the pixels. NaN without any.

    Parameters
    ----------
    image, truth : ndarray of float, shape [rows, columns] or [rows, columns, channels]
    part : ndarray of bool, shape [rows, columns]
        The pixels that count.
    """
    _check_shapes(image, truth)
    around = np.ones((2 * _RINGING_PX + 1,) * 2, np.uint8)
    truth = np.atleast_3d(np.asarray(truth, np.float32))
    image = np.atleast_3d(image)
    beyond = []
    for channel in range(truth.shape[2]):
        high, low = cv2.dilate(truth[..., channel], around), cv2.erode(truth[..., channel], around)
        step = high - low
        excess = np.maximum(image[..., channel] - high, low - image[..., channel])
        counts = part & (step >= _LEAST_STEP)
        beyond.append(np.maximum(excess, 0)[counts] / step[counts])
    values = np.sort(np.concatenate(beyond))
    return float(values[-max(len(values) // 100, 1) :].mean()) if len(values) else float("nan")


def residual_rms(
    sharp: NDArray[np.floating], coded: NDArray[np.floating], psf: NDArray[np.floating]
) -> float:
    """Return the root mean square of ``g - h * f``: what a sharp picture leaves unexplained.

    Parameters
    ----------
    sharp, coded : ndarray of float, shape [rows, columns]
        ``f`` and ``g``.
    psf : ndarray of float, shape [k, k]
        ``h``, odd. Only pixels whose whole PSF lies within the picture count.
    """
    _check_shapes(sharp, coded)
    reach = len(psf) // 2
    if sharp.ndim != 2 or min(sharp.shape) < len(psf):
        raise InputError(
            f"expected grey pictures of at least the PSF's {len(psf)} x {len(psf)} pixels, "
            f"got the shape {list(sharp.shape)}"
        )
    blurred = fftconvolve(np.asarray(sharp, np.float64), psf, mode="valid")
    inside = coded[reach : coded.shape[0] - reach, reach : coded.shape[1] - reach]
    return float(np.sqrt(np.mean((inside - blurred) ** 2)))


def noise_of(picture: NDArray[np.floating]) -> float:
    """Return the standard deviation of the white noise of a blurred grey picture.

    From the median of what alternates from pixel to pixel, so that a few edges do not count. It is
    not on the safe side, as the noise that depth is estimated with is.

    Parameters
    ----------
    picture : ndarray of float, shape [rows, columns]
    """
    values = np.asarray(picture, np.float32)
    passed = cv2.sepFilter2D(values, -1, _ALTERNATING, _ALTERNATING)[1:-1, 1:-1]
    return _MAD_TO_STD * float(np.median(np.abs(passed)))


def missing_scikit_image(what: str) -> InputError:
    """Return the error that says what scikit-image is needed for."""
    return InputError(f"{what} needs scikit-image: pip install scikit-image")


def _check_shapes(first: NDArray, second: NDArray) -> None:
    if first.shape != second.shape:
        raise InputError(
            f"expected pictures of one shape, got {list(first.shape)} and {list(second.shape)}"
        )
