"""Simulated flight: trim, equations of motion of three axes, and the inputs of manoeuvres."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import six_axes as six
import stranger_six
from stranger_six import Plane

from bayes_aero.dynamics import pilot as flying
from bayes_aero.dynamics.trim import Condition, conditions, lead, level_speed, rigid_trim, trimmed
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.errors import InputError
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import GRAVITY, air
from bayes_aero.physics.coefficients import coefficients, condition_joined
from bayes_aero.physics.filters import differentiate
from bayes_aero.physics.kinematics import Rotation, lever_arm
from bayes_aero.simulate.demo import TRUTH

# Trim from the model's own coefficients, whatever its parameters are called and whichever control pitches it
AIRSPEED, ALTITUDE = 95.0, 5200.0
DT = 0.04
INNER = slice(20, -20)


def values(**changes):
    return {name: jnp.asarray(x) for name, x in (TRUTH | {"Cmih": -2.0} | changes).items()}


def pitched_by(card, *effects):
    """The card's model with other effects in place of the elevator's."""
    return Model.of([*(e for e in card.effects if e != "elevator_moment"), *effects])


def test_the_command_is_the_textbook_s(card):
    alpha = jnp.asarray([0.05, 0.1, 0.2])
    shares, command = lead(Model.of(card.effects), values(), card.aircraft, alpha, AIRSPEED, ALTITUDE)
    np.testing.assert_array_equal(shares, [1.0, 0.0])
    np.testing.assert_allclose(command, -(TRUTH["Cm0"] + TRUTH["Cma"] * alpha) / TRUTH["Cmde"], rtol=1e-14)


@pytest.mark.parametrize("mach", [None, 0.3])
def test_at_level_speed_the_attached_lift_carries_the_weight(card, mach):
    speed = level_speed(Model.of(card.effects), values(), card.aircraft, 0.1, ALTITUDE, mach)
    density, sound = (float(x) for x in air(jnp.asarray(ALTITUDE)))
    CL = TRUTH["CL0"] + (TRUTH["CLa"] + TRUTH["CLaM"] * (mach or speed / sound)) * 0.1
    lift = 0.5 * density * speed**2 * card.aircraft.wing_area * CL
    assert lift == pytest.approx(card.aircraft.mass * GRAVITY, rel=1e-9)


@pytest.fixture(scope="module")
def standard(card):
    """The standard manoeuvres of a model that its stabilizer pitches, as a function of its values."""
    model = pitched_by(card, "stabilizer_trim")

    def flown(**changes):
        level = Condition(AIRSPEED, ALTITUDE)
        flights, _, refused = flying.fly_standard(model, values(**changes), card.aircraft, level, dt=DT)
        assert not refused
        return flights

    return model, flown(), flown(Cmih=2.0)


def test_a_model_is_flown_by_its_stabilizer_of_either_sign_or_cannot_be_trimmed(card, standard):
    model, flown, turned = standard
    doublet = flown["elevator_doublet"]
    assert np.all(doublet["elevator"] == 0.0)
    assert np.ptp(doublet["stabilizer"]) > np.deg2rad(3.0)
    begin = trimmed(model, values(), card.aircraft, AIRSPEED, ALTITUDE)
    assert doublet["alpha"][:25] == pytest.approx(begin.alpha, abs=np.deg2rad(0.1))
    assert np.ptp(doublet["alpha"]) > np.deg2rad(1.0)
    for name in flown.keys() - {"stabilizer_steps"}:  # those are prescribed, not the pilot's
        np.testing.assert_allclose(turned[name]["stabilizer"], -flown[name]["stabilizer"], atol=1e-9)
        np.testing.assert_allclose(turned[name]["alpha"], flown[name]["alpha"], atol=1e-9)
    with pytest.raises(InputError, match="neither elevator nor stabilizer pitches it"):
        trimmed(pitched_by(card), values(), card.aircraft, AIRSPEED, ALTITUDE)


@pytest.mark.parametrize("flight", ["sideslip", "slow_stall"])
def test_the_record_obeys_rigid_body_kinematics_and_gives_the_coefficients_back(card, standard, flight):
    """Euler's and the body-axis velocity equations, from accelerations moved to the CG, against derivatives."""
    s = {name: jnp.asarray(x) for name, x in standard[1][flight].items()}
    assert (float(jnp.ptp(s["beta"])) > 0.1) == (flight == "sideslip") == (float(s["X"].min()) > 0.5)
    slope = jax.jit(lambda x: differentiate(x, DT))
    rates = [slope(s[name]) for name in ("p", "q", "r")]
    felt = lever_arm(Rotation(s["p"], s["q"], s["r"], *rates), card.aircraft.accelerometer)
    ax, ay, az = (s[f"a{k}"] - arm for k, arm in zip("xyz", felt, strict=True))
    V, al, be, th, ph = (s[name] for name in ("airspeed", "alpha", "beta", "theta", "phi"))
    u, v, w = V * jnp.cos(al) * jnp.cos(be), V * jnp.sin(be), V * jnp.sin(al) * jnp.cos(be)
    p, q, r = s["p"], s["q"], s["r"]
    equations = {
        "u": (u, r * v - q * w + ax - GRAVITY * jnp.sin(th)),
        "v": (v, p * w - r * u + ay + GRAVITY * jnp.cos(th) * jnp.sin(ph)),
        "w": (w, q * u - p * v + az + GRAVITY * jnp.cos(th) * jnp.cos(ph)),
        "theta": (th, q * jnp.cos(ph) - r * jnp.sin(ph)),
        "phi": (ph, p + jnp.tan(th) * (q * jnp.sin(ph) + r * jnp.cos(ph))),
        "h": (s["altitude"], u * jnp.sin(th) - (v * jnp.sin(ph) + w * jnp.cos(ph)) * jnp.cos(th)),
    }
    for name, (x, equation) in equations.items():
        error = float(jnp.sqrt(jnp.mean((slope(x) - equation)[INNER] ** 2)))
        assert error <= 2e-3 * float(jnp.std(slope(x)[INNER])), name
    # What `physics.coefficients` makes of the record is what was flown, to the error of its smoothing.
    n = len(s["alpha"])
    ends = jnp.full(n, DT), jnp.zeros(n, int), jnp.full(n, n - 1)
    apart = jax.jit(lambda s: coefficients(condition_joined(s, *ends), card.aircraft))(s)
    for name in ("CL", "CD", "Cm"):
        error = np.asarray(apart[name] - s[name])[INNER]
        assert np.sqrt(np.mean(error**2)) < 1e-3, name


