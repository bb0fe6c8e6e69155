"""Random outlines: mattes of objects that robots meet, at the canvas' resolution."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.simulation.layered.tracing import FINENESS

_SHIFT = 4  # OpenCV's fixed-point coordinates: sixteenths of a canvas pixel


def _fill(canvas: FloatArray, points: NDArray[np.floating]) -> None:
    cv2.fillPoly(canvas, [np.rint(points * 2**_SHIFT).astype(np.int32)], 1.0, cv2.LINE_AA, _SHIFT)


def _stroke(canvas: FloatArray, points: NDArray[np.floating], width: float) -> None:
    """Draw a line of constant width along points [n, 2] (x, y)."""
    along = np.gradient(points, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
    across = along[:, ::-1] * [1, -1] * width / 2
    _fill(canvas, np.concatenate([points + across, (points - across)[::-1]]))


def width_px(random: np.random.Generator) -> float:
    """Width of something thin, on the canvas: 2 to 24 px of the frame."""
    return FINENESS * float(np.exp(random.uniform(np.log(2), np.log(24))))


def _end(random: np.random.Generator, side: int) -> DoubleArray:
    return random.uniform(-0.2, 1.2, 2) * side


def rods(random: np.random.Generator, side: int) -> FloatArray:
    """Draw a few straight rods that cross the picture."""
    canvas = np.zeros((side, side), np.float32)
    for _ in range(random.integers(1, 4)):
        middle = random.uniform(0, side, 2)
        angle = random.choice([0, 1]) * np.pi / 2
        angle += random.normal(0, 0.3)
        half = side * random.uniform(0.15, 0.9)
        step = half * np.array([np.cos(angle), np.sin(angle)])
        _stroke(canvas, np.array([middle - step, middle + step]), width_px(random))
    return canvas


def cables(random: np.random.Generator, side: int) -> FloatArray:
    """Draw sagging or winding cables."""
    canvas = np.zeros((side, side), np.float32)
    for _ in range(random.integers(1, 4)):
        t = np.linspace(0, 1, 40)[:, None]
        start, bend, end = (_end(random, side) for _ in range(3))
        points = (1 - t) ** 2 * start + 2 * t * (1 - t) * bend + t**2 * end
        _stroke(canvas, points, min(width_px(random), 12 * FINENESS))
    return canvas


def net(random: np.random.Generator, side: int) -> FloatArray:
    """Draw a net, a fence or a grating."""
    canvas = np.zeros((side, side), np.float32)
    spacing = FINENESS * random.uniform(14, 60)
    width = FINENESS * random.uniform(1.5, min(spacing / 6, 6))
    angle = random.uniform(0, np.pi)
    for turn in (0, random.uniform(0.8, 1.6))[: random.integers(1, 3)]:
        along = np.array([np.cos(angle + turn), np.sin(angle + turn)])
        for place in np.arange(-side, side, spacing):
            middle = side / 2 + place * along[::-1] * [1, -1]
            _stroke(canvas, np.array([middle - side * along, middle + side * along]), width)
    keep = np.zeros_like(canvas)
    corner = random.uniform(0, 0.5, 2) * side
    size = random.uniform(0.35, 1, 2) * side
    cv2.rectangle(keep, corner.astype(int).tolist(), (corner + size).astype(int).tolist(), 1.0, -1)
    return canvas * keep


def card(random: np.random.Generator, side: int) -> FloatArray:
    """Draw a polygon with three to six corners; mostly a rectangle."""
    canvas = np.zeros((side, side), np.float32)
    centre = random.uniform(0, side, 2)
    size = random.uniform(0.06, 0.5, 2) * side
    corners = 4 if random.random() < 0.7 else int(random.integers(3, 7))
    turn = (np.arange(corners) + 0.5) * 2 * np.pi / corners
    points = np.column_stack([np.cos(turn), np.sin(turn)]) * size
    angle = random.normal(0, 0.15) if random.random() < 0.6 else random.uniform(0, np.pi)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    _fill(canvas, centre + points @ rotation)
    return canvas


def ellipse(random: np.random.Generator, side: int) -> FloatArray:
    """Draw an ellipse of any size."""
    canvas = np.zeros((side, side), np.float32)
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    size = random.uniform(0.02, 0.3, 2) * side
    angle = random.uniform(0, np.pi)
    points = np.column_stack([np.cos(turn), np.sin(turn)]) * size
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    _fill(canvas, random.uniform(0, side, 2) + points @ rotation)
    return canvas


def frame(random: np.random.Generator, side: int) -> FloatArray:
    """Draw a window frame, or a ring: a shape with a hole like it."""
    shape = card if random.random() < 0.7 else ellipse
    outline = shape(random, side)
    thick = max(3, int(width_px(random)))
    return np.asarray(outline - cv2.erode(outline, np.ones((thick, thick), np.uint8)))


def furniture(random: np.random.Generator, side: int) -> FloatArray:
    """Draw something with a seat, a back and thin legs, or a ladder."""
    canvas = np.zeros((side, side), np.float32)
    left, top = random.uniform(-0.1, 0.7, 2) * side
    wide = random.uniform(0.15, 0.45)
    high = random.uniform(0.25, 0.7)
    width = min(width_px(random), 10 * FINENESS)
    lean = random.normal(0, 0.05)

    def bar(x0: float, y0: float, x1: float, y1: float, thick: float) -> None:
        ends = np.array([[x0 + lean * y0, y0], [x1 + lean * y1, y1]])
        _stroke(canvas, ends * [wide * side, high * side] + [left, top], thick)

    if random.random() < 0.3:  # a ladder
        bar(0, 0, 0, 1.5, width)
        bar(1, 0, 1, 1.5, width)
        for y in np.arange(0.05, 1.5, random.uniform(0.1, 0.25)):
            bar(0, y, 1, y, width * 0.8)
        return canvas
    for x in (0, 0.3, 0.75, 1):
        bar(x, 0.5, x + random.normal(0, 0.04), random.uniform(0.9, 1.1), width)
    for x in np.linspace(0, 1, random.integers(2, 7)):
        bar(x, 0, x, 0.5, width * random.uniform(0.5, 1))
    bar(-0.03, 0.5, 1.03, 0.5, width * random.uniform(1, 3))
    bar(0, 0, 1, 0, width * random.uniform(1, 3))
    return canvas


def person(random: np.random.Generator, side: int) -> FloatArray:
    """Draw a standing person: head, trunk, arms and legs."""
    canvas = np.zeros((side, side), np.float32)
    scale = random.uniform(0.25, 0.8) * side
    left, top = random.uniform(0, 0.9, 2) * side - [0, 0.2 * side]

    def limb(x0: float, y0: float, x1: float, y1: float, thick: float) -> None:
        points = np.array([[x0, y0], [x1, y1]]) * scale + [left, top]
        _stroke(canvas, points, thick * scale)

    cv2.circle(
        canvas, (int(left), int(top + 0.09 * scale)), int(0.075 * scale), 1.0, -1, cv2.LINE_AA
    )
    limb(0, 0.12, 0, 0.22, 0.06)
    limb(0, 0.2, random.normal(0, 0.02), 0.56, random.uniform(0.18, 0.26))
    for sign in (-1, 1):
        elbow = sign * random.uniform(0.12, 0.25)
        limb(sign * 0.1, 0.22, elbow, 0.4, 0.055)
        limb(elbow, 0.4, elbow + random.normal(0, 0.07), 0.56, 0.05)
        limb(sign * 0.05, 0.55, sign * random.uniform(0.04, 0.14), 1.0, 0.09)
    return canvas


def blob(random: np.random.Generator, side: int) -> FloatArray:
    """Draw a patch with a rough outline, as of bushes and cloth."""
    small = random.standard_normal((side // 4, side // 4)).astype(np.float32)
    coarse = cv2.GaussianBlur(small, (0, 0), random.uniform(2, 12))
    y, x = np.mgrid[: side // 4, : side // 4] * 4 / side
    centre = random.uniform(0, 1, 2)
    near = -((y - centre[0]) ** 2 + (x - centre[1]) ** 2) / random.uniform(0.01, 0.15)
    shape = coarse / coarse.std() + 2 + near
    return np.clip(cv2.resize(shape.astype(np.float32), (side, side)) * 4 + 0.5, 0, 1)


THINGS: dict[str, Callable[[np.random.Generator, int], FloatArray]] = {
    "rods": rods,
    "cables": cables,
    "net": net,
    "card": card,
    "another card": card,
    "ellipse": ellipse,
    "frame": frame,
    "furniture": furniture,
    "person": person,
    "blob": blob,
}


def leaf(random: np.random.Generator, side: int) -> FloatArray:
    """Draw a single pointed leaf, in the middle."""
    canvas = np.zeros((side, side), np.float32)
    length = side * 0.46
    width = side * random.uniform(0.1, 0.3)
    t = np.linspace(-1, 1, 24)
    bow = width * (1 - t**2) ** random.uniform(0.8, 1.5)
    bend = random.normal(0, 0.1) * side * (1 - t**2)
    points = np.concatenate(
        [np.column_stack([t * length, bow + bend]), np.column_stack([t * length, bend - bow])[::-1]]
    )
    angle = random.uniform(0, 2 * np.pi)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    _fill(canvas, side / 2 + points @ rotation)
    return canvas
