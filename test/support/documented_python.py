"""Python examples of the documents."""

import re
import textwrap


def python_examples(path):
    """Return the blocks of Python of a Markdown or reStructuredText file, in their order."""
    text = path.read_text()
    if path.suffix == ".md":
        return re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    blocks = re.findall(r"^\.\. code-block:: python\n\n((?:   .*\n|\n)+)", text, re.MULTILINE)
    return [textwrap.dedent(block).strip("\n") + "\n" for block in blocks]