# Steady flight in six degrees of freedom: the equations of another simulator say that nothing changes in it
PLANE = Plane(**six.ATTACHED, Ixy=1.5e3, Iyz=-2e3)
SPEED, HEIGHT = 120.0, 4000.0


def trimmed_six(effects=(*six.LONGITUDINAL, *six.LATERAL), **condition):
    model = six.model(effects)
    asked = Condition(condition.pop("airspeed", SPEED), HEIGHT, **condition)
    return rigid_trim(model, six.values(PLANE, model), six.aircraft(PLANE), asked)


def rates(found):
    """Those of the other simulator there."""
    V, alpha, beta = (found.state[name] for name in ("airspeed", "alpha", "beta"))
    x = np.zeros(12)
    x[:3] = V * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    x[3:9] = [found.state[name] for name in ("p", "q", "r", "phi", "theta", "psi")]
    x[9] = found.state["altitude"]
    engines = 0.5 * found.thrust * np.ones(2)
    return PLANE.rates(x, np.array([*(found.controls[n] for n in ("elevator", "aileron", "rudder")), *engines]))


@pytest.mark.parametrize("sideslip", [0.0, 0.1])
def test_nothing_changes_in_steady_flight(sideslip):
    steady = trimmed_six(sideslip=sideslip)
    slope = rates(steady)
    np.testing.assert_allclose(slope[:6], 0.0, atol=1e-6)
    np.testing.assert_allclose(slope[6:9], 0.0, atol=1e-9)
    assert slope[9] == pytest.approx(0.0, abs=1e-6)
    assert steady.state["beta"] == sideslip
    if not sideslip:  # that of the other simulator
        x, controls = stranger_six.level(PLANE, SPEED, HEIGHT)
        assert steady.state["alpha"] == pytest.approx(np.arctan2(x[2], x[0]), rel=1e-6)
        assert steady.controls["elevator"] == pytest.approx(controls[0], rel=1e-5)
        assert steady.thrust == pytest.approx(controls[3] + controls[4], rel=1e-6)


