"""The thermal network in torch, and the file that it becomes."""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from shop import write_dataset

from model.network import (
    INPUT_NAMES,
    OPSET,
    OUTPUT_NAMES,
    InputScale,
    Prior,
    Residual,
    ThermalNetwork,
    export_onnx,
    linear_recurrence,
)
from model.parity import PARITY_UM
from model.sensors import SensorModel
from training.dataset import load_dataset
from training.export import parity


def network(*, residual: bool = True, channels: int = 2) -> ThermalNetwork:
    """Return a network with random weights: 3 sensors, one channel that turns and one that is on or off."""
    torch.manual_seed(3)
    scale = InputScale([20.0, 21.0, 22.0], 3.0, [8000.0, 1.0][:channels], [False, True][:channels])
    net = ThermalNetwork(scale, Prior(), coefficients=5)
    with torch.no_grad():
        net.linear.copy_(10.0 * torch.randn_like(net.linear))
        net.bias.copy_(torch.randn_like(net.bias))
    if residual:
        down = torch.randn(net.linear.shape[0], 4, dtype=torch.float64) / 10.0
        net.residual = Residual(down, torch.randn(2, 5, dtype=torch.float64), hidden=6)
        torch.nn.init.normal_(net.residual.leave.weight)
    return net


def telemetry(steps: int, channels: int = 2, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return raw inputs (T, S + C) and irregular steps (T,)."""
    rng = np.random.default_rng(seed)
    temperatures = 20.0 + np.cumsum(rng.normal(0, 0.5, (steps, 3)), axis=0)
    extra = np.stack([rng.choice([0.0, 3000.0, 8000.0], steps), rng.choice([0.0, 1.0], steps)], axis=1)[:, :channels]
    dt_s = np.exp(rng.uniform(np.log(0.1), np.log(7200.0), steps))
    dt_s[0] = 0.0
    return np.concatenate([temperatures, extra], axis=1), dt_s


def whole(net: ThermalNetwork, inputs: np.ndarray, dt_s: np.ndarray) -> np.ndarray:
    with torch.no_grad():
        return net.decode(net.sequence(torch.tensor(inputs[None]), torch.tensor(dt_s[None])))[0].numpy()


def walked(session: onnxruntime.InferenceSession, modes: int, inputs: np.ndarray, dt_s: np.ndarray) -> np.ndarray:
    state, previous, out = np.zeros((1, modes)), inputs[:1], []
    for t in range(len(inputs)):
        fed = (inputs[t : t + 1], previous, state, dt_s[t].reshape(1, 1), np.full((1, 1), float(t == 0)))
        state, coefficients = session.run(None, dict(zip(INPUT_NAMES, fed, strict=True)))
        previous = inputs[t : t + 1]
        out.append(coefficients[0])
    return np.array(out)


@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("channels", [0, 1, 2])
def test_the_exported_step_agrees_with_torch_over_a_day_of_irregular_steps(residual: bool, channels: int) -> None:
    net = network(residual=residual, channels=channels)
    inputs, dt_s = telemetry(400, channels)
    session = onnxruntime.InferenceSession(export_onnx(net))
    np.testing.assert_allclose(walked(session, net.modes, inputs, dt_s), whole(net, inputs, dt_s), atol=1e-6)


def test_the_exported_graph_says_what_it_takes_in_double_precision_at_any_batch_size() -> None:
    net = network()
    exported = export_onnx(net)
    session = onnxruntime.InferenceSession(exported)
    assert [i.name for i in session.get_inputs()] == list(INPUT_NAMES)
    assert [o.name for o in session.get_outputs()] == list(OUTPUT_NAMES)
    assert {i.type for i in session.get_inputs()} == {"tensor(double)"}
    assert [i.shape[1] for i in session.get_inputs()] == [5, 5, net.modes, 1, 1]
    assert onnx.load_model_from_string(exported).opset_import[0].version == OPSET
    for batch in (1, 2, 7):
        fed = {i.name: np.ones((batch, i.shape[1])) for i in session.get_inputs()}
        assert [o.shape for o in session.run(None, fed)] == [(batch, net.modes), (batch, 5)]


def test_parity_notices_another_network(tmp_path: Path) -> None:
    dataset = load_dataset(write_dataset(tmp_path / "d", 1))
    scale = InputScale([20.0, 20.0], 1.0, [9000.0], [False])
    net = ThermalNetwork(scale, Prior(), coefficients=3)
    with torch.no_grad():
        net.linear.normal_()
    exported = export_onnx(net)
    sensors = SensorModel.fit(dataset.runs["r0"].telemetry.temperatures)
    assert parity(net, exported, dataset, sensors) < PARITY_UM
    with torch.no_grad():
        net.linear[0, 0] += 0.1
    assert parity(net, exported, dataset, sensors) > PARITY_UM


def test_sweeps_are_the_loop() -> None:
    torch.manual_seed(0)
    for length in (1, 2, 7, 64, 65):
        a, b = torch.rand(2, length, 3, dtype=torch.float64), torch.randn(2, length, 3, dtype=torch.float64)
        h, expected = torch.zeros(2, 3, dtype=torch.float64), []
        for t in range(length):
            h = b[:, t] if t == 0 else a[:, t] * h + b[:, t]
            expected.append(h)
        torch.testing.assert_close(linear_recurrence(a, b), torch.stack(expected, dim=1))


def test_modes_relax_exponentially_towards_a_held_drive() -> None:
    net = network(residual=False)
    drive = torch.tensor([[[0.0] * 8, [1.0] * 8, [1.0] * 8]], dtype=torch.float64)
    assert drive.shape[-1] >= len(net.warm)
    drive = drive[..., : len(net.warm)]
    for t in (1.0, 60.0, 1e4):
        a, before, now = net.transition(torch.tensor(t, dtype=torch.float64))
        h = before * 1.0 + now * 1.0 + a * 0.0
        torch.testing.assert_close(h, 1.0 - torch.exp(-t / net.tau_s))
        torch.testing.assert_close(a + before + now, torch.ones_like(a))  # a constant stays what it is


def test_a_longer_step_is_two_shorter_ones_along_a_ramp() -> None:
    net = network(residual=False)
    inputs = np.array([[20.0, 20.0, 20.0, 0.0, 0.0], [22.0, 21.0, 20.0, 0.0, 0.0], [26.0, 23.0, 20.0, 0.0, 0.0]])
    two = whole(net, inputs, np.array([0.0, 100.0, 200.0]))[-1]
    one = whole(net, inputs[[0, 2]], np.array([0.0, 300.0]))[-1]
    np.testing.assert_allclose(two, one, atol=1e-9)


def test_a_machine_at_its_reference_temperature_stands_still() -> None:
    net = network(residual=False)
    still = np.tile([20.0, 21.0, 22.0, 0.0, 0.0], (5, 1))
    out = whole(net, still, np.full(5, 600.0))
    np.testing.assert_allclose(out, np.tile(net.bias.detach().numpy(), (5, 1)), atol=1e-12)


def test_a_channel_that_is_on_or_off_is_one_source_and_a_speed_several() -> None:
    net = network()
    assert len(net.warm) == 3 + 4 + 1
    drive = net.drive(torch.tensor([20.0, 21.0, 22.0, 4000.0, 1.0], dtype=torch.float64))
    torch.testing.assert_close(
        torch.sort(drive[3:])[0], torch.tensor([0.25, 0.5**1.5, 0.5, 0.5**0.5, 1.0], dtype=torch.float64)
    )


def test_a_row_of_a_batch_is_what_it_is_alone() -> None:
    net = network()
    session = onnxruntime.InferenceSession(export_onnx(net))
    rng = np.random.default_rng(5)
    for batch in (2, 7, 1000):
        inputs, previous = (telemetry(batch, seed=s)[0] for s in (1, 2))
        modes = rng.normal(0.0, 1.0, (batch, net.modes))
        dt_s, fresh = rng.uniform(0.1, 7200.0, (batch, 1)), rng.integers(0, 2, (batch, 1)).astype(float)
        fed = dict(zip(INPUT_NAMES, (inputs, previous, modes, dt_s, fresh), strict=True))
        together = session.run(None, fed)
        for row in rng.integers(0, batch, 5):
            alone = session.run(None, {name: values[row : row + 1] for name, values in fed.items()})
            for one, all_of_them in zip(alone, together, strict=True):
                np.testing.assert_allclose(one[0], all_of_them[row], rtol=1e-12, atol=1e-9)
