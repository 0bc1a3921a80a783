from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace

import numpy as np
import pytest
from scipy.integrate import simpson

from data_synth import siblings
from data_synth.heat import FeedSource, PowerLaw, StrokeSource
from data_synth.machines import DESIGNS, open_shop
from data_synth.network import REST, OperatingPoint
from data_synth.run import simulate
from data_synth.siblings import described, sibling, unruled
from data_synth.tip import tip_deviation
from data_synth.variation import FURTHEST, SPREADS, Lot
from model.exceptions import InputError
from model.machine import load_machine, parse_machine, preset

ANGLES = slice(3, 6)
BUSY = OperatingPoint(speed=0.5, coolant=True, door=True, moving=True)
EVERY = pytest.mark.parametrize("name", DESIGNS)


def parts(value, kind):
    """Give every part of a design that is of this kind, in order."""
    if isinstance(value, kind):
        yield value
    inside = [getattr(value, f.name) for f in fields(value)] if is_dataclass(value) else value
    if is_dataclass(value) or isinstance(value, Mapping | tuple):
        for one in inside.values() if isinstance(inside, Mapping) else inside:
            yield from parts(one, kind)


def shares(design):
    """Return the sums of all shares of heat and of thermometers."""
    onto = [source.onto for source in design.sources if hasattr(source, "onto")]
    return np.array([sum(m.values()) for m in (*onto, *(t.at for t in design.thermometers.values()))])


@EVERY
def test_sibling_0_is_the_design(name):
    assert sibling(DESIGNS[name], 0) is DESIGNS[name]


@EVERY
def test_a_sibling_is_a_function_of_design_and_number(name):
    design = DESIGNS[name]
    assert sibling(design, 7) == sibling(design, 7)
    others = [sibling(design, k) for k in (0, 1, 2)]
    for get in (
        lambda d: d.network.capacity(),
        lambda d: d.network.conductances(REST)[0],
        lambda d: np.array([law.W for law in parts(d.sources, PowerLaw)]),
        lambda d: np.array([t.lag_s for t in d.thermometers.values()]),
    ):
        for a, b in ((0, 1), (0, 2), (1, 2)):
            assert (get(others[a]) != get(others[b])).any()


def test_two_designs_with_one_number_are_drawn_apart():
    vmc3 = DESIGNS["vmc3"]
    twin = replace(vmc3, name="another")
    assert (sibling(vmc3, 1).network.capacity() != sibling(twin, 1).network.capacity()).all()


@EVERY
def test_what_a_network_is_trained_on_stays(name):
    design, other = DESIGNS[name], sibling(DESIGNS[name], 3)
    assert other.name == f"{name}-3"
    assert other.network.nodes == design.network.nodes
    assert other.network.boundaries == design.network.boundaries
    assert [(k.a, k.b) for k in other.network.links] == [(k.a, k.b) for k in design.network.links]
    assert list(other.thermometers) == list(design.thermometers)
    assert other.capability == design.capability
    one, two = open_shop(name), open_shop(f"{name}~3")
    assert two.machine.name == f"{name}-3"
    for what in ("composition", "bodies", "axes", "terms", "sensors", "limits"):
        assert getattr(one.machine, what) == getattr(two.machine, what)


@EVERY
@pytest.mark.parametrize("number", [1, 2])
def test_physical_limits_hold(name, number):
    design, other = DESIGNS[name], sibling(DESIGNS[name], number)
    np.testing.assert_allclose(shares(other), shares(design))
    known = {*design.network.nodes, *design.network.boundaries}
    for thermometer in other.thermometers.values():
        assert set(thermometer.at) <= known
        assert min(thermometer.at.values()) > 0.0
    before, after = (np.array([k.W_per_K for k in d.network.links]) for d in (design, other))
    assert (after > 0.0).all()
    assert np.abs(np.log(after / before)).max() <= FURTHEST * SPREADS["contacts"] + 1e-12
    for was, now in zip(parts(design, StrokeSource), parts(other, StrokeSource), strict=True):
        assert now.share == was.share
        assert 0.0 <= now.screw.held < 1.0
        assert (now.screw.held == 0.0) == (was.screw.held == 0.0)
    for film in {link.film for link in other.network.links}:
        assert all(film.factor(point) >= 0.0 for point in (REST, BUSY))


@EVERY
def test_what_parts_share_they_go_on_sharing(name):
    """The screw that the nut warms is the screw that moves the axis."""
    other = sibling(DESIGNS[name], 5)
    moving = [drive for joint in other.structure.joints.values() for drive in getattr(joint, "drives", ())]
    for source in parts(other.sources, StrokeSource):
        assert any(source.screw is drive for drive in moving)


@EVERY
@pytest.mark.parametrize("number", [1, 2])
def test_a_uniform_rise_still_turns_nothing(name, number):
    shop = open_shop(f"{name}~{number}")
    got = shop.fields.evaluate(np.ones((1, len(shop.design.network.nodes))), np.zeros(1))
    for values in (*got.motion.values(), *got.location.values()):
        np.testing.assert_allclose(values[:, ANGLES], 0.0, atol=1e-9)