def test_what_cannot_be_held_is_refused():
    effects = [n for n in (*six.LONGITUDINAL, *six.LATERAL) if n not in ("rudder_yaw", "rudder_roll")]
    with pytest.raises(InputError, match=r"4000 m with sideslip 5\.73 deg that elevator, aileron can hold"):
        trimmed_six(effects, sideslip=0.1)
    with pytest.raises(InputError, match="no steady flight at 30 m/s"):
        trimmed_six(airspeed=30.0)


# The simulated flight against flight mechanics that was not taken from the simulator
BARE = Effect(
    "bare", Kind.AERODYNAMICS, Stage.TOTAL, "Constant coefficients.", (), (),
    lambda v, *_: {name: v[name] for name in ("CL", "CD", "Cm")}, Example({}, {}, {}, "-"), "-",
)  # fmt: skip


@pytest.mark.parametrize("degrees", [-30.0, 45.0])
def test_steady_level_turn(card, degrees):
    """Lift m g/cos(bank) holds a turn of rate g tan(bank)/V, the bank that of the lift, of sine cos(theta) sin(phi)."""
    phi, V, alpha, h = np.deg2rad(degrees), 90.0, 0.12, 3000.0
    a = replace(card.aircraft, accelerometer=(0.0, 0.0, 0.0), reference_point=(0.0, 0.0, 0.0))
    theta = np.arctan(np.tan(alpha) * np.cos(phi))
    bank = np.arcsin(np.cos(theta) * np.sin(phi))
    turn = GRAVITY * np.tan(bank) / V
    body = turn * np.array([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    qS = 0.5 * float(air(jnp.asarray(h))[0]) * V**2 * a.wing_area
    gyro = (a.Iz - a.Ix) * body[0] * body[2] + a.Ixz * (body[2] ** 2 - body[0] ** 2)
    values = {"CL": a.mass * GRAVITY / np.cos(bank) / qS, "CD": 0.0, "Cm": -gyro / (qS * a.chord), "Cmde": 1.0}
    values = {name: jnp.asarray(float(x)) for name, x in values.items()}  # the elevator is powerless
    start = flying.FlightState(*(jnp.asarray(float(x)) for x in (V, alpha, theta, body[1], h, 1.0)))
    pilot = flying.Pilot(alpha=jnp.zeros(50), thrust=jnp.zeros(50), phi=jnp.full(50, phi))
    (out,) = flying.fly(Model.of([BARE]), values, a, [pilot], [start], DT)
    for name, value in (("airspeed", V), ("alpha", alpha), ("theta", theta), ("q", body[1]), ("altitude", h)):
        np.testing.assert_allclose(out[name], value, rtol=1e-9, err_msg=name)
    for name, value in (("p", body[0]), ("r", body[2]), ("psi_dot", turn), ("ay", 0.0)):
        np.testing.assert_allclose(out[name], value, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(np.hypot(out["ax"], out["az"]), GRAVITY / np.cos(bank), rtol=1e-9)


# Conditions of the stall, from signals made by hand
def test_conditions_are_those_of_the_largest_lift_not_of_the_largest_angle():
    """Lift peaks in the first tenth; the angle of attack in the last, with the elevator pulled further."""
    n = 100
    alpha, elevator, az = (np.full(n, x) for x in (0.1, -0.05, -9.8))
    az[:10], elevator[:10] = -12.0, -0.15
    alpha[-10:], elevator[-10:] = 0.4, -0.28
    signals = {"alpha": alpha, "elevator": elevator, "az": az, "density": np.full(n, 1.0), "airspeed": np.full(n, 50.0)}
    held = conditions(signals | {"q": np.full(n, 0.3)})
    assert held["elevator"] == pytest.approx(-0.15)
    assert held["q"] == 0.0
    without = {name: x for name, x in signals.items() if name != "az"}
    assert conditions(without)["elevator"] == pytest.approx(-0.28)


# Shapes of inputs: what a 3-2-1-1, a later pulse and a rounded step are by definition
TIME = np.arange(-125, 1500) * DT


def test_a_3_2_1_1_lasts_as_many_samples_as_its_name_says():
    """Units of 0.8 s, 20 samples each: edges fall on samples, though 3 x 0.8 is not 2.4 in floating point."""
    signal = flying.pulses(TIME, flying.three_two_one_one(32.0, 0.8, 2.0))
    changes = np.flatnonzero(np.diff(signal)) + 1
    np.testing.assert_allclose(TIME[changes[0]], 32.0)
    np.testing.assert_array_equal(np.diff(changes), [60, 40, 20, 20])
    np.testing.assert_array_equal(signal[changes], [2.0, -2.0, 2.0, -2.0, 0.0])
    # A later pulse replaces an earlier one while it lasts.
    signal = flying.pulses(TIME, [(1.0, 10.0, 1.0), (3.0, 5.0, -2.0), *flying.steps((20.0, 4.0))])
    at = lambda t: signal[np.searchsorted(TIME, t)]
    assert [at(t) for t in (0.5, 2.0, 4.0, 7.0, 15.0, 59.0)] == [0.0, 1.0, -2.0, 1.0, 0.0, 4.0]


@pytest.mark.parametrize("dt", [0.04, 0.5])
def test_a_rounded_step_ends_where_the_step_ends_and_is_half_way_at_its_middle(dt):
    time = np.arange(-10.0, 10.0, dt)
    step = np.where(time < -0.25 * dt, 0.0, 1.0)
    smooth = flying.rounded(step, 2.0, dt)
    assert len(smooth) == len(time)
    np.testing.assert_allclose(smooth[np.abs(time) > 1.0 + dt], step[np.abs(time) > 1.0 + dt], atol=1e-12)
    assert np.all(np.diff(smooth) > -1e-12)
    middle = int(np.argmin(np.abs(time)))
    assert 0.5 * (smooth[middle - 1] + smooth[middle]) == pytest.approx(0.5)  # the window is symmetric


# Multisines: what orthogonal, flat and periodic mean, computed from the signals alone
PERIOD, BAND = 25.0, (0.1, 1.4)
ONE_PERIOD = np.arange(0.0, PERIOD, DT)


def peak_factor(signal):
    """Half the range over that of a sine of the same root mean square; 1 for a sine."""
    return np.ptp(signal) / (2.0 * np.sqrt(2.0 * np.mean(np.square(signal))))


def test_multisines_are_orthogonal_and_share_no_frequency():
    three = flying.multisines(ONE_PERIOD, PERIOD, BAND, 3)
    shared = three @ three.T
    np.testing.assert_allclose(shared - np.diag(np.diag(shared)), 0.0, atol=1e-10 * shared[0, 0])
    spectra = np.abs(np.fft.rfft(three)) > 1e-6 * len(ONE_PERIOD)
    frequencies = np.fft.rfftfreq(len(ONE_PERIOD), DT)
    assert np.all(spectra.sum(axis=0) <= 1)
    excited = frequencies[spectra.any(axis=0)]
    np.testing.assert_allclose(excited, np.arange(3, 36) / PERIOD)  # every multiple of 1/T from 0.1 to 1.4 Hz


@pytest.mark.parametrize(("controls", "least"), [(1, 1.1), (3, 1.3)])
def test_peaks_are_small_and_the_signal_begins_at_zero(controls, least):
    """In phase 33 cosines have a relative peak factor of about 4; Morelli accepts up to 1.3 for a few of them."""
    signals = flying.multisines(np.arange(0.0, PERIOD, 0.005), PERIOD, BAND, controls)
    np.testing.assert_allclose(signals[:, 0], 0.0, atol=1e-9)
    for signal in signals:
        assert peak_factor(signal) < least
        assert np.max(np.abs(signal)) == pytest.approx(1.0, abs=1e-2)


def test_multisines_of_the_standard_manoeuvre():
    time = np.arange(0.0, flying.SECONDS, DT)
    signals = flying.multisine_inputs(time, 3)
    one, two = (signals[:, round(begin / DT) : round((begin + PERIOD) / DT)] for begin in (5.0, 30.0))
    np.testing.assert_allclose(one, two, atol=1e-9)
    assert not np.any(signals[:, time < 5.0 - DT / 2])
    assert not np.any(signals[:, time > 55.0 - DT / 2])
