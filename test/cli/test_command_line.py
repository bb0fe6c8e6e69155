"""Exit status, messages and streams of the program `coded_aperture`."""

import errno
import os
import platform
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from waiting import run_program, run_python, scaled

import coded_aperture_ros
from coded_aperture_ros.cli import main as program
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output


def call(arguments, module="coded_aperture_ros.cli.main"):
    return run_python("-m", module, *arguments)


@pytest.fixture
def command(monkeypatch):
    """Make `coded_aperture act` run a function."""

    def install(run):
        command = SimpleNamespace(help="act", prepare=lambda name, words: lambda: run(words))
        monkeypatch.setattr(program, "COMMANDS", {"act": command})

    return install


@pytest.mark.parametrize("module", ["coded_aperture_ros", "coded_aperture_ros.cli.main"])
def test_version(module):
    result = call(["--version"], module)
    first, machine, libraries, ros = result.stdout.splitlines()
    assert first == f"coded_aperture {coded_aperture_ros.__version__}"
    assert platform.python_version() in machine
    assert f"numpy {np.__version__}, " in libraries and f"cv2 {cv2.__version__}, " in libraries
    assert ros.startswith("ROS ")
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("coded_aperture de", ["demo", "design", "depth", "deblur"]),
        ("coded_aperture depth --regularize s", ["semiglobal"]),
        ("coded_aperture simulate --side n", ["near"]),
        ("coded_aperture calibrate bl", ["blind"]),
    ],
)
def test_a_shell_is_told_what_may_come_next(tmp_path, line, expected):
    """As bash asks: the line so far comes in variables, the answer goes to a file."""
    pytest.importorskip("argcomplete")
    answer = tmp_path / "answer"
    asked = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    program = [sys.executable, "-m", "coded_aperture_ros"]
    subprocess.run(program, env={**os.environ, **asked}, timeout=scaled(60), check=True)
    assert answer.read_text().replace("\013", " ").split() == expected


@pytest.mark.parametrize("arguments", [[], ["unknown"], ["--unknown"]])
def test_wrong_usage_is_status_2_with_nothing_on_stdout(arguments):
    result = call(arguments)
    assert (result.returncode, result.stdout) == (2, "")
    (line,) = result.stderr.splitlines()
    assert line.startswith("coded_aperture: error: ")
    assert line.endswith("; see 'coded_aperture --help'")


@pytest.mark.parametrize("status", [0, 1])
def test_status_is_that_of_the_command(command, status):
    command(lambda options: status)
    assert program.main(["act"]) == status


def test_bad_input_is_one_line_on_stderr(command, capsys):
    def run(options):
        raise InputError("a.npz: not a filter bank")

    command(run)
    assert program.main(["act"]) == 1
    captured = capsys.readouterr()
    assert captured.err == "coded_aperture: error: a.npz: not a filter bank\n"
    assert captured.out == ""


def test_an_interrupt_is_quiet(command, capsys):
    def run(options):
        raise KeyboardInterrupt

    command(run)
    assert program.main(["act"]) == 130
    assert capsys.readouterr() == ("", "")


def test_a_program_that_is_told_to_end_cleans_up(command, tmp_path):
    def run(options):
        with atomic_output(tmp_path / "depth.npy") as temporary:
            assert temporary.exists()
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(10)  # never that long

    command(run)
    assert program.main(["act"]) == 130
    assert not list(tmp_path.iterdir())


def test_an_interrupt_while_options_are_collected_is_quiet(monkeypatch, capsys):
    """That of a command imports the library, which takes a second."""

    def interrupted(name, words):
        raise KeyboardInterrupt

    commands = {"act": SimpleNamespace(help="act", prepare=interrupted)}
    monkeypatch.setattr(program, "COMMANDS", commands)
    assert program.main(["act"]) == 130
    assert capsys.readouterr() == ("", "")


