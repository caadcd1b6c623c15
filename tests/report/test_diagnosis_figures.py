"""Figures, tables and words of a diagnosis: complete, with units, and true to its numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from bayes_aero.diagnosis.result import UnexplainedStructure, Verdict
from bayes_aero.diagnosis.screening.accuracy import sizes
from bayes_aero.diagnosis.view.models import with_stalls
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.report.figures.diagnosis import autocorrelation
from bayes_aero.report.figures.every_figure import DIAGNOSIS_FIGURES, draw_all
from bayes_aero.report.figures.found import telling
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.pages.captions import diagnosis_alternatives
from bayes_aero.report.style import NotDrawn, close, save
from bayes_aero.report.tables.diagnosis_tables import causes_table, probability, screen_table
from bayes_aero.report.text.diagnosis import revealed, sentences
from bayes_aero.report.text.phrases import size_text

DOES_NOT_APPLY = {"gain", "moves", "trajectories_hold_out", "trajectories_fitted"}  # nothing was added or flown


@pytest.fixture(scope="module")
def nothing(diagnosed):
    """The same diagnosis as if nothing had been found."""
    view = diagnosed.view
    empty = replace(view.diagnosis, verdict=Verdict.NO_EFFECT, causes=(), unknown=(), sensors=None)
    state = replace(view.extended.state, active=())
    return with_stalls(replace(view, diagnosis=empty, extended=replace(view.card, state=state)))


@pytest.mark.parametrize("split", ["fitted", "hold_out"])
def test_simulated_trajectories_are_told_in_numbers(flown, split):
    figure = DIAGNOSIS_FIGURES[f"trajectories_{split}"](flown)
    texts = [text.get_text() for text in figure.axes[2].texts]
    assert texts == ["RMS: card's 1.0, extended 0.10"]  # alpha in deg
    close(figure)


def test_an_error_of_a_sensor_is_shown_where_it_shows(flown):
    """Coefficients may not show it: the simulated output whose error falls most, with the errors that are told."""
    sensor, model = (
        replace(flown, diagnosis=replace(flown.diagnosis, causes=(replace(flown.diagnosis.causes[0], stage=stage),)))
        for stage in ("flight path", "coefficients")
    )
    assert telling(model).quantity in NAMES
    shown = telling(sensor)
    card, extended = (flown.trajectories.path(shown.manoeuvre, m, "fitted") for m in ("card", "extended"))
    falls = {n: card.errors[n].rms / extended.errors[n].rms for n in flown.trajectories.outputs}
    assert falls[shown.quantity] == max(falls.values())
    for path, (_, _, values, note) in zip((card, extended), shown.simulated, strict=True):
        rms = np.sqrt(np.mean((values - shown.measured) ** 2))
        assert float(note.split()[2]) == pytest.approx(rms, rel=0.06), path.model
    assert telling(replace(sensor, trajectories=None)).quantity in NAMES


def test_alternative_texts_are_sentences_about_what_is_shown(flown):
    shown = telling(flown)
    texts = diagnosis_alternatives(flown)
    assert texts.keys() <= DIAGNOSIS_FIGURES.keys()
    for stem in ("found", "measured_simulated"):
        assert shown.quantity in texts[stem][1]
        assert shown.manoeuvre in texts[stem][1]
    assert not any("array(" in text or "Telling" in text for pair in texts.values() for text in pair)


@pytest.mark.parametrize("stem", DIAGNOSIS_FIGURES)
def test_every_figure_draws_complete(stem, flown, tmp_path):
    figure = DIAGNOSIS_FIGURES[stem](flown)
    for ax in figure.axes:
        assert ax.has_data(), "empty axes"
        labels = [text for text in (ax.get_xlabel(), ax.get_ylabel()) if text]
        assert all("[" in text and "]" in text for text in labels), labels
        assert "rad]" not in "".join(labels)
    assert any(ax.get_xlabel() for ax in figure.axes)
    pixels = imread(save(figure, tmp_path / f"{stem}.png"))
    assert min(pixels.shape[:2]) > 300
    assert pixels[..., :3].std() > 0.01


@pytest.mark.parametrize("stem", ["found", "found_narrow"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_sizes_of_a_cause_stay_within_the_figure(stem, count, flown, tmp_path):
    """However many parameters it has: the bar may be as long as the panel, or short."""
    first, *others = flown.diagnosis.causes
    size = next(iter(first.parameters.values()))
    many = replace(first, parameters={f"parameter_{k}": replace(size, unit="rad") for k in range(count)})
    view = replace(flown, diagnosis=replace(flown.diagnosis, causes=(many, *others)))
    figure = DIAGNOSIS_FIGURES[stem](view)
    figure.draw_without_rendering()
    (panel,) = (ax for ax in figure.axes if ax.get_title().startswith("First screening"))
    texts = [text for text in panel.texts if "±" in text.get_text()]
    assert texts
    for text in texts:
        assert panel.bbox.x0 <= text.get_window_extent().x0
        assert text.get_window_extent().x1 <= figure.bbox.x1
    assert panel.bbox.width > 0.4 * figure.axes[0].bbox.width
    save(figure, tmp_path / f"{stem}.png")


def test_figures_without_a_cause(nothing, tmp_path):
    written, failed = draw_all(DIAGNOSIS_FIGURES, nothing, tmp_path)
    assert not failed
    assert {path.stem for path in written} == DIAGNOSIS_FIGURES.keys() - DOES_NOT_APPLY
    with pytest.raises(NotDrawn):
        DIAGNOSIS_FIGURES["gain"](nothing)


def test_measured_is_the_same_line_before_and_after(diagnosed):
    figure = DIAGNOSIS_FIGURES["measured_simulated"](diagnosed.view)
    first, second = (figure.axes[i].lines[0].get_ydata() for i in (0, 1))
    assert np.array_equal(first, second)
    close(figure)


def test_shares_of_the_mean_square_error_add_up(diagnosed):
    view = diagnosed.view
    for fitted in (view.card, view.extended):
        for numbers in fitted.composition.values():
            shares = [numbers[f"theil_{part}"] for part in ("bias", "variance", "covariance")]
            assert sum(shares) == pytest.approx(1.0)
            levels = [numbers["calibration"][level] for level in ("0.5", "0.9", "0.95")]
            assert levels == sorted(levels)


def test_the_extension_explains_more(diagnosed):
    view = diagnosed.view
    before, after = view.card.composition, view.extended.composition
    assert after["Cm"]["r2"] > before["Cm"]["r2"]


def test_candidates_are_ranked_once_each(diagnosed):
    for ranking in diagnosed.view.rankings:
        names = [s.effect for s in ranking.candidate_scores]
        assert len(names) == len(set(names))
        scores = [s.score for s in ranking.candidate_scores]
        assert scores == sorted(scores, reverse=True)


def test_tables_hold_every_cause_and_candidate(diagnosed):
    d, rankings = diagnosed.view.diagnosis, diagnosed.view.rankings
    assert set(causes_table(d).frame()["cause"]) == {c.name for c in d.causes}
    assert causes_table(d).terminal().row_count == len(d.causes)
    assert len(screen_table(rankings, d).frame()) == sum(len(r.candidate_scores) for r in rankings)


def test_a_cause_of_two_parameters_has_a_row_for_each_in_a_file_and_one_for_people(diagnosed):
    cause = diagnosed.view.diagnosis.causes[0]
    (size,) = cause.parameters.values()
    both = replace(cause, parameters={"one": size, "other": replace(size, mean=3.0 * size.mean)})
    table = causes_table(replace(diagnosed.view.diagnosis, causes=(both,)))
    rows = table.frame()
    assert list(rows["parameter"]) == ["one", "other"]
    assert list(rows["mean"]) == [size.mean, 3.0 * size.mean]
    assert list(rows["probability"]) == [cause.probability] * 2
    (row,) = page_table(table).rows
    assert row[2].split("; ")[1] == f"other {size_text(3.0 * size.mean, size.sd, size.unit)}"


def test_of_six_coefficients_a_terminal_shows_the_three_that_change_most(diagnosed):
    cause = diagnosed.view.diagnosis.causes[0]
    score = next(iter(cause.gain.before.values()))
    change = {"CL": 0.01, "CD": 0.3, "Cm": 0.0, "CY": -0.2, "Cl": float("nan"), "Cn": 0.1}
    before = {name: replace(score, r2=0.5) for name in change}
    after = {name: replace(score, r2=0.5 + by) for name, by in change.items()}
    six = replace(cause, gain=replace(cause.gain, before=before, after=after))
    table = causes_table(replace(diagnosed.view.diagnosis, causes=(six,)))
    heads = [str(column.header) for column in table.terminal().columns]
    assert [h for h in heads if h.startswith("R²")] == ["R² CD", "R² CY", "R² Cn"]
    assert {f"{name}_r2_after" for name in change} <= set(table.frame())


def test_without_a_cause_sentences_say_so(nothing):
    assert causes_table(nothing.diagnosis).frame().empty
    assert sentences(nothing)[0].startswith("No significant model error")


def test_words_name_cause_rivals_and_what_is_unexplained(diagnosed):
    view = diagnosed.view
    cause = replace(view.diagnosis.causes[0], ambiguous_with=("mass_scale",), excited=False)
    unknown = (UnexplainedStructure("Cm", "phi", 0.25, 0.01),)
    d = replace(
        view.diagnosis,
        verdict=Verdict.PARTLY_EXPLAINED,
        causes=(cause,),
        unknown=unknown,
        minor=("alpha_delay",),
        not_testable={"flap_moment": "channel flap does not move in this record"},
    )
    text = " ".join(sentences(replace(view, diagnosis=d)))
    for part in (cause.name, cause.claim, "mass_scale", "Cm", "phi", "25%", "alpha_delay", "flap"):
        assert part in text
    unexplained = replace(d, verdict=Verdict.UNEXPLAINED, causes=())
    assert "no effect of the catalogue" in sentences(replace(view, diagnosis=unexplained))[0]


def test_a_size_on_its_bound_is_no_measurement(diagnosed):
    """The fit's estimate is put where a fit ends that wants to go beyond the bounds."""
    view = diagnosed.view
    cause, extension, name = view.diagnosis.causes[0], view.diagnosis.aerodynamics, "e"
    state = extension.state
    column = int(state.full.columns([name])[0])
    theta = state.theta.copy()
    theta[column] = state.full.model.free[column].bounds[1] - 1e-9
    found = sizes(replace(state, theta=theta), extension.fit)
    assert [n for n, size in found.items() if size.at_bound] == [name]
    assert not any(size.at_bound for size in extension.sizes.values())
    held = replace(cause, parameters={name: found[name]})
    said = " ".join(sentences(replace(view, diagnosis=replace(view.diagnosis, causes=(held,)))))
    assert f"{name} is at a parameter bound" in said
    assert "at a parameter bound" not in " ".join(sentences(view))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ((0.01, 0.001, "rad"), "0.573 ± 0.057 deg"),
        ((1.5, 20.0, "m/s"), "2 ± 20 m/s"),
        ((-0.0806, 0.0043, "1"), "-0.0806 ± 0.0043"),
        ((0.5, 0.0, "1"), "0.5"),
        ((0.5, float("nan"), "s"), "0.5 s"),
    ],
)
def test_sizes_as_people_read_them(given, text):
    assert size_text(*given) == text


def test_probability_is_never_rounded_to_certainty():
    assert [probability(x) for x in (1.0, 0.646)] == ["> 0.99", "0.65"]


def test_what_was_hidden_is_revealed_with_its_size():
    (said,) = revealed({"alpha_bias": {"alpha_bias": 0.01}}, {"alpha_bias": "missed"})
    assert "alpha_bias" in said
    assert "0.573 deg" in said
    assert "not found" in said


def test_autocorrelation_of_a_period():
    x = np.sin(2.0 * np.pi * np.arange(1000) / 20.0)
    lags, r = autocorrelation([x, x], 30)
    assert r[0] == 1.0
    assert r[10] == pytest.approx(-1.0, abs=0.03)
    assert lags[-1] == 30
