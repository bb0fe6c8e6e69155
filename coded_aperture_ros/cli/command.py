"""What a command is: a dataclass of its arguments, rules between them, and what it does.

A command's module has one object `COMMAND`. Its arguments are the fields of a frozen dataclass:

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Arguments:
        inputs: tuple[str, ...] = argument("pictures", written="INPUT")
        output: str = argument("depth map", written="-o --output OUT")
        size: tuple[int, int] | None = argument("of the frame", None, written="--size W H")
        json: bool = argument("print a summary as JSON", False)
        estimation: DepthConfig = group("estimation", DepthConfig())

A field's type says how its words are read; a field that is a dataclass itself, such as a
configuration of the library, adds an option for each of its own fields. `parser` makes the
parser, and the dataclass with its values.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

from coded_aperture_ros.cli.rules import Rule
from coded_aperture_ros.core.options import Option

Arguments = TypeVar("Arguments")


class UsageError(Exception):
    """What was typed cannot be meant: one line says why. The exit status is 2.

    `program` is whose help tells more, such as ``coded_aperture mask``; empty: of the command that
    runs.
    """

    def __init__(self, message: str, program: str = "") -> None:
        super().__init__(message)
        self.program = program


@dataclasses.dataclass(frozen=True)
class Command(Generic[Arguments]):
    """A command, or an action of one."""

    arguments: type[Arguments]
    run: Callable[[Arguments], int]  # returns the exit status
    description: str
    examples: str  # shown below the options
    rules: tuple[Rule, ...] = ()


@dataclasses.dataclass(frozen=True)
class Argument(Option):
    """What the command line knows of a field beyond what every setting has."""

    # Names and placeholders: "-o --output FILE", "--depth-range NEAR FAR"; one placeholder alone is
    # a positional argument. Empty: the name of the field.
    written: str = ""
    parse: Callable[[str], Any] | None = None  # reads a word; None: the field's type does
    # Whether it names a file to write, or a folder. The folder of a file must be there, or the
    # command gets `--parents`; folders for results are made.
    is_output: bool = False


_REQUIRED: Any = dataclasses.MISSING


def argument(
    description: str, default: Any = _REQUIRED, *, daily: bool = True, **described: Any
) -> Any:
    """Declare a field of a command's arguments.

    Parameters
    ----------
    description : str
        Shown by ``--help``; the default is added to it, unless it has the word itself.
    default
        Value where the option is not given; without one it must be given.
    daily : bool
        Whether ``--help`` shows it; ``--help-all`` shows every one.
    **described
        Further attributes of `Argument`, such as `written`, `choices` or `minimum`.
    """
    known = Argument(description, daily=daily, **described)
    return dataclasses.field(default=default, metadata={"option": known})


def group(title: str, default: Any, *, without: Sequence[str] = ()) -> Any:
    """Declare a field that is a dataclass: its options are shown together below a title.

    `default` is an instance, whose values are the defaults of the options; the fields `without`
    are no options of the command.
    """
    return dataclasses.field(default=default, metadata={"group": title, "without": without})


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """Return the end of a message that names what is written alike, or nothing."""
    import difflib

    alike = difflib.get_close_matches(word, known, 1)
    return f" (did you mean {alike[0]}?)" if alike else ""
