"""The filter bank: energies of every blur level for every patch of a frame."""

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.bank.pattern import LearnedPattern
from coded_aperture_ros.bank.prior import NaturalImagePrior
from coded_aperture_ros.imaging.patches import PatchGrid
from coded_aperture_ros.optics import PsfStack

# A patch without any noise of its own is treated as having this share of the variance that was
# told: without noise, rounding and the rank of the basis would decide.
OWN_NOISE = np.float32(0.05)
LEAST_EXCESS = np.float32(1e-3)

# Distance between the patches of a frame, unless something else is asked for.
DEFAULT_STRIDE_PX = 8


@dataclasses.dataclass(frozen=True)
class FilterBank:
    """Everything that depth estimation needs to know about a mask and its blur sizes.

    For a patch with power spectrum ``P`` the energy of blur level ``d`` is twice the negative
    log-likelihood of a Gaussian texture seen through that level's PSF, minimised over the
    texture's contrast ``a`` and slope, and over the patch's own noise ``s``::

        E_d = min over a, slope, s of  sum_k m_k [ P_k / (s^2 V_k) + log(s^2 V_k) ]
        V_k = (a / s^2) (C_k + e^2) + 1

    with the expected power ``C_k`` of unit-contrast texture at level ``d``, the multiplicity
    ``m_k`` and the model error ``e``. This is the noise-aware form of the distance to the
    subspace of thesis eq. 6.22, to which it tends without noise. The noise of a patch may exceed
    the frame's because slants, edges and shading in it act like noise, and is often a little
    less because estimates err upward.

    Only the ratio ``a / s^2`` enters the weights, so one bank serves every noise level; for a
    given ratio the best noise follows in closed form.

    `project` and `energies` say what the energies are; `coded_aperture_ros.engine` computes them
    at the rate of a camera.

    The weights ``m / V`` of all hypotheses share one basis (thesis 8.3.1).

    Attributes
    ----------
    stack : PsfStack
        The L levels: blur sizes in px (or indices) and PSFs.
    window_px : int
        Side of the patches.
    prior : NaturalImagePrior
        Hypotheses for sharp texture.
    ratios : ndarray, float64 [S]
        Grid of contrast over noise variance, in half decades.
    basis : ndarray, float32 [K, R]
        Common basis of the weights.
    coefficients : ndarray, float32 [R, S, slopes, L]
        Weights in that basis.
    log_determinants : ndarray, float32 [S, slopes, L]
        ``sum_k m_k log V_k``.
    truncation_error : float
        Relative root-mean-square error of the weights at this rank.
    noise : float
        Standard deviation of the noise of one channel of the camera; 0 if it has to be estimated
        in every frame.
    mask_digest : str
        Digest of the mask's pattern; empty for measured PSFs and planes, whose depths, where they
        are known, hold whatever a camera file says.
    learned_from : str
        How the bank came to be, for a person to read.
    highest_frequency : float
        Frequencies above this, in cycles per pixel, are left out.
    stride_px : int
        Distance between patches that the bank was tuned for.
    level_error : float
        Mean error, in levels, on simulated planes with this distance; NaN if it was not tuned.
    pattern : LearnedPattern or None
        Mask and thin lens as found from planes: what a bank for another focus is made of.
    """

    stack: PsfStack
    window_px: int
    prior: NaturalImagePrior
    ratios: NDArray[np.float64]
    basis: NDArray[np.float32]
    coefficients: NDArray[np.float32]
    log_determinants: NDArray[np.float32]
    truncation_error: float
    noise: float
    mask_digest: str
    learned_from: str
    highest_frequency: float = 1.0
    stride_px: int = DEFAULT_STRIDE_PX
    level_error: float = float("nan")
    pattern: LearnedPattern | None = None

    @property
    def blur_sizes_px(self) -> NDArray[np.float64]:
        """Signed blur size of every level [L], px."""
        return self.stack.blur_sizes_px

    @property
    def levels(self) -> int:
        """Number L of levels."""
        return len(self.stack.blur_sizes_px)

    @cached_property
    def fourier(self) -> WindowedFourierBasis:
        """The transform that the bank's filters act on."""
        return WindowedFourierBasis(self.window_px, self.highest_frequency)

    @property
    def basis_vectors(self) -> int:
        """How many vectors the common basis has."""
        return int(self.basis.shape[1])

    @property
    def evidence_repetition(self) -> float:
        """How many windowed frequencies tell one thing: a window spreads each over several."""
        window = self.fourier.window.astype(np.float64)
        return float((len(window) * np.sum(window**4)) ** 2)

    @property
    def noise_range(self) -> tuple[float, float]:
        """Noise (standard deviation) for which every contrast hypothesis is in the bank."""
        contrasts = self.prior.contrasts
        return (
            float(np.sqrt(max(contrasts) / self.ratios[-1])),
            float(np.sqrt(min(contrasts) / self.ratios[0])),
        )

    @cached_property
    def functions_of_power(self) -> NDArray[np.float32]:
        """What is needed of a patch's spectrum: basis and multiplicity [K, R + 1]."""
        return np.column_stack([self.basis, self.fourier.multiplicity])

    def project(self, grey: NDArray[np.float32], stride_px: int) -> "ProjectedFrame":
        """Project every patch of a frame onto the common basis.

        Parameters
        ----------
        grey : ndarray, float32 [rows, columns]
            Linear light, without NaN.
        stride_px : int
            Distance between patches, px.

        Raises
        ------
        InputError
            If the frame is smaller than a patch.
        """
        projected, grid = self.fourier.project(grey, stride_px, self.functions_of_power)
        return ProjectedFrame(projected[..., :-1], projected[..., -1], grid)

    def energies(
        self, frame: "ProjectedFrame", noise: float | NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the energy of every level for every patch.

        Parameters
        ----------
        frame : ProjectedFrame
        noise : float, or ndarray, float32 [rows, columns]
            Standard deviation ``s_0`` of the noise, linear light, > 0: the frame's, or each
            patch's.

        Returns
        -------
        ndarray, float32 [rows, columns, L]
            Lower is likelier. A patch that is better explained by noise alone than by any
            texture has the same energy at every level.
        """
        plausible = self.plausible_ratios(float(np.median(noise)))
        count = self.fourier.multiplicity.sum()
        precision = 1 / (count * np.broadcast_to(np.square(noise), frame.power.shape))
        precision = precision.astype(np.float32)
        projections = frame.projections * precision[..., None]
        excess = np.tensordot(projections, self.coefficients[:, plausible], axes=1)
        # The best noise of a hypothesis is its excess, so the best hypothesis has the least product
        # of that and of its determinant.
        determinants = np.exp(self.log_determinants[plausible] / count)
        best = ((excess + OWN_NOISE) * determinants).min(axis=(-3, -2))
        textureless = frame.power * precision + OWN_NOISE
        best = np.clip(best, LEAST_EXCESS, textureless[..., None])
        return np.asarray(count * np.log(best), np.float32)

    def plausible_ratios(self, noise: float) -> slice:
        """Return which ratios belong to the prior's contrasts under a noise of this deviation."""
        return plausible_ratios(self.ratios, self.prior.contrasts, noise)


def plausible_ratios(
    ratios: NDArray[np.float64], contrasts: Sequence[float], noise: float
) -> slice:
    """Return which of `ratios`, in half decades, belong to contrasts under a noise.

    Parameters
    ----------
    ratios : ndarray, float64 [S]
        Contrast over noise variance, increasing.
    contrasts : sequence of float
        Variances in half decades, at most S.
    noise : float
        Standard deviation, > 0.
    """
    count = len(contrasts)
    wanted = min(contrasts) / noise**2
    first = int(np.argmin(np.abs(np.log(ratios / wanted))))
    first = min(first, len(ratios) - count)
    return slice(first, first + count)


@dataclasses.dataclass(frozen=True, eq=False)
class ProjectedFrame:
    """What the bank sees of a frame: its patches in the common basis.

    Attributes
    ----------
    projections : ndarray, float32 [rows, columns, R]
        Coefficients of every patch in the bank's basis.
    power : ndarray, float32 [rows, columns]
        Sum of the whole spectrum of every patch, without the mean.
    grid : PatchGrid
        Where the patches lie.
    """

    projections: NDArray[np.float32]
    power: NDArray[np.float32]
    grid: PatchGrid
