"""Reader of networks in ONNX form, without the package onnx: nodes and weights.

A file is a protocol buffer: fields of a number, each a whole number, four or eight bytes, or bytes
that may be a message again. Only what the networks that ship consist of is read.
"""

import dataclasses
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Numbers of the fields of onnx.proto3.
_MODEL_GRAPH = 7
_GRAPH_NODE, _GRAPH_WEIGHTS, _GRAPH_OUTPUT = 1, 5, 12
_NODE_INPUT, _NODE_OUTPUT, _NODE_KIND, _NODE_ATTRIBUTE = 1, 2, 4, 5
_ATTRIBUTE_NAME, _ATTRIBUTE_FLOAT, _ATTRIBUTE_INTEGER, _ATTRIBUTE_TENSOR = 1, 2, 3, 5
_ATTRIBUTE_INTEGERS = 8
_TENSOR_SHAPE, _TENSOR_TYPE, _TENSOR_NAME, _TENSOR_DATA = 1, 2, 8, 9
_OUTPUT_NAME = 1
# Types of a tensor's elements.
_TYPES = {1: "<f4", 7: "<i8"}
# Types of a field.
_VARINT, _EIGHT_BYTES, _BYTES, _FOUR_BYTES = 0, 1, 2, 5

_Message = dict[int, list[Any]]


@dataclasses.dataclass(frozen=True)
class Node:
    """A layer: kind, names of inputs and outputs, and attributes by name."""

    kind: str
    inputs: tuple[str, ...]
    output: str
    attributes: dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Graph:
    """Nodes in the order in which they run, arrays by name, and the name of the output."""

    nodes: tuple[Node, ...]
    weights: dict[str, NDArray[Any]]
    output: str

    @classmethod
    def from_bytes(cls, data: bytes) -> "Graph":
        """Graph of a network in ONNX form."""
        graph = _message(_message(data)[_MODEL_GRAPH][0])
        arrays = [_message(each) for each in graph.get(_GRAPH_WEIGHTS, [])]
        weights = {_text(each[_TENSOR_NAME][0]): _array(each) for each in arrays}
        nodes = [_node(_message(each)) for each in graph[_GRAPH_NODE]]
        constants = {node.output: node.attributes["value"] for node in nodes if _is_constant(node)}
        return cls(
            tuple(node for node in nodes if not _is_constant(node)),
            weights | constants,
            _text(_message(graph[_GRAPH_OUTPUT][0])[_OUTPUT_NAME][0]),
        )


def _is_constant(node: Node) -> bool:
    return node.kind == "Constant"


def _node(fields: _Message) -> Node:
    attributes = (_attribute(_message(each)) for each in fields.get(_NODE_ATTRIBUTE, []))
    return Node(
        _text(fields[_NODE_KIND][0]),
        tuple(_text(each) for each in fields.get(_NODE_INPUT, [])),
        _text(fields[_NODE_OUTPUT][0]),
        dict(attributes),
    )


def _attribute(fields: _Message) -> tuple[str, Any]:
    name = _text(fields[_ATTRIBUTE_NAME][0])
    if _ATTRIBUTE_TENSOR in fields:
        return name, _array(_message(fields[_ATTRIBUTE_TENSOR][0]))
    if _ATTRIBUTE_INTEGERS in fields:
        return name, _integers(fields[_ATTRIBUTE_INTEGERS])
    if _ATTRIBUTE_INTEGER in fields:
        return name, fields[_ATTRIBUTE_INTEGER][0]
    if _ATTRIBUTE_FLOAT in fields:
        return name, struct.unpack("<f", fields[_ATTRIBUTE_FLOAT][0])[0]
    return name, None  # text, which no layer needs


def _array(fields: _Message) -> NDArray[Any]:
    shape = _integers(fields.get(_TENSOR_SHAPE, []))
    data = fields.get(_TENSOR_DATA, [b""])[0]
    return np.frombuffer(data, _TYPES[fields[_TENSOR_TYPE][0]]).reshape(shape)


def _integers(values: list[Any]) -> list[int]:
    """Whole numbers, each by itself or some packed together."""
    found: list[int] = []
    for value in values:
        found += [value] if isinstance(value, int) else _packed(value)
    return found


def _packed(data: bytes) -> list[int]:
    found, at = [], 0
    while at < len(data):
        value, at = _varint(data, at)
        found.append(value)
    return found


def _text(data: bytes) -> str:
    return data.decode()


def _message(data: bytes) -> _Message:
    """Values of a message's fields, by number."""
    found: _Message = {}
    for number, value in _fields(data):
        found.setdefault(number, []).append(value)
    return found


def _fields(data: bytes) -> Iterator[tuple[int, Any]]:
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        kind = key & 7
        value: Any
        if kind == _VARINT:
            value, at = _varint(data, at)
        elif kind in (_EIGHT_BYTES, _FOUR_BYTES, _BYTES):
            length = {_EIGHT_BYTES: 8, _FOUR_BYTES: 4}.get(kind)
            if length is None:
                length, at = _varint(data, at)
            value = data[at : at + length]
            at += length
        else:
            raise ValueError(f"no ONNX form: a field of type {kind}")
        yield key >> 3, value


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Whole number of seven bits a byte, and where the next field begins."""
    value, shift = 0, 0
    while True:
        byte = data[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
