"""Camera of the frames, and the model prepared for it: likelihoods of depth, or PSFs."""

import dataclasses
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from rclpy.node import Node

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.depth import depths_are_measured
from coded_aperture_ros.depth.levels import check_camera
from coded_aperture_ros.frames import PatchGrid, View
from coded_aperture_ros.io.messages import MessageError
from coded_aperture_ros.likelihood import BlurLevels
from coded_aperture_ros.likelihood.bank import (
    DEFAULT_LEVEL_COUNT,
    FilterBank,
    check_frame_size,
    check_setting,
    load_bank,
)
from coded_aperture_ros.likelihood.bank.for_camera import guarded_range
from coded_aperture_ros.likelihood.bank.remap import remap_bank
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.ros.camera_model import required_camera
from coded_aperture_ros.ros.parameters import NodeParameters

Model = TypeVar("Model", bound=BlurLevels)


@dataclasses.dataclass(frozen=True)
class ModelConfig:
    """Camera, filter bank and depth range; only the camera can change while a node runs."""

    camera_file: str = option("", "Camera file (YAML), needed; may be changed while the node runs")
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
        within=(2, 500),
        read_only=True,
        parameter="learn.level_count",
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.far_m and self.near_m >= self.far_m:
            raise InputError(f"near_m {self.near_m:g} must be less than far_m {self.far_m:g}")


@dataclasses.dataclass(frozen=True, eq=False)
class _State(Generic[Model]):
    """Camera and model that belong together; a frame is processed with one such state."""

    file_camera: Camera
    camera: Camera
    model: Model


