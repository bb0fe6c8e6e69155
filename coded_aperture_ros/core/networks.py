"""Runtimes of the networks that ship: OpenCV, or ONNX Runtime, which takes half of the time."""

import os
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

import cv2

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError

RUNTIMES = ("auto", "opencv", "onnxruntime")
# Takes the inputs of a network by their names, and returns its output; not thread-safe.
Network = Callable[[Mapping[str, FloatArray]], FloatArray]


def check_runtime(runtime: str) -> None:
    """Raise an `InputError` if a runtime is not installed."""
    if runtime == "onnxruntime" and find_spec("onnxruntime") is None:
        raise InputError(
            "network: onnxruntime is not installed: in the folder of the checkout, pip install "
            "'.[fast]', or use opencv"
        )


def network_of(arrays: Mapping[str, Any], name: str, runtime: str, threads: int) -> Network:
    """Function that runs a network.

    Parameters
    ----------
    arrays : mapping
        Arrays of the file that the network ships in.
    name : str
        Of the network in that file.
    runtime : str
        One of `RUNTIMES`. `auto` is ONNX Runtime if it is installed; it runs networks that ship
        quantised to 8 bits.
    threads : int
        Of ONNX Runtime.

    Raises
    ------
    InputError
        If OpenCV cannot run the network.
    """
    if runtime == "onnxruntime" or (runtime == "auto" and find_spec("onnxruntime")):
        form = "int8" if f"{name}_int8" in arrays else "onnx"
        return _network_by_onnxruntime(arrays[f"{name}_{form}"].tobytes(), threads)
    try:
        network = cv2.dnn.readNetFromONNX(arrays[f"{name}_onnx"])
    except cv2.error as error:
        raise InputError(
            f"OpenCV {cv2.__version__} cannot run the networks of depth and deblurring: use OpenCV "
            "4.6 or newer, or semiglobal and inverse, which have none"
        ) from error

    def run(inputs: Mapping[str, FloatArray]) -> FloatArray:
        for key, values in inputs.items():
            network.setInput(values, key)
        return network.forward()

    return run


def _network_by_onnxruntime(model: bytes, threads: int) -> Network:
    """Network run by ONNX Runtime."""
    # New builds of ONNX Runtime report their use to its maker; a robot does not.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    # Threads that spin while they wait would take the processors from everything else.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    return lambda inputs: session.run(None, dict(inputs))[0]
