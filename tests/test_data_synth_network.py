import numpy as np
import pytest
from scipy.integrate import simpson

from data_synth.machines import DESIGNS
from data_synth.network import REST, Film, Link, Network, OperatingPoint
from data_synth.vmc3 import VMC3

HOUR = 3600.0
BUSY = OperatingPoint(speed=0.5, coolant=True, door=False, moving=True)


@pytest.fixture
def inputs():
    rng = np.random.default_rng(4)
    n = len(VMC3.network.nodes)
    return {
        "start": rng.uniform(18.0, 30.0, n),
        "power": rng.uniform(0.0, 200.0, n),
        "boundary": rng.uniform(15.0, 25.0, len(VMC3.network.boundaries)),
    }


def held(network, start, power, boundary, point, periods, period_s):
    """Run `periods` intervals of the same inputs."""
    return network.run(
        start,
        [point],
        np.zeros(periods, dtype=np.intp),
        np.tile(power, (periods, 1)),
        np.tile(boundary, (periods, 1)),
        period_s,
    )


def test_one_node_cools_as_exp():
    network = Network({"part": 5000.0}, ("air",), (Link("part", "air", 2.0),))
    got = held(network, np.array([50.0]), np.zeros(1), np.array([20.0]), REST, 90, 100.0)
    time = np.arange(91) * 100.0
    np.testing.assert_allclose(got[:, 0], 20.0 + 30.0 * np.exp(-time / 2500.0), rtol=1e-12)


@pytest.mark.parametrize("point", [REST, BUSY])
def test_heat_in_is_heat_stored_and_heat_out(point, inputs):
    network = VMC3.network
    got = held(network, inputs["start"], inputs["power"], inputs["boundary"], point, 720, 5.0)
    _, to_boundary = network.conductances(point)
    lost = (got[:, :, None] - inputs["boundary"]) * to_boundary
    out = simpson(lost.sum(axis=(1, 2)), dx=5.0)
    stored = network.capacity() @ (got[-1] - got[0])
    np.testing.assert_allclose(stored + out, inputs["power"].sum() * HOUR, rtol=1e-6)


def test_halving_the_step_changes_nothing(inputs):
    given = inputs["start"], inputs["power"], inputs["boundary"], BUSY
    whole = held(VMC3.network, *given, 60, 60.0)
    halves = held(VMC3.network, *given, 120, 30.0)
    np.testing.assert_allclose(halves[::2], whole, rtol=1e-11)


def test_a_long_run_ends_in_the_steady_state(inputs):
    given = inputs["power"], inputs["boundary"]
    long = held(VMC3.network, inputs["start"], *given, BUSY, 300, 6 * HOUR)
    np.testing.assert_allclose(long[-1], VMC3.network.steady(BUSY, *given), rtol=1e-9)


def test_without_heat_everything_takes_the_temperature_around():
    network = VMC3.network
    around = np.full(len(network.boundaries), 23.0)
    np.testing.assert_allclose(network.steady(BUSY, np.zeros(len(network.nodes)), around), 23.0, rtol=1e-12)


def test_a_heated_rod_is_the_analytic_fin():
    """θ(s) = θ0 cosh(m (L - s)) / cosh(m L), m² = h girth / (k A): steady fin, insulated tip."""
    n, length, k, area, girth, film = 200, 1.0, 45.0, 1.26e-3, 0.126, 20.0
    along, around = k * area / (length / n), film * girth * length / n
    nodes = {f"s{i}": 40.0 for i in range(n)}
    links = [Link(f"s{i}", f"s{i + 1}", along) for i in range(n - 1)]
    links += [Link(name, "air", around) for name in nodes] + [Link("s0", "hot", 2 * along)]
    got = Network(nodes, ("air", "hot"), tuple(links)).steady(REST, np.zeros(n), np.array([20.0, 60.0]))
    m, s = np.sqrt(film * girth / (k * area)), (np.arange(n) + 0.5) / n
    np.testing.assert_allclose(got, 20.0 + 40.0 * np.cosh(m * (length - s)) / np.cosh(m * length), atol=0.01)


def test_a_film_grows_with_speed_to_two_thirds():
    film = Film(spindle=4.0)
    added = [film.factor(OperatingPoint(speed=speed)) - 1.0 for speed in (0.125, 1.0)]
    assert added[1] / added[0] == pytest.approx(4.0)


@pytest.mark.parametrize("name", tuple(DESIGNS))
def test_every_node_reaches_the_air(name):
    between, to_boundary = DESIGNS[name].network.conductances(REST)
    assert np.linalg.eigvalsh(between).min() > 0.0
    np.testing.assert_allclose(between.sum(axis=1), to_boundary.sum(axis=1), atol=1e-9)
    np.testing.assert_allclose(between, between.T)
    assert DESIGNS[name].network.capacity().min() > 0.0


@pytest.mark.parametrize("name", DESIGNS)
def test_coolant_touches_only_its_tank_until_it_flows(name):
    wetted = [link for link in DESIGNS[name].network.links if link.b == "coolant"]
    assert len(wetted) > 5
    for link in wetted:
        assert link.film.factor(REST) == 0.0, link
        assert link.film.factor(OperatingPoint(coolant=True)) > 0.0, link
