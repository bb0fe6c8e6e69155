"""Learning a filter bank from pictures of textured planes, without knowing the mask.

The energies of a bank need nothing of a PSF but its autocorrelation, and the PSFs of all depths
are one mask, scaled. So one mask and one focus distance are sought under which the pictures are
likeliest, by the same likelihood with which the bank will judge patches later (thesis 6.2.1
learns from planes too, but a subspace for each of them on its own).

The likelihood of a single mask has many local maxima, because power spectra have no phases. A
mixture of a few masks, whose autocorrelations add up, has the same power spectra to offer and is
easy to climb. The bank is computed from the mixture. Only for deblurring, a single mask of that
autocorrelation is sought afterwards; its orientation (as found or rotated by 180 degrees) is
beyond what power spectra tell.
"""

import dataclasses
import itertools
import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.fft
import scipy.optimize
from numpy.typing import NDArray

from coded_aperture_ros.bank.bank import FilterBank
from coded_aperture_ros.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.bank.learn import LearnConfig, check_levels, learn_bank
from coded_aperture_ros.bank.prior import NaturalImagePrior, power_spectrum
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.images import Gamma, read_image
from coded_aperture_ros.optics import Mask, psf_width, render_psf_stack

PLANES_FILE = "planes.json"
_FEWEST = 4
_SATURATED = 0.995
_MOST_SATURATED = 0.01
# A window has texture if its power, relative to the noise, is at least this.
_TEXTURE_OVER_NOISE = 4.0
_LEAST_TEXTURED = 0.2
# Real pictures are not cleaner than this.
_LEAST_NOISE = 2e-4

# The fit looks for masks of at most this part of the window: a wider blur leaves too few
# independent frequencies in it.
_WIDEST = 0.5
_SLOPES = (1.6, 2.4, 3.2)
_CONTRASTS = 10.0 ** np.arange(-5, -0.9, 0.25)
_MODEL_ERROR = 3e-4
# Weight that holds the textures to the power laws, relative to a likelihood of one per frequency.
_STIFFNESS = 1e-3
# Curvatures of the likelihood differ: in these units the focus is as soft as the mask's cells.
_FOCUS_UNIT = 0.02
_COARSE_CELL_PX, _FINE_CELL_PX = 2.0, 1.0
_COARSE_STEPS, _FINE_STEPS, _FINE_ROUNDS = 30, 100, 3
_NEAREST_TO_FOCUS = (0.03, 0.15, 0.35, 0.6)
# Many starts for phase retrieval are cheap; the best of them are worth some steps each.
_RETRIEVALS, _CANDIDATES, _SINGLE_STEPS = 60, 4, 60


