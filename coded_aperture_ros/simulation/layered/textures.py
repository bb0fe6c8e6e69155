"""Random textures: procedural ones, and photographs that come inside Python packages.

None of the pictures is one that the benchmarks score on, or that a photograph of the Kodak set
shows.
"""

from collections.abc import Callable
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import scipy.fft
from scipy.spatial import cKDTree

from coded_aperture_ros.core.arrays import FloatArray

# Side of a texture; one is made once and cut from many times.
TEXTURE_PX = 768
TEXTURE_COUNT = 440
# The first so many have texture all over; of the others parts are nearly plain.
TEXTURED_COUNT = 320
_PICTURES = {
    "skimage": (
        "data",
        *("camera.png", "chelsea.png", "coffee.png", "gravel.png", "ihc.png", "retina.jpg"),
        *("moon.png", "page.png", "text.png", "cell.png", "clock_motion.png"),
    ),
    "sklearn": ("datasets/images", "china.jpg"),
    "matplotlib": ("mpl-data/sample_data", "grace_hopper.jpg"),
}


@lru_cache(maxsize=TEXTURE_COUNT)
def texture(number: int) -> FloatArray:
    """Texture by its number: always the same for the same number.

    Parameters
    ----------
    number : int
        In [0, TEXTURE_COUNT).

    Returns
    -------
    ndarray, float16 [TEXTURE_PX, TEXTURE_PX]
        Mean 0, standard deviation 1, cut off at 4.
    """
    random = np.random.default_rng([7, number])
    if number >= TEXTURED_COUNT:
        kinds = list(_PLAIN_KINDS)
        values = _PLAIN_KINDS[kinds[number % len(kinds)]](random)
        return np.clip(_standard(values), -4, 4).astype(np.float16)
    kinds = list(_KINDS)
    values = _KINDS[kinds[number % len(kinds)]](random)
    if random.random() < 0.25:  # two textures at once, one of them faint
        other = _KINDS[kinds[random.integers(len(kinds))]](random)
        values = _standard(values) + random.uniform(0.1, 0.6) * _standard(other)
    if random.random() < 0.7:  # most surfaces are rough when looked at closely
        rough = _standard(_power_law(random, random.uniform(0.5, 2.0)))
        values = _standard(values) + random.uniform(0.1, 0.6) * rough
    return np.clip(_standard(values), -4, 4).astype(np.float16)


def _standard(values: FloatArray) -> FloatArray:
    return (values - values.mean()) / max(float(values.std()), 1e-6)


@lru_cache(maxsize=1)
def _photographs() -> tuple[FloatArray, ...]:
    found = []
    for package, (folder, *names) in _PICTURES.items():
        spec = find_spec(package)
        if spec is None or spec.origin is None:
            continue
        for name in names:
            path = Path(spec.origin).parent / folder / name
            if path.is_file():
                picture = cv2.imdecode(np.frombuffer(_unprofiled(path.read_bytes()), np.uint8), 0)
                found.append((picture.astype(np.float32) / 255) ** np.float32(2.2))
    return tuple(found)


def _unprofiled(png: bytes) -> bytes:
    """Leave out the colour profile, of which libpng would complain on the terminal."""
    start = png.find(b"iCCP") - 4
    if start < 0:
        return png
    return png[:start] + png[start + 12 + int.from_bytes(png[start : start + 4], "big") :]


def _photograph(random: np.random.Generator) -> FloatArray:
    """Cut a square out of a photograph, turned, mirrored, and larger or smaller than it is."""
    pictures = _photographs()
    if not pictures:
        return _noise(random)
    picture = pictures[random.integers(len(pictures))]
    side = int(min(picture.shape) * random.uniform(0.5, 1.0))
    top, left = (random.integers(length - side + 1) for length in picture.shape)
    cut = np.rot90(picture[top : top + side, left : left + side], int(random.integers(4)))
    if random.random() < 0.5:
        cut = cut[:, ::-1]
    # At the resolution of the picture or less, and mirrored to fill the rest.
    size = min(TEXTURE_PX, max(64, int(2 * side * random.uniform(0.4, 1.0))))
    cut = cv2.resize(np.ascontiguousarray(cut), (size, size), interpolation=cv2.INTER_AREA)
    margin = TEXTURE_PX - size
    whole = cv2.copyMakeBorder(cut, 0, margin, 0, margin, cv2.BORDER_REFLECT)
    return np.asarray(whole ** np.float32(random.uniform(0.5, 1.2)))


