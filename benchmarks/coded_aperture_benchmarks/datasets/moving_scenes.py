"""Scenes with an object that moves during the exposure, simulated, with their truth."""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.datasets.moving_frame import (
    MovingFrame,
    MovingObject,
    render_moving_frame,
)
from coded_aperture_benchmarks.datasets.textures import TEST_PICTURES, load_textures
from coded_aperture_benchmarks.thesis.stair import with_noise
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.depth import DepthEstimate
from coded_aperture_ros.optics import Camera, Mask, PsfStack

# Rows and columns of the frames, and of the object in their middle.
FRAME_PX = (288, 384)
OBJECT_PX = (160, 208)
# Blur sizes of the mask from 3 to 20 px between these depths.
NEAR_M, FAR_M = 2.1, 5.1
_OBJECT_M, _SCENE_M = 2.5, 4.2
# Pictures of the scene and of the object, and the object's way during the exposure, px.
SCENES: tuple[tuple[str, str, tuple[float, float]], ...] = (
    ("astronaut", "grass", (12.0, 0.0)),
    ("motorcycle_left", "astronaut", (6.0, 6.0)),
    ("grass", "motorcycle_left", (-4.0, 9.0)),
    ("coins", "grass", (0.0, 12.0)),
    ("motorcycle_left", "coins", (5.0, -2.0)),
    ("astronaut", "motorcycle_left", (9.0, -4.0)),
)
# Half a window: nearer to the object's edge, windows see both, px.
_EDGE_PX = 24
# What lies beyond the frame is not known to the simulator, px.
_BORDER_PX = 16


def scene_camera(mask: Mask) -> Camera:
    """Return the camera that sees the scenes."""
    return Camera(
        focal_length_px=1194.0,
        focus_distance_m=1.9,
        image_width=FRAME_PX[1],
        image_height=FRAME_PX[0],
        mask=mask,
        mask_extent_mm=52.0,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class MovingScene:
    """A coded frame with noise, and what is true of it.

    Attributes
    ----------
    coded : ndarray, float32 [rows, columns]
    on_object, on_scene : ndarray of bool [rows, columns]
        Which pixels are scored as the one and as the other.
    """

    name: str
    coded: NDArray[np.float32]
    truth: MovingFrame
    on_object: NDArray[np.bool_]
    on_scene: NDArray[np.bool_]


def make_moving_scenes(
    mask: Mask, sigma: float, seed: int = 0, which: Sequence[int] = range(len(SCENES))
) -> list[MovingScene]:
    """Render scenes in which an object moves along a line, in front of one that stands still.

    Parameters
    ----------
    sigma : float
        Noise behind an open aperture; divided by the mask's open fraction.
    seed : int, optional
        Of the noise.
    which : sequence of int, optional
        Indices into `SCENES`.
    """
    pictures = dict(zip(TEST_PICTURES, load_textures("natural").pictures, strict=True))
    camera, (rows, columns) = scene_camera(mask), FRAME_PX
    covered = np.zeros(FRAME_PX, bool)
    top, left = (rows - OBJECT_PX[0]) // 2, (columns - OBJECT_PX[1]) // 2
    covered[top : top + OBJECT_PX[0], left : left + OBJECT_PX[1]] = True
    scenes = []
    for number in which:
        behind, before, motion = SCENES[number]
        static, moving = (_middle(pictures[name]) for name in (behind, before))
        object_depth, depth = (np.full(FRAME_PX, metres) for metres in (_OBJECT_M, _SCENE_M))
        truth = render_moving_frame(
            static, depth, [MovingObject(moving, object_depth, covered, motion)], camera
        )
        coded, _ = with_noise(truth.coded, mask, sigma, seed + number)
        far, near = (_distance(where) > _EDGE_PX for where in (~covered, covered))
        inside = np.zeros(FRAME_PX, bool)
        inside[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = True
        scenes.append(
            MovingScene(f"{before} before {behind}", coded, truth, near & inside, far & inside)
        )
    return scenes


def depth_error(estimate: DepthEstimate, scene: MovingScene) -> dict[str, float]:
    """Return the relative error of depth: mean and median on the object and on the scene."""
    assert estimate.depth_m is not None  # the camera says how far the levels are
    error = np.abs(estimate.depth_m - scene.truth.depth_m) / scene.truth.depth_m
    return {
        f"{kind}_{where}": float(take(error[pixels]))
        for where, pixels in (("object", scene.on_object), ("scene", scene.on_scene))
        for kind, take in (("mean", np.mean), ("median", np.median))
    }


def motion_error_px(motion_px: NDArray[np.float32], scene: MovingScene) -> dict[str, float]:
    """Return the mean distance of the motion from the true one, whichever way round, px."""
    true = scene.truth.motion_px
    error = np.minimum(
        *(np.hypot(*np.moveaxis(motion_px + sign * true, -1, 0)) for sign in (1, -1))
    )
    return {
        "motion_object": float(error[scene.on_object].mean()),
        "motion_scene": float(error[scene.on_scene].mean()),
    }


def _middle(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    rows, columns = FRAME_PX
    top, left = (picture.shape[0] - rows) // 2, (picture.shape[1] - columns) // 2
    return picture[top : top + rows, left : left + columns]


def _distance(where: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return how far every pixel is from the nearest one that is not in a region."""
    return np.asarray(cv2.distanceTransform(where.astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def deblurred(
    config: DeblurConfig,
    stack: PsfStack,
    camera: Camera,
    scene: MovingScene,
    alone: DepthEstimate,
    together: DepthEstimate,
) -> dict[str, dict[str, float]]:
    """Deblur a scene by defocus alone and by both, with true and with estimated maps.

    Parameters
    ----------
    config : DeblurConfig
        With method `cg` or `sparse`, and without occlusion, so that only the motion differs.
    alone, together : DepthEstimate
        Estimated by defocus alone, and by defocus and motion.

    Returns
    -------
    dict of dict
        Peak signal-to-noise ratio on `object` and `scene`, dB, of each result.
    """
    deblurrer = Deblurrer(stack, config)
    coded, truth = scene.coded, scene.truth
    blur = camera.blur_size_px(truth.depth_m).astype(np.float32)
    results = {
        "coded": coded,
        "defocus, true": deblurrer.deblur(coded, blur),
        "motion, true": deblurrer.deblur(coded, blur, motion_px=truth.motion_px),
        "defocus": deblurrer.deblur(coded, alone.blur_size_px),
        "motion": deblurrer.deblur(
            coded, together.blur_size_px, motion_px=together.values("motion")
        ),
    }
    return {
        name: {
            where: float(-10 * np.log10(np.mean((sharp - truth.sharp)[pixels] ** 2)))
            for where, pixels in (("object", scene.on_object), ("scene", scene.on_scene))
        }
        for name, sharp in results.items()
    }