@dataclasses.dataclass(frozen=True, eq=False)
class Planes:
    """Pictures of textured planes parallel to the sensor, one for each depth.

    Attributes
    ----------
    images : tuple of ndarray, float32 [rows, columns] or [rows, columns, 3]
        Linear light in [0, 1], all of one size.
    depths_m : ndarray, float64 [I]
        Depth of each plane, in any order; they are sorted, nearest first.
    names : tuple of str
        What to call each picture in messages.

    Raises
    ------
    InputError
        If there are fewer than four planes, sizes differ, a depth is not positive or not the only
        one of its value, or a picture is saturated or not finite.
    """

    images: tuple[NDArray[np.float32], ...]
    depths_m: NDArray[np.float64]
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        depths = np.asarray(self.depths_m, np.float64)
        if not len(self.images) == len(depths) == len(self.names):
            raise InputError("planes: expected one depth and one name for each picture")
        if len(depths) < _FEWEST:
            raise InputError(
                f"{len(depths)} planes are too few to tell the mask from the textures: "
                f"take at least {_FEWEST}, better 10 or more, at different depths"
            )
        for image, depth, name in zip(self.images, depths, self.names, strict=True):
            _check_picture(image, float(depth), name, self.images[0].shape[:2], self.names[0])
        order = np.argsort(depths)
        for first, second in itertools.pairwise(order):
            if depths[first] == depths[second]:
                raise InputError(
                    f"{self.names[second]}: depth_m {depths[second]:g} is also that of "
                    f"{self.names[first]}: keep one picture for each depth"
                )
        object.__setattr__(self, "images", tuple(self.images[i] for i in order))
        object.__setattr__(self, "names", tuple(self.names[i] for i in order))
        object.__setattr__(self, "depths_m", depths[order])

    @classmethod
    def load(cls, folder: str | os.PathLike[str], gamma: Gamma = 1.0) -> "Planes":
        """Read the planes that `planes.json` in a folder lists with `file` and `depth_m`.

        8-bit pictures are decoded with `gamma`; wider ones are linear.

        Raises
        ------
        InputError
            Naming the file and what is wrong with it; see also `Planes`.
        """
        listing = Path(folder) / PLANES_FILE
        try:
            entries = json.loads(listing.read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(
                f"cannot read {listing}: {error.strerror}: the folder needs a list of its "
                'pictures, [{"file": "a.png", "depth_m": 1.5}, ...]'
            ) from error
        except ValueError as error:
            raise InputError(f"{listing}: not JSON: {error}") from error
        if not isinstance(entries, list):
            raise InputError(f'{listing}: expected a list [{{"file": ..., "depth_m": ...}}, ...]')
        listed = [_entry(listing, number, entry) for number, entry in enumerate(entries)]
        return cls(
            images=tuple(read_image(path, gamma) for path, _ in listed),
            depths_m=np.array([depth for _, depth in listed]),
            names=tuple(str(path) for path, _ in listed),
        )


def _entry(listing: Path, number: int, entry: Any) -> tuple[Path, float]:
    if not isinstance(entry, dict):
        raise InputError(f"{listing}: entry {number}: expected file and depth_m, got {entry!r}")
    for key, kinds in (("file", str), ("depth_m", (int, float))):
        if key not in entry:
            raise InputError(f"{listing}: entry {number} has no {key}")
        if not isinstance(entry[key], kinds) or isinstance(entry[key], bool):
            raise InputError(f"{listing}: entry {number}: {key} cannot be {entry[key]!r}")
    return listing.parent / entry["file"], float(entry["depth_m"])


def _check_picture(
    image: NDArray[np.float32],
    depth_m: float,
    name: str,
    shape: tuple[int, ...],
    first: str,
) -> None:
    if not 0 < depth_m < np.inf:
        raise InputError(f"{name}: depth_m {depth_m:g} is not a positive distance in metres")
    if image.shape[:2] != shape:
        raise InputError(
            f"{name}: {image.shape[1]}x{image.shape[0]} px, but {first} has "
            f"{shape[1]}x{shape[0]} px: all planes have to come from one camera"
        )
    if not np.isfinite(image).all():
        raise InputError(f"{name}: has pixels that are NaN or infinite")
    saturated = float(np.mean(image >= _SATURATED))
    if saturated > _MOST_SATURATED:
        raise InputError(
            f"{name}: {saturated:.0%} of the pixels are saturated: expose it for a shorter time"
        )


def learn_bank_from_planes(
    planes: Planes,
    levels: int = 30,
    config: LearnConfig | None = None,
    prior: NaturalImagePrior | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> FilterBank:
    """Learn the bank of a camera whose mask is not known from pictures of planes.

    Parameters
    ----------
    planes : Planes
        All on one side of the focal plane, with texture everywhere; ten or more that are equally
        spaced in inverse depth are better than a few.
    levels : int, optional
        Number of levels, equally spaced in blur size between the nearest and the farthest plane;
        at least 2.
    config : LearnConfig, optional
        The window has to be twice as wide as the largest blur.
    prior : NaturalImagePrior, optional
        For the bank; the fit has a more flexible one.
    progress : callable, optional
        Wraps the iteration over the steps of the fit, as ``tqdm.tqdm`` does.

    Returns
    -------
    FilterBank
        With depths. Its PSFs are those of one mask that has about the autocorrelation found;
        their orientation is a guess. Blur sizes are the extent of that mask in px; the bank does
        not go together with a camera file, whose mask is another one.

    Raises
    ------
    InputError
        If a plane has no texture above its noise, or is smaller than the window.
    """
    check_levels(levels)
    config = config or LearnConfig()
    fit = fit_planes(planes, config.window_px, progress)
    mask, extent = single_mask(fit, planes, config.window_px, progress)
    share = extent / fit.extent_px
    largest = np.linspace(*fit.size_range_px, levels)
    stack = render_psf_stack(mask, fit.sign * largest * share)
    stack = dataclasses.replace(stack, depths_m=fit.depths_m(largest))
    components = [
        render_psf_stack(Mask("part", part / part.max()), largest).psfs * part.sum()
        for part in fit.parts
    ]
    return learn_bank(
        stack,
        config,
        prior,
        learned_from=f"{len(planes.names)} planes at {planes.depths_m[0]:g} to "
        f"{planes.depths_m[-1]:g} m, focus found at {fit.focus_distance_m:.3g} m",
        mask=mask,
        components=np.array(components),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class PlanesFit:
    """What explains the pictures of planes.

    Attributes
    ----------
    parts : ndarray, float64 [R, m, m]
        Masks whose autocorrelations add up to that of the mask; their squared sums add up to one.
    near_ratio : float
        Blur size of the least blurred plane over that of the most blurred one, in [0, 1).
    sign : int
        1 if the planes lie beyond the focal plane, -1 if in front of it.
    extent_px : float
        Width of the grid of cells at the most blurred plane, px.
    inverse_depths : ndarray, float64 [I]
        Of the planes, 1/m, in the order of their depths.
    log_noise : ndarray, float64 [I]
        Logarithm of the variance of every plane's noise, with what the model leaves unexplained.
    score : float
        Twice the negative log-likelihood of a window, on average.
    """

    parts: NDArray[np.float64]
    near_ratio: float
    sign: int
    extent_px: float
    inverse_depths: NDArray[np.float64]
    log_noise: NDArray[np.float64]
    score: float

    @property
    def size_range_px(self) -> tuple[float, float]:
        """Unsigned blur sizes of the nearest and of the farthest plane."""
        sizes = self.near_ratio * self.extent_px, self.extent_px
        return sizes if self.sign > 0 else sizes[::-1]

    @property
    def _most_and_least_blurred(self) -> tuple[float, float]:
        """Inverse depths of the two planes."""
        near, far = self.inverse_depths[0], self.inverse_depths[-1]
        return (far, near) if self.sign > 0 else (near, far)

    @property
    def focus_distance_m(self) -> float:
        """Where the blur would vanish; infinite if it does so nowhere in front of the camera."""
        most, least = self._most_and_least_blurred
        inverse = (least - self.near_ratio * most) / (1 - self.near_ratio)
        return float(1 / inverse) if inverse > 0 else np.inf

    def depths_m(self, sizes_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Depths of unsigned blur sizes of the grid: inverse depth is linear in blur size."""
        most, least = self._most_and_least_blurred
        towards_focus = (1 - sizes_px / self.extent_px) / (1 - self.near_ratio)
        return np.asarray(1 / (most + (least - most) * towards_focus))


def fit_planes(
    planes: Planes,
    window_px: int,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> PlanesFit:
    """Find the mask (as a mixture) and the focus under which the planes are likeliest.

    Coarse masks first, from several focus distances on both sides of the planes; the likeliest
    is refined.

    Raises
    ------
    InputError
        See `learn_bank_from_planes`.
    """
    likelihood = _likelihood_of(planes, window_px)
    starts = [(sign, ratio) for sign in (1, -1) for ratio in _NEAREST_TO_FOCUS]
    best: PlanesFit | None = None
    for step in progress([*starts, *range(_FINE_ROUNDS)]):
        if isinstance(step, tuple):
            sign, ratio = step
            start = _blobs(2, round(likelihood.extent_px / _COARSE_CELL_PX))
            found = likelihood.climb(likelihood.start(start, ratio, sign), _COARSE_STEPS)
            if best is None or found.score < best.score:
                best = found
        elif best is not None:
            # The finer masks start afresh: the coarse ones' cells would stay visible.
            if step == 0:
                blobs = _blobs(3, round(likelihood.extent_px / _FINE_CELL_PX))
                best = likelihood.start(blobs, best.near_ratio, best.sign)
            best = likelihood.climb(best, _FINE_STEPS)
    assert best is not None  # there are starts
    return best


def _likelihood_of(planes: Planes, window_px: int) -> "_Likelihood":
    fourier = WindowedFourierBasis(window_px)
    powers = [
        _textured_power(fourier, image, name)
        for image, name in zip(planes.images, planes.names, strict=True)
    ]
    return _Likelihood(powers, 1 / planes.depths_m, fourier, _WIDEST * window_px)


def _textured_power(
    fourier: WindowedFourierBasis, image: NDArray[np.float32], name: str
) -> NDArray[np.float32]:
    """Return the power spectra of a plane's windows [W, K]; refuse a plane without texture."""
    grey = image if image.ndim == 2 else image.mean(axis=2, dtype=np.float32)
    try:
        power, _ = fourier.project(
            np.ascontiguousarray(grey, np.float32),
            fourier.window_px // 4,
            np.eye(fourier.size, dtype=np.float32),
        )
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    power = power.reshape(-1, fourier.size)
    noise = max(float(np.quantile(power @ fourier.noise_weights, 0.05)), _LEAST_NOISE**2)
    mean_power = power @ fourier.multiplicity / fourier.multiplicity.sum()
    textured = np.mean(mean_power > _TEXTURE_OVER_NOISE * noise)
    if not textured >= _LEAST_TEXTURED:
        contrast = np.sqrt(max(float(np.median(mean_power)) - noise, 0.0))
        raise InputError(
            f"{name}: contrast {contrast:.2g} is not above the noise of {np.sqrt(noise):.2g} in "
            f"{1 - textured:.0%} of the picture: use a page with fine texture all over, and "
            "more light"
        )
    return power


def _blobs(count: int, cells: int) -> NDArray[np.float64]:
    """Return random masks, brightest in their middle, to start from [count, cells, cells]."""
    x = (np.arange(cells) + 0.5) / cells - 0.5
    blob = np.exp(-(x[:, None] ** 2 + x**2) / (2 * 0.3**2))
    return blob * np.random.default_rng(0).uniform(size=(count, cells, cells)) ** 2


def _normalised(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale masks so that their autocorrelations together have unit sum."""
    return np.asarray(parts / np.sqrt(np.sum(parts.sum(axis=(1, 2)) ** 2)))


class _Likelihood:
    """The likelihood of the planes' spectra, as a function of mask and focus.

    Windows that the same hypothesis about contrast and slope explains best are averaged; the
    averages are all that the likelihood depends on while the hypotheses stay. Every average has
    its own texture: the hypothesis' power law times a smooth function of frequency.
    """

    def __init__(
        self,
        powers: list[NDArray[np.float32]],
        inverse_depths: NDArray[np.float64],
        fourier: WindowedFourierBasis,
        extent_px: float,
    ) -> None:
        self.counts = fourier.multiplicity > 0
        self.multiplicity = fourier.multiplicity[self.counts].astype(np.float64)
        self.powers = [power[:, self.counts].astype(np.float64) for power in powers]
        self.inverse_depths = inverse_depths
        self.extent_px = extent_px
        self.width = psf_width(extent_px)
        self.lags = _half_plane(self.width - 1)
        self.operators = np.array(
            [_autocorrelation_to_power(fourier, slope, self.lags)[self.counts] for slope in _SLOPES]
        )
        self.texture = _smooth_functions(fourier.window_px)[:, self.counts]
        self.first_noise = np.log(
            [max(np.quantile(p @ fourier.noise_weights, 0.05), 1e-9) for p in powers]
        )

    def start(self, parts: NDArray[np.float64], near_ratio: float, sign: int) -> PlanesFit:
        """Return a first guess."""
        return PlanesFit(
            _normalised(parts), near_ratio, sign, self.extent_px, self.inverse_depths,
            self.first_noise, np.inf,
        )  # fmt: skip

    def climb(self, fit: PlanesFit, steps: int) -> PlanesFit:
        """Choose hypotheses, then improve mask and focus by quasi-Newton steps."""
        groups = self._group(fit)
        variables = [
            (fit.parts / fit.parts.max()).ravel(),
            groups.textures.ravel(),
            fit.log_noise,
            [fit.near_ratio / _FOCUS_UNIT],
        ]
        lengths = [len(values) for values in variables]
        bounds = [(0, None), (None, None), (-20, 0), (0, 0.95 / _FOCUS_UNIT)]
        result = scipy.optimize.minimize(
            self._value_and_gradient,
            np.concatenate(variables),
            args=(groups, fit.parts.shape, fit.sign),
            jac=True,
            method="L-BFGS-B",
            bounds=[bound for bound, n in zip(bounds, lengths, strict=True) for _ in range(n)],
            options={"maxiter": steps, "maxcor": 40, "ftol": 1e-12},
        )
        improved = dataclasses.replace(
            fit,
            parts=_normalised(result.x[: lengths[0]].reshape(fit.parts.shape)),
            log_noise=result.x[-len(self.powers) - 1 : -1],
            near_ratio=float(result.x[-1] * _FOCUS_UNIT),
        )
        return dataclasses.replace(improved, score=self._group(improved).score)

    def _sizes(self, near_ratio: float, sign: int) -> tuple[NDArray, NDArray]:
        """Unsigned blur size of every plane [I], px, and its derivative by the ratio."""
        v = self.inverse_depths
        towards_focus = (v - v.min()) / np.ptp(v)
        if sign < 0:
            towards_focus = 1 - towards_focus
        return (
            self.extent_px * (1 - (1 - near_ratio) * towards_focus),
            self.extent_px * towards_focus,
        )

    def _expected(self, parts: NDArray, sizes: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return the power [slopes, I, K] of unit texture, the PSFs' transforms, the renderers."""
        renderers = np.array([_renderer(self.width, parts.shape[-1], size) for size in sizes])
        psfs = np.einsum("ipa,rab,iqb->ripq", renderers, parts, renderers, optimize=True)
        torus = (2 * self.width, 2 * self.width)
        transforms = scipy.fft.rfft2(psfs, torus)
        correlations = scipy.fft.irfft2((np.abs(transforms) ** 2).sum(axis=0), torus)
        correlations = correlations[:, self.lags[:, 0], self.lags[:, 1]]
        expected = np.array([correlations @ operator.T for operator in self.operators])
        return np.maximum(expected, 0) + _MODEL_ERROR**2, transforms, renderers

    def _group(self, fit: PlanesFit) -> "_Groups":
        """Give every window its best hypothesis, and average the windows that share one."""
        expected = self._expected(fit.parts, self._sizes(fit.near_ratio, fit.sign)[0])[0]
        plane, slope, contrast, count, mean = [], [], [], [], []
        score = 0.0
        for i, powers in enumerate(self.powers):
            variance = _CONTRASTS[:, None, None] * expected[:, i] + np.exp(fit.log_noise[i])
            weights = (self.multiplicity / variance).reshape(-1, variance.shape[-1])
            energies = powers @ weights.T + (np.log(variance) @ self.multiplicity).ravel()
            best = energies.argmin(axis=1)
            score += energies.min(axis=1).mean() / len(self.powers)
            for hypothesis in np.unique(best):
                members = best == hypothesis
                plane.append(i)
                contrast.append(hypothesis // len(_SLOPES))
                slope.append(hypothesis % len(_SLOPES))
                count.append(members.sum())
                mean.append(powers[members].mean(axis=0))
        textures = np.zeros((len(plane), len(self.texture)))
        textures[:, 0] = np.log(_CONTRASTS[contrast])
        groups = _Groups(
            np.array(plane), np.array(slope), np.array(count, float), np.array(mean), textures,
            score,
        )  # fmt: skip
        return self._with_own_textures(groups, expected, fit.log_noise)

    def _with_own_textures(
        self, groups: "_Groups", expected: NDArray, log_noise: NDArray
    ) -> "_Groups":
        """Fit the texture of every group to its mean, by Fisher scoring."""
        weights = groups.count[:, None] * self.multiplicity
        stiffness = np.full(len(self.texture), 2 * _STIFFNESS * weights.sum() / len(weights))
        stiffness[0] = 0
        textures = groups.textures
        noise = np.exp(log_noise)[groups.plane, None]
        for _ in range(12):
            signal = np.exp(textures @ self.texture) * expected[groups.slope, groups.plane]
            total = signal + noise
            excess = weights * (1 / total - groups.mean / total**2) * signal
            gradient = excess @ self.texture.T + stiffness * textures
            curvature = np.einsum(
                "gk,ik,jk->gij",
                weights * (signal / total) ** 2,
                self.texture,
                self.texture,
                optimize=True,
            )
            curvature += np.diag(stiffness + 1e-6)
            step = np.linalg.solve(curvature, gradient[..., None])[..., 0]
            textures = textures - np.clip(step, -0.5, 0.5)
        return dataclasses.replace(groups, textures=textures)

    def _value_and_gradient(
        self, x: NDArray, groups: "_Groups", shape: tuple[int, ...], sign: int
    ) -> tuple[float, NDArray]:
        """Mean over all frequencies of ``P / V + log V`` (and stiffness), with its gradient."""
        cells, planes = int(np.prod(shape)), len(self.powers)
        textures = x[cells : -planes - 1].reshape(groups.textures.shape)
        noise = np.exp(x[-planes - 1 : -1])
        sums = x[:cells].reshape(shape).sum(axis=(1, 2))
        norm = np.sqrt(np.sum(sums**2))
        parts = x[:cells].reshape(shape) / norm
        sizes, size_slopes = self._sizes(x[-1] * _FOCUS_UNIT, sign)
        expected, transforms, renderers = self._expected(parts, sizes)

        gain = np.exp(textures @ self.texture)
        signal = gain * expected[groups.slope, groups.plane]
        total = signal + noise[groups.plane, None]
        weights = groups.count[:, None] * self.multiplicity
        weights /= weights.sum()
        stiffness = _STIFFNESS / len(textures)
        value = np.sum(weights * (groups.mean / total + np.log(total)))
        value += stiffness * np.sum(textures[:, 1:] ** 2)

        by_total = weights * (1 / total - groups.mean / total**2)
        by_textures = (by_total * signal) @ self.texture.T
        by_textures[:, 1:] += 2 * stiffness * textures[:, 1:]
        by_noise = np.bincount(groups.plane, by_total.sum(axis=1), planes) * noise
        by_expected = np.zeros_like(expected)
        np.add.at(by_expected, (groups.slope, groups.plane), gain * by_total)
        by_parts, by_sizes = self._back(by_expected, parts, sizes, transforms, renderers)
        by_parts -= np.sum(by_parts * parts) * (sums / norm)[:, None, None]
        gradient = [
            by_parts.ravel() / norm,
            by_textures.ravel(),
            by_noise,
            [by_sizes @ size_slopes * _FOCUS_UNIT],
        ]
        return float(value), np.concatenate(gradient)

    def _back(
        self,
        by_expected: NDArray,
        parts: NDArray,
        sizes: NDArray,
        transforms: NDArray,
        renderers: NDArray,
    ) -> tuple[NDArray, NDArray]:
        """Return derivatives by parts and sizes from those by power: `_expected` backwards."""
        by_lag = np.einsum("sik,skl->il", by_expected, self.operators, optimize=True) / 2
        torus = 2 * self.width
        by_correlation = np.zeros((len(sizes), torus, torus))
        by_correlation[:, self.lags[:, 0], self.lags[:, 1]] += by_lag
        by_correlation[:, -self.lags[:, 0], -self.lags[:, 1]] += by_lag
        by_psf = scipy.fft.irfft2(scipy.fft.rfft2(by_correlation) * transforms, (torus, torus))
        by_psf = 2 * by_psf[..., : self.width, : self.width]
        by_parts = np.einsum("ipa,ripq,iqb->rab", renderers, by_psf, renderers, optimize=True)
        # A renderer is piecewise smooth in the size; a difference is as good as its derivative.
        step = 5e-3
        cells = parts.shape[-1]
        slopes = np.array(
            [
                _renderer(self.width, cells, size + step)
                - _renderer(self.width, cells, size - step)
                for size in sizes
            ]
        ) / (2 * step)
        by_sizes = np.einsum(
            "ripq,ipa,rab,iqb->i", by_psf, slopes, parts, renderers, optimize=True
        ) + np.einsum("ripq,ipa,rab,iqb->i", by_psf, renderers, parts, slopes, optimize=True)
        return by_parts, by_sizes


@dataclasses.dataclass(frozen=True, eq=False)
class _Groups:
    """Windows that share a hypothesis: plane, slope, how many, mean power [G, K], texture."""

    plane: NDArray
    slope: NDArray
    count: NDArray
    mean: NDArray
    textures: NDArray
    score: float


def _renderer(pixels: int, cells: int, size_px: float) -> NDArray[np.float64]:
    """Share of every cell's light that falls onto each pixel, one axis [pixels, cells]."""
    cell_px = max(size_px, 1e-3) / cells
    pixel_edges = np.arange(pixels + 1)[:, None] - pixels / 2
    cell_edges = (np.arange(cells + 1) - cells / 2) * cell_px
    return np.diff(np.clip(pixel_edges, cell_edges[:-1], cell_edges[1:]), axis=0) / cell_px


def _half_plane(reach: int) -> NDArray[np.intp]:
    """One of each pair of opposite lags up to `reach` [lags, 2]."""
    rows, columns = np.mgrid[-reach : reach + 1, : reach + 1]
    kept = (columns > 0) | (rows >= 0)
    return np.stack([rows[kept], columns[kept]], axis=1)


def _autocorrelation_to_power(
    fourier: WindowedFourierBasis, slope: float, lags: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Return the matrix [K, lags] from a PSF's autocorrelation to a window's expected power.

    The same as `WindowedFourierBasis.expected_power`, written as what it is: linear.
    """
    n = fourier.window_px
    period = 4 * n
    torus = (period, period)
    covariance = scipy.fft.irfft2(power_spectrum(slope, torus), torus)
    window = scipy.fft.irfft(np.abs(scipy.fft.rfft(fourier.window, period)) ** 2, period)
    here = np.arange(-n, n)
    overlap = np.outer(window[here], window[here])
    columns = np.empty((fourier.size, len(lags)))
    for column, (row, across) in enumerate(lags):
        shifted = covariance[np.ix_((here - row) % period, (here - across) % period)]
        if row or across:  # and the opposite lag
            shifted = shifted + covariance[np.ix_((here + row) % period, (here + across) % period)]
        folded = (shifted * overlap).reshape(2, n, 2, n).sum(axis=(0, 2))
        columns[:, column] = scipy.fft.rfft2(folded).real.ravel()
    return columns


def _smooth_functions(window_px: int) -> NDArray[np.float64]:
    """Smooth functions of frequency [9, K] by which textures depart from power laws."""
    vertical = np.fft.fftfreq(window_px)[:, None]
    horizontal = np.fft.rfftfreq(window_px)
    radius = np.hypot(vertical, horizontal)
    radius[0, 0] = 1 / window_px
    angle = np.arctan2(vertical, horizontal)
    scale = np.log(radius / 0.15)
    directions = [np.cos(2 * angle), np.sin(2 * angle), np.cos(4 * angle)]
    functions = [np.ones_like(scale), scale, scale**2, *directions]
    functions += [direction * scale for direction in directions]
    return np.reshape(functions, (len(functions), -1))


def single_mask(
    fit: PlanesFit,
    planes: Planes,
    window_px: int,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> tuple[Mask, float]:
    """Find one mask instead of a mixture: the likeliest of several that come close to it.

    Returns
    -------
    mask : Mask
        Cropped to where it is open.
    extent_px : float
        Its extent at the most blurred plane.
    """
    likelihood = _likelihood_of(planes, window_px)
    candidates = [
        likelihood.climb(dataclasses.replace(fit, parts=_normalised(mask[None])), _SINGLE_STEPS)
        for mask in progress(_retrieved_masks(fit.parts))
    ]
    opening = _cropped(min(candidates, key=lambda candidate: candidate.score).parts[0])
    extent_px = fit.extent_px * len(opening) / fit.parts.shape[-1]
    return Mask("learned from planes", opening / opening.max()), extent_px


def _retrieved_masks(parts: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Find masks whose autocorrelations are about the sum of those of the parts.

    Phase retrieval for a non-negative mask of limited support, the best of many random starts.
    """
    cells = parts.shape[-1]
    torus = (2 * cells, 2 * cells)
    wanted = scipy.fft.irfft2((np.abs(scipy.fft.rfft2(parts, torus)) ** 2).sum(axis=0), torus)

    def misfit(x: NDArray) -> tuple[float, NDArray]:
        transform = scipy.fft.rfft2(x.reshape(cells, cells), torus)
        error = scipy.fft.irfft2(np.abs(transform) ** 2, torus) - wanted
        slope = scipy.fft.irfft2(scipy.fft.rfft2(error) * transform, torus)[:cells, :cells]
        return 1e4 * float(np.sum(error**2)), 4e4 * slope.ravel()

    random = np.random.default_rng(0)
    found = []
    for _ in range(_RETRIEVALS):
        start = random.uniform(size=cells**2) ** 2
        found.append(
            scipy.optimize.minimize(
                misfit, start / start.sum(), jac=True, method="L-BFGS-B",
                bounds=[(0, None)] * cells**2, options={"maxiter": 300},
            )
        )  # fmt: skip
    found.sort(key=lambda result: float(result.fun))
    return [np.asarray(result.x).reshape(cells, cells) for result in found[:_CANDIDATES]]


def _cropped(mask: NDArray[np.float64], darkest: float = 0.2) -> NDArray[np.float64]:
    """Crop to the square around the rows and columns with more than `darkest` of the brightest."""
    ranges = []
    for axis in (0, 1):
        profile = mask.sum(axis=axis)
        light = np.flatnonzero(profile > darkest * profile.max())
        ranges.append((light[0], light[-1] + 1))
    (left, right), (top, bottom) = ranges
    side = max(right - left, bottom - top)
    square = np.zeros((side, side))
    above, before = (side - (bottom - top)) // 2, (side - (right - left)) // 2
    inside = mask[top:bottom, left:right]
    square[above : above + inside.shape[0], before : before + inside.shape[1]] = inside
    return square
