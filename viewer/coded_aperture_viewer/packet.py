"""What the page is sent of a frame: a header in JSON, and pictures and maps behind it."""

import json
import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth import DepthEstimate
from coded_aperture_ros.io.messages import pixels_from_frame

# Depths are whole multiples of this share of the largest; 0 is unknown.
_STEPS = 60_000
NEARER, BEYOND = 65_534, 65_535
_QUALITY = 85
# Kinds of layers that the page can draw; vectors are left out.
METRES = ("depth", "bound")
SHARES = ("probability", "share")


def packet(
    frame: FloatArray,
    picture: FloatArray | None,
    estimate: DepthEstimate | None,
    largest_m: float,
    header: dict[str, Any],
) -> bytes:
    """Return the bytes of a frame, and of what was found in it.

    The first four of eight bytes say how long the header is. Its `parts` say where what follows
    begins, counted from the header's end, and how long it is. `frame` and `picture` are JPEG. Maps
    are row by row: `depth`, `std_dev` and layers in metres of 16 bits in units of `unit_m`,
    `confidence` and layers from 0 to 1 of 8 bits.

    Parameters
    ----------
    frame, picture : ndarray, float32 [rows, columns] or [rows, columns, 3]
        In linear light; the coded frame, and all in focus or focused anew, if there is one.
    estimate : DepthEstimate or None
    largest_m : float
        The largest depth that can be told.
    header : dict
        What else the page is told.
    """
    unit_m = largest_m / _STEPS
    parts = {"frame": _jpeg(frame)}
    if picture is not None:
        parts["picture"] = _jpeg(picture)
    if estimate is not None and estimate.depth_m is not None and estimate.std_dev_m is not None:
        parts["depth"] = steps(estimate.depth_m, unit_m).tobytes()
        parts["std_dev"] = steps(estimate.std_dev_m, unit_m).tobytes()
        parts["confidence"] = as_bytes(estimate.confidence).tobytes()
        for layer in estimate.layers.values():
            if layer.spec.kind in METRES:
                parts[layer.spec.name] = steps(layer.values, unit_m).tobytes()
            elif layer.spec.kind in SHARES:
                parts[layer.spec.name] = as_bytes(layer.values).tobytes()
    places, at = {}, 0
    for name, part in parts.items():
        places[name] = [at, len(part)]
        at += len(part) + _padding(part)
    told = {**header, "parts": places, "size": list(frame.shape[:2]), "unit_m": unit_m}
    text = json.dumps(told).encode()
    text += b" " * _padding(text)
    padded = (part + bytes(_padding(part)) for part in parts.values())
    return b"".join([struct.pack("<II", len(text), 0), text, *padded])


def steps(metres: FloatArray, unit_m: float) -> NDArray[np.uint16]:
    """Return depths in whole steps: 0 if unknown, `NEARER` and `BEYOND` if infinite."""
    known = np.isfinite(metres)
    counted = np.clip(np.where(known, metres, 0) / unit_m, 1, NEARER - 1)
    found = np.where(known, np.rint(counted), 0).astype("<u2")
    found[metres == np.inf], found[metres == -np.inf] = BEYOND, NEARER
    return found


def as_bytes(share: FloatArray) -> NDArray[np.uint8]:
    """Shares from 0 to 1 as whole numbers up to 255; 0 where unknown."""
    return np.rint(255 * np.nan_to_num(share)).astype(np.uint8)


def _jpeg(light: FloatArray) -> bytes:
    coloured = "bgr8" if light.ndim == 3 else "mono8"
    pixels = pixels_from_frame(np.clip(np.nan_to_num(light), 0, 1), coloured, "srgb")
    return bytes(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])


def _padding(part: bytes) -> int:
    """Return how many bytes are missing to a place where numbers of any size may begin."""
    return -len(part) % 8
