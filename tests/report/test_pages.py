"""Report pages: everything escaped, whole or not at all, true to their numbers, thinned without losing a peak."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from calling import holds
from linear_cards import SHORT_PERIOD_TRUTH
from report_samples import CARD, N, flight, records, study_context, with_offsets

from bayes_aero.diagnosis.result import INNOVATIONS, TRAJECTORIES, DiagnosisView, FlownMode, Motion, TheilParts
from bayes_aero.flight.health import HealthFinding
from bayes_aero.inference.results import OutputErrorStatus, PosteriorStatus
from bayes_aero.jobs import fly as job
from bayes_aero.jobs.results import RESULTS, Outcome
from bayes_aero.jobs.store import provenance
from bayes_aero.report.figures.every_figure import FIGURES
from bayes_aero.report.page import Fold, Picture, Plot, Report, Text, as_text, put_page, render, section
from bayes_aero.report.pages.diagnosis import diagnosis_page
from bayes_aero.report.pages.estimates import verdict
from bayes_aero.report.pages.fly import error_table, fly_page, initial_table, motion_sentences
from bayes_aero.report.pages.fly import parameter_table as trajectory_parameters
from bayes_aero.report.pages.identification import identification_page, identification_screen, parameter_table
from bayes_aero.report.pages.parts import PageContext, at_a_glance, stall_table
from bayes_aero.report.pages.study import MOST_UNITS, estimates, study_headline, study_page
from bayes_aero.report.plots import Line, Panel, extremes, linked
from bayes_aero.report.style import NotDrawn
from bayes_aero.report.table import TextTable

HOSTILE = """<script>alert(1)</script>"'&$$x$$</title>"""


class Outline(HTMLParser):
    """Tags and all text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag, _):
        self.tags.append(tag)

    def handle_data(self, data):
        self.text += data


def test_whatever_comes_from_a_run_is_escaped():
    table = TextTable(HOSTILE, (HOSTILE, "b"), ((HOSTILE, HOSTILE),), ((HOSTILE, 2),), note=HOSTILE)
    picture = Picture("data:,", HOSTILE, 3, 2, 2)
    panel = Panel("CL", "1", (Line("measured", "#000000", np.arange(3.0)),))
    item = {**linked(np.arange(3.0), [panel], "time"), "more": HOSTILE}
    plot = Plot(item, ((HOSTILE, "#000000", "solid"),), HOSTILE, HOSTILE, HOSTILE)
    blocks = Text(HOSTILE), table, picture, plot, Fold(HOSTILE, (Text(HOSTILE),))
    html = render(Report(HOSTILE, HOSTILE, HOSTILE, (), (section("a", "A", lambda: blocks),)))
    assert "<script>alert" not in html
    outline = Outline(html)
    assert outline.tags.count("script") == 3  # the library, the data, the page's own
    assert outline.text.count(HOSTILE) >= 12  # and is shown as it is
    data = re.search(r'<script type="application/json" id="plots">(.*?)</script>', html, re.S)
    assert data is not None
    assert json.loads(data[1])[0]["more"] == HOSTILE


def test_a_page_is_sound_asks_nothing_of_a_network_and_shows_the_numbers(full):
    source = provenance(full.card, full.records, 0, {"noise": "ar1"})
    html = render(identification_page(replace(full, notes=("Figure pair was not drawn: it rained",)), source, {}))
    markup = re.sub(r"<script>.*?</script>", "", html, flags=re.S)  # the library is watched in a browser
    assert re.findall(r"""(?:src|href)\s*=\s*["']data:""", markup)
    assert not re.search(r"""(?:src|href)\s*=\s*["'](?!data:|#)""", markup)
    assert "@import" not in markup
    assert "default-src 'none'" in html
    parts = ("emcee", "NUTS", "Cramér–Rao", "Figure pair was not drawn: it rained", full.records[0].sha256)
    holds(Outline(html).text, *parts, *full.mle.names)


