"""Settings are described once and checked against that description."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import (
    Option,
    check_options,
    option,
    options_of,
    parameter_names,
)


@dataclasses.dataclass(frozen=True)
class Config:
    rate_hz: float = option(10.0, "Frames a second", unit="Hz", within=(0.5, 60))
    levels: int = option(30, "Blur levels", within=(2, 200))
    method: str = option("none", "How to smooth", choices=("none", "tv"), read_only=True)
    lazy: bool = option(True, "Wait for subscribers")
    name: str = option("", "Any text")
    plain: int = 3

    def __post_init__(self):
        check_options(self)


def test_defaults_are_valid_and_described():
    described = {name: known for name, (_, known) in options_of(Config()).items()}
    assert list(described) == ["rate_hz", "levels", "method", "lazy", "name"]
    assert described["rate_hz"] == Option("Frames a second", "Hz", 0.5, 60)
    assert described["method"].read_only
    assert not described["levels"].read_only


def test_options_of_a_class_and_of_an_instance_are_the_same():
    assert options_of(Config) == options_of(Config())


@pytest.mark.parametrize(
    ("known", "words"),
    [
        (Option("", "m", 1, 2.5), "1 to 2.5 m"),
        (Option("", "px", 1), "at least 1 px"),
        (Option("", "", None, 7), "at most 7"),
        (Option("", choices=("", "a")), "one of '', a"),
        (Option(""), ""),
    ],
)
def test_what_is_allowed_in_words(known, words):
    assert known.allowed == words


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rate_hz": 0.4}, "rate_hz: 0.4 is out of range (0.5 to 60 Hz)"),
        ({"rate_hz": 60.001}, "rate_hz: 60.001 is out of range (0.5 to 60 Hz)"),
        ({"rate_hz": math.nan}, "rate_hz: nan is out of range (0.5 to 60 Hz)"),
        ({"rate_hz": math.inf}, "rate_hz: inf is out of range (0.5 to 60 Hz)"),
        ({"rate_hz": True}, "rate_hz: expected float (0.5 to 60 Hz), got True"),
        ({"rate_hz": "fast"}, "rate_hz: expected float (0.5 to 60 Hz), got 'fast'"),
        ({"rate_hz": None}, "rate_hz: expected float (0.5 to 60 Hz), got None"),
        ({"levels": 1}, "levels: 1 is out of range (2 to 200)"),
        ({"levels": 30.0}, "levels: expected int (2 to 200), got 30.0"),
        ({"levels": True}, "levels: expected int (2 to 200), got True"),
        ({"method": "TV"}, "method: 'TV' is not allowed, use one of none, tv"),
        ({"method": 1}, "method: expected str (one of none, tv), got 1"),
        ({"lazy": 1}, "lazy: expected bool, got 1"),
        ({"name": 5}, "name: expected str, got 5"),
    ],
)
def test_a_bad_value_is_refused_by_name_with_what_is_allowed(values, message):
    with pytest.raises(InputError) as caught:
        Config(**values)
    assert str(caught.value) == message


@given(st.floats(min_value=0.5, max_value=60) | st.integers(min_value=1, max_value=60))
def test_every_value_in_the_range_is_taken(value):
    """Whole numbers too: YAML writes 10 where 10.0 is meant."""
    assert Config(rate_hz=value).rate_hz == value


@given(st.floats() | st.integers())
def test_a_number_is_taken_exactly_if_it_is_in_the_range(value):
    try:
        Config(rate_hz=value)
        taken = True
    except InputError:
        taken = False
    assert taken == (0.5 <= value <= 60)


@given(st.text())
def test_messages_are_single_lines(text):
    """Whatever a file holds, the message stays one line."""
    if text in ("none", "tv"):
        return
    with pytest.raises(InputError) as caught:
        Config(method=text)
    assert len(str(caught.value).splitlines()) == 1


def test_huge_integers_are_out_of_range_and_not_an_overflow():
    with pytest.raises(InputError, match="levels"):
        Config(levels=10**400)


def test_names_of_parameters():
    @dataclasses.dataclass(frozen=True)
    class Grouped:
        plain: float = option(0.0, "As ever")
        moved: float = option(0.0, "In a group of parameters", parameter="group.moved")

    assert parameter_names(Grouped()) == {"plain": "plain", "moved": "group.moved"}
