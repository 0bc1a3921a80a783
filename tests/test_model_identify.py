import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from machines import FIVE_AXIS, five_axis_text, machine_text

from model.budget import spread
from model.chain import Chain
from model.cli_identify import identify as command
from model.compensation import compensate
from model.error_map import ErrorMap
from model.error_tables import read_error_table
from model.exceptions import DataError, InputError
from model.fields import Fields
from model.identify import design_matrix, identify
from model.least_squares import LeastSquares
from model.machine import Machine, load_machine, parse_machine, preset
from model.measurements import Measurements, read_measurements
from model.tables import write_table
from model.transforms import Array

VMC3 = load_machine(preset("vmc3"))
FIVE = parse_machine(five_axis_text(FIVE_AXIS[0]))
NOISE_UM = 0.3


def all_terms(machine: Machine, degree: int) -> Fields:
    return Fields(machine, tuple(t.name for t in machine.terms), degree)


def measured(
    machine: Machine, fields: Fields, truth: Array, tools: Array, *, n: int = 120, rotations: bool = False
) -> Measurements:
    """Return what the exact chain does at n positions, without noise."""
    q = spread(machine, n)
    chain, e = Chain(machine), fields.evaluate(np.tile(truth, (n, 1)), q)
    six = np.zeros((n, 6))
    tips = tools[np.arange(n) % len(tools)]
    for i in range(n):
        found = chain.deviation(q[i : i + 1], e[i : i + 1], tips[i])
        six[i] = [*found.position_mm[0] * 1e3, *found.orientation_rad[0] * 1e6]
    width = 6 if rotations else 3
    return Measurements(
        q=q,
        tool_mm=tips,
        position=np.repeat(np.arange(n), width),
        functional=np.tile(np.eye(6)[:width], (n, 1)),
        value=six[:, :width].ravel(),
        angular=np.tile(np.arange(width) >= 3, n),
        sigma=np.ones(n * width),
        absolute=False,
    )


ONE_TOOL = np.array([[0.0, 0.0, -120.0]])
TWO_TOOLS = np.array([[0.0, 0.0, -60.0], [0.0, 0.0, -220.0]])


@pytest.mark.parametrize(
    ("machine", "tools", "rotations"), [(VMC3, ONE_TOOL, False), (VMC3, TWO_TOOLS, True), (FIVE, TWO_TOOLS, True)]
)
def test_known_terms_come_back_as_far_as_the_measurement_sees_them(
    machine: Machine, tools: Array, rotations: bool
) -> None:
    """Without noise, up to the chain's second order: 20 µrad over half a metre of 20 µrad more is 0.2 nm."""
    fields = all_terms(machine, 2)
    truth = np.random.default_rng(1).normal(0.0, 10.0, fields.size)
    data = measured(machine, fields, truth, tools, rotations=rotations)
    chain = Chain(machine)
    found = identify(chain, data, fields)
    seen = LeastSquares(design_matrix(chain, data, fields), data.sigma).identifiable_part(truth)
    np.testing.assert_allclose(found.solution.coefficients, seen, atol=0.05)
    assert found.residual_um is not None
    assert found.residual_um < 0.01
    assert (found.residual_urad is not None) == rotations


@pytest.mark.parametrize("machine", [VMC3, FIVE])
def test_deviations_at_fresh_points_agree_even_where_terms_cannot_be_told_apart(machine: Machine) -> None:
    fields, rng = all_terms(machine, 2), np.random.default_rng(2)
    truth = rng.normal(0.0, 10.0, fields.size)
    data = measured(machine, fields, truth, ONE_TOOL, n=200)
    found = identify(Chain(machine), data, fields)
    assert found.ambiguities.count > 20
    q = 0.9 * spread(machine, 500)[200:] + 0.1 * spread(machine, 1)
    true, estimated = (fields.evaluate(np.tile(c, (len(q), 1)), q) for c in (truth, found.solution.coefficients))
    chain = Chain(machine)
    gap = chain.deviation(q, true, ONE_TOOL[0]).position_mm - chain.deviation(q, estimated, ONE_TOOL[0]).position_mm
    assert np.abs(gap).max() < 0.1e-3


