"""Predicted depth error of a mask with given pictures.

Sharp patches of the pictures are blurred with the mask's PSFs, and the cost of the filter bank
decides which blur level each shows. That is depth estimation of a plane, without learning a bank:
only every second frequency of a window is used, as neighbours share their information.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.predict import SIGMAS, check_sigmas, check_two_colours
from coded_aperture_ros.design.scores.spectra import SceneConfig, seen_spectra
from coded_aperture_ros.frames import transfer_function
from coded_aperture_ros.likelihood import plausible_ratios, take_logarithm
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.hypotheses import RATIOS
from coded_aperture_ros.likelihood.bank.prior import NaturalImagePrior, power_spectrum
from coded_aperture_ros.likelihood.scoring import MIN_NOISE_SHARE
from coded_aperture_ros.optics import Mask, psf_width, render_psf_stack

WINDOW_PX = 96
WINDOWS = 768
# Blur has removed most of the texture above, cycles per pixel.
_HIGHEST = 0.35
# Patches that are blurred at a time: no more memory than needed.
_BLOCK = 64


def patch_side_px(scene: SceneConfig, window_px: int = WINDOW_PX) -> int:
    """Side of sharp patches: a window, and room for the largest PSF around it.

    It is even, and quick to transform.
    """
    least = window_px + psf_width(scene.largest_px)
    return int(2 * scipy.fft.next_fast_len((least + 1) // 2, real=True))


class PictureScorer:
    """Predicts the depth errors of masks with given pictures.

    The patches, float32 [N, side, side], are sharp and grey, 0 to 1; the side is as from
    `patch_side_px`. Each is blurred with one level of the scene, of `true_levels`, which are as
    frequent as each other; its texture is that of the patches, whatever the scene's slope. `sigmas`
    is the noise behind an open aperture (standard deviation, linear light), divided by the light
    that a mask passes. Levels and noise, by `seed`, are the same for every mask.

    An `InputError` if the patches have another shape, there is none, the largest PSF does not fit
    the window, a noise is not above 0, or the scene has motion or diffraction.
    """

    def __init__(
        self,
        patches: FloatArray,
        scene: SceneConfig | None = None,
        sigmas: Sequence[float] = SIGMAS,
        seed: int = 0,
        window_px: int = WINDOW_PX,
    ) -> None:
        self.scene = scene or SceneConfig()
        self.sigmas = tuple(sigmas)
        self.spectra = WindowSpectra(window_px)
        self.side_px = patch_side_px(self.scene, window_px)
        check_sigmas(sigmas)
        for name in ("motion_px", "diffraction_px"):
            if getattr(self.scene, name) > 0:
                raise InputError(
                    f"{name}: not supported by the prediction from pictures: leave it at 0, or "
                    "predict from the mask alone"
                )
        widest = psf_width(self.scene.largest_px)
        if widest > window_px:
            raise InputError(
                f"a PSF of {widest} px does not fit the {window_px} px window: "
                "use a larger window, or smaller blur sizes"
            )
        if len(patches) == 0 or patches.shape[1:] != (self.side_px, self.side_px):
            raise InputError(
                f"patches: expected the shape [N, {self.side_px}, {self.side_px}] for this scene's "
                f"largest blur, got {list(patches.shape)}"
            )
        random = np.random.default_rng(seed)
        count = len(patches)
        self.true_levels = random.permutation(np.arange(count) % self.scene.levels)
        self._sharp = scipy.fft.rfft2(patches.astype(np.float32, copy=False))
        shapes = ((block.stop - block.start, window_px, window_px) for block in _blocks(count))
        white = (random.standard_normal(shape, dtype=np.float32) for shape in shapes)
        self._noise = np.concatenate([self.spectra.transform(windows) for windows in white])

    def depth_error(self, mask: Mask) -> DoubleArray:
        """Mean |level error| of a mask at each noise; raises `InputError` for one colour."""
        check_two_colours(mask)
        psfs = render_psf_stack(mask, self.scene.blur_sizes_px).psfs
        blurred = self._blurred(psfs)
        expected = self.spectra.expected(psfs)
        errors = []
        for sigma in self.sigmas:
            noise = sigma / mask.open_fraction
            power = np.abs(blurred + np.float32(noise) * self._noise) ** 2
            levels = likeliest_levels(self.spectra.cost(power, expected, noise))
            errors.append(np.abs(levels - self.true_levels).mean())
        return np.array(errors)

    def _blurred(self, psfs: FloatArray) -> NDArray[np.complex64]:
        """Spectra of the windows in the middle of blurred patches [N, K]."""
        side = self.side_px
        transfer = np.stack([transfer_function(psf, (side, side)) for psf in psfs])
        margin = (side - self.spectra.window_px) // 2
        middle = slice(margin, margin + self.spectra.window_px)
        blurred = np.empty_like(self._noise)
        for block in _blocks(len(blurred)):
            spectrum = self._sharp[block] * transfer[self.true_levels[block]]
            patches = scipy.fft.irfft2(spectrum, (side, side))
            blurred[block] = self.spectra.transform(patches[:, middle, middle])
        return blurred


class WindowSpectra:
    """Every second frequency of windows, and what the filter bank makes of them.

    `window_px` is even, at least 8; `multiplicity` [K] is how many coefficients of the full
    transform each frequency stands for.
    """

    def __init__(self, window_px: int) -> None:
        fourier = WindowedFourierBasis(window_px, _HIGHEST)
        self.window_px = window_px
        self._window = fourier.window
        multiplicity = fourier.multiplicity.reshape(window_px, -1)[::2, ::2]
        self._counts = multiplicity > 0
        self.multiplicity = multiplicity[self._counts]
        self._prior = NaturalImagePrior()

    def transform(self, windows: FloatArray) -> NDArray[np.complex64]:
        """Spectra [N, K] of windows [N, n, n]; white noise has the power s^2."""
        half = self.window_px // 2
        weighted = windows * (self._window[:, None] * self._window)
        # Every second frequency is what a transform of the sum of both halves has.
        folded = weighted.reshape(-1, 2, half, 2, half).sum(axis=(1, 3))
        return scipy.fft.rfft2(folded)[:, self._counts]

    def expected(self, psfs: FloatArray) -> FloatArray:
        """Power that is expected of the prior's texture behind PSFs [slopes, L, K].

        For unit contrast, with the model error, as `learn_bank` has it. The PSFs [L, k, k] are no
        larger than the window.
        """
        # Two windows wide: what is farther away than a window, no window sees.
        torus = 2 * self.window_px
        transfer = scipy.fft.rfft2(psfs, (torus, torus))
        gain = transfer.real**2 + transfer.imag**2
        window_transform = scipy.fft.rfft(self._window, torus)
        overlap = scipy.fft.irfft(window_transform.real**2 + window_transform.imag**2, torus)
        spectra = []
        for slope in self._prior.slopes:
            # The scale is that of four windows, as in `WindowedFourierBasis.expected_power`.
            texture = power_spectrum(slope, (2 * torus, 2 * torus))[::2, ::2].astype(np.float32)
            # No window sees the mean; without it, rounding is less than the power in the zeros.
            texture[0, 0] = 0
            spectrum = seen_spectra(texture, gain, overlap[:, None] * overlap)[:, ::4, ::4]
            spectra.append(np.maximum(spectrum[:, self._counts], 0))
        return np.array(spectra, np.float32) + np.float32(self._prior.model_error**2)

    def cost(self, power: FloatArray, expected: FloatArray, noise: float) -> FloatArray:
        """Cost of every level for every window [N, L], as the filter bank has it.

        That is twice the negative log-likelihood, over the number of frequencies. `power` [N, K] is
        that of the windows, noise included; `noise` > 0 is a standard deviation, linear light.
        """
        count = self.multiplicity.sum()
        ratios = RATIOS[plausible_ratios(RATIOS, self._prior.contrasts, noise)]
        variances = ratios.astype(np.float32)[:, None, None, None] * expected + 1
        hypotheses = (len(ratios) * len(expected), expected.shape[1])
        determinants = np.exp(np.log(variances) @ self.multiplicity / count).reshape(hypotheses)
        weights = (self.multiplicity / variances).reshape(-1, len(self.multiplicity))
        share = power * np.float32(1 / (count * noise**2))
        excess = (share @ weights.T).reshape(-1, *hypotheses)
        best = ((excess + MIN_NOISE_SHARE) * determinants).min(axis=1)
        textureless = np.asarray(share @ self.multiplicity + MIN_NOISE_SHARE, np.float32)
        return take_logarithm(best.T, textureless, 1.0).T


def likeliest_levels(cost: FloatArray) -> DoubleArray:
    """Level [N] of least cost [N, L], or the middle one where all cost the same."""
    middle = (cost.shape[1] - 1) / 2
    undecided = cost.max(axis=1) == cost.min(axis=1)
    return np.where(undecided, middle, cost.argmin(axis=1)).astype(np.float64)


def _blocks(count: int) -> Iterator[slice]:
    for start in range(0, count, _BLOCK):
        yield slice(start, min(start + _BLOCK, count))
