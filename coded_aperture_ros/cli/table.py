"""Tables of commands: a module is loaded only if its command is the one that was typed."""

import dataclasses
import logging
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import Any

from coded_aperture_ros.cli.command import Command, UsageError, did_you_mean

_HELP = {"-h", "--help", "--help-all"}


@dataclasses.dataclass(frozen=True)
class Entry:
    """A command in a module of this package, as its object `COMMAND`."""

    module: str
    help: str  # one line

    def load(self) -> Command[Any]:
        """Return the command."""
        module = import_module(f"coded_aperture_ros.cli.{self.module}")
        command: Command[Any] = module.COMMAND
        return command

    def prepare(self, program: str, words: Sequence[str]) -> Callable[[], int]:
        """Read what was typed after the command's name; return what runs it, for its status."""
        from coded_aperture_ros.cli.parser import parsed

        command = self.load()
        return partial(command.run, parsed(command, program, words))


@dataclasses.dataclass(frozen=True)
class Actions:
    """A command that has actions, each of which is a command."""

    help: str  # one line
    description: str
    examples: str
    actions: Mapping[str, Any]  # `Entry`, `Actions`, or what has `help` and `prepare` as well
    # What options without an action mean: name of the command to type instead, which is run.
    without: tuple[str, Entry] | None = None
    placeholder: str = "ACTION"

    def choose(self, program: str, words: Sequence[str]) -> tuple[str, Any, Sequence[str]]:
        """Return the name in messages, the command, and what was typed after its name.

        Raises
        ------
        UsageError
            If the first word is no action.
        SystemExit
            With status 0, after the help was printed.
        """
        first = words[0] if words else ""
        chosen = self.actions.get(first)
        if isinstance(chosen, Actions):
            return chosen.choose(f"{program} {first}", words[1:])
        if chosen is not None:
            return f"{program} {first}", chosen, words[1:]
        if first in _HELP:
            print(self.text(program, everything=first == "--help-all"))
            raise SystemExit(0)
        if not first.startswith("-"):
            raise UsageError(self._no_action(first), program)
        if action := next((word for word in words if word in self.actions), ""):
            raise UsageError(f"{first}: goes after the word {action}", program)
        if self.without is None:
            raise UsageError(f"{first}: {self._no_action('')}", program)
        name, entry = self.without
        present = f"{program.partition(' ')[0]} {name}"
        logging.warning("'%s' without an action is now '%s': use this", program, present)
        return present, entry, words

    def _no_action(self, word: str) -> str:
        what = self.placeholder.lower()
        if not word:
            return f"the {what} is missing, use one of {', '.join(self.actions)}"
        return f"{word}: no such {what}{did_you_mean(word, list(self.actions))}"

    def text(self, program: str, *, everything: bool = False) -> str:
        """Return the help; with `everything`, the actions of actions are listed, too."""
        options = ["  -h, --help       show this help, and end"]
        if any(isinstance(one, Actions) for one in self.actions.values()):
            options.append("  --help-all       list the actions of commands, too")
        if self.placeholder == "COMMAND":
            options.append("  --version        version of the program and of what it runs on")
        return "\n".join(
            [
                f"usage: {program} [-h] {self.placeholder} ...",
                "",
                textwrap.fill(self.description, 79),
                "",
                f"{self.placeholder.lower()}s:",
                *self._lines(everything, ""),
                "",
                "options:",
                *options,
                "",
                self.examples.rstrip(),
            ]
        )

    def _lines(self, everything: bool, before: str) -> Iterator[str]:
        for name, entry in self.actions.items():
            yield f"  {before + name:16} {entry.help}"
            if everything and isinstance(entry, Actions):
                yield from entry._lines(everything, f"{before}{name} ")
