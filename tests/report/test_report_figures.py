"""Figures draw, on results of several shapes, with labels, units and no empty axes; what they and their words say."""

from dataclasses import replace
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from calling import holds
from matplotlib.figure import Figure
from matplotlib.image import imread

from bayes_aero.diagnosis.diagnose import with_stalls
from bayes_aero.diagnosis.result import UnexplainedStructure, Verdict
from bayes_aero.diagnosis.selection import sizes
from bayes_aero.inference.sampling import pit_of
from bayes_aero.model.observations import Colour
from bayes_aero.physics.aircraft import NAMES
from bayes_aero.report.figures.diagnosis import autocorrelation, telling
from bayes_aero.report.figures.every_figure import DIAGNOSIS_FIGURES, FIGURES, draw_all
from bayes_aero.report.figures.posterior import pit_histogram
from bayes_aero.report.figures.time_histories import broken, predicted
from bayes_aero.report.pages.diagnosis import causes_table, probability, revealed, screen_table, sentences
from bayes_aero.report.phrases import size_text, symbol
from bayes_aero.report.style import NotDrawn, close

SLOW = {"trace_emcee", "trace_nuts", "rank_emcee", "rank_nuts", "pair", "pit"}
TWINS = ("fig6", "fig7", "fig8", "fig9", "trace_nuts", "rank_nuts")  # of another coefficient or sampler
OF_LATERAL = {f"{kind}_{name}" for kind in ("validation", "correlation") for name in ("CY", "Cl", "Cn")}
SIGMA = 0.005  # of the noise of the sample runs, which is white


def complete(figure: Figure) -> None:
    """No empty axes; a label on the outer ones, with a unit in brackets; nothing fails as it is drawn."""
    assert figure.axes
    for ax in figure.axes:
        assert ax.has_data(), "empty axes"
        labels = [text for text in (ax.get_xlabel(), ax.get_ylabel()) if text]
        assert all(("[" in text and "]" in text) or text == "density" for text in labels), labels
        place = ax.get_subplotspec()
        if place is not None and place.is_last_row():
            assert ax.get_xlabel(), "no x label"
        if place is not None and place.is_first_col():
            assert ax.get_ylabel() or any(t.get_text().strip() for t in ax.get_yticklabels()), "no y label"
    figure.draw_without_rendering()


@pytest.mark.parametrize("stem", [stem for stem in FIGURES if stem not in OF_LATERAL and not stem.startswith(TWINS)])
def test_every_figure_draws_complete(stem, full):
    complete(FIGURES[stem](full))


@pytest.mark.parametrize("stem", ["validation_Cn", "correlation_CY"])
def test_figures_of_lateral_coefficients_are_for_models_that_have_them(stem, full):
    with pytest.raises(NotDrawn, match="the model has no C"):
        FIGURES[stem](full)
    coefficients = ("CL", "CD", stem[-2:])  # the third one by another name
    complete(FIGURES[stem](replace(full, gp=None, observations=replace(full.observations, coefficients=coefficients))))


def test_the_registry_has_the_papers_nine_and_what_can_be_shown_without_posteriors_is(make, tmp_path):
    paper = [stem for stem in FIGURES if stem.startswith("fig")]
    assert [stem[:5] for stem in paper] == [f"fig{i}_" for i in range(1, 10)]
    for part in ("trace", "rank", "pair", "pit", "forest", "prior_posterior", "gp_prior_posterior", "crb_vs_credible"):
        assert any(stem.startswith(part) for stem in FIGURES)
    written, failed = draw_all(FIGURES, make(manoeuvres=1, engines=(), gp=False), tmp_path)
    assert not failed
    stems = {path.stem for path in written}
    holds(stems, "fig3_validation_CL", "forest")
    for path in written:
        pixels = imread(path)
        assert min(pixels.shape[:2]) > 300
        assert pixels[..., :3].std() > 0.01  # it shows something
    assert stems.isdisjoint(SLOW | {"fig2_gpr_fit", "prior_posterior", "gp_prior_posterior"})


def test_many_manoeuvres(make):
    run = make(manoeuvres=5)
    for stem in ("fig1_time_history", "fig3_validation_CL", "forest", "crb_vs_credible"):
        complete(FIGURES[stem](run))


def test_a_figure_that_fails_is_named_and_leaves_the_others(full, tmp_path):
    def bad(_):
        raise ValueError("no such luck")

    def empty(_):
        raise NotDrawn("nothing there")

    few = {"first": FIGURES["fig1_time_history"], "bad": bad, "empty": empty, "last": FIGURES["forest"]}
    steps = []
    written, failed = draw_all(few, full, tmp_path / "new", progress=lambda text, share: steps.append((text, share)))
    (failure,) = failed
    assert failure.startswith("Figure bad was not drawn: ValueError: no such luck. This")
    assert [path.name for path in written] == ["first.png", "last.png"]
    assert sorted((tmp_path / "new").iterdir()) == written
    assert steps[-1] == ("figures", 1.0)


