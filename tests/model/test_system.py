"""The simulation against closed forms, balances of momentum and energy, and the coefficients taken apart again."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.dynamics.aircraft import ENVELOPE, LATERAL, Longitudinal
from bayes_aero.dynamics.system import System, integrate
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import GRAVITY, NAMES, air
from bayes_aero.physics.coefficients import coefficients
from bayes_aero.physics.filters import differentiate
from bayes_aero.simulate.demo import TRUTH

DT = 0.04
N = 251
LINEAR = ("attached_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag")
INNER = slice(10, -10)


def numbers(**changes) -> dict[str, Any]:
    return {name: jnp.asarray(value) for name, value in (TRUTH | changes).items()}


def system(effects, aircraft, altitude=True, **changes) -> Longitudinal:
    return Longitudinal(Model.of(effects), numbers(**changes), aircraft, altitude)


def at_cg(card, **changes):
    origin = (0.0, 0.0, 0.0)
    return replace(card.aircraft, accelerometer=origin, **changes)


def inputs(n=N, dt=DT, **changes):
    """Elevator and thrust that move the aircraft, wings level."""
    t = np.arange(n) * dt
    elevator, thrust = -0.02 + 0.03 * np.sin(1.3 * t) * np.sin(0.31 * t), 2e4 + 4e3 * np.sin(0.4 * t)
    u = dict.fromkeys(LATERAL, np.zeros(n)) | {"elevator": elevator, "thrust": thrust}
    return {name: jnp.asarray(x) for name, x in (u | changes).items()}


def instant(elevator, thrust):
    """Inputs at one instant, wings level."""
    level = dict.fromkeys(LATERAL, 0.0) | {"elevator": elevator, "thrust": thrust}
    return {name: jnp.asarray(x) for name, x in level.items()}


def wings_not_level(n=N, dt=DT):
    """A weaving motion, recorded as it was; its parts need not fit each other for the balance in pitch."""
    t = np.arange(n) * dt
    p, r = 0.15 * np.sin(0.9 * t), 0.05 * np.cos(0.6 * t)
    return {
        "p": p, "r": r, "p_dot": 0.135 * np.cos(0.9 * t), "r_dot": -0.03 * np.sin(0.6 * t),
        "beta": 0.05 * np.sin(0.7 * t), "phi": 0.4 * np.sin(0.5 * t), "ay": 0.4 * np.cos(0.8 * t),
    }  # fmt: skip


def start(V=95.0, alpha=0.11, theta=0.12, q=0.0, altitude=5000.0):
    return jnp.asarray([V, alpha, theta, q, altitude])


fly = eqx.filter_jit(integrate)


class Falling(System):
    """x' = -2 t x^2, of which x = 1/(1 + t^2) is the solution from one."""

    @property
    def states(self):
        return ("x",)

    def motion(self, x, u):
        return -2.0 * u["t"] * x**2, {"x": x[0]}


def test_the_integration_is_of_fourth_order_and_substeps_are_steps():
    errors = []
    for n in (51, 101, 201):
        t = jnp.linspace(0.0, 3.0, n)
        found = fly(Falling(), jnp.ones(1), {"t": t}, 3.0 / (n - 1))
        errors.append(float(jnp.abs(found.outputs["x"] - 1.0 / (1.0 + t**2)).max()))
    assert errors[0] < 1e-4
    for coarse, fine in pairwise(errors):
        assert coarse / fine == pytest.approx(16.0, rel=0.2)
    # An input that is linear all along is the same at the half step, however it was sampled.
    coarse = fly(Falling(), jnp.ones(1), {"t": jnp.linspace(0.0, 3.0, 51)}, 0.06, substeps=4)
    fine = fly(Falling(), jnp.ones(1), {"t": jnp.linspace(0.0, 3.0, 201)}, 0.015)
    np.testing.assert_allclose(coarse.states, fine.states[::4], rtol=1e-12)


@pytest.mark.parametrize("more", [(), ("flow_separation", "kirchhoff_lift", "separated_moment", "separation_lag")])
def test_flight_is_integrated_to_fourth_order(card, more):
    """Richardson: inputs are linear within a sample, so its subdivision halves the step of a smooth problem."""
    flown = system((*LINEAR, *more), card.aircraft, tau1=30.0)
    begin = flown.complete_start(jnp.concatenate([start(), jnp.ones(int(bool(more)))]), instant(0.0, 0.0))
    found = [fly(flown, begin, inputs(80, 0.2), 0.2, substeps=k).states for k in (1, 2, 4)]
    first, second = (np.abs(np.asarray(a - b)).max(axis=0) for a, b in pairwise(found))
    assert np.all(second > 1e-9)
    np.testing.assert_allclose(first / second, 16.0, rtol=0.2)


