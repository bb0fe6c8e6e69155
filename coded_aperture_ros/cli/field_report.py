"""The page of `calibrate field`: how well the planes fit, where, and the PSFs of the lens."""

import base64
import html
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.bags.figures import encode_png
from coded_aperture_ros.bags.page import html_page, wide_table

_THIRDS = ("inner", "middle", "outer")
# An error of depth that is as dark as a cell gets, and a share of pixels that is enough.
_DARKEST, _ENOUGH = 0.2, 0.1


def field_page(found: Any, lines: str, pictures: dict[str, Any], misplaced: Iterable[str]) -> str:
    """Return the page.

    `found` is a `FieldFit`, `lines` what belongs into the camera file; `pictures` [rows, columns],
    0 to 1, are of PSFs, by what they show.
    """
    parts = [f'<p class="warning">{html.escape(text)}</p>' for text in misplaced]
    parts.append(f"<h2>For the camera file</h2><pre>{html.escape(lines)}</pre>")
    parts.append(
        "<h2>Planes</h2><p>Of each plane, by thirds of the image's radius: blur in px, as measured "
        "and by the fit to the other planes; the error of depth that is left; and which share of "
        f"the pixels tell. Below {_ENOUGH:.0%}, take a plane with finer texture there.</p>"
    )
    head = "".join(f"<th>{third}: blur</th><th>error</th><th>pixels</th>" for third in _THIRDS)
    rows = [
        f"<tr><td>{html.escape(Path(name).name)}</td><td>{depth_m:.4g}&nbsp;m</td>{_cells(thirds)}</tr>"
        for name, depth_m, thirds in zip(found.names, found.depths_m, found.by_thirds, strict=True)
    ]
    parts.append(wide_table([f"<tr><th>plane</th><th>at</th>{head}</tr>", *rows], "Planes"))
    if pictures:
        parts.append("<h2>PSFs of the parts of the image</h2>")
    for what, picture in pictures.items():
        data = base64.b64encode(encode_png(np.rint(255 * picture).astype(np.uint8))).decode()
        parts.append(
            f'<figure><img src="data:image/png;base64,{data}" alt="{html.escape(what)}">'
            f"<figcaption>{html.escape(what)}</figcaption></figure>"
        )
    return html_page("The lens away from the axis", parts)


def _cells(thirds: Any) -> str:
    cells = []
    for measured, predicted, error, share in thirds.tolist():
        if math.isnan(error):
            cells.append('<td colspan="2">nothing to see</td>')
        else:
            redness = round(100 * min(1, error / _DARKEST))
            colour = f"color-mix(in srgb, var(--bad) {redness}%, transparent)"
            cells.append(f'<td class="number">{measured:.1f} / {predicted:.1f}</td>')
            cells.append(f'<td class="number" style="background:{colour}">{error:.1%}</td>')
        weak = " weak" if share < _ENOUGH else ""
        cells.append(f'<td class="number{weak}">{share:.0%}</td>')
    return "".join(cells)
