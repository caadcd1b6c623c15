"""Every effect of the catalogue, without naming one: what the contract promises; and the signs of those of the record,
the aircraft and the lateral axis."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.effect import NEUTRAL_FLOW, Effect, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe, response_scales
from bayes_aero.model.records import marks_of, plain_marks
from bayes_aero.physics.aircraft import Aircraft, Axis
from bayes_aero.physics.kinematics import path_rates
from bayes_aero.report.pages.estimates import sign_sentences

AIRCRAFT = Aircraft(
    mass=15000.0, Ix=1e5, Iy=2e5, Iz=3e5, Ixz=1e4,
    wing_area=60.0, chord=3.0, half_span=10.0, aspect_ratio=7.0, tail_arm=15.0,
)  # fmt: skip
INDICES = ("first", "last")
MARKS = ("dt", "start", "elapsed", *INDICES)
WITH_MEMORY = (Stage.CHANNEL, Stage.LAG)
effects = pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)


@cache
def signals():
    """Two manoeuvres of 32 samples, every channel that the program knows and their marks."""
    rng, n = np.random.default_rng(0), 64
    s = {
        "alpha": rng.uniform(-0.1, 0.5, n), "alpha_dot": rng.normal(0, 0.05, n), "airspeed": rng.uniform(55, 100, n),
        "q": rng.normal(0, 0.05, n), "elevator": rng.normal(0, 0.1, n), "mach": rng.uniform(0.15, 0.4, n),
        "beta": rng.normal(0, 0.05, n), "density": rng.uniform(0.6, 1.2, n), "thrust": rng.uniform(2e3, 2e4, n),
        "altitude": rng.uniform(4900, 5100, n), "az": rng.normal(-9.8, 1.0, n),
    }  # fmt: skip
    gusts = {d.state: rng.normal(0, 1.0, n) for e in CATALOGUE.values() if (d := e.disturbance) is not None}
    s = {name: rng.normal(0, 0.1, n) for name in STANDARD_CHANNELS} | gusts | s
    s = {key: jnp.asarray(value) for key, value in s.items()}
    index = np.arange(n)
    return s | {
        "dt": jnp.full(n, 0.04), "start": jnp.asarray(index % 32 == 0), "elapsed": jnp.asarray(index % 32 * 0.04),
        "first": jnp.asarray(index // 32 * 32), "last": jnp.asarray(index // 32 * 32 + 31),
    }  # fmt: skip


def flow(s):
    """What the effects before have made of the flow: half separated, unevenly."""
    rng = np.random.default_rng(1)
    n = s["alpha"].shape[0]
    X = jnp.asarray(rng.uniform(0.01, 0.99, n))
    return {key: jnp.full(n, value) for key, value in NEUTRAL_FLOW.items()} | {
        "incidence": s["alpha"], "X": X, "CL_attached": jnp.asarray(rng.uniform(0, 1.5, n)),
        "X_difference": jnp.asarray(rng.uniform(-1.0, 1.0, n)) * jnp.minimum(X, 1.0 - X),
    }  # fmt: skip


def values(effect: Effect, which: str):
    own = {p.name: jnp.asarray(getattr(p, which)) for p in effect.parameters}
    return {name: jnp.asarray(4.0) for name in effect.uses} | own


def flat(increments):
    """All numbers of an effect's increments, positions too, as one vector."""
    return jnp.concatenate([jnp.ravel(jnp.asarray(x, float)) for x in jax.tree.leaves(increments)])


class Watched(dict):
    """Signals that remember which of them were asked for, whether or not they are there."""

    def __init__(self, given):
        super().__init__(given)
        self.read = set()

    def __getitem__(self, name):
        self.read.add(name)
        return super().__getitem__(name)

    def __contains__(self, name):
        self.read.add(name)
        return super().__contains__(name)

    def get(self, name, default=None):
        self.read.add(name)
        return super().get(name, default)


