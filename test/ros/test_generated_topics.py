"""docs/topics.md says of the nodes what they say themselves."""

import os
import subprocess
import sys


def test_the_page_of_topics_is_up_to_date(checkout, tmp_path):
    """In a process of its own, which no other test's nodes disturb."""
    code = (
        "import sys; from pathlib import Path; import generate_topics\n"
        "Path(sys.argv[1]).write_text(generate_topics.page(), encoding='utf-8')"
    )
    made = tmp_path / "topics.md"
    scripts = os.pathsep.join([str(checkout / "scripts"), str(checkout)])
    result = subprocess.run(
        [sys.executable, "-c", code, made],
        env={**os.environ, "PYTHONPATH": scripts},
        capture_output=True,
        check=False,
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, result.stderr
    assert made.read_text() == (checkout / "docs" / "topics.md").read_text()
