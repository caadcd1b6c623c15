"""Two wings whose separation points lag apart: against another simulator, one wing, and coefficients."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import six_axes as six
import stranger_six
from stranger_six import Strips

from bayes_aero.dynamics.aircraft.rigid_body import RigidBody
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.segments import segments, simulate
from bayes_aero.dynamics.simulated.rigid_pilot import fly_rigid
from bayes_aero.dynamics.simulated.rigid_trim import Condition, rigid_trim
from bayes_aero.dynamics.simulated.simulate import Pilot
from bayes_aero.dynamics.system import integrate
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.joined_channels import join

fly = eqx.filter_jit(integrate)
APART = ("wing_asymmetry", "roll_rate_incidence", "sideslip_incidence", "wing_lift_difference", "wing_drag_difference")
STALL = (*six.LONGITUDINAL, *six.LATERAL, *six.STALL)
PLANE = Strips(tau1=15.0, first=0.01, alpha_star=0.2)
DT = 0.04
ALIKE = 0.02
SEEN = ("airspeed", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi", "altitude", "ax", "ay", "az")


def model_and_values(plane=PLANE, effects=(*STALL, *APART)):
    """The aircraft's own model: the left half stalls `first`, so that the right less the left incidence is less."""
    model = six.model(effects)
    known = six.values(
        plane,
        model,
        wing_asymmetry=-plane.first,
        roll_station=plane.station / (plane.b / 2.0),
        sideslip_incidence=2.0 * plane.dihedral,
        alpha_star=plane.alpha_star - plane.first / 2.0,
    )
    return model, {name: x for name, x in known.items() if name in {p.name for p in model.parameters}}


@pytest.fixture(scope="module")
def flight():
    """A stall with aileron of the other simulator."""
    return stranger_six.fly(PLANE, "stall", np.random.default_rng(4), dt=DT, seconds=20.0, V=95.0)


def body(plane=PLANE, effects=(*STALL, *APART), **options):
    model, known = model_and_values(plane, effects)
    return RigidBody(model, known, six.aircraft(plane), **options)


def state_at_start(system, **start):
    return jnp.array([float(start.get(name, 0.0)) for name in system.start])


def inputs(flight):
    return {name: x for name, x in six.channels(flight).items() if name != "density"}


@pytest.mark.parametrize("euler", [False, True])
def test_two_lags_fly_as_those_of_another_simulator(flight, euler):
    system, u = body(euler=euler), inputs(flight)
    assert system.states[-2:] == ("X_right", "X_left")
    first = {name: x[0] for name, x in u.items()}
    start = system.complete_start(state_at_start(system, **{n: x[0] for n, x in flight.items()}), first)
    found = fly(system, system.state_at_start(start), u, DT, 2)
    assert found.outputs["X"].min() < 0.5
    assert np.abs(found.states[:, -2] - found.states[:, -1]).max() > 0.1
    for name in SEEN:
        atol = 5e-5 * np.ptp(flight[name])  # an aircraft that rolls by itself in the stall grows what rounding leaves
        np.testing.assert_allclose(found.outputs[name], flight[name], atol=atol, err_msg=name)


def test_rates_of_both_points_and_of_the_body_are_those_of_another_simulator(flight):
    system, k, points = body(), 400, (0.35, 0.6)
    now = {name: x[k] for name, x in flight.items()}
    V, alpha, beta = (now[n] for n in ("airspeed", "alpha", "beta"))
    velocity = V * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    turning = [now[n] for n in ("p", "q", "r", "phi", "theta", "psi", "altitude")]
    theirs = PLANE.rates(
        np.array([*velocity, *turning, points[1], points[0]]), np.array([now[n] for n in stranger_six.CONTROLS])
    )
    start = state_at_start(system, **now, X_right=points[0], X_left=points[1])
    u = {name: x[k] for name, x in inputs(flight).items()}
    rates, _ = system.motion(system.state_at_start(start), u)
    ours = dict(zip(system.states, np.asarray(rates), strict=True))
    np.testing.assert_allclose([ours["X_left"], ours["X_right"]], theirs[10:], rtol=1e-8)
    np.testing.assert_allclose([ours[n] for n in ("p", "q", "r")], theirs[3:6], rtol=1e-6)
    assert abs(theirs[3]) > 0.05


