"""Blur sizes and depths of a model's levels, and which levels are equivalent."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import (
    BoolArray,
    DoubleArray,
    FloatArray,
    IndexArray,
    constant,
    namespace,
)
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.depth.camera_depths import depths_by_camera
from coded_aperture_ros.depth.levels_plain import STEPS, Maps, look_up_plain
from coded_aperture_ros.likelihood import BlurLevels, LikelihoodModel
from coded_aperture_ros.optics import Camera


@dataclasses.dataclass(frozen=True, eq=False)
class Folding:
    """Levels of both sides of the focal plane as blur sizes without sign."""

    sizes_px: DoubleArray  # [n]; blur sizes without sign, px, increasing
    # [n]; level of each size beyond the focal plane, and in front of it. A size that only one side
    # has is its level on that side in both.
    far: IndexArray
    near: IndexArray

    @classmethod
    def from_sizes(cls, sizes_px: DoubleArray) -> "Folding":
        """Folding of the signed blur sizes of a model's levels [L], px."""
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

    def fold_volume(self, volume: FloatArray) -> FloatArray:
        """Cost of every unsigned size [rows, columns, n]: the lower of its levels' [..., L]."""
        far = volume[..., constant(self.far, volume)]
        if len(self.far) == volume.shape[-1]:  # each size is on one side only
            return far
        return np.minimum(far, volume[..., self.near])


# Depths that differ by at most this share are equivalent: `confidence` is for 5 %.
_TOLERANCE = 0.05


@dataclasses.dataclass(frozen=True, eq=False)
class Levels:
    """Blur size and depth of fractional levels.

    Attributes
    ----------
    blur_sizes_px : ndarray, float64 [L]
        Signed, positive beyond the focal plane; pixels, or only indices unless `in_pixels`.
    depths_m : ndarray, float64 [L], or None
        Metres along the optical axis; None if neither the model nor a camera gives them.
    in_pixels : bool
        Whether the blur sizes are known in pixels.
    agreement : ndarray, intp [2, L]
        First and last of the levels that are equivalent to each level: their depths differ by at
        most 5 %, or, where depths are not known, they are neighbours.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(2, 9, 15)))
    >>> levels = Levels.from_model(bank)
    >>> len(levels), levels.depths_m is None
    (15, True)

    References
    ----------
    Martinello 2012, eq. 3.28 (blur size of a depth).
    """

    blur_sizes_px: DoubleArray
    depths_m: DoubleArray | None
    in_pixels: bool
    agreement: IndexArray
    _size_table: FloatArray
    _depth_table: FloatArray | None
    _metres_per_level: FloatArray | None
    _curved: Camera | None  # camera with field curvature: depths depend on the image position

    @classmethod
    def from_model(cls, model: LikelihoodModel, camera: Camera | None = None) -> "Levels":
        """Levels of a model, with depths from its measured planes or else from the camera.

        Raises
        ------
        InputError
            If the model is not for the camera.
        """
        stack = model.stack
        by_camera = camera if camera is not None and not depths_are_measured(model) else None
        depths = stack.depths_m if by_camera is None else depths_by_camera(model, by_camera)
        count = len(stack)
        level = np.linspace(0, count - 1, (count - 1) * STEPS + 1)
        size = np.interp(level, np.arange(count), stack.blur_sizes_px)
        if by_camera is None:
            depth = stack.interpolate_depth(level)
        else:
            depth = by_camera.depth_m(size).astype(np.float32)
        per_level = None if depth is None else _metres_per_level(depth)
        # Measured planes include the field curvature already.
        is_curved = by_camera is not None and by_camera.field_curvature is not None
        return cls(
            stack.blur_sizes_px,
            depths,
            stack.in_pixels,
            _agreement(count, depths),
            size.astype(np.float32),
            depth,
            per_level,
            by_camera if is_curved else None,
        )

    def __len__(self) -> int:
        """Number L of levels."""
        return len(self.blur_sizes_px)

    @property
    def per_px(self) -> float:
        """Levels in a pixel of blur."""
        return float((len(self) - 1) / np.ptp(self.blur_sizes_px))

    @property
    def tolerance_px(self) -> FloatArray:
        """Error of each level's blur size that is 5 % of its depth, px, float32 [L]."""
        sizes = self.blur_sizes_px
        step_px = abs(np.mean(np.diff(sizes)))
        if self.depths_m is None:
            return np.full(len(sizes), step_px, np.float32)
        inverse = 1 / self.depths_m
        per_px = np.abs(np.gradient(inverse, sizes))
        # Levels of infinite depth are alike; some have no depth at all.
        tolerance = np.full(len(sizes), step_px)
        finite = np.isfinite(self.depths_m) & (per_px > 0)
        return np.divide(_TOLERANCE * inverse, per_px, out=tolerance, where=finite).astype(
            np.float32
        )

    @property
    def nearest_first(self) -> IndexArray:
        """Levels ordered by depth, or by blur size where depths are not known, intp [L]."""
        table = self._size_table if self._depth_table is None else self._depth_table
        return np.argsort(table[::STEPS], kind="stable")

    def nearer(self, level: FloatArray, other: FloatArray) -> FloatArray:
        """Nearer of two levels at every pixel, float32 of their shape."""
        # Depth grows or falls with the level's index.
        choose = "minimum" if self.nearest_first[0] == 0 else "maximum"
        return getattr(namespace(level), choose)(level, other)

    def metric_maps(
        self, level: FloatArray, deviation: FloatArray, unknown: BoolArray
    ) -> tuple[FloatArray, FloatArray, FloatArray | None, FloatArray | None]:
        """Level, blur size [px], depth [m] and standard deviation of depth [m] of every pixel.

        The inverse depth is linear in the blur size, so ``std(z) = z^2 std(1 / z)``.

        Parameters
        ----------
        level, deviation : ndarray, float32 [rows, columns]
            Of the whole image, without NaN; the standard deviation is in levels, > 0.
        unknown : ndarray, bool [rows, columns]
            Where all results are NaN.

        Returns
        -------
        tuple of ndarray, float32 [rows, columns]
            The standard deviation is +inf where the depth is; both are None if depths are not
            known.
        """
        tables = self._size_table, self._depth_table, self._metres_per_level
        known = tuple(self._size_table if table is None else table for table in tables)
        xp = namespace(level)
        flat = tuple(xp.empty_like(level.ravel()) for _ in range(4))
        fill = look_up if xp is np else look_up_plain
        fill(level.ravel(), deviation.ravel(), unknown.ravel(), known, flat)
        known_level, size_px, depth_m, std_dev_m = (values.reshape(level.shape) for values in flat)
        if self._depth_table is None:
            return known_level, size_px, None, None
        if self._curved is not None:
            axial_m, depth_m = depth_m, self._curved.field_corrected_depth(depth_m)
            # What is at infinity on the axis has no deviation that could be carried over.
            std_dev_m = std_dev_m * xp.where(xp.isinf(axial_m), 1, depth_m / axial_m) ** 2
        return known_level, size_px, depth_m, std_dev_m

    def depth_m(self, level: FloatArray, unknown: BoolArray | None = None) -> FloatArray | None:
        """Depth [m] of every pixel, float32 [rows, columns]; None if depths are not known.

        NaN where it is unknown. `level` is of the whole image, without NaN.
        """
        if unknown is None:
            unknown = level < 0
        return self.metric_maps(level, level, unknown)[2]