IF_RECORDED = {  # channels that an effect can do without
    **dict.fromkeys(("airspeed_bias", "airspeed_scale", "pitot_pressure_bias"), ("mach", "mach_follows")),
    **dict.fromkeys(("pitot_position", "vane_position"), ("beta", "r")),
    **dict.fromkeys(("thrust_scale", "thrust_lag"), ("thrust_left", "thrust_right")),
}


@effects
def test_neutral_values_give_nothing_and_others_what_fits_of_the_channels_it_names(effect):
    s = Watched(signals())
    state = flow(s)
    still, attached = dict(s), dict(state)
    if not effect.parameters or effect.name == "flow_separation":  # nothing where the flow is attached
        attached |= {"X": jnp.ones_like(s["alpha"]), "X_difference": jnp.zeros_like(s["alpha"])}
    if effect.disturbance is not None:  # a process of no intensity stays at zero
        still[effect.disturbance.state] = jnp.zeros_like(s["alpha"])
    assert np.all(np.asarray(flat(effect.increments(values(effect, "neutral"), still, AIRCRAFT, attached))) == 0.0)
    s.read.clear()
    increments = effect.increments(values(effect, "start"), s, AIRCRAFT, state)
    assert s.read - {*effect.channels, *MARKS} == set(IF_RECORDED.get(effect.name, ()))
    for key, increment in increments.items():
        added_to = {Stage.AIRCRAFT: vars(AIRCRAFT), Stage.CHANNEL: s, Stage.INFLOW: s}.get(effect.stage, state)
        assert np.shape(jnp.asarray(increment)) == np.shape(added_to[key])
        assert key not in MARKS
        if effect.stage not in (*WITH_MEMORY, Stage.AIRCRAFT):  # of one sample the same as of many
            sample, there = ({k: x[5] for k, x in given.items()} for given in (s, state))
            single = effect.increments(values(effect, "start"), sample, AIRCRAFT, there)[key]
            assert float(single) == pytest.approx(float(increment[5]), rel=1e-12)
    if effect.stage is Stage.CHANNEL:  # nothing crosses the seam between manoeuvres
        reversed_second = {k: jnp.concatenate([x[:32], x[32:] if k in MARKS else x[:31:-1]]) for k, x in s.items()}
        large = {p.name: jnp.asarray(p.start + 0.7 * effect.sizes[p.name][1]) for p in effect.parameters}
        before, after = (effect.increments(large, channels, AIRCRAFT, {}) for channels in (s, reversed_second))
        for key in before:
            np.testing.assert_allclose(before[key][:32], after[key][:32], rtol=1e-12, atol=1e-15)


@effects
def test_derivatives_are_finite_and_those_of_differences(effect):
    s = signals()
    state = flow(s)

    def response(v):
        return flat(effect.increments(v, s, AIRCRAFT, state))

    for which in ("neutral", "start"):
        _, pullback = jax.vjp(response, values(effect, which))
        (gradient,) = pullback(jnp.linspace(1.0, 2.0, len(response(values(effect, which)))))
        assert all(np.isfinite(float(g)) for g in gradient.values())
        if which == "start" and effect.disturbance is None:  # whose parameters act through its process
            assert all(float(gradient[p.name]) != 0.0 for p in effect.parameters)
    at = {p.name: jnp.asarray(p.start + 0.3 * effect.sizes[p.name][0]) for p in effect.parameters}
    at = values(effect, "start") | at  # a little off the start: a delay of exactly a sample has a kink at the ends
    for p in effect.parameters:
        h = 1e-5 * max(1.0, abs(p.start))
        up, down = (response(at | {p.name: at[p.name] + sign * h}) for sign in (1, -1))
        tangent = {k: jnp.asarray(float(k == p.name)) for k in at}
        _, slope = jax.jvp(response, (at,), (tangent,))
        scale = max(1.0, float(jnp.max(jnp.abs(slope))))
        np.testing.assert_allclose(slope, (up - down) / (2 * h), rtol=1e-5, atol=1e-8 * scale)


