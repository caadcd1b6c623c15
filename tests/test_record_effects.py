"""Effects on the record and on the aircraft: their sign convention, and how a model applies them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.observations import marks, observe, response_scales
from bayes_aero.model.records import marks_of
from bayes_aero.physics.aircraft import Axis
from bayes_aero.physics.coefficients import coefficients
from bayes_aero.physics.kinematics import path_rates

N, DT = 400, 0.04


def wave(t):
    """A smooth channel that changes sign."""
    return 0.3 * np.sin(0.9 * t) + 0.1 * np.cos(2.3 * t)


def bias(size):
    return lambda t: wave(t) + size


def scale(size):
    return lambda t: (1.0 + size) * wave(t)


def delay(size):
    return lambda t: wave(t - size)


def climb(size):
    return lambda t: wave(t) + size * t


RECORDED = [
    ("alpha_bias", "alpha", bias, 0.02), ("airspeed_bias", "airspeed", bias, -1.5),
    ("pitch_rate_bias", "q", bias, 0.004), ("accel_x_bias", "ax", bias, 0.1), ("accel_z_bias", "az", bias, -0.2),
    ("pitch_attitude_bias", "theta", bias, 0.01), ("alpha_scale", "alpha", scale, 0.08),
    ("airspeed_scale", "airspeed", scale, 0.03), ("pitch_rate_scale", "q", scale, -0.05),
    ("elevator_scale", "elevator", scale, 0.1), ("altitude_scale", "altitude", scale, 0.02),
    ("density_scale", "density", scale, -0.04), ("alpha_delay", "alpha", delay, 0.13),
    ("alpha_delay", "alpha", delay, -0.07), ("sideslip_delay", "beta", delay, 0.06),
    ("heading_delay", "psi", delay, 0.09), ("elevator_delay", "elevator", delay, 0.08),
    ("vertical_wind", "altitude", climb, 2.0), ("accel_y_bias", "ay", bias, 0.1),
    ("sideslip_bias", "beta", bias, 0.02), ("bank_angle_bias", "phi", bias, -0.01),
    ("roll_rate_bias", "p", bias, 0.003), ("yaw_rate_bias", "r", bias, -0.002), ("accel_y_scale", "ay", scale, 0.1),
    ("sideslip_scale", "beta", scale, -0.05), ("bank_angle_scale", "phi", scale, 0.04),
    ("roll_rate_scale", "p", scale, 0.08), ("yaw_rate_scale", "r", scale, -0.03),
    ("aileron_scale", "aileron", scale, 0.1), ("rudder_scale", "rudder", scale, -0.1),
    ("aileron_delay", "aileron", delay, 0.08), ("rudder_delay", "rudder", delay, -0.06),
]  # fmt: skip
BOTH = tuple(Axis)


@pytest.mark.parametrize(("name", "channel", "error", "size"), RECORDED)
def test_what_was_recorded_becomes_what_was_true(card, name, channel, error, size):
    beside = marks(N, DT)
    t = np.asarray(beside["elapsed"])
    channels = beside | {channel: jnp.asarray(error(size)(t))}
    (parameter,) = CATALOGUE[name].parameters
    model = Model.of([name], axes=BOTH)
    true = model.corrected({parameter.name: jnp.asarray(size)}, channels, card.aircraft)[channel]
    inner = slice(5, -5)  # a delay cannot look beyond the ends
    np.testing.assert_allclose(true[inner], wave(t)[inner], atol=1e-4 if error is delay else 1e-12)


@pytest.mark.parametrize("channel", ["elevator", "aileron", "rudder", "alpha", "sideslip"])
def test_a_late_channel_of_another_scale_is_scaled_as_it_was(card, channel):
    """Recorded(t) = (1 + scale) true(t - delay); a scale of the late channel would be a second tap of a filter."""
    beside, late, size = marks(N, DT), 0.13, -0.2
    t = np.asarray(beside["elapsed"])
    name = {"sideslip": "beta"}.get(channel, channel)
    model = Model.of([f"{channel}_scale", f"{channel}_delay"], axes=BOTH)
    given = {p.name: jnp.asarray(late if p.unit == "s" else size) for p in model.parameters}
    recorded = beside | {name: jnp.asarray((1.0 + size) * wave(t - late))}
    inner = slice(5, -5)
    true = model.corrected(given, recorded, card.aircraft)[name]
    np.testing.assert_allclose(true[inner], wave(t)[inner], atol=1e-4)


@pytest.mark.parametrize(("name", "size"), [("airspeed_bias", 2.0), ("airspeed_scale", 0.025)])
def test_mach_number_follows_the_airspeed_that_it_was_made_from(card, name, size):
    channels = marks(3, DT) | {"airspeed": jnp.asarray([82.0, 90.0, 70.0])}
    channels["mach"] = channels["airspeed"] / 320.0
    true = Model.of([name]).corrected({name: jnp.asarray(size)}, channels, card.aircraft)
    assert not np.allclose(true["airspeed"], channels["airspeed"])
    np.testing.assert_allclose(true["mach"], true["airspeed"] / 320.0, rtol=1e-12)


@pytest.mark.parametrize(("name", "size"), [("airspeed_bias", 5.0), ("airspeed_scale", 0.05)])
def test_a_mach_number_with_a_source_of_its_own_is_left_as_it_is(card, name, size):
    """True speeds and a = 320 m/s, by hand; the airspeed is recorded wrong, and the Mach number right."""
    true = np.array([60.0, 70.0, 80.0, 90.0])
    wrong = true + size if name == "airspeed_bias" else true * (1.0 + size)
    air = {"static_temperature": np.full(4, 320.0**2 / (1.4 * 287.05287))}
    model, t = Model.of([name]), np.arange(4) * DT
    for mach, follows in ((true / 320.0, 0.0), (wrong / 320.0, 1.0)):
        record = FlightRecord.from_arrays("by_hand", t, air | {"airspeed": wrong, "mach": mach})
        given = {"airspeed": jnp.asarray(wrong), "mach": jnp.asarray(mach)} | marks_of(record, 0)
        assert np.all(given["mach_follows"] == follows)
        found = model.corrected({name: jnp.asarray(size)}, given, card.aircraft)
        np.testing.assert_allclose(found["mach"], true / 320.0, rtol=1e-12)


def test_every_effect_on_the_record_has_its_sign_tested():
    shown = [e for e in CATALOGUE.values() if e.disturbance is None]
    measured = {e.name for e in shown if e.kind in ("measurement", "environment")}
    places = {
        "vane_position", "pitot_position", "sideslip_vane_position", "sideslip_vane_height",
        "accel_y_position", "accel_y_height", "accelerometer_position", "accelerometer_height",
    }  # fmt: skip
    assert measured == {row[0] for row in RECORDED} | places | {"pitot_pressure_bias"}


@pytest.mark.parametrize("size", [300.0, -150.0])
def test_an_airspeed_from_an_impact_pressure_that_is_off_becomes_the_true_one(card, size):
    t = np.arange(N) * DT
    V, density = 80.0 + 20.0 * wave(t), 0.75 + 0.1 * wave(t + 1.0)
    recorded = np.sqrt(V**2 + 2.0 * size / density)
    given = marks(N, DT) | {"airspeed": jnp.asarray(recorded), "density": jnp.asarray(density)}
    model = Model.of(["pitot_pressure_bias"])
    true = model.corrected({"pitot_pressure_bias": jnp.asarray(size)}, given, card.aircraft)["airspeed"]
    np.testing.assert_allclose(true, V, rtol=1e-12)


@pytest.mark.parametrize("x", [13.08, -4.0])
def test_a_vane_ahead_of_the_cg_reads_the_flow_of_its_own_place(card, x):
    """Velocities of a rigid body: (u, v + x r, w - x q) at x ahead of (u, v, w)."""
    t = np.arange(N) * DT
    alpha, beta, q, r = 0.2 + wave(t) / 3.0, wave(t + 1.0) / 4.0, 0.2 * wave(t + 2.0), 0.2 * wave(t + 3.0)
    V = 80.0 + 5.0 * wave(t + 4.0)
    u, v, w = V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)
    there = (v + x * r, w - x * q)
    recorded = {
        "alpha": np.arctan2(there[1], u), "q": q, "r": r, "airspeed": np.sqrt(u**2 + there[0] ** 2 + there[1] ** 2),
    }  # fmt: skip
    recorded["beta"] = np.arcsin(there[0] / recorded["airspeed"])
    given = marks(N, DT) | {name: jnp.asarray(series) for name, series in recorded.items()}
    model = Model.of(["vane_position"])
    true = model.corrected({"vane_position": jnp.asarray(x)}, given, card.aircraft)
    moved = max(np.abs(recorded["alpha"] - alpha).max(), np.abs(recorded["beta"] - beta).max())
    assert moved > 0.003  # of which less than a hundredth may be left: the airspeed is taken as that of the CG
    np.testing.assert_allclose(true["alpha"], alpha, atol=0.01 * moved)
    np.testing.assert_allclose(true["beta"], beta, atol=0.03 * moved)
    without = {name: series for name, series in given.items() if name not in ("beta", "r")}
    alone = model.corrected({"vane_position": jnp.asarray(x)}, without, card.aircraft)
    assert "beta" not in alone
    np.testing.assert_allclose(alone["alpha"] - given["alpha"], true["alpha"] - given["alpha"], rtol=0.02, atol=1e-12)


@pytest.mark.parametrize(("x", "height"), [(13.08, 0.0), (-4.0, 0.0), (0.0, 3.0), (0.0, -1.5)])
def test_a_sideslip_vane_away_from_the_cg_reads_the_flow_of_its_own_place(card, x, height):
    """The lateral velocity there is v + x r - z p, z = -height."""
    t = np.arange(N) * DT
    beta, p, r, V = wave(t) / 4.0, 0.3 * wave(t + 2.0), 0.2 * wave(t + 3.0), 80.0 + 5.0 * wave(t + 4.0)
    there = np.arctan2(V * np.sin(beta) + x * r + height * p, V * np.cos(beta))
    given = marks(N, DT) | {"beta": there, "p": p, "r": r, "airspeed": V}
    values = {"sideslip_vane_position": x, "sideslip_vane_height": height}
    name = "sideslip_vane_position" if x else "sideslip_vane_height"
    model = Model.of([name], axes=BOTH)
    true = model.corrected({name: values[name]}, {k: jnp.asarray(v) for k, v in given.items()}, card.aircraft)["beta"]
    moved = np.abs(there - beta).max()
    assert moved > 0.001
    np.testing.assert_allclose(true, beta, atol=0.02 * moved)  # the airspeed is taken as that of the CG


@pytest.mark.parametrize(("name", "place", "all_three"), [
    ("accel_y_position", (3.0, 0.0, 0.0), False), ("accel_y_height", (0.0, 0.0, -1.5), False),
    ("accelerometer_position", (-2.0, 0.0, 0.0), True), ("accelerometer_height", (0.0, 0.0, 1.0), True),
])  # fmt: skip
def test_accelerometers_elsewhere_read_the_acceleration_of_their_own_place(card, name, place, all_three):
    """That of a rigid body: omega_dot x d + omega x (omega x d) more; the flight path is then that of the centre."""
    t, axes = np.arange(N) * DT, ("ax", "ay", "az")
    rates = np.stack([0.3 * np.sin(0.8 * t), 0.2 * np.sin(0.5 * t), 0.1 * np.cos(0.7 * t)], axis=1)
    turning = np.stack([0.24 * np.cos(0.8 * t), 0.1 * np.cos(0.5 * t), -0.07 * np.sin(0.7 * t)], axis=1)
    more = np.cross(turning, place) + np.cross(rates, np.cross(rates, place))
    true = {n: wave(t + k) for k, n in enumerate(axes)} | {"airspeed": 80.0 + wave(t)}
    true |= {n: wave(t + 5.0 + k) / 5.0 for k, n in enumerate(("alpha", "beta", "phi", "theta"))}
    true |= dict(zip("pqr", rates.T, strict=True))
    recorded = true | {n: true[n] + more[:, k] for k, n in enumerate(axes) if all_three or n == "ay"}
    size = place[0] - place[2]  # ahead, or up
    model = Model.of([name], axes=BOTH)
    corrected = model.corrected({name: size}, marks(N, DT) | recorded, card.aircraft)
    aircraft = model.actual_aircraft({name: size}, card.aircraft)
    slopes = dict(zip(("p_dot", "q_dot", "r_dot"), turning.T, strict=True))
    found, expected = (path_rates(s | slopes, a) for s, a in ((corrected, aircraft), (true, card.aircraft)))
    moved = path_rates(recorded | slopes, card.aircraft)["beta"] - expected["beta"]
    assert np.abs(moved).max() > 1e-3
    for state, rate in expected.items():
        np.testing.assert_allclose(found[state][5:-5], rate[5:-5], atol=1e-6)


def test_a_pitot_tube_ahead_of_the_cg_reads_the_speed_of_its_own_place(card):
    """The speed of (u, v + x r, w - x q), where the flow angles are recorded beside it."""
    t = np.arange(N) * DT
    alpha, beta, q, r = 0.2 + wave(t) / 3.0, wave(t + 1.0) / 4.0, 0.2 * wave(t + 2.0), 0.2 * wave(t + 3.0)
    V, x = 80.0 + 5.0 * wave(t + 4.0), 13.08
    u, v, w = V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)
    across, down = v + x * r, w - x * q
    there = np.sqrt(u**2 + across**2 + down**2)
    beside = {"alpha": np.arctan2(down, u), "beta": np.arcsin(across / there)}
    given = marks(N, DT) | beside | {"q": q, "r": r, "airspeed": there}
    given = {name: jnp.asarray(series) for name, series in given.items()}
    true = Model.of(["pitot_position"]).corrected({"pitot_position": jnp.asarray(x)}, given, card.aircraft)
    assert np.abs(there - V).max() > 0.2
    np.testing.assert_allclose(true["airspeed"], V, rtol=1e-12)


def test_pitch_rate_in_the_vanes_angle_does_not_change_its_unit(card):
    """A delay and a place away from the CG leave a degree a degree; a scale does not."""
    t = np.arange(N) * DT
    names = ("alpha", "q", "airspeed")
    channels = marks(N, DT) | dict(zip(names, (wave(t), wave(t + 1.0), jnp.full(N, 80.0)), strict=True))
    for effect, value, unit in (("vane_position", 13.0, 1.0), ("alpha_delay", 0.1, 1.0), ("alpha_scale", 0.25, 0.8)):
        scale = response_scales(Model.of([effect]), {effect: jnp.asarray(value)}, channels, card.aircraft, names)
        np.testing.assert_allclose(scale["alpha"][5:-5], unit, rtol=0.02)
        np.testing.assert_allclose(scale["q"], 1.0)


def test_corrections_see_the_record_and_not_each_other_and_count_for_either_engine(card):
    channels = marks(N, DT) | {"alpha": jnp.linspace(0.1, 0.3, N)}
    model = Model.of(["alpha_bias", "alpha_scale"])
    both = model.corrected({"alpha_bias": 0.01, "alpha_scale": 0.25}, channels, card.aircraft)["alpha"]
    np.testing.assert_allclose(both, channels["alpha"] / 1.25 - 0.01, rtol=1e-12)
    channels = marks(1, DT) | {"thrust": [3e4], "thrust_left": [1e4], "thrust_right": [2e4]}
    channels = {name: jnp.asarray(x) for name, x in channels.items()}
    true = Model.of(["thrust_scale"]).corrected({"thrust_scale": 0.1}, channels, card.aircraft)
    found = [float(true[name][0]) for name in ("thrust", "thrust_left", "thrust_right")]
    assert found == pytest.approx([3.3e4, 1.1e4, 2.2e4])


def test_the_aircraft_is_moved_and_weighed(card):
    a = card.aircraft
    model = Model.of(["mass_scale", "cg_shift", "inertia_scale"])
    true = model.actual_aircraft({"mass_scale": 0.1, "cg_shift": 0.2, "inertia_scale": -0.1}, a)
    assert true.mass == pytest.approx(1.1 * a.mass)
    assert true.Iy == pytest.approx(0.9 * a.Iy)
    assert true.tail_arm == pytest.approx(a.tail_arm + 0.2)
    for key in ("reference_point", "accelerometer", "engine"):
        old, new = getattr(a, key), getattr(true, key)
        assert new == pytest.approx((old[0] - 0.2, old[1], old[2]))
    assert (true.chord, true.Ix, true.Iz) == (a.chord, a.Ix, a.Iz)
    a = card.aircraft
    values = {"lateral_cg_shift": 0.2, "roll_inertia_scale": 0.1, "yaw_inertia_scale": -0.1, "inertia_product": 0.02}
    true = Model.of(list(values), axes=BOTH).actual_aircraft(values, a)
    assert (true.Ix, true.Iz, true.Ixz) == pytest.approx((1.1 * a.Ix, 0.9 * a.Iz, a.Ixz + 0.02 * a.Iz))
    for key in ("reference_point", "accelerometer", "engine"):
        old, new = getattr(a, key), getattr(true, key)
        assert new == pytest.approx((old[0], old[1] - 0.2, old[2]))
    assert (true.Iy, true.tail_arm) == (a.Iy, a.tail_arm)


def steady(card, **changes):
    """Cl and Cn of straight flight without rotation, 1 g, as the record gives them."""
    signals = dict.fromkeys(("ax", "ay", "p", "q", "r", "p_dot", "q_dot", "r_dot", "alpha", "beta"), 0.0)
    signals |= {"az": -9.81, "airspeed": 80.0, "density": 1.0, "thrust": 2e4, "thrust_left": 1e4, "thrust_right": 1e4}
    forward = dict.fromkeys(("reference_point", "accelerometer", "engine"), (0.5, 0.0, 0.2))
    aircraft = replace(card.aircraft, engine_arm=2.0, engine_inclination=0.0, **forward)
    model = Model.of(list(changes), axes=BOTH)
    channels = {name: jnp.asarray([x]) for name, x in signals.items()}
    found = coefficients(model.corrected(changes, channels, aircraft), model.actual_aircraft(changes, aircraft))
    pressure_area = 0.5 * 80.0**2 * aircraft.wing_area * 2.0 * aircraft.half_span
    return float(found.Cl[0]) * pressure_area, float(found.Cn[0]) * pressure_area


def test_uneven_engines_and_a_centre_of_gravity_aside_ask_for_moments(card):
    """5 % of 10 kN more left and less right, 2 m out: 2000 N m to the right, which aerodynamics must balance."""
    (roll, yaw), (_, without) = steady(card, thrust_asymmetry=0.05), steady(card)
    assert (roll, yaw, without) == pytest.approx((0.0, -2000.0, 0.0), abs=1e-9)
    # About the card's reference point, left of the CG, a lift of m g through the CG rolls to the left: -m g dy.
    roll, yaw = steady(card, lateral_cg_shift=0.1)
    assert steady(card) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert roll == pytest.approx(-0.1 * card.aircraft.mass * 9.81, rel=1e-9)
    assert yaw == pytest.approx(0.0, abs=1e-6)  # thrust left of the CG, and the drag that it holds, on one line


def test_the_aircraft_can_be_differentiated_under_jit(card):
    model = Model.of(["cg_shift"])

    @jax.jit
    def arm(dx):
        true = model.actual_aircraft({"cg_shift": dx}, card.aircraft)
        return true.tail_arm + 10.0 * true.engine[0]

    assert float(jax.grad(arm)(jnp.asarray(0.0))) == pytest.approx(1.0 - 10.0)


def test_fixed_errors_of_sensor_and_mass_are_taken_out(card, model, clean_records):
    clean = clean_records[0]
    wrong = {**clean.channels, "q": clean["q"] * 1.1, "alpha": clean["alpha"] + 0.01}
    record = FlightRecord.from_arrays(clean.name, clean.time, wrong)
    errors = {"pitch_rate_scale": 0.1, "alpha_bias": 0.01}
    extended = Model.of([*card.effects, *errors], {**card.fixed, **errors})
    expected, found = observe([clean], card, model), observe([record], card, extended)
    np.testing.assert_allclose(found.measured, expected.measured, atol=1e-10)
    assert set(found.signals) == set(expected.signals)
    extended = Model.of([*card.effects, "mass_scale"], {**card.fixed, "mass_scale": 0.05})
    light, heavy = (observe(clean_records[:1], card, m) for m in (model, extended))
    assert heavy.aircraft.mass == pytest.approx(1.05 * card.aircraft.mass)
    ratio = np.asarray(heavy.measured[:, 0] / light.measured[:, 0])
    assert 1.04 < np.median(ratio) < 1.06


@pytest.mark.parametrize("name", ["alpha_bias", "mass_scale"])
def test_a_free_error_of_the_record_is_refused(card, clean_records, name):
    with pytest.raises(InputError, match=f"effect {name} .*fix it on the card, or use bayes-aero diagnose"):
        observe(clean_records, card, Model.of([*card.effects, name]))
