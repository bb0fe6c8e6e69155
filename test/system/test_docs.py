"""What the documentation shows can be typed, and what it says about the code is so."""

import re
import shlex
import textwrap

import pytest
import yaml
from cli_scene import call, parsed

from coded_aperture_ros.cli.command import UsageError
from coded_aperture_ros.cli.commands import COMMANDS
from coded_aperture_ros.cli.main import PROGRAM
from coded_aperture_ros.cli.table import Actions


@pytest.fixture(scope="module")
def documents(checkout):
    """Return the text of every document, by name."""
    paths = [*(checkout / "docs").glob("*.md"), *checkout.glob("*.md")]
    return {path.relative_to(checkout).as_posix(): path.read_text() for path in sorted(paths)}


def commands_in(text):
    """Return the command lines of our program in the indented blocks of a document."""
    joined = text.replace("\\\n", " ")
    lines = re.findall(rf"^    {PROGRAM} (.*)$", joined, re.MULTILINE)
    return [shlex.split(line, comments=True) for line in lines]


def test_every_command_in_the_documents_is_understood(documents, caplog):
    """Bench's own commands are understood by the benchmarks, and tested there."""
    commands = {name: commands_in(text) for name, text in documents.items()}
    assert sum(map(len, commands.values())) > 25
    for name, lines in commands.items():
        for line in lines:
            try:
                parsed(*line)
            except (SystemExit, UsageError) as error:
                pytest.fail(f"{name}: {PROGRAM} {shlex.join(line)}: {error}")
            # A former way of saying it would be warned of.
            assert caplog.messages == [], f"{name}: {PROGRAM} {shlex.join(line)}"


def typed_in_running_text(text):
    """Command lines in code marks with a file or a number: not only the name of an option."""
    for code in re.findall(r"`([^`\n]+)`", text):
        words = code.removeprefix(f"{PROGRAM} ").split()
        if words[0] in COMMANDS and any(re.search(r"\.[a-z]|^\d", word) for word in words):
            yield shlex.split(code.removeprefix(f"{PROGRAM} "))


def test_commands_in_running_text_can_be_typed(documents):
    """Those that look complete are."""
    typed = [line for text in documents.values() for line in typed_in_running_text(text)]
    assert ["simulate", "--random", "7", "-o", "scene.png"] in typed
    for name, text in documents.items():
        for line in typed_in_running_text(text):
            try:
                parsed(*line)
            except (SystemExit, UsageError) as error:
                pytest.fail(f"{name}: {PROGRAM} {shlex.join(line)}: {error}")


def help_texts(capsys, commands=COMMANDS, before=()):
    """Return the help of commands and of their actions, with every option."""
    texts = ""
    for name, command in commands.items():
        words = (*before, name)
        if words != ("bench",):
            texts += call(capsys, *words, "--help-all").out or call(capsys, *words, "--help").out
        if isinstance(command, Actions):
            texts += help_texts(capsys, command.actions, words)
    return texts


def test_the_options_in_the_documents_exist(documents, checkout, capsys):
    """Options named in running text are some command's; bench's are in the benchmarks."""
    of_others = {"--params-file", "--ros-args", "--show-args", "--clock", "--src", "--dst"}
    shown = call(capsys, "--help").out + help_texts(capsys)
    known = set(re.findall(r"--[a-z][a-z-]*[a-z]", shown)) | of_others
    benchmarks = "".join(path.read_text() for path in (checkout / "benchmarks").rglob("*.py"))
    for name, text in documents.items():
        named = {
            option
            for code in re.findall(r"`([^`\n]+)`", text)
            for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*[a-z]", code)
        }
        strange = {option for option in named - known if f'"{option}"' not in benchmarks}
        assert strange == set(), name


def test_python_examples_of_the_documents_compile(documents):
    """Those of the README are run by `test_readme`."""
    for name, text in documents.items():
        for example in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            compile(example, name, "exec")


def test_documents_are_few_and_have_a_picture_near_the_top(checkout):
    pages = [*(checkout / "docs").glob("*.md"), *(checkout / "docs").glob("*.rst")]
    assert 10 < len(pages) <= 20
    first_lines = {page.name: "".join(page.read_text().splitlines()[:20]) for page in pages}
    without = [
        name for name, text in first_lines.items() if not re.search(r"!\[|\.\. image::", text)
    ]
    assert without == []


def test_links_between_documents_lead_somewhere(documents, checkout):
    for name, text in documents.items():
        for target in re.findall(r"\]\((?!\w+:)([^)#\s]+)(?:#[^)]*)?\)", text):
            there = (checkout / name).parent / target
            assert there.exists(), f"{name}: {target}"


