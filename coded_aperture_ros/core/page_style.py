"""The look that all pages share: demo, bag report, design, field report and viewer."""

from functools import cache
from pathlib import Path

# Where the template of a page has the style sheet.
STYLE_PLACEHOLDER = "/*STYLE*/"


@cache
def page_style() -> str:
    """Style sheet of all pages (CSS), with the colours of a light and of a dark display.

    Examples
    --------
    >>> "prefers-color-scheme: dark" in page_style()
    True
    """
    return Path(__file__).with_name("page.css").read_text("utf-8")


def with_style(template: str) -> str:
    """Page of a template, HTML, with the style sheet in place of `STYLE_PLACEHOLDER`.

    Examples
    --------
    >>> "--accent" in with_style("<style>/*STYLE*/</style>")
    True
    """
    return template.replace(STYLE_PLACEHOLDER, page_style())
