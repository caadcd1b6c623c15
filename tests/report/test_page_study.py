"""The page of a study: what it says of its units is what their tables hold."""

from __future__ import annotations

from dataclasses import replace

import pytest
from study_samples import N, told

from bayes_aero.report.html.page import put_page, render
from bayes_aero.report.pages.study import MOST_UNITS, study_headline, study_page
from bayes_aero.report.tables.across_cases import estimates


def test_scatter_and_claims_are_those_of_the_values(tmp_path):
    given = told(tmp_path, n=40)
    CLa, alpha_star = estimates(given.units, given.results)
    mine = given.results[given.results["parameter"] == "CLa"]["value"]
    assert CLa.scatter == pytest.approx(mine.std())
    assert CLa.claimed == pytest.approx(0.1)
    assert list(CLa.unit) == list(range(1, 41))
    text = render(study_page(given))
    assert f"CLa ({CLa.scatter / 0.1:.1f} times)" in text
    assert alpha_star.scatter < 1.5 * alpha_star.claimed
    assert "alpha_star (" not in text
    ratio = f"{CLa.scatter / 0.1:.1f} times its intervals"
    assert study_headline(given) == f"All 40 units are done; all converged; CLa differs between units by {ratio}."


def test_the_verdict_of_diagnoses_counts_verdicts_and_names_the_commonest_cause(tmp_path):
    given = told(tmp_path)
    verdicts = ["explained"] * 5 + ["no_effect"] * (N - 5)
    causes = ["thrust_scale"] * 4 + ["alpha_bias"]
    rows = given.results[given.results["parameter"] == "alpha_star"].iloc[:5]
    named = replace(
        given,
        task="diagnose",
        units=given.units.assign(verdict=verdicts),
        results=rows.assign(cause=causes, parameter=causes, method="coefficients"),
    )
    first, *said = study_headline(named).rstrip(".").split("; ")
    assert first == f"All {N} units are done"
    assert said[:2] == [f"5 explained and {N - 5} no effect", f"thrust_scale is named in 4 of {N}"]


def test_units_that_failed_come_first_with_their_reason(tmp_path):
    page = study_page(told(tmp_path, failed=(4,)))
    assert page.verdict.startswith(f"{N - 1} of {N} units are done (1 failed); all converged; ")
    (units,) = next(s.blocks for s in page.sections if s.key == "units")
    assert units.rows[0][:3] == ("flight5-<b>", "5", "failed")
    assert units.rows[0][-1] == "no samples"
    assert [row[1] for row in units.rows[1:]] == [str(k) for k in (1, 2, 3, 4, 6, 7)]


def test_a_unit_whose_records_are_in_doubt_is_named(tmp_path):
    page = study_page(told(tmp_path))
    assert "Records are in doubt in 1 of 7 units: flight2-&lt;b&gt;: the sensors disagree." in render(page)


def test_a_unit_leads_to_its_own_page_and_nothing_else_to_anywhere(tmp_path):
    (tmp_path / "units" / "flight2-<b>").mkdir(parents=True)
    (tmp_path / "units" / "flight2-<b>" / "report.html").write_text("x")
    text = render(study_page(told(tmp_path)))
    assert text.count('href="units/') == 1
    assert 'href="units/flight2-%3Cb%3E/report.html"' in text
    assert "<b>" not in text


def test_a_study_in_which_nothing_was_done_has_a_page(tmp_path):
    page = study_page(told(tmp_path, failed=range(N)))
    assert page.verdict == f"0 of {N} units are done ({N} failed)."
    assert page.lead == ()
    assert put_page(lambda: page, tmp_path) == ()


def test_a_large_study_says_what_it_leaves_out(tmp_path):
    page = study_page(told(tmp_path, n=MOST_UNITS + 30))
    (units,) = next(s.blocks for s in page.sections if s.key == "units")
    assert len(units.rows) == MOST_UNITS
    assert "30 more" in units.note
    assert len(render(page)) < 1_000_000
