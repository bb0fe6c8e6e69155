"""Filter bank: energies of every blur level for every patch of a frame."""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, PerPatch
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import ChannelLikelihood, EngineLikelihood, Plan, new_engine
from coded_aperture_ros.likelihood.bank.field import FieldFilters
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.hypotheses import FilterHypotheses, fit_coefficients
from coded_aperture_ros.likelihood.bank.pattern import LearnedPattern
from coded_aperture_ros.likelihood.bank.prior import (
    NaturalImagePrior,
    periodic_levels,
    periodic_spectra,
)
from coded_aperture_ros.optics import Camera, PsfStack

# Default distance between the patches of a frame, px.
DEFAULT_STRIDE_PX = 8
# More would take all memory.
_MAX_LEVELS = 500


@dataclasses.dataclass(frozen=True, eq=False)
class FilterBank:
    """Filters that identify the blur levels of a mask; a `LikelihoodModel`.

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
        Standard deviation of the noise of one channel of the camera, linear light; 0: it is
        estimated in every frame.
    mask_digest : str
        Digest of the mask's pattern; empty for measured PSFs and planes, whose depths do not
        depend on a camera file.
    learned_from : str
        Origin of the bank, for a person to read.
    highest_frequency : float
        Highest frequency that counts, cycles per pixel.
    stride_px : int
        Default distance between patches, px.
    level_error : float
        Mean error, in levels, on simulated planes with this distance; NaN if it was not tuned.
    image_width, image_height : int
        Size of the frames that the blur sizes are of, px; 0 if it is unknown.
    setting_digest : str
        See `Camera.setting_digest`; empty if the depths do not come from a camera file.
    reliability : tuple of float
        Coefficients that make the decoder's confidence right for this bank (`reliability_terms` in
        `depth/stages/reliability.py`); empty for masks, for which it is right as it is.
    own_fit : tuple of float
        Coefficients that make the health of frames right for this bank (`OwnFit`); empty
        for masks, for which it is right as it is.
    optics_limits : tuple of float
        Of how much better other optics may explain frames that fit (`OpticsTest`); empty where they
        were not measured.
    channels : tuple of FilterBank
        Banks of the colour channels, where their PSFs differ; else empty.
    guard_levels : int
        Levels at either end for what is beyond the depth range.
    pattern : LearnedPattern or None
        Mask and thin lens as found from planes, for banks of another focus.
    field : FieldFilters or None
        Filters of the parts of the image, for lenses whose PSF changes over it.
    refinement : mapping of str to ndarray, or None
        Weights of a refinement that was fitted further to this bank's PSFs.

    References
    ----------
    Martinello 2012, chapter 6 (eq. 6.22) and section 8.3.1.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("disc"), [3.0, 5.0, 7.0]))
    >>> likelihood = bank.plan((64, 64), stride_px=8)
    >>> likelihood.cost(np.random.default_rng(0).random((64, 64), np.float32), 0.01).volume.shape
    (3, 3, 3)
    """

    stack: PsfStack
    window_px: int
    prior: NaturalImagePrior
    ratios: DoubleArray
    basis: FloatArray
    coefficients: FloatArray
    log_determinants: FloatArray
    truncation_error: float
    noise: float
    mask_digest: str
    learned_from: str
    highest_frequency: float = 1.0
    stride_px: int = DEFAULT_STRIDE_PX
    level_error: float = float("nan")
    image_width: int = 0
    image_height: int = 0
    setting_digest: str = ""
    reliability: tuple[float, ...] = ()
    own_fit: tuple[float, ...] = ()
    optics_limits: tuple[float, ...] = ()
    channels: tuple["FilterBank", ...] = ()
    guard_levels: int = 0
    pattern: LearnedPattern | None = None
    field: FieldFilters | None = None
    refinement: Mapping[str, NDArray[Any]] | None = None

    @property
    def blur_sizes_px(self) -> DoubleArray:
        """Signed blur size of every level [L], px."""
        return self.stack.blur_sizes_px

    @property
    def levels(self) -> int:
        """Number L of levels."""
        return len(self.stack.blur_sizes_px)

    @cached_property
    def fourier(self) -> WindowedFourierBasis:
        """Transform of the patches."""
        return WindowedFourierBasis(self.window_px, self.highest_frequency)

    @property
    def basis_vectors(self) -> int:
        """Number R of vectors of the common basis."""
        return int(self.basis.shape[1])

    @property
    def window_correlation(self) -> float:
        """Windowed frequencies in one independent measurement: a window correlates them."""
        window = self.fourier.window.astype(np.float64)
        return float((len(window) * np.sum(window**4)) ** 2)

    @cached_property
    def functions_of_power(self) -> FloatArray:
        """Linear functions of a patch's power: basis and multiplicity [K, R + 1]."""
        return np.column_stack([self.basis, self.fourier.multiplicity])

    @property
    def window(self) -> FloatArray:
        """Window of the patches along each side [N]."""
        return self.fourier.window

    @property
    def contrasts(self) -> Sequence[float]:
        """Variances of sharp texture."""
        return self.prior.contrasts

    @property
    def fattening(self) -> float:
        """Excess width of foregrounds relative to Hann windows, which these are."""
        return 1.0

    def plan(
        self,
        shape: tuple[int, ...],
        stride_px: int,
        backend: str = "numpy",
        threads: int = 1,
        periodic: bool = True,
    ) -> EngineLikelihood | ChannelLikelihood:
        """Likelihood for frames of one size.

        Parameters
        ----------
        shape, stride_px, backend, threads
            See `LikelihoodModel.plan`.
        periodic : bool
            Whether the cost has that of periodic texture, too, if sizes are in pixels; see `Cost`.
        """
        bank = self._with_periodic if periodic and self.stack.in_pixels else self
        planned = Plan.for_frames(bank, shape, stride_px, self.levels)
        engine = new_engine(planned, backend, threads)
        own = EngineLikelihood(engine, self.window_correlation, self.levels, planned.sparse_step)
        if not self.channels:
            return own
        settings = shape, stride_px, backend, threads, periodic
        return ChannelLikelihood(own, [bank.plan(*settings) for bank in self.channels])

    @cached_property
    def _with_periodic(self) -> "FilterBank":
        """Bank with the `periodic_levels` after its own, whose kinds of texture are periodic.

        There are several of these for each kind of its own: first all levels with some of the
        bands, then all with others. Only for `Plan.for_frames`: the stack has no such levels.
        """
        indices, kinds = periodic_levels(self.levels), self.log_determinants.shape[1]
        psfs = self.stack.psfs[indices, None]
        if self.pattern is not None:
            psfs = self.pattern.components(self.blur_sizes_px[indices]).swapaxes(0, 1)
        spectra = periodic_spectra(kinds)
        found = FilterHypotheses.compute(self.fourier, psfs, spectra, self.prior.model_error)
        basis = self.basis.astype(np.float64)
        weights = [
            fit_coefficients(basis, filters, scale)
            for filters, scale in zip(found.weights, found.scales, strict=True)
        ]

        def append(levels: FloatArray, more: DoubleArray, first: int = 0) -> FloatArray:
            """Levels with more of them; axes before the first are only in those of the bank."""
            more = more.reshape(*levels.shape[first:-2], -1, kinds, len(indices)).swapaxes(-3, -2)
            more = more.reshape(*levels.shape[first:-1], -1).astype(levels.dtype)
            more = np.broadcast_to(more, (*levels.shape[:first], *more.shape))
            return np.concatenate([levels, more], axis=-1)

        coefficients = np.stack(weights, axis=1)
        field = self.field and dataclasses.replace(
            self.field,
            coefficients=append(self.field.coefficients, coefficients, 1),
            log_determinants=append(self.field.log_determinants, found.log_determinants, 1),
        )
        return dataclasses.replace(
            self,
            coefficients=append(self.coefficients, coefficients),
            log_determinants=append(self.log_determinants, found.log_determinants),
            field=field,
        )

    def for_view(self, camera: Camera | None) -> "FilterBank":
        """Bank for a part of a camera's view; itself unless its PSFs change over the image."""
        if self.field is None or camera is None:
            return self
        field = dataclasses.replace(self.field, field=self.field.field.for_view(camera))
        return dataclasses.replace(self, field=field)

    def energies(self, grey: FloatArray, stride_px: int, noise: PerPatch) -> FloatArray:
        """Energies of a single frame [rows, columns, L]; `plan` is for many.

        Parameters
        ----------
        grey : ndarray, float32 [height, width]
            Linear light, without NaN.
        stride_px : int
            Distance between patches.
        noise : float, or ndarray, float32 [rows, columns]
            Standard deviation of the noise, linear light, > 0: the frame's, or each patch's.

        Raises
        ------
        InputError
            If the frame is smaller than a patch.
        """
        engine = new_engine(Plan.for_frames(self, grey.shape, stride_px))
        engine.project(grey)
        return engine.energies(noise)


