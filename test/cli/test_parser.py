"""The parser made of dataclasses: types, defaults, groups, help, and what it refuses."""

import dataclasses

import pytest
from cli_scene import call, parsed

from coded_aperture_ros.cli.command import Command, UsageError, argument, group
from coded_aperture_ros.cli.commands import COMMANDS
from coded_aperture_ros.cli.parser import fields_of, make_parser
from coded_aperture_ros.cli.parser import parsed as parse
from coded_aperture_ros.cli.rules import Setting, broken, excludes, needs, only_with, required
from coded_aperture_ros.cli.table import Actions, Entry
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option


@dataclasses.dataclass(frozen=True)
class Config:
    """Like a configuration of the library."""

    width: float = option(0.5, "Width of edges", unit="px", within=(0.0, 1.0), daily=True)
    kind: str = option("a", "Kind", choices=("a", "b"))
    check: bool = option(True, "Check it")

    def __post_init__(self):
        check_options(self)
        if self.kind == "b" and self.width == 0:
            raise InputError("width: more than 0 is needed for kind: b")


@dataclasses.dataclass(frozen=True)
class Stages:
    """Like a configuration that is put together from those of stages."""

    first: Config = group("first stage", Config())
    steps: int = option(3, "Steps", minimum=1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Shared:
    """Options of several commands."""

    gamma: float = argument("encoding", 1.0, written="--gamma G")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(Shared):
    """A bit of everything."""

    inputs: tuple[str, ...] = argument("pictures", written="INPUT")
    output: str = argument("100 % of the results", written="-o --output OUT")
    size: tuple[int, int] | None = argument("of the frame", None, written="--size W H", minimum=2)
    noise: float | None = argument("of the sensor", None, above=0)
    as_json: bool = argument("print JSON", False, written="--json")
    stages: Stages = group("stages", Stages(first=Config(width=0.25)))


COMMAND = Command(Arguments, lambda args: 0, "Do it.", "example:\n  act\n")


def read(*words):
    return parse(COMMAND, "act", words)


def test_what_is_not_given_has_its_default():
    args = read("a.png", "b.png", "-o", "out")
    assert args == Arguments(inputs=("a.png", "b.png"), output="out")
    assert args.stages.first.width == 0.25  # of the command, not of the configuration


def test_values_have_the_types_of_the_fields():
    words = [
        "--size",
        "3",
        "4",
        "--noise",
        ".5",
        "--json",
        "--width",
        "1",
        "--kind",
        "b",
        "--steps",
        "7",
        "--gamma",
        "2",
    ]
    args = read("a.png", "--output", "out", *words)
    assert (args.size, args.noise, args.as_json, args.gamma) == ((3, 4), 0.5, True, 2.0)
    assert args.stages == Stages(first=Config(1.0, "b"), steps=7)


def test_every_switch_can_be_turned_on_and_off():
    args = read("a.png", "-o", "out", "--no-check", "--json", "--no-json")
    assert (args.stages.first.check, args.as_json) == (False, False)
    assert read("a.png", "-o", "out", "--no-check", "--check").stages.first.check is True


@pytest.mark.parametrize(
    ("words", "phrase"),
    [
        ("a.png", "required: -o/--output"),
        ("-o out", "required: INPUT"),
        ("a.png -o out --wdith 3", "--wdith: no such option (did you mean --width?)"),
        ("a.png -o out --xyz", "--xyz: no such option"),
        ("a.png -o out --wdith=3", "(did you mean --width?)"),
        ("a.png -o out --width 3", "--width: 3.0 is out of range (0 to 1 px)"),
        ("a.png -o out --width x", "--width: invalid float value: 'x'"),
        ("a.png -o out --noise 0", "--noise: 0.0 is out of range (more than 0)"),
        ("a.png -o out --noise inf", "--noise: inf is out of range"),
        ("a.png -o out --size 3", "--size: expected 2 arguments"),
        ("a.png -o out --size 3 1", "--size: 1 is out of range (at least 2)"),
        ("a.png -o out --kind c", "--kind: 'c' is not allowed, use one of a, b"),
        ("a.png -o out --kind b --width 0", "--width: more than 0 is needed for kind: b"),
        ("a.png -o out --json yes", "unrecognized arguments: yes"),
    ],
)
def test_wrong_usage_says_what_and_where(words, phrase):
    with pytest.raises(UsageError) as caught:
        read(*words.split())
    message = str(caught.value)
    assert phrase in message
    assert len(message.splitlines()) == 1


def test_an_empty_argument_is_refused():
    with pytest.raises(UsageError, match="an argument is empty"):
        read("a.png", "-o", "")


def test_help_shows_the_options_of_daily_use_and_help_all_every_one():
    daily, every = (
        make_parser(COMMAND, "act", everything=everything).format_help()
        for everything in (False, True)
    )
    for text in (daily, every):
        assert "-o OUT, --output OUT" in text
        assert "Width of edges (0 to 1 px; default 0.25)" in " ".join(text.split())
        assert "100 % of the results" in text
        assert text.endswith("example:\n  act\n")
    assert "'--help-all' shows all 10 options" in daily
    for hidden in ("--kind {a,b}", "--check", "--no-check", "--steps INT"):
        assert hidden not in daily
        assert hidden in every
    assert "first stage:" in every and "stages:" in every


def all_commands(commands=COMMANDS, before=()):
    for name, entry in commands.items():
        if isinstance(entry, Actions):
            yield from all_commands(entry.actions, (*before, name))
        elif isinstance(entry, Entry):
            yield (*before, name), entry.load()


LOADED = dict(all_commands())
RULES = [(words, rule) for words, command in LOADED.items() for rule in command.rules]


def sample(field):
    """Return a value that is not the default of an option."""
    if field.option.choices:
        return next(choice for choice in field.option.choices if choice != field.default)
    if field.kind is bool:
        return not field.default
    return object()


def settings_with(command, *conditions):
    """Return the settings of a command line on which conditions hold, and no others."""
    settings = {
        one.path: Setting(one.flag, one.default, one.default) for one in command_fields(command)
    }
    for condition in conditions:
        for part in condition.split(" & "):
            flag, _, value = part.split(" | ")[0].partition(" ")
            fields = [
                one
                for one in command_fields(command)
                if one.flag == flag or (flag.endswith(".*") and one.path.startswith(flag[:-1]))
            ]
            field = fields[0]
            settings[field.path] = Setting(field.flag, value or sample(field), field.default)
    return settings


def command_fields(command):
    return fields_of(command.arguments)


@pytest.mark.parametrize(
    ("words", "rule"), RULES, ids=[f"{' '.join(words)}: {rule}" for words, rule in RULES]
)
def test_every_line_of_the_tables_of_rules(words, rule):
    """What it forbids is refused by a message that names both sides, and what it allows is not."""
    command = LOADED[words]

    def messages(*conditions):
        return list(broken([rule], settings_with(command, *conditions)))

    def named(message, condition):
        if condition.endswith(".*"):
            return "--" in message
        parts = condition.replace(" & ", " | ").split(" | ")
        return all(part in message for part in parts)

    if rule.kind == "required":
        (message,) = messages()
        assert all(named(message, other) for other in rule.others)
        for other in rule.others:
            assert messages(other) == []
        return
    assert messages() == []
    if rule.kind == "excludes":
        for other in rule.others:
            (message,) = messages(rule.subject, other)
            assert named(message, rule.subject) and named(message, other)
        assert messages(rule.subject) == messages(*rule.others) == []
        return
    (message,) = messages(rule.subject)
    assert all(named(message, condition) for condition in (rule.subject, *rule.others))
    assert messages(rule.subject, *rule.others) == []
    if rule.kind == "only with":
        for other in rule.others:
            assert messages(rule.subject, other) == []
    else:
        for other in rule.others:
            rest = [one for one in rule.others if one != other]
            (message,) = messages(rule.subject, *rest)
            assert named(message, other)


def test_kinds_of_rules():
    settings = {
        "motion": Setting("--motion", True, False),
        "method": Setting("--method", "bank", "bank"),
        "threads": Setting("--threads", 0, False),
        "two_pixel.side": Setting("--side", 3, 2),
    }
    rules = [
        needs("--motion", "--method bank", "--method two_pixel"),
        only_with("--motion", "--method two_pixel", note="it is slow"),
        excludes("--motion", "--method two_pixel", "--threads"),
        excludes("two_pixel.*", "--motion"),
        required("--method two_pixel"),
        needs("--motion & --threads", "--method two_pixel"),
        only_with("--motion", "--method two_pixel | --threads"),
    ]
    assert list(broken(rules, settings)) == [
        "--motion: needs --method two_pixel too",
        "--motion: only with --method two_pixel (it is slow)",
        "--motion: not with --threads",
        "--side: not with --motion",
        "required: --method two_pixel",
        "--motion with --threads: needs --method two_pixel too",
    ]


@pytest.mark.parametrize("words", LOADED, ids=" ".join)
def test_options_of_a_command_have_one_name_each(words):
    names = [name for field in command_fields(LOADED[words]) for name in field.names]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("words", LOADED, ids=" ".join)
def test_help_all_shows_every_option(capsys, words):
    shown = call(capsys, *words, "--help-all").out or call(capsys, *words, "--help").out
    for field in command_fields(LOADED[words]):
        assert field.flag in shown


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["dept"], "coded_aperture: error: dept: no such command (did you mean depth?)"),
        (["xyz"], "coded_aperture: error: xyz: no such command;"),
        ([], "coded_aperture: error: the command is missing, use one of demo, sample"),
        (["--xyz"], "coded_aperture: error: --xyz: the command is missing, use one of"),
        (["--json", "design"], "coded_aperture: error: --json: goes after the word design;"),
        (
            ["mask", "prnt"],
            "coded_aperture mask: error: prnt: no such action (did you mean print?)",
        ),
        (["mask"], "coded_aperture mask: error: the action is missing, use one of print"),
        (["calibrate", "--json", "noise"], "calibrate: error: --json: goes after the word noise;"),
        (["mask", "print", "--extnt-mm", "3"], "mask print: error: --extnt-mm: no such option"),
    ],
)
def test_a_word_that_is_wrong_is_one_line_with_what_may_be_meant(capsys, words, message):
    result = call(capsys, *words)
    assert (result.status, result.out) == (2, "")
    (line,) = result.err.splitlines()
    assert message in line
    assert line.endswith(" --help'")


