"""Of what was added, unseen data confirm what the flights have in them, and nothing else."""

import numpy as np
import pytest

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.diagnosis.screening.parameter_fit import refitted
from bayes_aero.diagnosis.screening.selection_state import linearised
from bayes_aero.diagnosis.selection.backward_elimination import confirmation
from bayes_aero.diagnosis.selection.cross_validation import LeftOut, holdout_gain, truncated
from bayes_aero.effects import CATALOGUE
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.injection import hidden_flights

TRUE = ("thrust_moment", "pitch_rate_lift", "drag_offset")
ABSENT = ("sideslip_drag", "alpha_dot_lift", "mach_drag", "elevator_drag")
DRAWN = np.random.default_rng(515).integers(1_000_000, size=6)
SEEDS = [DRAWN[0], *(pytest.param(seed, marks=pytest.mark.verify) for seed in DRAWN[1:3])]


def with_added(card, model, records, added):
    """The card's model with effects put in, whether they deserve it or not, everything fitted."""
    flights = despiked(join(records, card))[0]
    full = candidate_model(model, flights)
    theta = np.array([full.neutral[name] for name in full.model.names])
    mle = fit_mle(model, observe(records, card, model), seed=0)
    for name, value in zip(mle.names, mle.estimate, strict=True):
        theta[full.columns([name])[0]] = value
    return refitted(linearised(full, EquationError.of(flights, full.model), NAMES, theta, tuple(added)))[0]


@pytest.mark.recovery
@pytest.mark.parametrize("seed", SEEDS)
def test_what_was_flown_is_confirmed_and_what_was_not_is_taken_out(card, model, seed):
    rng = np.random.default_rng(seed)
    true, absent = str(rng.choice(TRUE)), [str(name) for name in rng.choice(ABSENT, 2, replace=False)]
    sizes = {p: float(rng.uniform(4.0, 8.0)) * least for p, (least, _) in CATALOGUE[true].sizes.items()}
    flights = hidden_flights({true: sizes}, seed=int(seed), noise="white", seconds=90.0)
    found = confirmation(with_added(card, model, [f.record for f in flights], [*absent, true]))
    assert found.kept == (true,)
    for name, (lost, deviation) in found.missed.items():
        assert (lost > 1.645 * deviation) == (name in found.kept)


@pytest.mark.recovery
def test_where_nothing_is_missing_nothing_is_confirmed(card, model):
    flights = hidden_flights({}, seed=int(DRAWN[3]), noise="white", seconds=90.0)
    found = confirmation(with_added(card, model, [f.record for f in flights], ABSENT))
    assert found.kept == ()
    assert set(found.missed) == set(ABSENT)


def test_first_order_is_the_whole_truth_for_an_effect_that_enters_linearly(card, model):
    """Cm alone is linear in a thrust arm; what is fitted again finds the same as the sensitivities say."""
    arm = {"thrust_arm": 3.0 * CATALOGUE["thrust_moment"].sizes["thrust_arm"][0]}
    flights = hidden_flights({"thrust_moment": arm}, seed=int(DRAWN[0]), noise="white", seconds=90.0)
    state = with_added(card, model, [f.record for f in flights], ["thrust_moment"])
    for effects in ((), ("thrust_moment",)):
        linear, full = LeftOut.first_order(state, effects), LeftOut.refitted(truncated(state, effects))
        assert np.allclose(linear.residual.std(axis=0), full.residual.std(axis=0), rtol=0.1)
    near = holdout_gain(LeftOut.first_order(state, ()), LeftOut.first_order(state, ("thrust_moment",)), state)
    whole = holdout_gain(LeftOut.refitted(truncated(state, ())), LeftOut.refitted(state), state)
    assert near[0] == pytest.approx(whole[0], rel=0.2)


@pytest.mark.verify
def test_without_induced_drag_which_is_neutral_at_infinity_first_order_is_exact(card, model):
    """Drag is linear in 1/e: along the tangent, too, nothing of it is left where e is infinite."""
    flights = hidden_flights({}, seed=int(DRAWN[4]), noise="white", seconds=90.0)
    without = Model.of([e for e in model.effects if e.name != "induced_drag"], dict(model.fixed))
    state = with_added(card, without, [f.record for f in flights], ["induced_drag"])
    own = state.full.own_columns("induced_drag")
    assert state.departure[own] == -state.theta[own]
    exact = np.asarray(state.responses.evaluate(state.full.at_neutral(state.theta, ["induced_drag"]))[0])
    left = state.residual + state.S[:, :, own] @ state.departure[own]
    np.testing.assert_allclose(left, exact[:, : len(NAMES)], atol=1e-9)
    assert 0.0 < holdout_gain(LeftOut.first_order(state, ()), LeftOut.refitted(state), state)[0] < 1e4
