"""Networks that ship, run by PyTorch: the same weights as for OpenCV and ONNX Runtime.

A second runtime on a GPU would have memory of its own, into which maps would have to be copied, and
would need a few GB more of libraries.
"""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch.nn import functional

from coded_aperture_ros.core.tensors.onnx_graph import Graph, Node


class TorchNetwork:
    """Network of a weights' file on a device; see `core.networks.network_of`.

    Parameters
    ----------
    arrays : mapping
        Arrays of the file that the network ships in.
    name : str
        Of the network in that file.
    device : str
        PyTorch's name of the device.
    """

    def __init__(self, arrays: Mapping[str, Any], name: str, device: str) -> None:
        # PyTorch's for the whole process: 10 bits of convolutions' inputs would change levels.
        torch.backends.cudnn.allow_tf32 = False
        graph = Graph.from_bytes(arrays[f"{name}_onnx"].tobytes())
        self._nodes, self._output = graph.nodes, graph.output
        self._weights = {
            key: torch.tensor(array, device=device) for key, array in graph.weights.items()
        }

    def __call__(self, inputs: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Output of the network for its inputs, by their names."""
        values = {**self._weights, **inputs}
        for node in self._nodes:
            found = [values[name] for name in node.inputs]
            values[node.output] = _LAYERS[node.kind](node, *found)
        return values[self._output]


def _convolved(
    node: Node, values: torch.Tensor, weights: torch.Tensor, bias: torch.Tensor
) -> torch.Tensor:
    given = node.attributes
    # Borders are the same on both sides.
    padding, dilation = given["pads"][:2], given["dilations"]
    return functional.conv2d(values, weights, bias, given["strides"], padding, dilation)


def _enlarged(
    node: Node, values: torch.Tensor, weights: torch.Tensor, bias: torch.Tensor
) -> torch.Tensor:
    return functional.conv_transpose2d(values, weights, bias, node.attributes["strides"])


def _joined(node: Node, *values: torch.Tensor) -> torch.Tensor:
    return torch.cat(values, node.attributes["axis"])


def _repeated(node: Node, values: torch.Tensor, *_: torch.Tensor) -> torch.Tensor:
    """Every value as a square of two by two: the one way in which networks enlarge."""
    return functional.interpolate(values, scale_factor=2, mode="nearest")


_LAYERS: Mapping[str, Callable[..., torch.Tensor]] = {
    "Conv": _convolved,
    "ConvTranspose": _enlarged,
    "Relu": lambda node, values: torch.relu(values),
    "Add": lambda node, one, other: one + other,
    "Concat": _joined,
    "Resize": _repeated,
}