@effects
def test_worked_example_comes_out(effect):
    example = effect.example
    assert example.source
    kinds = {"start": bool} | dict.fromkeys(INDICES, int)
    sample = {k: jnp.atleast_1d(jnp.asarray(v, kinds.get(k, float))) for k, v in example.signals.items()}
    state = NEUTRAL_FLOW | {"incidence": sample.get("alpha", 0.0)} | (example.known or {})
    state = {k: jnp.atleast_1d(jnp.asarray(v)) for k, v in state.items()}
    given = {k: jnp.asarray(v) for k, v in example.parameters.items()}
    increments = effect.increments(given, sample, AIRCRAFT, state)
    assert set(increments) == set(example.increments)
    for key, expected in example.increments.items():
        number = np.asarray(jnp.asarray(increments[key]))
        np.testing.assert_allclose(number, np.broadcast_to(expected, number.shape), rtol=1e-9, atol=1e-12)


@effects
def test_it_says_what_it_is_and_where_it_comes_from(effect):
    assert effect.claim.endswith(".")
    assert effect.formula.endswith(".")
    assert effect.source
    assert set(effect.sizes) == {p.name for p in effect.parameters}
    for p in effect.parameters:
        assert p.unit
        assert p.description
        assert p.prior.source
        assert p.bounds[0] <= p.start <= p.bounds[1]
        assert np.isfinite(float(p.prior.log_density(jnp.asarray(p.start))))
        least, largest = effect.sizes[p.name]
        assert 0.0 < least < largest < np.inf
        scanned = effect.scan.get(p.name, (p.start,))
        assert scanned
        assert set(effect.scan) <= {one.name for one in effect.parameters}
        assert p.name not in effect.scan or all(p.bounds[0] < value < p.bounds[1] for value in scanned)


def test_parameters_have_one_owner_in_the_whole_catalogue():
    names = [p.name for effect in CATALOGUE.values() for p in effect.parameters]
    assert len(names) == len(set(names))
    assert {name for effect in CATALOGUE.values() for name in effect.uses} <= set(names)


BOTH = tuple(Axis)
REST = {"alpha": 0.1, "beta": 0.0, "p": 0.0, "r": 0.0, "aileron": 0.0, "rudder": 0.0, "airspeed": 80.0}

STABLE = [  # a motion to the right, and the side on which a stable aircraft of usual controls answers it
    ("sideslip_side_force", "beta", "CY", -1),  # the wind from the right pushes to the left
    ("sideslip_roll", "beta", "Cl", -1),  # the right wing rises
    ("sideslip_yaw", "beta", "Cn", +1),  # the nose turns into the wind
    ("roll_damping", "p", "Cl", -1),
    ("yaw_damping", "r", "Cn", -1),
    ("yaw_rate_roll", "r", "Cl", +1),  # the left wing is faster and rises
    ("roll_rate_yaw", "p", "Cn", -1),  # lift of the right wing, which goes down, leans forward
    ("aileron_roll", "aileron", "Cl", -1),  # the right aileron down lifts the right wing
    ("rudder_side_force", "rudder", "CY", +1),  # the trailing edge left pushes the fin to the right
    ("rudder_yaw", "rudder", "Cn", -1),  # and the nose to the left
]


@pytest.mark.parametrize(("name", "channel", "coefficient", "side"), STABLE)
def test_defaults_have_the_sign_of_a_stable_aircraft(card, name, channel, coefficient, side):
    """An estimate of the wrong sign is reported, except two parameters that may have either."""
    model = Model.of([name], axes=BOTH)
    (p,), signals = model.parameters, {key: np.array([x]) for key, x in (REST | {channel: 0.1}).items()}
    told = sign_sentences({p.name: (-p.start, 0.001)}, [p])
    assert len(told) == (name not in ("yaw_rate_roll", "roll_rate_yaw"))
    assert sign_sentences({p.name: (p.start, 0.001)}, [p]) == []
    made = model.flow({p.name: p.start}, signals, card.aircraft)
    assert side * float(made[coefficient][0]) > 0.0
    others = {"CL", "CD", "Cm", "CY", "Cl", "Cn"} - {coefficient}
    assert all(float(made[key][0]) == 0.0 for key in others)