def test_the_text_of_a_page_has_every_sentence_and_every_number(full, simulated):
    """Only words are folded."""
    run = replace(full, notes=("It rained.",))
    page = identification_page(run, provenance(full.card, full.records, 0, {}), {}, simulated.paths)
    text = as_text(page)
    spaced = " ".join(text.split())
    holds(spaced, *(section.title for section in page.sections), "! It rained.")
    holds(spaced, *(" ".join(sentence.split()) for sentence in verdict(run)))
    tables = [block for section in page.sections for block in section.blocks if isinstance(block, TextTable)]
    assert len(tables) >= 4
    holds(text, *(line for table in tables for row in table.rows for cell in row[1:] for line in cell.split("\n")))


def test_the_identified_model_is_flown_on_the_page(full, simulated):
    off = [path for path in simulated.paths if (path.model, path.split) == ("card", "fitted")]
    page = identification_page(full, {}, {}, off)
    (part,) = [s for s in page.sections if s.key == "simulated"]
    (table,) = [b for b in part.blocks if isinstance(b, TextTable)]
    assert table.rows[0][0] == "a, first half"
    row = dict(zip(table.head, next(row for row in table.rows if row[0] == "α [deg]"), strict=True))
    assert row["simulation"] == "100%"  # alpha is off by a degree, inside two hundredths of a radian
    assert len([b for b in part.blocks if isinstance(b, Plot)]) == len(off) == 2
    assert not any(s.key == "simulated" for s in identification_page(full, {}, {}).sections)


def test_parameters_are_those_of_every_method(full):
    table = parameter_table(full).text()
    row = next(cells for cells in table.rows if cells[0].startswith("Cmde "))
    assert row[0] == "Cmde [1/rad]"
    assert row[1:3] == ("-0.800 ± 0.010", "-0.800 ± 0.040")  # the bound and four times it
    order = sorted(full.posteriors, key=lambda key: key != "white")  # white noise stands first
    for key, cell in zip(order, row[3:-2], strict=True):
        m = full.posteriors[key].marginals["Cmde"]
        assert [float(x) for x in re.split(" ± |\n| to ", cell)] == pytest.approx([m.mean, m.sd, *m.ci95], abs=5e-4)
    assert row[-1] == "42.4"  # 60 bounds apart, each off by one: 60/sqrt 2
    assert sum(span for _, span in table.groups) == len(table.head) == len(row)


def test_what_a_record_or_sampler_does_not_show_is_said(full):
    blocks: Any = stall_table({"emcee": full.stall}, "")
    table, warning = blocks
    assert full.stall.at_edge == 1.0  # lift without separation only rises
    assert table.rows[0][1].startswith("at least")
    assert table.rows[0][2] == "not shown by this record"
    assert "100%" in warning.text
    assert "CLmax" not in str(identification_screen(full, full.card, full.records).result)
    bad = replace(full.posteriors["nuts"], status=PosteriorStatus.DIVERGENT)
    page = identification_page(replace(full, posteriors={**full.posteriors, "nuts": bad}), {}, {})
    assert page.lead[0].tone == "warning"
    assert "divergent" in page.lead[0].text
    assert "by NUTS" in page.screen["Doubts"][0].text  # before all other doubts


def test_a_part_that_fails_does_not_cost_the_page(tmp_path):
    def fails():
        raise ValueError("no such luck")

    page = Report("t", "s", "v", (), (section("a", "Lift", fails), section("b", "Drag", lambda: (Text("fine"),))))
    holds(Outline(render(page)).text, "'Lift'", "ValueError: no such luck", "fine")
    (failure,) = put_page(lambda: page, tmp_path)
    assert "'Lift'" in failure
    (failure,) = put_page(fails, tmp_path)
    holds(failure, "report.html", "ValueError: no such luck")
    assert "in fails" in (tmp_path / "error.txt").read_text()


def test_thinning_keeps_every_peak():
    rng = np.random.default_rng(1)
    columns = [np.cumsum(rng.standard_normal(20_000)), rng.standard_normal(20_000)]
    columns[1][12_345] = 40.0
    keep = extremes(columns, 1000)
    assert len(keep) <= 2 * 1000 + 2
    assert {0, 12_345, 19_999} <= set(keep)
    edges = np.linspace(0, 20_000, 501).astype(int)
    for values in columns:
        for a, b in pairwise(edges):
            shown = values[keep[(keep >= a) & (keep < b)]]
            assert (shown.min(), shown.max()) == (values[a:b].min(), values[a:b].max())
    assert np.array_equal(extremes(columns, 30_000), np.arange(20_000))
    columns[0][:] = np.nan  # a channel that dropped out
    assert len(extremes(columns, 1000)) <= 2 * 1000 + 2