def test_power_and_momentum_change_by_what_accelerometers_feel(card):
    """d/dt (V^2/2 + g h) is the specific force, as accelerometers at the CG feel it, times the velocity."""
    flight = fly(system(LINEAR, at_cg(card)), start(), inputs(), DT).outputs
    energy = 0.5 * flight["airspeed"] ** 2 + GRAVITY * flight["altitude"]
    force = flight["ax"] * jnp.cos(flight["alpha"]) + flight["az"] * jnp.sin(flight["alpha"])
    power = flight["airspeed"] * force
    assert float(jnp.ptp(power)) > 50.0
    np.testing.assert_allclose(differentiate(energy, DT)[INNER], power[INNER], atol=1e-3)
    # In earth axes: horizontal and vertical velocity, differentiated, against the turned specific force.
    s = fly(system(LINEAR, at_cg(card)), start(), inputs(), DT).outputs
    climb, theta = s["theta"] - s["alpha"], s["theta"]
    forward, up = s["airspeed"] * jnp.cos(climb), s["airspeed"] * jnp.sin(climb)
    sin, cos = jnp.sin(theta), jnp.cos(theta)
    assert float(jnp.ptp(up)) > 3.0
    np.testing.assert_allclose(differentiate(forward, DT)[INNER], (s["ax"] * cos + s["az"] * sin)[INNER], atol=2e-5)
    np.testing.assert_allclose(
        differentiate(up, DT)[INNER], (s["ax"] * sin - s["az"] * cos - GRAVITY)[INNER], atol=2e-5
    )
    np.testing.assert_allclose(differentiate(s["altitude"], DT)[INNER], up[INNER], atol=2e-5)
    np.testing.assert_allclose(differentiate(theta, DT)[INNER], s["q"][INNER], atol=2e-6)
    np.testing.assert_allclose(differentiate(s["q"], DT)[INNER], s["q_dot"][INNER], atol=2e-4)


def test_level_flight_in_trim_goes_on_and_without_forces_it_is_a_parabola(card):
    """Lift, drag and moment chosen by hand so that forces and moments vanish: for a minute nothing moves."""
    a, V, alpha, h, T = card.aircraft, 110.0, 0.08, 4000.0, 2.5e4
    qS = 0.5 * float(air(jnp.asarray(h))[0]) * V**2 * a.wing_area
    CL = (a.mass * GRAVITY - T * np.sin(alpha)) / qS
    CD = T * np.cos(alpha) / qS
    X, Z = CL * np.sin(alpha) - CD * np.cos(alpha), -CL * np.cos(alpha) - CD * np.sin(alpha)
    x, _, z = a.reference_point  # r x F of a force at the reference point pitches up by z X - x Z
    Cm = -(z * X - x * Z) / a.chord - T * a.engine[2] / (qS * a.chord)
    values = {"CL0": CL - 4.5 * alpha, "CLa": 4.5, "CD0": CD - CL**2 / (np.pi * a.aspect_ratio * 0.8), "e": 0.8}
    values |= {"Cm0": Cm + 0.5 * alpha, "Cma": -0.5, "Cmq": -8.0, "Cmde": -0.7}
    n = 1501
    flight = fly(
        system(LINEAR, a, **values), start(V, alpha, alpha, 0.0, h),
        inputs(n, elevator=jnp.zeros(n), thrust=jnp.full(n, T)), DT,
    )  # fmt: skip
    for name, value in {"airspeed": V, "alpha": alpha, "theta": alpha, "q": 0.0, "altitude": h}.items():
        np.testing.assert_allclose(flight.outputs[name], value, rtol=1e-9, atol=1e-9, err_msg=name)
    nothing, n = dict.fromkeys(("CL0", "CLa", "CD0", "Cm0", "Cma", "Cmq", "Cmde"), 0.0), 200
    thrown, u = start(90.0, 0.1, 0.5, 0.02, 3000.0), inputs(n, thrust=jnp.zeros(n))
    flight = fly(system(LINEAR, card.aircraft, **nothing), thrown, u, DT)
    assert bool(jnp.all(flight.inside))
    t = np.arange(n) * DT
    forward, up = 90.0 * np.cos(0.4), 90.0 * np.sin(0.4) - GRAVITY * t
    expected = {
        "airspeed": np.hypot(forward, up), "theta": 0.5 + 0.02 * t,
        "alpha": 0.5 + 0.02 * t - np.arctan2(up, forward), "q": np.full(n, 0.02),
        "altitude": 3000.0 + 90.0 * np.sin(0.4) * t - 0.5 * GRAVITY * t**2,
    }  # fmt: skip
    for name, value in expected.items():
        np.testing.assert_allclose(flight.outputs[name], value, rtol=1e-8, atol=1e-8, err_msg=name)


