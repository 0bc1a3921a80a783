"""A look into an ONNX file before it is loaded: a network here is a plain sequence of operators, and nothing else.

A file of the format may also hold loops, operators of other makers, functions and the names of further files to read.
None of these belongs into a bundle, so none is given to the runtime. Only as much of protobuf's wire format is read
as that takes.
"""

from __future__ import annotations

from collections.abc import Iterator

from model.exceptions import BundleError

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
"""Wire types."""
MODEL_GRAPH, MODEL_FUNCTIONS = 7, 25
GRAPH_NODE, GRAPH_INITIALIZER = 1, 5
NODE_OPERATOR, NODE_ATTRIBUTE, NODE_DOMAIN = 4, 5, 7
ATTRIBUTE_TENSOR, ATTRIBUTE_GRAPH, ATTRIBUTE_GRAPHS = 5, 6, 11
TENSOR_EXTERNAL, TENSOR_LOCATION = 13, 14
"""Fields of onnx.proto, version 1 of the format."""


def check_network_file(content: bytes, where: str) -> None:
    """Check that an ONNX file holds operators of the standard and their constants alone.

    Raises
    ------
    BundleError
        where it is no such file; `where` names the bundle in it.
    """
    try:
        found = _foreign(memoryview(content))
    except (IndexError, ValueError, UnicodeDecodeError):
        raise BundleError(f"{where}: network.onnx cannot be loaded: it is not a protobuf message") from None
    if found is not None:
        raise BundleError(f"{where}: network.onnx must be a plain sequence of operators, got {found}; export it again")


def _foreign(content: memoryview) -> str | None:
    """Return the first thing that does not belong into it."""
    graphs = 0
    for field, value in _fields(content):
        if field == MODEL_FUNCTIONS:
            return "functions of its own"
        if field == MODEL_GRAPH:
            graphs += 1
            found = _in_graph(_message(value))
            if found is not None:
                return found
    return None if graphs == 1 else f"{graphs} graphs"


def _in_graph(content: memoryview) -> str | None:
    for field, value in _fields(content):
        found = None
        if field == GRAPH_NODE:
            found = _in_node(_message(value))
        elif field == GRAPH_INITIALIZER:
            found = _in_tensor(_message(value))
        if found is not None:
            return found
    return None


def _in_node(content: memoryview) -> str | None:
    operator, domain, graph, tensor = "", "", False, None
    for field, value in _fields(content):
        if field == NODE_OPERATOR:
            operator = bytes(_message(value)).decode()
        elif field == NODE_DOMAIN:
            domain = bytes(_message(value)).decode()
        elif field == NODE_ATTRIBUTE:
            for inner, part in _fields(_message(value)):
                graph = graph or inner in (ATTRIBUTE_GRAPH, ATTRIBUTE_GRAPHS)
                if inner == ATTRIBUTE_TENSOR:
                    tensor = tensor or _in_tensor(_message(part))
    if domain not in ("", "ai.onnx"):
        return f"the operator {operator[:32]!r} of {domain[:32]!r}"
    return f"a graph within the operator {operator[:32]!r}" if graph else tensor


def _in_tensor(content: memoryview) -> str | None:
    for field, value in _fields(content):
        if field == TENSOR_EXTERNAL or (field == TENSOR_LOCATION and value != 0):
            return "constants in another file"
    return None


def _message(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise ValueError("a number where a message should be")
    return value


def _fields(content: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield a message's fields: number, and a number or bytes."""
    at = 0
    while at < len(content):
        key, at = _varint(content, at)
        kind = key & 7
        if kind == VARINT:
            value, at = _varint(content, at)
            yield key >> 3, value
            continue
        if kind == BYTES:
            size, at = _varint(content, at)
        elif kind in (FIXED64, FIXED32):
            size = 8 if kind == FIXED64 else 4
        else:
            raise ValueError("a wire type that does not exist")
        if at + size > len(content):
            raise ValueError("it ends too early")
        yield key >> 3, content[at : at + size]
        at += size


def _varint(content: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = content[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise ValueError("a number of more than ten bytes")
