"""Linear systems of a card against their closed form."""

import jax.numpy as jnp
import numpy as np
import pytest
from linear_cards import (
    LATERAL,
    LATERAL_TRUTH,
    SHORT_PERIOD,
    SHORT_PERIOD_TRUTH,
    card_of,
    first_order_hold,
    lateral_flight,
    record_of,
    short_period_flight,
)

from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments, simulate
from bayes_aero.dynamics.system import integrate
from bayes_aero.errors import InputError
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model

FLIGHTS = {
    "short period": (SHORT_PERIOD, SHORT_PERIOD_TRUTH, short_period_flight),
    "lateral": (LATERAL, LATERAL_TRUTH, lateral_flight),
}


def theta_of(dynamics, truth):
    return jnp.asarray([truth[name] for name in dynamics.names])


@pytest.mark.parametrize("which", FLIGHTS)
def test_it_moves_as_the_matrix_exponential_says(which):
    text, truth, flight = FLIGHTS[which]
    true = flight(truth)
    card = card_of(text)
    dynamics = linear_dynamics(card)
    flights = join([record_of(true)], card, dynamics.inputs)
    values = dynamics.values(theta_of(dynamics, truth))
    system = dynamics.system(values, flights.aircraft)
    drives = dynamics.drives(values, flights.channels, flights)
    start = jnp.asarray([true[name][0] for name in dynamics.states])
    found = integrate(system, start, drives, 0.04, substeps=8)
    assert bool(jnp.all(found.inside))
    for name in dynamics.outputs:
        assert np.ptp(true[name]) > 1e-2
        np.testing.assert_allclose(found.outputs[name], true[name], rtol=0.0, atol=1e-8, err_msg=name)


def test_a_segment_starts_where_it_was_measured_and_has_no_residual():
    card = card_of(SHORT_PERIOD)
    dynamics = linear_dynamics(card)
    truth = SHORT_PERIOD_TRUTH | {"Z0": 0.0, "M0": 0.0}  # at rest until the first input: its start is exact
    true = short_period_flight(truth, x0=(0.0, 0.0))
    flown = segments(join([record_of(true)], card, dynamics.inputs), dynamics, substeps=8)
    assert flown.outputs == ("alpha", "q", "az")
    found = simulate(flown, theta_of(dynamics, truth), jnp.zeros((1, 2)))
    assert float(jnp.abs(found.residual[0, :, :2]).max()) < 1e-8


def test_a_system_without_inputs_flies():
    text = """
    [channels]
    time = { label = "t", unit = "s" }
    q = { label = "q", unit = "rad/s" }
    [linear]
    states = ["q"]
    [linear.rates.q]
    Mq = "q"
    """
    card = card_of(text)
    dynamics = linear_dynamics(card)
    t = np.arange(101) * 0.04
    flights = join([record_of({"q": 0.3 * np.exp(-0.8 * t)})], card, dynamics.inputs)
    system = dynamics.system({"Mq": jnp.asarray(-0.8)}, flights.aircraft)
    found = integrate(system, jnp.asarray([0.3]), dynamics.drives({}, flights.channels, flights), 0.04)
    np.testing.assert_allclose(found.outputs["q"], 0.3 * np.exp(-0.8 * t), atol=1e-8)


def test_parameters_say_unit_and_meaning():
    free = {p.name: p for p in linear_dynamics(card_of(SHORT_PERIOD)).free}
    assert {name: p.unit for name, p in free.items()} == {
        "Z0": "rad/s", "Zalpha": "1/s", "Zde": "1/s", "M0": "rad/s^2", "Malpha": "1/s^2", "Mq": "1/s", "Mde": "1/s^2",
        "az0": "m/s^2",
    }  # fmt: skip
    assert free["Mde"].description == "rate of q, per elevator"
    assert free["Mde"].prior.family == "normal"
    assert free["Mde"].prior.scale >= 100.0
    assert free["Mde"].start == 0.0


def test_the_card_sets_start_bounds_and_prior():
    extra = """
    [parameters.Mq]
    start = -1.0
    bounds = [-5.0, 0.0]
    prior = { family = "normal", location = -2.0, scale = 1.0, source = "tunnel" }
    """
    (mq,) = (p for p in linear_dynamics(card_of(SHORT_PERIOD + extra)).free if p.name == "Mq")
    assert (mq.start, mq.bounds, mq.prior.location, mq.prior.source) == (-1.0, (-5.0, 0.0), -2.0, "tunnel")
    with pytest.raises(InputError, match="outside its bounds"):
        linear_dynamics(card_of(SHORT_PERIOD + "\n[parameters.Mq]\nstart = 1.0\nbounds = [-5.0, 0.0]"))


def test_what_is_no_linear_card_and_what_is_no_model_is_said(card):
    with pytest.raises(InputError, match=r"no section \[linear\]"):
        linear_dynamics(card)
    with pytest.raises(InputError, match="linear system"):
        Model.from_card(card_of(SHORT_PERIOD))


def test_a_record_without_an_input_is_refused_by_its_name():
    card = card_of(SHORT_PERIOD)
    true = short_period_flight(SHORT_PERIOD_TRUTH)
    without = record_of({name: x for name, x in true.items() if name != "elevator"})
    with pytest.raises(InputError, match="no channel elevator"):
        join([without], card, linear_dynamics(card).inputs)


def test_the_closed_form_itself():
    """x' = -x + u with a ramp u = t from x = 0 is t - 1 + exp(-t)."""
    t = np.arange(20) * 0.1
    x = first_order_hold(np.array([[-1.0]]), np.array([[1.0]]), [0.0], t[:, None], 0.1)[:, 0]
    np.testing.assert_allclose(x, t - 1.0 + np.exp(-t), atol=1e-14)