@pytest.mark.parametrize("lag", [0.0, 20.0])
def test_coefficients_taken_apart_are_those_put_together(card, lag):
    """What the sensors of a simulated stall would show gives back the CL, CD, Cm it was flown with."""
    lateral = {name: jnp.asarray(x) for name, x in wings_not_level().items()}
    t = np.arange(N) * DT
    u = inputs(elevator=jnp.asarray(-0.10 - 0.010 * t)) | lateral
    u["mach"] = jnp.full(N, 0.3)
    effects = card.effects if lag else [name for name in card.effects if name != "separation_lag"]
    flown = system(effects, card.aircraft, tau1=lag, tau2=20.0)
    begin = jnp.concatenate([start(V=90.0, alpha=0.2, theta=0.2), jnp.full(int(lag > 0.0), 0.9)])
    flight = fly(flown, begin, u, DT)
    assert bool(jnp.all(flight.inside))
    s = flight.outputs
    assert float(s["X"].min()) < 0.5
    assert float(jnp.abs(s["alpha_dot"]).max()) > 0.03
    seen = {name: s[name] for name in ("ax", "az", "q", "q_dot", "alpha", "airspeed")}
    seen |= {name: u[name] for name in ("p", "r", "p_dot", "r_dot", "thrust")} | {"density": air(s["altitude"])[0]}
    assert min(abs(x) for x in card.aircraft.accelerometer) > 0.05
    for name in NAMES:
        value = getattr(coefficients(seen, card.aircraft), name)
        assert float(jnp.ptp(value)) > 1e-3
        np.testing.assert_allclose(value, s[name], rtol=1e-10, atol=1e-13, err_msg=name)


def test_alpha_dot_solves_its_equation(card):
    """With a steep stall and much hysteresis lift depends on alpha-dot; here the equation is written out by hand."""
    a = at_cg(card)
    effects = [name for name in card.effects if name not in ("separation_lag", "mach_lift")]
    flown = system(effects, a, tau2=60.0, a1=60.0)
    v, rng, falling, separated = TRUTH | {"tau2": 60.0, "a1": 60.0}, np.random.default_rng(4), 0, 0
    move = eqx.filter_jit(Longitudinal.motion)
    for _ in range(300):
        V, alpha = rng.uniform(60.0, 110.0), rng.uniform(0.15, 0.36)
        theta, q = rng.uniform(-0.3, 0.5), rng.normal(0.0, 0.15)
        de, T = rng.normal(-0.05, 0.05), rng.uniform(0.0, 3e4)
        _, s = move(flown, jnp.asarray([V, alpha, theta, q, 5000.0]), instant(de, T))
        rate = float(s["alpha_dot"])
        felt = alpha - 60.0 * a.chord / V * min(rate, 0.0)
        X = 1.0 / (1.0 + np.exp(120.0 * (felt - v["alpha_star"])))
        # The root of the program's own X: of an X of 1e-17 rounding may leave nothing, and its root 1e-9 of lift.
        kept = ((1.0 + np.sqrt(float(s["X"]))) / 2.0) ** 2
        lift = v["CL0"] + v["CLa"] * alpha * kept - v["Cmde"] * a.chord / a.tail_arm * de
        qS = 0.5 * float(air(jnp.asarray(5000.0))[0]) * V**2 * a.wing_area
        level = q + (-lift * qS - T * np.sin(alpha)) / (a.mass * V) + GRAVITY * np.cos(theta - alpha) / V
        assert abs(rate - level) < 1e-10
        assert float(s["X"]) == pytest.approx(X, rel=1e-7, abs=1e-12)
        falling += rate < -0.02
        separated += (rate < 0.0) & (0.05 < X < 0.95)
    assert falling > 50
    assert separated > 10  # there the equation is truly implicit


@pytest.mark.parametrize("CLadot", [-18.0, 18.0])
def test_lift_due_to_alpha_dot_of_either_sign_divides_alpha_dot(card, CLadot):
    """m V alpha_dot loses the lift rho V^2 S/2 CLadot alpha_dot c/V: by hand, alpha_dot (1 + rho S c CLadot/2m)."""
    u, a = instant(-0.02, 2e4), card.aircraft
    without, found = (
        float(system((*LINEAR, *more), a, CLadot=CLadot).motion(start(q=0.05), u)[1]["alpha_dot"])
        for more in ((), ("alpha_dot_lift",))
    )
    factor = 1.0 + 0.5 * float(air(jnp.asarray(5000.0))[0]) * a.wing_area * a.chord * CLadot / a.mass
    assert found == pytest.approx(without / factor, rel=1e-12)


