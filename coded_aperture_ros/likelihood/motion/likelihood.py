"""Likelihood of depth and motion together (thesis chapter 7)."""

import dataclasses
from typing import ClassVar

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray, PerPatch
from coded_aperture_ros.core.progress import LapTimer
from coded_aperture_ros.frames import ExpectedMotion
from coded_aperture_ros.likelihood import Cost, MotionField, relative_cost
from coded_aperture_ros.likelihood.motion.bank import MotionBank
from coded_aperture_ros.likelihood.motion.config import MotionConfig
from coded_aperture_ros.likelihood.motion.engine import MotionEngine
from coded_aperture_ros.likelihood.motion.joint import Separated, separate, separate_expected
from coded_aperture_ros.likelihood.protocol import LikelihoodModel
from coded_aperture_ros.optics import Camera, PsfStack

# A motion is as good as another that is so near, px, or so near relative to its length.
_AGREEMENT_PX = 1.0
_AGREEMENT_SHARE = 0.2
# Expected motions longer than the longest of the bank times this are not among the bank's.
_MAX_LENGTH_RATIO = 1.1


@dataclasses.dataclass(frozen=True, eq=False)
class MotionModel:
    """Model of a mask with motions as further hypotheses; a `LikelihoodModel`.

    Attributes
    ----------
    bank : MotionBank
        Filters of all pairs of motion and level.
    config : MotionConfig
        How motions are chosen.

    References
    ----------
    Martinello 2012, chapter 7.

    Examples
    --------
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.likelihood.motion import Motions, learn_motion_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("disc"), [3.0, 5.0]))
    >>> MotionModel(learn_motion_bank(bank, Motions.grid(2, [4.0]), rank=16)).learned_from
    'PSFs, natural-image prior, 3 motions'
    """

    bank: MotionBank
    config: MotionConfig = dataclasses.field(default_factory=MotionConfig)
    finds_motion: ClassVar[bool] = True

    def for_view(self, camera: Camera | None) -> "MotionModel":
        """Model itself: its PSFs do not change over the image."""
        return self

    @property
    def stack(self) -> PsfStack:
        """The L levels of defocus."""
        return self.bank.defocus.stack

    @property
    def window_px(self) -> int:
        """Side of the patches, px."""
        return self.bank.defocus.window_px

    @property
    def stride_px(self) -> int:
        """Default distance between patches, px."""
        return self.bank.defocus.stride_px

    @property
    def fattening(self) -> float:
        """Excess width of foregrounds; see `LikelihoodModel`."""
        return self.bank.defocus.fattening

    @property
    def noise(self) -> float:
        """Standard deviation of one channel's noise; 0: estimated in each frame."""
        return self.bank.defocus.noise

    @property
    def mask_digest(self) -> str:
        """Digest of the mask's pattern."""
        return self.bank.defocus.mask_digest

    @property
    def learned_from(self) -> str:
        """Origin of the bank, for a person to read."""
        return self.bank.product.learned_from

    def plan(
        self, shape: tuple[int, ...], stride_px: int, backend: str = "numpy", threads: int = 1
    ) -> "MotionLikelihood":
        """Likelihood for frames of one size; always on the processor."""
        engine = MotionEngine(self.bank, shape, stride_px, threads, self.config.finalists)
        return MotionLikelihood(self, engine, shape[1])


@dataclasses.dataclass(frozen=True, eq=False)
class _Expectation:
    """Motions to search: candidates near an expected field [rows, columns, 2], or all."""

    candidates: IndexArray | None = None
    field_px: DoubleArray | None = None
    search_reason: str = ""


