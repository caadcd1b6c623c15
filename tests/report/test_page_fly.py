"""The pages of a fit to trajectories and of a study: true to their numbers, whole, and never in their way."""

import json
from dataclasses import replace

import numpy as np
import pytest
from calling import holds
from linear_cards import SHORT_PERIOD_TRUTH
from report_samples import CARD, N, flight, records, study_told, with_offsets

from bayes_aero.diagnosis.result import FlownMode, Motion, TheilParts
from bayes_aero.inference.results import OutputErrorStatus
from bayes_aero.jobs import fly as job
from bayes_aero.jobs.results import RESULTS
from bayes_aero.jobs.store import provenance
from bayes_aero.report.page import Fold, HtmlTable, Plot, page_table, put_page, render
from bayes_aero.report.pages.fly import error_table, fly_page, initial_table, motion_sentences, parameter_table
from bayes_aero.report.pages.parts import PageContext, at_a_glance
from bayes_aero.report.pages.study import MOST_UNITS, estimates, study_headline, study_page
from bayes_aero.report.plots import AXIS, HIGHEST, LOW, Line, Panel, linked

DEGREE = np.deg2rad(1.0)


def context(said=("The fit converged.", "A finding."), **more):
    result = replace(flight(), sentences=said, notes=("A note.",), **more)
    return PageContext(CARD, records(), provenance(CARD, records(), 0, {"windows": 12.0}), {}, result)


def blocks_of(page, key):
    return next(s.blocks for s in page.sections if s.key == key)


def test_every_part_is_made_and_nothing_else():
    page = fly_page(flight().flown, context(motion=None))
    assert not [b for s in page.sections for b in s.blocks if "was not made" in getattr(b, "text", "")]
    assert [s.key for s in page.sections] == ["findings", "records", "fit", "errors", "parameters", "provenance"]
    assert page.verdict == "The fit converged."
    assert blocks_of(page, "findings")[0].items == ("A finding.", "A note.")
    assert [b.title for b in blocks_of(page, "fit") if isinstance(b, Plot)] == ["one", "two"]
    assert all(isinstance(b, Fold) for b in blocks_of(page, "provenance"))  # folded away
    html = render(page)
    holds(html, *SHORT_PERIOD_TRUTH)


def test_parameters_stand_with_both_deviations_and_their_bounds():
    flown = flight().flown
    table = page_table(parameter_table(flown))
    assert {row[0].split()[0] for row in table.rows} == set(SHORT_PERIOD_TRUTH)
    for row in table.rows:
        name, first, fit, crb, corrected, prior, bounds, remark = row
        truth = SHORT_PERIOD_TRUTH[name.split()[0]]
        assert abs(float(fit) - truth) < 4.0 * max(float(crb), float(corrected)), name
        assert float(first) == 0.0  # the card gives no start
        assert prior == "0 ± 1000, default"
        assert bounds == ("-40 to 0" if name.startswith("Mde ") else "none")
        assert remark == "–"
    units = [row[0] for row in table.rows if row[0].startswith("M")]
    assert units == ["M0 [rad/s²]", "Malpha [1/s²]", "Mq [1/s]", "Mde [1/s²]"]
    still = page_table(parameter_table(replace(flown, fit=replace(flown.fit, at_bound=("Mde",)))))
    assert [row[0] for row in still.rows if row[-1] == "at its bound"] == ["Mde [1/s²]"]


def test_numbers_of_a_fit_that_failed_are_warned_of_first():
    flown = flight().flown
    failed = replace(flown.fit, status=OutputErrorStatus.LEFT_ENVELOPE, covariance=1e40 * flown.fit.covariance)
    page = fly_page(replace(flown, fit=failed), context(("The fit failed: it left.",)))
    assert [block.tone for block in page.lead] == ["warning"]
    assert "Do not use the numbers" in page.lead[0].text
    estimates = [row[2] for row in blocks_of(page, "parameters")[0].rows]
    assert all(float(text) == pytest.approx(x, rel=0.01) for text, x in zip(estimates, failed.estimate, strict=True))
    assert fly_page(flown, context()).lead[0].tone == "lead"


def test_errors_of_a_known_offset():
    """Simulated is measured plus a constant: that is the RMS, the largest error, and all of it is bias."""
    flown = with_offsets(flight().flown, {"one": 100, "two": 300}, {"one": 2.0 * DEGREE, "two": -1.5 * DEGREE})
    rows = page_table(error_table(flown)).rows
    assert [row[0] for row in rows] == ["one", "α [deg]", "two", "α [deg]"]
    assert rows[1][1:4] == ("4.0", "2.0", "2.0")
    assert rows[1][5:8] == ("100%", "0%", "0%")
    assert rows[3][1:4] == ("3.0", "1.5", "1.5")
    (before, after) = flown.rms_errors["alpha"]
    assert after / DEGREE == pytest.approx(np.sqrt((100 * 2.0**2 + 300 * 1.5**2) / 400))
    assert before == pytest.approx(2.0 * after)
    assert [row[8:] for row in rows if row[0].startswith("α")] == [("± 2", "0%", "100%")] * 2
    alone = page_table(error_table(with_offsets(flight().flown, {"one": 200}, {"one": DEGREE})))
    assert [row[0] for row in alone.rows] == ["α [deg]"]  # no heading above a single manoeuvre


