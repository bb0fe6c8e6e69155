"""Field curvature of a lens, from planes at known depths."""

import dataclasses

import numpy as np

from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.calibration.scoring import Scoring, Windows, window_spectra
from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import grey_image
from coded_aperture_ros.likelihood.bank import learn_bank
from coded_aperture_ros.optics import Camera, FieldCurvature, render_psf, render_psf_stack
from coded_aperture_ros.optics.pupil import measured_beyond_pupil
from coded_aperture_ros.pipeline import FramePipeline

# Smallest blur on the axis, px: with less the corners may have none, or that of the other side of
# the focus.
_MIN_AXIAL_PX = 4.0
# Smallest level of the bank, and the distance between levels, px.
_MIN_LEVEL_PX = 1.5
_STEP_PX = 0.4
_MIN_PLANES = 3
_MIN_CONFIDENCE = 0.55
# Every so many-th pixel is a point.
_EVERY_PX = 4
# Residual from which a point loses weight in the robust fit, px.
_SCATTER_PX = 0.3
_ROUNDS = 30
# A plane is misplaced if the logarithm of its depth is off by more than the first, and by more than
# this share of its own scatter.
_MAX_DEPTH_ERROR = 0.05
_MAX_ERROR_OVER_SCATTER = 0.8
# So is one whose blur, in the middle third and by all its windows, is off the line of the others
# by `_MAX_RESIDUAL_PX`. Where blur is less than `_MIN_LINE_PX`, textures that are not like
# photographs move it by more.
_MIN_LINE_PX = 8.0
_MAX_RESIDUAL_PX = 0.4
_MIDDLE_SHARE = 0.35
_MIN_NOISE = 0.003
_MIN_LINE_PLANES = 5
_WINDOW_STRIDE_PX = 24
_SIZE_STEP_PX = 0.25


@dataclasses.dataclass(frozen=True, eq=False)
class FieldFit:
    """Field curvature and mask extent from planes, and the quality of the fit.

    For each plane that is blurred enough: name, depth, depth and median error by a fit to the
    others, and the error without curvature. `misplaced` are those whose depth is wrong, `trusted`
    the others, by their index among all planes. The `camera` is for the pictures, with both.
    `by_thirds` [planes, 3, 4] has for thirds of the radius the median blur, px, as measured and by
    the fit to the others, the median error of depth by that, and the share of the pixels that are
    used.
    """

    camera: Camera
    curvature: FieldCurvature
    mask_extent_mm: float
    names: tuple[str, ...]
    depths_m: DoubleArray
    found_m: DoubleArray
    errors_without: DoubleArray
    errors: DoubleArray
    misplaced: tuple[int, ...]
    trusted: tuple[int, ...]
    by_thirds: DoubleArray


