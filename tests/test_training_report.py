"""The report's page: what it says is what was found, and it stands alone."""

import html
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from shop import write_dataset

import training.job
from model.exceptions import DataError
from model.sensors import SensorModel
from model.tables import read_table, write_table
from training.baselines.ridge import RIDGE_AVERAGES
from training.cli import train
from training.evaluation import NETWORK, NO_COMPENSATION, RIDGE
from training.job import Result, train_bundle
from training.report import check_report, report_path, write_report
from training.report.figures import INTERVAL, follow_run
from training.report.left_out import left_out_runs
from training.report.modes import ModeWeights, mode_weights
from training.report.moments import APART_S, worst_moments
from training.report.page import MARK, column_counts, render
from training.report.svg import draw
from training.report.tables import sensor_model
from training.report.units import channel_value, clock, duration, micrometres, number, percent
from training.volume import scattered_points

WILD = '<b>r$3$ & "x"'
"""A run's name that would be markup in HTML, a formula in matplotlib and the end of an attribute."""
VOID = {"meta", "br", "path", "use", "rect", "img", "hr", "link"}


class Page(HTMLParser):
    """Reads a page and notes what a browser would stumble over."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text = text
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.loads: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), f"an attribute of {tag} stands twice"
        found = dict(attrs)
        self.tags.append((tag, found))
        if found.get("id"):
            self.ids.append(str(found["id"]))
        for name in ("href", "xlink:href", "src"):
            value = found.get(name)
            if value is not None:
                (self.links if value.startswith("#") else self.loads).append(value)
        self.links += re.findall(r"url\((#[^)]*)\)", " ".join(v or "" for v in found.values()))

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag


def wild(folder: Path) -> Path:
    """Rename a run of a data set to something that must be escaped."""
    for name in ("telemetry.csv", "error_terms.csv"):
        table = read_table(folder / name, text=("run", "term"))
        columns = {**table.text, **{k: ["" if np.isnan(v) else v for v in c] for k, c in table.numbers.items()}}
        columns["run"] = [WILD if run == "r3" else run for run in table.text["run"].tolist()]
        write_table(folder / name, {k: list(v) for k, v in columns.items()})
    return folder


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    folder = wild(write_dataset(tmp_path_factory.mktemp("report") / "data", 5))
    return train_bundle(folder, tmp_path_factory.mktemp("out") / "bundle", ["r4", WILD], 0)


@pytest.fixture(scope="module")
def page(result: Result) -> Page:
    return Page(render(result))


def test_the_page_is_well_formed_and_its_links_lead_somewhere(page: Page) -> None:
    assert page.text.lstrip().startswith("<!DOCTYPE html>")
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert page.links
    assert {link[1:] for link in page.links} <= set(page.ids)
    labels = [str(a["aria-labelledby"]) for _, a in page.tags if a.get("aria-labelledby")]
    assert labels
    assert set(labels) <= set(page.ids)


def test_the_page_loads_nothing_and_runs_nothing(page: Page) -> None:
    assert page.loads == []
    assert not {"script", "link", "img", "iframe", "object"} & {tag for tag, _ in page.tags}
    assert not any(name.startswith("on") for _, attributes in page.tags for name in attributes)
    assert "@import" not in page.text
    assert not re.search(r"url\((?!#)", page.text)
    assert not re.search(r"https?://(?!www\.w3\.org/)", page.text)  # names of formats are no addresses
    assert len(page.text.encode()) < 3_000_000


def test_pictures_and_tables_say_what_they_show(page: Page) -> None:
    count = [tag for tag, _ in page.tags].count
    assert count("h1") == 1
    assert count("figure") == count("figcaption") == count("svg") >= 5
    assert count("table") == count("caption") >= 6
    assert all(a.get("role") == "img" and a.get("aria-label") for tag, a in page.tags if tag == "svg")
    assert ("html", {"lang": "en"}) in page.tags
    assert all(a.get("scope") in {"row", "col"} for tag, a in page.tags if tag == "th")


def test_what_comes_from_data_is_escaped(page: Page) -> None:
    assert "<b>" not in page.text
    assert "&lt;b&gt;r$3$ &amp; " in page.text  # the dollars, too: no formula was made of them
    assert not any(tag == "b" for tag, _ in page.tags)


def test_the_figures_are_those_of_the_result(result: Result, page: Page) -> None:
    for name, score in result.scores.items():
        cells = "".join(f'<td class="n">{v}</td>' for v in (micrometres(score.rms_um), percent(score.share)))
        assert f'<th scope="row">{name}</th>{cells}' in page.text
    assert result.bundle.version in page.text
    assert result.dataset.fingerprint[:12] in page.text
    for name in result.dataset.measured_terms:
        assert f'<th scope="row">{name}</th>' in page.text
    unmeasured = page.text.split("Not measured, and so predicted as zero: ")[1].split(".</p>")[0].split(", ")
    assert set(unmeasured) == {t.name for t in result.dataset.machine.terms} - set(result.dataset.terms)


def test_worst_moments_are_the_worst_and_apart(result: Result) -> None:
    runs = left_out_runs(result)
    assert {run.name for run in runs} == {"r4", WILD}
    found = worst_moments(result.dataset, result.metric, runs)
    assert found[0].left_um == pytest.approx(result.scores[NETWORK].worst_um)
    assert [m.left_um for m in found] == sorted((m.left_um for m in found), reverse=True)
    for i, moment in enumerate(found):
        assert not any(
            abs(moment.time_s - other.time_s) < APART_S for other in found[:i] if other.run.name == moment.run.name
        )
        telemetry = moment.run.measured.telemetry
        now = np.searchsorted(telemetry.time_s, moment.time_s)
        before = (telemetry.time_s > moment.time_s - 3600.0) & (telemetry.time_s <= moment.time_s)
        assert moment.channels["spindle_rpm"] == pytest.approx(
            (telemetry.channels[now, 0], telemetry.channels[before, 0].mean())
        )
        assert moment.run.scored[moment.row]


def test_terms_alone_add_up_to_the_tip_where_they_move_it_apart(result: Result) -> None:
    """EXX moves the tip along x and EZ0T along z, so their squares add up to the whole."""
    for moment in worst_moments(result.dataset, result.metric, left_out_runs(result)):
        alone = dict(moment.terms)
        assert set(alone) == {"EXX", "EZ0T"}
        assert np.hypot(*alone.values()) == pytest.approx(moment.left_um)


def weights_of(result: Result) -> ModeWeights:
    assert result.making is not None
    record = result.bundle.manifest.training
    return mode_weights(result.dataset, result.making.served, sensor_model(result), record["runs"])


def test_the_weight_of_time_constants_is_at_the_true_one(result: Result) -> None:
    """The truth lags by 20 minutes: what acts at once or after hours must weigh less than what is near."""
    weights = weights_of(result)
    near = (weights.time_constants_s > 400.0) & (weights.time_constants_s < 3600.0)
    assert near.sum() == 2
    heaviest = 1 + int(np.argmax(weights.temperatures_um[1:]))
    assert near[heaviest - 1]
    assert weights.temperatures_um[0] < 0.5 * weights.temperatures_um[heaviest]
    assert weights.sources_um.max() < 0.3 * weights.temperatures_um.max()  # the spindle's speed does nothing


def test_a_weight_is_how_far_its_part_moves_the_tip(result: Result) -> None:
    """With all but one time constant of the decoder set to zero, that one is the network's whole prediction."""
    assert result.making is not None
    training = result.making.served
    net, telemetry = training.net, result.dataset.runs["r0"].telemetry
    inputs, taus = len(net.warm), len(net.tau_s)
    before = net.linear.detach().clone()
    kept = before.reshape(inputs, taus + 1, -1).clone()
    kept[:, [k for k in range(taus + 1) if k != 3]] = 0.0
    kept[net.warm == 0.0] = 0.0
    try:
        net.linear.data.copy_(kept.reshape(before.shape))
        filled = np.concatenate([telemetry.temperatures, telemetry.channels], axis=1)
        tensor = net.linear.new_tensor
        dt_s = np.diff(telemetry.time_s, prepend=telemetry.time_s[0])
        said = (net.sequence(tensor(filled[None]), tensor(dt_s[None]))[0] @ net.linear).detach().numpy()
        model = SensorModel.fit(telemetry.temperatures)
        weights = mode_weights(result.dataset, training, model, ["r0"])
    finally:
        net.linear.data.copy_(before)
    fields = training.fields
    columns = np.stack([said[:, fields.slices()["EZ0T"].start]], axis=1)
    positions = scattered_points(result.dataset.machine)[:, 0]
    exx = said[:, fields.slices()["EXX"]] @ fields.basis("EXX", positions).T
    change = np.concatenate([columns - columns[:1], exx - exx[:1]], axis=1)
    square = (change[:, 0] ** 2).mean() + (change[:, 1:] ** 2).mean()  # one moves the tip in z, the other in x
    assert weights.temperatures_um[3] == pytest.approx(np.sqrt(square), rel=1e-9)
    assert weights.temperatures_um.sum() == pytest.approx(weights.temperatures_um[3])
    assert weights.sources_um.max() == 0.0


