"""Camera models that a driver sends, and which of them belongs to a frame."""

from collections.abc import Callable
from typing import Any

from coded_aperture_ros.io.messages.camera_info import (
    check_camera_info,
    has_matrices,
    without_matrices,
)
from coded_aperture_ros.io.messages.encodings import MessageError, stamp_ns

# Models kept by their stamp: a frame may wait for its depth while so many others come.
_KEPT = 200


class CameraInfos:
    """Keeps camera models: the one with a frame's stamp belongs to it, or else the newest.

    One with a value that no camera can have is refused: the one before it holds. Where there is
    none, its region and binning hold, and so do those of a driver without a calibration: what a
    frame shows of the view does not depend on K.

    Parameters
    ----------
    refuse : callable
        Called with the reason why a model is refused, in a line.
    """

    def __init__(self, refuse: Callable[[str], None] = lambda reason: None) -> None:
        self._refuse = refuse
        self._newest: Any = None
        self._by_stamp: dict[int, Any] = {}
        self._checked: tuple[Any, ...] | None = (
            None  # content of the last model that was not refused
        )

    def receive(self, info: Any) -> None:
        """Keep a model."""
        try:
            if has_matrices(info):
                self._check(info)
        except MessageError as error:
            self._refuse(f"{error}; using the camera_info before it, or else the camera file")
            self._keep_region(info)
            return
        if not has_matrices(info):
            self._keep_region(info)
            return
        self._newest = info
        if stamp := stamp_ns(info.header):
            self._by_stamp.pop(stamp, None)  # a repeated one moves to the end: it is dropped last
            self._by_stamp[stamp] = info
        if len(self._by_stamp) > _KEPT:
            del self._by_stamp[next(iter(self._by_stamp))]

    def at(self, stamp: int) -> Any:
        """Model for a frame with a stamp, ns; None if none has come."""
        return self._by_stamp.get(stamp, self._newest)

    def has(self, stamp: int) -> bool:
        """Whether the model with this very stamp has come."""
        return stamp in self._by_stamp

    def forget_stamps(self) -> None:
        """Keep the newest model only: stamps repeat after the clock has jumped back."""
        self._by_stamp = {}

    def _check(self, info: Any) -> None:
        """Check a model, unless it has the content of the last one: cameras repeat it every frame.

        The check takes .2 ms, and the frame waits for it.
        """
        matrices = (tuple(getattr(info, name)) for name in "dkrp")
        content = (info.width, info.height, info.distortion_model, *matrices)
        if content != self._checked:
            check_camera_info(info)
            self._checked = content

    def _keep_region(self, info: Any) -> None:
        known = self._newest is not None and has_matrices(self._newest)
        if not known and info.width and info.height:
            self._newest = without_matrices(info)
