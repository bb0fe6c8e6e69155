"""Networks of the package in whole numbers of 8 bits, for ONNX Runtime."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import version_converter
from onnxruntime.quantization import (
    CalibrationDataReader,
    QuantFormat,
    QuantType,
    quant_pre_process,
    quantize_static,
)
from shards import Arrays

Run = Callable[[Mapping[str, np.ndarray]], np.ndarray]
# The oldest that can quantise by channel.
_QUANTISED_OPSET = 13


def recording(run: Run, inputs: list[Arrays]) -> Run:
    """Network that keeps what it is given in a list."""

    def keep(given: Mapping[str, np.ndarray]) -> np.ndarray:
        inputs.append({name: values.copy() for name, values in given.items()})
        return run(given)

    return keep


def quantised(model: np.ndarray, inputs: Sequence[Arrays], exact: Sequence[str]) -> np.ndarray:
    """Network of `to_onnx` with weights of 7 bits and layers of 8, for ONNX Runtime.

    With weights of 8 bits sums of two products would overflow on processors that lack AVX-512 VNNI.

    Parameters
    ----------
    model : ndarray, uint8
    inputs : sequence of dict
        What it is given for some frames, which tells the ranges of the layers.
    exact : sequence of str
        Layers, by a part of their names, that stay as they are.
    """
    with tempfile.TemporaryDirectory() as folder:
        plain, ready, found = (
            Path(folder) / f"{name}.onnx" for name in ("plain", "ready", "quantised")
        )
        onnx.save(_with_free_sizes(model), plain)
        quant_pre_process(str(plain), str(ready), skip_symbolic_shape=True)
        nodes = [node.name for node in onnx.load(ready).graph.node]
        quantize_static(
            ready,
            found,
            _Reader(inputs),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            per_channel=True,
            reduce_range=True,
            nodes_to_exclude=[node for node in nodes if any(name in node for name in exact)],
        )
        return np.frombuffer(found.read_bytes(), np.uint8)


class _Reader(CalibrationDataReader):
    def __init__(self, inputs: Sequence[Arrays]) -> None:
        self._inputs = iter(inputs)

    def get_next(self) -> Arrays | None:
        return next(self._inputs, None)


def _with_free_sizes(model: np.ndarray) -> onnx.ModelProto:
    """Network that takes frames of any size."""
    found = version_converter.convert_version(
        onnx.load_from_string(model.tobytes()), _QUANTISED_OPSET
    )
    for value in (*found.graph.input, *found.graph.output):
        for place, size in enumerate(value.type.tensor_type.shape.dim):
            if place != 1:  # the channels
                size.ClearField("dim_value")
                size.dim_param = f"{value.name}_{place}"
    del found.graph.value_info[:]
    return found
