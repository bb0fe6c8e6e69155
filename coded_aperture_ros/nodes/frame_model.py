"""The camera and the filter bank that frames are worked on with."""

import dataclasses
import time

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node

from coded_aperture_ros.bank import FilterBank, LearnConfig, learn_bank_for_camera, load_bank
from coded_aperture_ros.configuration import check_options, option
from coded_aperture_ros.depth import depths_are_measured
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.nodes.camera_model import fitted_camera, required_camera
from coded_aperture_ros.nodes.messages import MessageError
from coded_aperture_ros.optics import Camera


@dataclasses.dataclass(frozen=True)
class ModelConfig:
    """Camera, filter bank and depth range; nothing of it can change while a node runs."""

    camera_file: str = option("", "Camera file (YAML)", read_only=True)
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
    levels: int = option(
        30, "Blur levels to learn, if no bank is given", minimum=2, maximum=500, read_only=True
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.far_m and self.near_m >= self.far_m:
            raise InputError(f"near_m {self.near_m:g} must be less than far_m {self.far_m:g}")


class FrameModel:
    """Camera and bank for the size of the frames that come.

    Parameters
    ----------
    node : rclpy.node.Node
        To log with.
    config : ModelConfig
    learn_config : LearnConfig
        How to learn the bank if none is given.

    Raises
    ------
    InputError
        If a file does not load, or the bank can be neither loaded nor learned.
    """

    def __init__(self, node: Node, config: ModelConfig, learn_config: LearnConfig) -> None:
        self._logger = node.get_logger()
        self._config = config
        self._learn_config = learn_config
        self._file_camera = required_camera(config.camera_file)
        self.camera = self._file_camera
        self.bank = self._loaded() if config.bank else self._learned()

    def fit(self, width: int, height: int) -> None:
        """Make `camera` and `bank` those for frames of this size.

        A bank that was learned here is learned again for another size. One from a file stays: its
        blur sizes are in pixels, so they mean other depths then.

        Raises
        ------
        MessageError
            Of kind "size", where frames of this size cannot be the camera's, or are too small.
        """
        window_px = self.bank.window_px
        if min(width, height) < window_px:  # before a bank is learned for it in vain
            raise MessageError(
                "size",
                f"the frame is {width}x{height}, the bank needs at least {window_px}x{window_px}",
            )
        camera = fitted_camera(self._file_camera, width, height)
        if camera == self.camera:
            return
        scaled = "" if camera == self._file_camera else ": the camera file is scaled to them"
        self._logger.info(
            f"frames are {width}x{height} now, not {self.camera.image_width}x"
            f"{self.camera.image_height}{scaled}"
        )
        self.camera = camera
        if not self._config.bank:
            self.bank = self._learned()

    def blur_size_px(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the blur size of depths; NaN stays."""
        sizes = None
        if depths_are_measured(self.bank):
            sizes = self.bank.stack.blur_size_at(depth_m)
        return self.camera.blur_size_px(depth_m).astype(np.float32) if sizes is None else sizes

    def _loaded(self) -> FilterBank:
        bank = load_bank(self._config.bank)
        depths_m = bank.stack.depths_m
        if depths_m is None or not depths_are_measured(bank):
            depths_m = self.camera.depth_m(bank.blur_sizes_px)
        near_m, far_m = self._config.near_m, self._config.far_m
        if near_m and depths_m.min() >= near_m:
            self._warn_of_end(depths_m.min(), "nearer")
        if far_m and depths_m.max() <= far_m:
            self._warn_of_end(depths_m.max(), "farther")
        return bank

    def _warn_of_end(self, end_m: float, beyond: str) -> None:
        self._logger.warning(
            f"the bank ends at {end_m:.2f} m, and what is {beyond} will be taken for that: "
            "learn it for a little more than near_m to far_m"
        )

    def _learned(self) -> FilterBank:
        config = self._config
        if not config.far_m:
            raise InputError(
                "without a bank the depth range is needed: set the parameters near_m and far_m, "
                "or bank to a file made by 'coded_aperture learn'"
            )
        # A range that does not suit the camera is told before it is said to be learned.
        self.camera.blur_range_px(config.near_m, config.far_m)
        started_s = time.monotonic()
        self._logger.info(
            f"learning a bank of {config.levels} levels for {config.near_m:g} to "
            f"{config.far_m:g} m from {config.camera_file}"
        )
        try:
            bank = self._learned_for(*guarded_range(self.camera, config))
        except InputError:  # a level beyond the range that does not fit the window, say
            bank = self._learned_for(config.near_m, config.far_m, config.levels)
        self._logger.info(f"learned the bank in {time.monotonic() - started_s:.1f} s")
        return bank

    def _learned_for(self, near_m: float, far_m: float, levels: int) -> FilterBank:
        return learn_bank_for_camera(self.camera, near_m, far_m, levels, self._learn_config)


def guarded_range(camera: Camera, config: ModelConfig) -> tuple[float, float, int]:
    """Return a range with one more level on either side, and its number of levels.

    What is too near or beyond the range is the most like one of these levels. Without them it
    would be taken, with full confidence, for something at the end of the range.
    """
    ends = np.array(camera.blur_range_px(config.near_m, config.far_m))
    step = (ends[1] - ends[0]) / (config.levels - 1)
    beyond = np.array([ends[0] - step, ends[1] + step])
    # At most half of the way to the plane in focus or to infinity.
    focus_end = np.argmin(np.abs(ends))
    if abs(beyond[focus_end]) < abs(ends[focus_end]) / 2 or beyond[focus_end] * ends[0] < 0:
        beyond[focus_end] = ends[focus_end] / 2
    beyond[1] = min(beyond[1], (ends[1] + camera.blur_at_infinity_px) / 2)
    near_m, far_m = camera.depth_m(beyond)
    return float(near_m), float(far_m), config.levels + 2