def test_coverage_counts_each_position(result: Result) -> None:
    counts = column_counts(result.dataset)
    times = sum(len(run.time_s) for run in result.dataset.runs.values())
    assert {name: count.tolist() for name, count in counts.items()} == {"EXX": [times] * 3, "EZ0T": [times]}


def test_a_network_that_loses_is_said_to(result: Result) -> None:
    name = min((RIDGE, RIDGE_AVERAGES.name), key=lambda name: result.scores[name].rms_um)
    best = result.scores[name]
    scores = {**result.scores, NETWORK: replace(result.scores[NETWORK], rms_um=2.0 * best.rms_um, share=1.2)}
    text = render(replace(result, scores=scores))
    assert f"The network does not beat {name} on these measurements." in text
    assert "The network leaves more than no compensation does: do not use it." in text
    won = {**result.scores, NETWORK: replace(result.scores[NETWORK], rms_um=0.9 * best.rms_um, share=0.01)}
    assert "does not beat" not in render(replace(result, scores=won))


def test_without_baselines_the_page_still_stands(result: Result) -> None:
    """As a result of `thermotrue evaluate` is: no baseline, and nothing of how the bundle was made."""
    scores = {name: result.scores[name] for name in (NO_COMPENSATION, NETWORK)}
    methods = {NETWORK: result.methods[NETWORK]}
    bare = Page(render(replace(result, scores=scores, methods=methods, making=None)))
    assert bare.open == []
    assert {link[1:] for link in bare.links} <= set(bare.ids)
    assert RIDGE not in bare.text


