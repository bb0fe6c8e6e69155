"""The camera and the filter bank that frames are worked on with."""

import dataclasses
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node

from coded_aperture_ros.bank import (
    DEFAULT_LEVEL_COUNT,
    FilterBank,
    LearnConfig,
    learn_bank_for_camera,
    load_bank,
)
from coded_aperture_ros.calibration.planes.remap import remap_bank
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.depth import depths_are_measured
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.ros.camera_model import fitted_camera, required_camera
from coded_aperture_ros.ros.messages import MessageError
from coded_aperture_ros.ros.parameters import NodeParameters


@dataclasses.dataclass(frozen=True)
class ModelConfig:
    """Camera, filter bank and depth range; only the camera can change while a node runs."""

    camera_file: str = option("", "Camera file (YAML); may be changed while the node runs")
    bank: str = option(
        "", "Filter bank (.npz); empty: learn it at start from the camera file", read_only=True
    )
    near_m: float = option(
        0.0,
        "Nearest depth: learn from here, publish -Inf below; 0: no limit",
        unit="m",
        minimum=0,
        read_only=True,
    )
    far_m: float = option(
        0.0,
        "Farthest depth: learn up to here, publish +Inf beyond; 0: no limit",
        unit="m",
        minimum=0,
        read_only=True,
    )
    level_count: int = option(
        DEFAULT_LEVEL_COUNT,
        "Blur levels to learn, if no bank is given",
        minimum=2,
        maximum=500,
        read_only=True,
        formerly="levels",
        parameter="learn.level_count",
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.far_m and self.near_m >= self.far_m:
            raise InputError(f"near_m {self.near_m:g} must be less than far_m {self.far_m:g}")


@dataclasses.dataclass(frozen=True, eq=False)
class _State:
    """What belongs together: a frame is worked on with all of one state."""

    file_camera: Camera
    camera: Camera
    bank: FilterBank


class FrameModel:
    """Camera and bank for the size of the frames that come.

    A new camera file is prepared in full before anything changes, so that one that cannot be used
    leaves everything as it was; it takes effect with the next frame that `fit` is called for.

    Parameters
    ----------
    node : rclpy.node.Node
        To log with.
    parameters : NodeParameters
        Of the node, with `ModelConfig` and `LearnConfig`.
    learn : callable, optional
        Makes what stands in for a bank from a camera, its nearest and farthest depth and the number
        of levels; by default a bank is learned.

    Raises
    ------
    InputError
        If a file does not load, or the bank can be neither loaded nor learned.
    """

    def __init__(
        self,
        node: Node,
        parameters: NodeParameters,
        learn: Callable[[Camera, float, float, int], FilterBank] | None = None,
    ) -> None:
        self._logger = node.get_logger()
        self._config = config = parameters[ModelConfig]
        self._learn_config = parameters[LearnConfig]
        self._learn = learn
        self._frame_size: tuple[int, int] | None = None
        camera = required_camera(config.camera_file)
        self._first_camera = camera
        self._file_bank = load_bank(config.bank) if config.bank else None
        bank = self._file_bank
        if bank is None:
            bank = self._learned(camera, config)
        else:
            self._warn_of_ends(bank, camera)
        self._state = _State(camera, camera, bank)
        self._prepared: _State | None = None
        self._next: _State | None = None
        parameters.on_change(ModelConfig, self._prepare, self._take_over)

    @property
    def camera(self) -> Camera:
        """The camera of the frames."""
        return self._state.camera

    @property
    def bank(self) -> FilterBank:
        """The bank for them."""
        return self._state.bank

    def identity(self) -> dict[str, str]:
        """Return which camera and bank these are, in words."""
        bank = self._config.bank or "learned at start"
        digest = self.bank.mask_digest[:12] or "not known"
        return {
            "camera_file": self._config.camera_file,
            "bank": f"{bank}, {self.bank.levels} levels from {self.bank.learned_from}",
            "mask_digest": digest,
        }

    def _prepare(self, config: ModelConfig) -> None:
        """Make everything for a new camera file, or raise an `InputError`."""
        file_camera = required_camera(config.camera_file)
        camera = file_camera
        if self._frame_size is not None:
            camera = fitted_camera(file_camera, *self._frame_size)
        bank = self._file_bank
        if bank is None:
            bank = self._learned(camera, config)
        elif bank.pattern is not None and _setting(file_camera) != _setting(self._first_camera):
            ranged = bool(config.near_m and config.far_m)
            wanted = (config.near_m, config.far_m) if ranged else (None, None)
            bank = remap_bank(bank, camera, *wanted)
        elif bank.mask_digest and bank.mask_digest != camera.mask.digest:
            raise InputError(
                f"{config.camera_file}: the bank is for another mask than {camera.mask.name}"
            )
        self._prepared = _State(file_camera, camera, bank)

    def _take_over(self, config: ModelConfig) -> None:
        self._config, self._next = config, self._prepared
        self._logger.info(f"camera file is {config.camera_file} from the next frame on")

    def fit(self, width: int, height: int) -> None:
        """Make `camera` and `bank` those for frames of this size.

        A bank that was learned here is learned again for another size. One from a file stays: its
        blur sizes are in pixels, so they mean other depths then.

        Raises
        ------
        MessageError
            Of kind "size", where frames of this size cannot be the camera's, or are too small.
        """
        if self._next is not None:
            self._state, self._next = self._next, None
        window_px = self.bank.window_px
        if min(width, height) < window_px:  # before a bank is learned for it in vain
            raise MessageError(
                "size",
                f"the frame is {width}x{height}, the bank needs at least {window_px}x{window_px}",
            )
        file_camera = self._state.file_camera
        camera = fitted_camera(file_camera, width, height)
        self._frame_size = width, height
        if camera == self.camera:
            return
        scaled = "" if camera == file_camera else ": the camera file is scaled to them"
        self._logger.info(
            f"frames are {width}x{height} now, not {self.camera.image_width}x"
            f"{self.camera.image_height}{scaled}"
        )
        bank = self.bank if self._config.bank else self._learned(camera, self._config)
        self._state = _State(file_camera, camera, bank)

    def blur_size_px(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the blur size of depths; NaN stays."""
        sizes = None
        if depths_are_measured(self.bank):
            sizes = self.bank.stack.blur_size_at(depth_m)
        return self.camera.blur_size_px(depth_m).astype(np.float32) if sizes is None else sizes

    def _warn_of_ends(self, bank: FilterBank, camera: Camera) -> None:
        depths_m = bank.stack.depths_m
        if depths_m is None or not depths_are_measured(bank):
            depths_m = camera.depth_m(bank.blur_sizes_px)
        near_m, far_m = self._config.near_m, self._config.far_m
        if near_m and depths_m.min() >= near_m:
            self._warn_of_end(depths_m.min(), "nearer")
        if far_m and depths_m.max() <= far_m:
            self._warn_of_end(depths_m.max(), "farther")

    def _warn_of_end(self, end_m: float, beyond: str) -> None:
        self._logger.warning(
            f"the bank ends at {end_m:.2f} m, and what is {beyond} will be taken for that: "
            "learn it for a little more than near_m to far_m"
        )

    def _learned(self, camera: Camera, config: ModelConfig) -> FilterBank:
        if not config.far_m:
            raise InputError(
                "without a bank the depth range is needed: set the parameters near_m and far_m, "
                "or bank to a file made by 'coded_aperture learn'"
            )
        # A range that does not suit the camera is told before it is said to be learned.
        camera.blur_range_px(config.near_m, config.far_m)
        started_s = time.monotonic()
        self._logger.info(
            f"learning a bank of {config.level_count} levels for {config.near_m:g} to "
            f"{config.far_m:g} m from {config.camera_file}"
        )
        try:
            bank = self._learned_for(camera, *guarded_range(camera, config))
        except InputError:  # a level beyond the range that does not fit the window, say
            bank = self._learned_for(camera, config.near_m, config.far_m, config.level_count)
        self._logger.info(f"learned the bank in {time.monotonic() - started_s:.1f} s")
        return bank

    def _learned_for(self, camera: Camera, near_m: float, far_m: float, levels: int) -> FilterBank:
        if self._learn is not None:
            return self._learn(camera, near_m, far_m, levels)
        return learn_bank_for_camera(camera, near_m, far_m, levels, self._learn_config)


def _setting(camera: Camera) -> tuple[object, ...]:
    """Return what of a camera file tells at which depth a blur size occurs."""
    return (
        camera.focus_distance_m,
        camera.focal_length_px,
        camera.image_width,
        camera.side,
        camera.lens_mask_distance_mm,
    )


def guarded_range(camera: Camera, config: ModelConfig) -> tuple[float, float, int]:
    """Return a range with one more level on either side, and its number of levels.

    What is too near or beyond the range is the most like one of these levels. Without them it
    would be taken, with full confidence, for something at the end of the range.
    """
    ends = np.array(camera.blur_range_px(config.near_m, config.far_m))
    step = (ends[1] - ends[0]) / (config.level_count - 1)
    beyond = np.array([ends[0] - step, ends[1] + step])
    # At most half of the way to the plane in focus or to infinity.
    focus_end = np.argmin(np.abs(ends))
    nearer_focus = abs(beyond[focus_end]) < abs(ends[focus_end]) / 2
    if ends[0] * ends[1] > 0 and (nearer_focus or beyond[focus_end] * ends[0] < 0):
        beyond[focus_end] = ends[focus_end] / 2
    beyond[1] = min(beyond[1], (ends[1] + camera.blur_at_infinity_px) / 2)
    near_m, far_m = camera.depth_m(beyond)
    return float(near_m), float(far_m), config.level_count + 2
