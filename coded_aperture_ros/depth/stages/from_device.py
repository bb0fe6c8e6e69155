"""Copy of a frame's maps from the device that computed them."""

import dataclasses

import numpy as np

from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, Stage, Work

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "costs_on_device"
_MAPS = (
    *("level", "deviation", "confidence", "doubted"),
    *("unknown", "blur_size_px", "depth_m", "std_dev_m"),
)


def make(plan: Plan, config: object) -> Stage:
    """Stage of all maps."""
    return FromDevice()


class FromDevice(Stage):
    """Copies all maps and layers, which later stages and users take for arrays of NumPy."""

    name = "from device"

    def __call__(self, work: Work) -> None:
        """Wait for the device, and replace tensors by arrays."""
        fetch_maps(work)


def fetch_maps(work: Work) -> None:
    """Replace the maps and layers that a frame has so far by arrays in the processor's memory."""
    maps = {name: getattr(work, name, None) for name in _MAPS}
    values = {f"layer {name}": layer.values for name, layer in work.layers.items()}
    tensors = {
        name: each
        for name, each in (maps | values).items()
        if each is not None and not isinstance(each, np.ndarray)
    }
    if not tensors:
        return
    from coded_aperture_ros.core.tensors.transfer import download

    for name, array in download(tensors).items():
        if name in maps:
            setattr(work, name, array)
        else:
            layer = name.removeprefix("layer ")
            work.layers[layer] = dataclasses.replace(work.layers[layer], values=array)
