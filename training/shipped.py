"""The network in the file that ships, in the form in which it can be fitted further."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import onnx
import torch
from batches import Batch
from network import Refinement
from onnx import numpy_helper
from torch import nn

from coded_aperture_ros.core.archive import read_archive
from coded_aperture_ros.depth.decoders.network.network import SCHEMA, SCHEMA_VERSION

_PARTS = ("levels_onnx", "cells_onnx")
_FIRST = "every_level.layers.first"
# Of the modules that are exported, and where they are in the network.
_PREFIXES = {"layers.": "every_level.layers.", "network.": ""}


def shipped(path: Path) -> Refinement:
    """Return the network of a file that `export.py` wrote.

    Its normalisations were folded into the convolutions before them: here they only add what is
    left of them. `normalised` makes them what they were.
    """
    arrays = read_archive(path, SCHEMA, SCHEMA_VERSION)
    values = {
        name: tensor for part in _PARTS for name, tensor in _initializers(arrays[part]).items()
    }
    for layer in ("first", "size", "choice"):
        name = _FIRST if layer == "first" else layer
        values[f"{name}.weight"] = arrays[f"{layer}_weights"][:, :, None, None]
        values[f"{name}.bias"] = arrays[f"{layer}_bias"]
    values["trust"] = arrays["trust"]
    network = Refinement()
    state = network.state_dict()
    for convolution, norm in _pairs(network):
        bias = values.pop(f"{convolution}.bias")
        values[f"{norm}.bias"] = bias
        state[f"{norm}.running_var"] -= network.get_submodule(norm).eps
    missing = [name for name in values if name not in state]
    if missing:
        raise SystemExit(f"{path}: has weights that this network lacks: {', '.join(missing)}")
    for name, value in values.items():
        state[name] = torch.from_numpy(np.array(value, np.float32)).reshape(state[name].shape)
    network.load_state_dict(state)
    return network


def normalised(network: Refinement, batches: Iterable[Batch]) -> None:
    """Let the normalisations know what passes through them: the network gives what it gave."""
    moments: dict[nn.BatchNorm2d, list[torch.Tensor]] = {}

    def keep(norm: nn.BatchNorm2d, shown: tuple[torch.Tensor], _: torch.Tensor) -> None:
        values = shown[0].double().transpose(0, 1).flatten(1)
        moments.setdefault(norm, []).append(torch.stack([values.mean(1), (values**2).mean(1)]))

    norms = [module for module in network.modules() if isinstance(module, nn.BatchNorm2d)]
    hooks = [norm.register_forward_hook(keep) for norm in norms]
    network.eval()
    with torch.no_grad():
        for batch in batches:
            network(batch.costs, batch.frame)
        for norm in norms:
            mean, square = torch.stack(moments[norm]).mean(0)
            variance = (square - mean**2).clamp(min=0) + norm.eps
            norm.bias += mean.float()
            norm.weight.copy_(variance.sqrt())
            norm.running_mean.copy_(mean)
            norm.running_var.copy_(variance - norm.eps)
    for hook in hooks:
        hook.remove()


def _initializers(model: np.ndarray) -> dict[str, np.ndarray]:
    """Return the weights in a module that was exported, by their names in the network."""
    graph = onnx.load_from_string(model.tobytes()).graph
    found = {}
    for one in graph.initializer:
        for prefix, place in _PREFIXES.items():
            if one.name.startswith(prefix):
                found[place + one.name.removeprefix(prefix)] = numpy_helper.to_array(one)
    return found


def _pairs(network: Refinement) -> list[tuple[str, str]]:
    """Return the names of convolutions, and of the normalisations that are folded into them."""
    found = []
    for name, module in network.named_modules():
        children = dict(module.named_children())
        for first, second in (("0", "1"), ("spatial", "norm")):
            if isinstance(children.get(second), nn.BatchNorm2d):
                found.append((f"{name}.{first}".lstrip("."), f"{name}.{second}".lstrip(".")))
    return found