def test_calibrate_without_an_action_warns_and_designs(capsys, caplog, checkout):
    camera = checkout / "config" / "example_camera.yaml"
    options = ("--camera", camera, "--depth-range", 6, 28, "--json")
    found = call(capsys, "calibrate", *options)
    (warning,) = caplog.messages
    assert "'coded_aperture calibrate' without an action is now 'coded_aperture design'" in warning
    caplog.clear()
    assert call(capsys, "design", *options) == found
    assert found.status == 0
    assert parsed("calibrate", *options) == parsed("design", *options)


def test_only_the_module_of_the_command_is_loaded(tmp_path):
    import subprocess
    import sys

    code = (
        "import sys\n"
        "from coded_aperture_ros.cli.main import main\n"
        "main(['mask', 'print', 'levin', '--extent-mm', '9', '-o', sys.argv[1]])\n"
        "print(*sorted(name for name in sys.modules if '_ros.cli.' in name))\n"
    )
    output = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "mask.svg"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    loaded = {name.rpartition(".")[2] for name in output.splitlines()[-1].split()}
    assert "mask_print" in loaded
    assert not loaded & {"learn", "design", "simulate", "depth", "demo", "sample", "check", "bag"}


# ---- folders of output files ----


def is_output(field):
    """Whether an option names a file to write."""
    return getattr(field.option, "is_output", False)


