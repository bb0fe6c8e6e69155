"""Sheet as SVG, as PDF (which asks the printer not to scale its A4 page), and as DXF."""

import io
import re
from xml.sax.saxutils import escape

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.sheet import HEIGHT_MM, WIDTH_MM, Shape, Sheet, Text

_POINTS_PER_MM = 72 / 25.4
# Widths of Helvetica's digits and of most of its letters, in parts of the height; only the numbers
# of the rulers are centred.
_CHARACTER_WIDTH = 0.556


def sheet_svg(sheet: Sheet) -> str:
    """Text of an SVG file whose user unit is 1 mm."""
    size = f'width="{WIDTH_MM:g}mm" height="{HEIGHT_MM:g}mm"'
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {WIDTH_MM:g} {HEIGHT_MM:g}">',
        f"<title>{_clean(sheet.title)}</title>",
        '<rect width="100%" height="100%" fill="#ffffff"/>',
        *map(_svg_shape, sheet.shapes),
        *map(_svg_text, sheet.texts),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _svg_shape(shape: Shape) -> str:
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


def _svg_text(text: Text) -> str:
    (x, y), anchor = text.at, "middle" if text.centred else "start"
    return (
        f'<text x="{x:.4f}" y="{y:.4f}" font-family="Helvetica, Arial, sans-serif" '
        f'font-size="{text.height_mm:g}" text-anchor="{anchor}">{_clean(text.text)}</text>'
    )


def _clean(text: str) -> str:
    """Text with XML's reserved characters escaped, and forbidden ones replaced."""
    return escape(re.sub("[^\t\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "?", text))


def sheet_pdf(sheet: Sheet) -> bytes:
    """Bytes of a PDF file."""
    content = "\n".join([*map(_pdf_shape, sheet.shapes), *map(_pdf_text, sheet.texts)])
    stream = content.encode("cp1252", "replace")
    size = f"{WIDTH_MM * _POINTS_PER_MM:.3f} {HEIGHT_MM * _POINTS_PER_MM:.3f}"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {size}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n" % len(stream) + stream + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        b"<< /Title " + _pdf_string(sheet.title).encode("cp1252", "replace") + b" >>",
    ]
    data = b"%PDF-1.4\n"
    offsets = []
    for number, body in enumerate(objects, start=1):
        offsets.append(len(data))
        data += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    size_of_table = len(objects) + 1
    start_of_table = len(data)
    data += b"xref\n0 %d\n0000000000 65535 f \n" % size_of_table
    data += b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    data += b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (size_of_table, len(objects))
    return data + b"startxref\n%d\n%%%%EOF\n" % start_of_table


def sheet_dxf(sheet: Sheet) -> bytes:
    """Bytes of a DXF file with the lines to cut, in mm: layers `hole` and `rim`.

    Raises `InputError` if ezdxf is not installed.
    """
    try:
        import ezdxf
    except ImportError as error:
        raise InputError("DXF files need ezdxf: pip install ezdxf") from error
    drawing = ezdxf.new("R2000", units=ezdxf.units.MM)
    for shape in sheet.shapes:
        for outline in shape.outlines if shape.kind in ("hole", "rim") else ():
            points = [(x, HEIGHT_MM - y) for x, y in outline]
            drawing.modelspace().add_lwpolyline(
                points, close=True, dxfattribs={"layer": shape.kind}
            )
    text = io.StringIO()
    drawing.write(text)
    return text.getvalue().encode()


def _page_point(x_mm: float, y_mm: float) -> str:
    """Position in points, counted from the lower left corner of the page."""
    return f"{x_mm * _POINTS_PER_MM:.4f} {(HEIGHT_MM - y_mm) * _POINTS_PER_MM:.4f}"


def _pdf_shape(shape: Shape) -> str:
    dashes = f"{1.5 * _POINTS_PER_MM:.4f} {_POINTS_PER_MM:.4f}" if shape.dashed else ""
    colour = " ".join(f"{int(shape.colour[k : k + 2], 16) / 255:.3f}" for k in (1, 3, 5))
    lines = [
        f"% {shape.kind}",
        f"{shape.width_mm * _POINTS_PER_MM:.4f} w",
        f"[{dashes}] 0 d",
        f"{colour} {'rg' if shape.filled else 'RG'}",
    ]
    for first, *others in shape.outlines:
        lines += [f"{_page_point(*first)} m", *(f"{_page_point(*point)} l" for point in others)]
        if shape.closed:
            lines.append("h")
    return "\n".join([*lines, "f*" if shape.filled else "S"])


def _pdf_text(text: Text) -> str:
    x_mm, y_mm = text.at
    if text.centred:
        x_mm -= _CHARACTER_WIDTH * text.height_mm * len(text.text) / 2
    return (
        f"BT 0 0 0 rg /F1 {text.height_mm * _POINTS_PER_MM:.3f} Tf {_page_point(x_mm, y_mm)} Td "
        f"{_pdf_string(text.text)} Tj ET"
    )


def _pdf_string(text: str) -> str:
    printable = "".join(character if character.isprintable() else "?" for character in text)
    return "(" + printable.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)") + ")"
