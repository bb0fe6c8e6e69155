"""Cards with AprilTags and QR codes before a wall, at known distances."""

import dataclasses
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation.layered import LayeredScene, random_scene
from coded_aperture_ros.simulation.layered.tracing import FINENESS, Layer, prefiltered

TAG, QR = "tag", "qr"
SIZE = (480, 640)
CARDS_M, WALL_M = (0.5, 4.0), (4.0, 4.3)
# Modules of white around a code: a QR code's standard asks for four.
_QUIET = {TAG: 1, QR: 4}
_TAG_MODULES = 8
# A card has a square of so many modules for itself: the largest one fits, however it is turned.
_PITCH_MODULES = 40
_OFF_MIDDLE_MODULES, _LARGEST_ANGLE = 2.0, 0.3
_WHITE, _BLACK = 0.6, 0.04
# Outlines are exact to this part of a canvas pixel.
_FINER = 4
# The wall is drawn as if blurred by this: enough of it lies beside the frame.
_WALL_BLUR_PX = 16.0


@dataclasses.dataclass(frozen=True)
class Card:
    """One code.

    Attributes
    ----------
    kind : {"tag", "qr"}
    says : str
        The tag's number, or the text.
    side_px : float
        Of the code, without the white around it.
    middle_px : (float, float)
        Right, down; the middles of pixels are whole numbers.
    distance_m, angle : float
    """

    kind: str
    says: str
    side_px: float
    middle_px: tuple[float, float]
    distance_m: float
    angle: float

    def corners_px(self, beyond_px: float = 0.0) -> DoubleArray:
        """Return the corners [4, 2] of the code, right and down, in turn from its upper left."""
        half = self.side_px / 2 + beyond_px
        right, down = np.array([[-half, half, half, -half], [-half, -half, half, half]])
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        turned = np.column_stack([cosine * right - sine * down, sine * right + cosine * down])
        return np.asarray(turned + self.middle_px)


@dataclasses.dataclass(frozen=True, eq=False)
class CardScene:
    """Cards and the wall behind them.

    Attributes
    ----------
    cards : tuple of Card
    layers : tuple of Layer
        Nearest first; with inverse distances (1/m) in place of blur sizes.
    """

    cards: tuple[Card, ...]
    layers: tuple[Layer, ...]

    def seen_by(self, camera: Camera) -> LayeredScene:
        """Return the same before a camera, whose frame has `SIZE`."""
        growth = camera.blur_per_dioptre_px
        layers = []
        for layer in self.layers:
            inverse, down, right = layer.blur_px
            size = growth * (1 / camera.focus_distance_m - inverse)
            plane = (size, -growth * down, -growth * right)
            layers.append(dataclasses.replace(layer, blur_px=plane))
        return LayeredScene(tuple(layers), camera)


def pitch_px(module_px: float) -> int:
    """Return the side of the square that a card has for itself."""
    return int(np.ceil(_PITCH_MODULES * module_px))


