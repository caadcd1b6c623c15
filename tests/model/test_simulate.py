"""The simulated flight against flight mechanics that was not taken from the simulator."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.dynamics.pilot import Pilot, fly, ramps
from bayes_aero.dynamics.trim import INPUTS, FlightState, Plant, conditions
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import GRAVITY, air
from bayes_aero.physics.coefficients import coefficients, condition_joined
from bayes_aero.physics.filters import differentiate
from bayes_aero.physics.kinematics import Rotation, lever_arm
from bayes_aero.simulate.demo import PROFILES, TRUTH

# The simulated flight against flight mechanics that was not taken from the simulator
DT = 0.04
N = 2001
INNER = slice(20, -20)


def pilot(n: int = N, **changes) -> Pilot:
    return Pilot(alpha=jnp.zeros(n), thrust=jnp.zeros(n))._replace(**changes)


def state(V, alpha, theta, q=0.0, h=3000.0, X=1.0) -> FlightState:
    return FlightState(*(jnp.asarray(float(x)) for x in (V, alpha, theta, q, h, X)))


def weave(n: int = N) -> tuple[np.ndarray, np.ndarray]:
    """Bank of 30 deg and sideslip of 4 deg either way, smooth."""
    t = np.arange(n) * DT
    return np.deg2rad(30.0) * np.sin(0.5 * t) ** 3, np.deg2rad(4.0) * np.sin(0.7 * t + 1.0)


def constants() -> dict:
    return {name: jnp.asarray(value) for name, value in TRUTH.items()}


BARE = Effect(
    "bare", Kind.AERODYNAMICS, Stage.TOTAL, "Constant coefficients.", (), (),
    lambda v, *_: {name: v[name] for name in ("CL", "CD", "Cm")}, Example({}, {}, {}, "-"), "-",
)  # fmt: skip


def bare(CL=0.0, CD=0.0, Cm=0.0) -> dict:
    """Values of a model of constant coefficients; the elevator is powerless."""
    return {name: jnp.asarray(float(x)) for name, x in {"CL": CL, "CD": CD, "Cm": Cm, "Cmde": 1.0}.items()}


@pytest.fixture(scope="module")
def stall(card):
    """A stall with banks and sideslip, noise-free."""
    model = Model.of(card.effects)
    phi, beta = weave()
    time = np.arange(N) * DT
    p = pilot(
        alpha=jnp.asarray(np.deg2rad(ramps(time, PROFILES[0]))),
        thrust=jnp.asarray(np.interp(time, [0, 5, 8], [22e3, 22e3, 5e3])),
        phi=jnp.asarray(phi),
        beta=jnp.asarray(beta),
    )
    return fly(model, constants(), card.aircraft, p, state(95, np.deg2rad(6), np.deg2rad(6), h=5200), DT)


def test_wings_level_equations_are_the_symmetric_ones(card):
    """Etkin's symmetric equations, written out here, at random states."""
    model, a = Model.of(card.effects), card.aircraft
    rng = np.random.default_rng(1)
    for _ in range(5):
        V, alpha, gamma, q = rng.uniform(60, 110), rng.uniform(0.05, 0.3), rng.uniform(-0.1, 0.1), rng.normal(0, 0.05)
        inputs = {"alpha_led": jnp.asarray(alpha), "thrust": jnp.asarray(9e3), "command": jnp.asarray(0.01)}
        plant = Plant(model, constants(), a, (jnp.asarray(0.7), jnp.asarray(0.2), jnp.asarray(0.0)), jnp.asarray(0.0))
        rest = dict.fromkeys(INPUTS, jnp.asarray(0.0))
        x = jnp.stack(jax.tree.map(jnp.asarray, state(V, alpha, alpha + gamma, q)))
        derivative, out = plant.motion(x, rest | inputs)
        rates = FlightState(*derivative)
        qS = 0.5 * float(air(jnp.asarray(3000.0))[0]) * V**2 * a.wing_area
        lift, drag = qS * float(out["CL"]), qS * float(out["CD"])
        along = (9e3 * np.cos(alpha) - drag) / a.mass - GRAVITY * np.sin(gamma)
        assert pytest.approx(along, rel=1e-10) == rates.airspeed
        level = q - (lift + 9e3 * np.sin(alpha)) / (a.mass * V) + GRAVITY * np.cos(gamma) / V
        assert rates.alpha == pytest.approx(level, abs=1e-11)
        assert rates.theta == pytest.approx(q)
        assert rates.altitude == pytest.approx(V * np.sin(gamma))
        assert out["ay"] == out["p"] == out["r"] == 0.0
        Cm_cg = float(out["Cm"]) + (
            -(drag * np.cos(alpha) - lift * np.sin(alpha)) * a.reference_point[2]
            + (lift * np.cos(alpha) + drag * np.sin(alpha)) * a.reference_point[0]
        ) / (qS * a.chord)
        assert rates.q == pytest.approx((qS * a.chord * Cm_cg + 9e3 * a.engine[2]) / a.Iy, rel=1e-10)


