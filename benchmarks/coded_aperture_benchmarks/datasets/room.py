"""A furnished room in space, and what a camera sees that walks through it.

Layered scenes (`layered`) stand before one camera. Here the camera moves, so everything is made of
textured boards in space, and rays are traced through every opening of the mask.
"""

import dataclasses
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.optics import Camera, Intrinsics, Wavefront
from coded_aperture_ros.simulation.layered.textures import TEXTURE_PX, TEXTURED_COUNT, texture
from coded_aperture_ros.simulation.layered.tracing import compiled, lens_samples

# The room's sides and height; the camera keeps to a ring in its middle.
_ROOM_M = (9.0, 2.6, 8.0)
_RING_M = (2.0, 1.5)
_EYE_M = 1.2
# A walk begins at rest, and has its pace after so many steps.
_STARTING = 10
# Aberrations are those of the middle of squares of so many pixels.
_SQUARE_PX = 4
_LEVELS = 4
_FURNITURE = 24
# Textures have a texel of about this size; most surfaces are neither very plain nor very bright.
_TEXEL_M = (0.002, 0.006)


@dataclasses.dataclass(frozen=True, eq=False)
class Board:
    """A textured parallelogram in space; x to the right, y down, z forward, metres.

    Attributes
    ----------
    corner, right, down : ndarray, float64 [3]
        Where it begins, and its two edges, at right angles.
    texture : int
    tone, contrast : float
        Its light is ``tone * exp(contrast * texture)``.
    texel_m : float
    """

    corner: DoubleArray
    right: DoubleArray
    down: DoubleArray
    texture: int
    tone: float
    contrast: float
    texel_m: float


