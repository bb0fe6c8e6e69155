"""Page of the demo: six pictures with captions, and the summary in words and tables."""

import base64
import dataclasses
import html
import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bags.figures import encode_png
from coded_aperture_ros.core.page_style import with_style

# Colours of a bar from one end to the other.
_STOPS = 17
_TICKS = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """Picture of the page.

    Attributes
    ----------
    title, caption : str
        The caption is below the picture, and says what it shows.
    pixels : ndarray, uint8 [rows, columns, RGB]
        With a scale below the rows of the first picture, the page shows its own bar in its place.
    scale : (float, float) or None
        Ends of the colour bar; None: no bar.
    unit : str
        Of the bar's numbers.
    near_is_red : bool
        Whether the bar begins with red, as that of depth does.
    """

    title: str
    caption: str
    pixels: NDArray[np.uint8]
    scale: tuple[float, float] | None = None
    unit: str = "m"
    near_is_red: bool = True


def demo_page(pictures: list[Picture], summary: Mapping[str, Any]) -> str:
    """Page that needs no other file, HTML."""
    template = files("coded_aperture_ros.cli").joinpath("demo_page.html").read_text("utf-8")
    rows = len(pictures[0].pixels)
    figures = "\n".join(_figure(picture, rows) for picture in pictures)
    page = with_style(template).replace("<!--FIGURES-->", figures)
    return page.replace("/*SUMMARY*/ null", json.dumps(summary))


def _figure(picture: Picture, rows: int) -> str:
    title = html.escape(picture.title)
    data = base64.b64encode(encode_png(picture.pixels[:rows])).decode()
    image = f'<img alt="{title}" src="data:image/png;base64,{data}">'
    bar = "" if picture.scale is None else _bar(picture)
    return (
        f'<figure><button type="button" aria-label="Enlarge: {title}">{image}</button>{bar}'
        f"<figcaption><b>{title}.</b> {html.escape(picture.caption)}</figcaption></figure>"
    )


def _bar(picture: Picture) -> str:
    """Colour bar with numbers."""
    assert picture.scale is not None
    shades = np.linspace(0, 255, _STOPS).astype(np.uint8)[None]
    colours = cv2.applyColorMap(shades, cv2.COLORMAP_TURBO)[0, :, ::-1]
    if picture.near_is_red:
        colours = colours[::-1]
    gradient = ", ".join(f"rgb({red},{green},{blue})" for red, green, blue in colours.tolist())
    numbers = np.linspace(*picture.scale, _TICKS)
    ticks = "".join(f"<span>{number:.3g} {picture.unit}</span>" for number in numbers)
    return (
        f'<div class="bar"><i style="background: linear-gradient(90deg, {gradient})"></i>'
        f'<div class="ticks">{ticks}</div></div>'
    )