class MotionLikelihood:
    """Cost volumes and motion of frames of one size; a `Likelihood`."""

    def __init__(self, model: MotionModel, engine: MotionEngine, image_width: int) -> None:
        self._engine = engine
        self._config = model.config
        self.grid = engine.grid
        self._motions = model.bank.motions
        self._window_correlation = model.bank.defocus.window_correlation
        self._image_width = image_width
        self._apart_px = self._motions.distances_px(self._motions.vectors_px)
        self._nearest_motions = np.argsort(self._apart_px, axis=1, kind="stable")

    def cost(
        self,
        grey: FloatArray,
        noise: PerPatch,
        usable: BoolArray | None = None,
        prior: ExpectedMotion | None = None,
    ) -> Cost:
        """Cost of every level, and motion, for every patch; see `Likelihood.cost`.

        With a `prior` only motions near it are searched, else all.
        """
        timer = LapTimer()
        if usable is None:
            usable = np.ones((self.grid.rows, self.grid.columns), np.bool_)
        self._engine.project(grey)
        timer.lap("spectra")
        expected = self._expectation(prior)
        if expected.candidates is not None:
            energies = self._engine.energies_for(noise, expected.candidates)
            pairs = self._relative(energies, usable)
            timer.lap("energies")
            separated = separate_expected(pairs, expected.candidates, self._motions)
        else:
            pairs = self._all_pairs(noise, usable)
            timer.lap("energies")
            overlap = self.grid.window_px / self.grid.stride_px
            separated = separate(pairs, self._motions, self._config, overlap)
            if self._config.refinement_px:
                separated = self._refine(separated, noise, usable)
        motion = self._field(separated, expected, usable)
        timer.lap("motion")
        return Cost(separated.level_cost, motion=motion, seconds=timer.seconds)

    def close(self) -> None:
        """End the engine's threads."""
        self._engine.close()

    def _all_pairs(self, noise: PerPatch, usable: BoolArray) -> FloatArray:
        """Cost of every pair of motion and level [M, L, rows, columns]."""
        pairs = self._relative(self._engine.all_energies(noise), usable)
        static = np.flatnonzero(np.hypot(*self._motions.vectors_px.T) == 0)
        if static.size:
            static_cost = self._relative(self._engine.static_energies(noise)[None], usable)[0]
            pairs[static] = static_cost + pairs[static].min(axis=1, keepdims=True)
        return pairs

    def _relative(self, energies: FloatArray, usable: BoolArray) -> FloatArray:
        """Cost of pairs of motion and level, of the shape of their energies."""
        pairs = energies.reshape(-1, *energies.shape[2:])
        cost = relative_cost(np.moveaxis(pairs, 0, -1), self._window_correlation, usable)
        return np.moveaxis(cost, -1, 0).reshape(energies.shape)

    def _expectation(self, prior: ExpectedMotion | None) -> _Expectation:
        """Motions to search for what is known of the motion."""
        if prior is None:
            return _Expectation(search_reason="nothing expected")
        if prior.angle_rad is None:
            return _Expectation(search_reason=prior.reason)
        grid, motions = self.grid, self._motions
        field = prior.motion_px(grid.row_centres, grid.column_centres, self._image_width)
        longest = float(np.hypot(*np.moveaxis(field, -1, 0)).max())
        if longest > _MAX_LENGTH_RATIO * motions.longest_px:
            return _Expectation(
                search_reason=f"expected motion of {longest:.3g} px is longer than "
                f"{motions.longest_px:.3g} px"
            )
        # The candidates are those around the nearest one, so that there are few different sets.
        nearest = motions.distances_px(field).argmin(axis=-1)
        count = min(self._config.prior_motions, len(motions))
        return _Expectation(np.asarray(self._nearest_motions[:, :count][nearest]), field)

    def _refine(self, separated: Separated, noise: PerPatch, usable: BoolArray) -> Separated:
        """Refine the vectors of the motions that occur."""
        vectors = separated.vectors_px.copy()
        for index in np.unique(separated.motion):
            here = (separated.motion == index) & usable
            if vectors[index].any() and here.any():
                tolerance_px = self._config.refinement_px
                vectors[index] = self._engine.refine_motion(
                    noise, here, vectors[index], tolerance_px
                )
        return dataclasses.replace(separated, vectors_px=vectors)

    def _field(
        self, separated: Separated, expected: _Expectation, usable: BoolArray
    ) -> MotionField:
        """Motion of every patch, NaN where it is not usable."""
        vectors = separated.vectors_px[separated.motion]
        if expected.field_px is not None:
            # Blur does not show the sign: it is that of the expected motion.
            against = np.sum(vectors * expected.field_px, axis=-1, keepdims=True) < 0
            vectors = np.where(against, -vectors, vectors)
        length = np.hypot(*self._motions.vectors_px.T)
        near = self._apart_px <= np.maximum(_AGREEMENT_PX, _AGREEMENT_SHARE * length[:, None])
        agree = near[separated.motion[None], separated.candidates]
        confidence = np.asarray((separated.probability * agree).sum(axis=0), np.float32)
        vectors[~usable], confidence[~usable] = np.nan, 0
        return MotionField(vectors.astype(np.float32), confidence, expected.search_reason)


def with_motion_config(model: LikelihoodModel, motion: MotionConfig) -> LikelihoodModel:
    """Model with other settings of motion, without learning; itself if nothing changes."""
    if isinstance(model, MotionModel) and model.config != motion:
        return dataclasses.replace(model, config=motion)
    return model
