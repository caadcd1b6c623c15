"""Linear systems of a card against their closed form."""

import re

import equinox as eqx
import jax.numpy as jnp
import linear_cards as cards
import numpy as np
import pytest

from bayes_aero.dynamics.flight import linear_dynamics
from bayes_aero.dynamics.system import integrate
from bayes_aero.errors import InputError
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join
from bayes_aero.physics.aircraft import NO_AIRCRAFT

DECAY = """
[channels]
time = { label = "t", unit = "s" }
q = { label = "q", unit = "rad/s" }
[linear]
states = ["q"]
[linear.rates.q]
Mq = "q"
"""
FLIGHTS = {
    "short period": (cards.SHORT_PERIOD, cards.SHORT_PERIOD_TRUTH, cards.short_period_flight),
    "lateral": (cards.LATERAL, cards.LATERAL_TRUTH, cards.lateral_flight),
    "without inputs": (DECAY, {"Mq": -0.8}, lambda truth: {"q": 0.3 * np.exp(truth["Mq"] * 0.04 * np.arange(101))}),
}


def theta_of(dynamics, truth):
    return jnp.asarray([truth[name] for name in dynamics.names])


@pytest.mark.parametrize("which", FLIGHTS)
def test_it_moves_as_the_matrix_exponential_says(which):
    text, truth, flight = FLIGHTS[which]
    true, card = flight(truth), cards.card_of(text)
    dynamics = linear_dynamics(card)
    flights = join([cards.record_of(true)], card, dynamics.inputs)
    values = dynamics.values(theta_of(dynamics, truth))
    drives = dynamics.drives(values, flights.channels, flights)
    start = jnp.asarray([true[name][0] for name in dynamics.states])
    shown = eqx.filter_jit(integrate)(dynamics.system(values, flights.aircraft), start, drives, 0.04, substeps=8)
    assert bool(jnp.all(shown.inside))
    for name in dynamics.outputs:
        assert np.ptp(true[name]) > 1e-2
        np.testing.assert_allclose(shown.outputs[name], true[name], rtol=0.0, atol=1e-8, err_msg=name)


def test_parameters_have_unit_meaning_and_what_the_card_sets():
    free = {p.name: p for p in linear_dynamics(cards.card_of(cards.SHORT_PERIOD)).free}
    assert {name: p.unit for name, p in free.items()} == {
        "Z0": "rad/s", "Zalpha": "1/s", "Zde": "1/s", "M0": "rad/s^2", "Malpha": "1/s^2", "Mq": "1/s", "Mde": "1/s^2",
        "az0": "m/s^2",
    }  # fmt: skip
    assert (free["Mde"].description, free["Mde"].start) == ("rate of q, per elevator", 0.0)
    assert free["Mde"].prior.scale >= 100.0
    extra = """
    [parameters.Mq]
    start = -1.0
    bounds = [-5.0, 0.0]
    prior = { family = "normal", location = -2.0, scale = 1.0, source = "tunnel" }
    """
    (mq,) = (p for p in linear_dynamics(cards.card_of(cards.SHORT_PERIOD + extra)).free if p.name == "Mq")
    assert (mq.start, mq.bounds, mq.prior.location, mq.prior.source) == (-1.0, (-5.0, 0.0), -2.0, "tunnel")


def test_what_is_no_linear_card_no_model_or_lacks_an_input_is_said(card):
    with pytest.raises(InputError, match=r"no section \[linear\]"):
        linear_dynamics(card)
    with pytest.raises(InputError, match="linear system"):
        Model.from_card(cards.card_of(cards.SHORT_PERIOD))
    card = cards.card_of(cards.SHORT_PERIOD)
    true = cards.short_period_flight(cards.SHORT_PERIOD_TRUTH)
    without = cards.record_of({name: x for name, x in true.items() if name != "elevator"})
    with pytest.raises(InputError, match="no channel elevator"):
        join([without], card, linear_dynamics(card).inputs)


def moved(text, lengths=(), **more):
    """Dynamics of a card, with values of the truth, and what they give at one instant."""
    dynamics = linear_dynamics(cards.card_of(text), lengths)
    values = dynamics.values(theta_of(dynamics, cards.SHORT_PERIOD_TRUTH | more))
    u = {"elevator": jnp.asarray(0.05)} | {name: jnp.asarray(x) for name, x in more.items() if name == "M0"}
    return dynamics, values, dynamics.system(values, NO_AIRCRAFT).motion(jnp.array([0.1, 0.3]), u)


def test_a_bias_is_what_a_record_shows_beyond_the_state():
    text = cards.SHORT_PERIOD.replace("[linear.rates.q]", '[linear.outputs.q]\nby_q = "1"\n[linear.rates.q]', 1)
    dynamics, _, (_, shown) = moved(text, by_q=0.02)
    assert float(shown["q"]) == pytest.approx(0.32)
    assert float(shown["alpha"]) == pytest.approx(0.1)
    assert dynamics.outputs.count("q") == 1


def test_a_constant_by_manoeuvre_is_that_of_each_sample_s_and_cannot_be_fixed():
    text = cards.SHORT_PERIOD.replace("[linear]", '[linear]\nby_manoeuvre = ["M0"]', 1)
    dynamics, values, (rate, _) = moved(text, (500, 500), M0=0.5, M0_1=0.5, M0_2=-0.7)
    assert [n for n in dynamics.names if n.startswith("M0")] == ["M0_1", "M0_2"]
    records = [
        cards.record_of(cards.short_period_flight(cards.SHORT_PERIOD_TRUTH), name=f"flight_{k}") for k in range(2)
    ]
    flights = join(records, cards.card_of(text), ("elevator",))
    drive = dynamics.drives(values, flights.channels, flights)["M0"]
    np.testing.assert_array_equal(drive, np.repeat([0.5, -0.7], flights.lengths))
    np.testing.assert_allclose(rate, moved(cards.SHORT_PERIOD, M0=0.5)[2][0])
    with pytest.raises(InputError, match="M0 is fixed and differs between manoeuvres"):
        cards.card_of(text.replace("[linear.fixed]", "[linear.fixed]\nM0 = 0.0", 1))


@pytest.mark.parametrize(("changed", "said"), [
    (("[linear]", '[linear]\nby_manoeuvre = ["Mq"]'), "has Mq, which is no constant"),
    (("[linear]", '[linear]\nby_manoeuvre = "M0"'), "must be a list of constants"),
    (("[linear]", '[linear]\ndelays = { q = "Mq" }'), "must be the name of a parameter of no row"),
    (("[linear]", '[linear]\ndelays = { theta = "tau" }'), "theta"),
    (("[linear.rates.q]", '[linear.outputs.q]\none = "q"\n[linear.rates.q]'), "it may only have a bias"),
])  # fmt: skip
def test_a_row_that_means_nothing_is_refused(changed, said):
    with pytest.raises(InputError, match=re.escape(said)):
        cards.card_of(cards.SHORT_PERIOD.replace(*changed, 1))
