"""docs/commands.md has every command and option as its parser knows it; docs/ stays short."""

from coded_aperture_ros.cli.reference import page

# Beyond this a reader does not find a page by looking down the list.
MOST_PAGES = 20


def test_the_reference_of_commands_is_up_to_date(checkout):
    text = (checkout / "docs" / "commands.md").read_text()
    assert text == page(text)


def test_the_pages_are_few(checkout):
    pages = [*(checkout / "docs").glob("*.md"), *(checkout / "docs").glob("*.rst")]
    assert len(pages) <= MOST_PAGES, sorted(page.name for page in pages)
