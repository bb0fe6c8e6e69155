"""Settings described once: defaults, units, ranges and help live in frozen dataclasses.

ROS parameters, command-line options and YAML files are all derived from these dataclasses, so
that a default or a range is written in one place only.
"""

import dataclasses
import sys
from typing import Any

from coded_aperture_ros.core.errors import InputError


@dataclasses.dataclass(frozen=True)
class Option:
    """What is known about one setting, kept in its dataclass field's metadata."""

    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] | None = None
    read_only: bool = False

    @property
    def allowed(self) -> str:
        """The allowed values, in words; empty where anything of the right type goes."""
        if self.choices is not None:
            return "one of " + ", ".join(choice or "''" for choice in self.choices)
        unit = f" {self.unit}" if self.unit else ""
        if self.minimum is not None and self.maximum is not None:
            return f"{self.minimum:g} to {self.maximum:g}{unit}"
        if self.minimum is not None:
            return f"at least {self.minimum:g}{unit}"
        if self.maximum is not None:
            return f"at most {self.maximum:g}{unit}"
        return ""


def option(
    default: Any,
    description: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] | None = None,
    read_only: bool = False,
) -> Any:
    """Declare a dataclass field that carries its `Option`.

    `read_only` marks what a running node cannot change. The other arguments are the fields of
    `Option`; bounds are inclusive.
    """
    described = Option(description, unit, minimum, maximum, choices, read_only)
    return dataclasses.field(default=default, metadata={"option": described})


def options_of(config: Any) -> dict[str, tuple[dataclasses.Field[Any], Option]]:
    """Return `{name: (field, option)}` of a configuration dataclass or an instance of one."""
    return {
        field.name: (field, field.metadata["option"])
        for field in dataclasses.fields(config)
        if "option" in field.metadata
    }


def check_options(config: Any) -> None:
    """Check every option of a dataclass instance against its type, choices and range.

    Meant to be called from `__post_init__`.

    Raises
    ------
    InputError
        Naming the setting, its value and what is allowed.
    """
    for name, (field, described) in options_of(config).items():
        check_option(name, getattr(config, name), type(field.default), described)


def check_option(name: str, value: Any, expected: type, described: Option) -> None:
    """Check one value; see `check_options`."""
    allowed = f" ({described.allowed})" if described.allowed else ""
    if not _has_type(value, expected):
        raise InputError(f"{name}: expected {expected.__name__}{allowed}, got {value!r}")
    if described.choices is not None and value not in described.choices:
        raise InputError(f"{name}: {value!r} is not allowed, use {described.allowed}")
    if expected in (int, float):
        too_small = described.minimum is not None and value < described.minimum
        too_large = described.maximum is not None and value > described.maximum
        # Not math.isfinite, which fails for integers beyond the range of floats.
        if too_small or too_large or not abs(value) <= sys.float_info.max:
            raise InputError(f"{name}: {value!r} is out of range{allowed}")


def _has_type(value: Any, expected: type) -> bool:
    if expected is float:
        return isinstance(value, (int, float)) and not isinstance(value, bool)
    if expected is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, expected)
