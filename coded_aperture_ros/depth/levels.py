"""The blur levels of a model as blur sizes and depths, and which are as good as each other."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood import BlurLevels, LikelihoodModel
from coded_aperture_ros.optics import Camera


@dataclasses.dataclass(frozen=True, eq=False)
class Folding:
    """Levels of both sides of the focal plane as blur sizes without sign."""

    sizes_px: DoubleArray  # [n]; blur sizes without sign, increasing
    # [n]; the level of each size beyond and before the focal plane; if there is none, the other
    # one.
    far: IndexArray
    near: IndexArray

    @classmethod
    def of(cls, sizes_px: DoubleArray) -> "Folding":
        """Fold the signed blur sizes of a model's levels [L]."""
        absolute = np.abs(sizes_px)
        # Sizes of the two sides mirror each other but for rounding.
        order = np.argsort(absolute)
        step = np.abs(np.diff(sizes_px)).min()
        begins = np.flatnonzero(np.diff(absolute[order], prepend=-1.0) > 0.01 * step)
        groups = np.split(order, begins[1:])
        far, near = (
            np.array([group[np.argmax(sign * sizes_px[group])] for group in groups], np.intp)
            for sign in (1, -1)
        )
        return cls(absolute[far], far, near)

    def of_sizes(self, volume: FloatArray) -> FloatArray:
        """Return the cost of every size, whatever its side [rows, columns, n], from [.., L]."""
        if len(self.far) == volume.shape[-1]:  # each size is on one side only
            return volume[..., self.far]
        return np.minimum(volume[..., self.far], volume[..., self.near])


# Steps between two levels that blur sizes and depths are tabulated at: finer than any estimate.
_STEPS = 128
# Depths that differ by this share are as good as each other.
_TOLERANCE = 0.05

