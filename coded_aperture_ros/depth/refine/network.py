"""Runs the network that ships with the package."""

import gzip
from functools import lru_cache
from importlib.resources import files

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError

WEIGHTS = "refinement.onnx.gz"


class Network:
    """Costs and frame in, logits of blur sizes and of neighbours out; see `training/network.py`."""

    def __init__(self) -> None:
        try:
            self._net = cv2.dnn.readNetFromONNX(np.frombuffer(_weights(), np.uint8))
        except cv2.error as error:
            raise InputError(
                f"regularize: OpenCV {cv2.__version__} does not read the network of learned: "
                "use semiglobal, or OpenCV 4.6 or newer"
            ) from error

    def __call__(self, costs: FloatArray, frame: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the logits [bins + 1, rows, columns] and [choices, rows, columns]."""
        self._net.setInput(costs[None], "costs")
        self._net.setInput(frame[None], "frame")
        size, choice = self._net.forward(["size", "choice"])
        return size[0], choice[0]


@lru_cache(maxsize=1)
def _weights() -> bytes:
    return gzip.decompress((files(__package__) / WEIGHTS).read_bytes())