def test_a_diagnosis_shows_causes_gain_and_what_is_open(diagnosed, flown, card):
    ranges = {"alpha": [0.07, 0.21], "load_factor": [0.71, 1.52], "airspeed": [80.0, 110.0]}
    point = {"manoeuvre": "thrust_steps", "amplitude": 1.5, "airspeed": 95.4, "altitude": 5200.0, "seconds": 60.0}
    points = {
        "questions": [{"effects": ["a", "b"], "enough": 5.0, "present": 0.7}],
        "points": [{**point, "excursion": ranges, "standard_errors": [6.25], "nats_per_second": 0.3}],
        "stated": [],
    }
    hidden = {"hidden": {"alpha_bias": {"alpha_bias": 0.01}}, "named": {"alpha_bias": "missed"}}
    about = Outcome(flown, **hidden, notes=("n",), test_points=points)
    context = PageContext(card, diagnosed.records, provenance(card, diagnosed.records, 0, {}), {}, about)
    page = diagnosis_page(flown, context)
    text = Outline(render(page)).text
    holds(text, *(cause.claim for cause in flown.diagnosis.causes))
    holds(text, "a or b: expected to be decided, 6.2 standard errors", "thrust steps", "4 to 12", "0.71 to 1.52")
    holds(text, "Hidden effect: alpha_bias", "Trajectories, before and after", "time inside", "CLmax")
    table = next(b for b in page.sections[2].blocks if isinstance(b, TextTable))
    assert [row[0] for row in table.rows] == ["CL", "CD", "Cm"]
    assert "was not made" not in text
    assert "manoeuvre by manoeuvre" not in text  # there is one
    only = by_trajectories(flown)
    text = Outline(render(diagnosis_page(only, context))).text
    holds(text, "they need lift coefficients", "lacks channels")
    followed = replace(only, diagnosis=replace(only.diagnosis, compared=INNOVATIONS, tested=None))
    text = Outline(render(diagnosis_page(followed, context))).text
    assert "from innovations: process noise and gusts are estimated" in text
    assert "lacks channels" not in text
    assert "Measured and simulated coefficients" not in text


def by_trajectories(view: DiagnosisView) -> DiagnosisView:
    """What is shown where no coefficients were formed."""
    diagnosis = replace(view.diagnosis, compared=TRAJECTORIES)
    return DiagnosisView(diagnosis=diagnosis, rankings=view.rankings, moves=view.moves, trajectories=view.trajectories)


def test_a_unit_that_cannot_be_is_the_first_word(diagnosed, flown, card):
    words = "1 in knots", "", "", "1 in knots"
    health = (HealthFinding(diagnosed.records[0].name, "airspeed", "unit", None, None, *words, grave=True),)
    source = provenance(card, diagnosed.records, 0, {})
    context = PageContext(card, diagnosed.records, source, {}, Outcome(flown, health=health))
    for page in (diagnosis_page(flown, context), diagnosis_page(by_trajectories(flown), context)):
        assert "Not fit for use" in page.screen["Record"][0].text
        assert "1 in knots" in page.screen["Record"][1].text
        html = render(page)
        assert html.index("in knots") < html.index("<dt>Result</dt>")


def test_a_long_record_makes_a_page_of_bearable_size(make, monkeypatch):
    """200,000 samples: what is drawn is thinned, which the page says."""
    monkeypatch.setitem(make.__globals__, "N", 200_000)
    page = render(identification_page(make(manoeuvres=1, gp=False), {}, {}))
    assert len(page.encode()) < 10_000_000
    assert "thinned so that every peak stays" in page


def test_figures_with_a_panel_for_each_manoeuvre_are_left_out_where_there_are_many(make, monkeypatch):
    monkeypatch.setattr("bayes_aero.report.style.MOST_MANOEUVRES", 1)
    with pytest.raises(NotDrawn, match="2 are more than 1"):
        FIGURES["fig1_time_history"](make(manoeuvres=2, gp=False))