def test_neither_backend_nor_settings_nor_open_figures_of_the_user_change(full):
    plt.switch_backend("agg")
    before = dict(matplotlib.rcParams)
    figure = FIGURES["trace_nuts"](full)
    close(figure)
    assert dict(matplotlib.rcParams) == before
    assert not plt.get_fignums()


def test_predictions_follow_the_test_points_or_all_samples_and_lines_break_at_gaps(full, make):
    points = predicted(full, "CD")
    test = full.gp.splits["random"][0]["CD"]
    assert np.array_equal(points.index, test.test)
    assert np.array_equal(points.gp, test.gp)
    t, y = broken(np.array([0.0, 0.1, 5.0]), np.array([1.0, 2.0, 3.0]))
    assert np.isnan(t[2])
    assert np.array_equal(y, [1.0, 2.0, np.nan, 3.0], equal_nan=True)
    run = make(gp=False)
    points = predicted(run, "CL")
    alpha, elevator = (np.asarray(run.observations.signals[k]) for k in ("alpha", "elevator"))
    chord, arm = run.card.aircraft.chord, run.card.aircraft.tail_arm
    assert "gp" not in points
    assert np.allclose(points.mle, 0.2 + 4.0 * alpha + 0.8 * chord / arm * elevator)


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_the_title_says_how_neighbours_correlate(make, rho):
    """A correlation of 0.9 taken out of white samples leaves neighbours tied by -0.9/(1 + 0.81)."""
    run = make(manoeuvres=2, gp=False, noise=Colour.AR1, engines=("emcee",), width=1e-3)
    posterior = run.posteriors["emcee"]
    draws = posterior.tree["posterior"].to_dataset()  # all of the true noise, which is white
    values = {"sigma": SIGMA, "rho": rho}
    draws = draws.assign({n: 0.0 * draws[n] + values[n.split("_")[0]] for n in draws if n.split("_")[0] in values})
    tree = posterior.tree.copy()
    tree["posterior"] = type(tree["posterior"])(draws)
    run = replace(run, posteriors={"emcee": replace(posterior, tree=tree)})
    pit: Any = pit_of(run)
    if rho == 0.9:
        assert np.mean(pit.correlation) == pytest.approx(-0.9 / 1.81, abs=0.15)
    else:
        assert pit.values.shape[1] == 3
        assert all(bars.outside == 0 for bars in pit.bars)
    titles = [ax.get_title() for ax in pit_histogram(replace(run, pit=pit)).axes]
    assert titles == [f"{n}: neighbours correlate {r:+.2f}" for n, r in zip(NAMES, pit.correlation, strict=True)]


def test_an_error_of_a_sensor_is_shown_where_it_shows(flown):
    """Coefficients may not show it: the simulated output whose error falls most, with its errors in numbers."""
    sensor, model = (
        replace(flown, diagnosis=replace(flown.diagnosis, causes=(replace(flown.diagnosis.causes[0], stage=stage),)))
        for stage in ("flight path", "coefficients")
    )
    assert telling(model)[0].name in NAMES
    panel, manoeuvre, _ = telling(sensor)
    card, extended = (flown.trajectories.path(manoeuvre, m, "fitted").errors for m in ("card", "extended"))
    assert panel.name == symbol(max(card, key=lambda n: card[n].rms / extended[n].rms))
    measured, *simulated = panel.lines
    sizes = [float(size) for size in panel.note.removeprefix("RMS error ").split(" → ")]
    rms = [np.sqrt(np.mean((line.values - measured.values) ** 2)) for line in simulated]
    assert sizes == pytest.approx(rms, rel=0.06)
    assert telling(replace(sensor, trajectories=None))[0].name in NAMES


@pytest.mark.parametrize("stem", DIAGNOSIS_FIGURES)
def test_every_figure_of_a_diagnosis_draws_complete(stem, flown):
    figure = DIAGNOSIS_FIGURES[stem](flown)
    for ax in figure.axes:
        assert ax.has_data(), "empty axes"
        labels = [text for text in (ax.get_xlabel(), ax.get_ylabel()) if text]
        assert all("[" in text and "]" in text and "rad]" not in text for text in labels), labels
    assert any(ax.get_xlabel() for ax in figure.axes)
    figure.draw_without_rendering()


