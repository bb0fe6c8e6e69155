"""From a command's dataclass to its parser, and from what was typed back to the dataclass."""

import argparse
import dataclasses
import inspect
import textwrap
import types
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NoReturn, TypeVar, Union, get_args, get_origin, get_type_hints

from coded_aperture_ros.cli.command import Argument, Command, UsageError, did_you_mean
from coded_aperture_ros.cli.rules import Setting, broken
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import check_folder
from coded_aperture_ros.core.options import Option, check_option

Arguments = TypeVar("Arguments")

# Option of every command that writes files; no field of its arguments.
_PARENTS = "parents"
_MORE = "'--help-all' shows all {count} options."


@dataclasses.dataclass(frozen=True)
class Field:
    """A field of a command's arguments, or of a dataclass in it."""

    path: str  # "output", "estimation.noise"
    title: str  # of its group
    option: Option
    hint: Any  # its type
    default: Any  # `dataclasses.MISSING`: required

    @property
    def names(self) -> list[str]:
        """What it goes by on the command line; of a positional argument nothing."""
        words = getattr(self.option, "written", "").split()
        if words and not words[0].startswith("-"):
            return []
        names = [word for word in words if word.startswith("-")]
        return names or [f"--{self.path.rpartition('.')[2].replace('_', '-')}"]

    @property
    def flag(self) -> str:
        """What messages call it."""
        return (self.names or self.placeholders)[-1]

    @property
    def placeholders(self) -> list[str]:
        """What stands for its values in the help."""
        words = getattr(self.option, "written", "").split()
        placeholders = [word for word in words if not word.startswith("-")]
        return placeholders or [self.kind.__name__.upper()]

    @property
    def kind(self) -> type:
        """Type of a single value."""
        return _shape(self.hint)[0]

    @property
    def nargs(self) -> Any:
        """How many values it takes, as argparse says it."""
        _, many = _shape(self.hint)
        required = self.default is dataclasses.MISSING
        if many == "any":
            if getattr(self.option, "parse", None) is not None:
                return None  # one word has them all
            return "+" if required or self.names else "*"
        if many == 1:
            return None if required or self.names else "?"
        return many


def fields_of(
    arguments: type,
    default: Any = None,
    path: str = "",
    title: str = "",
    without: Sequence[str] = (),
) -> list[Field]:
    """Return all fields of a dataclass, and those of the dataclasses in it.

    `default` is an instance whose values are the defaults, instead of the class' own.
    """
    hints = get_type_hints(arguments)
    found = []
    owners = [inspect.get_annotations(one) for one in arguments.__mro__]
    ordered = sorted(  # what a command shares with others comes after its own
        dataclasses.fields(arguments),
        key=lambda field: max(at for at, names in enumerate(owners) if field.name in names),
    )
    for field in ordered:
        if field.name in without:
            continue
        value = field.default if default is None else getattr(default, field.name)
        name = f"{path}{field.name}"
        if "option" in field.metadata:
            hint = hints[field.name]
            found.append(Field(name, title, field.metadata["option"], hint, value))
        elif dataclasses.is_dataclass(hint := hints[field.name]):
            below = field.metadata.get("group", title)
            left_out = field.metadata.get("without", ())
            found += fields_of(hint, value, f"{name}.", below, left_out)  # type: ignore[arg-type]
    return found


def parsed(command: Command[Arguments], program: str, words: Sequence[str]) -> Arguments:
    """Return the arguments that are typed after a command's name.

    Raises
    ------
    UsageError
        If they cannot be read, or do not go together.
    InputError
        If the folder of an output file does not exist, and ``--parents`` is not given.
    SystemExit
        With status 0, after the help was printed.
    """
    parser = make_parser(command, program)
    parser.refuse_unknown(words)
    given = vars(parser.parse_args(words))
    fields = fields_of(command.arguments)
    if not given.pop(_PARENTS, False):
        for field in fields:
            if getattr(field.option, "is_output", False) and given.get(field.path) is not None:
                check_folder(given[field.path])
    settings = {
        field.path: Setting(field.flag, given.get(field.path, field.default), field.default)
        for field in fields
    }
    for message in broken(command.rules, settings):
        raise UsageError(message)
    return _built(command.arguments, None, given, "", {one.path: one.flag for one in fields})


def _built(arguments: Any, default: Any, given: Mapping[str, Any], path: str, flags: Any) -> Any:
    """Return a dataclass with the values that are given, and of others the defaults."""
    hints = get_type_hints(arguments)
    values = {}
    for field in dataclasses.fields(arguments):
        name = f"{path}{field.name}"
        if "option" in field.metadata:
            if name in given:
                value = given[name]
                values[field.name] = tuple(value) if isinstance(value, list) else value
        elif dataclasses.is_dataclass(hint := hints[field.name]):
            below = field.default if default is None else getattr(default, field.name)
            values[field.name] = _built(hint, below, given, f"{name}.", flags)
    if default is not None and all(values[name] is getattr(default, name) for name in values):
        return default
    try:
        if default is None:
            return arguments(**values)
        return dataclasses.replace(default, **values)
    except InputError as error:
        name, _, reason = str(error).partition(": ")
        flag = flags.get(path + name)
        message = f"{flag}: {reason}".replace("_", "-") if flag else str(error)
        raise UsageError(message) from error