_Maps = tuple[FloatArray, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Levels:
    """What a fractional level means.

    The `blur_sizes_px` [L] are signed, and mere indices unless `in_pixels`; `depths_m` [L] is None
    if neither a camera nor the model says how far the levels are. `agreement`, intp [2, L], has the
    first and last of the levels that are as good as each level: their depths differ by at most 5 %,
    or, where depths are not known, they are neighbours.
    """

    blur_sizes_px: DoubleArray
    depths_m: DoubleArray | None
    in_pixels: bool
    agreement: IndexArray
    _size_table: FloatArray
    _depth_table: FloatArray | None
    _metres_per_level: FloatArray | None
    _bends: Camera | None  # whose depths also depend on the place in the image

    @classmethod
    def of(cls, model: LikelihoodModel, camera: Camera | None = None) -> "Levels":
        """Return the levels of a model, in metres where a camera or the model itself knows.

        Raises `InputError` if the model is not for the camera.
        """
        stack = model.stack
        by_camera = camera if camera is not None and not depths_are_measured(model) else None
        depths = stack.depths_m if by_camera is None else _depths_by_camera(model, by_camera)
        count = len(stack)
        level = np.linspace(0, count - 1, (count - 1) * _STEPS + 1)
        size = np.interp(level, np.arange(count), stack.blur_sizes_px)
        if by_camera is None:
            depth = stack.interpolate_depth(level)
        else:
            depth = by_camera.depth_m(size).astype(np.float32)
        per_level = None if depth is None else _metres_per_level(depth)
        # Planes were measured all over the image.
        bends = by_camera is not None and by_camera.field_curvature is not None
        return cls(
            stack.blur_sizes_px,
            depths,
            stack.in_pixels,
            _agreement(count, depths),
            size.astype(np.float32),
            depth,
            per_level,
            by_camera if bends else None,
        )

    def __len__(self) -> int:
        """Return the number L of levels."""
        return len(self.blur_sizes_px)

    @property
    def nearest_first(self) -> IndexArray:
        """The levels in the order of their depths, or of their blur sizes [L]."""
        table = self._size_table if self._depth_table is None else self._depth_table
        return np.argsort(table[::_STEPS], kind="stable")

    def nearer(self, level: FloatArray, other: FloatArray) -> FloatArray:
        """Return the nearer one of two maps of levels."""
        # Depth grows or falls with the level's index.
        choose = np.minimum if self.nearest_first[0] == 0 else np.maximum
        return np.asarray(choose(level, other))

    def meaning(
        self, level: FloatArray, deviation: FloatArray, unknown: BoolArray
    ) -> tuple[FloatArray, FloatArray, FloatArray | None, FloatArray | None]:
        """Return fractional levels, blur sizes, px, depths, m, and their standard deviations, m.

        NaN where they are unknown. Deviations of depths are made of those of levels, above 0: the
        inverse depth is linear in the blur size, and `std(z) = z^2 std(1 / z)`; +inf where the
        depth is. None if depths are not known. Takes maps of the whole image, without NaN.
        """
        tables = self._size_table, self._depth_table, self._metres_per_level
        known = tuple(self._size_table if table is None else table for table in tables)
        flat = tuple(np.empty(level.size, np.float32) for _ in range(4))
        look_up(level.ravel(), deviation.ravel(), unknown.ravel(), known, flat)
        found, size_px, depth_m, std_dev_m = (values.reshape(level.shape) for values in flat)
        if self._depth_table is None:
            return found, size_px, None, None
        if self._bends is not None:
            axial_m, depth_m = depth_m, self._bends.field_corrected_depth(depth_m)
            # What is at infinity on the axis has no deviation that could be carried over.
            std_dev_m = std_dev_m * np.square(np.where(np.isinf(axial_m), 1, depth_m / axial_m))
        return found, size_px, depth_m, std_dev_m

    def depth_m(self, level: FloatArray, unknown: BoolArray | None = None) -> FloatArray | None:
        """Depth of a map of fractional levels of the whole image, m; None if depths are not known.

        NaN where it is unknown; the map has no NaN.
        """
        if unknown is None:
            unknown = np.zeros(level.shape, np.bool_)
        return self.meaning(level, np.zeros_like(level), unknown)[2]


def depths_are_measured(model: BlurLevels) -> bool:
    """Return whether a model knows its depths from measurement, better than by a camera file."""
    return not model.mask_digest and model.stack.depths_m is not None


def blur_sizes_px(
    model: BlurLevels, camera: Camera | None, depth_m: FloatArray
) -> FloatArray | None:
    """Return the blur sizes of a depth map of the whole image, NaN where it is; None if unknown.

    From whoever knows the depths of the levels best, as in `Levels`.
    """
    if camera is None or depths_are_measured(model):
        return model.stack.interpolate_blur_size(depth_m)
    return np.asarray(camera.blur_map_px(depth_m), np.float32)


def _metres_per_level(depth_m: FloatArray) -> FloatArray:
    """Return by how much the depth changes in a level, from a table of depths; +inf at +inf."""
    per_level = np.where(np.isnan(depth_m), np.nan, np.inf)
    known = np.isfinite(depth_m)
    depth = depth_m[known].astype(np.float64)
    if len(depth) > 1:
        per_level[known] = depth**2 * np.abs(np.gradient(1 / depth, 1 / _STEPS))
    return per_level.astype(np.float32)


def _agreement(count: int, depths_m: DoubleArray | None) -> IndexArray:
    index = np.arange(count)
    if depths_m is None:
        near = np.abs(index[:, None] - index) <= 1
    else:
        # By inverse depth, so that levels at or beyond the blur size of infinity agree too.
        inverse = np.abs(1 / depths_m)
        near = np.abs(inverse[:, None] - inverse) <= _TOLERANCE * inverse[:, None]
        near |= index[:, None] == index
    return np.array([near.argmax(axis=1), count - 1 - near[:, ::-1].argmax(axis=1)])


def check_camera(model: BlurLevels, camera: Camera) -> None:
    """Refuse a camera that cannot tell the depths of a model's levels, by an `InputError`."""
    if not depths_are_measured(model):
        _depths_by_camera(model, camera)


def _depths_by_camera(model: BlurLevels, camera: Camera) -> DoubleArray:
    sizes = model.stack.blur_sizes_px
    if not model.stack.in_pixels:
        raise InputError(
            "camera: the bank's PSFs were measured without their sizes, so a camera cannot "
            "tell their depths: learn the bank with the depths (--depths) or sizes_px"
        )
    if model.mask_digest not in ("", camera.mask.digest):
        raise InputError(
            f"camera: its mask {camera.mask.name} is not the one that the bank was "
            f"learned for ({model.learned_from}): learn the bank for this camera"
        )
    far = {"far": 1, "near": -1, "both": 0}[camera.side]
    if (sizes * far < 0).any():
        raise InputError(
            f"camera: its side is {camera.side}, but the bank has blur sizes of the other "
            "side of the focal plane: learn the bank for this camera"
        )
    depths = camera.depth_m(sizes)
    if not np.isfinite(depths).any():
        raise InputError(
            f"camera: no point gives the bank's blur sizes of {sizes.min():g} to "
            f"{sizes.max():g} px, its blur at infinity is {camera.blur_at_infinity_px:g} px: "
            "learn the bank for this camera"
        )
    return depths


def _loop(
    level: FloatArray, deviation: FloatArray, unknown: BoolArray, tables: _Maps, maps: _Maps
) -> None:
    sizes, depths, per_level = tables
    of_level, of_size, of_depth, of_deviation = maps
    nan, last = np.float32(np.nan), len(sizes) - 1
    for i in range(len(level)):
        at, gone = int(level[i] * np.float32(_STEPS) + np.float32(0.5)), unknown[i]
        at = min(max(at, 0), last)  # never beyond the tables, whatever comes
        of_level[i] = nan if gone else level[i]
        of_size[i] = nan if gone else sizes[at]
        of_depth[i] = nan if gone else depths[at]
        of_deviation[i] = nan if gone else per_level[at] * deviation[i]


def _plain(
    level: FloatArray, deviation: FloatArray, unknown: BoolArray, tables: _Maps, maps: _Maps
) -> None:
    at = (level * _STEPS + np.float32(0.5)).astype(np.int32)
    sizes, depths, per_level = (table.take(at, mode="clip") for table in tables)
    for found, value in zip(maps, (level, sizes, depths, per_level * deviation), strict=True):
        np.copyto(found, np.where(unknown, np.float32(np.nan), value))


# Writes levels, sizes, depths and deviations of depths, see `Levels.meaning`, by tables of sizes,
# depths and metres per level. All are flat, which is quicker.
look_up = Compiled(_loop, _plain, finite=False)
