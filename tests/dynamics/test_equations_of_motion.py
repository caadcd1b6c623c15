"""Equations of motion and modes, with one lag of the separation point or two: closed forms and another simulator."""

from dataclasses import replace
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import six_axes as six
import stranger_six
from scipy.spatial.transform import Rotation
from stranger_six import Plane, Strips

from bayes_aero.dynamics.aircraft import ENVELOPE, HELD, Longitudinal, RigidBody
from bayes_aero.dynamics.flight import AircraftDynamics, aircraft_dynamics, linear_dynamics
from bayes_aero.dynamics.segments import segments, simulate
from bayes_aero.dynamics.system import System, integrate
from bayes_aero.dynamics.trim import Steady, modes, named_modes
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join
from bayes_aero.physics.aircraft import GRAVITY, NAMES, NO_AIRCRAFT, Axis, air
from bayes_aero.physics.coefficients import coefficients
from bayes_aero.simulate.demo import TRUTH

# Six degrees of freedom against closed forms and a simulator that shares no code
DT = 0.04
fly = eqx.filter_jit(integrate)
FLOW = ("airspeed", "alpha", "beta")
ODD = Plane(**six.ATTACHED, Ixy=1.5e3, Iyz=-2e3, nose=(1.5, 0.3, -0.4))
EVEN = Plane(**six.ATTACHED)
START = {"airspeed": 115.0, "alpha": 0.07, "theta": 0.09, "q": 0.01, "altitude": 4000.0}


def body(plane, model=None, **options):
    model = six.model() if model is None else model
    return RigidBody(model, six.values(plane, model), six.aircraft(plane), **options)


def start_of(system, **start):
    return jnp.array([float(start.get(name, 0.0)) for name in system.start])


def state_at_start(system, **start):
    return system.state_at_start(start_of(system, **start))


def inputs(flight):
    return {name: x for name, x in six.channels(flight).items() if name != "density"}


def turning(n, **rates):
    """A body in no air, its path held: it turns as the `rates` say."""
    system = body(ODD, altitude=False, held=(*FLOW, *rates))
    still = dict.fromkeys(("elevator", "aileron", "rudder", "thrust", "density", "alpha", "beta", "alpha_dot"), 0.0)
    u = still | {"airspeed": 100.0, "sound": 300.0} | {f"{name}_dot": 0.0 for name in rates} | rates
    return system, {name: jnp.broadcast_to(jnp.asarray(x, float), n) for name, x in u.items()}


def test_attitude_follows_any_rates_through_the_vertical():
    """Against the product of rotations by scipy, of which each lasts a sample at the rate of its middle."""
    n, dt = 3001, 0.002
    t = np.arange(n) * dt
    rates = {"p": 0.5 * np.sin(2.0 * t), "q": 1.2 + 0.3 * np.cos(t), "r": 0.2 * np.cos(3.0 * t)}
    system, u = turning(n, **rates)
    found = fly(system, state_at_start(system, phi=0.1, theta=-0.2, psi=1.0), u, dt).outputs
    middle = np.stack([0.5 * (x[1:] + x[:-1]) for x in rates.values()], axis=1)
    turned = Rotation.from_euler("ZYX", [1.0, -0.2, 0.1])
    for step in Rotation.from_rotvec(dt * middle):
        turned = turned * step
    assert float(jnp.abs(found["theta"]).max()) > np.radians(70.0)
    last = Rotation.from_euler("ZYX", [float(found[name][-1]) for name in ("psi", "theta", "phi")])
    np.testing.assert_allclose((turned.inv() * last).magnitude(), 0.0, atol=3e-6)
    # Beyond half a turn bank and heading are those nearest to the recorded ones.
    n, dt, r = 401, 0.05, 0.6
    system, u = turning(n, p=0.0, q=0.0, r=r)
    heading = 5.0 * np.pi + 0.2 + r * np.arange(n) * dt
    u |= {"near_psi": jnp.asarray(heading + 0.1), "near_phi": jnp.full(n, -4.0 * np.pi)}
    found = fly(system, state_at_start(system, psi=np.pi + 0.2), u, dt).outputs
    np.testing.assert_allclose(found["psi"], heading, atol=1e-9)
    np.testing.assert_allclose(found["phi"], -4.0 * np.pi, atol=1e-9)