def test_energy_changes_by_the_work_of_the_side_force_alone(card):
    """Rolling does no work: V^2/2 + g h is constant in a parabola with any bank angle."""
    model = Model.of([BARE])
    phi, _ = weave(150)
    flight = fly(model, bare(), card.aircraft, pilot(150, phi=jnp.asarray(phi)), state(90, 0.1, 0.3), DT)
    energy = 0.5 * flight["airspeed"] ** 2 + GRAVITY * flight["altitude"]
    assert float(jnp.ptp(flight["altitude"])) > 10.0
    np.testing.assert_allclose(energy, energy[0], rtol=1e-7)
    # d/dt (V^2/2 + g h) = side force x side velocity, and the side force is what `ay` records at the CG.
    model, n = Model.of([BARE]), 150
    phi, beta = weave(n)
    aircraft = replace(card.aircraft, accelerometer=(0.0, 0.0, 0.0))
    p = pilot(n, phi=jnp.asarray(phi), beta=jnp.asarray(beta))
    out = fly(model, bare(), aircraft, p, state(90, 0.1, 0.3), DT)
    power = differentiate(0.5 * out["airspeed"] ** 2 + GRAVITY * out["altitude"], DT)
    np.testing.assert_allclose(power[INNER], (out["ay"] * out["airspeed"] * np.sin(beta))[INNER], atol=0.02)
    assert float(jnp.abs(power).max()) > 1.0