def test_figures_table_and_sentences_without_a_cause(diagnosed, tmp_path):
    """The same diagnosis as if nothing had been found, added or simulated."""
    view = diagnosed.view
    empty = replace(view.diagnosis, verdict=Verdict.NO_EFFECT, causes=(), unknown=(), sensors=None)
    state = replace(view.extended.state, active=())
    nothing = with_stalls(replace(view, diagnosis=empty, extended=replace(view.card, state=state)))
    written, failed = draw_all(DIAGNOSIS_FIGURES, nothing, tmp_path)
    assert not failed
    assert {path.stem for path in written} == DIAGNOSIS_FIGURES.keys() - {"gain", "trajectories_hold_out"}
    assert causes_table(empty).frame().empty
    assert "No significant model error" in sentences(nothing.diagnosis)[0]


def test_shares_of_the_mean_square_error_add_up_and_the_extension_explains_more(diagnosed):
    view = diagnosed.view
    for fitted in (view.card, view.extended):
        for numbers in fitted.composition.values():
            assert sum(numbers[f"theil_{part}"] for part in ("bias", "variance", "covariance")) == pytest.approx(1.0)
            levels = [numbers["calibration"][level] for level in ("0.5", "0.9", "0.95")]
            assert levels == sorted(levels)
    assert view.extended.composition["Cm"]["r2"] > view.card.composition["Cm"]["r2"]
    figure = DIAGNOSIS_FIGURES["measured_simulated"](view)
    measured, *simulated = (np.asarray(line.get_ydata()) for line in figure.axes[2].lines)
    r2 = " → ".join(f"{1.0 - np.mean((y - measured) ** 2) / np.var(measured):.3f}" for y in simulated)
    assert figure.axes[2].texts[0].get_text() == f"R² {r2}"
    close(figure)


def test_tables_hold_every_cause_and_candidate_ranked_once_each(diagnosed):
    d, rankings = diagnosed.view.diagnosis, diagnosed.view.rankings
    for ranking in rankings:
        names, scores = zip(*((s.effect, s.score) for s in ranking.candidate_scores), strict=True)
        assert len(names) == len(set(names))
        assert list(scores) == sorted(scores, reverse=True)
    assert set(causes_table(d).frame()["cause"]) == {c.name for c in d.causes}
    assert len(causes_table(d).text().rows) == len(d.causes)
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
    (row,) = table.text().rows
    assert row[2].split("; ")[1] == f"other {size_text(3.0 * size.mean, size.sd, size.unit)}"


def test_words_name_cause_rivals_and_what_is_unexplained(diagnosed):
    view = diagnosed.view
    cause = replace(view.diagnosis.causes[0], ambiguous_with=("mass_scale",), excited=False)
    unknown = (UnexplainedStructure("Cm", "phi", 0.25, 0.01),)
    d = replace(
        view.diagnosis, verdict=Verdict.PARTLY_EXPLAINED, causes=(cause,), unknown=unknown, minor=("alpha_delay",),
        not_testable={"flap_moment": "channel flap does not move in this record"},
    )  # fmt: skip
    text = " ".join(sentences(d, view.trajectories))
    holds(text, cause.name, cause.claim, "mass_scale", "Cm", "phi", "25%", "alpha_delay", "flap")
    unexplained = replace(d, verdict=Verdict.UNEXPLAINED, causes=())
    assert "no effect of the catalogue" in sentences(unexplained)[0]


def test_a_size_on_its_bound_is_no_measurement(diagnosed):
    """The fit's estimate is put where a fit ends that wants to go beyond the bounds."""
    view = diagnosed.view
    cause, extension, name = view.diagnosis.causes[0], view.diagnosis.aerodynamics, "e"
    state = extension.state
    column = int(state.full.columns([name])[0])
    theta = state.theta.copy()
    theta[column] = state.full.model.free[column].bounds[1] - 1e-9
    bounded = sizes(replace(state, theta=theta))
    assert [n for n, size in bounded.items() if size.at_bound] == [name]
    assert not any(size.at_bound for size in extension.sizes.values())
    cause = replace(cause, parameters={name: bounded[name]})
    text = " ".join(sentences(replace(view.diagnosis, causes=(cause,)), view.trajectories))
    assert f"{name} is at a parameter bound" in text
    assert "at a parameter bound" not in " ".join(sentences(view.diagnosis, view.trajectories))


def test_probabilities_what_was_hidden_and_autocorrelation():
    assert [probability(x) for x in (1.0, 0.646)] == ["> 0.99", "0.65"]
    (sentence,) = revealed({"alpha_bias": {"alpha_bias": 0.01}}, {"alpha_bias": "missed"})
    holds(sentence, "alpha_bias", "0.573 deg", "not found")
    x = np.sin(2.0 * np.pi * np.arange(1000) / 20.0)
    lags, r = autocorrelation([x, x], 30)
    assert r[0] == 1.0
    assert r[10] == pytest.approx(-1.0, abs=0.03)
    assert lags[-1] == 30
