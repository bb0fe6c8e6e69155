"""Depth from two frames of one view with the lens focused at two distances."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray, Shape
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.depth.decoders.network import unsupported_reason
from coded_aperture_ros.depth.estimate import DepthEstimate
from coded_aperture_ros.depth.estimator import DepthEstimator
from coded_aperture_ros.depth.levels import Folding
from coded_aperture_ros.depth.quality import Health
from coded_aperture_ros.frames import Frame
from coded_aperture_ros.likelihood import Cost
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig, learn_bank
from coded_aperture_ros.optics import Camera, render_psf_stack


class FocusPair:
    """Depth from two frames at two focus distances, by the sum of their costs of equal depths.

    That is ``C(z) = C_1(S_1(z)) + C_2(S_2(z))``, with the blur sizes ``S`` of the two settings.
    Where one frame does not distinguish the sides of its focal plane, the other does.

    Parameters
    ----------
    estimator : DepthEstimator
        Of the first frame, for single frames; its bank was learned from its camera's mask.
    focus_m : float
        Focus distance of the second frame, m.

    Raises
    ------
    InputError
        If the bank's PSFs are not those of the camera's mask, or there is too much blur at the
        second focus.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(640.0, 1.0, 128, 96, Mask.named("levin"), 46.0)
    >>> bank = learn_bank_for_camera(camera, 1.15, 2.4, 12)
    >>> pair = FocusPair(DepthEstimator(bank, camera=camera), 1.2)
    >>> first, second = np.random.default_rng(0).random((2, 96, 128), np.float32)
    >>> pair.estimate(first, second).depth_m.shape
    (96, 128)
    """

    def __init__(self, estimator: DepthEstimator, focus_m: float) -> None:
        bank, camera, depths_m = _checked(estimator)
        refocused = camera.refocused(focus_m)
        # Focus breathing: the second frame is brought to the scale of the first.
        self._middle = np.array(camera.intrinsics.camera_matrix)[[2, 5]]
        self._scale = camera.focal_length_px / refocused.focal_length_px
        other_camera = dataclasses.replace(camera, focus_distance_m=focus_m, side="both")
        other_bank = _bank_of_second_focus(bank, other_camera, depths_m)
        # A frame with levels on one side only need not find the side: it decides where the network
        # supports its bank.
        one_sided = bank.stack.has_both_sides and not other_bank.stack.has_both_sides
        reason = unsupported_reason(other_bank, other_bank.stride_px)
        self._second_decides = one_sided and not reason
        first, second = (bank, camera), (other_bank, other_camera)
        deciding, other = (second, first) if self._second_decides else (first, second)
        config = estimator.config
        added = _AddedFocus(
            DepthEstimator(other[0], config, other[1], patches_tell_sides=True),
            Folding.from_sizes(deciding[0].stack.blur_sizes_px),
        )
        self._estimator = DepthEstimator(
            deciding[0], config, deciding[1], second_focus=added, patches_tell_sides=True
        )

    def estimate(
        self, first: Frame | FloatArray, second: Frame | FloatArray, size: Shape | None = None
    ) -> DepthEstimate:
        """Depth of every pixel of the first frame; see `DepthEstimator.estimate`.

        The scene must be static. If one frame does not fit its bank, the estimate has the lower
        health. Levels and blur sizes may be those of the second frame; depths are valid for both.

        Parameters
        ----------
        first, second : Frame or ndarray, float32 [rows, columns] or [rows, columns, 3]
            Linear light of equal size, at the two focus distances.
        size : (int, int), optional
            Rows and columns of the maps; the frames' by default.

        Raises
        ------
        InputError
            As from `DepthEstimator.estimate`, or if the frames differ in shape.
        """
        first, second = Frame.of(first), Frame.of(second)
        if first.light.shape != second.light.shape:
            raise InputError(
                "two frames: expected two of one size, got "
                f"{first.light.shape} and {second.light.shape}"
            )
        second = dataclasses.replace(second, light=self._at_scale(second.light))
        deciding, other = (second, first) if self._second_decides else (first, second)
        return self._estimator.estimate(dataclasses.replace(deciding, refocused=other), size)

    def close(self) -> None:
        """End the threads that the work was shared among."""
        self._estimator.close()

    def _at_scale(self, frame: FloatArray) -> FloatArray:
        """Second frame at the scale of the first; NaN beyond its view."""
        if abs(self._scale - 1) * max(frame.shape[:2]) < 0.5:  # less than a pixel at the edges
            return frame
        moved = np.column_stack([np.eye(2) * self._scale, self._middle * (1 - self._scale)])
        # Linear interpolation would remove half of the noise. NaN pixels count as missing.
        options = {"flags": cv2.INTER_LANCZOS4, "borderValue": (np.nan,) * 3}
        return np.asarray(cv2.warpAffine(frame, moved, frame.shape[1::-1], **options))


@dataclasses.dataclass(frozen=True, eq=False)
class _AddedFocus:
    """Adds the cost of the frame that does not decide; see `SecondFocus`."""

    estimator: DepthEstimator  # of the frame that does not decide
    folding: Folding  # of the levels of the frame that decides

    def add(self, cost: Cost, frame: Frame) -> tuple[Cost, Health | None]:
        work = self.estimator.run_front(frame)
        self.estimator.run_back(work)
        other_folding = Folding.from_sizes(self.estimator.model.stack.blur_sizes_px)
        own = work.frame_cost.in_memory()
        total = _sum_of_costs(cost, own, self.folding, other_folding)
        return total, work.health

    def close(self) -> None:
        self.estimator.close()


def _checked(estimator: DepthEstimator) -> tuple[FilterBank, Camera, DoubleArray]:
    """Bank, camera and depths of the levels; an `InputError` if they suit no pair of frames."""
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
    return bank, camera, depths_m


def _bank_of_second_focus(bank: FilterBank, camera: Camera, depths_m: DoubleArray) -> FilterBank:
    """Bank of the same depths, for a camera that is focused elsewhere."""
    stack = render_psf_stack(camera.mask, camera.blur_size_px(depths_m), camera.psf_diffraction_px)
    config = LearnConfig(bank.window_px, bank.basis_vectors, 1.0, bank.noise)
    with naming(f"in focus at {camera.focus_distance_m:g} m"):
        model = learn_bank(stack, config, bank.prior, mask=camera.mask)
    return dataclasses.replace(model, stride_px=bank.stride_px)


def _sum_of_costs(cost: Cost, other: Cost, folding: Folding, other_folding: Folding) -> Cost:
    """Cost of two frames together, level by level."""
    small = None
    if cost.small is not None:  # of sizes without sign
        volume = cost.small.volume[..., _size_of_levels(folding)]
        if other.small is not None:
            volume = volume + other.small.volume[..., _size_of_levels(other_folding)]
        small_volume = _subtract_least(folding.fold_volume(volume))
        small = dataclasses.replace(cost.small, volume=small_volume)
    volume = _subtract_least(cost.volume + other.volume)
    return dataclasses.replace(cost, volume=volume, small=small)


def _size_of_levels(folding: Folding) -> IndexArray:
    """Index of the folded size of every level [L]."""
    sizes = np.empty(max(folding.far.max(), folding.near.max()) + 1, np.intp)
    sizes[folding.far] = np.arange(len(folding.far))
    sizes[folding.near] = np.arange(len(folding.far))
    return sizes


def _subtract_least(volume: FloatArray) -> FloatArray:
    """Cost of every level above the least of each patch [rows, columns, L]."""
    return np.asarray(volume - volume.min(axis=-1, keepdims=True))
