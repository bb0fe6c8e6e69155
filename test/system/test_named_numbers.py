"""Numbers of error name camera, range, field of view and noise.

Each stands in a sentence, a row of a table or a caption that names them, or that refers to what
does: the paragraph of "the demo's camera", or a table. Figures of others say whose they are.
"""

import re

import pytest

_NUMBER = re.compile(r"\d ?(?:%|dB\b|mm\b|cm\b|m\b|points?\b)")
_ERROR = re.compile(
    r"\b(?:errors?|off by|wrong|right|within|accura\w+|exact\w*|RMS|PSNR|dB|deviation|fill\w*"
    r"|published|coverage|calibrated|(?:depth|known) at|with depth)\b",
    re.IGNORECASE,
)
_NAMED = {
    "camera": re.compile(r"f/\d|\b(?:cmount|hq|apsc|fullframe|thesis)_\d+mm"),
    "range": re.compile(r"\d to \d[\d.]* m\b|\bat \d[\d.]* m\b"),
    "field of view": re.compile(r"degrees|°"),
    "noise": re.compile(r"\blux\b|\bnoise\b", re.IGNORECASE),
}
_LEGEND = "**The demo's camera**"
_REFERS = re.compile(r"the demo's camera|of (?:this|the first) table", re.IGNORECASE)
# What counts as right, here 5 or 10 %, is no result.
_LIMIT = re.compile(r"(?:right to|within) (?:5|10) %|at (?:most|least) \d[\d.]* %", re.IGNORECASE)
_OF_OTHERS = re.compile(r"\((?:[^()]*\W)?(?:makers?|authors)\b[^()]*\)")
# Columns whose cells hold for the others of their row, and rows for those of their column.
_CONDITIONS = re.compile(r"camera|lens|range|distance|view|noise|scene", re.IGNORECASE)


def paragraphs(page):
    """Return the paragraphs of a page, without code and titles."""
    blocks = re.split(r"\n\s*\n", re.sub(r"^```.*?^```", "", page, flags=re.M | re.S))
    return [block for block in blocks if block.strip() and not re.match(r" {4}|#", block)]


def cells(row):
    return [cell.strip() for cell in row.strip().strip("|").split("|")]


def cells_of(table, caption):
    """Yield each cell of a table: what it says, and that with all that holds for it."""
    head, _, *rows = map(cells, table.splitlines())
    of_columns = [row for row in rows if _CONDITIONS.search(row[0])]
    of_row = [column for column, title in enumerate(head) if column and _CONDITIONS.search(title)]
    for row in rows:
        for column, value in enumerate(row[1:], 1):
            said = f"{row[0]}: {head[column]}: {value}"
            named = [f"{other[0]}: {other[column]}" for other in of_columns]
            named += [row[other] for other in of_row]
            yield value, said, " ".join([said, *named, caption])


def sentences_of(block):
    """Yield each sentence or bullet of a paragraph."""
    for item in re.split(r"^[-*] ", block, flags=re.M):
        for sentence in re.split(r"(?<=[.!?])[*_]*\s+(?=[A-Z*`\[])", " ".join(item.split())):
            yield sentence, sentence, sentence


def unnamed(page):
    """Return what each number of error on a page lacks."""
    found = {}
    blocks = paragraphs(page)
    for index, block in enumerate(blocks):
        beside = [*blocks[max(index - 1, 0) : index], *blocks[index + 1 : index + 2]]
        caption = " ".join(text for text in beside if not text.startswith("|"))
        parts = cells_of(block, caption) if block.startswith("|") else sentences_of(block)
        for number, said, whole in parts:
            if not (_NUMBER.search(_LIMIT.sub("", number)) and _ERROR.search(said)):
                continue
            if _OF_OTHERS.search(said) or _REFERS.search(whole):
                continue
            lacks = [what for what, pattern in _NAMED.items() if not pattern.search(whole)]
            if lacks:
                found[said] = lacks
    return found


@pytest.mark.parametrize("page", ["README.md", "docs/performance.md"])
def test_every_number_of_error_names_its_camera_range_view_and_noise(checkout, page):
    assert unnamed((checkout / page).read_text()) == {}


def test_the_legend_names_them_all(checkout):
    (legend,) = (b for b in paragraphs((checkout / "README.md").read_text()) if _LEGEND in b)
    assert [what for what, pattern in _NAMED.items() if not pattern.search(legend)] == []


_ALL = "25 mm f/1.4, 29 x 21 degrees, 0.6 to 1.5 m, 300 lux"


@pytest.mark.parametrize(
    ("page", "lacks"),
    [
        ("Depth is right to 2 % in the median.", list(_NAMED)),
        ("With f/1.4 at 300 lux the error is 3 mm.", ["range", "field of view"]),
        (f"We used {_ALL}. The error is 1.3 %.", list(_NAMED)),
        ("- All in focus, it gains 3.1 dB.\n- One lens.", list(_NAMED)),
        ("Depth at 76 % of the pixels, 0.6 to 1.5 m, 29 degrees, noise 0.002.", ["camera"]),
        ("| | ours | D435 |\n|---|---|---|\n| error | 1.3 % | 2 % at 2 m (maker) |", list(_NAMED)),
        ("| scene | within 10 % |\n|---|---|\n| desk, 25 mm f/1.4 | 93 % |\n\nNoise 0.002.",
         ["range", "field of view"]),
        ("*A frame: known at 76 % of the pixels; 29 degrees.*", ["camera", "range", "noise"]),
        (f"The error is 1.3 % ({_ALL}).", None),
        ("The demo's camera has an error of 1.3 %.", None),
        (f"With {_ALL}:\n\n| | error |\n|---|---|\n| desk | 1.3 % |", None),
        ("| camera | view, range, noise | error |\n|---|---|---|\n"
         f"| `hq_16mm_f1.4` | {_ALL} | 1.3 % |", None),
        ("ToF: 0.1 % + 11 mm of error (its maker).", None),
        ("Right are those within 10 %, sure those right to 5 %.", None),
        ("| scene | view | range | error |\n|---|---|---|---|\n"
         "| desk | 44 degrees | 1 to 2 m | 2 % |\n\nBy f/2.", ["noise"]),
        ("| | hq_6mm | D435 |\n|---|---|---|\n| range | 1 to 2 m | 1 to 3 m |\n"
         "| view, degrees | 31 x 23 | 72 x 49 |\n| error | 2 % | 2 % (maker) |\n\n300 lux.", None),
        ("Put a page at 0.5 m, and open the lens.", None),
    ],
)  # fmt: skip
def test_a_number_without_its_conditions_is_found(page, lacks):
    assert list(unnamed(page).values()) == ([] if lacks is None else [lacks])