def test_our_own_mistakes_keep_their_traceback(command):
    def run(options):
        raise ZeroDivisionError

    command(run)
    with pytest.raises(ZeroDivisionError):
        program.main(["act"])


def test_a_reader_that_leaves_is_not_an_error_message():
    """As in `coded_aperture ... --json | head -1`."""
    code = (
        "import sys\n"
        "from types import SimpleNamespace as N\n"
        "from coded_aperture_ros.cli import main as program\n"
        "def run(options):\n"
        "    for line in range(100_000):\n"
        "        print('line', line)\n"
        "    return 0\n"
        "program.COMMANDS = {'act': N(prepare=lambda name, words: lambda: run(words))}\n"
        "sys.exit(program.main(['act']))\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "line 0\n"
    process.stdout.close()
    assert process.stderr.read() == ""
    process.stderr.close()
    assert process.wait(timeout=scaled(60)) == 1


ACT = (
    "import sys\n"
    "from types import SimpleNamespace as N\n"
    "from coded_aperture_ros.cli import main as program\n"
    "def run(options):\n"
    "    print('done' * int(sys.argv.pop()))\n"
    "    print(sys.stdin.read(), end='')\n"
    "    print('told', file=sys.stderr)\n"
    "    return 0\n"
    "program.COMMANDS = {'act': N(prepare=lambda name, words: lambda: run(words))}\n"
    "sys.exit(program.main(sys.argv[1:2]))\n"
)


def in_shell(arguments, redirected):
    return run_program(
        "sh", "-c", f'"$0" "$@" {redirected}', sys.executable, *arguments, stdin=subprocess.DEVNULL
    )


@pytest.mark.parametrize(
    ("redirected", "out", "err"),
    [
        (">&-", "", "told\n"),
        ("2>&-", "done\n", ""),
        ("<&-", "done\n", "told\n"),
        (">&- 2>&-", "", ""),
    ],
)
def test_closed_streams_take_nothing_and_have_nothing(redirected, out, err):
    result = in_shell(("-c", ACT, "act", "1"), redirected)
    assert (result.returncode, result.stdout, result.stderr) == (0, out, err)


def test_names_that_are_no_unicode_are_printed(command, capsys):
    command(lambda options: print(os.fsdecode(b"bad\xff.npz")) or 0)
    assert program.main(["act"]) == 0
    assert capsys.readouterr().out == "bad\\udcff.npz\n"


@pytest.mark.parametrize("words", [1, 100_000])
def test_a_full_disk_behind_the_output_is_one_line(words):
    result = in_shell(("-c", ACT, "act", str(words)), "> /dev/full")
    assert result.returncode == 1
    *_, last = result.stderr.splitlines()
    assert last == "coded_aperture: error: cannot write the output: No space left on device"
    assert "Traceback" not in result.stderr


def test_other_faults_of_the_system_keep_their_traceback(command):
    def run(options):
        raise OSError(errno.ENOMEM, "no memory")

    command(run)
    with pytest.raises(OSError, match="no memory"):
        program.main(["act"])


def test_a_version_that_cannot_be_written_is_one_line():
    result = in_shell(("-m", "coded_aperture_ros", "--version"), "> /dev/full")
    assert (result.returncode, len(result.stderr.splitlines())) == (1, 1)
    assert "No space left" in result.stderr


def test_every_command_explains_itself():
    assert program.COMMANDS
    for name in program.COMMANDS:
        result = call([name, "--help"])
        assert (result.returncode, result.stderr) == (0, "")
        assert f"coded_aperture {name}" in result.stdout
        assert result.stdout.count(f"coded_aperture {name}") > 1, "an example is missing"


def test_commands_are_listed_in_the_order_of_use():
    assert list(program.COMMANDS) == [
        *(
            "demo",
            "sample",
            "check",
            "design",
            "calibrate",
            "mask",
            "learn",
            "depth",
            "deblur",
            "simulate",
            "bag",
            "view",
            "bench",
        )
    ]
