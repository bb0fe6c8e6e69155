"""Videos with true depth, and how far and how restlessly estimated depth is off in them."""

import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_benchmarks.datasets.cameras import camera_for_blur
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import read_depth, read_image
from coded_aperture_ros.metrics.errors import RelativeError
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation import render_coded_frame

WARM_UP_FRAMES = 5
BAND_PX = 12
# True depths are exact: what changes by more does move.
_CONSTANT = 1e-3
# Nearer than the background by this share: a moving object, and not a rounding of its outline.
_NEARER = 0.02
# Slits up to this wide in a moving object are where, for a moment, its depth does not change.
_SLIT_PX = 4
# A larger change of the true depth from one frame to the next is an edge passing by.
_SMOOTH = 0.02
# Turns the median absolute deviation of a normal distribution into its standard deviation.
_MAD_TO_STD = 1.4826

_RAY_TRACED, _RGBD = "meta.json", "intrinsics.json"
_EVERY_FRAME = 10_000
# What the simulated camera sees of an RGB-D video: white stays below saturation, and the depths
# span these blur sizes, beyond the focus.
_WHITE = np.float32(0.9)
_SMALLEST_BLUR_PX, _LARGEST_BLUR_PX = 4.0, 20.0
# Three blocks a side differ by 0.002, which noise hides, and take twice the time.
_APERTURE_BLOCKS = 2


@dataclasses.dataclass(frozen=True, eq=False)
class CodedVideo:
    """Consecutive coded frames with their truth.

    Attributes
    ----------
    frames : list of ndarray, float32 [rows, columns, 3]
        Linear light, without noise.
    depth_m : ndarray, float32 [frames, rows, columns]
        True depth; NaN where unknown.
    moving : ndarray, bool [frames, rows, columns], or None
        The pixels that show a moving object; None where the camera itself moves.
    """

    frames: list[NDArray[np.float32]]
    depth_m: NDArray[np.float32]
    camera: Camera
    moving: NDArray[np.bool_] | None = None

    def around_moving(self, reach_px: float = BAND_PX) -> NDArray[np.bool_] | None:
        """Return the pixels within `reach_px` of a moving object, without the object itself."""
        if self.moving is None:
            return None
        return np.stack([_band(moving, reach_px) for moving in self.moving])

    def static_points(self) -> NDArray[np.bool_] | None:
        """Return the pixels [rows, columns] of constant true depth; None if the camera moves."""
        return None if self.moving is None else _constant(self.depth_m)