def test_spoilers_of_one_side_roll_and_yaw_to_it_and_alike_ones_do_nothing(card):
    model = Model.of(["spoiler_roll", "spoiler_yaw"], axes=BOTH)
    deflected = {"alpha": [0.1, 0.1], "spoiler_left": [0.0, 0.3], "spoiler_right": [0.3, 0.3]}
    deflected = {name: np.array(x) for name, x in deflected.items()}
    made = model.flow({"Clds": 0.1, "Cnds": 0.02}, deflected, card.aircraft)
    assert np.asarray(made["Cl"]) == pytest.approx([0.015, 0.0], abs=1e-15)
    assert np.asarray(made["Cn"]) == pytest.approx([0.003, 0.0], abs=1e-15)


# What was recorded becomes what was true: the sign convention of effects on the record and on the aircraft
N, DT = 400, 0.04
T, INNER = np.arange(N) * DT, slice(5, -5)  # a delay cannot look beyond the ends


def wave(t):
    """A smooth channel that changes sign."""
    return 0.3 * np.sin(0.9 * t) + 0.1 * np.cos(2.3 * t)


MADE_WRONG = {  # by the last word of an effect's name
    "bias": lambda t, size: wave(t) + size,
    "scale": lambda t, size: (1.0 + size) * wave(t),
    "delay": lambda t, size: wave(t - size),
    "wind": lambda t, size: wave(t) + size * t,
}
RECORDED = [
    ("alpha_bias", "alpha", 0.02), ("airspeed_bias", "airspeed", -1.5), ("pitch_rate_bias", "q", 0.004),
    ("accel_x_bias", "ax", 0.1), ("accel_z_bias", "az", -0.2), ("pitch_attitude_bias", "theta", 0.01),
    ("alpha_scale", "alpha", 0.08), ("airspeed_scale", "airspeed", 0.03), ("pitch_rate_scale", "q", -0.05),
    ("elevator_scale", "elevator", 0.1), ("altitude_scale", "altitude", 0.02), ("density_scale", "density", -0.04),
    ("alpha_delay", "alpha", 0.13), ("alpha_delay", "alpha", -0.07), ("sideslip_delay", "beta", 0.06),
    ("heading_delay", "psi", 0.09), ("elevator_delay", "elevator", 0.08), ("vertical_wind", "altitude", 2.0),
    ("accel_y_bias", "ay", 0.1), ("sideslip_bias", "beta", 0.02), ("bank_angle_bias", "phi", -0.01),
    ("roll_rate_bias", "p", 0.003), ("yaw_rate_bias", "r", -0.002), ("accel_y_scale", "ay", 0.1),
    ("sideslip_scale", "beta", -0.05), ("bank_angle_scale", "phi", 0.04), ("roll_rate_scale", "p", 0.08),
    ("yaw_rate_scale", "r", -0.03), ("aileron_scale", "aileron", 0.1), ("rudder_scale", "rudder", -0.1),
    ("aileron_delay", "aileron", 0.08), ("rudder_delay", "rudder", -0.06),
]  # fmt: skip


def corrected(card, sizes, channels):
    """Channels of the record as they truly were, with errors of these sizes taken out."""
    model = Model.of(list(sizes), axes=BOTH)
    owners = {p.name: e.name for e in model.effects for p in e.parameters}
    given = plain_marks(N, DT) | {name: jnp.asarray(x) for name, x in channels.items()}
    return model.corrected({p: jnp.asarray(sizes[name]) for p, name in owners.items()}, given, card.aircraft)


@pytest.mark.parametrize(("name", "channel", "size"), RECORDED)
def test_what_was_recorded_becomes_what_was_true(card, name, channel, size):
    error = name.split("_")[-1]
    true = corrected(card, {name: size}, {channel: MADE_WRONG[error](T, size)})[channel]
    np.testing.assert_allclose(true[INNER], wave(T)[INNER], atol=1e-4 if error == "delay" else 1e-12)


