"""Six degrees of freedom, with one lag of the separation point or two, against closed forms and another simulator."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import six_axes as six
import stranger_six
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from stranger_six import G, Plane, Strips

from bayes_aero.dynamics.aircraft import HELD, Longitudinal, RigidBody
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.pilot import Pilot, fly_rigid
from bayes_aero.dynamics.segments import segments, simulate
from bayes_aero.dynamics.system import integrate
from bayes_aero.dynamics.trim import Condition, rigid_trim
from bayes_aero.errors import InputError
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.observations import join
from bayes_aero.physics.aircraft import Axis
from bayes_aero.physics.coefficients import coefficients

# Six degrees of freedom against closed forms, conserved quantities and a simulator that shares no code
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


def turning(n, plane=ODD, **rates):
    """A body in no air, its path held: it turns by itself, or as the `rates` say."""
    system = body(plane, altitude=False, held=(*FLOW, *rates))
    still = dict.fromkeys(("elevator", "aileron", "rudder", "thrust", "density", "alpha", "beta", "alpha_dot"), 0.0)
    u = still | {"airspeed": 100.0, "sound": 300.0} | {f"{name}_dot": 0.0 for name in rates} | rates
    return system, {name: jnp.broadcast_to(jnp.asarray(x, float), n) for name, x in u.items()}


def to_earth(found):
    """Body axes to earth axes, sample by sample."""
    return Rotation.from_euler("ZYX", np.stack([found[n] for n in ("psi", "theta", "phi")], axis=1))


def test_without_torque_momentum_stays_and_a_symmetric_top_precesses():
    """Tumbling through the vertical, about no principal axis."""
    n, dt = 1501, 0.01
    system, u = turning(n)
    found = fly(system, state_at_start(system, p=1.1, q=0.9, r=-0.6, phi=0.2, theta=0.3), u, dt).outputs
    assert float(jnp.abs(found["theta"]).max()) > np.radians(80.0)
    spin = np.stack([found[n] for n in ("p", "q", "r")], axis=1)
    momentum = spin @ ODD.tensor()
    np.testing.assert_allclose(np.sum(spin * momentum, axis=1), np.sum(spin[0] * momentum[0]), rtol=1e-9)
    fixed = to_earth(found).apply(momentum)
    np.testing.assert_allclose(fixed, np.broadcast_to(fixed[0], fixed.shape), atol=1e-7 * np.linalg.norm(momentum[0]))
    assert np.ptp(spin, axis=0).min() > 0.3
    # Iy = Iz: p stays, q and r turn back at (Iz - Ix)/Iy p; the axis goes round the angular momentum at |H|/Iy.
    n, dt, p = 1001, 0.01, 2.0
    top = Plane(**six.ATTACHED, Iy=4e5, Iz=4e5, Ixz=0.0)
    system, u = turning(n, top)
    found = fly(system, state_at_start(system, p=p, q=0.5), u, dt).outputs
    t = np.arange(n) * dt
    rate = (top.Iz - top.Ix) / top.Iy * p
    np.testing.assert_allclose(found["p"], p, rtol=1e-12)
    np.testing.assert_allclose(found["q"], 0.5 * np.cos(rate * t), atol=1e-8)
    np.testing.assert_allclose(found["r"], -0.5 * np.sin(rate * t), atol=1e-8)
    momentum = np.array([top.Ix * p, top.Iy * 0.5, 0.0])
    around = Rotation.from_rotvec(np.outer(t, momentum / top.Iy))
    np.testing.assert_allclose(to_earth(found).apply([1.0, 0.0, 0.0]), around.apply([1.0, 0.0, 0.0]), atol=1e-7)


def test_attitude_follows_any_rates_through_the_vertical():
    """Two loops at a steady pitch rate begun in a bank: beyond 90 degrees bank and heading turn over by half a turn."""
    n, dt, q = 801, 0.02, 0.8
    system, u = turning(n, p=0.0, q=q, r=0.0)
    found = fly(system, state_at_start(system, theta=0.1), u, dt).outputs
    pitch = 0.1 + q * np.arange(n) * dt
    assert pitch[-1] > 4.0 * np.pi
    np.testing.assert_allclose(np.sin(found["theta"]), np.sin(pitch), atol=1e-9)
    np.testing.assert_allclose(np.cos(found["phi"]), np.sign(np.cos(pitch)), atol=1e-9)
    np.testing.assert_allclose(np.cos(found["psi"]), np.sign(np.cos(pitch)), atol=1e-9)
    # Against the product of rotations by scipy, of which each lasts a sample at the rate of its middle.
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
    np.testing.assert_allclose((turned.inv() * to_earth(found)[-1]).magnitude(), 0.0, atol=3e-6)
    n, dt, r = 401, 0.05, 0.6
    system, u = turning(n, p=0.0, q=0.0, r=r)
    heading = 5.0 * np.pi + 0.2 + r * np.arange(n) * dt
    u |= {"near_psi": jnp.asarray(heading + 0.1), "near_phi": jnp.full(n, -4.0 * np.pi)}
    found = fly(system, state_at_start(system, psi=np.pi + 0.2), u, dt).outputs
    np.testing.assert_allclose(found["psi"], heading, atol=1e-9)
    np.testing.assert_allclose(found["phi"], -4.0 * np.pi, atol=1e-9)


def moved(n, dt, **more):
    """Elevator and thrust that move the aircraft, wings level."""
    t = np.arange(n) * dt
    u = {"elevator": -0.01 + 0.02 * np.sin(1.3 * t) * np.sin(0.31 * t), "thrust": 2e4 + 4e3 * np.sin(0.4 * t)}
    u |= {"aileron": 0.0 * t, "rudder": 0.0 * t} | more
    return {name: jnp.asarray(x) for name, x in u.items()}


@pytest.mark.parametrize("stall", [False, True])
def test_without_lateral_input_it_is_longitudinal_motion(stall):
    effects = (*six.LONGITUDINAL, *(six.STALL if stall else ()))
    plane = Plane(**six.ATTACHED | {"stalls": stall}, tau1=20.0 * stall, alpha_star=0.12)
    model = six.model(effects, (Axis.LONGITUDINAL,))
    flat = Longitudinal(model, six.values(plane, model), six.aircraft(plane))
    whole = body(plane, six.model((*effects, *six.LATERAL)))
    u = moved(501, 0.04)
    ends = []
    for system in (flat, whole):
        start = jnp.array([float(START.get(n, 0.0)) for n in system.start])
        first = {name: x[0] for name, x in u.items()}
        ends.append(fly(system, system.state_at_start(system.complete_start(start, first)), u, 0.04, 3).outputs)
    assert float(jnp.ptp(ends[0]["X"])) > 0.1 or not stall
    for name, x in ends[0].items():
        np.testing.assert_allclose(ends[1][name], x, rtol=1e-9, atol=1e-9, err_msg=name)


def test_prescribed_lateral_motion_is_longitudinal_motion():
    """With p, r, beta and phi held to what another flight recorded, and its side force from the accelerometer."""
    n, dt = 401, 0.04
    t = np.arange(n) * dt
    model = six.model(six.LONGITUDINAL, (Axis.LONGITUDINAL,))
    lateral = {
        "p": 0.15 * np.sin(0.9 * t), "r": 0.05 * np.cos(0.6 * t), "p_dot": 0.135 * np.cos(0.9 * t),
        "r_dot": -0.03 * np.sin(0.6 * t), "beta": 0.05 * np.sin(0.7 * t), "phi": 0.4 * np.sin(0.5 * t),
        "ay": 0.4 * np.cos(0.8 * t),
    }  # fmt: skip
    u = moved(n, dt, **lateral)
    flat = Longitudinal(model, six.values(ODD, model), six.aircraft(ODD))
    held = body(ODD, model, held=HELD[Axis.LATERAL])
    assert set(held.states) == set(flat.states)
    ends = [fly(s, jnp.array([START[name] for name in s.states]), u, dt).outputs for s in (flat, held)]
    assert float(jnp.ptp(ends[0]["alpha"])) > 0.05
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
    np.testing.assert_allclose(
        [found[n] for n in ("ax", "ay", "az")], [first[n] for n in ("ax", "ay", "az")], rtol=1e-6
    )
    assert np.abs(theirs[3:6] - EVEN.rates(x, controls)[3:6])[[0, 2]].min() > 0.01


@pytest.fixture(scope="module")
def flown():
    """Aileron and rudder of the other simulator."""
    return {kind: stranger_six.fly(ODD, kind, np.random.default_rng(2), seconds=20.0) for kind in ("aileron", "rudder")}


SEEN = ("airspeed", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi", "altitude", "ax", "ay", "az")


@pytest.mark.parametrize("euler", [False, True])
def test_it_flies_as_another_simulator_does(flown, euler):
    system = body(ODD, euler=euler)
    for flight in flown.values():
        u = {name: x for name, x in six.channels(flight).items() if name != "density"}
        found = fly(system, state_at_start(system, **{n: flight[n][0] for n in system.start}), u, 0.04, 2).outputs
        for name in SEEN:
            np.testing.assert_allclose(found[name], flight[name], rtol=2e-7, atol=2e-7, err_msg=name)
    assert np.ptp(flown["aileron"]["p"]) > 0.2
    assert np.ptp(flown["rudder"]["beta"]) > 0.1


def test_the_integration_is_that_of_an_adaptive_one():
    """One engine fails, and all else stays: equations written out by hand, in body velocities, by scipy."""
    plane, seconds, dt = ODD, 4.0, 0.02
    x, controls = stranger_six.level(plane, 120.0, 4000.0)
    controls = controls + np.array([0.0, 0.0, 0.0, -controls[3], 0.0])
    n = round(seconds / dt) + 1
    exact = solve_ivp(lambda _, x: plane.rates(x, controls), (0.0, seconds), x, rtol=1e-11, atol=1e-11).y[:, -1]
    first = plane.sensed(x, controls)
    system = body(plane)
    u = {name: jnp.full(n, first[name]) for name in six.channels(dict.fromkeys(first, 0.0)) if name != "density"}
    found = fly(system, state_at_start(system, **first), u, dt).outputs
    for name, value in plane.sensed(exact, controls).items():
        if name in SEEN:
            np.testing.assert_allclose(found[name][-1], value, rtol=2e-7, atol=2e-7, err_msg=name)
    assert float(jnp.abs(found["psi"][-1])) > 0.05


def test_coefficients_are_taken_apart_again(flown):
    """What accelerometers and rates of the simulated flight say of CL, CD, Cm, CY, Cl, Cn is what the model said."""
    plane = ODD
    system = body(plane)
    moved_point = eqx.tree_at(lambda s: s.aircraft.reference_point, system, (0.2, -0.1, 0.15))
    flight = flown["rudder"]
    u = {name: x for name, x in six.channels(flight).items() if name != "density"}
    found = fly(moved_point, state_at_start(system, **{n: flight[n][0] for n in system.start}), u, 0.04).outputs
    signals = found | u | {"density": jnp.asarray([plane.density(float(h)) for h in found["altitude"]])}
    apart = coefficients(signals, moved_point.aircraft)
    for name in ("CL", "CD", "Cm", "CY", "Cl", "Cn"):
        np.testing.assert_allclose(getattr(apart, name), found[name], rtol=1e-6, atol=1e-9, err_msg=name)


def level_flight(plane):
    """The stranger's level flight, and its record at that instant."""
    x, controls = stranger_six.level(plane, 120.0, 4000.0)
    first = plane.sensed(x, controls)
    return first, {name: jnp.asarray(first[name]) for name in ("elevator", "aileron", "rudder", "thrust")}


