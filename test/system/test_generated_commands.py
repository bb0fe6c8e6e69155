"""docs/commands.md has every command and option as its parser knows it; docs/ stays short."""

import importlib
import sys

import pytest

# Beyond this a reader does not find a page by looking down the list.
MOST_PAGES = 20


@pytest.fixture
def generator(checkout, monkeypatch):
    monkeypatch.syspath_prepend(str(checkout / "scripts"))
    monkeypatch.syspath_prepend(str(checkout / "viewer"))
    yield importlib.import_module("generate_commands")
    sys.modules.pop("generate_commands")


def test_the_reference_of_commands_is_up_to_date(generator):
    text = generator.PAGE.read_text()
    assert text == generator.page(text)


def test_the_pages_are_few(checkout):
    pages = [*(checkout / "docs").glob("*.md"), *(checkout / "docs").glob("*.rst")]
    assert len(pages) <= MOST_PAGES, sorted(page.name for page in pages)
