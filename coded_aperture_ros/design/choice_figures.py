"""Figure of a choice of cameras. Matplotlib is imported only when drawing."""

from collections.abc import Mapping, Sequence
from typing import Any

from coded_aperture_ros.core.figures import new_figure
from coded_aperture_ros.design.choice import Wanted
from coded_aperture_ros.design.relief import LEAST_FILL, MOST_ERROR

_INCHES = (11.0, 6.4)


def draw_choice(rows: Sequence[Mapping[str, Any]], wanted: Wanted) -> Any:
    """Figure with error and fill over distance of every camera, the best one on top.

    Raises `InputError` if matplotlib is missing.
    """
    figure = new_figure(*_INCHES)
    panels = figure.subplots(2, 1, sharex=True)
    for number, one in enumerate(rows):
        parts = [part for part in one["distances"] if part["error"] is not None]
        middle_m = [2 / (1 / part["near_m"] + 1 / part["far_m"]) for part in parts]
        style = {"marker": "o", "color": f"C{number % 10}", "label": one["camera"]}
        panels[0].plot(middle_m, [100 * part["error"] for part in parts], **style)
        panels[1].plot(middle_m, [100 * part["fill"] for part in parts], **style)
    for axes, limit, what, top in (
        (panels[0], MOST_ERROR, "median error, %", 15),
        (panels[1], LEAST_FILL, "filled, %", 101),
    ):
        axes.axhline(100 * limit, color="k", linestyle="--", linewidth=0.8)
        axes.set_ylabel(what)
        axes.set_ylim(0, top)
        axes.grid(True, color="0.88")
    panels[1].set_xlabel("distance, m")
    panels[1].set_xlim(wanted.near_m, wanted.far_m)
    panels[0].set_title(
        f"{wanted.near_m:g} to {wanted.far_m:g} m, {wanted.illuminance_lux:g} lux at "
        f"{wanted.rate_hz:g} Hz; dashed: the limits of the range"
    )
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    return figure