def test_lateral_modes_are_those_of_the_closed_forms():
    """The linearised lateral motion, longitudinal states held, against its matrix in dimensional derivatives."""
    plane = EVEN
    first, u = level_flight(plane)
    held = HELD[Axis.LONGITUDINAL]
    system = body(plane, altitude=False, held=held, heading=False)
    u |= {name: jnp.asarray(first[name]) for name in held} | {"alpha_dot": jnp.zeros(()), "q_dot": jnp.zeros(())}
    assert system.states == ("beta", "p", "r", "phi")
    x = jnp.array([first[name] for name in system.states])
    found = np.asarray(jax.jacfwd(lambda x: system.motion(x, u)[0])(x))
    V, alpha, theta = first["airspeed"], first["alpha"], first["theta"]
    area = 0.5 * first["density"] * V**2 * plane.S
    half = plane.b / (2.0 * V)
    side = area * np.array([plane.CYbe, 0.0, plane.CYr * half])
    L, N = (
        area
        * plane.b
        * np.array([[plane.Clbe, plane.Clp * half, plane.Clr * half], [plane.Cnbe, plane.Cnp * half, plane.Cnr * half]])
    )
    both = np.linalg.solve([[plane.Ix, -plane.Ixz], [-plane.Ixz, plane.Iz]], np.array([L, N]))
    slip = side / (plane.mass * V) + np.array([0.0, np.sin(alpha), -np.cos(alpha)])
    hand = np.zeros((4, 4))
    hand[0] = [*slip, G * np.cos(theta) / V]
    hand[1:3, :3] = both
    hand[3, 1:3] = [1.0, np.tan(theta)]
    np.testing.assert_allclose(found, hand, rtol=1e-6, atol=1e-9)
    roots = np.linalg.eigvals(found)
    oscillation = roots[np.abs(roots.imag) > 0.1][0]
    fast, slow = sorted(roots[np.abs(roots.imag) < 0.1].real)
    assert np.abs(oscillation) == pytest.approx(np.sqrt(both[1, 0] + slip[0] * both[1, 2]), rel=0.1)  # Dutch roll
    assert fast == pytest.approx(both[0, 1], rel=0.2)  # roll subsidence
    turn = both[0, 0] * both[1, 2] - both[1, 0] * both[0, 2]
    spiral = G / V * turn / (both[1, 0] * both[0, 1] - both[0, 0] * (both[1, 1] - G / V))  # Etkin and Reid, ch. 6
    assert slow == pytest.approx(spiral, rel=0.3)