def test_standard_errors_cover_the_truth_as_often_as_they_say() -> None:
    """Of 400 repetitions the 95 % interval of each determined coefficient holds the truth in 95 ± 4 %."""
    fields, rng = all_terms(VMC3, 1), np.random.default_rng(3)
    truth = rng.normal(0.0, 10.0, fields.size)
    data = measured(VMC3, fields, truth, TWO_TOOLS, n=60)
    design = design_matrix(Chain(VMC3), data, fields)
    equations = LeastSquares(design, data.sigma)
    known = equations.determined
    assert 5 < known.sum() < fields.size
    scores, spreads = [], []
    for _ in range(400):
        solution = equations.solve(design @ truth + rng.normal(0.0, NOISE_UM, len(data)))
        errors = np.sqrt(np.diag(solution.covariance)[known])
        scores.append((solution.coefficients - truth)[known] / errors)
        spreads.append(solution.spread)
    inside = (np.abs(scores) < 1.96).mean(axis=0)
    assert inside.min() > 0.91
    assert inside.max() < 0.99
    assert np.std(scores) == pytest.approx(1.0, abs=0.03)
    assert np.mean(spreads) == pytest.approx(NOISE_UM, rel=0.01)


@pytest.mark.parametrize(("machine", "tools"), [(VMC3, ONE_TOOL), (VMC3, TWO_TOOLS), (FIVE, ONE_TOOL)])
def test_what_is_called_ambiguous_has_no_effect_and_nothing_is_left_out(machine: Machine, tools: Array) -> None:
    fields = all_terms(machine, 2)
    data = measured(machine, fields, np.zeros(fields.size), tools)
    design = design_matrix(Chain(machine), data, fields)
    scale = np.abs(design).max()
    open_ = identify(Chain(machine), data, fields).ambiguities
    assert open_.count == fields.size - np.linalg.matrix_rank(design, tol=1e-6 * scale)
    changes = []
    for k in open_.unseen:
        changes.append({k: 1.0})
    for group in open_.alike:
        first, *others = group
        changes += [{first: group[k], k: -1.0} for k in others]
    changes += open_.combined
    vectors = np.zeros((len(changes), fields.size))
    for vector, change in zip(vectors, changes, strict=True):
        vector[list(change)] = list(change.values())
    np.testing.assert_allclose(design @ vectors.T, 0.0, atol=1e-4 * scale)
    assert np.linalg.matrix_rank(vectors, tol=1e-6) == open_.count
    for trade in open_.combined:  # none has a member to spare
        members = list(trade)
        assert np.linalg.matrix_rank(design[:, members], tol=1e-6 * scale) == len(members) - 1
        assert len(members) > 2


def test_a_second_tool_length_tells_a_tilt_of_the_tool_holder_from_its_shift() -> None:
    fields = Fields(VMC3, ("EX0T", "EB0T"), 0)
    truth = np.array([5.0, -30.0])
    one = identify(Chain(VMC3), measured(VMC3, fields, truth, ONE_TOOL), fields)
    two = identify(Chain(VMC3), measured(VMC3, fields, truth, TWO_TOOLS), fields)
    assert [c.determined for c in one.coefficients] == [False, False]
    assert one.ambiguities.alike == (pytest.approx({0: 1.0, 1: -0.12}),)  # 1 µrad over 120 mm is 0.12 µm
    assert two.ambiguities.count == 0
    np.testing.assert_allclose(two.solution.coefficients, truth, atol=0.02)


def shown(*args: object, warned: str = "") -> str:
    done = CliRunner().invoke(command, [*map(str, args)], catch_exceptions=False)
    assert done.exit_code == 0
    assert re.search(warned, done.stderr) if warned else done.stderr == ""
    return done.stdout


