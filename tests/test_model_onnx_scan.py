"""A network's file holds operators and constants, and nothing that runs or reads anything else."""

from collections.abc import Callable
from pathlib import Path

import onnx
import pytest
from onnx import TensorProto, helper

from model.exceptions import BundleError
from model.onnx_scan import check_network_file

ROOT = Path(__file__).parent.parent
NETWORK = (Path(__file__).parent / "data" / "tiny_bundle" / "network.onnx").read_bytes()


@pytest.mark.parametrize("folder", ["tests/data/tiny_bundle", "demo/vmc3"])
def test_our_own_networks_pass(folder: str) -> None:
    check_network_file((ROOT / folder / "network.onnx").read_bytes(), "here")


def external(network: onnx.ModelProto) -> None:
    tensor = network.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")


def external_attribute(network: onnx.ModelProto) -> None:
    tensor = helper.make_tensor("x", TensorProto.DOUBLE, [1], [0.0])
    tensor.external_data.add(key="location", value="secrets")
    network.graph.node.append(helper.make_node("Constant", [], ["x"], value=tensor))


def loop(network: onnx.ModelProto) -> None:
    body = helper.make_graph([], "body", [], [])
    network.graph.node.append(helper.make_node("Loop", ["", ""], ["x"], body=body))


def operator(network: onnx.ModelProto) -> None:
    network.graph.node.append(helper.make_node("Run", [], ["x"], domain="com.example"))


def function(network: onnx.ModelProto) -> None:
    network.functions.append(helper.make_function("mine", "f", [], [], [], []))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (external, "constants in another file"),
        (external_attribute, "constants in another file"),
        (loop, "a graph within the operator 'Loop'"),
        (operator, "the operator 'Run' of 'com.example'"),
        (function, "functions of its own"),
        (lambda n: n.ClearField("graph"), "0 graphs"),
    ],
)
def test_what_does_not_belong_into_it_is_refused(change: Callable[[onnx.ModelProto], None], what: str) -> None:
    network = onnx.load_from_string(NETWORK)
    change(network)
    with pytest.raises(BundleError, match=f"here: network.onnx must be a plain sequence of operators, got {what}"):
        check_network_file(network.SerializeToString(), "here")


@pytest.mark.parametrize("content", [b"\x08", b"\x3a\xff\x01", b"\x3f", b"\xff" * 20, b"\x38\x01", NETWORK[:-1]])
def test_what_is_no_message_is_said_so(content: bytes) -> None:
    with pytest.raises(BundleError, match="here: network.onnx cannot be loaded: it is not a protobuf message"):
        check_network_file(content, "here")
