"""Work on a device as one recorded step: thousands of small operations are started at once."""

import logging
from collections.abc import Callable, Mapping
from typing import Any

import torch
from numpy.typing import NDArray

from coded_aperture_ros.core.tensors.transfer import copy_without_waiting, tensor_of

Tensors = Mapping[str, torch.Tensor]
# Calls before one is recorded: libraries choose their ways and constants are copied in them.
_WARM_UP = 2


class Recorded:
    """Function of tensors by name; on a GPU it is recorded once, and then repeated as a CUDA graph.

    A GPU takes a few microseconds for most operations, and Python as long to start each. The
    function must not look at values, and inputs must keep their shapes. What cannot be recorded
    runs as it is.

    Parameters
    ----------
    function : callable
        Takes and returns tensors by name.
    device : str
        PyTorch's name of the device.
    """

    def __init__(self, function: Callable[[Tensors], Tensors], device: str) -> None:
        self._function = function
        self._device = torch.device(device)
        self._inputs: dict[str, torch.Tensor] = {}
        self._graph: Any = None
        self._outputs: Tensors = {}
        self._records = self._device.type == "cuda"

    @property
    def is_recorded(self) -> bool:
        """Whether there is a graph that is repeated."""
        return self._graph is not None

    @torch.inference_mode()
    def __call__(self, inputs: Mapping[str, NDArray[Any] | torch.Tensor]) -> Tensors:
        """Outputs, which the next call overwrites."""
        if self._device.type == "cpu":
            return self._function({name: tensor_of(values) for name, values in inputs.items()})
        self._take(inputs)
        if self._graph is None and self._records:
            self._record()
        if self._graph is None:
            return self._function(self._inputs)
        self._graph.replay()
        return self._outputs

    def _take(self, inputs: Mapping[str, NDArray[Any] | torch.Tensor]) -> None:
        """Copy the inputs to where the recorded step reads them."""
        for name, values in inputs.items():
            given = tensor_of(values)
            if name not in self._inputs:
                self._inputs[name] = torch.empty_like(given, device=self._device)
            copy_without_waiting(self._inputs[name], given)

    def _record(self) -> None:
        """Record the function as a graph, or find that it cannot be."""
        stream = torch.cuda.current_stream()
        try:
            beside = torch.cuda.Stream()
            beside.wait_stream(stream)
            with torch.cuda.stream(beside):
                for _ in range(_WARM_UP):
                    self._function(self._inputs)
            stream.wait_stream(beside)
            graph = torch.cuda.CUDAGraph()
            # Other threads may use the GPU meanwhile, as for deblurring.
            with torch.cuda.graph(graph, capture_error_mode="thread_local"):
                self._outputs = self._function(self._inputs)
            self._graph = graph
        except RuntimeError as error:
            torch.cuda.set_stream(stream)
            self._records = False
            logging.getLogger(__name__).warning(
                f"CUDA graph: not recorded, running step by step: {error}"
            )