def write_measured(path: Path, data: Measurements, **columns: object) -> None:
    values = data.value.reshape(len(data.q), -1)
    names = ["dx_um", "dy_um", "dz_um", "da_urad", "db_urad", "dc_urad"][: values.shape[1]]
    axes = {a: data.q[:, i] for i, a in enumerate(VMC3.axis_names)}
    found = {name: values[:, i] for i, name in enumerate(names)}
    write_table(path, {**axes, **found, "tool_length_mm": -data.tool_mm[:, 2], **columns})


FEW = Fields(VMC3, ("EXX", "EBX", "EC0X", "EZ0T"), 2)
TRUTH = np.array([4.0, 12.0, -3.0, 5.0, -8.0, 2.0, 15.0, -7.0])


def test_collinear_terms_are_named(tmp_path: Path) -> None:
    data = measured(VMC3, FEW, TRUTH, ONE_TOOL, n=40)
    write_measured(tmp_path / "m.csv", data)
    text = shown(
        "vmc3", tmp_path / "m.csv", "--out", tmp_path / "o.csv", "--terms", "EXX,X0T,ecz,EC0X,ECY",
        warned="^warning: 6 combinations of coefficients are not determined; the table has the smallest errors",
    )  # fmt: skip
    assert "with the same effect: EXX's constant and EX0T\n" in text
    assert "with the same effect: ECY's constant and EC0X\n" in text
    assert "without effect on the measurement: ECZ\n" in text


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_the_table_it_writes_compensates_the_machine(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(4)
    data = measured(VMC3, FEW, TRUTH, TWO_TOOLS)
    data.value[:] += rng.normal(0.0, NOISE_UM, len(data))
    write_measured(tmp_path / f"m.{suffix}", data)
    text = shown(
        "vmc3", tmp_path / f"m.{suffix}", "--out", tmp_path / "o.csv", "--terms", ",".join(FEW.terms), "--degree", 2
    )
    assert "4 terms written to" in text
    assert "360 measured numbers determine 8 combinations of 8 coefficients" in text
    table = ErrorMap.from_rows(VMC3, read_error_table(tmp_path / "o.csv"))
    chain, q = Chain(VMC3), spread(VMC3, 50)
    corrected = compensate(chain, q, table).corrected
    true = FEW.evaluate(np.tile(TRUTH, (50, 1)), corrected)
    left = np.linalg.norm(chain.tip(corrected, true) - chain.tip(q), axis=1)
    before = np.linalg.norm(chain.deviation(q, FEW.evaluate(np.tile(TRUTH, (50, 1)), q)).position_mm, axis=1)
    assert left.max() < NOISE_UM * 1e-3
    assert before.max() > 10e-3


def test_json_has_values_within_their_standard_errors(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    data = measured(VMC3, FEW, TRUTH, TWO_TOOLS)
    data.value[:] += rng.normal(0.0, NOISE_UM, len(data))
    write_measured(tmp_path / "m.csv", data)
    found = json.loads(
        shown(
            "vmc3",
            tmp_path / "m.csv",
            "--out",
            tmp_path / "o.csv",
            "--terms",
            ",".join(FEW.terms),
            "--degree",
            2,
            "--json",
        )
    )
    values, errors = (np.array([c[key] for c in found["coefficients"]]) for key in ("value", "standard_error"))
    assert [c["term"] for c in found["terms"]] == [*FEW.terms]
    assert (np.abs(values - TRUTH) < 3.5 * errors).all()
    assert found["residual_um"] == pytest.approx(NOISE_UM, rel=0.1)
    assert found["residual_urad"] is None
    assert found["undetermined"] == {"count": 0, "no_effect": [], "same_effect": [], "only_combined": []}
    assert found["terms"][3]["rms"] == pytest.approx(abs(values[7]))
    assert found["terms"][3]["standard_error"] == pytest.approx(errors[7])
    assert found["warnings"] == []


def read_text(folder: Path, text: str) -> Measurements:
    (folder / "m.csv").write_text(text)
    return read_measurements(folder / "m.csv", VMC3)


def test_displacements_along_lines_are_those_in_x_y_z(tmp_path: Path) -> None:
    plain = read_text(tmp_path, "X,Y,Z,dx_um,dy_um,dz_um\n1,2,3,4,5,\n6,7,8,,,9\n")
    lines = read_text(tmp_path, "X,Y,Z,dl_um,nx,ny,nz\n1,2,3,4,2,0,0\n1,2,3,-5,0,-.1,0\n6,7,8,9,0,0,1\n")
    fields = all_terms(VMC3, 1)
    both = [(d.value[:, None] * design_matrix(Chain(VMC3), d, fields)) for d in (plain, lines)]
    np.testing.assert_allclose(*both, atol=1e-12)
    assert len(plain) == 3


def test_an_uncertainty_is_a_weight_of_its_inverse_square_and_an_outlier_can_be_weighed_down(tmp_path: Path) -> None:
    head = "X,Y,Z,dx_um,da_urad,"
    sigma = read_text(tmp_path, head + "sigma_um,sigma_urad\n0,0,0,1,,2,1\n9,0,0,2,7,4,5\n")
    weight = read_text(tmp_path, head + "weight\n0,0,0,1,,.25\n9,0,0,2,7,.0625\n")
    np.testing.assert_allclose(sigma.sigma, [2.0, 4.0, 5.0])
    np.testing.assert_allclose(weight.sigma, [2.0, 4.0, 4.0])
    assert (sigma.absolute, weight.absolute) == (True, False)
    outlier = read_text(tmp_path, "X,Y,Z,dx_um,weight\n1,0,0,3,1\n2,0,0,3,1\n3,0,0,900,1e-12\n")
    found = identify(Chain(VMC3), outlier, Fields(VMC3, ("EX0T",), 0))
    assert found.solution.coefficients[0] == pytest.approx(3.0, abs=1e-6)


def test_an_empty_tool_length_is_the_machines_own(tmp_path: Path) -> None:
    data = read_text(tmp_path, "X,Y,Z,dx_um,tool_length_mm\n1,0,0,3,\n2,0,0,3,80\n")
    np.testing.assert_allclose(data.tool_mm, [VMC3.tool.offset_mm, [0.0, 0.0, -80.0]])


def test_without_spare_measurements_only_stated_uncertainties_give_standard_errors(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("X,Y,Z,dx_um\n400,250,250,3\n")
    args = ("vmc3", tmp_path / "m.csv", "--out", tmp_path / "o.csv", "--terms", "EX0T", "--json")
    found = json.loads(shown(*args, warned="warning: there are no spare measurements, so the residuals say nothing"))
    assert (found["coefficients"][0]["value"], found["coefficients"][0]["standard_error"]) == (pytest.approx(3.0), None)
    assert found["spread"] is None
    (tmp_path / "m.csv").write_text("X,Y,Z,dx_um,sigma_um\n400,250,250,3,.5\n")
    stated = json.loads(shown(*args, warned="no spare"))
    assert stated["coefficients"][0]["standard_error"] == pytest.approx(0.5)


def test_beyond_what_was_measured_the_table_is_constant_and_says_so(tmp_path: Path) -> None:
    lines = [f"{x},250,250,{x / 10}" for x in range(200, 401, 20)]
    (tmp_path / "m.csv").write_text("\n".join(["X,Y,Z,dx_um", *lines, ""]))
    shown(
        "vmc3", tmp_path / "m.csv", "--out", tmp_path / "o.csv", "--terms", "EXX,EYY",
        warned="warning: axis X was measured from 200 to 400 mm only; the table is constant beyond\nwarning: axis Y",
    )  # fmt: skip
    table = ErrorMap.from_rows(VMC3, read_error_table(tmp_path / "o.csv"))
    e = table.evaluate(np.array([[0.0, 0, 0], [200.0, 0, 0], [300.0, 0, 0], [400.0, 0, 0], [800.0, 0, 0]]))
    # The table on the workpiece side goes the other way.
    np.testing.assert_allclose(e[:, VMC3.term_index["EXX"]], [-0.02, -0.02, -0.03, -0.04, -0.04], atol=1e-9)


def test_terms_that_nothing_measures_are_all_without_effect(tmp_path: Path) -> None:
    data = read_text(tmp_path, "X,Y,Z,dz_um\n1,0,0,3\n2,0,0,3\n")
    found = identify(Chain(VMC3), data, Fields(VMC3, ("EX0T", "EXY"), 2))
    assert found.rank == 0
    assert found.ambiguities.unseen == (0, 1, 2, 3)
    np.testing.assert_allclose(found.solution.coefficients, 0.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "X,Y,Z,dx_mm\n1,2,3,4\n",
            "^'.*m.csv' must have a measured value in one of the columns dx_um, dy_um, .* got none",
        ),
        ("X,Y,Z,dx_um\n1,2,3,\n", "^'.*m.csv' must have a measured value"),
        ("X,Y,dx_um\n1,2,3\n", "^'.*m.csv' must have a column 'Z'"),
        ("X,Y,Z,dx_um\n1,2,3,inf\n", "^column 'dx_um' of '.*' must be finite, got inf in row 1"),
        (
            "X,Y,Z,dl_um,nx,ny\n1,2,3,4,1,0\n",
            "^'.*m.csv' must have a column 'nz', the direction along which dl_um counts",
        ),
        (
            "X,Y,Z,dl_um,nx,ny,nz\n1,2,3,,,,\n1,2,3,4,0,0,0\n",
            "^direction nx, ny, nz of '.*' must be finite and not zero, got 0, 0, 0 in row 2",
        ),
        ("X,Y,Z,dx_um,weight\n1,2,3,4,0\n", "^column 'weight' of '.*' must be positive, got 0 in row 1"),
        ("X,Y,Z,dx_um,sigma_um\n1,2,3,4,\n", "^column 'sigma_um' of '.*' must be positive, got nan in row 1"),
        ("X,Y,Z,dx_um,weight,sigma_um\n1,2,3,4,1,1\n", "^'.*m.csv' must have either weight or sigma_um, got both"),
        ("X,Y,Z,dx_um,sigma_urad\n1,2,3,4,1\n", "^'.*m.csv' must have a column 'sigma_um' beside sigma_urad"),
        (
            "X,Y,Z,dx_um,tool_length_mm\n1,2,3,4,inf\n",
            "^column 'tool_length_mm' of '.*' must be finite, got inf in row 1",
        ),
    ],
)
def test_bad_measurements_get_one_sentence(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        read_text(tmp_path, text)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--out", "o.parquet"), "^'o.parquet' must end in .csv, got '.parquet'"),
        (("--out", "o.csv", "--terms", "EXX,EXQ"), "^unknown error term 'EXQ' for machine 'vmc3'"),
        (("--out", "o.csv", "--tool", "left"), "^unknown tool 'left' of machine 'vmc3'"),
    ],
)
def test_bad_options_get_one_sentence(options: tuple[str, ...], message: str, tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("X,Y,Z,dx_um\n1,2,3,4\n")
    with pytest.raises(InputError, match=message):
        shown("vmc3", tmp_path / "m.csv", *options)


def test_parts_of_higher_degree_are_named_by_it() -> None:
    fields = Fields(parse_machine(machine_text()), ("EXX",), 5)
    data = measured(fields.machine, fields, np.zeros(fields.size), ONE_TOOL, n=30)
    names = [c.name for c in identify(Chain(fields.machine), data, fields).coefficients]
    assert names[0] == "EXX's constant"
    assert names[3:] == ["EXX's cubic part", "EXX's part of degree 4", "EXX's part of degree 5"]
