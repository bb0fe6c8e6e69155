"""A sheet as SVG, in millimetres."""

import re
from xml.sax.saxutils import escape

from coded_aperture_ros.design.sheet import HEIGHT_MM, WIDTH_MM, Shape, Sheet, Text


def svg_of(sheet: Sheet) -> str:
    """Return the sheet as the text of an SVG file whose user unit is 1 mm."""
    size = f'width="{WIDTH_MM:g}mm" height="{HEIGHT_MM:g}mm"'
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {WIDTH_MM:g} {HEIGHT_MM:g}">',
        f"<title>{_clean(sheet.title)}</title>",
        '<rect width="100%" height="100%" fill="#ffffff"/>',
        *map(_shape, sheet.shapes),
        *map(_text, sheet.texts),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _shape(shape: Shape) -> str:
    path = " ".join(
        "M" + " L".join(f"{x:.4f} {y:.4f}" for x, y in outline) + (" Z" if shape.closed else "")
        for outline in shape.outlines
    )
    fill, stroke = (shape.colour, "none") if shape.filled else ("none", shape.colour)
    style = f'class="{shape.kind}" fill="{fill}" fill-rule="evenodd" stroke="{stroke}"'
    style += f' stroke-width="{shape.width_mm:g}"'
    if shape.dashed:
        style += ' stroke-dasharray="1.5 1"'
    return f'<path {style} d="{path}"/>'


def _text(text: Text) -> str:
    (x, y), anchor = text.at, "middle" if text.centred else "start"
    return (
        f'<text x="{x:.4f}" y="{y:.4f}" font-family="Helvetica, Arial, sans-serif" '
        f'font-size="{text.height_mm:g}" text-anchor="{anchor}">{_clean(text.text)}</text>'
    )


def _clean(text: str) -> str:
    """Escape what XML reserves, and leave out what it forbids: a file's name may have anything."""
    return escape(re.sub("[^\t\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "?", text))