def test_an_axis_without_a_model_is_prescribed():
    """Roll and yaw with sideslip held to the record, as in the published case: p and r alone are simulated."""
    plane = EVEN
    flight = stranger_six.fly(plane, "rudder", np.random.default_rng(5), dt=0.02, seconds=15.0)
    model = six.model(six.LATERAL, (Axis.LATERAL,))
    held = (*HELD[Axis.LONGITUDINAL], "beta", "phi")
    system = body(plane, model, altitude=False, held=held, heading=False)
    assert system.states == ("p", "r")
    slope = lambda name: np.gradient(flight[name], 0.02)
    spin = np.stack([flight[n] for n in ("p", "q", "r")], axis=1)
    turned = np.stack([slope(n) for n in ("p", "q", "r")], axis=1)
    arm = np.broadcast_to(plane.nose, spin.shape)
    felt = np.cross(turned, arm) + np.cross(spin, np.cross(spin, arm))
    u = six.channels(flight) | {name: jnp.asarray(flight[name]) for name in held}
    u |= {f"{name}_dot": jnp.asarray(slope(name)) for name in ("alpha", "q")}
    u |= {"force_x": jnp.asarray(flight["ax"] - felt[:, 0]), "force_z": jnp.asarray(flight["az"] - felt[:, 2])}
    found = fly(system, jnp.array([flight[n][0] for n in system.states]), u, 0.02).outputs
    for name in ("p", "r"):
        assert np.ptp(flight[name]) > 0.1
        np.testing.assert_allclose(found[name], flight[name], atol=2e-4 * np.ptp(flight[name]))
    np.testing.assert_allclose(found["ay"], flight["ay"], atol=2e-3 * np.ptp(flight["ay"]))