class FrameModel(Generic[Model]):
    """Camera and model for the size of the frames.

    A new camera file is prepared in full before anything changes, so that one that cannot be used
    leaves everything as it was; it takes effect with the next call of `fit`.

    Parameters
    ----------
    node : Node
        Its logger is used.
    parameters : NodeParameters
        With `ModelConfig`.
    make : callable
        Makes a model from a camera and a bank, or from a camera and a depth range; see `new_model`.

    Raises
    ------
    InputError
        If a file does not load, or the model cannot be made.
    """

    def __init__(self, node: Node, parameters: NodeParameters, make: Callable[..., Model]) -> None:
        self._logger = node.get_logger()
        config = parameters[ModelConfig]
        self._config = config
        self._make = make
        self._view: View | None = None
        self._first_camera = required_camera(config.camera_file)
        camera = self._first_camera
        self._bank = load_bank(config.bank) if config.bank else None
        if self._bank is not None:
            camera = check_setting(self._bank, camera)
            self._check_range(self._bank, camera)
        model = self._model_for(self._first_camera, camera, config)
        self._state = _State(self._first_camera, camera, model)
        self._prepared: _State[Model] | None = None
        # Set in the executor's thread, taken in the worker's.
        self._next: deque[_State[Model]] = deque(maxlen=1)
        parameters.on_change(ModelConfig, self._prepare, self._take_over, reads_files=True)

    @property
    def camera(self) -> Camera:
        """Camera of the frames, after region of interest and binning."""
        return self.whole if self._view is None else self.whole.for_view(self._view)

    @property
    def whole(self) -> Camera:
        """Camera of the whole view, in pixels of the frames."""
        return self._state.camera

    @property
    def model(self) -> Model:
        """Model for the frames."""
        return self._state.model

    def identity(self) -> dict[str, str]:
        """Keys and values of /diagnostics: camera file, bank, and the digest of the mask."""
        model = self.model
        bank = self._config.bank or "learned at start"
        return {
            "camera_file": self._config.camera_file,
            "bank": f"{bank}, {len(model.stack)} levels from {model.learned_from}",
            "mask_digest": model.mask_digest[:12] or "not known",
        }

    def _prepare(self, config: ModelConfig) -> None:
        """Prepare camera and model of a new camera file, or raise an `InputError`."""
        file_camera = required_camera(config.camera_file)
        camera = self._resized(file_camera)
        model = self._model_for(file_camera, camera, config)
        check_camera(model, camera)
        self._prepared = _State(file_camera, camera, model)

    def _take_over(self, config: ModelConfig) -> None:
        assert self._prepared is not None  # by `_prepare`, just before
        self._config = config
        self._next.append(self._prepared)
        self._logger.info(f"camera file {config.camera_file} is used from the next frame on")

    def fit(self, view: View) -> None:
        """Set `camera` and `model` to those for frames with this view.

        A model that was learned by the node is learned again for another size; a bank from a file
        is remapped where the driver says that it bins.

        Raises
        ------
        MessageError
            Of kind "size", if the camera cannot take frames of this size, or they are too small, or
            the bank is for another size.
        """
        if self._next:
            self._state = self._next.pop()
        size = view.whole_width, view.whole_height
        file_camera = self._state.file_camera
        bank = self._bank
        try:
            # First, lest a bank is learned in vain for frames smaller than a window.
            PatchGrid.covering((view.height, view.width), self.model.window_px, 1)
            camera = file_camera.resized(*size)
            if bank is not None and not view.is_binned:
                check_frame_size(bank, *size)
        except InputError as error:
            raise MessageError("size", str(error)) from error
        if camera != self.whole:
            scaled = "" if camera == file_camera else ", the camera file is scaled to it"
            self._logger.info(
                f"frame size changed from {self.whole.image_width}x{self.whole.image_height} to "
                f"{size[0]}x{size[1]} (whole view){scaled}"
            )
            model = self._model_for(file_camera, camera, self._config)
            self._state = _State(file_camera, camera, model)
        self._view = view  # only of frames that can be processed

    def change(self, changed: Callable[[Model], Model]) -> None:
        """Replace the model by a changed one; not while a frame is processed with it."""
        self._state = dataclasses.replace(self._state, model=changed(self._state.model))

    def _resized(self, file_camera: Camera) -> Camera:
        """Camera file scaled to the size of the last frame, or else of the bank's frames."""
        view = self._view
        bank = self._bank
        if view is not None:
            return file_camera.resized(view.whole_width, view.whole_height)
        if bank is not None and bank.image_width:
            return file_camera.resized(bank.image_width, bank.image_height)
        return file_camera

    def _model_for(self, file_camera: Camera, camera: Camera, config: ModelConfig) -> Model:
        """Model for a camera file, scaled to `camera`: the bank, remapped if needed, or learned."""
        bank = self._bank
        if bank is None:
            return self._learn(camera, config)
        near_m, far_m = None, None
        if config.near_m and config.far_m:
            near_m, far_m = config.near_m, config.far_m
        size = camera.image_width, camera.image_height
        if bank.image_width and (bank.image_width, bank.image_height) != size:
            if near_m is None:
                depths_m = bank.stack.depths_m
                if depths_m is None:
                    own = file_camera.resized(bank.image_width, bank.image_height)
                    depths_m = own.depth_m(bank.blur_sizes_px)
                near_m, far_m = float(depths_m.min()), float(depths_m.max())
            bank = remap_bank(bank, camera, near_m, far_m)
        elif bank.mask_digest and bank.mask_digest != camera.mask.digest:
            raise InputError(
                f"{config.camera_file}: the bank is for another mask than {camera.mask.name}: "
                "learn a bank for this camera file"
            )
        elif file_camera.setting_digest != self._first_camera.setting_digest:
            if bank.pattern:
                bank = remap_bank(bank, camera, near_m, far_m)
            elif bank.mask_digest:  # the same filters, if their levels still have depths
                bank = remap_bank(bank, camera)
        return self._make(camera=camera, bank=bank)

    def _check_range(self, bank: FilterBank, camera: Camera) -> None:
        """Compare near_m and far_m with the bank's levels; an `InputError` if they do not overlap.

        Warns where the levels do not extend beyond the range: no depth could be outside then.
        """
        depths_m = bank.stack.depths_m
        if depths_m is None or not depths_are_measured(bank):
            depths_m = camera.depth_m(bank.blur_sizes_px)
        near_m = self._config.near_m
        far_m = self._config.far_m
        if depths_m.max() <= near_m or 0 < far_m <= depths_m.min():
            raise InputError(
                f"near_m, far_m: {near_m:g} to {far_m:g} m, but the bank's levels are at "
                f"{depths_m.min():.4g} to {depths_m.max():.4g} m: set a range that overlaps them"
            )
        ends = (
            (near_m and depths_m.min() >= near_m, depths_m.min(), "nearer"),
            (far_m and depths_m.max() <= far_m, depths_m.max(), "farther"),
        )
        for ends_within_range, end_m, beyond in ends:
            if ends_within_range:
                self._logger.warning(
                    f"the bank ends at {end_m:.2f} m, {beyond} objects get that depth: "
                    "learn it for a little more than near_m to far_m"
                )

    def _learn(self, camera: Camera, config: ModelConfig) -> Model:
        """Model learned for the depth range, with a guard level beyond each end if it fits."""
        if not config.far_m:
            raise InputError(
                "without a bank the depth range is needed: set the parameters near_m and far_m, "
                "or bank to a file made by 'coded_aperture learn'"
            )
        range_m = config.near_m, config.far_m
        guarded = guarded_range(camera, *range_m, config.level_count)
        started_s = time.monotonic()
        self._logger.info(
            f"learning {config.level_count} levels for {config.near_m:g} to {config.far_m:g} m "
            f"from {config.camera_file}"
        )
        try:
            model = self._make(camera=camera, depth_range_m=guarded[:2], level_count=guarded[2])
            if isinstance(model, FilterBank):
                model = dataclasses.replace(model, guard_levels=1)
        except InputError:  # for example, a level beyond the range does not fit the window
            count = config.level_count
            model = self._make(camera=camera, depth_range_m=range_m, level_count=count)
        self._logger.info(f"learned in {time.monotonic() - started_s:.1f} s")
        return model