def card_scene(seed: int, module_px: float) -> CardScene:
    """Return as many cards as fit, half of them tags; the same for the same arguments.

    All modules (the squares that a code is made of) have one size in the picture, at whatever
    distance. Tags, and likewise QR codes, are at random inverse distances, one in each of as many
    equal parts.
    """
    random = np.random.default_rng([7, seed])
    pitch = pitch_px(module_px)
    rows, columns = (length // pitch for length in SIZE)
    places = [(row, column) for row in range(rows) for column in range(columns)]
    kinds = [(TAG, QR)[(row + column) % 2] for row, column in places]
    inverse = np.empty(len(places))
    for kind in (TAG, QR):
        here = np.flatnonzero([each == kind for each in kinds])
        inverse[here] = _spread(random, len(here))
    numbers = random.permutation(len(_dictionary().bytesList))
    found = []
    for index, ((row, column), kind) in enumerate(zip(places, kinds, strict=True)):
        says = str(numbers[index]) if kind == TAG else f"BIN {seed % 100:02d}{index:02d}"
        modules = modules_of(kind, says)
        off = module_px * random.uniform(-_OFF_MIDDLE_MODULES, _OFF_MIDDLE_MODULES, 2)
        right, down = map(float, (np.array([column, row]) + 0.5) * pitch - 0.5 + off)
        side_px = module_px * (len(modules) - 2 * _QUIET[kind])
        angle = random.uniform(-_LARGEST_ANGLE, _LARGEST_ANGLE)
        card = Card(kind, says, side_px, (right, down), float(1 / inverse[index]), angle)
        found.append((card, _layer(card, modules, module_px)))
    nearest_first = [layer for _, layer in sorted(found, key=lambda pair: pair[0].distance_m)]
    return CardScene(tuple(card for card, _ in found), (*nearest_first, *_wall(seed)))


def modules_of(kind: str, says: str) -> BoolArray:
    """Return a code and the white around it, true where it is white."""
    if kind == TAG:
        code = cv2.aruco.generateImageMarker(_dictionary(), int(says), _TAG_MODULES) > 0
    else:
        code = cv2.QRCodeEncoder_create().encode(says) > 0
        dark = np.flatnonzero(~code.all(axis=1))
        inside = slice(dark[0], dark[-1] + 1)  # OpenCV adds some white itself
        code = code[inside, inside]
    return np.pad(code, _QUIET[kind], constant_values=True)


@cache
def _dictionary() -> "cv2.aruco.Dictionary":
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def _spread(random: np.random.Generator, count: int) -> DoubleArray:
    """Return random inverse distances, one in each of equal parts, in random order."""
    nearest, farthest = (1 / distance for distance in CARDS_M)
    share = (random.permutation(count) + random.random(count)) / count
    return np.asarray(farthest + (nearest - farthest) * share)


def _layer(card: Card, modules: BoolArray, module_px: float) -> Layer:
    # The card's corners are at 0.71 of its side from the middle.
    half = int(np.ceil(0.75 * len(modules) * module_px))
    side = 2 * half * FINENESS
    away = (np.arange(side * _FINER) + 0.5) / (FINENESS * _FINER) - half
    y, x = np.meshgrid(away, away, indexing="ij")
    cosine, sine = np.cos(card.angle), np.sin(card.angle)
    row = np.floor((cosine * y - sine * x) / module_px + len(modules) / 2).astype(int)
    column = np.floor((cosine * x + sine * y) / module_px + len(modules) / 2).astype(int)
    inside = (np.minimum(row, column) >= 0) & (np.maximum(row, column) < len(modules))
    light = np.zeros(inside.shape, np.float32)
    light[inside] = np.where(modules[row[inside], column[inside]], _WHITE, _BLACK)
    shining, hiding = (_averaged(part, side) for part in (light, inside))
    # A pixel's first canvas pixel is half of one before its middle.
    left, top = (middle + 0.5 - half for middle in card.middle_px)
    return Layer(top, left, prefiltered(shining), prefiltered(hiding), (1 / card.distance_m, 0, 0))


def _averaged(canvas: NDArray, side: int) -> NDArray[np.float32]:
    mean = cv2.resize(canvas.astype(np.float32), (side, side), interpolation=cv2.INTER_AREA)
    return np.asarray(mean)


def _wall(seed: int) -> tuple[Layer, ...]:
    """Return a random room's planes, all within the distances of the wall."""
    blur = (_WALL_BLUR_PX, _WALL_BLUR_PX + 1)
    room = random_scene(3_000_000 + seed, Mask.named("levin"), "far", SIZE, blur, empty=True)
    nearest, farthest = (1 / distance for distance in WALL_M)
    planes = []
    for layer in room.layers:
        size, down, right = ((nearest - farthest) * part for part in layer.blur_px)
        inverse = nearest + (nearest - farthest) * _WALL_BLUR_PX - size
        planes.append(dataclasses.replace(layer, blur_px=(inverse, -down, -right)))
    return tuple(planes)
