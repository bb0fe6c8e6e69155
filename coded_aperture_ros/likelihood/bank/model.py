"""The filter bank: energies of every blur level for every patch of a frame."""

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, PerPatch
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import EngineLikelihood, Plan, new_engine
from coded_aperture_ros.likelihood.bank.field import FieldFilters
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.hypotheses import Hypotheses, fitted_coefficients
from coded_aperture_ros.likelihood.bank.pattern import LearnedPattern
from coded_aperture_ros.likelihood.bank.prior import (
    NaturalImagePrior,
    periodic_levels,
    periodic_spectra,
)
from coded_aperture_ros.optics import Camera, PsfStack

# Distance between the patches of a frame, unless something else is asked for.
DEFAULT_STRIDE_PX = 8
# More would take all memory.
_MAX_LEVELS = 500


@dataclasses.dataclass(frozen=True, eq=False)
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

    A bank is a `LikelihoodModel`: `plan` makes what computes the cost of every level at the rate of
    a camera; see `coded_aperture_ros.likelihood`.

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
    image_width, image_height : int
        Size of the frames that the blur sizes are of, px; 0 where it is not known.
    setting_digest : str
        Digest of what makes depths of blur sizes: see `Camera.setting_digest`; empty where the
        depths do not come from a camera file.
    guard_levels : int
        Levels at either end that stand for what is beyond the depth range.
    pattern : LearnedPattern or None
        Mask and thin lens as found from planes: what a bank for another focus is made of.
    field : FieldFilters or None
        Filters of the parts of the image, for lenses whose PSF changes over it.
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
    guard_levels: int = 0
    pattern: LearnedPattern | None = None
    field: FieldFilters | None = None

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
        """The transform that the bank's filters act on."""
        return WindowedFourierBasis(self.window_px, self.highest_frequency)

    @property
    def basis_vectors(self) -> int:
        """How many vectors the common basis has."""
        return int(self.basis.shape[1])

    @property
    def window_correlation(self) -> float:
        """How many windowed frequencies tell one thing: a window spreads each over several."""
        window = self.fourier.window.astype(np.float64)
        return float((len(window) * np.sum(window**4)) ** 2)

    @cached_property
    def functions_of_power(self) -> FloatArray:
        """What is needed of a patch's spectrum: basis and multiplicity [K, R + 1]."""
        return np.column_stack([self.basis, self.fourier.multiplicity])

    @property
    def window(self) -> FloatArray:
        """The window that patches are multiplied by, along each side [N]."""
        return self.fourier.window

    @property
    def contrasts(self) -> Sequence[float]:
        """The variances of sharp texture that are tried."""
        return self.prior.contrasts

    @property
    def fattening(self) -> float:
        """See `LikelihoodModel`: the windows are Hann windows."""
        return 1.0

    def plan(
        self,
        shape: tuple[int, ...],
        stride_px: int,
        backend: str = "numpy",
        threads: int = 1,
        periodic: bool = True,
    ) -> EngineLikelihood:
        """Plan the work on frames of one size; see `LikelihoodModel.plan`.

        Whether `periodic` texture is tried, too, if sizes are in pixels: see `Cost`.
        """
        tried = self._with_periodic if periodic and self.stack.in_pixels else self
        engine = new_engine(Plan.of(tried, shape, stride_px), backend, threads)
        return EngineLikelihood(engine, self.window_correlation, self.levels)

    @cached_property
    def _with_periodic(self) -> "FilterBank":
        """The bank with `periodic_levels` after its own, whose kinds of texture are periodic.

        There are several of these for each kind of its own: first all levels with some of the
        bands, then all with others. Only for `Plan.of`: its stack has the own levels alone.
        """
        some, kinds = periodic_levels(self.levels), self.log_determinants.shape[1]
        psfs = self.stack.psfs[some, None]
        if self.pattern is not None:
            psfs = self.pattern.components(self.blur_sizes_px[some]).swapaxes(0, 1)
        spectra = periodic_spectra(kinds)
        found = Hypotheses.of(self.fourier, psfs, spectra, self.prior.model_error)
        basis = self.basis.astype(np.float64)
        weights = [
            fitted_coefficients(basis, filters, scale)
            for filters, scale in zip(found.weights, found.scales, strict=True)
        ]

        def after(own: FloatArray, more: DoubleArray, first: int = 0) -> FloatArray:
            more = more.reshape(*own.shape[first:-2], -1, kinds, len(some)).swapaxes(-3, -2)
            more = more.reshape(*own.shape[first:-1], -1).astype(own.dtype)
            more = np.broadcast_to(more, (*own.shape[:first], *more.shape))
            return np.concatenate([own, more], axis=-1)

        coefficients = np.stack(weights, axis=1)
        field = self.field and dataclasses.replace(
            self.field,
            coefficients=after(self.field.coefficients, coefficients, 1),
            log_determinants=after(self.field.log_determinants, found.log_determinants, 1),
        )
        return dataclasses.replace(
            self,
            coefficients=after(self.coefficients, coefficients),
            log_determinants=after(self.log_determinants, found.log_determinants),
            field=field,
        )

    def for_view(self, camera: Camera | None) -> "FilterBank":
        """Bank for frames of a camera, which may show a part of its view only."""
        if self.field is None or camera is None:
            return self
        field = dataclasses.replace(self.field, field=self.field.field.for_view(camera))
        return dataclasses.replace(self, field=field)

    def energies(self, grey: FloatArray, stride_px: int, noise: PerPatch) -> FloatArray:
        """Return the energies of a single frame [rows, columns, L]; `plan` is for many.

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
        engine = new_engine(Plan.of(self, grey.shape, stride_px))
        engine.project(grey)
        return engine.energies(noise)


def check_frame_size(
    bank: FilterBank, width: int, height: int, given: tuple[int, int] | None = None
) -> None:
    """Refuse frames of another size than that of a bank, where it knows that.

    An `InputError` says which size it is for, and what to do; `given` is the frame's own size
    (width, height), where it was resampled.
    """
    own, given = (bank.image_width, bank.image_height), given or (width, height)
    PatchGrid.covering((height, width), bank.window_px, 1)  # refuses what is smaller than a window
    if not all(own) or (width, height) == own:
        return
    size = "{}x{}".format(*given)
    scale = (own[0] / given[0] + own[1] / given[1]) / 2
    fits = tuple(round(scale * length) for length in given) == own
    remedy = f"learn a bank for {size} (sizes of the image in the camera file)"
    if given == own:
        remedy = "leave out --frame-scale"
    elif fits and 0.1 <= scale < 1:  # what is enlarged has lost what tells depth
        remedy += f", or, if it is the same view, resample it by depth --frame-scale {scale:.6g}"
    resampled = "" if given == (width, height) else f", resampled to {width}x{height}"
    raise InputError(
        f"frame of {size}{resampled}: the bank is for {own[0]}x{own[1]}, and the same blur in "
        f"pixels would be another depth: {remedy}"
    )


def check_setting(bank: FilterBank, camera: Camera) -> Camera:
    """Refuse a camera with another focus, focal length, mask size or view than the bank's.

    Returns the camera for frames of the bank's size, if it knows that. An `InputError` says what to
    do.
    """
    if bank.setting_digest in ("", camera.setting_digest):
        return camera.resized(bank.image_width, bank.image_height) if bank.image_width else camera
    raise InputError(
        f"the bank was learned for another setting of the camera ({bank.learned_from}), with "
        "another focus, focal length, mask size or side: learn the bank for this camera file, or "
        "make one with learn --remap"
    )


def check_levels(count: int) -> None:
    """Refuse fewer than two levels, and so many that they would take all memory."""
    if not 2 <= count <= _MAX_LEVELS:
        allowed = "needs at least 2" if count < 2 else f"has at most {_MAX_LEVELS}"
        raise InputError(f"a bank {allowed} levels, got {count}")
