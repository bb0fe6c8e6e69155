"""The field curvature of a lens, from planes at known depths."""

import dataclasses

import numpy as np

from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.calibration.scoring import Scoring, Windows, window_spectra
from coded_aperture_ros.core.arrays import BoolArray, DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import grey_image
from coded_aperture_ros.likelihood.bank import learn_bank
from coded_aperture_ros.optics import Camera, FieldCurvature, render_psf, render_psf_stack

# With less blur on the axis the corners may have none, or that of the other side of the focus.
_LEAST_PX = 4.0
_SMALLEST_PX = 1.5
_STEP_PX = 0.4
_FEWEST = 3
_CONFIDENT = 0.55
_EVERY_PX = 4
_SCATTER_PX = 0.3
_ROUNDS = 30
# A plane whose depth is off by more than the first, and by more than its own scatter, is elsewhere.
_OFF = 0.05
_OF_SCATTER = 0.8
# So is one whose blur, in the middle third and by all its windows, is off the line of the others.
# Where blur is less, textures that are not like photographs move it more than that.
_TOLD_PX = 8.0
_OFF_PX = 0.4
_MIDDLE = 0.35
_LEAST_NOISE = 0.003
_FEWEST_TOLD = 5
_WINDOW_STRIDE_PX = 24
_SIZE_STEP_PX = 0.25


