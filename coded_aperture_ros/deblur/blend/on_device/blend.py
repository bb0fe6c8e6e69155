"""Blended picture of a frame and its blur sizes, on a device; see `Blend`."""

from typing import Any

import torch

from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.core.tensors.networks import TorchNetwork
from coded_aperture_ros.core.tensors.transfer import download, upload_to
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.blend import blend
from coded_aperture_ros.deblur.blend.on_device.hypotheses import DeviceHypotheses
from coded_aperture_ros.optics import PsfStack


class DeviceBlend(blend.Blend):
    """Weighted sum of the hypotheses of each pixel, on a device.

    A frame is copied there and back once. Not for several threads at once.

    Parameters
    ----------
    stack : PsfStack
    rank : int
        See `InverseFilters`.
    workers : Workers
        Threads that make the filters.
    device : str
        PyTorch's name of the device.
    """

    def __init__(self, stack: PsfStack, rank: int, workers: Workers, device: str) -> None:
        self._brightness = DeviceHypotheses(stack, rank, workers)
        self._colour = DeviceHypotheses(stack, max(rank // 2, 2), workers)
        arrays = read_shipped(blend.__file__, blend.WEIGHTS, blend.SCHEMA, blend.SCHEMA_VERSION)
        self._network: Any = TorchNetwork(arrays, "blend", device)
        self._upload = upload_to(device)

    @torch.inference_mode()
    def _blended(
        self,
        channels: list[FloatArray],
        blur: FloatArray,
        known: BoolArray,
        noise: float,
        allowed: float,
    ) -> list[FloatArray]:
        """Deblurred `opponents`, which lie in the processor's memory again."""
        given: list[Any] = [self._upload(each) for each in (blur, known, *channels)]
        found = super()._blended(given[2:], given[0], given[1], noise, allowed)
        pictures = download({str(number): each for number, each in enumerate(found)})
        return list(pictures.values())