def instant(**given):
    """Inputs at one instant."""
    return {name: jnp.asarray(x) for name, x in given.items()}


def moved(n, dt, **more):
    """Elevator and thrust that move the aircraft, wings level."""
    t = np.arange(n) * dt
    u = {"elevator": -0.01 + 0.02 * np.sin(1.3 * t) * np.sin(0.31 * t), "thrust": 2e4 + 4e3 * np.sin(0.4 * t)}
    u |= {"aileron": 0.0 * t, "rudder": 0.0 * t} | more
    return {name: jnp.asarray(x) for name, x in u.items()}


def wings_not_level(t):
    """A weaving motion, recorded as it was; its parts need not fit each other for the balance in pitch."""
    return {
        "p": 0.15 * np.sin(0.9 * t), "r": 0.05 * np.cos(0.6 * t), "p_dot": 0.135 * np.cos(0.9 * t),
        "r_dot": -0.03 * np.sin(0.6 * t), "beta": 0.05 * np.sin(0.7 * t), "phi": 0.4 * np.sin(0.5 * t),
        "ay": 0.4 * np.cos(0.8 * t),
    }  # fmt: skip


def test_without_lateral_input_it_is_longitudinal_motion():
    effects = (*six.LONGITUDINAL, *six.STALL)
    plane = Plane(**six.ATTACHED | {"stalls": True}, tau1=20.0, alpha_star=0.12)
    model = six.model(effects, (Axis.LONGITUDINAL,))
    flat = Longitudinal(model, six.values(plane, model), six.aircraft(plane))
    whole = body(plane, six.model((*effects, *six.LATERAL)))
    u = moved(501, 0.04)
    ends = []
    for system in (flat, whole):
        start = system.complete_start(start_of(system, **START), {name: x[0] for name, x in u.items()})
        ends.append(fly(system, system.state_at_start(start), u, 0.04, 3).outputs)
    assert float(jnp.ptp(ends[0]["X"])) > 0.1
    for name, x in ends[0].items():
        np.testing.assert_allclose(ends[1][name], x, rtol=1e-9, atol=1e-9, err_msg=name)


def test_a_centre_of_gravity_aside_and_uneven_engines_turn_it_as_another_simulator_says():
    """Rates at one instant; the engines' true thrust is what the effect makes of the recorded one."""
    odd = Plane(**six.ATTACHED, aside=0.12, uneven=0.2)
    model = six.model((*six.LONGITUDINAL, *six.LATERAL, "lateral_cg_shift", "thrust_asymmetry"))
    known = six.values(odd, model, lateral_cg_shift=0.12, thrust_asymmetry=0.2)
    system = RigidBody(model, known, model.actual_aircraft(known, six.aircraft(odd)))
    x, controls = stranger_six.level(EVEN, 110.0, 4000.0)
    x[[1, 3, 4, 5]] = 3.0, 0.1, 0.05, -0.04
    theirs, first = odd.rates(x, controls), odd.sensed(x, controls)
    u = {name: jnp.asarray(y) for name, y in first.items() if name in stranger_six.CONTROLS or name == "thrust"}
    _, found = system.motion(state_at_start(system, **first), model.corrected(known, u, system.aircraft))
    np.testing.assert_allclose([found[f"{n}_dot"] for n in ("p", "q", "r")], theirs[3:6], rtol=1e-6, atol=1e-9)
    for name in ("ax", "ay", "az"):
        np.testing.assert_allclose(found[name], first[name], rtol=1e-6)
    assert np.abs(theirs[3:6] - EVEN.rates(x, controls)[3:6])[[0, 2]].min() > 0.01


