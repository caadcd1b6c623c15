"""Every figure draws, on results of several shapes, with labels, units and no empty axes."""

from __future__ import annotations

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from bayes_aero.report.figures import every_figure as figures
from bayes_aero.report.figures.every_figure import FIGURES, write_figures
from bayes_aero.report.style import NotDrawn, close, save
from bayes_aero.report.tables.predictions import broken, predicted

SLOW = {"trace_emcee", "trace_nuts", "rank_emcee", "rank_nuts", "pair", "pit"}
UNITLESS = {"density"}

OF_LATERAL = {f"{kind}_{name}" for kind in ("validation", "correlation") for name in ("CY", "Cl", "Cn")}
ASKED_FOR = {"next_flight"}  # drawn in test_next_flight_table.py


def check(figure: Figure) -> None:
    """No empty axes; labels on the outer ones, with a unit in brackets."""
    assert figure.axes
    for ax in figure.axes:
        assert ax.has_data(), "empty axes"
        labels = [ax.get_xlabel(), ax.get_ylabel()]
        assert all("[" in text and "]" in text for text in labels if text and text not in UNITLESS), labels
        place = ax.get_subplotspec()
        if place is not None and place.is_last_row():
            assert ax.get_xlabel(), "no x label"
        if place is not None and place.is_first_col():
            named = ax.get_ylabel() or any(t.get_text().strip() for t in ax.get_yticklabels())
            assert named, "no y label"


@pytest.mark.parametrize("stem", [stem for stem in FIGURES if stem not in OF_LATERAL | ASKED_FOR])
def test_every_figure_draws_complete(stem, full, tmp_path):
    figure = FIGURES[stem](full)
    check(figure)
    path = save(figure, tmp_path / f"{stem}.png")
    pixels = imread(path)
    assert min(pixels.shape[:2]) > 300
    assert pixels[..., :3].std() > 0.01


@pytest.mark.parametrize("stem", sorted(OF_LATERAL))
def test_figures_of_lateral_coefficients_are_for_models_that_have_them(stem, full):
    with pytest.raises(NotDrawn, match="the model has no C"):
        FIGURES[stem](full)
    coefficients = ("CL", "CD", stem[-2:])  # the third one by another name
    check(FIGURES[stem](replace(full, gp=None, observations=replace(full.observations, coefficients=coefficients))))


def test_the_registry_has_the_papers_nine_and_the_bayesian_ones():
    paper = [stem for stem in FIGURES if stem.startswith("fig")]
    assert [stem[:5] for stem in paper] == [f"fig{i}_" for i in range(1, 10)]
    for part in ("trace", "rank", "pair", "pit", "forest", "prior_posterior", "gp_prior_posterior", "crb_vs_credible"):
        assert any(stem.startswith(part) for stem in FIGURES)


@pytest.mark.parametrize("count", [1, 5])
def test_one_and_many_manoeuvres(count, make):
    run = make(manoeuvres=count)
    for stem in FIGURES.keys() - SLOW - OF_LATERAL - ASKED_FOR:
        check(FIGURES[stem](run))


def test_without_posteriors_and_gp_what_can_be_shown_is(make, tmp_path):
    written, failed = write_figures(make(engines=(), gp=False), tmp_path)
    assert not failed
    stems = {path.stem for path in written}
    assert "fig3_validation_CL" in stems
    assert "forest" in stems
    assert stems.isdisjoint(SLOW | {"fig2_gpr_fit", "prior_posterior", "gp_prior_posterior"})


def test_a_figure_that_fails_is_named_and_leaves_the_others(full, tmp_path, monkeypatch):
    def bad(_):
        raise ValueError("no such luck")

    def empty(_):
        raise NotDrawn("nothing there")

    few = {"first": FIGURES["fig1_time_history"], "bad": bad, "empty": empty, "last": FIGURES["forest"]}
    monkeypatch.setattr(figures, "FIGURES", few)
    heard = []
    written, failed = write_figures(full, tmp_path / "new", progress=lambda text, share: heard.append((text, share)))
    assert [path.name for path in written] == ["first.png", "last.png"]
    assert [one.partition(". This")[0] for one in failed] == ["Figure bad was not drawn: ValueError: no such luck"]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["first.png", "last.png"]
    assert heard[-1] == ("figures", 1.0)


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    figure = Figure()

    def fails(partial, **_):
        partial.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(figure, "savefig", fails)
    with pytest.raises(OSError, match="disk full"):
        save(figure, path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_neither_backend_nor_settings_nor_open_figures_of_the_user_change(full):
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    before = dict(matplotlib.rcParams)
    figure = FIGURES["trace_nuts"](full)
    close(figure)
    assert dict(matplotlib.rcParams) == before
    assert not plt.get_fignums()


def test_predictions_follow_the_test_points_in_order(full):
    points = predicted(full, "CD")
    test = full.gp.splits["random"][0]["CD"]
    assert np.array_equal(points.index, test.test)
    assert np.array_equal(points.gp, test.gp)
    second = points.of(full.observations.manoeuvre == 1)
    assert set(full.observations.manoeuvre[second.index]) == {1}


def test_without_a_gp_the_fit_at_all_samples_is_shown(make):
    run = make(gp=False)
    points = predicted(run, "CL")
    alpha, elevator = (np.asarray(run.observations.signals[k]) for k in ("alpha", "elevator"))
    chord, arm = run.card.aircraft.chord, run.card.aircraft.tail_arm
    assert points.gp is None
    assert np.allclose(points.mle, 0.2 + 4.0 * alpha + 0.8 * chord / arm * elevator)


def test_lines_break_at_gaps():
    t, y = broken(np.array([0.0, 0.1, 5.0]), np.array([1.0, 2.0, 3.0]))
    assert np.isnan(t[2])
    assert np.array_equal(y, [1.0, 2.0, np.nan, 3.0], equal_nan=True)
