"""Whether the mask has turned in its lens, and which of its cells are covered."""

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
_STRIDE_PX, _MIDDLE, _PARTS = 32, 0.25, (2, 2)
_LEVELS, _LEAST_BLUR_PX = 32, 2.5
# Windows that fit worst are of edges and of what moves; fewer of one PSF say little.
_KEPT, _FEWEST = 0.8, 4
_STRETCHES, _FEWEST_WINDOWS = 4, 120
_FINE = 8
# Degrees that a mask may have turned where nothing tells.
_SPREAD_DEG = 3.0
_STEP_DEG, _STEP = 0.25, 0.05
_TURNS_DEG = np.arange(-8.0, 8.1, 2.0)
_SORTINGS, _ROUNDS = 2, 3
# Windows overlap, and so do what they tell of neighbouring frequencies.
_REPEATED = 4.0
_SURE, _COVERED, _MOST_COVERED = 5.0, 0.3, 6
# That many PSFs tell about cells: those with the most windows.
_GROUPS = 12


@dataclasses.dataclass(frozen=True, eq=False)
class MaskState:
    """A mask as it sits in the lens.

    Attributes
    ----------
    turned_deg, std_deg : float
        Clockwise, as the camera file's picture shows it.
    passed : ndarray, float64 [n, m]
        Which share each open cell of the mask passes of what it did; 0 where it is closed.
    covered : ndarray, bool [n, m]
        Cells that pass less than a third. Of a mask that is its own half turn, it may be the cell
        on the other side of the middle: power spectra do not tell.
    windows : int
        How many windows tell.
    """

    turned_deg: float
    std_deg: float
    passed: DoubleArray
    covered: BoolArray
    windows: int

    def mask(self, mask: Mask) -> Mask:
        """Return the mask as it is now."""
        return turned(
            Mask(mask.name, (mask.transmission * self.passed).astype(np.float32)), self.turned_deg
        )


def turned(mask: Mask, degrees: float) -> Mask:
    """Return a mask turned clockwise, on a finer grid."""
    if not degrees:
        return mask
    cells = np.kron(mask.transmission, np.ones((_FINE, _FINE), np.float32))
    middle = (cells.shape[1] - 1) / 2, (cells.shape[0] - 1) / 2
    turn = cv2.getRotationMatrix2D(middle, -degrees, 1.0)
    return Mask(mask.name, cv2.warpAffine(cells, turn, cells.shape[::-1]).clip(0, 1))


def fit_mask(
    camera: Camera, frames: Sequence[FloatArray], largest_px: float, progress: Progress
) -> MaskState:
    """Fit how the mask is turned, and what its cells pass, to windows of unknown depth.

    Textures with a direction bend what a stretch of a video says. So each of four stretches is
    asked for the turn by itself: how they scatter is how far to trust it.

    Parameters
    ----------
    camera : Camera
        As it was set up.
    frames : sequence of ndarray, float32 [rows, columns]
        Grey, linear light, in order.
    largest_px : float
        Largest blur size that there may be.
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
    sizes_px = np.linspace(_LEAST_BLUR_PX, largest_px, _LEVELS)
    turns, seen = [], list[Windows]()
    for first in progress(range(0, len(frames), per_stretch)):
        of_stretch = list(_windows(camera, frames[first : first + per_stretch]))
        windows = sum(len(each.powers) for each in of_stretch)
        if windows < _FEWEST_WINDOWS:
            raise InputError(
                f"{windows} windows in {per_stretch} frames are too few to tell: give more frames"
            )
        turns.append(_turn(scoring, of_stretch, sizes_px))
        seen += of_stretch
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
    """Return how far the mask is turned, in degrees, by the windows of a stretch."""
    of_one_part = [each for each in seen if (each.tangent == seen[0].tangent).all()]
    cells = len(scoring.steps) - 1
    state = min(
        (np.array([degrees, *np.ones(cells)]) for degrees in _TURNS_DEG),
        key=lambda state: _sorted(scoring, state, of_one_part, sizes_px[::4])[1],
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
    """Return the state with the fewest cells covered that explain the windows, and these cells.

    One after the other, each the one that explains most: all at once they would make up for each
    other. `state` says what they passed before.
    """
    most = sorted(windows, key=lambda each: -len(each.powers))[:_GROUPS]
    cells = np.arange(1, len(state))
    open_ = np.array([state[0], *np.ones(len(cells))])
    textures = [scoring.textures(state, each) for each in most]
    _, gradient, information = scoring.derivatives(state, textures, cells)
    # As if every cell were open: where the state is, the gradient has vanished.
    gradient = gradient - information @ (state[1:] - open_[1:])
    chosen: list[int] = []
    moved, gained = np.zeros(0), 0.0
    while len(chosen) < _MOST_COVERED:
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
    """Return by how much the cost falls if some cells change, and how they do."""
    moved = np.asarray(-np.linalg.solve(information[np.ix_(cells, cells)], gradient[cells]))
    return float(-gradient[cells] @ moved), moved


@dataclasses.dataclass(frozen=True, eq=False)
class _Fitted:
    """The PSFs of a camera whose mask is in a state: how far turned, and what its cells pass."""

    camera: Camera
    open_cells: IndexArray

    def psf(self, state: DoubleArray, windows: Windows) -> FloatArray:
        """Return the PSF of some windows."""
        cells = np.array(self.camera.mask.transmission)
        # What derivatives step beyond is the same by scale.
        cells[tuple(self.open_cells.T)] *= state[1:].clip(0) / max(1.0, state[1:].max())
        mask, size_px = turned(Mask(self.camera.mask.name, cells), state[0]), windows.blur_size_px
        if self.camera.wavefront is None:
            return render_psf(mask, size_px)
        width = psf_width(1.25 * size_px + 4)
        return self.camera.field_psf(mask, size_px, windows.tangent, width)


def _windows(camera: Camera, frames: Iterable[FloatArray]) -> Iterator[Windows]:
    """Yield the windows of every frame and every part of its middle."""
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
    """Return windows sorted by the blur size that explains them best, and what is left, of most."""
    found, left = [], 0.0
    for tangent in {tuple(each.tangent) for each in seen}:
        of_part = [each for each in seen if tuple(each.tangent) == tangent]
        powers = np.concatenate([each.powers for each in of_part])
        noise = float(np.median([each.noise for each in of_part]))
        here = [Windows(float(s), np.array(tangent), powers, noise) for s in sizes_px]
        costs = np.stack([scoring.costs(state, each).min(axis=1) for each in here])
        best, least = costs.argmin(axis=0), costs.min(axis=0)
        misfit = least - saturated_cost(powers)
        kept = misfit <= np.quantile(misfit, _KEPT)
        left += float(least[kept].sum())
        for level, each in enumerate(here):
            inside = kept & (best == level)
            if inside.sum() >= _FEWEST:
                found.append(dataclasses.replace(each, powers=powers[inside]))
    return found, left
