"""Boards that fill the frame, alone or behind a card: what the check of fit learns to let pass."""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
from measured import photograph_board
from scenes import (
    FIRST_BOARD_SHARD,
    FIRST_NEAR_SHARD,
    FIRST_NOISE_SHARD,
    FRAMES_PER_SHARD,
    ScenePlan,
)

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.simulation.layered import LayeredScene
from coded_aperture_ros.simulation.layered.tracing import FINENESS, Layer, prefiltered

_NARROWEST_PX = 1.2
_WIDEST_PX = 21.0
_NEAR_PX = 6.0
# How many boards are soft, and the Gauss filter that they are softened by.
_SOFT_SHARE = 0.7
_PHOTOGRAPH_SHARE = 0.7
_SOFT_PX = (0.3, 2.0)
# Of boards of noise: how many have small blur, are bricks, and stand behind a card.
_NEAR_SHARE = 0.65
_BRICK_SHARE = 0.3
_CARD_SHARE = 0.3
# Exponent of the amplitude of noise: 0 is white, 1.2 that of natural pictures. How much of it is
# white; standard deviation of the light, and its mean.
_SLOPES = (0.3, 1.4)
_WHITE_SHARE = 0.4
_CONTRAST = (0.04, 0.25)
_BRIGHTNESS = (0.3, 0.5)
# Height of bricks, and their joints, px of the frame.
_BRICK_PX = (5.0, 50.0)
_JOINT_PX = (0.7, 3.0)


def shows_boards_only(number: int) -> bool:
    """Whether a frame is one of those that show boards in every case."""
    return number >= FIRST_BOARD_SHARD * FRAMES_PER_SHARD


def board_scene(
    number: int, plan: ScenePlan, scene: LayeredScene, photographs: Path
) -> LayeredScene:
    """The farthest surface of a scene as a board, at one random blur size.

    As where a lens is calibrated: no other surface tells the bank's other levels from beyond.

    Parameters
    ----------
    number : int
        Of the frame, which says what is on the board.
    plan : ScenePlan
    scene : LayeredScene
    photographs : Path
        Folder of PNG files, which may be missing.
    """
    has_noise = number >= FIRST_NOISE_SHARD * FRAMES_PER_SHARD
    random = np.random.default_rng([22, number])
    widest = float(np.nanmax(np.abs(scene.blur_size_px())))
    near = number >= FIRST_NEAR_SHARD * FRAMES_PER_SHARD
    if near and not (has_noise and random.random() > _NEAR_SHARE):
        widest = min(widest, _NEAR_PX)
    size = float(np.exp(random.uniform(*np.log([_NARROWEST_PX, max(widest, 2.0)]))))
    sign = -1.0 if plan.side == "near" else 1.0
    board = dataclasses.replace(scene.layers[-1], blur_px=(sign * size, 0, 0), relief_px=None)
    if has_noise:
        layers: tuple[Layer, ...] = (_with_texture(board, random),)
        if random.random() < _CARD_SHARE:
            layers = (_card(layers[0], sign, random), *layers)
        return LayeredScene(layers, scene.camera)
    if shows_boards_only(number):
        board = _printed(board, sorted(photographs.glob("*.png")), random)
    return LayeredScene((board,), scene.camera)


def _printed(board: Layer, photographs: list[Path], random: np.random.Generator) -> Layer:
    """Board with a photograph on it, or softened, or as it is."""
    if photographs and random.random() < _PHOTOGRAPH_SHARE:
        path = photographs[int(random.integers(len(photographs)))]
        return photograph_board(path, board, random)
    if random.random() > _SOFT_SHARE:
        return board
    sigma = FINENESS * float(np.exp(random.uniform(*np.log(_SOFT_PX))))
    light, cover = (cv2.GaussianBlur(one, (0, 0), sigma) for one in (board.light, board.cover))
    return dataclasses.replace(board, light=light, cover=cover)


def _with_texture(board: Layer, random: np.random.Generator) -> Layer:
    """Board with noise or bricks on it, whose finest structure is about a pixel."""
    shape = board.light.shape
    bricks = random.random() < _BRICK_SHARE
    values = _noise(shape, random)
    if bricks:
        values = _bricks(shape, random) + np.float32(random.uniform(0.1, 0.6)) * values
    values -= values.mean()
    values *= np.exp(random.uniform(*np.log(_CONTRAST))) / values.std()
    light = np.clip(random.uniform(*_BRIGHTNESS) + values, 0, 1).astype(np.float32)
    return dataclasses.replace(board, light=prefiltered(light) * board.cover)


def _noise(shape: tuple[int, ...], random: np.random.Generator) -> FloatArray:
    """Noise with a power-law spectrum or a white one, float32, standard deviation 1."""
    slope = 0.0 if random.random() < _WHITE_SHARE else random.uniform(*_SLOPES)
    rows, columns = (-(-length // FINENESS) for length in shape)
    across, down = np.fft.rfftfreq(columns), np.fft.fftfreq(rows)[:, None]
    frequency = np.hypot(down, across)
    frequency[0, 0] = np.inf if slope else 1.0
    white = np.fft.rfft2(random.standard_normal((rows, columns)))
    noise = np.fft.irfft2(white * frequency**-slope, (rows, columns)).astype(np.float32)
    fine = cv2.resize(noise, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine / fine.std())


def _bricks(shape: tuple[int, ...], random: np.random.Generator) -> FloatArray:
    """Bricks with joints, every one of a tone of its own, a little turned, float32."""
    height, joint = (
        FINENESS * np.exp(random.uniform(*np.log(limits))) for limits in (_BRICK_PX, _JOINT_PX)
    )
    width = height * random.uniform(1, 3.5)
    angle = random.normal(0, 0.1) + np.pi / 2 * (random.random() < 0.2)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    down = x * np.sin(angle) + y * np.cos(angle) + 4 * max(shape)
    right = x * np.cos(angle) - y * np.sin(angle) + 4 * max(shape)
    row = np.floor(down / height)
    right = right + row % 2 * width / 2
    column = np.floor(right / width)
    tones = random.standard_normal(997).astype(np.float32)
    tone = tones[(row * 131 + column * 31).astype(int) % len(tones)]
    in_joint = (down % height < joint) | (right % width < joint)
    return np.where(in_joint, np.float32(random.uniform(-2.5, 2.5)), tone)


def _card(board: Layer, sign: float, random: np.random.Generator) -> Layer:
    """Rectangle before a board, with a texture of its own and another blur size."""
    behind_px = abs(board.blur_px[0])
    factor = random.uniform(1.1, 1.6) if sign < 0 else random.uniform(0.4, 0.9)
    size = sign * float(np.clip(factor * behind_px, _NARROWEST_PX, _WIDEST_PX))
    rows, columns = board.light.shape
    ends = (np.sort(random.uniform(0.15, 0.85, 2)) for _ in range(2))
    (top, bottom), (left, right) = ends
    cover = np.zeros((rows, columns), np.float32)
    cover[int(top * rows) : int(bottom * rows), int(left * columns) : int(right * columns)] = 1
    card = dataclasses.replace(board, cover=prefiltered(cover), blur_px=(size, 0, 0))
    return _with_texture(card, random)