def test_tips_measured_alone_are_reported_at_their_places(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "data", 4)
    terms = read_table(folder / "error_terms.csv", text=("run", "term"))
    growth = terms.text["term"] == "EZ0T"  # moves the tip by as much in z, wherever it is
    run, time_s, up = terms.text["run"][growth], terms.numbers["time_s"][growth], terms.numbers["value"][growth]
    tips: dict[str, list[float] | list[str]] = {"run": [*run, *run], "time_s": [*time_s, *time_s]}
    tips.update({"X": [100.0] * len(run) + [700.0] * len(run), "Y": [0.0] * 2 * len(run), "Z": [250.0] * 2 * len(run)})
    tips.update({"dx_um": [0.0] * 2 * len(run), "dy_um": [0.0] * 2 * len(run), "dz_um": [*up, *up]})
    write_table(folder / "tool_tip.csv", tips)
    (folder / "error_terms.csv").unlink()
    result = train_bundle(folder, tmp_path / "bundle", ["r3"], 0)
    text = Page(render(result)).text
    assert "at X 100 mm, Y 0 mm, Z 250 mm, where it was measured most often" in text
    assert "Where in the working volume the tool tip itself was measured." in text
    assert "The tool tip&#39;s deviation at that moment, worst position first." in text
    drift = left_out_runs(result)[0]
    np.testing.assert_allclose(drift.at_um[NO_COMPENSATION][:, 2], up[run == "r3"])
    np.testing.assert_allclose(drift.rms_um[NO_COMPENSATION], np.abs(up[run == "r3"]))


def test_a_report_lies_beside_its_bundle_and_overwrites_nothing_else(result: Result, tmp_path: Path) -> None:
    assert report_path(tmp_path / "a.b") == tmp_path / "a.b.html"
    assert report_path(tmp_path / "a" / "..") == report_path(tmp_path)
    path = report_path(tmp_path / "bundle")
    check_report(path)
    write_report(result, path)
    check_report(path)  # an older report may go
    assert MARK in path.read_text(encoding="utf-8")
    path.write_text("my thesis")
    with pytest.raises(DataError, match=r"'.*bundle.html' exists and is not a report; name another --out"):
        check_report(path)
    folder = tmp_path / "folder.html"
    folder.mkdir()
    with pytest.raises(DataError, match=r"report '.*' must be a file, got a folder"):
        check_report(folder)


