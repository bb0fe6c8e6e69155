"""Closed forms of a frame on a device; see `InverseHypotheses`."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from coded_aperture_ros.core.tensors.constants import kept_on_device
from coded_aperture_ros.core.tensors.functions import interp
from coded_aperture_ros.deblur.blend.hypotheses import HYPOTHESIS_PAIRS, InverseHypotheses
from coded_aperture_ros.deblur.inverse_filters import STEPS_PER_LEVEL
from coded_aperture_ros.frames import extend_periodically, periodic_shape

# Filters of so many sizes of frames and noises are kept on the device; one is 15 MB at 640x480.
_KEPT = 8


class DeviceHypotheses(InverseHypotheses):
    """Inverse filters of a camera, combined for several blur sizes at each pixel, on a device."""

    def __init__(self, *settings: Any) -> None:
        super().__init__(*settings)
        self._on_device: list[tuple[NDArray[np.complex64], torch.Tensor]] = []

    def table_steps(self, blur: torch.Tensor) -> torch.Tensor:
        """Step of each signed blur size among those of the tables."""
        sizes_px = self._stack.blur_sizes_px[self._order]
        level = interp(blur, sizes_px, np.arange(len(sizes_px)))
        return torch.round(level * STEPS_PER_LEVEL).long()

    def compute(self, channel: torch.Tensor, steps: torch.Tensor, noise: float) -> torch.Tensor:
        """Hypotheses [HYPOTHESES, rows, columns] of a channel; the last is itself."""
        rows, columns = channel.shape
        shape = periodic_shape((rows, columns), self._extension_px)
        host_transforms, lookup = self._filters((rows, columns), noise)
        transforms = self._kept(host_transforms, channel.device)
        table = kept_on_device(lookup, channel.device).reshape(
            len(lookup), -1, len(self.model_errors)
        )
        extended: Any = extend_periodically(channel, shape)
        spectrum = torch.fft.rfft2(extended)
        filtered = torch.fft.irfft2(spectrum * transforms, s=shape)[:, :rows, :columns]
        found = [
            (table[:, :, error][:, steps[size]] * filtered).sum(0)
            for size, error in HYPOTHESIS_PAIRS.tolist()
        ]
        return torch.stack([*found, channel])

    def _kept(self, transforms: NDArray[np.complex64], device: torch.device) -> torch.Tensor:
        """Transforms on the device; those of an array are copied once."""
        for array, held in self._on_device:
            if array is transforms:
                return held
        self._on_device = [
            *self._on_device[1 - _KEPT :],
            (transforms, torch.tensor(transforms, device=device)),
        ]
        return self._on_device[-1][1]
