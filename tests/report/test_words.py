"""The verdict speaks where results disagree and why, and says that they agree where they do."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bayes_aero.inference.likelihood.mle_result import MleStatus
from bayes_aero.inference.posterior.posterior import PosteriorStatus
from bayes_aero.model.noise import Colour
from bayes_aero.report.pages.identification import headline
from bayes_aero.report.text.identification import verdict


def said(run, *words: str) -> str:
    """The one sentence with all of `words`."""
    found = [s for s in verdict(run) if all(w in s for w in words)]
    assert len(found) == 1, (words, verdict(run))
    return found[0]


def silent(run, word: str) -> bool:
    return not any(word in s for s in verdict(run))


def test_where_everything_agrees_it_says_so_and_no_more(make):
    run = make(gp=False)
    sentences = verdict(run)
    assert len(sentences) == 2, sentences
    assert "intervals agree" in sentences[0]
    assert "1.00 to 1.00 times" in sentences[0]
    assert sentences[1].startswith("emcee and NUTS agree")


def test_what_was_flown_stands_beside_what_was_found(make):
    run = make(gp=False, corrected=4.0)
    assert silent(run, "simulated")
    flown = dict(zip(run.mle.names, run.mle.estimate, strict=True))
    flown |= {"Cma": flown["Cma"] + 0.03, "tau1": 0.0}  # three Cramer-Rao deviations, .75 corrected; one not fitted
    text = said(replace(run, truth=flown), "simulated")
    assert "of the 6 true parameters" in text
    assert "5 (ML, Cramér-Rao bound), 6 (ML, corrected bound)" in text
    assert "Cma, -0.8 corrected standard errors" in text


def test_coloured_residuals_and_what_they_make_of_the_bound(full, make):
    text = said(full, "not white")
    assert "Cm +0.90" in text
    assert "4 times" in text
    assert silent(make(), "not white")
    assert silent(make(lag1=0.9, corrected=1.05), "not white")  # coloured, but the bound does not care


def test_the_white_posterior_is_no_second_witness(full, make):
    assert "within 0%" in said(full, "same assumption")
    assert silent(make(), "same assumption")


def test_the_chosen_noise_model_moves_the_mean(full, make):
    assert "0.5 times the corrected" in said(full, "weighs the data differently")
    text = said(full, "mean function is wrong, or the residual")
    assert "Cma (6.7)" in text  # 0.3 / hypot(0.02, 0.04)
    assert "Cmde" not in text
    assert "noise models disagree about Cma beyond their intervals" in headline(full)
    wider = make(width=4.0, corrected=4.0, lag1=0.9)
    assert "disagree" not in headline(wider)
    assert silent(wider, "mean function is wrong, or the residual")
    assert silent(wider, "weighs the data differently")


def test_between_manoeuvres(full, make):
    counts = said(full, "Fitted alone")
    assert "by the Cramér-Rao bound: Cmde (42.4)" in counts
    assert "by the corrected bound: Cmde (10.6)" in counts
    assert "by the AR(1) posterior's width: Cmde (21.2)" in counts
    why = said(full, "No noise model alone explains")
    assert "Cmde is -0.800 from flight1 and -1.400 from flight2" in why
    assert "lacks an effect" in why
    assert silent(make(apart={"Cmde": 3.0}), "Fitted alone")


def test_a_difference_that_the_corrected_bounds_explain_is_not_blamed_on_the_model(make):
    run = make(apart={"Cmde": -8.0}, corrected=4.0, width=4.0, lag1=0.9)
    assert "Cramér-Rao bound: Cmde (5.7); by the corrected bound: none" in said(run, "Fitted alone")
    assert silent(run, "No noise model alone")


def test_engines_that_disagree(make):
    run = make(gp=False)
    other = make(shift={"CLa": 1.0}, width=1.3, gp=False).posteriors["nuts"]
    run = replace(run, posteriors=run.posteriors | {"nuts": other})
    text = said(run, "emcee and NUTS disagree")
    assert "(CLa)" in text
    assert "run longer" in text


def test_unfinished_posteriors_are_named(make):
    run = make()
    bad = replace(run.posteriors["nuts"], status=PosteriorStatus.DIVERGENT)
    assert "divergent transitions" in said(replace(run, posteriors=run.posteriors | {"nuts": bad}), "posterior by NUTS")
    assert silent(run, "posterior by NUTS")


def test_what_the_random_split_leaks(full, make):
    text = said(full, "GPR correlation")
    assert "neighbours 40 ms away" in text
    better = said(full, "maximum likelihood correlates better")
    assert "CD" in better
    honest = make()
    assert "does not leak significantly" in said(honest, "GPR correlation")
    assert silent(honest, "correlates better")


def test_a_gp_whose_hyperparameters_were_not_sampled_is_named(make):
    run = make()
    object.__setattr__(run.gp.fits["CD"], "posterior", None)
    first = run.gp.splits["random"][0]
    first["CD"] = replace(first["CD"], status="refused: Pareto k too large.", k_hat=None)
    assert "refused: Pareto k too large" in said(run, "Gaussian process of CD")


def test_a_fit_that_failed_gets_its_warning_and_no_comparison(make):
    run = make(status=MleStatus.NOT_CONVERGED, corrected=4.0, lag1=0.9, gp=False)
    sentences = verdict(run)
    assert "stopped before the optimum" in sentences[0]
    assert silent(run, "not white")
    assert silent(run, "agree;")


def test_a_manoeuvre_that_cannot_be_fitted_alone_is_left_out(make):
    run = make(apart={"Cmde": -60.0})
    run.alone["flight2"] = replace(run.alone["flight2"], status=MleStatus.STALL_NOT_IDENTIFIED)
    assert "left out of the comparison" in said(run, "flight2 alone")
    assert silent(run, "Fitted alone")
    assert not silent(run, "intervals agree")


def test_colour_at_longer_lags_is_not_passed_over(make):
    assert "longer lags" in said(make(corrected=3.0, width=3.0), "not white")


@pytest.mark.parametrize("engines", [(), ("emcee",), ("nuts", "white")])
def test_runs_that_are_not_finished_have_a_verdict_too(engines, make):
    for manoeuvres in (1, 2):
        assert verdict(make(manoeuvres=manoeuvres, engines=engines, gp=False))
    assert verdict(make(noise=Colour.WHITE, engines=engines, corrected=3.0, lag1=0.5))
