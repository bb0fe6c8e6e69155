"""docs/commands.md has every command and option as its parser knows it."""

from coded_aperture_ros.cli.reference import page


def test_the_reference_of_commands_is_up_to_date(checkout):
    text = (checkout / "docs" / "commands.md").read_text()
    assert text == page(text)