def test_files_that_the_documents_name_exist(documents, checkout):
    """Paths in code marks, from the project's root or from the package."""
    folders = {path.name for path in checkout.iterdir() if path.is_dir()}
    rooms = {path.name for path in (checkout / "coded_aperture_ros").iterdir() if path.is_dir()}
    for name, text in documents.items():
        for path in re.findall(r"`([\w./-]+/[\w.-]*\.(?:py|md|yaml|xml|sh))`", text):
            first = path.split("/")[0]
            if first in folders | rooms:
                root = checkout if first in folders and (checkout / path).exists() else None
                there = root or checkout / "coded_aperture_ros"
                assert (there / path).exists(), f"{name}: {path}"


def test_the_architecture_names_every_room(checkout, documents):
    package = checkout / "coded_aperture_ros"
    rooms = {path.name for path in package.iterdir() if (path / "__init__.py").is_file()}
    table = documents["docs/architecture.md"].split("## Rooms")[1].split("\n## ")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == rooms


def test_make_has_what_documents_and_ci_call(documents, checkout):
    targets = set(re.findall(r"^([a-z-]+):", (checkout / "Makefile").read_text(), re.MULTILINE))
    ci = [checkout / ".ci/run", *(checkout / ".github/workflows").glob("*.yml")]
    texts = {**documents, **{path.name: path.read_text() for path in ci}}
    for name, text in texts.items():
        lines = re.findall(r"(?:^    |^(?:.*run: )?|`)make ((?:[a-z-]+ ?)+)", text, re.MULTILINE)
        called = {word for line in lines for word in line.split()}
        if name in (".ci/run", "run", "tests.yml", "CONTRIBUTING.md"):
            assert called, name
            assert called <= targets, name


def test_hosted_ci_runs_what_it_should(checkout):
    """Every Python from wheels, the oldest versions, the documents, and an installed ROS."""
    jobs = yaml.safe_load((checkout / ".github/workflows/tests.yml").read_text())["jobs"]
    pythons = jobs["wheels"]["strategy"]["matrix"]["python"]
    assert pythons == ["3.10", "3.11", "3.12", "3.13"]
    assert jobs["jazzy"]["container"]["image"] == "ros:jazzy"
    run = {name: [step.get("run", "") for step in job["steps"]] for name, job in jobs.items()}
    assert {"make lint", "make test-all"} <= set(run["wheels"])
    assert "make test-oldest" in run["oldest"]
    assert "make docs" in run["docs"]
    assert "make test-installed" in run["jazzy"]
    assert "CODED_APERTURE_NO_SKIPS=1" in (checkout / "scripts/test_installed_ros.sh").read_text()


def indented_blocks(text):
    """Return the indented blocks of a document, without their indentation."""
    blocks = re.findall(r"(?:^    .*\n|^\n(?=    ))+", text, re.MULTILINE)
    return [textwrap.dedent(block).strip("\n") for block in blocks if block.strip()]


def test_calibration_prints_what_its_document_shows(documents, tmp_path, monkeypatch, capsys):
    """From the camera file in the document to the levels, and to the printed mask."""
    monkeypatch.chdir(tmp_path)
    text = documents["docs/calibration.md"]
    camera, command, shown = indented_blocks(text)[:3]
    (tmp_path / "camera.yaml").write_text(camera)
    result = call(capsys, *shlex.split(command)[1:])
    assert (result.status, result.out.rstrip("\n")) == (0, shown), result.err
    printed = [line for line in commands_in(text) if line[:2] == ["mask", "print"]]
    assert len(printed) == 4
    for line in printed:
        assert call(capsys, *line).status == 0


def test_our_names_beside_those_of_other_packages_exist(documents, checkout):
    """Topics and parameters are in the generated page, arguments and frames in launch files."""
    _, _, section = documents["docs/robot.md"].partition("## Names, here and in other camera")
    rows = re.findall(r"^\|[^|]*\|[^|]*\|([^|]*)\|[^|]*\|$", section, re.MULTILINE)[2:]
    names = {
        name.partition(":=")[0].strip("/.")
        for row in rows
        for name in re.findall(r"`([^`]+)`", row)
    }
    assert len(names) > 30
    files = [*(checkout / "launch").iterdir(), *(checkout / "urdf").iterdir()]
    known = documents["docs/topics.md"] + "".join(path.read_text() for path in files)
    assert {n for n in names if n not in known and not (checkout / n).exists()} == {"camera_link"}
