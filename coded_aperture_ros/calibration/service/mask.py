"""Rotation of the mask in its lens, and its covered cells."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import cv2
import numpy as np

from coded_aperture_ros.calibration.scoring import Scoring, Windows, saturated_cost, window_spectra
from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.bank.field import nearest_part
from coded_aperture_ros.optics import Camera, Mask, psf_width, render_psf
from coded_aperture_ros.optics.wavefront import field_tangents

# Of a real lens, windows of the middle of the frame, where it is at its best; in parts of one PSF.
_STRIDE_PX = 32
_MIDDLE = 0.25
_PARTS = (2, 2)
_LEVELS = 32
_MIN_BLUR_PX = 2.5
# Share of the windows that are kept: those that fit worst are of edges and of moving objects; and
# the smallest number of windows with one PSF.
_KEPT = 0.8
_MIN_WINDOWS = 4
_STRETCHES = 4
_MIN_STRETCH_WINDOWS = 120
_FINE = 8
# Prior standard deviation of the rotation, degrees.
_SPREAD_DEG = 3.0
_STEP_DEG = 0.25
_STEP = 0.05
_TURNS_DEG = np.arange(-8.0, 8.1, 2.0)
_SORTINGS = 2
_ROUNDS = 3
# Factor of the information that overlapping windows and neighbouring frequencies repeat.
_REPEATED = 4.0
_SURE = 5.0
_COVERED = 0.3
_MAX_COVERED = 6
# Number of PSFs, those with the most windows, that the cells are fitted to.
_GROUPS = 12


@dataclasses.dataclass(frozen=True, eq=False)
class MaskState:
    """State of a mask in the lens.

    Attributes
    ----------
    turned_deg, std_deg : float
        Rotation, clockwise in the camera file's picture, and its standard deviation.
    passed : ndarray, float64 [n, m]
        Share of its original light that each open cell passes; 0 where it is closed.
    covered : ndarray, bool [n, m]
        Cells that pass less than a third. For a mask that is its own half turn, it may be the cell
        on the other side of the middle: power spectra do not tell.
    windows : int
        Number of windows that were used.
    """

    turned_deg: float
    std_deg: float
    passed: DoubleArray
    covered: BoolArray
    windows: int

    def mask(self, mask: Mask) -> Mask:
        """Mask in this state."""
        return turned(
            Mask(mask.name, (mask.transmission * self.passed).astype(np.float32)), self.turned_deg
        )


def turned(mask: Mask, degrees: float) -> Mask:
    """Mask turned clockwise, on a finer grid."""
    if not degrees:
        return mask
    cells = np.kron(mask.transmission, np.ones((_FINE, _FINE), np.float32))
    middle = (cells.shape[1] - 1) / 2, (cells.shape[0] - 1) / 2
    turn = cv2.getRotationMatrix2D(middle, -degrees, 1.0)
    return Mask(mask.name, cv2.warpAffine(cells, turn, cells.shape[::-1]).clip(0, 1))


def fit_mask(
    camera: Camera, frames: Sequence[FloatArray], largest_px: float, progress: Progress
) -> MaskState:
    """Rotation of the mask, and light of its cells, from windows of unknown depth.

    Textures with a direction bias a stretch of a video. So the rotation is estimated from each of
    four stretches: their scatter is its error.

    Parameters
    ----------
    camera : Camera
        As it was set up.
    frames : sequence of ndarray, float32 [rows, columns]
        Grey, linear light, in order.
    largest_px : float
        Largest blur size that there may be, px.
    progress : Progress

    Raises
    ------
    InputError
        If there are too few windows with texture.
    """
    per_stretch = -(-len(frames) // _STRETCHES)
    open_cells = np.argwhere(camera.mask.transmission > 0)
    steps = np.array([_STEP_DEG, *np.full(len(open_cells), _STEP)])
    scoring = Scoring(_Fitted(camera, open_cells).psf, steps)
    sizes_px = np.linspace(_MIN_BLUR_PX, largest_px, _LEVELS)
    turns = []
    seen = list[Windows]()
    for first in progress(range(0, len(frames), per_stretch)):
        stretch_windows = list(_windows(camera, frames[first : first + per_stretch]))
        windows = sum(len(each.powers) for each in stretch_windows)
        if windows < _MIN_STRETCH_WINDOWS:
            raise InputError(
                f"{windows} windows in {per_stretch} frames are too few to tell: give more frames"
            )
        turns.append(_turn(scoring, stretch_windows, sizes_px))
        seen += stretch_windows
    state = np.array([np.mean(turns), *np.ones(len(open_cells))])
    covered: list[int] = []
    for _ in range(_SORTINGS):
        state, covered = _covered(scoring, state, _sorted(scoring, state, seen, sizes_px)[0])
    passed, is_covered = (np.zeros(camera.mask.transmission.shape) for _ in range(2))
    passed[tuple(open_cells.T)] = state[1:]
    is_covered[tuple(open_cells[covered].T)] = 1
    std_deg = float(np.std(turns, ddof=1) / np.sqrt(len(turns))) if len(turns) > 1 else np.inf
    count = sum(len(each.powers) for each in seen)
    return MaskState(float(state[0]), std_deg, passed, is_covered > 0, count)


def _turn(scoring: Scoring, seen: list[Windows], sizes_px: DoubleArray) -> float:
    """Rotation of the mask, degrees, from the windows of a stretch."""
    one_part = [each for each in seen if (each.tangent == seen[0].tangent).all()]
    cells = len(scoring.steps) - 1
    state = min(
        (np.array([degrees, *np.ones(cells)]) for degrees in _TURNS_DEG),
        key=lambda state: _sorted(scoring, state, one_part, sizes_px[::4])[1],
    )
    spread = np.array([_SPREAD_DEG, *scoring.steps[1:]])
    for _ in range(_SORTINGS):
        windows, _ = _sorted(scoring, state, seen, sizes_px)
        count = sum(len(each.powers) for each in windows)
        state, _ = scoring.fit(
            state, windows, spread * np.sqrt(count), lambda _: np.array([0]), _ROUNDS, iter
        )
    return float(state[0])


def _covered(
    scoring: Scoring, state: DoubleArray, windows: list[Windows]
) -> tuple[DoubleArray, list[int]]:
    """State with the fewest covered cells that explains the windows, and these cells.

    Greedy: each is the one that explains most, as all at once they would compensate each other.
    `state` has the light of the cells before.
    """
    most = sorted(windows, key=lambda each: -len(each.powers))[:_GROUPS]
    cells = np.arange(1, len(state))
    open_ = np.array([state[0], *np.ones(len(cells))])
    textures = [scoring.textures(state, each) for each in most]
    _, gradient, information = scoring.derivatives(state, textures, cells)
    # As if every cell were open: where the state is, the gradient has vanished.
    gradient = gradient - information @ (state[1:] - open_[1:])
    chosen: list[int] = []
    moved = np.zeros(0)
    gained = 0.0
    while len(chosen) < _MAX_COVERED:
        tried = [[*chosen, cell] for cell in range(len(cells)) if cell not in chosen]
        gains = [(*_gain(gradient, information, each), each) for each in tried]
        best = max(
            (each for each in gains if each[1][-1] < _COVERED - 1),
            default=None,
            key=lambda each: each[0],
        )
        if best is None or (best[0] - gained) / _REPEATED < _SURE**2:
            break
        gained, moved, chosen = best
    found = open_.copy()
    found[1 + np.array(chosen, int)] = np.clip(1 + moved, 0, 1)
    return found, chosen


def _gain(
    gradient: DoubleArray, information: DoubleArray, cells: list[int]
) -> tuple[float, DoubleArray]:
    """Decrease of the cost if some cells change, and their changes."""
    moved = np.asarray(-np.linalg.solve(information[np.ix_(cells, cells)], gradient[cells]))
    return float(-gradient[cells] @ moved), moved


@dataclasses.dataclass(frozen=True, eq=False)
class _Fitted:
    """PSFs of a camera for a state of its mask: rotation, and light of its cells."""

    camera: Camera
    open_cells: IndexArray

    def psf(self, state: DoubleArray, windows: Windows) -> FloatArray:
        """PSF of some windows."""
        cells = np.array(self.camera.mask.transmission)
        # What derivatives step beyond is the same by scale.
        cells[tuple(self.open_cells.T)] *= state[1:].clip(0) / max(1.0, state[1:].max())
        mask = turned(Mask(self.camera.mask.name, cells), state[0])
        size_px = windows.blur_size_px
        if self.camera.wavefront is None:
            return render_psf(mask, size_px)
        width = psf_width(1.25 * size_px + 4)
        return self.camera.field_psf(mask, size_px, windows.tangent, width)


def _windows(camera: Camera, frames: Iterable[FloatArray]) -> Iterator[Windows]:
    """Windows of every frame and every part of its middle."""
    k = camera.intrinsics.camera_matrix
    parts = field_tangents(camera.intrinsics, *_PARTS) / 2
    left_out = _MIDDLE if camera.wavefront or camera.field_curvature else 0.0
    for grey in frames:
        rows, columns = (int(left_out * length) for length in grey.shape)
        middle = grey[rows : grey.shape[0] - rows, columns : grey.shape[1] - columns]
        powers, noise, middles = window_spectra(np.ascontiguousarray(middle), _STRIDE_PX)
        places = (middles - [k[5] - rows, k[2] - columns]) / [k[4], k[0]]
        part = nearest_part(places[None], parts)[0]
        for number, tangent in enumerate(parts):
            yield Windows(0.0, tangent, powers[part == number], noise)


def _sorted(
    scoring: Scoring, state: DoubleArray, seen: list[Windows], sizes_px: DoubleArray
) -> tuple[list[Windows], float]:
    """Windows sorted by the blur size that explains them best, and the remaining cost of most."""
    found = []
    left = 0.0
    for tangent in {tuple(each.tangent) for each in seen}:
        part_windows = [each for each in seen if tuple(each.tangent) == tangent]
        powers = np.concatenate([each.powers for each in part_windows])
        noise = float(np.median([each.noise for each in part_windows]))
        here = [Windows(float(s), np.array(tangent), powers, noise) for s in sizes_px]
        costs = np.stack([scoring.costs(state, each).min(axis=1) for each in here])
        best = costs.argmin(axis=0)
        least = costs.min(axis=0)
        misfit = least - saturated_cost(powers)
        kept = misfit <= np.quantile(misfit, _KEPT)
        left += float(least[kept].sum())
        for level, each in enumerate(here):
            inside = kept & (best == level)
            if inside.sum() >= _MIN_WINDOWS:
                found.append(dataclasses.replace(each, powers=powers[inside]))
    return found, left