# Fits to trajectories
DEGREE = np.deg2rad(1.0)


def context(sentences=("The fit converged.", "A finding."), **more):
    result = replace(flight(), sentences=sentences, notes=("A note.",), **more)
    return PageContext(CARD, records(), provenance(CARD, records(), 0, {"windows": 12.0}), {}, result)


def blocks_of(page, key) -> Any:
    return next(s.blocks for s in page.sections if s.key == key)


def not_made(page):
    return [b for s in page.sections for b in s.blocks if "was not made" in getattr(b, "text", "")]


def legends(page):
    return str([b.legend for b in blocks_of(page, "fit") if isinstance(b, Plot)])


def test_every_part_is_made_and_nothing_else():
    page = fly_page(flight().flown, context(motion=None))
    assert not not_made(page)
    assert [s.key for s in page.sections] == ["findings", "records", "fit", "errors", "parameters", "provenance"]
    assert list(page.screen) == ["Record", "Result", "Doubts", "Next"]
    assert page.screen["Result"][0].text == "The fit converged."
    assert blocks_of(page, "findings")[0].items == ("The fit converged.", "A finding.", "A note.")
    assert [b.title for b in blocks_of(page, "fit") if isinstance(b, Plot)] == ["one", "two"]
    assert all(isinstance(b, Fold) for b in blocks_of(page, "provenance"))  # folded away
    holds(render(page), *SHORT_PERIOD_TRUTH)


def test_parameters_stand_with_both_deviations_and_their_bounds():
    flown = flight().flown
    table = trajectory_parameters(flown).text()
    assert {row[0].split()[0] for row in table.rows} == set(SHORT_PERIOD_TRUTH)
    for row in table.rows:
        name, first, fit, crb, corrected, prior, bounds, remark = row
        truth = SHORT_PERIOD_TRUTH[name.split()[0]]
        assert abs(float(fit) - truth) < 4.0 * max(float(crb), float(corrected)), name
        assert float(first) == 0.0  # the card gives no start
        assert prior == "0 ± 1000, default"
        assert bounds == ("-40 to 0" if name.startswith("Mde ") else "none")
        assert remark == "–"
    still = trajectory_parameters(replace(flown, fit=replace(flown.fit, at_bound=("Mde",)))).text()
    assert [row[0] for row in still.rows if row[-1] == "at its bound"] == ["Mde [1/s²]"]


def test_numbers_of_a_fit_that_failed_are_warned_of_first():
    flown = flight().flown
    failed = replace(flown.fit, status=OutputErrorStatus.LEFT_ENVELOPE, covariance=1e40 * flown.fit.covariance)
    left = replace(flown, fit=failed)
    page = fly_page(left, context(("The fit failed: it left.",), flown=left))
    assert page.screen["Result"][1].text == "Do not use these numbers."
    estimates = [row[2] for row in blocks_of(page, "parameters")[0].rows]
    assert all(float(text) == pytest.approx(x, rel=0.01) for text, x in zip(estimates, failed.estimate, strict=True))
    assert "RMS error" in fly_page(flown, context()).screen["Result"][1].text


def test_errors_of_a_known_offset():
    """Simulated is measured plus a constant: that is the RMS, the largest error, and all of it is bias."""
    flown = with_offsets(flight().flown, {"one": 100, "two": 300}, {"one": 2.0 * DEGREE, "two": -1.5 * DEGREE})
    rows = error_table(flown).text().rows
    assert [row[0] for row in rows] == ["one", "α [deg]", "two", "α [deg]"]
    assert rows[1][1:4] == ("4.0", "2.0", "2.0")
    assert rows[1][5:8] == ("100%", "0%", "0%")
    assert rows[3][1:4] == ("3.0", "1.5", "1.5")
    (before, after) = flown.rms_errors["alpha"]
    assert after / DEGREE == pytest.approx(np.sqrt((100 * 2.0**2 + 300 * 1.5**2) / 400))
    assert before == pytest.approx(2.0 * after)
    assert [row[8:] for row in rows if row[0].startswith("α")] == [("± 2", "0%", "100%")] * 2
    alone = error_table(with_offsets(flight().flown, {"one": 200}, {"one": DEGREE})).text()
    assert [row[0] for row in alone.rows] == ["α [deg]"]  # no heading above a single manoeuvre


