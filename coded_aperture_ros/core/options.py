"""Options of frozen dataclasses: default, unit, range and help, written in one place.

ROS parameters, command-line options and YAML files are derived from them:

    temporal_frames: float = option(0.0, "...", parameter="temporal.frames")
"""

import dataclasses
import sys
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.text import short


@dataclasses.dataclass(frozen=True)
class Option:
    """Description of one setting, in the metadata of its dataclass field.

    Attributes
    ----------
    description : str
        For help texts and ROS descriptors.
    unit : str
        Of the value and its bounds.
    minimum, maximum : float or None
        Inclusive bounds.
    above : float or None
        Exclusive lower bound.
    choices : tuple or None
        The only values allowed.
    read_only : bool
        Whether a running node cannot change it.
    daily : bool
        Whether `--help` shows it; `--help-all` shows every option.
    needs : (str, value) or None
        Field, and the value of it without which only the default is allowed; True: any but 0.
    parameter : str
        Name of the ROS parameter, such as ``regularize.method``; empty: see `parameter_names`.
    """

    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    choices: tuple[Any, ...] | None = None
    read_only: bool = False
    daily: bool = False
    needs: tuple[str, Any] | None = None
    parameter: str = ""

    @property
    def allowed(self) -> str:
        """Allowed values, in words; empty if every value of the type is allowed."""
        if self.choices is not None:
            return "one of " + ", ".join(str(choice) or "''" for choice in self.choices)
        unit = f" {self.unit}" if self.unit else ""
        if self.minimum is not None and self.maximum is not None:
            return f"{self.minimum:g} to {self.maximum:g}{unit}"
        if self.above is not None:
            return f"more than {self.above:g}{unit}"
        if self.minimum is not None:
            return f"at least {self.minimum:g}{unit}"
        if self.maximum is not None:
            return f"at most {self.maximum:g}{unit}"
        return ""


def option(
    default: Any, description: str, *, within: tuple[float, float] | None = None, **described: Any
) -> Any:
    """Dataclass field with its default and its `Option`.

    Parameters
    ----------
    default
    description : str
    within : (float, float), optional
        Both bounds.
    **described
        Further attributes of `Option`.

    Examples
    --------
    >>> @dataclasses.dataclass(frozen=True)
    ... class LensConfig:
    ...     focus_m: float = option(1.0, "Focus distance", unit="m", within=(0.1, 100.0))
    ...     def __post_init__(self):
    ...         check_options(self)
    >>> LensConfig(focus_m=2.0)
    LensConfig(focus_m=2.0)
    >>> LensConfig(focus_m=0.0)
    Traceback (most recent call last):
    ...
    coded_aperture_ros.core.errors.InputError: focus_m: 0.0 is out of range (0.1 to 100 m)
    """
    if within is not None:
        described["minimum"], described["maximum"] = within
    known = Option(description, **described)
    return dataclasses.field(default=default, metadata={"option": known})


def option_of(config: type, name: str) -> Any:
    """Dataclass field with the default and the `Option` of a field of another configuration."""
    field, known = options_of(config)[name]
    return dataclasses.field(default=field.default, metadata={"option": known})


def options_of(config: Any) -> dict[str, tuple[dataclasses.Field[Any], Option]]:
    """`{name: (field, option)}` of a configuration dataclass or an instance of one."""
    return {
        field.name: (field, field.metadata["option"])
        for field in dataclasses.fields(config)
        if "option" in field.metadata
    }


def parameter_names(config: Any) -> dict[str, str]:
    """`{field name: name of the ROS parameter}` of a configuration dataclass.

    With a `parameter_group` of ``motion.`` the fields `motion_rank` and `finalists` have the
    parameters ``motion.rank`` and ``motion.finalists``, unless their options give another name.
    """
    group = getattr(config, "parameter_group", "")
    return {
        name: described.parameter or group + name.removeprefix(group.replace(".", "_"))
        for name, (_, described) in options_of(config).items()
    }


def check_options(config: Any) -> None:
    """Check every option of a dataclass instance against its type, choices and range.

    To be called in `__post_init__`; see `option`.

    Raises
    ------
    InputError
        If a value is not allowed, with the setting, its value and the allowed values.
    """
    for name, (field, described) in options_of(config).items():
        value = getattr(config, name)
        check_option(name, value, type(field.default), described)
        if described.needs is not None and value != field.default:
            other, needed = described.needs
            found = getattr(config, other)
            if not found if needed is True else found != needed:
                needed = "more than 0" if isinstance(found, float) else needed
                instead = f"use {field.default}" if field.default != "" else "leave it empty"
                raise InputError(f"{name}: needs {other}: {needed}, else {instead}")


def check_option(name: str, value: Any, expected: type, described: Option) -> None:
    """Raise an `InputError` if a value is not allowed; see `check_options`."""
    allowed = f" ({described.allowed})" if described.allowed else ""
    if not has_type(value, expected):
        raise InputError(f"{name}: expected {expected.__name__}{allowed}, got {short(value)}")
    if described.choices is not None and value not in described.choices:
        raise InputError(f"{name}: {short(value)} is not allowed, use {described.allowed}")
    if expected in (int, float):
        too_small = described.minimum is not None and value < described.minimum
        too_small |= described.above is not None and value <= described.above
        too_large = described.maximum is not None and value > described.maximum
        # Not math.isfinite, which fails for integers beyond the range of floats.
        if too_small or too_large or not abs(value) <= sys.float_info.max:
            raise InputError(f"{name}: {short(value)} is out of range{allowed}")


def has_type(value: Any, expected: type) -> bool:
    """Whether a value is of a type: an integer is a float, too; a bool is not a number.

    Examples
    --------
    >>> has_type(1, float), has_type(True, int)
    (True, False)
    """
    if isinstance(value, bool):
        return expected is bool
    return isinstance(value, (int, float) if expected is float else expected)