SEEN = ("airspeed", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi", "altitude", "ax", "ay", "az")


@pytest.mark.parametrize(("kind", "moving", "least"), [("aileron", "p", 0.2), ("rudder", "beta", 0.1)])
def test_it_flies_as_another_simulator_does(kind, moving, least):
    flight = stranger_six.fly(ODD, kind, np.random.default_rng(2), seconds=15.0)
    assert np.ptp(flight[moving]) > least
    for euler in (False, True):
        system = body(ODD, euler=euler)
        start = state_at_start(system, **{n: flight[n][0] for n in system.start})
        found = fly(system, start, inputs(flight), 0.04, 2).outputs
        for name in SEEN:
            np.testing.assert_allclose(found[name], flight[name], rtol=2e-7, atol=2e-7, err_msg=name)


def test_an_axis_without_a_model_is_prescribed():
    """Roll and yaw with sideslip held to the record, as in the published case: p and r alone are simulated."""
    flight = stranger_six.fly(EVEN, "rudder", np.random.default_rng(5), dt=0.02, seconds=15.0)
    model = six.model(six.LATERAL, (Axis.LATERAL,))
    held = (*HELD[Axis.LONGITUDINAL], "beta", "phi")
    system = body(EVEN, model, altitude=False, held=held, heading=False)
    assert system.states == ("p", "r")
    slope = lambda name: np.gradient(flight[name], 0.02)
    spin = np.stack([flight[n] for n in ("p", "q", "r")], axis=1)
    turned = np.stack([slope(n) for n in ("p", "q", "r")], axis=1)
    arm = np.broadcast_to(EVEN.nose, spin.shape)
    felt = np.cross(turned, arm) + np.cross(spin, np.cross(spin, arm))
    u = six.channels(flight) | {name: jnp.asarray(flight[name]) for name in held}
    u |= {f"{name}_dot": jnp.asarray(slope(name)) for name in ("alpha", "q")}
    u |= {"force_x": jnp.asarray(flight["ax"] - felt[:, 0]), "force_z": jnp.asarray(flight["az"] - felt[:, 2])}
    found = fly(system, jnp.array([flight[n][0] for n in system.states]), u, 0.02).outputs
    for name in ("p", "r"):
        assert np.ptp(flight[name]) > 0.1
        np.testing.assert_allclose(found[name], flight[name], atol=2e-4 * np.ptp(flight[name]))
    np.testing.assert_allclose(found["ay"], flight["ay"], atol=2e-3 * np.ptp(flight["ay"]))


# Three degrees of freedom, the lateral motion prescribed: integration, the stall, sensitivities
LINEAR = ("attached_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag")


def longitudinal(effects, aircraft, **changes) -> Longitudinal:
    values = {name: jnp.asarray(value) for name, value in (TRUTH | changes).items()}
    return Longitudinal(Model.of(effects), values, aircraft, True)


def begin(V=95.0, alpha=0.11, theta=0.12, q=0.0, altitude=5000.0):
    return jnp.asarray([V, alpha, theta, q, altitude])


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


def test_coefficients_taken_apart_are_those_put_together(card):
    """What the sensors of a simulated stall would show gives back the CL, CD, Cm it was flown with."""
    n = 251
    t = np.arange(n) * DT
    u = moved(n, DT, elevator=-0.10 - 0.010 * t, mach=np.full(n, 0.3), **wings_not_level(t))
    flown = longitudinal(card.effects, card.aircraft, tau1=20.0, tau2=20.0)
    flight = fly(flown, jnp.append(begin(V=90.0, alpha=0.2, theta=0.2), 0.9), u, DT)
    assert bool(jnp.all(flight.inside))
    s = flight.outputs
    assert float(s["X"].min()) < 0.5
    assert float(jnp.abs(s["alpha_dot"]).max()) > 0.03
    seen = {name: s[name] for name in ("ax", "az", "q", "q_dot", "alpha", "airspeed")}
    seen |= {name: u[name] for name in ("p", "r", "p_dot", "r_dot", "thrust")} | {"density": air(s["altitude"])[0]}
    assert min(abs(x) for x in card.aircraft.accelerometer) > 0.05
    apart = coefficients(seen, card.aircraft)
    for name in NAMES:
        assert float(jnp.ptp(apart[name])) > 1e-3
        np.testing.assert_allclose(apart[name], s[name], rtol=1e-10, atol=1e-13, err_msg=name)


def test_alpha_dot_solves_its_equation(card):
    """With a steep stall and much hysteresis lift depends on alpha-dot; here the equation is written out by hand."""
    a = replace(card.aircraft, accelerometer=(0.0, 0.0, 0.0))
    effects = [name for name in card.effects if name not in ("separation_lag", "mach_lift")]
    flown = longitudinal(effects, a, tau2=60.0, a1=60.0)
    v, rng, falling, separated = TRUTH | {"tau2": 60.0, "a1": 60.0}, np.random.default_rng(4), 0, 0
    move = eqx.filter_jit(Longitudinal.motion)
    for _ in range(300):
        V, alpha = rng.uniform(60.0, 110.0), rng.uniform(0.15, 0.36)
        theta, q = rng.uniform(-0.3, 0.5), rng.normal(0.0, 0.15)
        de, T = rng.normal(-0.05, 0.05), rng.uniform(0.0, 3e4)
        _, s = move(flown, jnp.asarray([V, alpha, theta, q, 5000.0]), instant(elevator=de, thrust=T))
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
    u, a = instant(elevator=-0.02, thrust=2e4), card.aircraft
    without, found = (
        float(longitudinal((*LINEAR, *more), a, CLadot=CLadot).motion(begin(q=0.05), u)[1]["alpha_dot"])
        for more in ((), ("alpha_dot_lift",))
    )
    factor = 1.0 + 0.5 * float(air(jnp.asarray(5000.0))[0]) * a.wing_area * a.chord * CLadot / a.mass
    assert found == pytest.approx(without / factor, rel=1e-12)


def test_the_separation_point_lags_as_a_state(card):
    """X' = (X_static - X) V/(tau1 c), X_static with the hysteresis of alpha-dot; it begins at X_static of rest."""
    effects = [name for name in card.effects if name != "mach_lift"]
    flown = longitudinal(effects, card.aircraft, tau1=15.0, tau2=40.0, a1=40.0)
    assert flown.states[-1] == "X"
    u = instant(elevator=-0.1, thrust=1e4)
    x = jnp.concatenate([begin(75.0, 0.29, 0.1, -0.1), jnp.asarray([0.4])])
    derivative, s = flown.motion(x, u)
    rate = float(s["alpha_dot"])
    assert rate < -0.02
    felt = 0.29 - 40.0 * card.aircraft.chord / 75.0 * rate
    static = 0.5 * (1.0 - np.tanh(40.0 * (felt - TRUTH["alpha_star"])))
    assert float(derivative[-1]) == pytest.approx((static - 0.4) * 75.0 / (15.0 * card.aircraft.chord), rel=1e-9)
    at_rest = 0.5 * (1.0 - np.tanh(40.0 * (0.29 - TRUTH["alpha_star"])))
    assert float(flown.complete_start(x, u)[-1]) == pytest.approx(at_rest, rel=1e-12)
    assert float(s["X"]) == 0.4


def test_sensitivities_are_those_of_finite_differences(card):
    """Through the stall with hysteresis, where each step solves for alpha-dot."""
    model = Model.of([name for name in card.effects if name not in ("mach_lift", "separation_lag")])
    t = np.arange(301) * DT
    u = moved(301, DT, elevator=-0.11 + 0.06 * np.sin(0.9 * t), thrust=np.full(301, 1.5e4))
    base = jnp.asarray([dict(TRUTH, tau2=20.0)[name] for name in model.names])

    def respond(theta):
        flown = Longitudinal(model, dict(zip(model.names, theta, strict=True)), card.aircraft, True)
        first = {name: value[0] for name, value in u.items()}
        shown = integrate(flown, flown.complete_start(begin(V=90.0, alpha=0.2, theta=0.2), first), u, DT).outputs
        return jnp.stack([shown[name] for name in ("airspeed", "alpha", "theta", "q", "az", "X")], axis=1)

    along = jax.jit(lambda theta, direction: jax.jvp(respond, (theta,), (direction,)))
    for name, value, direction in zip(model.names, base, jnp.eye(len(base)), strict=True):
        h = 1e-6 * max(0.1, abs(float(value)))
        nominal, slope = along(base, direction)
        up, down = (along(base + sign * h * direction, direction)[0] for sign in (1, -1))
        size = jnp.abs(slope).max(axis=0)
        assert float(size[1]) > 0.0
        error = jnp.abs((up - down) / (2.0 * h) - slope).max(axis=0)
        assert np.all(np.asarray(error) <= 1e-4 * np.asarray(size) + 1e-9), name
    assert float(nominal[:, 5].min()) < 0.4
    assert float(jnp.min(jnp.diff(nominal[:, 1]))) < -1e-3  # alpha falls, so that the hysteresis acts


def test_what_leaves_the_envelope_stops_and_a_start_that_is_no_number_is_outside(card):
    """An unstable aircraft tumbles; states, outputs and their derivatives are numbers all the same."""

    def respond(Cma):
        flown = longitudinal(LINEAR, card.aircraft, Cma=Cma)
        return integrate(flown, begin(), moved(501, DT), DT)

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
    found = fly(longitudinal(LINEAR, card.aircraft), begin(alpha=np.nan), moved(20, DT), DT)
    assert not np.asarray(found.inside).any()


# Two wings whose separation points lag apart: against another simulator, one wing, and coefficients
APART = ("wing_asymmetry", "roll_rate_incidence", "sideslip_incidence", "wing_lift_difference", "wing_drag_difference")
STALL = (*six.LONGITUDINAL, *six.LATERAL, *six.STALL)
PLANE = Strips(tau1=15.0, first=0.01, alpha_star=0.2)


def model_and_values():
    """The aircraft's own model: the left half stalls `first`, so that the right less the left incidence is less."""
    model = six.model((*STALL, *APART))
    known = six.values(
        PLANE, model, wing_asymmetry=-PLANE.first, roll_station=PLANE.station / (PLANE.b / 2.0),
        sideslip_incidence=2.0 * PLANE.dihedral, alpha_star=PLANE.alpha_star - PLANE.first / 2.0,
    )  # fmt: skip
    return model, {name: x for name, x in known.items() if name in {p.name for p in model.parameters}}


@pytest.fixture(scope="module")
def flight():
    """A stall with aileron of the other simulator."""
    return stranger_six.fly(PLANE, "stall", np.random.default_rng(4), dt=DT, seconds=20.0, V=95.0)


def begun(flight):
    """The system with its start and inputs, of which nobody gives the separation points."""
    system, u = RigidBody(*model_and_values(), six.aircraft(PLANE)), inputs(flight)
    first = {name: x[0] for name, x in u.items()}
    start = system.complete_start(start_of(system, **{n: x[0] for n, x in flight.items()}), first)
    return system, system.state_at_start(start), u


def test_two_lags_fly_as_those_of_another_simulator_and_as_the_coefficients_of_a_record(flight):
    """The lag of sampled static points, linear between samples, against the states that were integrated."""
    system, start, u = begun(flight)
    assert system.states[-2:] == ("X_right", "X_left")
    found = fly(system, start, u, DT, 2)
    assert found.outputs["X"].min() < 0.5
    assert np.abs(found.states[:, -2] - found.states[:, -1]).max() > 0.1
    for name in SEEN:
        atol = 5e-5 * np.ptp(flight[name])  # an aircraft that rolls by itself in the stall grows what rounding leaves
        np.testing.assert_allclose(found.outputs[name], flight[name], atol=atol, err_msg=name)
    n = len(flight["time"])
    signals = found.outputs | u | {"dt": jnp.full(n, DT), "start": jnp.arange(n) == 0}
    flow = jax.jit(lambda s: system.model.flow(system.values, s, system.aircraft))(signals)
    both = np.stack([flow["X"] + side * flow["X_difference"] / 2.0 for side in (1.0, -1.0)], axis=1)
    np.testing.assert_allclose(both, found.states[:, -2:], atol=5e-4)
    for name in ("CL", "CD", "Cm", "CY", "Cl", "Cn"):
        np.testing.assert_allclose(flow[name], found.outputs[name], atol=5e-4 * np.ptp(found.outputs[name]))


def test_a_record_is_flown_with_both(flight, tmp_path):
    """From a card to segments: no record shows separation points, and none of them can be given."""
    channels = {name: flight[name] for name in (*six.RECORDED, "thrust")}
    record = FlightRecord.from_arrays("stall", flight["time"], channels, "simulated")
    flights = join([record], six.card_in(tmp_path, PLANE), ())
    model, known = model_and_values()
    dynamics = aircraft_dynamics(model, flights)
    flown = segments(flights, dynamics, fixed={}, substeps=2)
    theta = jnp.array([known[name] for name in model.names])
    found = eqx.filter_jit(simulate)(flown.nameless, theta, jnp.zeros((1, len(dynamics.start))))
    scale = np.ptp(np.asarray(found.measured[0]), axis=0)
    assert np.all(np.abs(np.asarray(found.residual[0])) < 2e-4 * scale + 1e-6)
    with pytest.raises(InputError, match="initial state has X_left"):
        segments(flights, dynamics, fixed={"X_left": 0.5})


# Modes of motion against textbooks, closed forms and that simulator
# Boeing 747 in cruise at Mach 0.8 and 40,000 ft. Etkin and Reid, Dynamics of Flight, 3rd ed. 1996, sections 6.2 and
# 6.7: speeds in ft/s, at 774 ft/s.
JET = 774.0
LONGITUDINAL = (
    [-0.006868, 0.01395, 0.0, -32.2], [-0.09055, -0.3151, 773.98, 0.0], [0.0001187, -0.001026, -0.4285, 0.0],
    [0.0, 0.0, 1.0, 0.0],
)  # fmt: skip
LATERAL = (
    [-0.0558, 0.0, -774.0, 32.2], [-0.003865, -0.4342, 0.4136, 0.0], [0.001086, -0.006112, -0.1458, 0.0],
    [0.0, 1.0, 0.0, 0.0],
)  # fmt: skip
PUBLISHED = {
    "short period": -0.3719 + 0.8875j, "phugoid": -0.003289 + 0.06723j,
    "Dutch roll": -0.03301 + 0.94655j, "roll": -0.56248, "spiral": -0.0072973,
}  # fmt: skip


def of(found):
    return {mode.name: mode.eigenvalue for mode in found}


def dynamics_of(plane, *effects, axes=six.BOTH):
    model = six.model(effects, axes)
    return AircraftDynamics(model), six.values(plane, model)


def derivative(plane, V, h):
    """Of the other simulator's rates by u, v, w, p, q, r, phi and theta in level flight, by central differences."""
    x, controls = stranger_six.level(plane, V, h)
    kept, A = np.arange(8), np.zeros((8, 8))
    for k in kept:
        step = np.zeros(12)
        step[k] = 1e-5 * (V if k < 3 else 1.0)
        ends = [plane.rates(x + sign * step, controls)[:8] for sign in (1.0, -1.0)]
        A[:, k] = (ends[0] - ends[1]) / (2.0 * step[k])
    return A


def test_the_published_modes_of_a_jet_transport():
    sideways = np.array(LATERAL)
    sideways[0, 1:] /= JET  # v to beta
    sideways[1:, 0] *= JET
    found = of(named_modes(np.array(LONGITUDINAL), ("airspeed", "w", "q", "theta"), JET))
    found |= of(named_modes(sideways, ("beta", "p", "r", "phi"), JET))
    assert set(found) == set(PUBLISHED)
    for name, value in PUBLISHED.items():
        assert abs(found[name] - value) < 1e-3 * abs(value), name


LONG, LAT = (Axis.LONGITUDINAL,), (Axis.LATERAL,)
ALL = {"short period", "phugoid", "Dutch roll", "roll", "spiral"}
PLANES = {  # effects, axes and names of the modes; cards of one axis have its own
    "both axes": (EVEN, (*six.LONGITUDINAL, *six.LATERAL), six.BOTH, ALL),
    "stable dihedral": (
        Plane(**six.ATTACHED, engine_arm=0.0, Cnbe=0.05, Clbe=-0.12), (*six.LONGITUDINAL, *six.LATERAL), six.BOTH, ALL,
    ),
    "longitudinal": (EVEN, six.LONGITUDINAL, LONG, {"short period", "phugoid"}),
    "lateral": (EVEN, six.LATERAL, LAT, {"Dutch roll", "roll", "spiral"}),
    "unstable": (Plane(**six.ATTACHED, Cma=0.5), six.LONGITUDINAL, LONG, {"short period, aperiodic", "phugoid"}),
}  # fmt: skip


@pytest.mark.parametrize("which", PLANES)
def test_modes_are_those_of_another_simulator(which):
    """The eigenvalues are the same in body velocities and in airspeed and flow angles."""
    plane, effects, axes, names = PLANES[which]
    dynamics, values = dynamics_of(plane, *effects, axes=axes)
    trim = stranger_six.level(plane, 120.0, 4000.0)[0]
    steady = Steady(120.0, 4000.0, float(np.arctan2(trim[2], trim[0])) if axes == LAT else 0.0)
    found = modes(dynamics, values, six.aircraft(plane), steady)
    assert {mode.name for mode in found} == names
    theirs = np.linalg.eigvals(derivative(plane, 120.0, 4000.0))
    for mode in found:
        assert np.min(np.abs(theirs - mode.eigenvalue)) < 1e-6 * max(1.0, abs(mode.eigenvalue)), mode.name
    assert which != "unstable" or max(mode.eigenvalue.real for mode in found) > 0.1


def test_a_linear_card_has_the_eigenvalues_of_its_matrix():
    """Short period: of x^2 - (Zalpha + Mq) x + Zalpha Mq - Malpha; roll and yaw without coupling: Lp and Nr."""
    dynamics = linear_dynamics(read_card("attas_short_period"))
    values = dict.fromkeys(dynamics.names, 0.0) | dynamics.fixed | {"Zalpha": -0.9, "Malpha": -2.1, "Mq": -1.3}
    (mode,) = modes(dynamics, values, NO_AIRCRAFT, Steady(100.0, 0.0))
    assert mode.name == "short period"
    assert mode.eigenvalue == pytest.approx(np.roots([1.0, 2.2, 0.9 * 1.3 + 2.1])[0], rel=1e-12)
    dynamics = linear_dynamics(read_card("lateral"))
    values = dict.fromkeys(dynamics.names, 0.0) | {"Lp": -2.5, "Nr": -0.4}
    assert of(modes(dynamics, values, NO_AIRCRAFT, Steady(100.0, 0.0))) == {"roll": -2.5, "other": -0.4}


def test_a_lag_of_the_separation_adds_a_mode_and_moves_no_other():
    """Far from the stall it does not act; its own eigenvalue is -V/(tau1 c)."""
    whole, values = dynamics_of(EVEN, *six.LONGITUDINAL, *six.LATERAL)
    lagged, own = dynamics_of(EVEN, *six.LONGITUDINAL, *six.LATERAL, *six.STALL)
    own |= {"tau1": 4.0, "a1": 60.0}
    steady = Steady(150.0, 4000.0)
    found = modes(lagged, own, six.aircraft(EVEN), steady)
    plain = of(modes(whole, values, six.aircraft(EVEN), steady))
    (other,) = (mode for mode in found if mode.name == "other")
    assert other.eigenvalue.real == pytest.approx(-150.0 / (4.0 * EVEN.c), rel=1e-3)
    for mode in found:
        if mode is not other:
            assert abs(mode.eigenvalue - plain[mode.name]) < 1e-3


def test_motion_without_modes_is_refused():
    dynamics, values = dynamics_of(EVEN, *six.LONGITUDINAL, *six.LATERAL)
    with pytest.raises(InputError, match="no steady flight at 20 m/s"):
        modes(dynamics, values, six.aircraft(EVEN), Steady(20.0, 4000.0))
    held = AircraftDynamics(dynamics.model, held=("beta", "phi"))
    with pytest.raises(InputError, match="holds beta, phi to the record"):
        modes(held, values, six.aircraft(EVEN), Steady(120.0, 4000.0))
    with pytest.raises(InputError, match="not finite"):
        named_modes(np.array([[np.nan]]), ("p",), 100.0)