@pytest.mark.parametrize(("error", "channel"), [("elevator", "elevator"), ("rudder", "rudder"), ("sideslip", "beta")])
def test_a_late_channel_of_another_scale_is_scaled_as_it_was(card, error, channel):
    """Recorded(t) = (1 + scale) true(t - delay); a scale of the late channel would be a second tap of a filter."""
    late, size = 0.13, -0.2
    sizes = {f"{error}_scale": size, f"{error}_delay": late}
    true = corrected(card, sizes, {channel: (1.0 + size) * wave(T - late)})[channel]
    np.testing.assert_allclose(true[INNER], wave(T)[INNER], atol=1e-4)


@pytest.mark.parametrize(("name", "size"), [("airspeed_bias", 5.0), ("airspeed_scale", 0.05)])
def test_a_mach_number_with_a_source_of_its_own_is_left_as_it_is(card, name, size):
    """True speeds and a = 320 m/s, by hand; the airspeed is recorded wrong, and the Mach number right."""
    true = np.array([60.0, 70.0, 80.0, 90.0])
    wrong = true + size if name == "airspeed_bias" else true * (1.0 + size)
    air = {"static_temperature": np.full(4, 320.0**2 / (1.4 * 287.05287))}
    for mach, follows in ((true / 320.0, 0.0), (wrong / 320.0, 1.0)):
        record = FlightRecord.from_arrays("by_hand", T[:4], air | {"airspeed": wrong, "mach": mach})
        given = {"airspeed": jnp.asarray(wrong), "mach": jnp.asarray(mach)} | marks_of(record, 0)
        assert np.all(given["mach_follows"] == follows)
        estimate = Model.of([name]).corrected({name: jnp.asarray(size)}, given, card.aircraft)
        np.testing.assert_allclose(estimate["mach"], true / 320.0, rtol=1e-12)


def test_every_effect_on_the_record_has_its_sign_tested():
    shown = [e for e in CATALOGUE.values() if e.disturbance is None]
    measured = {e.name for e in shown if e.kind in ("measurement", "environment")}
    assert measured == {row[0] for row in (*RECORDED, *ELSEWHERE, *ACCELEROMETERS)} | {"pitot_pressure_bias"}


@pytest.mark.parametrize("size", [300.0, -150.0])
def test_an_airspeed_from_an_impact_pressure_that_is_off_becomes_the_true_one(card, size):
    V, density = 80.0 + 20.0 * wave(T), 0.75 + 0.1 * wave(T + 1.0)
    recorded = {"airspeed": np.sqrt(V**2 + 2.0 * size / density), "density": density}
    true = corrected(card, {"pitot_pressure_bias": size}, recorded)["airspeed"]
    np.testing.assert_allclose(true, V, rtol=1e-12)


ELSEWHERE = [
    ("vane_position", 13.08, 0.0, ("alpha", "beta", "airspeed"), 0.003, 0.03),
    ("vane_position", -4.0, 0.0, ("alpha", "beta", "airspeed"), 0.003, 0.03),
    ("sideslip_vane_position", 13.08, 0.0, ("beta",), 0.001, 0.02),
    ("sideslip_vane_height", 0.0, -1.5, ("beta",), 0.001, 0.02),
    ("pitot_position", 13.08, 0.0, ("alpha", "beta", "airspeed"), 0.2, 1e-10),
]


