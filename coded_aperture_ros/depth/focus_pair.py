"""Depth from two frames of one view with the lens focused at two distances."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, Shape
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.depth.decoders.network import untrained
from coded_aperture_ros.depth.estimate import DepthEstimate
from coded_aperture_ros.depth.estimator import DepthEstimator
from coded_aperture_ros.depth.folding import Folding
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.likelihood import Cost
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig, learn_bank
from coded_aperture_ros.optics import render_psf_stack


class FocusPair:
    """Adds what two frames say: the costs of the same depths, whatever their blur in each.

    That is ``C(z) = C_1(S_1(z)) + C_2(S_2(z))``, with the blur sizes ``S`` of the two settings.
    Where one frame cannot tell the sides of its focal plane apart, the other can.

    Parameters
    ----------
    estimator : DepthEstimator
        Of the first frame, for single frames; its bank was learned from its camera's mask.
    focus_m : float
        Where the second frame is in focus.

    Raises
    ------
    InputError
        If the bank's PSFs are not those of the camera's mask, or there is too much blur at the
        second focus.
    """

    def __init__(self, estimator: DepthEstimator, focus_m: float) -> None:
        bank, camera, depths_m = estimator.model, estimator.camera, estimator.depths_m
        if not isinstance(bank, FilterBank) or camera is None or depths_m is None:
            raise InputError("two frames need a filter bank and the camera file that it is for")
        if bank.mask_digest != camera.mask.digest:
            raise InputError(
                "two frames need a bank that was learned from the camera file's mask: see learn "
                "--camera; PSFs that were measured are of one focus"
            )
        if not np.isfinite(depths_m).all():
            raise InputError(
                "two frames need a bank without levels at or beyond infinity: see learn --camera"
            )
        refocused = camera.refocused(focus_m)
        # Focus breathing: the second frame is brought to the scale of the first.
        self._middle = np.array(camera.intrinsics.camera_matrix)[[2, 5]]
        self._scale = camera.focal_length_px / refocused.focal_length_px
        other = dataclasses.replace(camera, focus_distance_m=focus_m, side="both")
        stack = render_psf_stack(
            camera.mask, other.blur_size_px(depths_m), camera.psf_diffraction_px
        )
        config = LearnConfig(bank.window_px, bank.basis_vectors, 1.0, bank.noise)
        with naming(f"in focus at {focus_m:g} m"):
            model = learn_bank(stack, config, bank.prior, mask=camera.mask)
        model = dataclasses.replace(model, stride_px=bank.stride_px)
        self._first, self._second = (
            DepthEstimator(each, estimator.config, its, like=estimator, costs_tell_sides=True)
            for each, its in ((bank, camera), (model, other))
        )
        # Who has one side only need not find out which: it decides, if it can as well.
        one_sided = bank.stack.has_both_sides and not model.stack.has_both_sides
        self._second_decides = one_sided and not untrained(model, model.stride_px)

    def estimate(
        self,
        first: FloatArray,
        second: FloatArray,
        size: Shape | None = None,
        hidden_noise: tuple[float, float] = (0.0, 0.0),
    ) -> DepthEstimate:
        """Estimate the depth of every pixel of the first frame; see `DepthEstimator.estimate`.

        Nothing may move between the two frames. If one does not fit, neither is trusted. The levels
        and blur sizes may be those of the second frame: only the depths are of both.
        """
        if first.shape != second.shape:
            raise InputError(
                f"two frames: expected two of one size, got {first.shape} and {second.shape}"
            )
        frames = first, self._at_scale(second)
        pairs = list(zip((self._first, self._second), frames, hidden_noise, strict=True))
        deciding, other = pairs[::-1] if self._second_decides else pairs
        seen, own = _looked(*deciding)
        seen_by_other, of_other = _looked(*other)
        health = other[0].decide(seen_by_other, of_other.volume, of_other).health
        both = _added(own, of_other, *(_folding(one) for one, *_ in (deciding, other)))
        return deciding[0].decide(seen, both.volume, both, size, others=health)

    def close(self) -> None:
        """End the threads that the work was shared among."""
        self._first.close()
        self._second.close()

    def _at_scale(self, frame: FloatArray) -> FloatArray:
        if abs(self._scale - 1) * max(frame.shape[:2]) < 0.5:  # less than a pixel at the edges
            return frame
        moved = np.column_stack([np.eye(2) * self._scale, self._middle * (1 - self._scale)])
        # Linear interpolation would take away half of the noise. What was not seen is left out.
        how = {"flags": cv2.INTER_LANCZOS4, "borderValue": (np.nan,) * 3}
        return np.asarray(cv2.warpAffine(frame, moved, frame.shape[1::-1], **how))


def _looked(
    estimator: DepthEstimator, frame: FloatArray, hidden_noise: float
) -> tuple[Observation, Cost]:
    seen = estimator.observe(frame, hidden_noise)
    return seen, estimator.cost(seen, seen.grey)


def _folding(estimator: DepthEstimator) -> Folding:
    return Folding.of(estimator.model.stack.blur_sizes_px)


def _added(own: Cost, other: Cost, folding: Folding, of_other: Folding) -> Cost:
    """Return the cost of one frame with that of another added, level by level."""
    small = None
    if own.small is not None:  # of sizes without sign
        of_levels = own.small.volume[..., _places(folding)]
        if other.small is not None:
            of_levels = of_levels + other.small.volume[..., _places(of_other)]
        small = dataclasses.replace(own.small, volume=_from_least(folding.of_sizes(of_levels)))
    return dataclasses.replace(own, volume=_from_least(own.volume + other.volume), small=small)


def _places(folding: Folding) -> IndexArray:
    """Return which of the folded sizes every level has [L]."""
    places = np.empty(max(folding.far.max(), folding.near.max()) + 1, np.intp)
    places[folding.far] = places[folding.near] = np.arange(len(folding.far))
    return places


def _from_least(volume: FloatArray) -> FloatArray:
    return np.asarray(volume - volume.min(axis=-1, keepdims=True))