# Two wings whose separation points lag apart: against another simulator, one wing, and coefficients
APART = ("wing_asymmetry", "roll_rate_incidence", "sideslip_incidence", "wing_lift_difference", "wing_drag_difference")
STALL = (*six.LONGITUDINAL, *six.LATERAL, *six.STALL)
PLANE = Strips(tau1=15.0, first=0.01, alpha_star=0.2)
DT = 0.04
ALIKE = 0.02


def model_and_values(plane=PLANE, effects=(*STALL, *APART)):
    """The aircraft's own model: the left half stalls `first`, so that the right less the left incidence is less."""
    model = six.model(effects)
    known = six.values(
        plane, model, wing_asymmetry=-plane.first, roll_station=plane.station / (plane.b / 2.0),
        sideslip_incidence=2.0 * plane.dihedral, alpha_star=plane.alpha_star - plane.first / 2.0,
    )  # fmt: skip
    return model, {name: x for name, x in known.items() if name in {p.name for p in model.parameters}}


@pytest.fixture(scope="module")
def flight():
    """A stall with aileron of the other simulator."""
    return stranger_six.fly(PLANE, "stall", np.random.default_rng(4), dt=DT, seconds=20.0, V=95.0)


def two_winged(plane=PLANE, effects=(*STALL, *APART), **options):
    model, known = model_and_values(plane, effects)
    return RigidBody(model, known, six.aircraft(plane), **options)