def written_by(*words):
    """Options of a command that names of files to write follow."""
    return {
        one.flag for one in command_fields(LOADED[words]) if getattr(one.option, "is_output", False)
    }


def test_every_output_is_known_as_one():
    """`-o` is an output file, or its help says that it is a folder, or the name of a bag."""
    for words, command in LOADED.items():
        for one in command_fields(command):
            if "-o" in one.names and not is_output(one):
                assert "folder" in one.option.description, words
    assert written_by("depth") == {"--output", "--movie"}
    assert written_by("deblur") == {"--output", "--anaglyph", "--stereo"}
    assert written_by("calibrate", "field") == {"--output", "--report", "--picture"}
    assert written_by("calibrate", "psf") == {"--output", "--picture"}
    assert written_by("mask", "search") == {"--output", "--checkpoint"}


@pytest.mark.parametrize(
    "words",
    [
        ("learn", "--mask", "levin", "--blur-sizes", 3, 9, 4, "-o"),
        ("depth", "a.png", "--bank", "b.npz", "-o"),
        ("depth", "a.png", "--bank", "b.npz", "-o", "here.npy", "--movie"),
        ("deblur", "a.png", "--bank", "b.npz", "--depth", "auto", "-o", "here", "--stereo"),
        ("simulate", "--random", 1, "-o"),
        ("mask", "print", "levin", "--extent-mm", 9, "-o"),
        ("calibrate", "planes", "planes", "-o"),
        ("calibrate", "field", "planes", "--camera", "c.yaml", "-o"),
        ("calibrate", "trace", "lens.yaml", "--camera", "c", "--depth-range", 1, 2, "-o"),
    ],
    ids=lambda words: " ".join(map(str, (*words[:2], words[-1]))),
)
def test_the_folder_of_an_output_file_has_to_be_there(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"no folder new.deeper: make it, or add --parents") as no:
        parsed(*words, "new/deeper/x.npz")
    assert str(no.value).startswith("cannot write new/deeper/x.npz: ")
    parsed(*words, "new/deeper/x.npz", "--parents")
    parsed(*words, "x.npz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("output", ["new", "new/deeper", "new/deeper.v2/", "made.v2"])
def test_folders_for_results_are_made(tmp_path, monkeypatch, output):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "made.v2").mkdir()
    assert parsed("depth", "a.png", "--bank", "b.npz", "-o", output).output == output


def test_nothing_is_computed_for_a_folder_that_does_not_exist(tmp_path, capsys):
    words = ("learn", "--mask", "levin", "--blur-sizes", 3, 9, 4, "-o")
    result = call(capsys, *words, tmp_path / "new" / "bank.npz")
    assert (result.status, result.out) == (1, "")
    assert result.err.count("\n") == 1
    assert "there is no folder" in result.err
    assert not list(tmp_path.iterdir())