def test_wings_that_nothing_tells_apart_fly_as_one():
    """Without asymmetry, roll or sideslip; elevator and thrust alone move the aircraft."""
    even = replace(PLANE, first=0.0)
    t = np.arange(501) * DT
    u = {"elevator": -0.05 - 0.06 * np.sin(0.25 * t), "thrust": 2e4 + 4e3 * np.sin(0.4 * t)}
    u = {name: jnp.asarray(x) for name, x in (u | {"aileron": 0.0 * t, "rudder": 0.0 * t}).items()}
    ends = []
    for effects in (STALL, (*STALL, *APART)):
        system = body(even, effects)
        start = state_at_start(system, airspeed=95.0, alpha=0.12, theta=0.12, altitude=4000.0)
        start = system.complete_start(start, {name: x[0] for name, x in u.items()})
        ends.append((system.states, fly(system, system.state_at_start(start), u, DT, 3)))
    (one, whole), (two, wings) = ends
    assert (one[-1:], two[-2:]) == (("X",), ("X_right", "X_left"))
    assert whole.outputs["X"].min() < 0.5
    for name, x in whole.outputs.items():
        np.testing.assert_allclose(wings.outputs[name], x, rtol=1e-9, atol=1e-9, err_msg=name)
    for side in (-1, -2):
        np.testing.assert_allclose(wings.states[:, side], whole.states[:, -1], atol=1e-9)


def test_coefficients_of_the_record_are_those_of_the_simulation(flight):
    """The lag of sampled static points against the states that were integrated; linear between samples."""
    system, u = body(), inputs(flight)
    first = {name: x[0] for name, x in u.items()}
    start = system.complete_start(state_at_start(system, **{n: x[0] for n, x in flight.items()}), first)
    found = fly(system, system.state_at_start(start), u, DT, 2)
    n = len(flight["time"])
    signals = found.outputs | u | {"dt": jnp.full(n, DT), "start": jnp.arange(n) == 0}
    known = system.model.flow(system.values, signals, system.aircraft)
    both = np.stack([known["X"] + side * known["X_difference"] / 2.0 for side in (1.0, -1.0)], axis=1)
    np.testing.assert_allclose(both, found.states[:, -2:], atol=5e-4)
    for name in ("CL", "CD", "Cm", "CY", "Cl", "Cn"):
        np.testing.assert_allclose(known[name], found.outputs[name], atol=5e-4 * np.ptp(found.outputs[name]))


def test_a_record_is_flown_with_both(flight, tmp_path):
    """From a card to segments: no record shows separation points, and none of them can be given."""
    path = tmp_path / "another.toml"
    path.write_text(six.card_text(PLANE), encoding="utf-8")
    channels = {name: flight[name] for name in (*six.RECORDED, "thrust")}
    record = FlightRecord.from_arrays("stall", flight["time"], channels, "simulated")
    flights = join([record], read_card(str(path)), ())
    model, known = model_and_values()
    dynamics = aircraft_dynamics(model, flights)
    flown = segments(flights, dynamics, fixed={}, substeps=2)
    theta = jnp.array([known[name] for name in model.names])
    found = simulate(flown, theta, jnp.zeros((1, len(dynamics.start))))
    scale = np.ptp(np.asarray(found.measured[0]), axis=0)
    assert np.all(np.abs(np.asarray(found.residual[0])) < 2e-4 * scale + 1e-6)
    with pytest.raises(InputError, match="initial state has X_left"):
        segments(flights, dynamics, fixed={"X_left": 0.5})


def test_a_pilot_flies_them():
    """Trimmed and led into the stall: the equations of the other simulator hold along the flight."""
    model, known = model_and_values()
    trim = rigid_trim(model, known, six.aircraft(PLANE), Condition(95.0, 4000.0))
    n = 451
    alpha = trim.state["alpha"] + np.interp(np.arange(n) * DT, [0.0, 3.0, 15.0, 20.0], [0.0, 0.0, 0.1, 0.1])
    pilot = Pilot(alpha, np.full(n, trim.thrust), trim_gain=0.15)
    found = fly_rigid(model, known, six.aircraft(PLANE), pilot, trim, DT)
    assert np.isfinite(found["alpha"]).all()
    assert found["X"].min() < 0.6
    flown = {name: found[name] for name in SEEN} | {n: found[n] for n in ("elevator", "aileron", "rudder")}
    V, alpha = flown["airspeed"][0], flown["alpha"][0]
    turning = [flown[name][0] for name in ("p", "q", "r", "phi", "theta", "psi", "altitude")]
    x = np.array([V * np.cos(alpha), 0.0, V * np.sin(alpha), *turning, 0.0, 0.0])
    x[10:] = PLANE.halves(x)[1]
    engine = np.full(n, trim.thrust / 2.0)
    controls = np.stack([*(flown[name] for name in ("elevator", "aileron", "rudder")), engine, engine], axis=1)
    path = [x]
    for k in range(n - 1):  # controls linear within a sample; the pilot's follow the state within it, too
        path.append(stranger_six.advanced(PLANE, path[-1], controls[k], controls[k + 1], DT))
    theirs = dict(zip(("p", "q", "r", "phi", "theta", "psi", "altitude"), np.array(path).T[3:10], strict=True))
    for name, values in theirs.items():
        np.testing.assert_allclose(values, flown[name], atol=ALIKE * np.ptp(values), err_msg=name)