def test_without_tolerances_there_is_no_band():
    flown = with_offsets(flight().flown, {"one": 200}, {"one": DEGREE})
    assert "tolerance" in legends(fly_page(flown, context()))
    without = {"tolerance": None, "within": None}
    free = tuple(replace(p, errors={n: replace(e, **without) for n, e in p.errors.items()}) for p in flown.paths)
    assert "tolerance" not in error_table(replace(flown, paths=free)).text().head
    assert "tolerance" not in legends(fly_page(replace(flown, paths=free), context()))


def test_a_simulation_that_is_lost_leaves_the_page_whole():
    """First values that fly to infinity: a gap in the curve, a dash in the tables, no warning."""
    flown = with_offsets(flight().flown, {"one": 200}, {"one": DEGREE})
    nothing = {"rms": float("inf"), "largest": float("inf"), "theil": TheilParts(*[float("nan")] * 4)}
    errors = {"alpha": replace(flown.paths[0].errors["alpha"], **nothing)}
    gone = {"alpha": np.geomspace(1.0, 1e308, 200)}
    lost = replace(flown, paths=tuple(replace(p, simulated=gone, errors=errors) for p in flown.paths))
    assert error_table(lost).text().rows[0][1:8] == ("–",) * 7
    page = fly_page(lost, context(flown=lost))
    assert not not_made(page)
    assert "first values → fit: α –" in page.screen["Result"][1].text


def test_first_states_are_those_flown_and_a_linear_card_shows_its_own_channels():
    rows = {row[0]: row[1:] for row in initial_table(flight().flown).text().rows[:3]}
    assert list(rows) == ["one", "α [deg]", "q [deg/s]"]
    assert float(rows["α [deg]"][0]) * DEGREE == pytest.approx(0.04, abs=0.002)
    assert float(rows["q [deg/s]"][0]) * DEGREE == pytest.approx(0.0, abs=0.003)
    measured = flight().flown.path("one", "start").simulated["alpha"][0]
    assert float(rows["α [deg]"][1]) * DEGREE == pytest.approx(float(rows["α [deg]"][0]) * DEGREE - measured, abs=1e-4)
    (table,) = (b for b in at_a_glance(records(), CARD) if isinstance(b, TextTable))
    heads = [head.replace("\n", " ") for head in table.head[5:]]
    assert heads == ["α [deg]", "q [deg/s]", "az [m/s²]", "δe [deg]"]


def test_a_page_that_fails_is_reported_and_costs_no_number(tmp_path, monkeypatch):
    def fails(*_):
        raise ValueError("no such luck")

    flown = flight().flown  # before what fits it is replaced
    monkeypatch.setattr(job, "output_error_fit", lambda *_, **__: flown)
    with monkeypatch.context() as patch:
        patch.setattr(job, "fly_page", fails)
        result = job.fly(records(), CARD, out=tmp_path, figures=False)  # pyright: ignore[reportCallIssue]
    assert result.failures[-1].startswith("report.html was not written: ValueError: no such luck")
    assert json.loads((tmp_path / RESULTS).read_text())["failures"] == list(result.failures)
    assert not (tmp_path / "report.html").exists()
    result = job.fly(records(), CARD, out=tmp_path, figures=False)  # pyright: ignore[reportCallIssue]
    assert (result.notes, result.failures) == ((), ())
    assert not (tmp_path / "error.txt").exists()  # of the run before
    assert "The fit converged;" in (tmp_path / "report.html").read_text()


PERIOD = {"period": (3.831, 0.014), "damping_ratio": (0.1091, 0.0024)}
MODES = (
    FlownMode("Dutch roll", -0.18 + 1.64j, (0.004, 0.006), PERIOD),
    FlownMode("roll", -1.4 + 0.0j, (0.03, 0.0), {"time_constant": (0.714, 0.015)}),
    FlownMode("spiral", 0.001 + 0.0j, (0.02, 0.0), {}),
)
MOTION = Motion(120.0, 4000.0, MODES)