def check_frame_size(
    bank: FilterBank, width: int, height: int, original: tuple[int, int] | None = None
) -> None:
    """Check that frames have the size that a bank is for, if it is known.

    Parameters
    ----------
    bank : FilterBank
    width, height : int
        Size of the frames, px.
    original : (int, int), optional
        Their width and height before they were resampled, px.

    Raises
    ------
    InputError
        Saying which size the bank is for, and what to do.

    Examples
    --------
    >>> from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
    >>> from coded_aperture_ros.optics import Camera, Mask
    >>> camera = Camera(640.0, 1.0, 160, 120, Mask.named("levin"), 46.0)
    >>> check_frame_size(learn_bank_for_camera(camera, 1.2, 2.4, 5), 160, 120)
    """
    expected, original = (bank.image_width, bank.image_height), original or (width, height)
    PatchGrid.covering((height, width), bank.window_px, 1)  # raises if less than a window
    if not all(expected) or (width, height) == expected:
        return
    size = "{}x{}".format(*original)
    scale = (expected[0] / original[0] + expected[1] / original[1]) / 2
    fits = tuple(round(scale * length) for length in original) == expected
    remedy = f"learn a bank for {size} (sizes of the image in the camera file)"
    if original == expected:
        remedy = "leave out --frame-scale"
    elif fits and 0.1 <= scale < 1:  # an enlarged frame lacks the frequencies that show blur
        remedy += f", or, if it is the same view, resample it by depth --frame-scale {scale:.6g}"
    resampled = "" if original == (width, height) else f", resampled to {width}x{height}"
    raise InputError(
        f"frame of {size}{resampled}: the bank is for {expected[0]}x{expected[1]}, and the same "
        f"blur in pixels would be another depth: {remedy}"
    )


def check_level_count(count: int) -> None:
    """Raise `InputError` for fewer than two levels, and for more than memory holds."""
    if not 2 <= count <= _MAX_LEVELS:
        allowed = "needs at least 2" if count < 2 else f"has at most {_MAX_LEVELS}"
        raise InputError(f"a bank {allowed} levels, got {count}")