@dataclasses.dataclass(frozen=True, eq=False)
class FieldFit:
    """Field curvature and mask extent as planes show them, and how well they fit.

    Of each plane that is blurred enough: name, depth, depth and median error by a fit to the
    others, and the error without curvature. `misplaced` are those whose depth is wrong, `trusted`
    the others, by their index among all planes. The `camera` is for the pictures, with both.
    `by_thirds` [planes, 3, 4] has for thirds of the radius the median blur, px, as measured and by
    the fit to the others, the median error of depth by that, and which share of the pixels tell.
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
    """Fit field curvature and mask extent to the blur that a bank of the axis finds everywhere.

    An `InputError` if too few planes are blurred enough, or pictures have other proportions.
    """
    rows, columns = planes.images[0].shape[:2]
    camera = camera.resized(columns, rows)
    axial_px = np.abs(camera.blur_size_px(planes.depths_m))
    used = [int(index) for index in np.flatnonzero(axial_px >= _LEAST_PX)]
    if len(used) < _FEWEST:
        raise InputError(
            f"{len(used)} planes are blurred by {_LEAST_PX:g} px or more, {_FEWEST} are needed: "
            "take planes farther from the focus"
        )
    true = planes.depths_m[used]
    sign = 1 if true[-1] > camera.focus_distance_m else -1
    sizes_px = sign * np.arange(_SMALLEST_PX, axial_px.max() * 1.1 + _STEP_PX, _STEP_PX)
    bank = learn_bank(render_psf_stack(camera.mask, np.sort(sizes_px)))
    # What a network has learned must not bend what is measured.
    config = DepthConfig(regularize="semiglobal", check_fit=False, threads=0)
    estimator = DepthEstimator(bank, config)
    tangent2 = FieldCurvature(1.0).defocus_map(camera.intrinsics, (rows, columns))
    unit = camera.blur_per_dioptre_px
    # Nearer to the border no window is centred.
    points = []
    margin = bank.window_px // 2
    some = np.s_[margin:-margin:_EVERY_PX, margin:-margin:_EVERY_PX]
    for index in progress(used):
        found = estimator.estimate(planes.images[index])
        sure = found.confidence[some] >= _CONFIDENT
        blur = found.blur_size_px[some][sure] / unit
        points.append(np.stack([blur, tangent2[some][sure], tangent2[some][sure] ** 2]))
    estimator.close()
    focus = 1 / camera.focus_distance_m

    def fitted(of: list[int]) -> DoubleArray:
        """Solve ``blur + second t^2 + fourth t^4 = scale (1 / z_focus - 1 / z)`` for all three."""
        counts = [points[i].shape[1] for i in of]
        blur, *bends = np.hstack([points[i] for i in of])
        matrix = np.stack([np.repeat(focus - 1 / true[of], counts), *np.negative(bends)], axis=1)
        weight = np.repeat(np.array(counts) ** -0.5, counts)
        robust = weight
        for _ in range(_ROUNDS):
            solved = np.linalg.lstsq(matrix * robust[:, None], blur * robust, rcond=None)[0]
            robust = weight / np.sqrt(1 + ((matrix @ solved - blur) * unit / _SCATTER_PX) ** 2)
        return np.asarray(solved)

    def apart(index: int, scale: float, second: float, fourth: float) -> DoubleArray:
        """Return the logarithm of depth over true depth at every point of a plane."""
        left = focus - np.array([1, second, fourth]) @ points[index] / scale
        return -np.log(np.maximum(left, 1e-6) * true[index])

    def of_thirds(index: int, scale: float, *bends: float) -> DoubleArray:
        """Return what `FieldFit.by_thirds` has of a plane."""
        blur, *powers = points[index]
        predicted = scale * (focus - 1 / true[index]) - np.array(bends) @ powers
        error = np.abs(np.expm1(apart(index, scale, *bends)))
        of_all = np.digitize(tangent2[some], thirds)
        third = np.digitize(powers[0], thirds)
        found = np.full((3, 4), np.nan)
        for number, inside in enumerate(third == number for number in range(3)):
            found[number, 3] = inside.sum() / max(1, (of_all == number).sum())
            if inside.any():
                values = blur[inside] * unit, predicted[inside] * unit, error[inside]
                found[number, :3] = [np.median(each) for each in values]
        return found

    everything = list(range(len(used)))
    thirds = tangent2.max() * np.array([1, 4]) / 9
    without = [fitted([j for j in everything if j != i]) for i in everything]
    left_out = [apart(i, *without[i]) for i in everything]
    middle = np.array([np.median(each) for each in left_out])
    scatter = np.array([np.ptp(np.quantile(each, (0.1, 0.9))) for each in left_out])
    scale, second, fourth = (float(value) for value in fitted(everything))
    curvature = FieldCurvature(round(second / scale, 4), round(fourth / scale, 4))
    extent_mm = round(camera.mask_extent_mm * scale, 4)
    misplaced = np.abs(middle) > np.maximum(_OFF, _OF_SCATTER * scatter)
    misplaced |= _off_the_line(camera, planes, used)
    return FieldFit(
        dataclasses.replace(camera, field_curvature=curvature, mask_extent_mm=extent_mm),
        curvature,
        extent_mm,
        tuple(planes.names[index] for index in used),
        true,
        true * np.exp(middle),
        np.array([np.median(np.abs(np.expm1(apart(i, 1, 0, 0)))) for i in everything]),
        np.array([np.median(np.abs(np.expm1(each))) for each in left_out]),
        tuple(np.flatnonzero(misplaced)),
        tuple(np.array(used)[~misplaced]),
        np.array([of_thirds(i, *without[i]) for i in everything]),
    )


def _off_the_line(camera: Camera, planes: Planes, used: list[int]) -> BoolArray:
    """Return which planes are blurred, in the middle of the image, as at another depth."""
    scoring = Scoring(lambda _, seen: render_psf(camera.mask, seen.blur_size_px), np.ones(1))
    k = camera.intrinsics.camera_matrix
    corner = np.hypot(*planes.images[0].shape[:2]) / 2
    expected = np.abs(camera.blur_size_px(planes.depths_m[used]))
    grid = np.arange(_SMALLEST_PX, 1.2 * expected.max(), _SIZE_STEP_PX)
    sizes_px = np.empty(len(used))
    for number, index in enumerate(used):
        grey, _ = grey_image(planes.images[index], 1.0)
        powers, noise, middles = window_spectra(np.ascontiguousarray(grey), _WINDOW_STRIDE_PX)
        powers = powers[np.hypot(*(middles - [k[5], k[2]]).T) < _MIDDLE * corner]
        noise = max(noise, _LEAST_NOISE**2)
        here = (Windows(float(size), np.zeros(2), powers, noise) for size in grid)
        costs = [scoring.costs(np.zeros(1), each).min(axis=1).sum() for each in here]
        sizes_px[number] = grid[int(np.argmin(costs))]
    off = np.zeros(len(used), bool)
    inverse = 1 / planes.depths_m[used]
    told = np.maximum(expected, sizes_px) >= _TOLD_PX
    while (told & ~off).sum() >= _FEWEST_TOLD:
        # The worst first: it bends the line of the others.
        left: dict[int, float] = {}
        for number in map(int, np.flatnonzero(told & ~off)):
            others = told & ~off
            others[number] = False
            line = np.polyfit(inverse[others], sizes_px[others], 1)
            left[number] = abs(sizes_px[number] - np.polyval(line, inverse[number]))
        worst = max(left, key=lambda number: left[number])
        if left[worst] <= _OFF_PX:
            break
        off[worst] = True
    return off
