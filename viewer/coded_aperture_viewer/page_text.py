"""Text of the page: HTML with its style sheet and scripts in place of the links to them."""

import base64
import hashlib
import re
from functools import cache
from pathlib import Path

from coded_aperture_ros.core.page_style import page_style

_FOLDER = Path(__file__).with_name("page")
# In place of the style that all pages of the project share.
_SHARED = '<link rel="stylesheet" href="shared">'
_STYLE = re.compile(r'<link rel="stylesheet" href="(\w+\.css)">')
_SCRIPT = re.compile(r'<script src="(\w+\.js)"></script>')


@cache
def page_text() -> str:
    """Return the page, which needs no other file."""
    text = (_FOLDER / "page.html").read_text("utf-8")
    text = text.replace(_SHARED, f"<style>\n{page_style()}</style>")
    text = _STYLE.sub(lambda found: f"<style>\n{_read(found[1])}</style>", text)
    return _SCRIPT.sub(lambda found: f"<script>\n{_read(found[1])}</script>", text)


@cache
def page_policy() -> str:
    """Content security policy of the page: its own scripts only, and in no frame."""
    scripts = re.findall(r"<script>(.*?)</script>", page_text(), re.DOTALL)
    hashes = " ".join(f"'sha256-{_hash(script)}'" for script in scripts)
    return (
        f"default-src 'none'; style-src 'unsafe-inline'; script-src {hashes}; "
        "img-src blob: data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def _read(name: str) -> str:
    return (_FOLDER / name).read_text("utf-8")


def _hash(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
