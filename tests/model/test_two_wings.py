"""Two separation points, left and right: each wing at its own incidence, one mechanism for all that follows."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit

from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.axes import Axis
from bayes_aero.model.model import Model
from bayes_aero.physics.separation import lagged
from bayes_aero.simulate.demo import TRUTH

BOTH = tuple(Axis)
N, DT = 300, 0.04
TELL_APART = {"wing_asymmetry": 0.012, "roll_rate_incidence": 0.6, "sideslip_incidence": 0.2, "aileron_incidence": -0.3}
WINGS = ("wing_lift_difference", "wing_drag_difference")


def signals() -> dict[str, jax.Array]:
    t = np.arange(N) * DT
    s = {
        "alpha": 0.2 + 0.13 * np.sin(0.8 * t), "alpha_dot": 0.104 * np.cos(0.8 * t), "airspeed": 80.0 + 5.0 * np.cos(t),
        "q": 0.05 * np.cos(t), "elevator": -0.1 * np.sin(t), "mach": np.full(N, 0.25), "p": 0.2 * np.sin(1.3 * t),
        "beta": 0.06 * np.cos(0.9 * t), "aileron": 0.1 * np.sin(0.7 * t), "dt": np.full(N, DT), "start": t == 0.0,
    }  # fmt: skip
    return {name: jnp.asarray(x) for name, x in s.items()}


def model_and_values(card, tell=TELL_APART, **changes):
    """The card's model with wings told apart by effects `tell`, whose values they have, and the demo's truth."""
    own = {p.name: x for name, x in tell.items() for p in CATALOGUE[name].parameters}
    model = Model.of([*card.effects, *tell, *WINGS], axes=BOTH)
    return model, {k: jnp.asarray(v) for k, v in (TRUTH | own | changes).items()}


def difference(s, aircraft) -> np.ndarray:
    """Incidence of the right wing less that of the left."""
    roll = 2.0 * 0.6 * np.asarray(s["p"]) * aircraft.half_span / np.asarray(s["airspeed"])
    return 0.012 + roll + 0.2 * np.asarray(s["beta"]) - 0.3 * np.asarray(s["aileron"])


def test_each_wing_has_the_static_separation_of_its_own_incidence(card):
    s = signals()
    model, v = model_and_values(card, tau1=0.0, tau2=0.0)
    known = model.flow(v, s, card.aircraft)
    alpha, half = np.asarray(s["alpha"]), difference(s, card.aircraft) / 2.0
    right, left = (expit(-2.0 * TRUTH["a1"] * (alpha + side - TRUTH["alpha_star"])) for side in (half, -half))
    np.testing.assert_allclose(known["X"], (right + left) / 2.0, rtol=1e-10)
    np.testing.assert_allclose(known["X_difference"], right - left, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(model.static_separation(v, s, card.aircraft), known["X"], rtol=1e-14)
    assert np.abs(right - left).max() > 0.2


def test_lift_and_drag_of_the_two_wings_roll_and_yaw_as_strips_of_half_the_area_do(card):
    """Force of either wing at 4/(3 pi) of the half span, moment r x F about body axes in N m."""
    s, a = signals(), card.aircraft
    model, v = model_and_values(card, tau1=0.0, tau2=0.0)
    known = model.flow(v, s, a)
    alpha, half = np.asarray(s["alpha"]), difference(s, a) / 2.0
    pressure_area, roll, yaw = 1234.0, 0.0, 0.0
    for side in (1.0, -1.0):
        X = expit(-2.0 * TRUTH["a1"] * (alpha + side * half - TRUTH["alpha_star"]))
        lift = TRUTH["CLa"] * alpha * ((1.0 + np.sqrt(X)) / 2.0) ** 2 * pressure_area / 2.0
        drag = TRUTH["CDX"] * (1.0 - X) * pressure_area / 2.0
        y = side * 4.0 / (3.0 * np.pi) * a.half_span
        along, down = lift * np.sin(alpha) - drag * np.cos(alpha), -lift * np.cos(alpha) - drag * np.sin(alpha)
        roll, yaw = roll + y * down, yaw - y * along
    span = 2.0 * a.half_span
    np.testing.assert_allclose(known["Cl"], roll / pressure_area / span, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(known["Cn"], yaw / pressure_area / span, rtol=1e-7, atol=1e-12)


def test_a_wing_that_stalls_first_drops_and_is_dragged_back(card):
    """Right first: rolls and yaws to the right, most of all about the stall angle."""
    s = signals() | dict.fromkeys(("p", "beta", "aileron"), jnp.zeros(N))
    model, v = model_and_values(card, {"wing_asymmetry": 0.01})
    known = model.flow(v, s, card.aircraft)
    assert np.all(known["X_difference"] < 0.0)
    assert np.all((known["Cl"] > 0.0) & (known["Cn"] > 0.0))
    assert np.max(known["Cl"]) > 50.0 * known["Cl"][np.argmin(s["alpha"])]


def test_wings_that_are_alike_are_one_to_the_last_bit(card):
    s = signals()
    one = Model.of([*card.effects], axes=BOTH)
    v = {k: jnp.asarray(x) for k, x in (TRUTH | {"tau1": 12.0}).items()}
    expected = one.flow(v, s, card.aircraft)
    model, alike = model_and_values(card, dict.fromkeys(TELL_APART, 0.0), tau1=12.0)
    for found in (model.flow(alike, s, card.aircraft), Model.of([*card.effects]).flow(v, s, card.aircraft)):
        for name in ("X", "CL", "CD", "Cm", "Cl", "Cn", "X_difference"):
            np.testing.assert_array_equal(found[name], expected[name], name)


def test_without_an_effect_that_tells_them_apart_nothing_is_computed_twice(card):
    """The program of a model of one axis is that of the same effects before wings were known: one X."""

    def steps(model, values):
        program = jax.make_jaxpr(lambda s: model.flow(values, s, card.aircraft)["CL"])(signals())
        return str(program).count("logistic")

    v = {k: jnp.asarray(x) for k, x in TRUTH.items()}
    at_neutral: dict[str, float] = dict.fromkeys(("wing_asymmetry", "roll_station"), 0.0)
    held = Model.of([*card.effects, "wing_asymmetry", "roll_rate_incidence", *WINGS], at_neutral, BOTH)
    assert not held.two_wings
    assert steps(Model.of(card.effects), v) == steps(held, v | at_neutral) == 1
    assert steps(*model_and_values(card)) == 2


def test_either_wing_lags_by_itself_behind_its_own_static_point(card):
    s, lag = signals(), 20.0
    model, v = model_and_values(card, tau1=lag)
    static, _ = model_and_values(card, tau1=0.0)
    before = static.flow(v | {"tau1": jnp.asarray(0.0)}, s, card.aircraft)
    after = model.flow(v, s, card.aircraft)
    tau = lag * card.aircraft.chord / s["airspeed"]
    right, left = (
        lagged(before["X"] + side * before["X_difference"] / 2.0, tau, s["dt"], s["start"]) for side in (1.0, -1.0)
    )
    np.testing.assert_allclose(after["X"], (right + left) / 2.0, rtol=1e-9)
    np.testing.assert_allclose(after["X_difference"], right - left, atol=1e-12)


def test_a_simulation_without_lag_gives_the_mean_and_gets_the_difference(card):
    s, (_, v) = signals(), model_and_values(card, tau1=0.0)
    model = Model.of([*card.effects, *TELL_APART, *WINGS], {"tau1": 0.0}, BOTH)
    whole = model.flow(v, s, card.aircraft)
    given = model.flow(v, s, card.aircraft, X=model.static_separation(v, s, card.aircraft))
    for name in ("X", "X_difference", "CL", "Cl", "Cn"):
        np.testing.assert_array_equal(given[name], whole[name])


@pytest.mark.parametrize("name", TELL_APART)
def test_moments_follow_the_strength_of_each_cause(card, name):
    """Derivatives of Cl and Cn by it, against central differences."""
    s, (model, v) = signals(), model_and_values(card, {name: 0.1 * TELL_APART[name]})
    (parameter,) = CATALOGUE[name].parameters

    def moments(x):
        known = model.flow(v | {parameter.name: x}, s, card.aircraft)
        return jnp.stack([known["Cl"], known["Cn"], known["CL"]])

    at, h = jnp.asarray(0.1 * TELL_APART[name]), 1e-6
    _, slope = jax.jvp(moments, (at,), (jnp.ones_like(at),))
    assert np.abs(slope[0]).max() > 1e-4
    np.testing.assert_allclose(slope, (moments(at + h) - moments(at - h)) / (2.0 * h), atol=2e-8)