@pytest.mark.parametrize("wanted", [True, False])
def test_train_writes_it_unless_told_not_to(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wanted: bool
) -> None:
    monkeypatch.setattr(training.job, "train_bundle", lambda *_: result)
    args = [str(result.dataset.path), "--out", str(tmp_path / "bundle"), *([] if wanted else ["--no-report"])]
    done = CliRunner().invoke(train, args)
    assert done.exit_code == 0, done.output
    path = tmp_path / "bundle.html"
    assert path.exists() == wanted
    assert (f"report {path}" in done.output.replace("\n", "")) == wanted
    told = CliRunner().invoke(train, [*args, "--json"])
    assert json.loads(told.stdout)["report"] == (str(path) if wanted else None)


def test_a_taken_report_is_found_before_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training.job, "train_bundle", lambda *_: pytest.fail("trained"))
    (tmp_path / "bundle.html").write_text("my thesis")
    done = CliRunner().invoke(train, [str(tmp_path), "--out", str(tmp_path / "bundle")])
    assert isinstance(done.exception, DataError)


def test_times_that_show_different_terms_are_not_joined_by_lines(result: Result) -> None:
    run = left_out_runs(result)[0]
    assert run.alike
    assert "stroke-dasharray" in follow_run("a", run, RIDGE, legend=False)  # the baseline's line
    assert "stroke-dasharray" not in follow_run("a", replace(run, alike=False), RIDGE, legend=False)


def test_the_band_is_the_networks_own_interval_at_the_place_that_is_drawn(result: Result, page: Page) -> None:
    assert result.making is not None
    assert result.interval is not None
    predictor = result.making.predictor
    assert predictor.uncertainty is not None
    for run in left_out_runs(result):
        telemetry = run.measured.telemetry
        states = predictor.states(telemetry)
        size = run.measured.between(predictor.spread(states))
        distance = np.abs(result.metric.positions - np.array([400.0, 0.0, 250.0])).sum(axis=1)
        q = result.metric.positions[[int(np.argmin(distance))]]
        expected = 1.959964 * predictor.uncertainty.tip(np.repeat(q, len(size), axis=0), size)
        assert run.allowed_um is not None
        np.testing.assert_allclose(run.allowed_um, expected, rtol=1e-12)
        assert INTERVAL in follow_run("a", run, RIDGE, legend=True)
        assert INTERVAL not in follow_run("a", replace(run, allowed_um=None), RIDGE, legend=True)
    assert f"{percent(result.interval.within)} lie within the network's 95 % interval" in html.unescape(page.text)


def test_two_pictures_on_a_page_share_no_ids() -> None:
    def fill(figure: object) -> None:
        axes = figure.subplots()  # type: ignore[attr-defined]
        axes.plot([0.0, 1.0], [0.0, 1.0], clip_on=True)
        axes.set_title("a < b & $x$")

    one, two = (Page(f"<p>{draw(name, 'a < b', (2.0, 1.0), fill)}</p>") for name in ("one", "two"))
    assert one.ids
    assert not set(one.ids) & set(two.ids)
    assert {link[1:] for link in one.links} <= set(one.ids)
    assert "a &lt; b &amp; $x$" in one.text
    assert draw("one", "a", (2.0, 1.0), fill) == draw("one", "a", (2.0, 1.0), fill)


@pytest.mark.parametrize(
    ("said", "text"),
    [
        (number(0.0), "0"),
        (number(-45.64), "−45.6"),
        (number(0.01234), "0.0123"),
        (number(12345.6), "12346"),
        (number(float("nan")), "–"),
        (micrometres(6.254), "6.25\xa0µm"),
        (micrometres(-0.004), "0\xa0µm"),
        (micrometres(-0.5), "−0.50\xa0µm"),
        (percent(0.1114), "11.1\xa0%"),
        (duration(8.0), "8\xa0s"),
        (duration(5400.0), "1.5\xa0h"),
        (duration(100_000.0), "28\xa0h"),
        (duration(300_000.0), "3.5\xa0days"),
        (clock(18_240.0), "5\xa0h 04\xa0min"),
        (channel_value("spindle_rpm", 12_000.0), "12000\xa0rpm"),
        (channel_value("coolant_on", 1.0 / 3.0), "0.333"),
    ],
)
def test_numbers_read_as_people_write_them(said: str, text: str) -> None:
    assert said == text
