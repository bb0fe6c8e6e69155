"""A random scene: planes of a room, and things before them, each a layer of its own."""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation.layered.shapes import THINGS, leaf, net
from coded_aperture_ros.simulation.layered.textures import TEXTURE_COUNT, TEXTURE_PX, texture
from coded_aperture_ros.simulation.layered.tracing import (
    FEWEST_CELLS,
    FINENESS,
    Layer,
    lens_samples,
    prefiltered,
    seen_from_centre,
    traced,
)

SIDES = ("far", "near", "both")
FENCES = ("net", "leaves", "pane")
_LARGEST_PX = 19.5
_FOCAL_LENGTH_PX = 600.0
_FOCUS_M = 1.0
# How much nearer a fence is than what is behind it, and the sides of leaves that let light pass.
_FENCE_APART_PX, _LEAVES_PX = 2.0, (10, 36)
_AROUND = (1, 1, 1, 1, cv2.BORDER_CONSTANT)


@dataclasses.dataclass(frozen=True, eq=False)
class LayeredScene:
    """A scene of layers, nearest first, before a camera.

    Attributes
    ----------
    layers : tuple of Layer
        The last ones fill the frame.
    camera : Camera
        Its mask, and blur sizes as of the layers; image size as of the frame.
    """

    layers: tuple[Layer, ...]
    camera: Camera

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame."""
        return self.camera.image_height, self.camera.image_width

    def coded(self, mask: Mask | None = None, fewest_cells: int = FEWEST_CELLS) -> FloatArray:
        """Return the frame that the camera records, without noise, float32 [rows, columns].

        Another `mask` may stand in for the camera's; see `lens_samples` for `fewest_cells`.
        """
        samples = lens_samples(mask or self.camera.mask, self._widest_px(), fewest_cells)
        return traced(list(self.layers), self.shape, samples)

    def all_in_focus(self) -> FloatArray:
        """Return the frame through the middle of the aperture alone, float32 [rows, columns]."""
        return traced(list(self.layers), self.shape, np.array([[0, 0, 1]], np.float32))

    def blur_size_px(self) -> FloatArray:
        """Return the signed blur size of what every pixel shows, float32 [rows, columns]."""
        return seen_from_centre(list(self.layers), self.shape)

    def depth_m(self) -> FloatArray:
        """Return the depth of what every pixel shows, float32 [rows, columns]."""
        return np.asarray(self.camera.depth_m(self.blur_size_px()), np.float32)

    def refocused(self, focus_m: float) -> "LayeredScene":
        """Return the scene before the same lens, focused at another distance without breathing.

        Blur sizes are linear in the inverse of the depth, whatever the focus.
        """
        camera = dataclasses.replace(self.camera, focus_distance_m=focus_m, side="both")
        more = camera.blur_at_infinity_px - self.camera.blur_at_infinity_px
        layers = (
            dataclasses.replace(layer, blur_px=(layer.blur_px[0] + more, *layer.blur_px[1:]))
            for layer in self.layers
        )
        return LayeredScene(tuple(layers), camera)

    def _widest_px(self) -> float:
        return float(np.nanmax(np.abs(self.blur_size_px())))


def random_scene(
    seed: int,
    mask: Mask,
    side: str = "far",
    shape: tuple[int, int] = (288, 288),
    blur_range_px: tuple[float, float] | None = None,
    empty: bool = False,
) -> LayeredScene:
    """Return a random scene; the same for the same arguments.

    Parameters
    ----------
    seed : int
        At least 0.
    mask : Mask
        Of the camera.
    side : {"far", "near", "both"}
        Of the focal plane.
    shape : (int, int)
        Rows and columns of the frame.
    blur_range_px : (float, float) or None
        Signed blur sizes of the nearest and the farthest surface. None: random ones.
    empty : bool
        Only the room, and nothing in it.
    """
    random = np.random.default_rng([seed, SIDES.index(side)])
    draw, camera = _drawing(random, mask, side, shape, blur_range_px)
    things = () if empty else draw.things()
    return LayeredScene((*things, *draw.room(things)), camera)


def rod_scene(
    seed: int,
    mask: Mask,
    widths_px: Sequence[float],
    side: str = "far",
    shape: tuple[int, int] = (288, 288),
) -> tuple[LayeredScene, NDArray[np.int32]]:
    """Return a scene of rods of known widths before a room, and which of them each pixel shows.

    Parameters
    ----------
    seed, mask, side, shape
        As of `random_scene`.
    widths_px : sequence of float
        Of the rods, in pixels of the frame. The rods stand or lie side by side in random order.

    Returns
    -------
    scene : LayeredScene
    labels : ndarray, int32 [rows, columns]
        1 for the first width's rod, and so on; 0 where none is seen.
    """
    random = np.random.default_rng([seed, SIDES.index(side), len(widths_px)])
    draw, camera = _drawing(random, mask, side, shape)
    room = draw.room(())
    rods = draw.rods(widths_px, seen_from_centre(list(room), shape))
    order = sorted(range(len(rods)), key=lambda index: rods[index][0])
    layers = (*(rods[index][1] for index in order), *room)
    # The same scene once more, with numbers for blur sizes.
    numbers = [float(index + 1) for index in order] + [0.0] * len(room)
    numbered = [
        dataclasses.replace(layer, blur_px=(number, 0.0, 0.0), relief_px=None)
        for layer, number in zip(layers, numbers, strict=True)
    ]
    labels = np.rint(seen_from_centre(numbered, shape)).astype(np.int32)
    return LayeredScene(layers, camera), labels


@dataclasses.dataclass(frozen=True, eq=False)
class Fenced:
    """A scene seen through something that lets part of the view pass.

    Attributes
    ----------
    scene : LayeredScene
    cover : ndarray, float32 [rows, columns]
        Share of each pixel that the nearer surface takes, 0 to 1.
    near_px, behind_px : ndarray, float32 [rows, columns]
        Signed blur sizes of the nearer surface, wherever it may be, and of the room behind.
    """

    scene: LayeredScene
    cover: FloatArray
    near_px: FloatArray
    behind_px: FloatArray


def fenced_scene(
    seed: int, mask: Mask, kind: str = "net", side: str = "far", shape: tuple[int, int] = (288, 288)
) -> Fenced:
    """Return a room behind a net, foliage or a pane that shines; the same for the same arguments.

    Parameters
    ----------
    seed, mask, shape
        As of `random_scene`.
    kind : {"net", "leaves", "pane"}
        A net, fence or grating; leaves side by side; or glass that reflects, or a thin curtain.
    side : {"far", "near"}
        Of the focal plane.
    """
    random = np.random.default_rng([seed, SIDES.index(side), FENCES.index(kind), 3])
    while True:
        draw, camera = _drawing(random, mask, side, shape, _apart(random, side))
        room = draw.room(())
        behind = seen_from_centre(list(room), shape)
        # A floor or a wall beside may leave no place before it.
        if behind.min() >= draw.nearest + _FENCE_APART_PX:
            break
    layers, cover, near = draw.fence(kind, room, float(behind.min()) - _FENCE_APART_PX)
    return Fenced(LayeredScene((*layers, *room), camera), cover, near, behind)


def _apart(random: np.random.Generator, side: str) -> tuple[float, float]:
    """Return a range of blur sizes with room for something before the room."""
    wide, narrow = random.uniform(7, _LARGEST_PX), random.uniform(0.1, 0.55)
    near, far = max(narrow * wide, 0.9), wide
    return (near, far) if side == "far" else (-far, -near)


def _drawing(
    random: np.random.Generator,
    mask: Mask,
    side: str,
    shape: tuple[int, int],
    blur_range_px: tuple[float, float] | None = None,
) -> "tuple[_Drawing, Camera]":
    """Return what draws a scene of these blur sizes, or of random ones, and its camera."""
    nearest, farthest = blur_range_px or _blur_range(random, side)
    # What is farther away than all of the scene: blur sizes end at that of infinity.
    infinity = max(farthest, 1.0) * random.uniform(1.2, 1.8)
    if side == "near":
        infinity = -nearest * random.uniform(0.3, 1.0)
    camera = Camera(
        focal_length_px=_FOCAL_LENGTH_PX,
        focus_distance_m=_FOCUS_M,
        image_width=shape[1],
        image_height=shape[0],
        mask=mask,
        mask_extent_mm=infinity * _FOCUS_M / _FOCAL_LENGTH_PX * 1e3,
        side=side,
    )
    widest = max(abs(nearest), abs(farthest))
    margin = int(np.ceil(widest / 2)) + 2
    return _Drawing(random, shape, margin, (nearest, farthest)), camera


def _blur_range(random: np.random.Generator, side: str) -> tuple[float, float]:
    """Return the blur sizes of the nearest and the farthest surface."""
    if side == "both":
        return random.uniform(-15, -2), random.uniform(2, 15)
    far = random.uniform(6, _LARGEST_PX)
    # Mostly deep scenes, where near things stand out; some shallow ones.
    near = random.uniform(1.0, (0.5 if random.random() < 0.75 else 0.85) * far)
    return (near, far) if side == "far" else (-far, -near)


class _Drawing:
    """Draws one scene's layers; holds what they have in common."""

    def __init__(
        self,
        random: np.random.Generator,
        shape: tuple[int, int],
        margin_px: int,
        blur_range_px: tuple[float, float],
    ) -> None:
        self.random, self.shape, self.margin = random, shape, margin_px
        self.nearest, self.farthest = blur_range_px
        self.canvas = tuple(FINENESS * (length + 2 * margin_px) for length in shape)
        self.exposure = float(np.exp(random.uniform(np.log(0.06), np.log(0.4))))
        # How much the scene's textures vary, and how sharp they are.
        self.contrast = float(np.exp(random.uniform(np.log(0.12), np.log(0.6))))
        self.softness = random.uniform(0, 1.0) if random.random() < 0.3 else 0.0

    def things(self) -> tuple[Layer, ...]:
        """Return what stands, hangs and grows before the room, nearest first."""
        random = self.random
        found: list[tuple[float, FloatArray | None]] = []
        names = list(THINGS)
        for _ in range(int(random.integers(1, 11))):
            name = names[random.integers(len(names))]
            found.append((self._place(), self._thing(name)))
        if random.random() < 0.3:
            near, far = sorted(self._place() for _ in range(2))
            for _ in range(int(random.integers(5, 45))):
                found.append((random.uniform(near, far), None))
        layers = []
        for blur, matte in sorted(found, key=lambda pair: pair[0]):
            layer = self._leaf(blur) if matte is None else self._layer(matte, blur)
            if layer is not None:
                layers.append(layer)
        return tuple(layers)

    def rods(self, widths_px: Sequence[float], behind_px: FloatArray) -> list[tuple[float, Layer]]:
        """Return rods side by side before what is behind: how far away each is, and its layer."""
        random, rows, columns = self.random, *self.canvas
        y, x = np.mgrid[:rows, :columns].astype(np.float32)
        standing = random.random() < 0.6
        across, along = (x, y) if standing else (y, x)
        spacing = FINENESS * self.shape[int(standing)] / len(widths_px)
        places = random.permutation(len(widths_px)) + random.uniform(0.4, 0.6, len(widths_px))
        found = []
        for place, width in zip(places * spacing, widths_px, strict=True):
            lean = random.uniform(-0.3, 0.3) * spacing / along.max()
            middle = place + FINENESS * self.margin + lean * (along - along.max() / 2)
            away = np.abs(across - middle) / np.hypot(1, lean)
            # Exact to a fraction of a pixel: the width matters.
            matte = np.clip(FINENESS * width / 2 - away + 0.5, 0, 1)
            inside = slice(FINENESS * self.margin, -FINENESS * self.margin or None, FINENESS)
            covered = behind_px[matte[inside, inside] > 0.5]
            limit = float(covered.min()) if covered.size else self.farthest
            limit -= 0.15 * (self.farthest - self.nearest)
            blur = random.uniform(self.nearest, max(limit, self.nearest))
            layer = self._layer(matte, blur)
            if layer is None:
                raise InputError(f"no rod of {width:g} px can be drawn: use 1 px or more")
            found.append((blur, layer))
        return found

    def fence(
        self, kind: str, room: tuple[Layer, ...], farthest: float
    ) -> tuple[tuple[Layer, ...], FloatArray, FloatArray]:
        """Return what part of the room is seen through: its share of pixels, and its blur size."""
        random = self.random
        blur = random.uniform(self.nearest, farthest)
        if kind == "leaves":
            band = min(0.5, farthest - blur)
            places = np.sort(random.uniform(blur, blur + band, int(random.integers(60, 200))))
            grown = [self._leaf(float(place), _LEAVES_PX) for place in places]
            layers = tuple(layer for layer in grown if layer is not None)
            near = np.full(self.shape, blur + band / 2, np.float32)
        else:
            matte = net(random, max(self.canvas))[: self.canvas[0], : self.canvas[1]]
            if kind == "pane":
                matte = np.full(self.canvas, random.uniform(0.25, 0.65), np.float32)
            slant = random.uniform(-1, 1, 2) * (farthest - blur) / sum(self.shape)
            slant *= random.random() < 0.4
            middle = np.array(self.shape) / 2
            plane = (blur - float(slant @ middle), *slant)
            layers = (self._drawn(matte, self._light(matte.shape), plane, 0, 0),)
            y, x = np.mgrid[: self.shape[0], : self.shape[1]].astype(np.float32)
            near = (plane[0] + slant[0] * y + slant[1] * x).astype(np.float32)
        # What is in front shines, what is behind does not.
        shining = [dataclasses.replace(layer, light=layer.cover) for layer in layers]
        black = [dataclasses.replace(layer, light=0 * layer.light) for layer in room]
        cover = traced([*shining, *black], self.shape, np.array([[0, 0, 1]], np.float32))
        return layers, np.clip(cover, 0, 1), near

    def room(self, things: tuple[Layer, ...]) -> tuple[Layer, ...]:
        """Return the planes behind all things: the nearest of them is seen at every pixel."""
        random, rows, columns = self.random, *self.canvas
        y, x = np.mgrid[:rows, :columns].astype(np.float32) / FINENESS - self.margin
        span = self.farthest - self.nearest
        height, width = self.shape
        planes = [self._wall(span)]
        if random.random() < 0.5:  # a floor, seen from above: nearer below
            horizon = random.uniform(-0.3, 0.7) * height
            slope = -random.uniform(0.5, 1.0) * span / max(height - horizon, 1)
            planes.append((self.farthest - slope * horizon, slope, random.normal(0, 0.05) * slope))
        for edge in (0, width):  # walls beside
            if random.random() < 0.25:
                middle = random.uniform(0.2, 0.8) * width
                slope = -random.uniform(0.4, 1.0) * span / (edge - middle)
                planes.append((self.farthest - slope * middle, 0.0, slope))
        sizes = [base + down * y + right * x for base, down, right in planes]
        first = np.argmin(sizes, axis=0)
        shadow = self._shadow(things)
        layers = []
        for index, plane in enumerate(planes):
            matte = (first == index).astype(np.float32)
            if matte.any():
                if index == 0:
                    matte[:] = 1  # behind the others, so that no light is missing at seams
                layers.append(self._drawn(matte, self._light(matte.shape) * shadow, plane, 0, 0))
        return tuple(layers[::-1])

    def _wall(self, span: float) -> tuple[float, float, float]:
        """Return the plane that ends the scene: often slanted, and as far as the range goes."""
        random = self.random
        slant = random.uniform(-1, 1, 2) * (0.5 * span if random.random() < 0.5 else 0.02 * span)
        down, right = slant / self.shape
        highest = max(0, down * self.shape[0]) + max(0, right * self.shape[1])
        return self.farthest - highest, down, right

    def _place(self) -> float:
        """Return the blur size of a thing: more of them are near than far."""
        return float(self.nearest + (self.farthest - self.nearest) * self.random.random() ** 1.6)

    def _thing(self, name: str) -> FloatArray:
        side = max(self.canvas)
        return THINGS[name](self.random, side)[: self.canvas[0], : self.canvas[1]]

    def _layer(self, matte: FloatArray, blur: float) -> Layer | None:
        random = self.random
        rows, columns = np.flatnonzero(matte.any(axis=1)), np.flatnonzero(matte.any(axis=0))
        if rows.size < 3 or columns.size < 3:
            return None
        top, left = rows[0], columns[0]
        matte = matte[top : rows[-1] + 1, left : columns[-1] + 1]
        size = np.array(matte.shape) / FINENESS
        slant = np.zeros(2)
        if random.random() < 0.4:
            room = min(blur - self.nearest, self.farthest - blur)
            slant = random.uniform(-1, 1, 2) * room / size.sum()
        y, x = top / FINENESS - self.margin, left / FINENESS - self.margin
        middle = y + size[0] / 2, x + size[1] / 2
        base = blur - slant[0] * middle[0] - slant[1] * middle[1]
        relief = None
        if random.random() < 0.25:  # round: nearer in the middle
            inside = cv2.distanceTransform((matte > 0.5).astype(np.uint8), cv2.DIST_L2, 3)
            deepest = max(float(inside.max()), 1)
            bulge = np.sqrt(np.maximum(1 - (1 - inside / deepest) ** 2, 0))
            relief = -random.uniform(0, 0.25) * (blur - self.nearest) * bulge.astype(np.float32)
        light = self._light(matte.shape)
        return self._drawn(matte, light, (base, *slant), int(top), int(left), relief)

    def _leaf(self, blur: float, sides_px: tuple[int, int] = (10, 70)) -> Layer | None:
        random = self.random
        side = FINENESS * int(np.exp(random.uniform(*np.log(sides_px))))
        matte = leaf(random, side)
        top, left = (int(random.integers(-side // 2, length)) for length in self.canvas)
        slant = random.uniform(-1, 1, 2) * min(1.5, self.farthest - blur) * FINENESS / side
        middle = np.array([top, left]) / FINENESS - self.margin + side / FINENESS / 2
        base = blur - float(slant @ middle)
        return self._drawn(matte, self._light(matte.shape), (base, *slant), top, left)

    def _drawn(
        self,
        matte: FloatArray,
        light: FloatArray,
        plane: tuple[float, ...],
        top: int,
        left: int,
        relief: FloatArray | None = None,
    ) -> Layer:
        base, down, right = map(float, plane)
        # Half a pixel of nothing around it, as a pixel on the outline is covered in part.
        shining, hiding = (cv2.copyMakeBorder(part, *_AROUND) for part in (light * matte, matte))
        if relief is not None:
            relief = cv2.copyMakeBorder(relief, *_AROUND[:4], cv2.BORDER_REPLICATE)
        # Means over pixels begin at canvas pixels, half of one before the pixel's middle.
        y, x = ((value - 1) / FINENESS - self.margin for value in (top, left))
        return Layer(y, x, prefiltered(shining), prefiltered(hiding), (base, down, right), relief)

    def _light(self, shape: tuple[int, ...]) -> FloatArray:
        """Return a textured surface's light: tone, contrast, shading."""
        random = self.random
        rows, columns = shape
        whole = texture(int(random.integers(TEXTURE_COUNT)))
        scale = max(rows, columns) / TEXTURE_PX
        if scale > 1:  # larger than a texture: mirrored
            margin = max(rows, columns) - TEXTURE_PX
            whole = np.pad(whole, ((0, margin), (0, margin)), mode="reflect")
        top, left = (int(random.integers(len(whole) - length + 1)) for length in shape)
        cut = np.asarray(whole[top : top + rows, left : left + columns], np.float32)
        cut = np.ascontiguousarray(np.flip(cut, tuple(np.flatnonzero(random.random(2) < 0.5))))
        if self.softness > 0:
            cut = cv2.GaussianBlur(cut, (0, 0), FINENESS * self.softness)
        contrast = self.contrast * float(np.exp(random.normal(0, 0.5)))
        if random.random() < 0.15:  # painted
            contrast *= random.uniform(0.05, 0.3)
        tone = self.exposure * float(np.exp(random.normal(0, 0.5)))
        light = tone * np.exp(np.clip(contrast * cut, -2.5, 1.5))
        light *= self._shading(shape)
        return np.clip(light, 0.002, 0.9).astype(np.float32)

    def _shading(self, shape: tuple[int, ...]) -> FloatArray:
        """Return smooth light and shade."""
        random = self.random
        coarse = random.normal(0, random.uniform(0, 0.35), (3, 3)).astype(np.float32)
        return np.exp(cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC))

    def _shadow(self, things: tuple[Layer, ...]) -> FloatArray:
        """Return the shadows that some things cast on the room."""
        random = self.random
        shadow = np.ones(self.canvas, np.float32)
        shift = random.normal(0, 40, 2).astype(int)
        for layer in things:
            if random.random() < 0.4:
                top, left = (
                    int((value + self.margin) * FINENESS) + int(step)
                    for value, step in zip((layer.top, layer.left), shift, strict=True)
                )
                rows, columns = layer.cover.shape
                inside = [
                    (max(0, start), min(start + length, limit))
                    for start, length, limit in zip(
                        (top, left), (rows, columns), self.canvas, strict=True
                    )
                ]
                (r0, r1), (c0, c1) = inside
                if r0 < r1 and c0 < c1:
                    cast = layer.cover[r0 - top : r1 - top, c0 - left : c1 - left]
                    shadow[r0:r1, c0:c1] *= 1 - random.uniform(0.2, 0.7) * cast
        return cv2.GaussianBlur(shadow, (0, 0), float(np.exp(random.uniform(0, 2.5))))
