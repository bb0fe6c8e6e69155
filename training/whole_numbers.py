"""The second form of networks that ship: weights and layers in whole numbers, for ONNX Runtime."""

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
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

from coded_aperture_ros.core.archive import read_archive, write_archive

# The oldest that can quantise by channel.
_OPSET = 13

Inputs = dict[str, np.ndarray]
Run = Callable[[Mapping[str, np.ndarray]], np.ndarray]


def kept(run: Run, inputs: list[Inputs]) -> Run:
    """Return a network that keeps what it is given."""

    def keep(given: Mapping[str, np.ndarray]) -> np.ndarray:
        inputs.append({name: values.copy() for name, values in given.items()})
        return run(given)

    return keep


def add_whole_numbers(
    path: Path, schema: tuple[str, int], inputs: dict[str, list[Inputs]], exact: Sequence[str] = ()
) -> None:
    """Add the second form of its networks to a file; print its size and checksum.

    Parameters
    ----------
    path : Path
    schema : (str, int)
        Of the file, and its version.
    inputs : dict of str to list of dict
        By network: what it is given for some frames, which tells the ranges of the layers.
    exact : sequence of str
        Layers, by a part of their names, that stay as they are.
    """
    arrays = read_archive(path, *schema)
    for stated in ("schema", "schema_version"):
        arrays.pop(stated)
    for name, given in inputs.items():
        arrays[f"{name}_int8"] = _quantised(arrays[f"{name}_onnx"], given, exact)
    write_archive(path, *schema, arrays)
    packed = path.read_bytes()
    print(f"{len(packed)} bytes, sha256 {hashlib.sha256(packed).hexdigest()}")


def _quantised(model: np.ndarray, inputs: list[Inputs], exact: Sequence[str]) -> np.ndarray:
    """Return a network with weights of 7 bits and layers of 8.

    With weights of 8 bits sums of two products would overflow on processors that lack AVX-512 VNNI.
    """
    with tempfile.TemporaryDirectory() as folder:
        plain, ready, quantised = (
            Path(folder) / f"{name}.onnx" for name in ("plain", "ready", "quantised")
        )
        free = _with_free_sizes(model)
        onnx.save(free, plain)
        quant_pre_process(str(plain), str(ready), skip_symbolic_shape=True)
        nodes = [node.name for node in onnx.load(ready).graph.node]
        quantize_static(
            ready,
            quantised,
            _Reader(inputs),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            per_channel=True,
            reduce_range=True,
            nodes_to_exclude=[node for node in nodes if any(name in node for name in exact)],
        )
        return np.frombuffer(quantised.read_bytes(), np.uint8)


class _Reader(CalibrationDataReader):
    def __init__(self, inputs: list[Inputs]) -> None:
        self._inputs: Iterator[Inputs] = iter(inputs)

    def get_next(self) -> Inputs | None:
        return next(self._inputs, None)


def _with_free_sizes(model: np.ndarray) -> onnx.ModelProto:
    """Return a network that takes frames of any size."""
    found = version_converter.convert_version(onnx.load_from_string(model.tobytes()), _OPSET)
    for value in (*found.graph.input, *found.graph.output):
        for place, size in enumerate(value.type.tensor_type.shape.dim):
            if place != 1:  # the channels
                size.ClearField("dim_value")
                size.dim_param = f"{value.name}_{place}"
    del found.graph.value_info[:]
    return found