def test_modes_stand_on_the_page_and_what_motion_lacks_is_said():
    (modes,) = blocks_of(fly_page(flight().flown, context(motion=MOTION)), "motion")
    assert [row[:3] for row in modes.rows] == [
        ("Dutch roll", "period, s", "3.831 ± 0.014"), ("Dutch roll", "damping ratio", "0.1091 ± 0.0024"),
        ("roll", "time constant, s", "0.714 ± 0.015"), ("spiral", "neither grows nor falls beyond its error", "–"),
    ]  # fmt: skip
    assert "at 120 m/s and 4000 m" in modes.note
    for motion, words in ((MOTION, "spiral"), (replace(MOTION, modes=(), why_not="no trim"), "no trim")):
        (sentence,) = motion_sentences(motion)
        assert words in sentence
    assert motion_sentences(None) == []


# Studies
def test_scatter_and_claims_are_those_of_the_values(tmp_path):
    given = study_context(tmp_path, n=40)
    CLa, alpha_star = estimates(given.units, given.results)
    mine = given.results[given.results["parameter"] == "CLa"]["value"]
    assert CLa.scatter == pytest.approx(mine.std())
    assert CLa.claimed == pytest.approx(0.1)
    assert list(CLa.rows["number"]) == list(range(1, 41))
    assert alpha_star.scatter < 1.5 * alpha_star.claimed
    ratio = f"{CLa.scatter / 0.1:.1f} times its intervals"
    assert study_headline(given) == f"All 40 units are done; all converged; CLa differs between units by {ratio}."


def test_the_verdict_of_diagnoses_counts_verdicts_and_names_the_commonest_cause(tmp_path):
    given = study_context(tmp_path)
    verdicts = ["explained"] * 5 + ["no_effect"] * (N - 5)
    causes = ["thrust_scale"] * 4 + ["alpha_bias"]
    rows = given.results[given.results["parameter"] == "alpha_star"].iloc[:5]
    results = rows.assign(cause=causes, parameter=causes, method="coefficients")
    named = replace(given, task="diagnose", units=given.units.assign(verdict=verdicts), results=results)
    parts = [f"All {N} units are done", f"5 explained and {N - 5} no effect", f"thrust_scale is named in 4 of {N}"]
    assert study_headline(named).rstrip(".").split("; ")[:3] == parts


def test_units_that_failed_or_are_in_doubt_are_named_with_their_reason(tmp_path):
    page = study_page(study_context(tmp_path, failed=(4,)))
    assert page.verdict.startswith(f"{N - 1} of {N} units are done (1 failed); all converged; ")
    (units,) = blocks_of(page, "units")
    assert units.rows[0][:3] == ("flight5-<b>", "5", "failed")
    assert units.rows[0][-2] == "no samples"
    assert [row[1] for row in units.rows[1:]] == [str(k) for k in (1, 2, 3, 4, 6, 7)]
    page = study_page(study_context(tmp_path))
    assert "Records are in doubt in 1 of 7 units: flight2-&lt;b&gt;: the sensors disagree." in render(page)


def test_a_unit_leads_to_its_own_page_and_nothing_else_to_anywhere(tmp_path):
    (tmp_path / "units" / "flight2-<b>").mkdir(parents=True)
    (tmp_path / "units" / "flight2-<b>" / "report.html").write_text("x")
    text = render(study_page(study_context(tmp_path)))
    assert text.count('href="units/') == 1
    assert 'href="units/flight2-%3Cb%3E/report.html"' in text
    assert "<b>" not in text


def test_a_study_in_which_nothing_was_done_has_a_page_and_a_large_one_says_what_it_leaves_out(tmp_path):
    page = study_page(study_context(tmp_path, failed=range(N)))
    assert page.verdict == f"0 of {N} units are done ({N} failed)."
    assert page.lead == ()
    assert put_page(lambda: page, tmp_path) == ()
    page = study_page(study_context(tmp_path, n=MOST_UNITS + 30))
    (units,) = blocks_of(page, "units")
    assert len(units.rows) == MOST_UNITS
    assert "30 more" in units.note
    assert len(render(page)) < 1_000_000
