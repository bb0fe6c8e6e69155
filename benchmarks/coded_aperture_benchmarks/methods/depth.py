"""Depth by this project's estimator: banks by what they are learned from, and kept predictions.

A prediction is kept in the folder of `--predictions`, under a digest of all that it follows from:
the frame, the bank, the camera, the settings, and the source of the package. Nothing in it is ever
out of date; what is not wanted any more is deleted with the folder.
"""

import dataclasses
import hashlib
import os
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import coded_aperture_ros
from coded_aperture_benchmarks.run import PREDICTIONS
from coded_aperture_ros.calibration.psf.optics_limits import with_optics_limits
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator
from coded_aperture_ros.depth.decoders.network import unsupported_reason
from coded_aperture_ros.likelihood.bank import (
    FilterBank,
    LearnConfig,
    learn_bank,
    learn_bank_for_camera,
)
from coded_aperture_ros.likelihood.bank.for_camera import guarded_range
from coded_aperture_ros.optics import Camera, PsfStack

# Banks are learned for a little more than what there is to see.
RANGE_MARGIN = 0.02
# Of a shallow scene the nearest level is nearer: at such a share of the farthest depth.
_NEAREST = (0.7, 0.5, 0.3, 0.15)
_SOURCES = (".py", ".npz")
_DEFAULTS = LearnConfig()


class Bank(Protocol):
    """What a bank is learned from."""

    def learn(self) -> FilterBank:
        """Return the bank; learned once in a while."""


@dataclasses.dataclass(frozen=True)
class CameraBank:
    """A bank for a camera and a range of depths in m."""

    camera: Camera
    near_m: float
    far_m: float
    levels: int
    config: LearnConfig = _DEFAULTS

    def learn(self) -> FilterBank:
        """Return the bank; the last ones are remembered."""
        return _learned(self)

    @classmethod
    def of_scene(
        cls,
        camera: Camera,
        depth_m: NDArray[np.floating],
        levels: int,
        config: LearnConfig | None = None,
    ) -> "CameraBank":
        """Return the bank for a little more than the depths that there are; NaN is unknown."""
        near_m = float(np.nanmin(depth_m)) * (1 - RANGE_MARGIN)
        far_m = float(np.nanmax(depth_m)) * (1 + RANGE_MARGIN)
        return cls(camera, near_m, far_m, levels, config or _DEFAULTS)

    @classmethod
    def guarded(cls, camera: Camera, ends_m: tuple[float, float], levels: int) -> "CameraBank":
        """Return the bank for a range as the commands learn it, with a guard around it."""
        return cls(camera, *guarded_range(camera, *ends_m, levels))


@dataclasses.dataclass(frozen=True, eq=False)
class StackBank:
    """A bank for PSFs."""

    stack: PsfStack
    config: LearnConfig = _DEFAULTS

    def learn(self) -> FilterBank:
        """Return the bank; the last ones are remembered."""
        return _learned_from_stack(self)


# A process works through its cells in order of what they need: few at a time are enough.
@lru_cache(maxsize=2)
def _learned(bank: CameraBank) -> FilterBank:
    return with_optics_limits(
        learn_bank_for_camera(bank.camera, bank.near_m, bank.far_m, bank.levels, bank.config)
    )


@lru_cache(maxsize=2)
def _learned_from_stack(bank: StackBank) -> FilterBank:
    return with_optics_limits(learn_bank(bank.stack, bank.config))


def bank_with_refinement(camera: Camera, ends_m: tuple[float, float], levels: int) -> CameraBank:
    """Return a bank that depth is refined with, for the nearest and farthest depth of a scene.

    Where a scene is shallow, for nearer ones too. An `InputError` if there is none.
    """
    for share in _NEAREST:
        range_m = np.array([min(ends_m[0], share * ends_m[1]), ends_m[1]], np.float32)
        with suppress(InputError):
            found = CameraBank.of_scene(camera, range_m, levels)
            bank = found.learn()
            if not unsupported_reason(bank, bank.stride_px):
                return found
    raise InputError("there is no bank for this scene that depth is refined with")


class Predictor:
    """Predicts depth of single frames; the estimator is made when it is needed first."""

    def __init__(self, bank: Bank, config: DepthConfig, camera: Camera | None) -> None:
        self._made_of = bank, config, camera
        # Then a frame's depth follows from those before it, too.
        self._remembers = config.temporal_frames > 0
        self._estimator: DepthEstimator | None = None

    def __call__(self, frame: FloatArray) -> DepthEstimate:
        """Return the depth of a frame, as it was kept or as it is estimated."""
        folder = os.environ.get(PREDICTIONS)
        if not folder or self._remembers:
            return self._estimate(frame)
        path = Path(folder) / f"{_digest((frame, *self._made_of))}.pickle"
        if path.is_file():
            kept: DepthEstimate = pickle.loads(path.read_bytes())
            return kept
        estimate = self._estimate(frame)
        with atomic_output(path) as temporary:
            temporary.write_bytes(pickle.dumps(estimate))
        return estimate

    def _estimate(self, frame: FloatArray) -> DepthEstimate:
        if self._estimator is None:
            bank, config, camera = self._made_of
            self._estimator = DepthEstimator(bank.learn(), config, camera)
        return self._estimator.estimate(frame)

    def close(self) -> None:
        """End the estimator's threads."""
        if self._estimator is not None:
            self._estimator.close()


@contextmanager
def predictor(
    bank: Bank, config: DepthConfig, camera: Camera | None = None
) -> Iterator[Callable[[FloatArray], DepthEstimate]]:
    """Yield a function from a frame to its depth; see `Predictor`."""
    made = Predictor(bank, config, camera)
    try:
        yield made
    finally:
        made.close()


def predict(
    frame: FloatArray, bank: Bank, config: DepthConfig, camera: Camera | None = None
) -> DepthEstimate:
    """Return the depth of one frame; see `Predictor`."""
    with predictor(bank, config, camera) as estimated:
        return estimated(frame)


def _digest(what: Any) -> str:
    return hashlib.sha256(pickle.dumps((what, _source_digest()))).hexdigest()[:32]


@cache
def _source_digest() -> str:
    """Return a digest of the package: its modules, and the weights of its networks."""
    digest = hashlib.sha256()
    root = Path(coded_aperture_ros.__file__).parent
    for path in sorted(root.rglob("*")):
        if path.suffix in _SOURCES:
            digest.update(str(path.relative_to(root)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
