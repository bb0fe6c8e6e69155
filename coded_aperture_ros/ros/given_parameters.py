"""Parameters that a node was given under names that it does not have."""

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import yaml
from rclpy.node import Node

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.yaml_file import read_yaml

_VALUES = "ros__parameters"
# Of every node of ROS.
_OF_ROS = re.compile(r"use_sim_time|start_type_description_service|qos_overrides\..*")
# Of all nodes: before the name there may be that of one.
_FOR_ALL = re.compile(r"([^:=]+):=.*", re.DOTALL)
_LEAST_LIKENESS = 0.7


def unused_parameters(
    node: Node, arguments: Sequence[str], shares_arguments: bool = False
) -> Iterator[str]:
    """Yield a line about each parameter, and each parameter file, that has no effect on a node.

    Parameters
    ----------
    node : Node
        Its parameters are declared.
    arguments : sequence of str
        Of the program.
    shares_arguments : bool, optional
        Whether the program has other nodes, for which its arguments may be. These, like a
        parameter for all nodes in a file, count only if the name is nearly one of this node's.

    Yields
    ------
    str
    """
    files = dict(_files(arguments))
    name = node.get_fully_qualified_name()
    for_others = {
        parameter
        for sections in files.values()
        for pattern, parameters in sections.items()
        if pattern.endswith("*")
        for parameter in parameters
    }
    if shares_arguments:
        for_others |= set(_assigned(arguments))
    given: Mapping[str, Any] = getattr(node, "_parameter_overrides", {})  # rclpy has no other way
    own = [one for one in node.get_parameters_by_prefix("") if not _OF_ROS.fullmatch(one)]
    for parameter in given:
        if node.has_parameter(parameter) or _OF_ROS.fullmatch(parameter):
            continue
        likely = difflib.get_close_matches(parameter, own, 1, _LEAST_LIKENESS)
        if likely:
            yield f"parameter {parameter} is not known and not used: did you mean {likely[0]}?"
        elif parameter not in for_others:
            yield f"parameter {parameter} is not known and not used: see ros2 param list {name}"
    for path, sections in files.items():
        if sections and not any(_matches(pattern, name) for pattern in sections):
            names = {pattern.rpartition("/")[2]: pattern for pattern in sections}
            likely = difflib.get_close_matches(node.get_name(), names, 1, _LEAST_LIKENESS)
            hint = (
                f"did you mean {name} by {names[likely[0]]}?" if likely else "nothing of it is used"
            )
            yield f"{path} has no parameters for {name}, only for {', '.join(sections)}: {hint}"


def _files(arguments: Sequence[str]) -> Iterator[tuple[str, dict[str, dict[str, Any]]]]:
    """Yield each parameter file with the parameters of its sections, by the nodes' pattern."""
    for option, path in pairwise(arguments):
        if option == "--params-file":
            try:
                yield path, dict(_sections(read_yaml(path, path)))
            except (InputError, yaml.YAMLError):
                continue  # ROS itself has read it, and knows more of YAML than this


def _sections(content: Any, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    if not isinstance(content, Mapping):
        return
    for key, value in content.items():
        if key == _VALUES and isinstance(value, Mapping):
            yield path, dict(_flat(value))
        else:
            yield from _sections(value, f"{path}/{str(key).strip('/')}")


def _flat(values: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _assigned(arguments: Sequence[str]) -> Iterator[str]:
    """Yield the names in `-p NAME:=VALUE` that are for all nodes."""
    for option, assigned in pairwise(arguments):
        if option in ("-p", "--param") and (match := _FOR_ALL.fullmatch(assigned)):
            yield match[1]


def _matches(pattern: str, name: str) -> bool:
    """Whether a node's name with its namespace is one of those that a section is for."""
    parts = [
        {"**": ".*", "*": "[^/]+"}.get(part, re.escape(part)) for part in pattern.split("/") if part
    ]
    # `/**/node` is for a node without a namespace, too.
    expression = "/" + "/".join(parts)
    return re.fullmatch(expression.replace("/.*", "(/.*)?"), name) is not None