@pytest.mark.parametrize(("name", "x", "up", "shown", "least", "left"), ELSEWHERE)
def test_away_from_the_cg_the_flow_of_its_own_place_is_read(card, name, x, up, shown, least, left):
    """Velocities of a rigid body: (u, v + x r + up p, w - x q) ahead of and above (u, v, w). Vanes take the airspeed,
    in which this shows a little, as that of the CG: a share `left` of what moved them is not taken out."""
    true = {"alpha": 0.2 + wave(T) / 3.0, "beta": wave(T + 1.0) / 4.0, "airspeed": 80.0 + 5.0 * wave(T + 4.0)}
    rates = {"p": 0.3 * wave(T + 2.0), "q": 0.2 * wave(T + 2.0), "r": 0.2 * wave(T + 3.0)}
    alpha, beta, V = true.values()
    u, v, w = V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)
    across, down = v + x * rates["r"] + up * rates["p"], w - x * rates["q"]
    there = {"alpha": np.arctan2(down, u), "airspeed": np.sqrt(u**2 + across**2 + down**2)}
    there["beta"] = np.arcsin(across / there["airspeed"])
    recorded = true | rates | {channel: there[channel] for channel in shown}
    estimate = corrected(card, {name: x or up}, recorded)
    shares = {"vane_position": {"alpha": 0.01, "beta": left}, "pitot_position": {"airspeed": left}}
    moved = {channel: np.abs(there[channel] - true[channel]).max() for channel in shown}
    for channel, share in shares.get(name, {"beta": left}).items():
        of = max(moved["alpha"], moved["beta"]) if name == "vane_position" else moved[channel]
        assert of > least
        np.testing.assert_allclose(estimate[channel], true[channel], rtol=0.0, atol=share * of)
    if name == "vane_position":  # without sideslip and yaw rate as nearly as with them
        alone = corrected(card, {name: x}, {n: recorded[n] for n in ("alpha", "q", "airspeed")})
        assert "beta" not in alone
        added, expected = (x["alpha"] - recorded["alpha"] for x in (alone, estimate))
        np.testing.assert_allclose(added, expected, rtol=0.02, atol=1e-12)


ACCELEROMETERS = [
    ("accel_y_position", (3.0, 0.0, 0.0), False), ("accel_y_height", (0.0, 0.0, -1.5), False),
    ("accelerometer_position", (-2.0, 0.0, 0.0), True), ("accelerometer_height", (0.0, 0.0, 1.0), True),
]  # fmt: skip


@pytest.mark.parametrize(("name", "place", "all_three"), ACCELEROMETERS)
def test_accelerometers_elsewhere_read_the_acceleration_of_their_own_place(card, name, place, all_three):
    """That of a rigid body: omega_dot x d + omega x (omega x d) more; the flight path is then that of the centre."""
    axes = ("ax", "ay", "az")
    rates = np.stack([0.3 * np.sin(0.8 * T), 0.2 * np.sin(0.5 * T), 0.1 * np.cos(0.7 * T)], axis=1)
    turning = np.stack([0.24 * np.cos(0.8 * T), 0.1 * np.cos(0.5 * T), -0.07 * np.sin(0.7 * T)], axis=1)
    more = np.cross(turning, place) + np.cross(rates, np.cross(rates, place))
    true = {n: wave(T + k) for k, n in enumerate(axes)} | {"airspeed": 80.0 + wave(T)}
    true |= {n: wave(T + 5.0 + k) / 5.0 for k, n in enumerate(("alpha", "beta", "phi", "theta"))}
    true |= dict(zip("pqr", rates.T, strict=True))
    recorded = true | {n: true[n] + more[:, k] for k, n in enumerate(axes) if all_three or n == "ay"}
    size = place[0] - place[2]  # ahead, or up
    aircraft = Model.of([name], axes=BOTH).actual_aircraft({name: size}, card.aircraft)
    slopes = dict(zip(("p_dot", "q_dot", "r_dot"), turning.T, strict=True))
    estimate = path_rates(corrected(card, {name: size}, recorded) | slopes, aircraft)
    expected = path_rates(true | slopes, card.aircraft)
    moved = path_rates(recorded | slopes, card.aircraft)["beta"] - expected["beta"]
    assert np.abs(moved).max() > 1e-3
    for state, rate in expected.items():
        np.testing.assert_allclose(estimate[state][INNER], rate[INNER], atol=1e-6)


