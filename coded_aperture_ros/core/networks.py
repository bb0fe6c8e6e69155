"""What runs the small networks that ship: OpenCV, or ONNX Runtime in half of its time."""

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

import cv2

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError

RUNTIMES = ("auto", "opencv", "onnxruntime")
# From what a network is given, by its names, to what it says; not for several threads at once.
Network = Callable[[Mapping[str, FloatArray]], FloatArray]


def check_runtime(runtime: str) -> None:
    """Check that a runtime is there; raises `InputError`, saying what is missing."""
    if runtime == "onnxruntime" and find_spec("onnxruntime") is None:
        raise InputError(
            "network: onnxruntime is not installed: in the folder of the checkout, pip install "
            "'.[fast]', or use opencv"
        )


def network_of(arrays: Mapping[str, Any], name: str, runtime: str, threads: int) -> Network:
    """Return what runs a network of the file that it ships in.

    ONNX Runtime, see `check_runtime`, computes in whole numbers of 8 bits; `auto` takes it where it
    is installed. Raises `InputError` if OpenCV cannot run the network.
    """
    if runtime == "onnxruntime" or (runtime == "auto" and find_spec("onnxruntime")):
        return _in_whole_numbers(arrays[f"{name}_int8"].tobytes(), threads)
    try:
        network = cv2.dnn.readNetFromONNX(arrays[f"{name}_onnx"])
    except cv2.error as error:
        raise InputError(
            f"OpenCV {cv2.__version__} cannot run the networks of depth and deblurring: use OpenCV "
            "4.6 or newer, or semiglobal and inverse, which have none"
        ) from error

    def run(given: Mapping[str, FloatArray]) -> FloatArray:
        for key, values in given.items():
            network.setInput(values, key)
        return network.forward()

    return run


def _in_whole_numbers(model: bytes, threads: int) -> Network:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    # Threads that wait for work would take the processors from everybody else.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    return lambda given: session.run(None, dict(given))[0]
