"""Cameras with another binning of the same sensor."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.design.choice import Offer
from coded_aperture_ros.optics.camera_file import camera_entries, camera_from_mapping
from coded_aperture_ros.optics.sensor import Sensor

# Measured on frames of the camera file's binning.
_MEASURED = ("camera_info", "noise", "noise_gain")
# Objects of the simulated scenes are larger than this.
_LEAST_FRAME_PX = 60


def with_binnings(offer: Offer, binnings: Sequence[int]) -> tuple[list[Offer], list[str]]:
    """Offer of a camera file and those with other binnings, and warnings of what is left out.

    Parameters
    ----------
    offer : Offer
    binnings : sequence of int
        That of the camera file and repeated ones are passed over. Without a `sensor` in the camera
        file all of them are.

    Returns
    -------
    list of Offer
        The first is `offer`.
    list of str
    """
    found = [offer]
    warnings: list[str] = []
    if offer.binning is None:
        return found, warnings
    others = [binning for binning in dict.fromkeys(binnings) if binning != offer.binning]
    measured = [name for name in camera_entries(offer.path) if name in _MEASURED]
    if others and measured:
        warnings.append(
            f"{offer.path}: {', '.join(measured)}: measured with a binning of {offer.binning}; "
            "not used with others"
        )
    for binning in others:
        try:
            found.append(with_binning(offer, binning))
        except InputError as error:
            warnings.append(f"{error}; left out")
    return found, warnings


def with_binning(offer: Offer, binning: int) -> Offer:
    """Offer with another binning of the same part of the sensor; `InputError` if none is left."""
    where = f"{offer.path} with a binning of {binning}"
    with naming(where):
        entries = binned_entries(camera_entries(offer.path), binning)
    camera = camera_from_mapping(entries, where, offer.path.parent)
    if min(camera.image_width, camera.image_height) < _LEAST_FRAME_PX:
        raise InputError(
            f"{where}: frames of {camera.image_width}x{camera.image_height}: expected at least "
            f"{_LEAST_FRAME_PX} px along both sides"
        )
    before = offer.camera.image_width * offer.camera.image_height
    return dataclasses.replace(
        offer,
        name=f"{offer.name}, binning {binning}",
        camera=camera,
        sensor=dataclasses.replace(offer.sensor, binning=binning),
        binning=binning,
        pixels=offer.pixels * camera.image_width * camera.image_height / before,
        magnification=offer.magnification * offer.sensor.binning / binning,
        file_name=f"{offer.path.stem}_binning{binning}{offer.path.suffix}",
    )


def binned_entries(entries: Mapping[str, Any], binning: int) -> dict[str, Any]:
    """Entries of a camera file with another binning of the same part of the sensor.

    With another one, noise and calibration that were measured on the camera file's frames are left
    out.

    Examples
    --------
    >>> sensor = {"width": 4096, "height": 3000, "pixel_pitch_um": 3.45, "binning": 4}
    >>> camera = {"pixel_pitch_um": 13.8, "image_width": 1024, "image_height": 750}
    >>> found = binned_entries({**camera, "sensor": sensor}, 2)
    >>> found["pixel_pitch_um"], found["image_width"], found["image_height"]
    (6.9, 2048, 1500)
    """
    before = Sensor.from_entry(entries["sensor"])
    if binning == before.binning:
        return dict(entries)
    sensor = dataclasses.replace(before, binning=binning)
    found = {name: value for name, value in entries.items() if name not in _MEASURED}
    if "focal_length_px" in found:
        found["focal_length_px"] *= before.binning / binning
    else:
        found["pixel_pitch_um"] = sensor.frame_pitch_um
    for name in ("image_width", "image_height"):
        found[name] = entries[name] * before.binning // binning
    return {**found, "sensor": {**entries["sensor"], "binning": binning}}