def test_pitch_rate_in_the_vanes_angle_does_not_change_its_unit(card):
    """A delay and a place away from the CG leave a degree a degree; a scale does not."""
    names = ("alpha", "q", "airspeed")
    channels = plain_marks(N, DT) | dict(zip(names, (wave(T), wave(T + 1.0), jnp.full(N, 80.0)), strict=True))
    for effect, value, unit in (("vane_position", 13.0, 1.0), ("alpha_delay", 0.1, 1.0), ("alpha_scale", 0.25, 0.8)):
        scale = response_scales(Model.of([effect]), {effect: jnp.asarray(value)}, channels, card.aircraft, names)
        np.testing.assert_allclose(scale["alpha"][INNER], unit, rtol=0.02)
        np.testing.assert_allclose(scale["q"], 1.0)


def test_corrections_see_the_record_and_not_each_other_and_count_for_either_engine(card):
    alpha = np.linspace(0.1, 0.3, N)
    both = corrected(card, {"alpha_bias": 0.01, "alpha_scale": 0.25}, {"alpha": alpha})["alpha"]
    np.testing.assert_allclose(both, alpha / 1.25 - 0.01, rtol=1e-12)
    thrust = {"thrust": np.full(N, 3e4), "thrust_left": np.full(N, 1e4), "thrust_right": np.full(N, 2e4)}
    true = corrected(card, {"thrust_scale": 0.1}, thrust)
    assert [float(true[name][0]) for name in thrust] == pytest.approx([3.3e4, 1.1e4, 2.2e4])


@pytest.mark.parametrize(("values", "moved", "changed"), [
    ({"mass_scale": 0.1, "cg_shift": 0.2, "inertia_scale": -0.1}, (0.2, 0.0, 0.0),
     lambda a: {"mass": 1.1 * a.mass, "Iy": 0.9 * a.Iy, "tail_arm": a.tail_arm + 0.2}),
    ({"lateral_cg_shift": 0.2, "roll_inertia_scale": 0.1, "yaw_inertia_scale": -0.1, "inertia_product": 0.02},
     (0.0, 0.2, 0.0), lambda a: {"Ix": 1.1 * a.Ix, "Iz": 0.9 * a.Iz, "Ixz": a.Ixz + 0.02 * a.Iz}),
])  # fmt: skip
def test_the_aircraft_is_moved_and_weighed_and_nothing_else_changes(card, values, moved, changed):
    a = card.aircraft
    true = Model.of(list(values), axes=BOTH).actual_aircraft(values, a)
    places = {key: tuple(np.subtract(getattr(a, key), moved)) for key in ("reference_point", "accelerometer", "engine")}
    for key, expected in vars(replace(a, **changed(a), **places)).items():
        assert expected is None or getattr(true, key) == pytest.approx(expected), key


def test_fixed_errors_of_sensor_and_mass_are_taken_out(card, model, clean_records):
    clean = clean_records[0]
    wrong = {**clean.channels, "q": clean["q"] * 1.1, "alpha": clean["alpha"] + 0.01}
    record = FlightRecord.from_arrays(clean.name, clean.time, wrong)
    errors = {"pitch_rate_scale": 0.1, "alpha_bias": 0.01, "mass_scale": 0.05}
    lighter = replace(card, aircraft=replace(card.aircraft, mass=card.aircraft.mass / 1.05))
    extended = Model.of([*card.effects, *errors], {**card.fixed, **errors})
    expected, freed = observe([clean], card, model), observe([record], lighter, extended)
    np.testing.assert_allclose(freed.measured, expected.measured, atol=1e-10)
    assert set(freed.signals) == set(expected.signals)
    assert freed.aircraft.mass == pytest.approx(card.aircraft.mass)


@pytest.mark.parametrize("name", ["alpha_bias", "mass_scale"])
def test_a_free_error_of_the_record_is_refused(card, clean_records, name):
    with pytest.raises(InputError, match=f"effect {name} .*fix it on the card, or use bayes-aero diagnose"):
        observe(clean_records, card, Model.of([*card.effects, name]))