def _noise(random: np.random.Generator) -> FloatArray:
    """Draw noise with a power-law spectrum, sometimes stretched, or blotches and veins of it."""
    noise = _power_law(random, random.uniform(1.0, 3.4))
    if random.random() < 0.3:
        return np.asarray(np.abs(_standard(noise)) ** random.uniform(0.4, 1.5), np.float32)
    return noise


def _power_law(random: np.random.Generator, slope: float) -> FloatArray:
    shape = (TEXTURE_PX, TEXTURE_PX)
    stretch = np.exp(random.uniform(0, 1.5) * (random.random() < 0.4))
    angle = random.uniform(0, 3)
    rows = np.fft.fftfreq(shape[0])[:, None]
    columns = np.fft.rfftfreq(shape[1])
    along = rows * np.cos(angle) + columns * np.sin(angle)
    across = (columns * np.cos(angle) - rows * np.sin(angle)) * stretch
    amplitude = np.maximum(np.hypot(along, across), 1 / TEXTURE_PX) ** (-slope / 2)
    white = scipy.fft.rfft2(random.standard_normal(shape, dtype=np.float32))
    return np.asarray(scipy.fft.irfft2(white * amplitude.astype(np.float32)), np.float32)


def _dead_leaves(random: np.random.Generator) -> FloatArray:
    """Discs and polygons of all sizes that cover each other."""
    canvas = np.zeros((TEXTURE_PX, TEXTURE_PX), np.float32)
    smallest = random.uniform(3, 12)
    count = 2500
    radii = np.minimum(smallest * (1 - random.random(count)) ** (-1 / 1.8), 160)
    at = random.integers(0, TEXTURE_PX, (count, 2))
    tones = random.random(count)
    corners = random.integers(3, 8)
    for centre, radius, tone in zip(at, np.sort(radii)[::-1], tones, strict=True):
        if corners == 7:
            cv2.circle(canvas, centre.tolist(), int(radius), float(tone), -1, cv2.LINE_AA)
        else:
            turn = random.uniform(0, 2 * np.pi) + np.arange(corners) * 2 * np.pi / corners
            points = centre + radius * np.column_stack([np.cos(turn), np.sin(turn)])
            cv2.fillPoly(canvas, [points.astype(np.int32)], float(tone), cv2.LINE_AA)
    return canvas