def test_without_tolerances_there_is_no_band():
    flown = with_offsets(flight().flown, {"one": 200}, {"one": DEGREE})
    assert "tolerance" in str([b.legend for b in blocks_of(fly_page(flown, context()), "fit") if isinstance(b, Plot)])
    without = {"tolerance": None, "within": None}
    free = tuple(replace(p, errors={n: replace(e, **without) for n, e in p.errors.items()}) for p in flown.paths)
    page = fly_page(replace(flown, paths=free), context())
    assert "tolerance" not in page_table(error_table(replace(flown, paths=free))).head
    assert "tolerance" not in str([b for b in blocks_of(page, "fit") if not isinstance(b, Plot)])
    assert "tolerance" not in str([b.legend for b in blocks_of(page, "fit") if isinstance(b, Plot)])


def test_a_simulation_that_is_lost_leaves_the_page_whole():
    """First values that fly to infinity: a gap in the curve, a dash in the tables, no warning."""
    flown = with_offsets(flight().flown, {"one": 200}, {"one": DEGREE})
    infinite, nothing = float("inf"), TheilParts(*[float("nan")] * 4)
    paths = tuple(
        replace(
            p,
            simulated={"alpha": np.geomspace(1.0, 1e308, 200)},
            errors={n: replace(e, rms=infinite, largest=infinite, theil=nothing) for n, e in p.errors.items()},
        )
        for p in flown.paths
    )
    lost = replace(flown, paths=paths)
    assert page_table(error_table(lost)).rows[0][1:8] == ("–",) * 7
    page = fly_page(lost, context())
    assert not [b for s in page.sections for b in s.blocks if "was not made" in getattr(b, "text", "")]
    assert "first values → fit: α\u00a0–" in page.lead[0].text


def test_first_states_are_those_flown_and_a_linear_card_shows_its_own_channels():
    rows = {row[0]: row[1:] for row in page_table(initial_table(flight().flown)).rows[:3]}
    assert list(rows) == ["one", "α [deg]", "q [deg/s]"]
    assert float(rows["α [deg]"][0]) * DEGREE == pytest.approx(0.04, abs=0.002)
    assert float(rows["q [deg/s]"][0]) * DEGREE == pytest.approx(0.0, abs=0.003)
    measured = flight().flown.path("one", "start").simulated["alpha"][0]
    assert float(rows["α [deg]"][1]) * DEGREE == pytest.approx(float(rows["α [deg]"][0]) * DEGREE - measured, abs=1e-4)
    (table,) = (b for b in at_a_glance(records(), CARD) if isinstance(b, HtmlTable))
    heads = [head.replace("\n", " ") for head in table.head[5:]]
    assert heads == ["α [deg]", "q [deg/s]", "az [m/s²]", "δe [deg]"]


@pytest.mark.parametrize("name", ["q", "aileron_right", "flow_angle_of_the_right_wing", 40 * "long_"])
def test_a_label_is_never_longer_than_its_panel(name):
    """A letter of 13 pixels is some 7 wide; no name makes a panel higher than two."""
    item = linked(np.arange(3.0), [Panel(name, "deg", (Line("x", "#000000", np.arange(3.0)),), height=LOW)], "t")
    (panel,) = item["panels"]
    label, height = panel["label"], panel["height"] - AXIS
    assert label.replace("\n", " ") == f"{name} [deg]"
    assert LOW <= height <= HIGHEST
    assert height == HIGHEST or 7.0 * max(map(len, label.split("\n"))) <= height
    assert (height == LOW) == (len(name) < 15)


def test_a_page_that_fails_is_told_and_costs_no_number(tmp_path, monkeypatch):
    def fails(*_):
        raise ValueError("no such luck")

    flown = flight().flown  # before what fits it is replaced
    monkeypatch.setattr(job, "output_error_fit", lambda *_, **__: flown)
    monkeypatch.setattr(job, "fly_page", fails)
    found = job.fly(records(), CARD, out=tmp_path, figures=False)
    said = "report.html was not written: ValueError: no such luck"
    assert found.failures[-1].startswith(said)
    assert json.loads((tmp_path / RESULTS).read_text())["failures"] == list(found.failures)
    assert not (tmp_path / "report.html").exists()
    monkeypatch.undo()
    monkeypatch.setattr(job, "output_error_fit", lambda *_, **__: flown)
    found = job.fly(records(), CARD, out=tmp_path, figures=False)
    assert (found.notes, found.failures) == ((), ())
    assert not (tmp_path / "error.txt").exists()  # of the run before
    assert "The fit converged;" in (tmp_path / "report.html").read_text()


