"""Photographs with measured disparity, as scenes of surfaces that occlude each other."""

import dataclasses
import math
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import read_image
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation.layered.scene import LayeredScene
from coded_aperture_ros.simulation.layered.tracing import FINENESS, Layer, prefiltered

# How far a surface goes on behind what is before it, px of the photograph.
_HIDDEN_PX = 16
# So many that steps between them are smaller than those of levels.
_SLICES = 32
_ZOOM = (0.6, 1.3)
_ENLARGED = (0.6, 4.0)
_FOCAL_LENGTH_PX = 600.0
_FOCUS_M = 1.0
# Where the middle of a canvas' first pixel lies, in pixels of the frame.
_FIRST = 0.5 / FINENESS - 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class Slice:
    """What a photograph shows within a range of disparity, and behind what is nearer.

    Attributes
    ----------
    light : ndarray, float32 [rows, columns, 3]
        Linear light; anything where nothing is covered.
    cover : ndarray, bool [rows, columns]
    away : ndarray, float32 [rows, columns]
        From the nearest, 0, to the farthest, 1, linear in inverse depth.
    """

    light: FloatArray
    cover: BoolArray
    away: FloatArray


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """A photograph in slices, nearest first, and where its disparity is known."""

    slices: tuple[Slice, ...]
    known: BoolArray


@lru_cache(maxsize=32)
def load_measured(folder: Path, count: int = _SLICES) -> Measured:
    """Scene of a folder with `sharp_srgb.png` and `disparity.npz`, px, NaN where unknown."""
    light = read_image(folder / "sharp_srgb.png", SRGB)
    with np.load(folder / "disparity.npz") as arrays:
        disparity = np.asarray(arrays["disparity"], np.float32)
    known = np.isfinite(disparity)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    disparity = disparity[tuple(nearest)]
    high, low = np.percentile(disparity, [99.9, 0.1])
    away = np.clip((high - disparity) / (high - low), 0, 1)
    number = np.minimum((away * count).astype(int), count - 1)
    slices = []
    for index in range(count):
        # A pixel that shows something nearer hides what is beside it.
        farther = number >= index
        if not (number == index).any():
            continue
        gap, (rows, columns) = distance_transform_edt(~farther, return_indices=True)
        cover = (number[rows, columns] == index) & (gap <= _HIDDEN_PX)
        slices.append(Slice(light[rows, columns], cover, away[rows, columns]))
    last = slices[-1]
    slices[-1] = dataclasses.replace(last, cover=np.ones_like(last.cover))
    return Measured(tuple(slices), known)


def measured_scene(
    measured: Measured,
    mask: Mask,
    blur_range_px: tuple[float, float],
    shape: tuple[int, int],
    random: np.random.Generator,
    channel: int | None = None,
) -> tuple[LayeredScene, BoolArray]:
    """Part of a photograph, at a random size and angle, before a camera with some range of blur.

    Its light is that of a channel, or a random mixture of all.

    Returns
    -------
    scene : LayeredScene
    known : ndarray, bool [rows, columns]
        Where the truth is.
    """
    near, far = blur_range_px
    margin = int(np.ceil(max(abs(near), abs(far)) / 2)) + 2
    canvas = tuple(FINENESS * (length + 2 * margin) for length in shape)
    turn = _random_turn(measured.known.shape, canvas, random)
    tint = random.dirichlet((4, 4, 4)).astype(np.float32)
    if channel is not None:
        tint = np.eye(3, dtype=np.float32)[channel]
    exposure = np.float32(math.exp(random.uniform(math.log(0.3), math.log(1.0))))

    def turned(values: FloatArray) -> FloatArray:
        return np.asarray(
            cv2.warpAffine(
                values.astype(np.float32),
                turn,
                canvas[::-1],
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REFLECT_101,
            )
        )

    layers = []
    for part in measured.slices:
        cover = prefiltered(turned(part.cover))
        box = cv2.boundingRect((cover > 0).astype(np.uint8))
        left, top, width, height = box
        if not width or not height:
            continue
        here = (slice(top, top + height), slice(left, left + width))
        light = prefiltered(turned(exposure * (part.light @ tint)) * turned(part.cover))
        away = float(part.away[part.cover].mean())
        layers.append(
            Layer(
                top / FINENESS - margin + _FIRST,
                left / FINENESS - margin + _FIRST,
                light[here].copy(),
                cover[here].copy(),
                (near + (far - near) * away, 0.0, 0.0),
            )
        )
    middle = slice(FINENESS * margin, -FINENESS * margin)
    known = turned(measured.known)[middle, middle][::FINENESS, ::FINENESS] > 0.99
    return LayeredScene(tuple(layers), _camera(mask, blur_range_px, shape, random)), known


@lru_cache(maxsize=32)
def _photograph(path: Path) -> FloatArray:
    return np.asarray(read_image(path, SRGB))


def photograph_board(path: Path, board: Layer, random: np.random.Generator) -> Layer:
    """Board with a photograph on it, at a random size and angle, instead of its own texture.

    It may be enlarged to four times its pixels: nothing on it is sharp then.
    """
    picture = _photograph(path)
    tint = random.dirichlet((4, 4, 4)).astype(np.float32)
    exposure = np.float32(math.exp(random.uniform(math.log(0.3), math.log(1.0))))
    zoom = 1 / math.exp(random.uniform(*np.log(_ENLARGED)))
    canvas = board.light.shape
    turned = cv2.warpAffine(
        (exposure * (picture @ tint)).astype(np.float32),
        _random_turn(picture.shape[:2], canvas, random, zoom),
        canvas[::-1],
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT_101,
    )
    light = prefiltered(np.clip(turned, 0, 1).astype(np.float32)) * board.cover
    return dataclasses.replace(board, light=light)


def _random_turn(
    source: tuple[int, ...],
    canvas: tuple[int, ...],
    random: np.random.Generator,
    zoom: float | None = None,
) -> FloatArray:
    """Where in the photograph each place of a canvas lies, as an affine matrix [2, 3]."""
    zoom = (random.uniform(*_ZOOM) if zoom is None else zoom) / FINENESS
    angle = math.pi / 2 * random.integers(4) + random.normal(0, 0.1)
    flip = -1.0 if random.random() < 0.5 else 1.0
    matrix = zoom * np.array(
        [[flip * math.cos(angle), -math.sin(angle)], [flip * math.sin(angle), math.cos(angle)]]
    )
    reach = zoom * max(canvas)
    middle = [
        length / 2 + (random.random() - 0.5) * max(length - reach, 0) for length in source[::-1]
    ]
    shift = np.array(middle) - matrix @ (np.array(canvas[::-1]) / 2)
    return np.column_stack([matrix, shift]).astype(np.float32)


def _camera(
    mask: Mask,
    blur_range_px: tuple[float, float],
    shape: tuple[int, int],
    random: np.random.Generator,
) -> Camera:
    """Camera with these blur sizes, as those of random scenes."""
    near, far = blur_range_px
    infinity = max(far, 1.0) * random.uniform(1.2, 1.8)
    if near < 0:
        infinity = -near * random.uniform(0.3, 1.0)
    return Camera(
        focal_length_px=_FOCAL_LENGTH_PX,
        focus_distance_m=_FOCUS_M,
        image_width=shape[1],
        image_height=shape[0],
        mask=mask,
        mask_extent_mm=infinity * _FOCUS_M / _FOCAL_LENGTH_PX * 1e3,
        side="near" if near < 0 else "far",
    )
