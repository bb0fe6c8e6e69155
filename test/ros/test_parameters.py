"""ROS parameters made from configuration dataclasses."""

import dataclasses
from types import MappingProxyType

import pytest
from rcl_interfaces.msg import ParameterType
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros_helpers import Ros

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.ros.parameters import NodeParameters


@dataclasses.dataclass(frozen=True)
class Config:
    file: str = option("", "A file", read_only=True)
    kind: str = option("fast", "A method", choices=("fast", "slow"))
    weight: float = option(0.5, "A weight", unit="m", within=(0.0, 1.0))
    size: int = option(8, "A size", minimum=1)
    free: float = option(1.0, "Any number", parameter="group.free")
    on: bool = option(True, "A switch")

    def __post_init__(self):
        check_options(self)
        if self.kind == "slow" and self.size > 100:
            raise InputError("size: slow goes up to 100 only")


@dataclasses.dataclass(frozen=True)
class Other:
    rank: int = option(3, "Another", minimum=1)


@pytest.fixture(scope="module")
def ros():
    ros = Ros()
    yield ros
    ros.close()


@pytest.fixture
def make(ros, request):
    made = []

    def make(*configs, fixed=MappingProxyType({}), **overrides):
        given = [Parameter(name, value=value) for name, value in overrides.items()]
        node = Node("subject", context=ros.context, parameter_overrides=given)
        made.append(node)
        return node, NodeParameters(node, *(configs or (Config(), Other())), fixed=fixed)

    yield make
    for node in made:
        node.destroy_node()


def change(node, **values):
    given = [Parameter(name, value=value) for name, value in values.items()]
    return node.set_parameters_atomically(given)


def test_defaults_and_overrides(make):
    _, parameters = make(weight=0.25, file="bank.npz", rank=7)
    assert parameters[Config] == Config(weight=0.25, file="bank.npz")
    assert parameters[Other] == Other(rank=7)


def test_descriptors_say_what_is_allowed(make):
    node, _ = make()
    weight = node.describe_parameter("weight")
    assert weight.description == "A weight [m]"
    assert weight.type == ParameterType.PARAMETER_DOUBLE
    (allowed,) = weight.floating_point_range
    assert (allowed.from_value, allowed.to_value) == (0.0, 1.0)
    (allowed,) = node.describe_parameter("size").integer_range
    assert (allowed.from_value, allowed.to_value) == (1, 2**63 - 1)
    assert node.describe_parameter("file").read_only
    assert node.describe_parameter("kind").additional_constraints == "one of fast, slow"
    assert not node.describe_parameter("group.free").floating_point_range


def test_a_good_value_makes_a_new_config(make):
    node, parameters = make()
    before = parameters[Config]
    assert change(node, weight=1.0, kind="slow").successful
    assert parameters[Config] == dataclasses.replace(before, weight=1.0, kind="slow")
    assert before == Config()
    assert parameters[Other] is parameters[Other]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("weight", 1.5, "weight"),
        ("weight", float("nan"), "weight"),
        ("weight", "much", "Type.DOUBLE"),
        ("weight", True, "Type.DOUBLE"),
        ("weight", 2, "weight"),
        ("group.free", float("inf"), "group.free"),
        ("size", 0, "size"),
        ("size", 2.0, "Type.INTEGER"),
        ("kind", "medium", "'medium' is not allowed, use one of fast, slow"),
        ("file", "other.npz", "read-only"),
        ("on", 1, "on"),
    ],
)
def test_a_bad_value_is_refused_with_the_reason_and_the_old_one_stays(make, name, value, reason):
    node, parameters = make()
    result = change(node, **{name: value})
    assert not result.successful
    assert reason in result.reason
    assert parameters[Config] == Config()
    assert node.get_parameter(name).value == getattr(Config(), name.removeprefix("group."))


def test_values_are_checked_together(make):
    node, parameters = make()
    assert change(node, size=200).successful
    result = change(node, kind="slow")
    assert (result.successful, result.reason) == (False, "size: slow goes up to 100 only")
    assert change(node, kind="slow", size=50).successful
    assert parameters[Config] == Config(kind="slow", size=50)


def test_one_bad_value_of_several_refuses_all(make):
    node, parameters = make()
    assert not change(node, size=20, kind="medium").successful
    assert parameters[Config] == Config()


def test_fixed_configs_are_read_only_and_have_a_prefix(make):
    fixed = {"learn.": Other()}
    node, parameters = make(Config(), fixed=fixed, **{"learn.rank": 5})
    assert parameters[Other] == Other(rank=5)
    assert "read-only" in change(node, **{"learn.rank": 4}).reason
    assert change(node, size=9).successful
    assert parameters[Other] == Other(rank=5)


@pytest.mark.parametrize(
    ("name", "value", "hint"),
    [
        ("weight", 2.0, "0 to 1 m"),
        ("weight", "much", "expected float (0 to 1 m), got 'much'"),
        ("weight", True, "expected float"),
        ("size", 2.5, "expected int"),
        ("size", 0, "at least 1"),
        ("kind", "medium", "one of fast, slow"),
    ],
)
def test_a_bad_value_at_start_is_one_clear_line(make, name, value, hint):
    with pytest.raises(InputError) as caught:
        make(**{name: value})
    assert name in str(caught.value)
    assert hint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_integer_is_a_number_too(make):
    node, parameters = make(weight=1)
    assert (type(parameters[Config].weight), parameters[Config].weight) == (float, 1.0)
    assert node.get_parameter("weight").type_ == Parameter.Type.DOUBLE
    assert change(node, weight=0).successful
    assert (type(parameters[Config].weight), parameters[Config].weight) == (float, 0.0)
    assert node.get_parameter("weight").value == 0.0
    assert node.set_parameters([Parameter("weight", value=1)])[0].successful


@pytest.fixture
def warned(monkeypatch):
    """Return what nodes warn of."""
    said = []
    monkeypatch.setattr(RcutilsLogger, "warning", lambda _, message, **__: said.append(message))
    return said


def test_a_parameter_goes_by_the_name_of_its_group(make, warned):
    node, parameters = make(**{"group.free": 5.0})
    assert change(node, **{"group.free": 6.0}).successful
    assert parameters[Config].free == 6.0
    assert warned == []
    assert not node.has_parameter("free")


@pytest.mark.parametrize(
    "error",
    [
        InputError("cannot read /etc/shadow: got 'root:x:0'"),
        MemoryError(),
        RecursionError("too deep"),
        OverflowError("too large"),
        OSError(13, "Permission denied", "/etc/shadow"),
        KeyError("root"),
    ],
    ids=lambda error: type(error).__name__,
)
@pytest.mark.parametrize("reads_files", [True, False])
def test_whoever_sets_a_parameter_learns_nothing_of_files(make, error, reads_files):
    node, parameters = make()

    def prepare(config):
        raise error

    parameters.on_change(Config, prepare, lambda config: None, reads_files=reads_files)
    before = parameters[Config]
    result = change(node, weight=1.0)
    assert not result.successful
    if reads_files or not isinstance(error, InputError):
        assert "root" not in result.reason and "shadow" not in result.reason
        assert "log of the node" in result.reason
    else:
        assert result.reason == str(error)
    assert parameters[Config] is before
    parameters.forget_listeners()
    assert change(node, weight=1.0).successful