def moving_pixels(depth_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Find the pixels of moving objects in the true depths of a static camera.

    These are nearer than what the pixel shows at its farthest. Where an object covers a pixel all
    the time, its depth gives it away: it changes both since the last frame and to the next one.

    Parameters
    ----------
    depth_m : ndarray, float32 [frames, rows, columns]
        The longer the video, the more of the background it has seen.

    Returns
    -------
    ndarray, bool [frames, rows, columns]
    """
    depth = np.nan_to_num(depth_m, nan=0.0)
    known = np.isfinite(depth_m)
    nearer = depth < (1 - _NEARER) * depth.max(axis=0)
    changes = np.abs(np.diff(depth, axis=0)) > _CONSTANT * depth[1:]
    restless = np.zeros_like(nearer)
    restless[1:-1] = changes[:-1] & changes[1:]
    moving = nearer | restless
    # Closing erodes what touches the border of the picture.
    square = np.ones((1, _SLIT_PX + 1, _SLIT_PX + 1), bool)
    moving |= ndimage.binary_closing(moving, square)
    moving &= known
    return moving


def _constant(depth_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return where the depth is known and the same in all frames; NaN fails the comparison."""
    constant: NDArray[np.bool_] = np.ptp(depth_m, axis=0) <= _CONSTANT * depth_m[0]
    return constant


def _band(moving: NDArray[np.bool_], reach_px: float) -> NDArray[np.bool_]:
    if not moving.any():  # the transform would measure to a point outside of the picture
        return np.zeros_like(moving)
    band: NDArray[np.bool_] = ~moving & (ndimage.distance_transform_edt(~moving) <= reach_px)
    return band


def check_video(folder: Path) -> None:
    """Check that a folder looks like one that `load_video` reads."""
    _loader(folder)


def check_rgbd_video(folder: Path) -> None:
    """Check that a folder looks like an RGB-D video."""
    if not (folder / _RGBD).is_file():
        raise InputError(f"{folder}: no RGB-D video: expected {_RGBD}, color_*.jpg, depth_*.png")


def load_video(folder: Path, frames: int, mask_name: str = "levin") -> CodedVideo:
    """Read the first frames of a ray-traced video, or simulate those of an RGB-D video.

    Parameters
    ----------
    folder : pathlib.Path
        A ray-traced video has `meta.json`, see `RayTracedScene.load_views`; its camera is static.
        An RGB-D video has `intrinsics.json` (`width`, `height` and `fx` in pixels), pictures
        `color_NNNNN.jpg` and `depth_NNNNN.png` in millimetres, 0 where unknown; its camera moves,
        nothing else does.
    frames : int
        At most so many.
    mask_name : str, optional
        One that the video was rendered with, or is simulated with.
    """
    return _loader(folder)(folder, frames, mask_name)


def _loader(folder: Path) -> Callable[[Path, int, str], CodedVideo]:
    for name, load in ((_RAY_TRACED, _ray_traced), (_RGBD, _simulated)):
        if (folder / name).is_file():
            return load
    raise InputError(
        f"{folder}: no video with true depth: expected {_RAY_TRACED} of a ray-traced one "
        f"or {_RGBD} of an RGB-D one"
    )


def _ray_traced(folder: Path, frames: int, mask_name: str) -> CodedVideo:
    views = RayTracedScene.load_views(folder, mask_name, _EVERY_FRAME)
    if len(views) < 2:
        raise InputError(f"{folder}: a still picture, expected a video")
    depth_m = np.stack([view.depth_m for view in views])
    return CodedVideo(
        frames=[view.coded for view in views[:frames]],
        depth_m=depth_m[:frames],
        camera=views[0].camera,
        moving=moving_pixels(depth_m)[:frames],  # all frames know most of the background
    )


def _simulated(folder: Path, frames: int, mask_name: str) -> CodedVideo:
    colour_files = sorted(folder.glob("color_*.jpg"))
    depth_files = sorted(folder.glob("depth_*.png"))
    if len(depth_files) < 2 or len(colour_files) != len(depth_files):
        raise InputError(
            f"{folder}: expected as many color_*.jpg as depth_*.png, at least 2, "
            f"got {len(colour_files)} and {len(depth_files)}"
        )
    depths = [read_depth(path) for path in depth_files]
    camera = _camera_for(folder, depths, Mask.named(mask_name))
    coded = []
    for path, depth_m in zip(colour_files[:frames], depths, strict=False):
        light = _light(path)
        try:
            coded.append(
                render_coded_frame(light, depth_m, camera, aperture_blocks=_APERTURE_BLOCKS)
            )
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
    return CodedVideo(coded, np.stack(depths[:frames]), camera)


def sharp_frames(folder: Path) -> Iterator[NDArray[np.float32]]:
    """Yield the pictures of an RGB-D video as `load_video` takes them, linear light."""
    return map(_light, sorted(folder.glob("color_*.jpg")))


def _light(path: Path) -> NDArray[np.float32]:
    return _WHITE * read_image(path, SRGB)


def _camera_for(folder: Path, depths: list[NDArray[np.float32]], mask: Mask) -> Camera:
    """Return a camera that sees all depths of a video, beyond its focus, well spread in blur."""
    path = folder / _RGBD
    try:
        intrinsics: dict[str, Any] = json.loads(path.read_text())
        focal_length_px = float(intrinsics["fx"])
        width, height = intrinsics["width"], intrinsics["height"]
    except KeyError as error:
        raise InputError(f"{path}: has no {error.args[0]}") from error
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: expected a JSON object with numbers: {error}") from error
    for depth_m in depths:
        if depth_m.shape != (height, width):
            raise InputError(
                f"{folder}: a depth map has {depth_m.shape[1]} x {depth_m.shape[0]} pixels, "
                f"{_RGBD} says {width} x {height}"
            )
    if not any(np.isfinite(depth_m).any() for depth_m in depths):
        raise InputError(f"{folder}: no pixel has a known depth")
    # fmin and fmax leave out what is unknown.
    nearest = float(min(np.fmin.reduce(depth_m, axis=None) for depth_m in depths))
    farthest = float(max(np.fmax.reduce(depth_m, axis=None) for depth_m in depths))
    if not nearest < farthest:
        raise InputError(f"{folder}: all depths are {nearest:g} m, expected a scene with depth")
    return camera_for_blur(
        mask,
        focal_length_px,
        (height, width),
        (nearest, farthest),
        (_SMALLEST_BLUR_PX, _LARGEST_BLUR_PX),
    )


@dataclasses.dataclass(frozen=True)
class Change:
    """How much the relative error of the depth changes from one frame to the next.

    Attributes
    ----------
    std, robust_std : float
        Standard deviation of the change, and 1.4826 times its median absolute deviation.
        Independent errors of standard deviation s change by 1.41 s. NaN without any pixel.
    """

    std: float
    robust_std: float

    @staticmethod
    def of(changes: NDArray[np.floating]) -> "Change":
        """Summarise changes, NaN where unknown."""
        known = changes[np.isfinite(changes)]
        if not known.size:
            return Change(float("nan"), float("nan"))
        deviation = np.median(np.abs(known - np.median(known)))
        return Change(float(np.std(known, dtype=np.float64)), _MAD_TO_STD * float(deviation))


@dataclasses.dataclass(frozen=True)
class Flicker:
    """Standard deviation over time of the depth of points at rest, relative to the truth.

    Attributes
    ----------
    median, mean : float
        Over the points; NaN without any.
    """

    median: float
    mean: float
    points: int


@dataclasses.dataclass(frozen=True, eq=False)
class VideoScore:
    """How good the depth of a video is.

    Attributes
    ----------
    everywhere : RelativeError
        Of all pixels with a true depth.
    moving, around_moving : RelativeError or None
        Of moving objects, and of the band around them; None if the camera moves.
    flicker : Flicker or None
        Of the points at rest; None if the camera moves.
    change : Change
        Wherever the true depth changes by less than 2 % from one frame to the next.
    unrest : ndarray, float32 [rows, columns]
        For a static camera the standard deviation over time of each point at rest; for a moving
        one the root mean square change of each pixel. Relative; NaN where there is none.
    """

    everywhere: RelativeError
    moving: RelativeError | None
    around_moving: RelativeError | None
    flicker: Flicker | None
    change: Change
    unrest: NDArray[np.float32]


def score_video(
    depth_m: NDArray[np.float32], video: CodedVideo, warm_up: int = WARM_UP_FRAMES
) -> VideoScore:
    """Compare the depths of all frames with the truth.

    Parameters
    ----------
    depth_m : ndarray of float, shape [frames, rows, columns]
        Metres; what is not finite is unknown.
    warm_up : int, optional
        The first so many frames are left out, in which a filter has seen little of the past.
    """
    if depth_m.shape != video.depth_m.shape:
        raise InputError(
            f"expected depths of shape {list(video.depth_m.shape)}, got {list(depth_m.shape)}"
        )
    if len(depth_m) < warm_up + 2:
        raise InputError(
            f"a video of {len(depth_m)} frames is too short: expected at least {warm_up + 2}, "
            f"as the first {warm_up} do not count"
        )
    truth = video.depth_m[warm_up:]
    known = np.isfinite(truth)
    estimated = depth_m[warm_up:]
    relative = np.where(np.isfinite(estimated), estimated / truth - 1, np.float32(np.nan))
    changes = _smooth_changes(relative, truth)
    static = video.static_points()

    def error_of(part: NDArray[np.bool_]) -> RelativeError:
        errors = np.abs(relative[part])
        return RelativeError.from_errors(errors[np.isfinite(errors)], int(np.count_nonzero(part)))

    def error_in(part: NDArray[np.bool_] | None) -> RelativeError | None:
        return None if part is None else error_of(part[warm_up:] & known)

    unrest = _deviation(changes, about_zero=True)
    if static is not None:
        unrest = np.where(static, _deviation(relative), np.float32(np.nan))
    return VideoScore(
        everywhere=error_of(known),
        moving=error_in(video.moving),
        around_moving=error_in(video.around_moving()),
        flicker=None if static is None else _flicker(unrest),
        change=Change.of(changes),
        unrest=unrest,
    )


def _smooth_changes(
    relative: NDArray[np.floating], truth: NDArray[np.float32]
) -> NDArray[np.floating]:
    """Return the changes from frame to frame, NaN where an edge passes: [frames - 1, ...]."""
    smooth = np.abs(np.diff(truth, axis=0)) < _SMOOTH * truth[:-1]
    return np.where(smooth, np.diff(relative, axis=0), np.float32(np.nan))


def _deviation(values: NDArray[np.floating], about_zero: bool = False) -> NDArray[np.float32]:
    """Return the standard deviation over the first axis of what is known; NaN for less than two.

    About zero it is the root mean square, and one value is enough.
    """
    known = np.isfinite(values)
    count = np.count_nonzero(known, axis=0)
    filled = np.where(known, values, 0).astype(np.float64)
    mean = 0.0 if about_zero else filled.sum(axis=0) / np.maximum(count, 1)
    squares = np.where(known, filled - mean, 0) ** 2
    deviation = np.sqrt(squares.sum(axis=0) / np.maximum(count, 1))
    enough = count >= (1 if about_zero else 2)
    return np.where(enough, deviation, np.nan).astype(np.float32)


def _flicker(deviation: NDArray[np.float32]) -> Flicker:
    known = deviation[np.isfinite(deviation)]
    if not known.size:
        return Flicker(float("nan"), float("nan"), 0)
    return Flicker(float(np.median(known)), float(np.mean(known, dtype=np.float64)), known.size)