@pytest.mark.parametrize("degrees", [-30.0, 20.0, 45.0])
def test_steady_level_turn(card, degrees):
    """Lift m g/cos(bank) holds a level turn of rate g tan(bank)/V at constant speed (any flight-mechanics text).

    There the bank is that of the lift, of sine cos(theta) sin(phi).
    """
    phi, V, alpha, h = np.deg2rad(degrees), 90.0, 0.12, 3000.0
    a = replace(card.aircraft, accelerometer=(0.0, 0.0, 0.0), reference_point=(0.0, 0.0, 0.0))
    theta = np.arctan(np.tan(alpha) * np.cos(phi))
    bank = np.arcsin(np.cos(theta) * np.sin(phi))
    turn = GRAVITY * np.tan(bank) / V
    body = turn * np.array([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    qS = 0.5 * float(air(jnp.asarray(h))[0]) * V**2 * a.wing_area
    gyro = (a.Iz - a.Ix) * body[0] * body[2] + a.Ixz * (body[2] ** 2 - body[0] ** 2)
    values = bare(CL=a.mass * GRAVITY / np.cos(bank) / qS, Cm=-gyro / (qS * a.chord))
    start = state(V, alpha, theta, body[1])
    out = fly(Model.of([BARE]), values, a, pilot(50, phi=jnp.full(50, phi)), start, DT)
    for name, value in (("airspeed", V), ("alpha", alpha), ("theta", theta), ("q", body[1]), ("altitude", h)):
        np.testing.assert_allclose(out[name], value, rtol=1e-9, err_msg=name)
    for name, value in (("p", body[0]), ("r", body[2]), ("psi_dot", turn), ("ay", 0.0)):
        np.testing.assert_allclose(out[name], value, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(np.hypot(out["ax"], out["az"]), GRAVITY / np.cos(bank), rtol=1e-9)


def test_the_record_obeys_rigid_body_kinematics_and_gives_the_coefficients_back(card, stall):
    """Euler's and the body-axis velocity equations, from accelerations moved to the CG, against derivatives."""
    s = stall
    d = {
        name: differentiate(s[name], DT)
        for name in ("airspeed", "alpha", "beta", "theta", "phi", "altitude", "p", "q", "r")
    }
    rotation = Rotation(s["p"], s["q"], s["r"], d["p"], d["q"], d["r"])
    ax, ay, az = (
        s[f"a{k}"] - arm for k, arm in zip("xyz", lever_arm(rotation, card.aircraft.accelerometer), strict=True)
    )
    V, al, be, th, ph = (s[name] for name in ("airspeed", "alpha", "beta", "theta", "phi"))
    u, v, w = V * jnp.cos(al) * jnp.cos(be), V * jnp.sin(be), V * jnp.sin(al) * jnp.cos(be)
    p, q, r = s["p"], s["q"], s["r"]
    found = {
        "u": (differentiate(u, DT), r * v - q * w + ax - GRAVITY * jnp.sin(th)),
        "v": (differentiate(v, DT), p * w - r * u + ay + GRAVITY * jnp.cos(th) * jnp.sin(ph)),
        "w": (differentiate(w, DT), q * u - p * v + az + GRAVITY * jnp.cos(th) * jnp.cos(ph)),
        "theta": (d["theta"], q * jnp.cos(ph) - r * jnp.sin(ph)),
        "phi": (d["phi"], p + jnp.tan(th) * (q * jnp.sin(ph) + r * jnp.cos(ph))),
        "h": (d["altitude"], u * jnp.sin(th) - (v * jnp.sin(ph) + w * jnp.cos(ph)) * jnp.cos(th)),
    }
    for name, (derivative, equation) in found.items():
        error = float(jnp.sqrt(jnp.mean((derivative - equation)[INNER] ** 2)))
        assert error < 2e-3 * float(jnp.std(derivative[INNER])), name
    # What `physics.coefficients` makes of the record is what was flown, to the error of its smoothing.
    n = len(stall["alpha"])
    ends = jnp.full(n, DT), jnp.zeros(n, int), jnp.full(n, n - 1)
    found = coefficients(condition_joined(stall, *ends), card.aircraft)
    for name, limit in (("CL", 2e-3), ("CD", 1e-3), ("Cm", 1e-3)):
        error = np.asarray(getattr(found, name) - stall[name])[INNER]
        assert np.sqrt(np.mean(error**2)) < limit, name


# Conditions of the stall, from signals made by hand
def test_conditions_are_those_of_the_largest_lift_not_of_the_largest_angle():
    """Lift peaks in the first tenth; the angle of attack in the last, with the elevator pulled further."""
    n = 100
    alpha, elevator, az = np.full(n, 0.1), np.full(n, -0.05), np.full(n, -9.8)
    az[:10], elevator[:10] = -12.0, -0.15
    alpha[-10:], elevator[-10:] = 0.4, -0.28
    signals = {"alpha": alpha, "elevator": elevator, "az": az, "density": np.full(n, 1.0), "airspeed": np.full(n, 50.0)}
    held = conditions(signals | {"q": np.full(n, 0.3)})
    assert held["elevator"] == pytest.approx(-0.15)
    assert held["q"] == 0.0
    without = {name: x for name, x in signals.items() if name != "az"}
    assert conditions(without)["elevator"] == pytest.approx(-0.28)
