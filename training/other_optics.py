"""Random optics and processing that are neither those of a bank nor of a kind with a name."""

import dataclasses

import cv2
import numpy as np
from coded_aperture_benchmarks.datasets.fitting_frames import Recorded

from coded_aperture_ros.optics import Mask

# Kinds of misfit, and the cause that each is learned as.
OTHER_OPTICS, OTHER_SCALE, OTHER_FILTER = "other optics", "other scale", "other filter"
OTHER_CAUSES = {OTHER_OPTICS: "mask", OTHER_SCALE: "scale", OTHER_FILTER: "processed"}
_SIDE = 44  # cells of a mask that is drawn finely
_TURN_DEG = (12.0, 348.0)
_WAYS = (cv2.INTER_LINEAR, cv2.INTER_CUBIC, cv2.INTER_LANCZOS4, cv2.INTER_NEAREST)
_SCALES = (0.7, 2.0)
_STRETCH = (0.85, 1.18)


def random_optics(own: Mask, random: np.random.Generator) -> Mask:
    """Random grid, the own mask turned or half open, or a few openings."""
    kind = random.integers(4)
    if kind == 0:
        return Mask("grid", _grid(random))
    fine = cv2.resize(own.transmission, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
    if kind == 1:
        return Mask("turned", _turned(fine, random))
    if kind == 2:
        open_share = np.float32(random.uniform(0.3, 0.9))
        square = cv2.GaussianBlur(np.ones_like(fine), (0, 0), random.uniform(0.5, 6.0))
        return Mask("half open", np.clip((1 - open_share) * fine + open_share * square, 0, 1))
    return Mask("openings", _openings(random))


def _grid(random: np.random.Generator) -> np.ndarray:
    side = int(random.integers(3, 15))
    grid = random.random((side, side)) < random.uniform(0.2, 0.7)
    grid[side // 2, side // 2] = True
    if random.random() < 0.3:  # cells that pass part of the light
        return (grid * random.random(grid.shape)).astype(np.float32)
    return grid.astype(np.float32)


def _turned(fine: np.ndarray, random: np.random.Generator) -> np.ndarray:
    if random.random() < 0.5:
        fine = fine[:, ::-1].copy()
    middle = ((_SIDE - 1) / 2,) * 2
    turn = cv2.getRotationMatrix2D(middle, random.uniform(*_TURN_DEG), random.uniform(0.7, 1.0))
    return np.clip(cv2.warpAffine(fine, turn, fine.shape), 0, 1)


def _openings(random: np.random.Generator) -> np.ndarray:
    plate = np.zeros((_SIDE, _SIDE), np.float32)
    for _ in range(int(random.integers(2, 6))):
        centre = random.integers(4, _SIDE - 4, 2).tolist()
        axes = random.integers(2, 14, 2).tolist()
        cv2.ellipse(plate, centre, axes, random.uniform(0, 180), 0, 360, 1.0, -1)
    return plate


def resampled(one: Recorded, random: np.random.Generator) -> Recorded:
    """Frame at another scale, a little stretched and turned, as large as it was."""
    scale = float(np.exp(random.uniform(*np.log(_SCALES))))
    height, width = one.frame.shape
    middle = ((width - 1) / 2, (height - 1) / 2)
    move = cv2.getRotationMatrix2D(middle, random.uniform(-8, 8), scale)
    if random.random() < 0.5:
        move[:, :2] *= [random.uniform(*_STRETCH), 1.0]
    way = int(random.choice(_WAYS))

    def moved(values: np.ndarray, how: int) -> np.ndarray:
        border = cv2.BORDER_REFLECT
        return cv2.warpAffine(values, move, (width, height), flags=how, borderMode=border)

    truth = moved(one.blur_size_px, cv2.INTER_NEAREST)
    return dataclasses.replace(one, frame=moved(one.frame, way), blur_size_px=truth)


def filtered(one: Recorded, random: np.random.Generator) -> Recorded:
    """Frame through a random small kernel, perhaps with noise that was added later."""
    side = int(random.choice([3, 5, 7]))
    kernel = random.random((side, side)) ** random.uniform(0.5, 4)
    if random.random() < 0.4:
        kernel *= random.choice([-0.4, 1.0], kernel.shape, p=[0.35, 0.65])
    kernel[side // 2, side // 2] += random.uniform(0, 0.6) * kernel.size
    frame = cv2.filter2D(one.frame, -1, kernel / max(kernel.sum(), 1.0))
    if random.random() < 0.5:
        noise = random.uniform(3e-4, 3e-3)
        frame = frame + noise * random.standard_normal(frame.shape)
    return dataclasses.replace(one, frame=np.clip(frame, 0, 1).astype(np.float32))