def inputs(flight):
    return {name: x for name, x in six.channels(flight).items() if name != "density"}


@pytest.mark.parametrize("euler", [False, True])
def test_two_lags_fly_as_those_of_another_simulator(flight, euler):
    system, u = two_winged(euler=euler), inputs(flight)
    assert system.states[-2:] == ("X_right", "X_left")
    first = {name: x[0] for name, x in u.items()}
    start = system.complete_start(start_of(system, **{n: x[0] for n, x in flight.items()}), first)
    found = fly(system, system.state_at_start(start), u, DT, 2)
    assert found.outputs["X"].min() < 0.5
    assert np.abs(found.states[:, -2] - found.states[:, -1]).max() > 0.1
    for name in SEEN:
        atol = 5e-5 * np.ptp(flight[name])  # an aircraft that rolls by itself in the stall grows what rounding leaves
        np.testing.assert_allclose(found.outputs[name], flight[name], atol=atol, err_msg=name)


def test_rates_of_both_points_and_of_the_body_are_those_of_another_simulator(flight):
    system, k, points = two_winged(), 400, (0.35, 0.6)
    now = {name: x[k] for name, x in flight.items()}
    V, alpha, beta = (now[n] for n in ("airspeed", "alpha", "beta"))
    velocity = V * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    turning = [now[n] for n in ("p", "q", "r", "phi", "theta", "psi", "altitude")]
    theirs = PLANE.rates(
        np.array([*velocity, *turning, points[1], points[0]]), np.array([now[n] for n in stranger_six.CONTROLS])
    )
    start = start_of(system, **now, X_right=points[0], X_left=points[1])
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
        system = two_winged(even, effects)
        start = start_of(system, airspeed=95.0, alpha=0.12, theta=0.12, altitude=4000.0)
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
    system, u = two_winged(), inputs(flight)
    first = {name: x[0] for name, x in u.items()}
    start = system.complete_start(start_of(system, **{n: x[0] for n, x in flight.items()}), first)
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
    channels = {name: flight[name] for name in (*six.RECORDED, "thrust")}
    record = FlightRecord.from_arrays("stall", flight["time"], channels, "simulated")
    flights = join([record], six.card_in(tmp_path, PLANE), ())
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