@EVERY
def test_heat_in_is_still_heat_stored_and_heat_out(name):
    network = sibling(DESIGNS[name], 4).network
    rng = np.random.default_rng(0)
    n, nodes = 360, len(network.nodes)
    power, boundary = rng.uniform(0.0, 200.0, nodes), rng.uniform(15.0, 25.0, len(network.boundaries))
    held = np.zeros(n, dtype=np.intp), np.tile(power, (n, 1)), np.tile(boundary, (n, 1)), 5.0
    got = network.run(np.full(nodes, 20.0), [BUSY], *held)
    out = simpson(((got[:, :, None] - boundary) * network.conductances(BUSY)[1]).sum(axis=(1, 2)), dx=5.0)
    stored = network.capacity() @ (got[-1] - got[0])
    np.testing.assert_allclose(stored + out, 5.0 * n * power.sum(), rtol=1e-5)
    still = network.steady(BUSY, np.zeros(nodes), np.full(len(network.boundaries), 23.0))
    np.testing.assert_allclose(still, 23.0, rtol=1e-11)


def test_a_sibling_does_not_inherit_steps_already_worked_out():
    design = DESIGNS["vmc3"]
    base = design.network.step(REST, 60.0)
    assert np.abs(sibling(design, 1).network.step(REST, 60.0).decay - base.decay).max() > 1e-4


@pytest.mark.parametrize("kind", ["masses", "contacts", "exponents"])
def test_factors_spread_as_stated(kind):
    lot = Lot("vmc3", 1, DESIGNS["vmc3"].network)
    z = np.log([lot.factor(f"key {k}", kind) for k in range(4000)]) / SPREADS[kind]
    assert np.std(z) == pytest.approx(1.0, rel=0.05)
    assert np.median(z) == pytest.approx(0.0, abs=0.06)
    assert np.abs(z).max() <= FURTHEST + 1e-9


@pytest.mark.parametrize("name", ["vmc3", "gantry3"])
def test_siblings_drift_alike_but_not_the_same(name):
    """As machines of one series: some tens of per cent, never another order of magnitude."""

    def path(number):
        shop = open_shop(f"{name}~{number}")
        got = tip_deviation(shop.machine, simulate(shop, "r00_shop", "shop", (5, 0), 6.0).terms)
        return got - got[:1]

    base = path(0)
    size = np.sqrt(np.mean(base**2))
    others = [path(number) for number in range(1, 6)]
    ratios = np.array([np.sqrt(np.mean(other**2)) for other in others]) / size
    apart = np.array([np.sqrt(np.mean((other - base) ** 2)) for other in others]) / size
    assert ((ratios > 1 / 3) & (ratios < 3.0)).all()
    assert 0.03 < np.median(apart) < 0.6


@pytest.mark.parametrize("written", ["vmc3~3", "vmc3-3"])
def test_a_sibling_opens_by_name_and_by_its_own_description(tmp_path, written):
    shop = open_shop(written)
    assert shop.design == sibling(DESIGNS["vmc3"], 3)
    (tmp_path / "machine.toml").write_text(shop.machine.source)
    for place in (tmp_path, tmp_path / "machine.toml"):
        again = open_shop(str(place))
        assert again.machine == shop.machine
        assert again.design == shop.design


def test_a_siblings_description_differs_by_its_name_alone():
    text = open_shop("vmc3~3").machine.source
    assert text.replace('name = "vmc3-3"', 'name = "vmc3"') == preset("vmc3").read_text()
    assert open_shop("vmc3~0").machine == load_machine(preset("vmc3"))
    assert parse_machine(text).name == "vmc3-3"


@pytest.mark.parametrize("number", ["-1", "x", "", "1000000", "1.5"])
def test_a_siblings_number_is_a_whole_number(number):
    with pytest.raises(InputError, match=f"the number of a sibling of 'vmc3' must be from 0 to 999999, got '{number}'"):
        open_shop(f"vmc3~{number}")


def test_a_negative_number_is_no_sibling():
    with pytest.raises(InputError, match="the number of a sibling of 'vmc3' must be from 0 to 999999, got -2"):
        sibling(DESIGNS["vmc3"], -2)


@pytest.mark.parametrize("name", ["vmc9~3", "vmc9-3", "vmc3-0", "vmc3-03", "vmc3-x"])
def test_a_sibling_of_no_design_is_unknown(name):
    with pytest.raises(InputError, match=f"machine '{name}' must have a thermal design"):
        open_shop(name)


@EVERY
def test_every_number_of_a_design_has_its_rule(name):
    assert unruled(DESIGNS[name]) == set()


@pytest.mark.parametrize("kind", siblings.RULES)
def test_rules_are_for_fields_that_there_are(kind):
    assert set(siblings.RULES[kind]) <= {field.name for field in fields(kind)}


def test_a_number_without_a_rule_is_found_and_stays():
    @dataclass(frozen=True)
    class Lamp:
        onto: Mapping[str, float]
        W: float

    design = replace(
        DESIGNS["vmc3"], sources=(Lamp({"motor": 1.0}, 60.0), FeedSource("X", PowerLaw(1.0, 1.0, 1.0), {}))
    )
    assert unruled(design) == {"Lamp.W", "Lamp.onto"}
    lamp, feed = sibling(design, 1).sources
    assert lamp == design.sources[0]
    assert feed.law.W != 1.0


def test_the_card_can_say_how_far_a_sibling_is_varied():
    text = described("vmc3", 3)
    assert text.startswith("Sibling 3 of vmc3")
    for kind, spread in SPREADS.items():
        assert f"{kind} {100 * spread:g} %" in text