def fit_field(camera: Camera, planes: Planes, progress: Progress = iter) -> FieldFit:
    """Field curvature and mask extent, fitted to the blur that a bank of the axis finds everywhere.

    Parameters
    ----------
    camera : Camera
        As it was set up.
    planes : Planes
    progress : callable, optional
        Wraps the iteration over the planes.

    Returns
    -------
    FieldFit

    Raises
    ------
    InputError
        If too few planes are blurred enough, or pictures have other proportions.
    """
    rows, columns = planes.images[0].shape[:2]
    camera = camera.resized(columns, rows)
    axial_px = np.abs(camera.blur_size_px(planes.depths_m))
    used = [int(index) for index in np.flatnonzero(axial_px >= _MIN_AXIAL_PX)]
    if len(used) < _MIN_PLANES:
        raise InputError(
            f"{len(used)} planes are blurred by {_MIN_AXIAL_PX:g} px or more, {_MIN_PLANES} are "
            "needed: take planes farther from the focus"
        )
    points = _field_points(camera, planes, used, float(axial_px.max()), progress)
    true = points.depths_m
    everything = list(range(len(used)))
    without = [points.solve([j for j in everything if j != i]) for i in everything]
    left_out = [points.log_depth_errors(i, *without[i]) for i in everything]
    middle = np.array([np.median(each) for each in left_out])
    scatter = np.array([np.ptp(np.quantile(each, (0.1, 0.9))) for each in left_out])
    uncorrected = [points.log_depth_errors(i, 1, 0, 0) for i in everything]
    scale, second, fourth = (float(value) for value in points.solve(everything))
    curvature = FieldCurvature(round(second / scale, 4), round(fourth / scale, 4))
    extent_mm = round(camera.mask_extent_mm * scale, 4)
    if reason := measured_beyond_pupil(camera.mask, extent_mm, camera.pupil_mm):
        raise InputError(reason)
    misplaced = np.abs(middle) > np.maximum(_MAX_DEPTH_ERROR, _MAX_ERROR_OVER_SCATTER * scatter)
    misplaced |= _off_the_line(camera, planes, used)
    return FieldFit(
        camera=dataclasses.replace(camera, field_curvature=curvature, mask_extent_mm=extent_mm),
        curvature=curvature,
        mask_extent_mm=extent_mm,
        names=tuple(planes.names[index] for index in used),
        depths_m=true,
        found_m=true * np.exp(middle),
        errors_without=np.array([np.median(np.abs(np.expm1(each))) for each in uncorrected]),
        errors=np.array([np.median(np.abs(np.expm1(each))) for each in left_out]),
        misplaced=tuple(np.flatnonzero(misplaced)),
        trusted=tuple(np.array(used)[~misplaced]),
        by_thirds=np.array([points.thirds(i, *without[i]) for i in everything]),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _FieldPoints:
    """Confident blur sizes over the field, for each of P planes."""

    depths_m: DoubleArray  # [P]; true ones
    # For each plane [3, n]: blur size in dioptres, squared tangent of the field angle, its square.
    points: list[DoubleArray]
    squared_tangent: FloatArray  # of all pixels that were looked at
    corner: float  # the largest squared tangent
    inverse_focus: float  # 1/m
    unit_px: float  # blur size per dioptre

    def solve(self, planes: list[int]) -> DoubleArray:
        """Scale and bends of ``blur + second t^2 + fourth t^4 = scale (1 / z_focus - 1 / z)``."""
        counts = [self.points[i].shape[1] for i in planes]
        blur, *bends = np.hstack([self.points[i] for i in planes])
        axial = np.repeat(self.inverse_focus - 1 / self.depths_m[planes], counts)
        matrix = np.stack([axial, *np.negative(bends)], axis=1)
        weight = np.repeat(np.array(counts) ** -0.5, counts)
        robust = weight
        for _ in range(_ROUNDS):
            solved = np.linalg.lstsq(matrix * robust[:, None], blur * robust, rcond=None)[0]
            residual_px = (matrix @ solved - blur) * self.unit_px
            robust = weight / np.sqrt(1 + (residual_px / _SCATTER_PX) ** 2)
        return np.asarray(solved)

    def log_depth_errors(
        self, plane: int, scale: float, second: float, fourth: float
    ) -> DoubleArray:
        """Logarithm of depth over true depth at every point of a plane [n]."""
        left = self.inverse_focus - np.array([1, second, fourth]) @ self.points[plane] / scale
        return -np.log(np.maximum(left, 1e-6) * self.depths_m[plane])

    def thirds(self, plane: int, scale: float, *bends: float) -> DoubleArray:
        """Entry of `FieldFit.by_thirds` for a plane [3, 4]."""
        limits = self.corner * np.array([1, 4]) / 9
        blur, *powers = self.points[plane]
        axial = scale * (self.inverse_focus - 1 / self.depths_m[plane])
        predicted = axial - np.array(bends) @ powers
        error = np.abs(np.expm1(self.log_depth_errors(plane, scale, *bends)))
        third_of_all = np.digitize(self.squared_tangent, limits)
        third = np.digitize(powers[0], limits)
        found = np.full((3, 4), np.nan)
        for number, inside in enumerate(third == number for number in range(3)):
            found[number, 3] = inside.sum() / max(1, (third_of_all == number).sum())
            if inside.any():
                sizes_px = blur[inside] * self.unit_px, predicted[inside] * self.unit_px
                found[number, :3] = [np.median(each) for each in (*sizes_px, error[inside])]
        return found


def _field_points(
    camera: Camera, planes: Planes, used: list[int], largest_px: float, progress: Progress
) -> _FieldPoints:
    """Blur sizes of the planes `used` over the field, by a bank of the PSFs of the axis."""
    true = planes.depths_m[used]
    sign = 1 if true[-1] > camera.focus_distance_m else -1
    sizes_px = sign * np.arange(_MIN_LEVEL_PX, largest_px * 1.1 + _STEP_PX, _STEP_PX)
    bank = learn_bank(render_psf_stack(camera.mask, np.sort(sizes_px)))
    # What a network has learned must not bend what is measured.
    config = DepthConfig(regularize="semiglobal", check_fit=False, threads=0)
    pipeline = FramePipeline(bank, depth=config, deblur=None)
    shape = planes.images[0].shape[:2]
    squared_tangent = FieldCurvature(1.0).defocus_map(camera.intrinsics, shape)
    unit_px = camera.blur_per_dioptre_px
    # Nearer to the border no window is centred.
    points = []
    margin = bank.window_px // 2
    some = np.s_[margin:-margin:_EVERY_PX, margin:-margin:_EVERY_PX]
    for index in progress(used):
        found = pipeline(planes.images[index])
        sure = found.confidence[some] >= _MIN_CONFIDENCE
        blur = found.blur_size_px[some][sure] / unit_px
        squared = squared_tangent[some][sure]
        points.append(np.stack([blur, squared, squared**2]))
    pipeline.close()
    corner = squared_tangent.max()
    inverse_focus = 1 / camera.focus_distance_m
    return _FieldPoints(true, points, squared_tangent[some], corner, inverse_focus, unit_px)


def _off_the_line(camera: Camera, planes: Planes, used: list[int]) -> BoolArray:
    """Planes whose blur, in the middle of the image, is that of another depth."""
    scoring = Scoring(lambda _, seen: render_psf(camera.mask, seen.blur_size_px), np.ones(1))
    k = camera.intrinsics.camera_matrix
    corner = np.hypot(*planes.images[0].shape[:2]) / 2
    expected = np.abs(camera.blur_size_px(planes.depths_m[used]))
    grid = np.arange(_MIN_LEVEL_PX, 1.2 * expected.max(), _SIZE_STEP_PX)
    sizes_px = np.empty(len(used))
    for number, index in enumerate(used):
        grey, _ = grey_image(planes.images[index], 1.0)
        powers, noise, middles = window_spectra(np.ascontiguousarray(grey), _WINDOW_STRIDE_PX)
        powers = powers[np.hypot(*(middles - [k[5], k[2]]).T) < _MIDDLE_SHARE * corner]
        noise = max(noise, _MIN_NOISE**2)
        here = (Windows(float(size), np.zeros(2), powers, noise) for size in grid)
        costs = [scoring.costs(np.zeros(1), each).min(axis=1).sum() for each in here]
        sizes_px[number] = grid[int(np.argmin(costs))]
    off = np.zeros(len(used), bool)
    inverse = 1 / planes.depths_m[used]
    usable = np.maximum(expected, sizes_px) >= _MIN_LINE_PX
    while (usable & ~off).sum() >= _MIN_LINE_PLANES:
        # The worst first: it bends the line of the others.
        left: dict[int, float] = {}
        for number in map(int, np.flatnonzero(usable & ~off)):
            others = usable & ~off
            others[number] = False
            line = np.polyfit(inverse[others], sizes_px[others], 1)
            left[number] = abs(sizes_px[number] - np.polyval(line, inverse[number]))
        worst = max(left, key=lambda number: left[number])
        if left[worst] <= _MAX_RESIDUAL_PX:
            break
        off[worst] = True
    return off
