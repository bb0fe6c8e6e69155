"""Drawing of a random scene: planes of a room, and objects in front of them, each in a layer."""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation.layered.shapes import THINGS, leaf, net
from coded_aperture_ros.simulation.layered.textures import TEXTURE_COUNT, TEXTURE_PX, texture
from coded_aperture_ros.simulation.layered.tracing import FINENESS, Layer, prefiltered, traced

# Of the blur sizes of a scene on one side of the focal plane.
LARGEST_PX = 19.5
_FOCAL_LENGTH_PX = 600.0
_FOCUS_M = 1.0
# Sides of the leaves that let light pass.
_LEAVES_PX = (10, 36)
_AROUND = (1, 1, 1, 1, cv2.BORDER_CONSTANT)


def new_drawing(
    random: np.random.Generator,
    mask: Mask,
    side: str,
    shape: tuple[int, int],
    blur_range_px: tuple[float, float] | None = None,
) -> "tuple[Drawing, Camera]":
    """Drawing of a scene of these blur sizes, or of random ones, and its camera."""
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
    return Drawing(random, shape, margin, (nearest, farthest)), camera


def _blur_range(random: np.random.Generator, side: str) -> tuple[float, float]:
    """Blur sizes of the nearest and the farthest surface."""
    if side == "both":
        return random.uniform(-15, -2), random.uniform(2, 15)
    far = random.uniform(6, LARGEST_PX)
    # Mostly deep scenes, where near things stand out; some shallow ones.
    near = random.uniform(1.0, (0.5 if random.random() < 0.75 else 0.85) * far)
    return (near, far) if side == "far" else (-far, -near)


class Drawing:
    """Random layers of one scene, with common exposure and texture."""

    def __init__(
        self,
        random: np.random.Generator,
        shape: tuple[int, int],
        margin_px: int,
        blur_range_px: tuple[float, float],
    ) -> None:
        self.random = random
        self.shape = shape
        self.margin = margin_px
        self.nearest, self.farthest = blur_range_px
        self.canvas = tuple(FINENESS * (length + 2 * margin_px) for length in shape)
        self.exposure = float(np.exp(random.uniform(np.log(0.06), np.log(0.4))))
        # How much the scene's textures vary, and how sharp they are.
        self.contrast = float(np.exp(random.uniform(np.log(0.12), np.log(0.6))))
        self.softness = random.uniform(0, 1.0) if random.random() < 0.3 else 0.0

    def things(self) -> tuple[Layer, ...]:
        """Objects in front of the room, nearest first."""
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
        """Rods side by side in front of a background: blur size and layer of each."""
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
        """Layers that cover a part of the room, their share of each pixel, and their blur size."""
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
        """Planes behind all things: the nearest of them is seen at every pixel."""
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
        """Plane that ends the scene: often slanted, and as far as the range goes."""
        random = self.random
        slant = random.uniform(-1, 1, 2) * (0.5 * span if random.random() < 0.5 else 0.02 * span)
        down, right = slant / self.shape
        highest = max(0, down * self.shape[0]) + max(0, right * self.shape[1])
        return self.farthest - highest, down, right

    def _place(self) -> float:
        """Blur size of an object; near ones are more frequent."""
        return float(self.nearest + (self.farthest - self.nearest) * self.random.random() ** 1.6)

    def _thing(self, name: str) -> FloatArray:
        side = max(self.canvas)
        return THINGS[name](self.random, side)[: self.canvas[0], : self.canvas[1]]

    def _layer(self, matte: FloatArray, blur: float) -> Layer | None:
        random = self.random
        rows = np.flatnonzero(matte.any(axis=1))
        columns = np.flatnonzero(matte.any(axis=0))
        if rows.size < 3 or columns.size < 3:
            return None
        top = rows[0]
        left = columns[0]
        matte = matte[top : rows[-1] + 1, left : columns[-1] + 1]
        size = np.array(matte.shape) / FINENESS
        slant = np.zeros(2)
        if random.random() < 0.4:
            room = min(blur - self.nearest, self.farthest - blur)
            slant = random.uniform(-1, 1, 2) * room / size.sum()
        y = top / FINENESS - self.margin
        x = left / FINENESS - self.margin
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
        """Textured surface's light: tone, contrast, shading."""
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
        """Shadows that some things cast on the room."""
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
