"""Slow averages and drift of a depth node, for /diagnostics."""

import time
from collections.abc import Callable

from coded_aperture_ros.depth import DepthConfig, DepthEstimate
from coded_aperture_ros.depth.drift import DriftWatch
from coded_aperture_ros.depth.quality import unchecked_reason
from coded_aperture_ros.frames import Frame
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.ros.diagnostics import Complaint


class NodeDrift:
    """Watches the frames of a node against its present bank.

    Parameters
    ----------
    now : callable
        Steady clock, s.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._watch: DriftWatch | None = None
        self._model: LikelihoodModel | None = None

    def use(self, model: LikelihoodModel) -> None:
        """Take a bank for the frames to come; the watch begins anew with another one.

        Of PSFs without sizes it is not known where parts of the mask are: they are not watched.
        """
        if model is self._model:
            return
        self._model, self._watch = model, None
        if not isinstance(model, FilterBank) or model.stack.nominal or not model.stack.in_pixels:
            return
        if not unchecked_reason(model.stack):
            self._watch = DriftWatch(model.stack, middle_only=model.field is not None)

    def see(
        self, frame: Frame, estimate: DepthEstimate, config: DepthConfig
    ) -> tuple[dict[str, float], Complaint | None]:
        """Averages up to a frame, and the complaint about what has changed, if anything has."""
        if self._watch is None:
            return {}, None
        now_s = self._now()
        if config.check_fit and self._watch.due(now_s):
            self._watch.see(now_s, frame, estimate, config.saturation)
        drift = self._watch.drift
        if drift is None:
            return self._watch.figures(), None
        minutes = (now_s - drift.since_s) / 60
        text = f"drifting since {minutes:.0f} min: {drift.text}"
        return self._watch.figures() | {"drifting_min": minutes}, Complaint(text)
