"""The transform's figure and words: which distribution is asked, and what the band does not know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_aero.inference.posterior.pit import pit_of
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.model.noise import Colour
from bayes_aero.report.figures.pit import pit_histogram, pit_words
from bayes_aero.report.html.page import Fold, Picture
from bayes_aero.report.pages.identification import identification_page
from bayes_aero.report.style import NotDrawn, save

SIGMA = 0.005  # of the noise of the sample runs, which is white


def certain(posterior: Posterior, **values: float) -> Posterior:
    """Draws that all have these values."""
    tree = posterior.tree.copy()
    group = tree["posterior"].to_dataset()
    for name in posterior.names:
        key = name.split("_")[0]
        if key in values:
            group[name] = 0.0 * group[name] + values[key]
    tree["posterior"] = type(tree["posterior"])(group)
    return replace(posterior, tree=tree)


def run_of(make, noise: Colour, **values: float):
    run = make(manoeuvres=2, gp=False, noise=noise, engines=("emcee",), width=1e-3)
    run = replace(run, posteriors={"emcee": certain(run.posteriors["emcee"], sigma=SIGMA, **values)})
    return replace(run, pit=pit_of(run))


def test_one_step_ahead_under_coloured_noise(make):
    run = run_of(make, Colour.AR1, rho=0.0)
    caption, alt = pit_words(run)
    assert "innovation" in caption
    assert "one-step-ahead" in alt
    assert "near enough to independence" in caption
    t = run.pit
    assert t.values.shape[1] == 3
    assert all(bars.outside == 0 for bars in t.bars)


def test_colour_that_the_noise_model_does_not_have_is_told(make):
    """A correlation of 0.9 taken out of white samples leaves neighbours tied by -0.9/(1 + 0.81)."""
    run = run_of(make, Colour.AR1, rho=0.9)
    caption, alt = pit_words(run)
    assert "residuals of CL, CD and Cm are coloured" in caption
    assert "the band takes samples as independent, so it is too narrow" in caption
    assert np.mean(run.pit.correlation) == pytest.approx(-0.9 / 1.81, abs=0.15)
    assert "Lag-1 correlation of neighbours: CL -0." in alt


def test_white_noise_predicts_each_sample_by_itself(make):
    caption, alt = pit_words(run_of(make, Colour.WHITE))
    assert "each sample by itself" in caption
    assert "one-step-ahead" not in alt


def test_the_figure_stands_behind_the_calibration_s_fold(make, tmp_path):
    run = run_of(make, Colour.AR1, rho=0.0)
    path = save(pit_histogram(run), tmp_path / "pit.png")
    page = identification_page(run, {}, {"pit": path})
    folds = [b for s in page.sections if s.key == "diagnostics" for b in s.blocks if isinstance(b, Fold)]
    (fold,) = (fold for fold in folds if fold.title.startswith("Calibration"))
    (picture,) = (block for block in fold.blocks if isinstance(block, Picture))
    assert (picture.caption, picture.alt) == pit_words(run)


def test_without_a_posterior_there_is_nothing_to_draw(make):
    with pytest.raises(NotDrawn, match="no posterior"):
        pit_histogram(make(gp=False, engines=()))
