"""Predictors on unseen data: the discrepancy helps where there is one and does no harm where there is none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.predictors import Predictor, compare_states
from bayes_aero.diagnosis.screening.selection_state import linearised
from bayes_aero.diagnosis.selection import discrepancy
from bayes_aero.errors import InputError
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.gp import MapStatus, fit_gp
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.joined_channels import join
from bayes_aero.model.observations import observe
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import simulate_stall

LOOKED_AT = (20.0, 80.0)  # s of each flight: a Gaussian process costs the cube of the samples


def _with_lift(record: FlightRecord, card, size: float) -> FlightRecord:
    """The record with a lift that no model knows: `size` (CL) times a wave of the airspeed, crest to crest 12 m/s."""
    channels = {name: np.array(x) for name, x in record.channels.items()}
    V, alpha = channels["airspeed"], channels["alpha"]
    dCL = size * np.sin(2.0 * np.pi * V / 12.0)
    force = 0.5 * channels["density"] * V**2 * card.aircraft.wing_area / card.aircraft.mass * dCL
    channels["ax"] += force * np.sin(alpha)
    channels["az"] -= force * np.cos(alpha)
    return FlightRecord.from_arrays(record.name, np.asarray(record.time), channels, "simulated")


def _state(card, model, size: float):
    flown = (simulate_stall(i, card=card).window(*LOOKED_AT) for i in range(2))
    records = [_with_lift(record, card, size) for record in flown]
    effects = tuple(e for e in model.effects if e.name != "separation_lag")  # fixed at neutral by the card
    model = replace(model, effects=effects, parameters=tuple(p for e in effects for p in e.parameters), fixed=())
    full = CandidateModel(model, tuple(e.name for e in model.effects), (), {})
    start = fit_mle(model, observe(records, card, model), seed=0, extra_starts=0).estimate
    return linearised(full, EquationError.of(join(records, card), model), NAMES, np.asarray(start))


@pytest.fixture(scope="module")
def wavy(card, model):
    """A comparison on two manoeuvres with the unknown lift."""
    return compare_states(_state(card, model, 0.04), card.gp_inputs)


@pytest.fixture(scope="module")
def state(card, model):
    """Two manoeuvres without."""
    return _state(card, model, 0.0)


@pytest.fixture(scope="module")
def plain(card, state):
    """A comparison on them."""
    return compare_states(state, card.gp_inputs)


def test_discrepancy_that_is_there_is_predicted(wavy):
    before = wavy.predictions[Predictor.EXTENDED]["CL"].scores
    after = wavy.predictions[Predictor.DISCREPANCY]["CL"].scores
    assert after.rmse < 0.75 * before.rmse
    assert after.elpd > before.elpd + 20.0
    assert all(0.0 < t < 1.0 for t in wavy.predictions[Predictor.DISCREPANCY]["CL"].trust)


def test_discrepancy_that_is_not_there_does_no_harm(plain):
    for name in NAMES:
        before = plain.predictions[Predictor.EXTENDED][name].scores
        after = plain.predictions[Predictor.DISCREPANCY][name].scores
        assert after.rmse < 1.03 * before.rmse
        assert after.elpd > before.elpd - 0.02 * plain.inside.sum()


def test_all_are_scored_at_the_same_points(plain):
    for row in plain.predictions.values():
        for name in NAMES:
            assert row[name].scores is not None
            assert "demo_stall_1" in row[name].status
            assert np.array_equal(np.isfinite(row[name].mean), plain.inside)
            assert 0.0 <= row[name].scores.coverage95 <= 1.0
    assert set(plain.table) == {p.value for p in Predictor}
    assert plain.split == "manoeuvre"


def test_without_additions_the_extended_model_is_the_card(plain):
    for name in NAMES:
        card, extended = (plain.predictions[p][name].scores for p in (Predictor.CARD, Predictor.EXTENDED))
        assert math.isclose(card.rmse, extended.rmse, rel_tol=1e-6)


def test_scores_are_those_of_their_predictions(wavy):
    c, found = 2, wavy.predictions[Predictor.GP]["Cm"]
    z, y, s = wavy.measured[wavy.inside, c], found.mean[wavy.inside], found.sd[wavy.inside]
    assert math.isclose(found.scores.rmse, math.sqrt(np.mean((z - y) ** 2)))
    assert math.isclose(found.scores.coverage95, np.mean(np.abs(z - y) < 1.959964 * s))
    density = -0.5 * ((z - y) / s) ** 2 - np.log(s * math.sqrt(2 * math.pi))
    assert math.isclose(found.scores.elpd, density.sum())


def test_an_optimum_that_failed_is_refused(card, state, monkeypatch):
    original = discrepancy.fit_gp

    def broken(*args, **options):
        fit = original(*args, **options | {"starts": 1})
        return replace(fit, optima=(fit.optima[0]._replace(status=MapStatus.not_positive_definite),))

    monkeypatch.setattr(discrepancy, "fit_gp", broken)
    found = compare_states(state, card.gp_inputs)
    refused = found.predictions[Predictor.GP]["CD"]
    assert refused.scores is None
    assert "could not be factorised" in refused.status
    assert found.predictions[Predictor.EXTENDED]["CD"].scores is not None


def test_an_input_that_was_not_recorded_is_named(state):
    with pytest.raises(InputError, match="flap"):
        compare_states(state, ("alpha", "flap"))


def test_a_process_of_one_stretch_earns_no_trust():
    """Of 12 s, the part held out and its gaps taken away, one stretch is left: nothing predicts it."""
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((20, 1)), rng.standard_normal(20)
    fit = fit_gp(x, y, sample=False, starts=2)
    assert discrepancy.trust_of(fit, y, np.ones(20), [np.arange(20)], 10) == (0.0, pytest.approx(np.mean(y**2)))
    halves = [np.arange(10), np.arange(10, 20)]
    assert discrepancy.trust_of(fit, y, np.ones(20), halves, 10)[0] == 0.0  # the gap leaves nothing of the other
