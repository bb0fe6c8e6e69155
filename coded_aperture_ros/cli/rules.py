"""Which options need or exclude each other: a table for each command, checked in one place.

What depends on the files that the options name is checked where the files are read. What an option
of the library needs, for commands and nodes alike, is its `needs`; see `core.options`.

A condition is an option that has another value than its default, ``--motion``, or one with a
certain value, ``--method two_pixel``. Alternatives are written ``--motion | --method motion``, what
must hold together ``--level-count & --remap``. A name that ends in ``.*``, such as ``two_pixel.*``,
stands for every option of a group.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any


@dataclasses.dataclass(frozen=True)
class Setting:
    """An option and its value."""

    flag: str  # as it is typed, "--depth-range"; of a positional argument, its placeholder
    value: Any
    default: Any

    @property
    def is_changed(self) -> bool:
        """Whether the value is another one than the default; 0 is not the same as false."""
        same_kind = isinstance(self.value, bool) == isinstance(self.default, bool)
        return not (same_kind and self.value == self.default)


@dataclasses.dataclass(frozen=True)
class Rule:
    """One line of a table; made by `needs`, `only_with`, `excludes` and `required`."""

    kind: str
    subject: str
    others: tuple[str, ...]
    note: str = ""

    def __str__(self) -> str:
        return f"{self.subject} {self.kind} {', '.join(self.others)}"


def needs(subject: str, *others: str) -> Rule:
    """Return the rule that with `subject` all of the others must be given."""
    return Rule("needs", subject, others)


def only_with(subject: str, *others: str, note: str = "") -> Rule:
    """Return the rule that `subject` is of use with one of the others only."""
    return Rule("only with", subject, others, note)


def excludes(subject: str, *others: str, note: str = "") -> Rule:
    """Return the rule that `subject` goes with none of the others."""
    return Rule("excludes", subject, others, note)


def required(*alternatives: str, note: str = "") -> Rule:
    """Return the rule that one of the alternatives must be given; `note` is said of them."""
    return Rule("required", "", alternatives, note)


def broken(rules: Iterable[Rule], settings: Mapping[str, Setting]) -> Iterator[str]:
    """Yield a message for every rule that is broken.

    Parameters
    ----------
    rules : iterable of Rule
    settings : mapping of str to Setting
        By the name of the field; of a field in a group, by ``group.field``.
    """
    for rule in rules:
        if message := _message(rule, settings):
            yield message


def _message(rule: Rule, settings: Mapping[str, Setting]) -> str:
    """Return what is wrong by a rule, or nothing."""
    note = f" ({rule.note})" if rule.note else ""
    held = [other for other in rule.others if _holds(other, settings)]
    if rule.kind == "required":
        return "" if held else f"required: {_joined(rule.others)}{note}"
    given = _given(rule.subject, settings)
    if not given:
        return ""
    if rule.kind == "excludes":
        return f"{given}: not with {held[0]}{note}" if held else ""
    if rule.kind == "only with":
        return "" if held else f"{given}: only with {_joined(rule.others)}{note}"
    missing = [other for other in rule.others if other not in held]
    return f"{given}: needs {_joined(missing, ', ')} too" if missing else ""


def _joined(conditions: Sequence[str], between: str = " or ") -> str:
    return between.join(conditions).replace(" | ", " or ").replace(" & ", " with ")


def _holds(condition: str, settings: Mapping[str, Setting]) -> bool:
    return any(_given(part, settings) for part in condition.split(" | "))


def _given(condition: str, settings: Mapping[str, Setting]) -> str:
    """Return the condition as messages say it if it holds, else nothing.

    Of a group that is the first option that is changed.
    """
    if " & " in condition:
        parts = [_given(part, settings) for part in condition.split(" & ")]
        return " with ".join(parts) if all(parts) else ""
    for part in condition.split(" | "):
        if part.endswith(".*"):
            members = (one for name, one in settings.items() if name.startswith(part[:-1]))
            if changed := next((one.flag for one in members if one.is_changed), ""):
                return changed
            continue
        flag, _, value = part.partition(" ")
        one = next(one for one in settings.values() if one.flag == flag)
        if str(one.value) == value if value else one.is_changed:
            return part
    return ""
