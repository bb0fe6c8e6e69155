"""Command-line options that several sub-commands share."""

import argparse
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from itertools import pairwise
from typing import Any

from coded_aperture_ros.core.arguments import at_least
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import Option, check_option, options_of
from coded_aperture_ros.core.workers import processors


class CommandParser(argparse.ArgumentParser):
    """Parser of a sub-command, whose help ends with examples.

    It can add options once it is the command that was chosen: options made from the
    library's settings need the library, whose import takes a while, and the program's own `--help`
    should not wait for it.
    """

    add_late_options: Callable[[argparse.ArgumentParser], None] | None = None

    def __init__(self, *, description: str = "", **others: Any) -> None:
        super().__init__(
            description=textwrap.fill(description, 79),
            formatter_class=argparse.RawDescriptionHelpFormatter,  # examples keep their lines
            **others,
        )
        # For what only the values of several options together can tell.
        self.set_defaults(usage_error=self.error)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Add the late options, then parse; see `argparse.ArgumentParser`."""
        show_late_options(self, ())
        # `--namespace ''` is that of the root.
        if any(not two and one != "--namespace" for one, two in pairwise(["", *(args or ())])):
            self.error("an argument is empty, like a variable of the shell that is not set")
        return super().parse_known_args(args, namespace)


def show_late_options(parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
    """Add the late options of a parser, and of those of its commands that `words` name."""
    if isinstance(parser, CommandParser) and parser.add_late_options is not None:
        late, parser.add_late_options = parser.add_late_options, None
        late(parser)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word in set(words) & set(action.choices):
                show_late_options(action.choices[word], words)


class _Commands(argparse._SubParsersAction):
    """Chooses a command; refuses options before its name, in place of which its own would count."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: Any = None) -> None:
        for action in parser._actions:
            if getattr(namespace, action.dest, action.default) != action.default:
                parser.error(f"{action.option_strings[-1]}: goes after the word {values[0]}")
        super().__call__(parser, namespace, values, option_string)


def add_commands(
    parser: argparse.ArgumentParser, dest: str, commands: Iterable[Any], *, required: bool = True
) -> None:
    """Let a parser choose among modules, each with `add_parser(subparsers)`."""
    subparsers = parser.add_subparsers(
        dest=dest,
        metavar=dest.upper(),
        required=required,
        parser_class=CommandParser,
        action=_Commands,
    )
    for command in commands:
        command.add_parser(subparsers)


def add_config_options(
    parser: argparse.ArgumentParser, config: type, title: str, **defaults: Any
) -> argparse._ArgumentGroup:
    """Add an option for every setting of a configuration dataclass; return their group.

    A setting `confidence_threshold` becomes `--confidence-threshold`, with the dataclass's
    help and range, and its default unless `defaults` has another one; None, where it matters
    whether it was given.
    """
    group = parser.add_argument_group(title)
    for name, (field, described) in options_of(config).items():
        default = defaults.get(name, field.default)
        shown = field.default if default is None else default
        allowed = f"{described.allowed}; " if described.allowed and not described.choices else ""
        group.add_argument(
            written_name(name),
            type=_parser_of(type(field.default), described),
            choices=described.choices,
            default=default,
            metavar=None if described.choices else type(field.default).__name__.upper(),
            help=f"{described.description} ({allowed}default {shown})",
        )
    return group


def settings_of(configs: Mapping[str, str], **defaults: Any) -> Callable[[Any], None]:
    """Return what adds the options of configurations to a parser, see `add_config_options`.

    `configs` has the title of each by its name, such as `bank.LearnConfig`: its module is imported
    only then.
    """

    def add(parser: argparse.ArgumentParser) -> None:
        for config, title in configs.items():
            module, _, name = f"coded_aperture_ros.{config}".rpartition(".")
            add_config_options(parser, getattr(import_module(module), name), title, **defaults)

    return add


def written_name(name: str) -> str:
    """Return the name of a setting, or of an attribute of the arguments, as an option."""
    return f"--{name.replace('_', '-')}"


def _parser_of(kind: type, described: Option) -> Callable[[str], Any]:
    def parse(text: str) -> Any:
        if kind is bool and text.lower() not in ("true", "false"):
            raise argparse.ArgumentTypeError(f"expected true or false, got {text}")
        value = text.lower() == "true" if kind is bool else kind(text)
        try:
            check_option("", value, kind, described)
        except InputError as error:
            raise argparse.ArgumentTypeError(str(error).removeprefix(": ")) from error
        return value

    parse.__name__ = kind.__name__  # argparse says "invalid int value"
    return parse


def config_from(args: argparse.Namespace, config: type) -> Any:
    """Return the configuration dataclass with the values of the command line."""
    given = {name: getattr(args, name) for name in options_of(config)}
    return config(**{name: value for name, value in given.items() if value is not None})


def changed(args: argparse.Namespace, group: argparse._ArgumentGroup) -> list[str]:
    """Return which options of a group have other values than their defaults."""
    present = [action for action in group._group_actions if action.help != argparse.SUPPRESS]
    return [one.option_strings[0] for one in present if getattr(args, one.dest) != one.default]


def add_gamma_option(parser: argparse.ArgumentParser) -> None:
    """Add `--gamma`, which says how 8-bit input is encoded."""
    what = {
        "--gamma G": "how 8-bit input is encoded: an exponent such as 2.2, or srgb as in most "
        "pictures (default 1: linear light, as from a camera's raw values)"
    }
    add_options(parser, what, type=_gamma, default="1")


def add_bits_option(parser: argparse.ArgumentParser) -> None:
    """Add `--bits`, for sensors whose numbers were not scaled."""
    what = "of 16-bit input, where a sensor's 10 or 12 are not scaled to 16 (default %(default)s)"
    add_options(parser, {"--bits N": what}, type=int, choices=range(8, 17), default=16)


def add_mosaic_option(parser: argparse.ArgumentParser) -> None:
    """Add `--bayer`, for pictures as the sensor counts them."""
    what = {
        "--bayer {rggb,bggr,gbrg,grbg}": "pictures are the grey mosaics of a sensor with these "
        "colour filters in every two by two pixels; bags know it themselves"
    }
    add_options(parser, what, default="")


def _gamma(text: str) -> Any:
    from coded_aperture_ros.frames import gamma_from_text

    try:
        return gamma_from_text(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix("gamma: ")) from error


def add_options(
    parser: argparse._ActionsContainer, options: Mapping[str, str], **others: Any
) -> argparse.Action:
    """Add options that have much in common; return the last.

    `options` says how each is written, such as ``-o --output FILE`` or ``--depth-range NEAR FAR``,
    and what it is. One without a placeholder for its value is a flag; of ``--band {full,half}`` the
    first is the default. `add_argument` gets all `others` for each of them.
    """
    for written, what in options.items():
        names = [word for word in written.split() if word.startswith("-")]
        places = tuple(written.split()[len(names) :])
        shape: dict[str, Any] = {"metavar": places, "nargs": len(places)}
        if len(places) < 2:
            shape = {"metavar": places[0]} if places else {"action": "store_true"}
        if places and places[0].startswith("{"):
            choices = tuple(places[0].strip("{}").split(","))
            shape = {"choices": choices, "default": choices[0]}
        action = parser.add_argument(*names, help=what, **(shape | others))
    return action


def add_jobs_option(parser: argparse.ArgumentParser) -> None:
    """Add how many processes share the work."""
    what = {"--jobs N": "processes (default: one for each processor)"}
    add_options(parser, what, type=at_least(1), default=processors())