def depths_are_measured(model: BlurLevels) -> bool:
    """Whether a model has measured depths, which take precedence over a camera file's.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> depths_are_measured(learn_bank(render_psf_stack(Mask.named("levin"), np.arange(2.0, 9))))
    False
    """
    return not model.mask_digest and model.stack.depths_m is not None


def _metres_per_level(depth_m: FloatArray) -> FloatArray:
    """Change of depth per level [m], at every entry of a table of depths [m]; +inf at +inf."""
    per_level = np.where(np.isnan(depth_m), np.nan, np.inf)
    known = np.isfinite(depth_m)
    depth = depth_m[known].astype(np.float64)
    if len(depth) > 1:
        per_level[known] = depth**2 * np.abs(np.gradient(1 / depth, 1 / STEPS))
    return per_level.astype(np.float32)


def _agreement(count: int, depths_m: DoubleArray | None) -> IndexArray:
    """First and last level that is equivalent to each of `count` levels, intp [2, L]."""
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
    """Raise `InputError` if a camera cannot give the depths of a model's levels."""
    if not depths_are_measured(model):
        depths_by_camera(model, camera)


def _loop(
    level: FloatArray, deviation: FloatArray, unknown: BoolArray, tables: Maps, maps: Maps
) -> None:
    sizes, depths, per_level = tables
    known_level, size_px, depth_m, std_dev_m = maps
    nan, last = np.float32(np.nan), len(sizes) - 1
    for i in range(len(level)):
        entry = int(level[i] * np.float32(STEPS) + np.float32(0.5))
        entry = min(max(entry, 0), last)  # compiled code does not check the bounds of the tables
        known_level[i] = nan if unknown[i] else level[i]
        size_px[i] = nan if unknown[i] else sizes[entry]
        depth_m[i] = nan if unknown[i] else depths[entry]
        std_dev_m[i] = nan if unknown[i] else per_level[entry] * deviation[i]


# Fills maps of level, blur size, depth and deviation of depth (see `Levels.metric_maps`) from
# tables of sizes, depths and metres per level. All are flat, which is quicker.
look_up = Compiled(_loop, look_up_plain, finite=False)
