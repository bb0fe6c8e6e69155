"""Depth and motion from one coded frame."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator
from coded_aperture_ros.depth.estimate import Observation
from coded_aperture_ros.depth.levels import level_evidence
from coded_aperture_ros.depth.upsample import nearest_patches
from coded_aperture_ros.imaging import PatchGrid
from coded_aperture_ros.imaging.static_average import frames_of_patches
from coded_aperture_ros.likelihood import Engine
from coded_aperture_ros.methods.motion.bank import MotionBank
from coded_aperture_ros.methods.motion.config import MotionConfig
from coded_aperture_ros.methods.motion.engine import MotionEngine
from coded_aperture_ros.methods.motion.joint import Separated, separate, separate_expected
from coded_aperture_ros.methods.motion.rotation import ExpectedMotion
from coded_aperture_ros.optics import Camera

# A motion is as good as another that is so near, px, or so near for its length.
_AGREEMENT_PX, _AGREEMENT_SHARE = 1.0, 0.2
# Motions that are expected to be this much longer than the longest are no such motions.
_LONGER = 1.1


@dataclasses.dataclass(frozen=True, eq=False)
class MotionEstimate(DepthEstimate):
    """What one frame says about depth and motion; all maps are of one shape [rows, columns].

    Attributes
    ----------
    motion_px : ndarray, float32 [rows, columns, 2]
        Way during the exposure in pixels of the frame, to the right, and down. Blur does not tell
        which way along its line: where no motion was expected, it is to the right, or down where
        it is upright. NaN where unknown.
    motion_confidence : ndarray, float32 [rows, columns]
        Probability, in [0, 1], that a pixel's patch by itself gives to about this motion.
    searched : str
        Why all motions were tried and not only expected ones; empty where these were enough.
    """

    motion_px: NDArray[np.float32]
    motion_confidence: NDArray[np.float32]
    searched: str


class MotionEstimator(DepthEstimator):
    """Turns coded frames into depth and motion (thesis chapter 7).

    Depth is estimated as by `DepthEstimator`, with the motions as further hypotheses; see
    `separate`.

    Parameters
    ----------
    bank : MotionBank
    config : DepthConfig, optional
        Its `backend` does not matter: the processor computes the energies.
    camera : Camera, optional
        Turns blur sizes into metres.
    motion : MotionConfig, optional
        How motions are chosen; which there are, the bank says.
    """

    def __init__(
        self,
        bank: MotionBank,
        config: DepthConfig | None = None,
        camera: Camera | None = None,
        motion: MotionConfig | None = None,
    ) -> None:
        super().__init__(bank.still, config, camera)
        self.motion_bank = bank
        self.motion = motion or MotionConfig()
        self._apart_px = bank.motions.distances_px(bank.motions.vectors_px)
        self._nearest_first = np.argsort(self._apart_px, axis=1, kind="stable")
        self._field = np.empty((0, 0, 2))
        self._motion_engine: MotionEngine | None = None
        self._expected: ExpectedMotion | None = None
        self._separated: Separated | None = None
        self._searched = ""

    def estimate(
        self,
        frame: NDArray[np.float32],
        size: tuple[int, int] | None = None,
        expected: ExpectedMotion | None = None,
    ) -> MotionEstimate:
        """Estimate depth and motion of every pixel of a frame.

        Parameters
        ----------
        frame, size
            See `DepthEstimator.estimate`.
        expected : ExpectedMotion, optional
            Of the picture; only motions near it are tried. Where it is not known, all are.

        Raises
        ------
        InputError
            See `DepthEstimator.estimate`.
        """
        self._expected = expected
        estimate = super().estimate(frame, size)
        assert isinstance(estimate, MotionEstimate)  # that is what `decide` returns
        return estimate

    def evidence_of(
        self,
        seen: Observation,
        grey: NDArray[np.float32],
        frames: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Return the evidence against every level, whatever the motion [rows, columns, L]."""
        self._planned(grey.shape)
        engine = self._motion_engine
        assert engine is not None  # `_planned` has made it
        engine.project(grey)
        self.stages.lap("spectra")
        variance = seen.noise**2 + (0 if seen.shot_variance is None else seen.shot_variance)
        if frames is not None:
            variance = variance / frames_of_patches(frames, seen.grid)
        noise = np.sqrt(variance, dtype=np.float32)
        candidates = self._candidates(seen.grid, grey.shape)
        if candidates is not None:
            evidence = self._evidence(engine.of_some(noise, candidates), seen)
            self.stages.lap("energies")
            self._separated = separate_expected(evidence, candidates, self.motion_bank.motions)
        else:
            evidence = self._evidence(engine.of_all(noise), seen)
            still = np.flatnonzero(np.hypot(*self.motion_bank.motions.vectors_px.T) == 0)
            if still.size:
                of_still = self._evidence(engine.of_still(noise)[None], seen)[0]
                evidence[still] = of_still + evidence[still].min(axis=1, keepdims=True)
            self.stages.lap("energies")
            self._separated = separate(
                evidence,
                self.motion_bank.motions,
                self.motion,
                seen.grid.window_px / seen.grid.stride_px,
            )
            if self.motion.refinement_px:
                self._refine(engine, noise, seen)
        self.stages.lap("motion")
        return self._separated.level_evidence

    def decide(
        self,
        seen: Observation,
        evidence: NDArray[np.float32],
        own: NDArray[np.float32],
        size: tuple[int, int] | None = None,
    ) -> MotionEstimate:
        """Choose the levels of all patches, and draw the maps of depth and motion."""
        estimate = super().decide(seen, evidence, own, size)
        separated = self._separated
        assert separated is not None  # `evidence_of` has been called
        grid, shape = seen.grid, seen.grey.shape
        vectors = self._towards_expected(separated.vectors_px[separated.motion])
        confidence = self._motion_confidence(separated)
        vectors[~seen.usable], confidence[~seen.usable] = np.nan, 0
        rows, columns = nearest_patches(grid, shape, estimate.level.shape)

        def drawn(values: NDArray[np.float32]) -> NDArray[np.float32]:
            return np.take(np.take(values, columns, axis=1), rows, axis=0)

        return MotionEstimate(
            **{field.name: getattr(estimate, field.name) for field in dataclasses.fields(estimate)},
            motion_px=drawn(vectors.astype(np.float32)),
            motion_confidence=drawn(confidence),
            searched=self._searched,
        )

    def _refine(self, engine: MotionEngine, noise: NDArray[np.float32], seen: Observation) -> None:
        """Search for what exactly the motions are that occur."""
        separated = self._separated
        assert separated is not None  # as the caller knows
        vectors = separated.vectors_px.copy()
        for index in np.unique(separated.motion):
            here = (separated.motion == index) & seen.usable
            if vectors[index].any() and here.any():
                tolerance = self.motion.refinement_px
                vectors[index] = engine.refined(noise, here, vectors[index], tolerance)
        self._separated = dataclasses.replace(separated, vectors_px=vectors)

    def _motion_confidence(self, separated: Separated) -> NDArray[np.float32]:
        """Return the probability of what is as good as each patch's motion [rows, columns]."""
        motions = self.motion_bank.motions
        apart = self._apart_px
        length = np.hypot(*motions.vectors_px.T)
        near = apart <= np.maximum(_AGREEMENT_PX, _AGREEMENT_SHARE * length[:, None])
        agree = near[separated.motion[None], separated.candidates]
        return np.asarray((separated.probability * agree).sum(axis=0), np.float32)

    def _evidence(self, energies: NDArray[np.float32], seen: Observation) -> NDArray[np.float32]:
        """Return the evidence against pairs of motion and level, of the shape of their energies."""
        pairs = energies.reshape(-1, *energies.shape[2:])
        evidence = level_evidence(np.moveaxis(pairs, 0, -1), self.bank.evidence_repetition)
        evidence[~seen.usable] = 0
        return np.moveaxis(evidence, -1, 0).reshape(energies.shape)

    def _candidates(self, grid: PatchGrid, shape: tuple[int, ...]) -> NDArray[np.intp] | None:
        """Return which motions to try at every patch [rows, columns, k]; None for all."""
        expected, motions = self._expected, self.motion_bank.motions
        if expected is None:
            self._searched = "nothing expected"
            return None
        if expected.angle_rad is None:
            self._searched = expected.reason
            return None
        field = self._field = expected.at(grid.row_centres, grid.column_centres, shape[1])
        longest = float(np.hypot(*np.moveaxis(field, -1, 0)).max())
        if longest > _LONGER * motions.longest_px:
            self._searched = (
                f"expected motion of {longest:.3g} px is longer than {motions.longest_px:.3g} px"
            )
            return None
        self._searched = ""
        # As the middle of all that are nearest to the same one, so that there are few sets.
        nearest = motions.distances_px(field).argmin(axis=-1)
        count = min(self.motion.prior_motions, len(motions))
        return np.asarray(self._nearest_first[:, :count][nearest])

    def _towards_expected(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return motions the way round that is expected."""
        if self._searched:
            return vectors.copy()
        against = np.sum(vectors * self._field, axis=-1, keepdims=True) < 0
        return np.where(against, -vectors, vectors)

    def _new_engine(self, shape: tuple[int, ...], stride_px: int) -> Engine:
        """Return what computes the energies of frames of a size."""
        threads = self.config.threads
        self._motion_engine = MotionEngine(
            self.motion_bank, shape, stride_px, threads, self.motion.finalists
        )
        return self._motion_engine
