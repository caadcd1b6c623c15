"""A lag of the separation point asked of trajectories: found where it is, not wanted where it is not."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from bayes_aero.diagnosis.candidate_set import CandidateModel, candidate_model, lag_of
from bayes_aero.diagnosis.search import search_trajectories
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.diagnosis.trajectories.holdout_fits import CandidateFit, Noise, holdout_fits, left_out
from bayes_aero.diagnosis.trajectories.lag_test import confirmed, with_lag
from bayes_aero.diagnosis.trajectories.results import LagTest, Path
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import segments
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.injection import hidden_records

OUTPUTS = ("airspeed", "alpha", "theta", "q", "ax", "az")
SEED = 4132


def asked(card, hidden, seed):
    """The card's model fitted to two stalls, and what is said of a lag beside it."""
    flights = despiked(join(hidden_records(hidden, seed=seed, seconds=90.0), card, FLIGHT))[0]
    model = Model.from_card(card)
    full = candidate_model(model, flights)
    dynamics = aircraft_dynamics(model, flights)
    whole = segments(flights, dynamics, outputs=OUTPUTS)
    start = np.array([TRUTH[name] for name in dynamics.names])
    first = fit_output_error(whole, start=start, prior_weight=30.0)  # near enough to need no shorter windows
    noise = Noise.of(first)
    fit = fit_output_error(
        noise.on(whole), start=first.estimate, departure=first.departure, prior_weight=noise.variance_inflation
    )
    plain, effect = CandidateFit("extended", fit), lag_of(full)
    wider = replace(model.extended(), fixed=())
    lagged, lag = with_lag(wider, effect, plain, noise, flights)
    if not lag.gains:
        return lag, lagged
    silent = {c.name: {0: {}, 1: {}} for c in (plain, lagged)}
    fits: dict[str, list] = {"extended": [], "lagged": []}
    for name, found in left_out((plain, lagged), silent, noise):
        fits[name].append(found)
    without, within = (holdout_fits(c, fits[c.name], {}) for c in (plain, lagged))
    return confirmed(lag, without, within, OUTPUTS, fit.flown.growth, noise.variance_inflation), lagged


@pytest.mark.parametrize("broken", [lambda _: np.float64(1e300) * 1e300, lambda _: np.linalg.inv(np.zeros((2, 2)))])
def test_a_lag_whose_fit_breaks_down_is_a_failure_and_not_no_lag(monkeypatch, broken):
    monkeypatch.setattr(search_trajectories, "lag_of", broken)
    lagged, failures = search_trajectories._asked_of_a_lag(Mock(spec=CandidateModel), Mock(spec=Extension), 0, None)
    assert lagged is None
    assert [told.split(":")[0] for told in failures] == ["Whether the separation point lags was not tested"]


@pytest.mark.verify
def test_a_hidden_lag_is_kept_and_measured(card):
    """Eight to sixteen chords: half a second and more in the stall."""
    tau1 = np.random.default_rng(SEED).uniform(8.0, 16.0)
    lag, lagged = asked(card, {"separation_lag": {"tau1": tau1}}, SEED)
    assert lag.effect == "separation_lag"
    assert lag.kept, lag
    found = dict(zip(lagged.fit.names, lagged.fit.estimate, strict=True))
    assert found["tau2"] >= 0.0
    assert found["tau1"] == pytest.approx(tau1, rel=0.2)


@pytest.mark.recovery
def test_a_lag_is_not_wanted_where_the_hysteresis_is_quasi_steady(card):
    assert not asked(card, {}, SEED + 1)[0].kept


def path(errors, name="a"):
    n = len(next(iter(errors.values())))
    zero = {key: np.zeros(n) for key in errors}
    return Path(name, "extended", "hold_out", True, {}, np.arange(n) * 0.04, zero, {k: -x for k, x in errors.items()})


def test_the_gain_on_unseen_flight_is_that_of_normal_densities():
    """Half the error gains n log 2 over the colour's cost; a noise_growth that both share changes nothing of it."""
    n, rng = 400, np.random.default_rng(2)
    one = np.ones((n, 1))
    noise = [{"alpha": rng.standard_normal(n)} for _ in range(2)]
    before, after = ([path({k: s * x for k, x in e.items()}) for e in noise] for s in (1.0, 0.5))
    tried = LagTest("separation_lag", 5.0)
    found = confirmed(tried, before, after, ("alpha",), [one] * 2, 10.0)
    assert found.kept
    assert found.unseen[0] == pytest.approx(2 * n * np.log(2.0) / 10.0)
    swollen = confirmed(tried, before, after, ("alpha",), [3.0 * one] * 2, 10.0)
    assert swollen.unseen[0] == pytest.approx(found.unseen[0])
    worse = confirmed(tried, after, before, ("alpha",), [one] * 2, 10.0)
    assert not worse.kept
    assert worse.unseen[0] == pytest.approx(-found.unseen[0])