def test_the_separation_point_lags_as_a_state(card):
    """X' = (X_static - X) V/(tau1 c), X_static with the hysteresis of alpha-dot; it begins at X_static of rest."""
    flown = system([name for name in card.effects if name != "mach_lift"], card.aircraft, tau1=15.0, tau2=40.0, a1=40.0)
    assert flown.states[-1] == "X"
    u = instant(-0.1, 1e4)
    x = jnp.concatenate([start(75.0, 0.29, 0.1, -0.1), jnp.asarray([0.4])])
    derivative, s = flown.motion(x, u)
    rate = float(s["alpha_dot"])
    assert rate < -0.02
    felt = 0.29 - 40.0 * card.aircraft.chord / 75.0 * rate
    static = 0.5 * (1.0 - np.tanh(40.0 * (felt - TRUTH["alpha_star"])))
    assert float(derivative[-1]) == pytest.approx((static - 0.4) * 75.0 / (15.0 * card.aircraft.chord), rel=1e-9)
    at_rest = 0.5 * (1.0 - np.tanh(40.0 * (0.29 - TRUTH["alpha_star"])))
    assert float(flown.complete_start(x, u)[-1]) == pytest.approx(at_rest, rel=1e-12)
    assert float(s["X"]) == 0.4


@pytest.mark.parametrize("lag", [0.0, 15.0])
def test_sensitivities_are_those_of_finite_differences(card, lag):
    """Through the stall with hysteresis, where each step solves for alpha-dot."""
    dropped = {"mach_lift"} if lag else {"mach_lift", "separation_lag"}
    model = Model.of([name for name in card.effects if name not in dropped])
    names = [name for name in model.names if name != "tau1" or lag]
    t = np.arange(301) * DT
    u = inputs(301, elevator=jnp.asarray(-0.11 + 0.06 * np.sin(0.9 * t)), thrust=jnp.full(301, 1.5e4))
    base = jnp.asarray([dict(TRUTH, tau1=lag, tau2=20.0)[name] for name in names])

    @jax.jit
    def respond(theta):
        values = dict(zip(names, theta, strict=True))
        flown = Longitudinal(model, values, card.aircraft, True)
        x = jnp.concatenate([start(V=90.0, alpha=0.2, theta=0.2), jnp.full(int(lag > 0.0), 1.0)])
        first = {name: value[0] for name, value in u.items()}
        found = integrate(flown, flown.complete_start(x, first), u, DT)
        return jnp.stack([found.outputs[name] for name in ("airspeed", "alpha", "theta", "q", "az", "X")], axis=1)

    nominal = respond(base)
    assert float(nominal[:, 5].min()) < 0.4
    assert float(jnp.min(jnp.diff(nominal[:, 1]))) < -1e-3  # alpha falls, so that the hysteresis acts
    slopes = jax.jit(jax.jacfwd(respond))(base)
    for k, name in enumerate(names):
        h = 1e-6 * max(0.1, abs(float(base[k])))
        up, down = (respond(base.at[k].add(sign * h)) for sign in (1, -1))
        size = jnp.abs(slopes[:, :, k]).max(axis=0)
        assert float(size[1]) > 0.0
        error = jnp.abs((up - down) / (2.0 * h) - slopes[:, :, k]).max(axis=0)
        assert np.all(np.asarray(error) <= 1e-4 * np.asarray(size) + 1e-9), name


def test_what_leaves_the_envelope_stops_and_a_start_that_is_no_number_is_outside(card):
    """An unstable aircraft tumbles; states, outputs and their derivatives are numbers all the same."""

    def respond(Cma):
        flown = system(LINEAR, card.aircraft, Cma=Cma)
        return integrate(flown, start(), inputs(501), DT)

    found, slope = jax.jvp(jax.jit(respond), (jnp.asarray(3.0),), (jnp.asarray(1.0),))
    inside = np.asarray(found.inside)
    assert inside[0]
    assert not inside[-1]
    out = int(np.argmin(inside))
    assert not inside[out:].any()
    states = np.asarray(found.states)
    np.testing.assert_array_equal(states[out:], np.broadcast_to(states[out - 1], states[out:].shape))
    for name, x in zip(("airspeed", "alpha", "theta", "q"), states.T, strict=False):
        low, high = ENVELOPE[name]
        assert np.all((x >= low) & (x <= high))
    for tree in (found.states, found.outputs, slope.states, slope.outputs):
        assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(tree))
    assert np.ptp(np.asarray(slope.states)[:out], axis=0).min() > 0.0
    found = fly(system(LINEAR, card.aircraft), start(alpha=np.nan), inputs(20), DT)
    assert not np.asarray(found.inside).any()