class Parser(argparse.ArgumentParser):
    """Parser of one command."""

    def error(self, message: str) -> NoReturn:
        """Raise what `main` prints in one line."""
        raise UsageError(message.removeprefix("argument "))

    def refuse_unknown(self, words: Sequence[str]) -> None:
        """Refuse empty words, and options that do not exist; argparse names others first."""
        # `--namespace ''` is that of the root.
        if any(not two and one != "--namespace" for one, two in pairwise(["", *words])):
            self.error("an argument is empty, like a variable of the shell that is not set")
        for word in words:
            if word == "--":
                return
            name = word.partition("=")[0]
            if name.startswith("--") and not any(
                known.startswith(name) for known in self._option_string_actions
            ):
                self.error(f"{name}: no such option{did_you_mean(name, self.shown())}")

    def shown(self) -> list[str]:
        """Return the names of all options."""
        return [name for name in self._option_string_actions if name.startswith("--")]


class _HelpAll(argparse.Action):
    """Print the help with every option, and end."""

    def __init__(self, *, command: Command[Any], **others: Any) -> None:
        super().__init__(nargs=0, **others)
        self._command = command

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> None:
        make_parser(self._command, parser.prog, everything=True).print_help()
        parser.exit()


def make_parser(command: Command[Any], program: str, *, everything: bool = False) -> Parser:
    """Return the parser of a command, which `program` names in its help.

    Its help shows the options of daily use, or with `everything` all of them.
    """
    fields = fields_of(command.arguments)
    hidden = 0 if everything else sum(not field.option.daily for field in fields)
    more = _MORE.format(count=len(fields)) if hidden else ""
    parser = Parser(
        prog=program,
        description=textwrap.fill(command.description, 79),
        epilog="\n\n".join(filter(None, [more, command.examples])),
        formatter_class=argparse.RawDescriptionHelpFormatter,  # examples keep their lines
        argument_default=argparse.SUPPRESS,
        add_help=False,
    )
    groups: dict[str, Any] = {"": parser}
    for field in fields:
        if field.title not in groups:
            groups[field.title] = parser.add_argument_group(field.title)
        _add(groups[field.title], field, everything)
    if any(getattr(field.option, "is_output", False) for field in fields):
        what = "make the folders of output files"
        parser.add_argument("--parents", dest=_PARENTS, action="store_true", help=what)
    parser.add_argument("-h", "--help", action="help", help="show this help, and end")
    if hidden or everything:
        what = "show every option, and end"
        parser.add_argument("--help-all", action=_HelpAll, command=command, help=what)
    return parser


def _add(parser: Any, field: Field, everything: bool) -> None:
    """Add an option, or a positional argument, to a parser or a group of one."""
    shown = everything or field.option.daily
    what = _described(field) if shown else argparse.SUPPRESS
    if field.kind is bool:
        negative = [f"--no-{name[2:]}" for name in field.names if name.startswith("--")]
        parser.add_argument(
            *field.names, dest=field.path, action="store_true", default=argparse.SUPPRESS, help=what
        )
        parser.add_argument(
            *negative,
            dest=field.path,
            action="store_false",
            default=argparse.SUPPRESS,
            help=f"not {field.flag}" if shown and field.default is True else argparse.SUPPRESS,
        )
        return
    required = field.default is dataclasses.MISSING
    choices = field.option.choices
    placeholders = field.placeholders
    details: dict[str, Any] = {
        "type": _reader(field),
        "nargs": field.nargs,
        "choices": choices,
        "metavar": None if choices else placeholders[0] if len(placeholders) == 1 else placeholders,
        "help": what,
    }
    if isinstance(details["metavar"], list):
        details["metavar"] = tuple(placeholders)
    if field.names:
        parser.add_argument(*field.names, dest=field.path, required=required, **details)
    else:
        parser.add_argument(field.path, default=argparse.SUPPRESS, **details)


def _described(field: Field) -> str:
    """Return the help of an option: what it is, what is allowed, and its default."""
    option, default = field.option, field.default
    known = []
    if option.allowed and not option.choices:
        known.append(option.allowed)
    unspoken = "default" not in option.description
    if unspoken and default is True:
        known.append("default: on")
    elif unspoken and field.kind is not bool and default not in (None, "", (), dataclasses.MISSING):
        known.append(f"default {default}")
    text = option.description
    if known and text.endswith(")"):
        text = f"{text[:-1]}; {'; '.join(known)})"
    elif known:
        text += f" ({'; '.join(known)})"
    return text.replace("%", "%%")


def _reader(field: Field) -> Any:
    """Return what makes a value of a word, or says why it cannot."""
    option, kind = field.option, field.kind
    if isinstance(option, Argument) and option.parse is not None:
        return option.parse

    # What has no bounds may be infinite, such as the far end of a depth range.
    checks = not isinstance(option, Argument) or bool(option.allowed)

    def read(text: str) -> Any:
        if text is argparse.SUPPRESS:  # what stands for a positional argument left out
            return text
        value = kind(text)
        if kind in (int, float, str) and checks:
            try:
                check_option("", value, kind, option)
            except InputError as error:
                raise argparse.ArgumentTypeError(str(error).removeprefix(": ")) from error
        return value

    read.__name__ = kind.__name__  # argparse says "invalid int value"
    return read


def _shape(hint: Any) -> tuple[Any, Any]:
    """Return the type of a value, and how many there are: a number, or "any"."""
    if get_origin(hint) in (Union, types.UnionType):
        hint = next(one for one in get_args(hint) if one is not type(None))
    if get_origin(hint) is tuple:
        first, *others = get_args(hint)
        return first, "any" if others == [Ellipsis] else 1 + len(others)
    return hint, 1