MODES = (
    FlownMode(
        "Dutch roll", -0.18 + 1.64j, (0.004, 0.006), {"period": (3.831, 0.014), "damping_ratio": (0.1091, 0.0024)}
    ),
    FlownMode("roll", -1.4 + 0.0j, (0.03, 0.0), {"time_constant": (0.714, 0.015), "time_to_half": (0.495, 0.011)}),
    FlownMode("spiral", 0.001 + 0.0j, (0.02, 0.0), {}),
)
MOTION = Motion(120.0, 4000.0, MODES)


def test_modes_stand_on_the_page_and_what_motion_lacks_is_said():
    page = fly_page(flight().flown, context(motion=MOTION))
    (modes,) = blocks_of(page, "motion")
    assert [row[:3] for row in modes.rows] == [
        ("Dutch roll", "period, s", "3.831(14)"),
        ("Dutch roll", "damping ratio", "0.1091(24)"),
        ("roll", "time constant, s", "0.714(15)"),
        ("spiral", "neither grows nor falls beyond its error", "–"),
    ]
    assert "at 120 m/s and 4000 m" in modes.note
    (said,) = motion_sentences(MOTION)
    assert "spiral" in said
    (said,) = motion_sentences(replace(MOTION, modes=(), why_not="no trim"))
    assert "no trim" in said
    assert motion_sentences(None) == []


def test_scatter_and_claims_are_those_of_the_values(tmp_path):
    given = study_told(tmp_path, n=40)
    CLa, alpha_star = estimates(given.units, given.results)
    mine = given.results[given.results["parameter"] == "CLa"]["value"]
    assert CLa.scatter == pytest.approx(mine.std())
    assert CLa.claimed == pytest.approx(0.1)
    assert list(CLa.rows["number"]) == list(range(1, 41))
    text = render(study_page(given))
    assert f"CLa ({CLa.scatter / 0.1:.1f} times)" in text
    assert alpha_star.scatter < 1.5 * alpha_star.claimed
    assert "alpha_star (" not in text
    ratio = f"{CLa.scatter / 0.1:.1f} times its intervals"
    assert study_headline(given) == f"All 40 units are done; all converged; CLa differs between units by {ratio}."


def test_the_verdict_of_diagnoses_counts_verdicts_and_names_the_commonest_cause(tmp_path):
    given = study_told(tmp_path)
    verdicts = ["explained"] * 5 + ["no_effect"] * (N - 5)
    causes = ["thrust_scale"] * 4 + ["alpha_bias"]
    rows = given.results[given.results["parameter"] == "alpha_star"].iloc[:5]
    results = rows.assign(cause=causes, parameter=causes, method="coefficients")
    named = replace(given, task="diagnose", units=given.units.assign(verdict=verdicts), results=results)
    first, *said = study_headline(named).rstrip(".").split("; ")
    assert first == f"All {N} units are done"
    assert said[:2] == [f"5 explained and {N - 5} no effect", f"thrust_scale is named in 4 of {N}"]


def test_units_that_failed_or_are_in_doubt_are_named_with_their_reason(tmp_path):
    page = study_page(study_told(tmp_path, failed=(4,)))
    assert page.verdict.startswith(f"{N - 1} of {N} units are done (1 failed); all converged; ")
    (units,) = next(s.blocks for s in page.sections if s.key == "units")
    assert units.rows[0][:3] == ("flight5-<b>", "5", "failed")
    assert units.rows[0][-2] == "no samples"
    assert [row[1] for row in units.rows[1:]] == [str(k) for k in (1, 2, 3, 4, 6, 7)]
    page = study_page(study_told(tmp_path))
    assert "Records are in doubt in 1 of 7 units: flight2-&lt;b&gt;: the sensors disagree." in render(page)


def test_a_unit_leads_to_its_own_page_and_nothing_else_to_anywhere(tmp_path):
    (tmp_path / "units" / "flight2-<b>").mkdir(parents=True)
    (tmp_path / "units" / "flight2-<b>" / "report.html").write_text("x")
    text = render(study_page(study_told(tmp_path)))
    assert text.count('href="units/') == 1
    assert 'href="units/flight2-%3Cb%3E/report.html"' in text
    assert "<b>" not in text


def test_a_study_in_which_nothing_was_done_has_a_page_and_a_large_one_says_what_it_leaves_out(tmp_path):
    page = study_page(study_told(tmp_path, failed=range(N)))
    assert page.verdict == f"0 of {N} units are done ({N} failed)."
    assert page.lead == ()
    assert put_page(lambda: page, tmp_path) == ()
    page = study_page(study_told(tmp_path, n=MOST_UNITS + 30))
    (units,) = next(s.blocks for s in page.sections if s.key == "units")
    assert len(units.rows) == MOST_UNITS
    assert "30 more" in units.note
    assert len(render(page)) < 1_000_000