@dataclasses.dataclass(frozen=True, eq=False)
class Room:
    """Boards, seen from poses ``[4, 4]`` that turn points of a camera into those of the room."""

    boards: tuple[Board, ...]

    def coded(self, camera: Camera, pose: DoubleArray) -> FloatArray:
        """Return the frame that a camera records there, without noise, float32 [rows, columns]."""
        _, depth_m = self.seen(camera, pose)
        blur_px = camera.blur_size_px(depth_m[np.isfinite(depth_m)])
        samples = lens_samples(camera.mask, float(np.abs(blur_px).max(initial=1.0)))
        return self._trace(camera, pose, samples)[0]

    def seen(self, camera: Camera, pose: DoubleArray) -> tuple[FloatArray, FloatArray]:
        """Return the all-in-focus frame and the true depth there, m; NaN where nothing is."""
        light, depth_m = self._trace(camera, pose, np.array([[0, 0, 1]], np.float32))
        return light, np.where(depth_m > 0, depth_m, np.float32(np.nan))

    def _trace(
        self, camera: Camera, pose: DoubleArray, samples: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        turned, place = pose[:3, :3], pose[:3, 3]
        focal_px, _, middle_x, _, _, middle_y, *_ = camera.intrinsics.camera_matrix
        extent_m = 1e-3 * camera.mask_extent_mm
        view, unit_px = camera.intrinsics, camera.blur_per_dioptre_px
        moves = _moves(camera.wavefront, view, unit_px, samples.tobytes())
        farthest_px = float(np.abs(moves[..., :2]).max())
        boards, boxes = [], []
        for board in self.boards:
            corner, right, down = (
                (board.corner - place) @ turned,
                board.right @ turned,
                board.down @ turned,
            )
            normal = np.cross(right, down)
            boards.append(
                np.concatenate([corner, normal, right / (right @ right), down / (down @ down)])
            )
            corners = np.array([corner, corner + right, corner + down, corner + right + down])
            boxes.append(_box(corners, focal_px, (middle_x, middle_y), camera, farthest_px))
        lens = np.array([focal_px, middle_x, middle_y, camera.focus_distance_m, extent_m])
        textures, sides, starts, first = _textures(tuple(board.texture for board in self.boards))
        paint = [
            (
                first[board.texture],
                board.tone,
                board.contrast,
                np.linalg.norm(board.right) / board.texel_m,
                np.linalg.norm(board.down) / board.texel_m,
                board.texel_m,
            )
            for board in self.boards
        ]
        found = compiled("coded_aperture_benchmarks.datasets.room_kernels", "rooms").trace(
            np.array(boards, np.float32),
            np.array(boxes, np.float32),
            np.array(paint, np.float64),
            textures,
            sides,
            starts,
            samples,
            moves,
            _SQUARE_PX,
            lens.astype(np.float32),
            camera.image_height,
            camera.image_width,
        )
        return np.asarray(found[0]), np.asarray(found[1])


@lru_cache(maxsize=1)
def _moves(lens: Wavefront | None, view: Intrinsics, unit_px: float, seen: bytes) -> FloatArray:
    """Return how far aberrations move rays in each square of the image, px, and what passes.

    Of rays through places [n, 3] of the mask, `seen` as bytes: [rows, columns, n, 3], or
    [1, 1, n, 3] where there are none. Light falls off towards the corners as behind the rims.
    """
    samples = np.frombuffer(seen, np.float32).reshape(-1, 3)
    still = np.array([0, 0, 1], np.float32)
    if lens is None or len(samples) == 1:
        return np.tile(still, (1, 1, len(samples), 1))
    shape = -(-view.image_height // _SQUARE_PX), -(-view.image_width // _SQUARE_PX)
    moves, k = np.empty((*shape, len(samples), 3), np.float32), view.camera_matrix
    places = 2 * samples[:, :2].T.astype(np.float64)
    for square in np.ndindex(shape):
        middle = (np.array(square) + 0.5) * _SQUARE_PX - 0.5
        tangent = (middle - [k[5], k[2]]) / [k[4], k[0]]
        moved, passed = lens.trace(places, 0.0, unit_px, tangent)
        moves[square] = np.stack([*moved, passed], axis=1)
    return moves


def random_room(seed: int) -> Room:
    """Return a room with furniture along its walls and some things in its middle."""
    random = np.random.default_rng([11, seed])
    wide, high, deep = _ROOM_M
    boards = list(box_boards(random, np.array([0, high / 2, 0]), _ROOM_M, 0.0))
    for _ in range(_FURNITURE):
        size = random.uniform([0.1, 0.3, 0.1], [1.0, 2.0, 0.7])
        angle = random.uniform(0, 2 * np.pi)
        outer = min(
            (wide / 2 - 0.4) / max(abs(np.cos(angle)), 1e-6),
            (deep / 2 - 0.4) / max(abs(np.sin(angle)), 1e-6),
        )
        away = random.uniform(0.85, 1.0) * outer
        middle = np.array([away * np.cos(angle), high - size[1] / 2, away * np.sin(angle)])
        boards += box_boards(random, middle, size, random.uniform(0, np.pi))
    for _ in range(3):  # in the middle of the ring
        size = random.uniform([0.2, 0.3, 0.2], [0.6, 1.5, 0.6])
        place = random.uniform(-0.4, 0.4, 2)
        middle = np.array([place[0], high - size[1] / 2, place[1]])
        boards += box_boards(random, middle, size, random.uniform(0, np.pi))
    return Room(tuple(boards))


def walk(seed: int, length_m: float, step_m: float) -> DoubleArray:
    """Return poses [n, 4, 4] along a way around the middle of the room.

    The camera looks ahead and to the outside, sways, and goes up and down, as one in a hand does.
    """
    random = np.random.default_rng([12, seed])
    phases = random.uniform(0, 2 * np.pi, 5)
    # Finely, then cut into equal steps.
    turn = np.linspace(0, 2 * np.pi * (1 + length_m / (2 * np.pi * min(_RING_M))), 20_000)
    ring = 1 + 0.08 * np.sin(0.7 * turn + phases[0])
    places = np.column_stack(
        [
            _RING_M[0] * ring * np.cos(turn),
            _ROOM_M[1] - _EYE_M + 0.12 * np.sin(2.3 * turn + phases[1]),
            _RING_M[1] * ring * np.sin(turn),
        ]
    )
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    # From rest: the first steps are small.
    starting = step_m * np.cumsum(np.arange(_STARTING) / _STARTING)
    steady = starting[-1] + step_m * np.arange(1, int((length_m - starting[-1]) / step_m) + 1)
    at = np.interp(np.concatenate([starting, steady]), way, turn)
    count = len(at)
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose, angle in zip(poses, at, strict=True):
        pose[:3, 3] = [np.interp(angle, turn, places[:, axis]) for axis in range(3)]
        outward = np.deg2rad(35 + 10 * np.sin(1.7 * angle + phases[2]))
        yaw = -angle + outward
        pitch = np.deg2rad(6) * np.sin(2.9 * angle + phases[3])
        roll = np.deg2rad(4) * np.sin(2.2 * angle + phases[4])
        pose[:3, :3] = _turned(yaw, pitch, roll)
    return poses


def _turned(yaw: float, pitch: float, roll: float) -> DoubleArray:
    about_y, about_x, about_z = (
        cv2.Rodrigues(np.array(axis, float))[0]
        for axis in ((0, yaw, 0), (pitch, 0, 0), (0, 0, roll))
    )
    return np.asarray(about_y @ about_x @ about_z)


def box_boards(
    random: np.random.Generator, middle: DoubleArray, size: Any, angle: float
) -> list[Board]:
    """Return the six sides of a box that is turned about the vertical axis."""
    turned = _turned(angle, 0, 0)
    edges = [turned[:, axis] * size[axis] for axis in range(3)]
    found = []
    for axis in range(3):
        right, down = (edges[other] for other in range(3) if other != axis)
        for sign in (-1, 1):
            corner = middle + sign * edges[axis] / 2 - right / 2 - down / 2
            found.append(
                Board(
                    corner,
                    right,
                    down,
                    int(random.integers(TEXTURED_COUNT)),
                    float(np.exp(random.uniform(np.log(0.08), np.log(0.35)))),
                    float(random.uniform(0.12, 0.45)),
                    float(random.uniform(*_TEXEL_M)),
                )
            )
    return found


def _box(
    corners: DoubleArray,
    focal_px: float,
    middle: tuple[float, float],
    camera: Camera,
    aberrations_px: float,
) -> tuple[float, float, float, float]:
    """Return the rows and columns between which a board may be seen: first, last, first, last."""
    nearest = corners[:, 2].min()
    if nearest < 0.1:  # partly behind the camera
        return (0, 1e6, 0, 1e6) if corners[:, 2].max() > 0 else (1, 0, 1, 0)
    reach = abs(float(camera.blur_size_px(float(nearest)))) / 2 + 1 + aberrations_px
    x, y = (focal_px * corners[:, axis] / corners[:, 2] + middle[axis] for axis in range(2))
    return y.min() - reach, y.max() + reach, x.min() - reach, x.max() + reach


@lru_cache(maxsize=1)  # they take a third of a gigabyte
def _textures(numbers: tuple[int, ...]) -> tuple[FloatArray, Any, Any, dict[int, int]]:
    """Return all textures in levels of halved size, one after the other, and where they begin."""
    sides = TEXTURE_PX // 2 ** np.arange(_LEVELS)
    starts = np.concatenate([[0], np.cumsum(sides**2)[:-1]])
    length = int(np.sum(sides**2))
    parts: list[FloatArray] = []
    first: dict[int, int] = {}
    for number in dict.fromkeys(numbers):
        first[number] = length * len(first)
        whole = texture(number).astype(np.float32)
        parts += [
            cv2.resize(whole, (int(side),) * 2, interpolation=cv2.INTER_AREA).ravel()
            for side in sides
        ]
    return np.concatenate(parts), sides, starts, first
