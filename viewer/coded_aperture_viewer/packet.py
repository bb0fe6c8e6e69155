"""Binary message of a frame for a page: a JSON header, then pictures and maps."""

import dataclasses
import json
import struct
from collections.abc import Hashable, Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth import DepthEstimate
from coded_aperture_ros.io.messages import pixels_from_frame

# Depths are sent as 16-bit numbers: this many steps up to the largest depth; 0 is unknown.
_STEPS = 60_000
# Steps that stand for -inf (nearer than the range) and inf (beyond it).
NEARER = 65_534
BEYOND = 65_535
_JPEG_QUALITY = 85
# Kinds of layers that the page can draw; vectors are not sent.
METRES = ("depth", "bound")
SHARES = ("probability", "share")


@dataclasses.dataclass(frozen=True, eq=False)
class Packet:
    """Encoded frame and results, from which each page gets a message.

    Attributes
    ----------
    entries : dict
        Of the header, the same for all pages.
    parts : {str: bytes}
        The coded frame and the maps.
    pictures : {key: bytes}
        Pictures, of which a page gets one.
    """

    entries: dict[str, Any]
    parts: dict[str, bytes]
    pictures: dict[Hashable, bytes]

    def message(self, picture: Hashable, entries: dict[str, Any]) -> bytes:
        """Message with one of the pictures, if there is such a one, and further entries.

        The first four of eight bytes are the length of the header, in JSON. Its `parts` has the
        offset of each part, from the header's end, and its length.
        """
        parts = dict(self.parts)
        if picture in self.pictures:
            parts["picture"] = self.pictures[picture]
        places = {}
        offset = 0
        for name, part in parts.items():
            places[name] = [offset, len(part)]
            offset += len(part) + _padding(part)
        text = json.dumps({**self.entries, **entries, "parts": places}).encode()
        text += b" " * _padding(text)
        padded = (part + bytes(_padding(part)) for part in parts.values())
        return b"".join([struct.pack("<II", len(text), 0), text, *padded])


def packet(
    frame: FloatArray,
    pictures: Mapping[Any, FloatArray],
    estimate: DepthEstimate | None,
    largest_m: float,
    entries: dict[str, Any],
) -> Packet:
    """Encoded frame and results.

    The coded frame and the pictures are JPEG. Maps are row by row: `depth`, `std_dev` and layers in
    metres have 16 bits, in units of `unit_m`; `confidence` and layers from 0 to 1 have 8 bits.

    Parameters
    ----------
    frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
        Linear light.
    pictures : {key: ndarray like `frame`}
        All-in-focus and refocused pictures.
    estimate : DepthEstimate or None
    largest_m : float
        Largest depth that can be sent.
    entries : dict
        Of the header; `size` and `unit_m` are added.
    """
    unit_m = largest_m / _STEPS
    parts = {"frame": _jpeg(frame)}
    if estimate is not None and estimate.depth_m is not None and estimate.std_dev_m is not None:
        parts["depth"] = steps(estimate.depth_m, unit_m).tobytes()
        parts["std_dev"] = steps(estimate.std_dev_m, unit_m).tobytes()
        parts["confidence"] = shares_as_bytes(estimate.confidence).tobytes()
        for layer in estimate.layers.values():
            if layer.spec.kind in METRES:
                parts[layer.spec.name] = steps(layer.values, unit_m).tobytes()
            elif layer.spec.kind in SHARES:
                parts[layer.spec.name] = shares_as_bytes(layer.values).tobytes()
    encoded = {key: _jpeg(picture) for key, picture in pictures.items()}
    entries = {**entries, "size": list(frame.shape[:2]), "unit_m": unit_m}
    return Packet(entries, parts, encoded)


def steps(metres: FloatArray, unit_m: float) -> NDArray[np.uint16]:
    """Depths in steps of `unit_m`: 0 if unknown, `NEARER` and `BEYOND` if infinite."""
    known = np.isfinite(metres)
    counted = np.clip(np.where(known, metres, 0) / unit_m, 1, NEARER - 1)
    numbers = np.where(known, np.rint(counted), 0).astype("<u2")
    numbers[metres == np.inf] = BEYOND
    numbers[metres == -np.inf] = NEARER
    return numbers


def shares_as_bytes(share: FloatArray) -> NDArray[np.uint8]:
    """Shares from 0 to 1 as numbers from 0 to 255; 0 where unknown."""
    return np.rint(255 * np.nan_to_num(share)).astype(np.uint8)


def _jpeg(light: FloatArray) -> bytes:
    encoding = "bgr8" if light.ndim == 3 else "mono8"
    pixels = pixels_from_frame(np.clip(np.nan_to_num(light), 0, 1), encoding, "srgb")
    return bytes(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])


def _padding(part: bytes) -> int:
    """Number of bytes up to the next multiple of 8, where numbers of any size may begin."""
    return -len(part) % 8