def _bricks(random: np.random.Generator) -> FloatArray:
    """Bricks or tiles with joints, every one of a tone of its own."""
    height = random.integers(24, 140)
    width = int(height * random.uniform(1, 3.5))
    joint = max(2, int(height * random.uniform(0.03, 0.15)))
    shift = random.choice([0, width // 2])
    canvas = np.full((TEXTURE_PX, TEXTURE_PX), random.uniform(-2, 2), np.float32)
    for row, top in enumerate(range(0, TEXTURE_PX, height)):
        for left in range(-width - shift * (row % 2), TEXTURE_PX, width):
            area = (
                slice(top, top + height - joint),
                slice(max(left, 0), max(left + width - joint, 0)),
            )
            canvas[area] = random.normal()
    return canvas + random.uniform(0.05, 0.8) * _standard(_noise(random))


def _weave(random: np.random.Generator) -> FloatArray:
    """Crossed stripes that bend a little."""
    y, x = np.mgrid[:TEXTURE_PX, :TEXTURE_PX].astype(np.float32)
    angle = random.uniform(0, np.pi)
    bend = random.uniform(0, 12) * cv2.GaussianBlur(_standard(_noise(random)), (0, 0), 20)
    along = x * np.cos(angle) + y * np.sin(angle) + bend
    across = y * np.cos(angle) - x * np.sin(angle) + bend
    one, two = (2 * np.pi / random.uniform(6, 60) for _ in range(2))
    stripes = np.sin(along * one)
    if random.random() < 0.6:
        stripes = stripes * np.sin(across * two)
    if random.random() < 0.5:
        stripes = np.sign(stripes)
    return np.asarray(stripes + random.uniform(0, 0.7) * _standard(_noise(random)), np.float32)


def _cells(random: np.random.Generator) -> FloatArray:
    """Cells around random points, as of stones or leather, with or without joints."""
    points = random.uniform(0, TEXTURE_PX, (random.integers(60, 1500), 2))
    half = TEXTURE_PX // 2
    at = (np.mgrid[:half, :half].reshape(2, -1).T + 0.5) * 2
    distance, nearest = cKDTree(points).query(at, k=2)
    tones = random.normal(size=len(points))[nearest[:, 0]]
    if random.random() < 0.5:
        gap = distance[:, 1] - distance[:, 0]
        tones = np.where(gap < random.uniform(2, 6), random.uniform(-2, 2), tones)
    small = tones.reshape(half, half).astype(np.float32)
    canvas = cv2.resize(small, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_LINEAR)
    return np.asarray(canvas + random.uniform(0, 0.5) * _standard(_noise(random)))


def _strokes(random: np.random.Generator) -> FloatArray:
    """Draw writing or scribbles on paper."""
    canvas = np.zeros((TEXTURE_PX, TEXTURE_PX), np.float32)
    letters = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789 "
    scale = random.uniform(0.5, 2.5)
    if random.random() < 0.6:
        page = np.zeros(canvas.shape, np.uint8)  # OpenCV 5 writes on bytes only
        for row in range(0, TEXTURE_PX + 30, int(34 * scale)):
            line = "".join(random.choice(list(letters), 60))
            at = (-int(random.integers(50)), row)
            face = int(random.integers(0, 8))
            cv2.putText(page, line, at, face, scale, 1, max(1, int(2 * scale)), cv2.LINE_8)
        canvas[:] = page
    else:
        for _ in range(random.integers(100, 700)):
            start = random.integers(0, TEXTURE_PX, 2)
            end = start + random.normal(0, 70, 2).astype(int)
            tone = float(random.normal())
            width = int(random.integers(1, 8))
            cv2.line(canvas, start.tolist(), end.tolist(), tone, width, cv2.LINE_AA)
    return canvas + random.uniform(0.02, 0.5) * float(canvas.std()) * _standard(_noise(random))


def _grain(random: np.random.Generator) -> FloatArray:
    """Rings of wood."""
    y, x = np.mgrid[:TEXTURE_PX, :TEXTURE_PX].astype(np.float32)
    centre = random.uniform(-600, 1400, 2)
    radius = np.hypot((x - centre[0]) * random.uniform(0.05, 1), y - centre[1])
    radius += random.uniform(4, 40) * cv2.GaussianBlur(_standard(_noise(random)), (0, 0), 12)
    rings = np.sin(radius * 2 * np.pi / random.uniform(8, 60)) ** 3
    return np.asarray(rings + random.uniform(0.1, 0.8) * _standard(_noise(random)), np.float32)


_KINDS: dict[str, Callable[[np.random.Generator], FloatArray]] = {
    "photograph": _photograph,
    "noise": _noise,
    "leaves": _dead_leaves,
    "another photograph": _photograph,
    "bricks": _bricks,
    "weave": _weave,
    "more photographs": _photograph,
    "cells": _cells,
    "strokes": _strokes,
    "grain": _grain,
}


def _checks(random: np.random.Generator) -> FloatArray:
    """Draw a board of two tones, turned and in perspective, with or without a border."""
    cells = int(random.integers(4, 14))
    board = np.indices((cells, cells)).sum(axis=0) % 2
    board = np.kron(board, np.ones((64, 64))).astype(np.float32)
    if random.random() < 0.5:
        board = cv2.copyMakeBorder(board, *[64] * 4, cv2.BORDER_CONSTANT, value=random.random())
    corners = np.array([[0, 0], [0, 1], [1, 1], [1, 0]], np.float32)
    size = random.uniform(0.5, 1.6) * TEXTURE_PX
    turned = cv2.getRotationMatrix2D((0.5, 0.5), random.uniform(0, 360), 1)
    placed = np.column_stack([corners, np.ones(4)]) @ turned.T - 0.5
    placed = (placed + random.uniform(-0.2, 0.2, (4, 2))) * size + TEXTURE_PX / 2
    change = cv2.getPerspectiveTransform(
        corners * (len(board) - 1), np.ascontiguousarray(placed, np.float32)
    )
    canvas = cv2.warpPerspective(
        board,
        change,
        (TEXTURE_PX,) * 2,
        flags=cv2.INTER_AREA,
        borderMode=cv2.BORDER_CONSTANT if random.random() < 0.3 else cv2.BORDER_REFLECT,
        borderValue=random.random(),
    )
    return _nearly_plain(canvas, random)


def _panels(random: np.random.Generator) -> FloatArray:
    """Rectangles of one tone each that cover each other: doors, drawers, posters, windows."""
    canvas = np.full((TEXTURE_PX, TEXTURE_PX), random.random(), np.float32)
    for _ in range(random.integers(3, 30)):
        top, left = random.integers(-100, TEXTURE_PX, 2)
        rows, columns = np.exp(random.uniform(np.log(20), np.log(500), 2)).astype(int)
        area = slice(max(top, 0), top + rows), slice(max(left, 0), left + columns)
        canvas[area] = random.random()
    return _nearly_plain(canvas, random)


def _signs(random: np.random.Generator) -> FloatArray:
    """Large letters and bold outlines on plain ground."""
    page = np.zeros((TEXTURE_PX, TEXTURE_PX), np.uint8)
    for _ in range(random.integers(2, 14)):
        at = random.integers(0, TEXTURE_PX, 2).tolist()
        thick = int(random.integers(3, 40))
        tone = int(random.integers(80, 256))
        if random.random() < 0.5:
            scale = float(random.uniform(2, 9))
            letter = chr(int(random.integers(ord("A"), ord("Z") + 1)))
            cv2.putText(page, letter, at, 0, scale, tone, thick, cv2.LINE_8)
        elif random.random() < 0.5:
            filled = random.random() < 0.4
            cv2.circle(page, at, int(random.integers(20, 200)), tone, -1 if filled else thick)
        else:
            end = random.integers(0, TEXTURE_PX, 2).tolist()
            cv2.line(page, at, end, tone, thick)
    return _nearly_plain(np.asarray(page / 255, np.float32), random)


def _nearly_plain(canvas: FloatArray, random: np.random.Generator) -> FloatArray:
    """Give a picture of plain parts next to no texture of their own, in places none."""
    if random.random() < 0.5:
        canvas = 1 - canvas
    canvas = cv2.GaussianBlur(canvas, (0, 0), float(random.uniform(0.5, 1.5)))
    rough = float(np.exp(random.uniform(np.log(0.005), np.log(0.15))))
    uneven = np.clip(_standard(_power_law(random, 3.0)) + random.uniform(-1, 1), 0, 2)
    own = _standard(_power_law(random, random.uniform(0.5, 2.5)))
    return np.asarray(_standard(canvas) + rough * uneven * own, np.float32)


_PLAIN_KINDS: dict[str, Callable[[np.random.Generator], FloatArray]] = {
    "checks": _checks,
    "panels": _panels,
    "signs": _signs,
    "more checks": _checks,
}
