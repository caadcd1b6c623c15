"""Errors of sensors without an altitude, and where flow-angle sensors sit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import six_axes
from parts import part
from stranger_six import drawn, fly

from bayes_aero.api import read
from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.consistency import (
    KnownErrors,
    check_sensors,
    consistency,
    errors_of_diagnosis,
    errors_of_path,
    screen_sensor_errors,
)
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.screening.regression import RegressionFit
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.agreement import Agreement, Consistency, OpenError
from bayes_aero.flight.channel import Axis
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.io.documents import ConsistencyPart
from bayes_aero.model.joined_records import joined
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.report.text.check import consistency_sentences, open_sentences
from bayes_aero.residuals.flight_path import FlightPathError
from bayes_aero.simulate.demo import simulate_stall
from bayes_aero.simulate.injection import flyable, hidden_records

# Errors of sensors without an altitude: named, or told with what cannot be parted from them; silent where none is
G = 9.80665
NOISE = {"ax": 0.01, "az": 0.02, "q": 2e-4, "theta": 5e-4, "alpha": 5e-4, "airspeed": 0.1}


def level_flight(seconds: float, seed: int, **offsets: float) -> FlightRecord:
    """Wings level, by hand: u' = ax - g sin theta - q w, w' = az + g cos theta + q u with u = V cos a, w = V sin a."""
    t = np.arange(0.0, seconds, 0.1)
    swing = [(0.02, 0.9), (0.015, 1.7), (0.03, 0.25)]
    alpha = 0.10 + sum(a * np.sin(w * t) for a, w in swing)
    alpha_dot = sum(a * w * np.cos(w * t) for a, w in swing)
    theta = 0.12 + sum(1.5 * a * np.sin(w * t - 0.4) for a, w in swing)
    q = sum(1.5 * a * w * np.cos(w * t - 0.4) for a, w in swing)
    V, V_dot = 100.0 + 4.0 * np.sin(0.2 * t), 0.8 * np.cos(0.2 * t)
    u, w = V * np.cos(alpha), V * np.sin(alpha)
    true = {
        "ax": V_dot * np.cos(alpha) - w * alpha_dot + q * w + G * np.sin(theta),
        "az": V_dot * np.sin(alpha) + u * alpha_dot - q * u - G * np.cos(theta),
        "q": q, "theta": theta, "alpha": alpha, "airspeed": V,
    }  # fmt: skip
    rng = np.random.default_rng(seed)
    measured = {n: x + offsets.get(n, 0.0) + NOISE[n] * rng.standard_normal(t.size) for n, x in true.items()}
    return FlightRecord.from_arrays(f"level_{seed}", t, measured)


@pytest.fixture(scope="module")
def bare(card):
    """A card that states the aircraft and no constants: lateral channels are neither recorded nor stated."""
    return replace(card, aircraft=replace(card.aircraft, accelerometer=(0.0, 0.0, 0.0)), constants={}, sums={})


def found_in(record: FlightRecord, card) -> tuple[KnownErrors, Consistency]:
    known = errors_of_path(screen_sensor_errors([record], card))
    return known, consistency([record], card, known=known)


def test_an_offset_of_the_attitude_is_told_with_the_accelerometers_that_look_the_same(bare):
    """Gravity in the body axes turns: ax by g b cos theta and az by g b sin theta do the same to V and alpha."""
    known, found = found_in(level_flight(60.0, 1, theta=0.0125), bare)
    assert found.unchecked == ("altitude", "beta", "phi")
    told = {e.name: e for e in found.open}
    entry = told["pitch_attitude_bias"]
    assert "accel_x_bias" in entry.imitators
    assert entry.among > 3.0 * entry.sd or entry.among > 0.005  # with those free it is not known as well
    size = known.errors.get("pitch_attitude_bias", {}).get("parameters", {}).get("pitch_attitude_bias")
    mean, sd = (size["mean"], size["sd"]) if size else (entry.mean, entry.sd)
    assert mean == pytest.approx(0.0125, abs=max(4.0 * sd, 0.003))
    assert any("pitch_attitude_bias" in one and "accel_x_bias" in one for one in open_sentences(found))
    assert ConsistencyPart.of(found).open["pitch_attitude_bias"].imitators
    # An offset b of theta and offsets of ax and az that stand for it give one and the same flight path.
    b = 0.0125
    tilted = {"ax": -G * b * np.cos(0.12), "az": -G * b * np.sin(0.12)}
    found = found_in(level_flight(60.0, 1, **tilted), bare)[1]
    told = {e.name: e for e in found.open}
    assert {"accel_x_bias", "pitch_attitude_bias"} <= set(told)
    assert "pitch_attitude_bias" in told["accel_x_bias"].imitators


@pytest.mark.parametrize("seed", [2, 3])
def test_nothing_is_asked_for_where_nothing_is_hidden(bare, seed):
    known, found = found_in(level_flight(60.0, seed), bare)
    assert found.agreement is Agreement.AGREE
    assert not [e for e in known.errors.values() if not e["minor"]]
    assert not [e.name for e in found.open if e.asked]


def misread(
    card, *, bias: float = 0.0, scale: float = 0.0, pressure: float = 0.0, own_mach: bool = False
) -> FlightRecord:
    """A simulated stall whose airspeed has errors: of the impact pressure (Pa), then in proportion, then a constant.

    They are in the Mach number, too, unless it has a source of its own.
    """
    flown = simulate_stall(0, card=card)
    channels = {name: np.array(x) for name, x in flown.channels.items()}
    V = channels["airspeed"]
    channels["airspeed"] = np.sqrt(V**2 + 2.0 * pressure / channels["density"]) * (1.0 + scale) + bias
    channels["mach"] *= 1.0 if own_mach else channels["airspeed"] / V
    return FlightRecord.from_arrays("stall", np.asarray(flown.time), channels, "simulated")


@pytest.mark.parametrize(("hidden", "name", "true"), [
    ({"pressure": -200.0}, "pitot_pressure_bias", -200.0), ({"scale": 0.03}, "airspeed_scale", 0.03),
    ({"bias": -3.0}, "airspeed_bias", -3.0),
])  # fmt: skip
def test_an_offset_of_the_pitot_line_is_none_of_the_airspeed(card, hidden, name, true):
    """rho V dV = dp: the three errors of the airspeed differ by how they go with speed."""
    known, _ = found_in(misread(card, **hidden), card)
    assert list(known.errors) == [name]
    size = known.errors[name]["parameters"][name]
    assert size["mean"] == pytest.approx(true, abs=4.0 * size["sd"])
    assert size["sd"] < 0.02 * abs(true)


@pytest.mark.parametrize("gained", [-2.0, -40.0])
def test_the_flight_path_is_selected_again_without_an_error_larger_than_sensors_have(monkeypatch, gained):
    """Another that explains it within 3 nats takes its place; where none does, it stays and corrects nothing."""
    names, asked = ("airspeed_scale", "airspeed_bias", "alpha_scale"), []
    full = CandidateModel(Model.of(names, axes=tuple(Axis)), (), tuple(CATALOGUE[n] for n in names), {})

    def linearised(own, *_):
        asked.append(tuple(e.name for e in own.candidates))
        return part(SelectionState, full=own, active=names[:2] if len(asked) == 1 else names[2:])

    def selected(state, **_):
        no_fit, base = part(RegressionFit), part(SelectionState, active=())
        sizes = {"airspeed_scale": Size(-0.06, 0.01, "1"), "airspeed_bias": Size(10.7, 0.5, "m/s"),
                 "alpha_scale": Size(0.1, 0.01, "1")}  # fmt: skip
        return Extension(base, no_fit, state, no_fit, (), sizes, state.active, ())

    for name, given in {
        "linearised": linearised, "forward_selection": selected, "widened": lambda found, *_: found,
        "nats_gained": lambda *_: gained, "without_hold": lambda one: {n: {} for n in one.state.active},
    }.items():  # fmt: skip
        monkeypatch.setattr(f"bayes_aero.diagnosis.consistency.{name}", given)
    monkeypatch.setattr(FlightPathError, "outputs", ("airspeed",))
    found = check_sensors(full, part(FlightPathError), np.zeros(3), seed=0)
    assert asked == [names, names[2:]]
    assert found.state.active == (names[2:] if gained > -3.0 else names[:2])
    assert [one.implausible for one in found.larger] == ([("airspeed_bias",)] if gained > -3.0 else [])


PITOT = Path(__file__).resolve().parents[3] / "shared" / "trials" / "pitot_zero_offset.csv"


@pytest.mark.skipif(not PITOT.exists(), reason="needs ../shared/trials")
def test_a_pitot_line_that_is_off_is_named_and_explains_the_record(card):
    """300 Pa; the scale of the airspeed is right."""
    (record,) = read(PITOT, card)
    known, found = found_in(record, card)
    assert list(known.errors) == ["pitot_pressure_bias"]
    size = known.errors["pitot_pressure_bias"]["parameters"]["pitot_pressure_bias"]
    assert size["mean"] == pytest.approx(300.0, abs=3.0 * size["sd"])
    assert size["sd"] < 10.0
    assert found.agreement is Agreement.EXPLAINED


def test_two_errors_of_a_sensor_are_one_joint_estimate_and_half_of_it_no_correction(card):
    known, found = found_in(misread(card, bias=6.0, scale=0.05), card)
    assert set(known.errors) == {"airspeed_bias", "airspeed_scale"}
    for name, other, true in (("airspeed_bias", "airspeed_scale", 6.0), ("airspeed_scale", "airspeed_bias", 0.05)):
        assert -1.0 < known.errors[name]["joint"][other] < -0.9
        size = known.errors[name]["parameters"][name]
        assert size["mean"] == pytest.approx(true, abs=4.0 * size["sd"])
    assert found.agreement is Agreement.EXPLAINED
    (answer, *_) = consistency_sentences(found, corrects=False)
    assert answer.count("estimated together with") == 2
    assert not {e.name for e in found.open} & set(known.errors)
    # A bias of 13 m/s is larger than sensors have, and the scale was estimated beside it.
    known, found = found_in(misread(card, bias=13.0, scale=0.05), card)
    assert not known.errors
    assert found.agreement is Agreement.UNEXPLAINED
    assert not found.corrected
    joint = {e.name: e.joint for e in found.open if e.joint}
    assert set(joint) == {"airspeed_bias", "airspeed_scale"}
    assert -1.0 < joint["airspeed_scale"]["airspeed_bias"] < -0.9
    assert any("estimated together" in one and "airspeed_scale" in one for one in open_sentences(found))
    assert ConsistencyPart.of(found).open["airspeed_scale"].joint == joint["airspeed_scale"]


@pytest.mark.parametrize(("bias", "scale"), [(4.0, -0.0225), (-3.0, 0.02), (2.0, -0.01)])
def test_offset_and_scale_that_go_with_speed_as_a_pitot_pressure_are_not_named_that(card, bias, scale):
    """dp / (rho V) = 2 e - e V / V0 to first order of V about V0: offset and scale of opposite signs stand for it."""
    known, found = found_in(misread(card, bias=bias, scale=scale), card)
    assert set(known.errors) == {"airspeed_bias", "airspeed_scale"}
    for name, true in (("airspeed_bias", bias), ("airspeed_scale", scale)):
        size = known.errors[name]["parameters"][name]
        assert size["mean"] == pytest.approx(true, abs=4.0 * size["sd"])
    assert "airspeed_scale" in known.errors["airspeed_bias"]["joint"]
    assert found.agreement is not Agreement.UNEXPLAINED


def test_the_true_pitot_pressure_leaves_the_path_and_errors_beside_larger_ones_are_found(card):
    """The scale of the correction goes with the airspeed; where its integral begins must not be multiplied by it."""

    def left(pressure: float) -> float:
        flights = joined([misread(card, pressure=pressure)], card)
        path = FlightPathError.of(flights, Model.of(["pitot_pressure_bias"]))
        residual = path.evaluate(np.array([pressure]))[0][:, path.outputs.index("airspeed")]
        return float(np.std(residual))

    assert left(258.0) == pytest.approx(left(0.0), rel=0.2)
    # A vane 9 deg off is no error that vanes have and is not corrected; the airspeed is judged beside it.
    record = misread(card, bias=-3.0)
    record = replace(record, channels={**record.channels, "alpha": record.channels["alpha"] + np.radians(9.0)})
    known, _ = found_in(record, card)
    assert list(known.errors) == ["airspeed_bias"]
    size = known.errors["airspeed_bias"]["parameters"]["airspeed_bias"]
    assert size["mean"] == pytest.approx(-3.0, abs=4.0 * size["sd"])


@pytest.mark.verify
def test_a_right_mach_number_beside_a_wrong_airspeed_leaves_the_lift_as_it_is(card):
    """CLa is 3.6, CD0 .045; moved with the airspeed, the Mach number would make CLa 3.78."""
    found = diagnose([misread(card, pressure=300.0, own_mach=True)], card, gains_wanted=False)
    assert {c.name for c in found.causes} == {"pitot_pressure_bias"}
    assert not found.minor
    assert not found.unknown
    for name, true in (("CLa", 3.6), ("CD0", 0.045)):
        _, after, sd = found.base_moves[name]
        assert after == pytest.approx(true, abs=3.0 * sd)


@pytest.mark.recovery
def test_an_error_that_a_diagnosis_is_sure_of_is_not_undecided(card, monkeypatch):
    """Whatever the flight path alone could not part it from: altitude and drag together part it."""
    effects, flights = flyable(["accel_x_bias"], seed=5311, noise="white", seconds=90.0)
    found = diagnose([flight.record for flight in flights], card, seed=1, gains_wanted=False)
    two = (undecided("accel_x_bias", "pitch_attitude_bias"), undecided("vertical_wind", "alpha_bias"))
    monkeypatch.setattr("bayes_aero.diagnosis.consistency.open_errors", lambda _: two)
    known = errors_of_diagnosis(found)
    size = known.errors["accel_x_bias"]["parameters"]["accel_x_bias"]
    assert size["mean"] == pytest.approx(effects["accel_x_bias"]["accel_x_bias"], abs=4.0 * size["sd"])
    assert [e.name for e in known.open] == ["vertical_wind"]


def undecided(name: str, imitator: str) -> OpenError:
    return OpenError(name=name, unit="1", mean=0.1, sd=0.01, among=0.1, asked=False, imitators=(imitator,), share=0.99)


# Flow-angle sensors on a boom, hidden in simulated stalls: told from a lag, sized, and moved back by a card
BOOM, LAG = 13.08, 0.15  # m, s: at 80 m/s x/V is .16 s, so that each is what the other would pretend to be


@pytest.mark.recovery
@pytest.mark.parametrize(("name", "true"), [("vane_position", BOOM), ("alpha_delay", LAG)])
def test_a_boom_is_called_a_boom_and_a_lag_a_lag(card, name, true):
    """By kinematics alone: no aerodynamics enters, and each is the other's nearest rival."""
    records = hidden_records({name: {name: true}}, seed=620, noise="ar1", seconds=90.0)
    found = screen_sensor_errors(records, card)
    assert found.causes == (name,)
    size = found.sizes[name]
    assert abs(size.mean - true) < 3.0 * size.sd
    assert 1.96 * size.sd < 0.15 * true


AT = 3.0  # m from where the card says
BESIDE = {  # what a lateral sensor adds that is elsewhere or late, of a flight's channels and its angular accelerations
    "sideslip_vane_position": (6.0, lambda f, _: {"beta": f["beta"] + 6.0 * f["r"] / f["airspeed"]}),
    "sideslip_vane_height": (2.0, lambda f, _: {"beta": f["beta"] + 2.0 * f["p"] / f["airspeed"]}),
    "sideslip_delay": (0.1, lambda f, _: {"beta": np.interp(f["time"] - 0.1, f["time"], f["beta"])}),
    "sideslip_scale": (0.15, lambda f, _: {"beta": 1.15 * f["beta"]}),
    "accel_y_position": (AT, lambda f, dot: {"ay": f["ay"] + AT * (dot["r"] + f["p"] * f["q"])}),
    "accelerometer_position": (AT, lambda f, dot: {
        "ax": f["ax"] - AT * (f["q"] ** 2 + f["r"] ** 2),
        "ay": f["ay"] + AT * (dot["r"] + f["p"] * f["q"]),
        "az": f["az"] + AT * (f["p"] * f["r"] - dot["q"]),
    }),
}  # fmt: skip


@pytest.mark.parametrize("name", [None, *BESIDE])
def test_lateral_sensors_elsewhere_or_late_are_told_apart(tmp_path, name):
    """By kinematics, in flights of a simulator that shares no code: velocities and accelerations of a rigid body."""
    rng = np.random.default_rng(41)
    plane = drawn(rng, **six_axes.ATTACHED)
    records = []
    for kind in ("aileron", "rudder", "elevator"):
        flight = fly(plane, kind, rng)
        dot = {n: np.gradient(flight[n], flight["time"]) for n in "pqr"}
        flight |= BESIDE[name][1](flight, dot) if name else {}
        records.append(six_axes.record(kind, flight, rng))
    found = screen_sensor_errors(records, six_axes.card_in(tmp_path, plane))
    assert found.causes == (() if name is None else (name,))
    if name is not None:
        size = found.sizes[name]
        assert abs(size.mean - BESIDE[name][0]) < 3.0 * size.sd
        assert size.sd < 0.1 * BESIDE[name][0]


def test_a_card_that_states_the_boom_has_the_coefficients_of_the_cg(card, model, clean_records):
    """A record of the CG moved to the boom by hand, and back by the card's fixed parameter."""
    clean = clean_records[0]
    wrong = dict(clean.channels)
    wrong["alpha"] = clean["alpha"] - BOOM * clean["q"] / clean["airspeed"]
    wrong["beta"] = clean["beta"] + BOOM * clean["r"] / clean["airspeed"]
    boom = FlightRecord.from_arrays(clean.name, clean.time, wrong)
    stated = Model.of([*card.effects, "vane_position"], {**card.fixed, "vane_position": BOOM})
    at_cg, uncorrected, found = (
        np.asarray(observe([record], card, m).signals["alpha_dot"])
        for record, m in ((clean, model), (boom, model), (boom, stated))
    )
    moved = np.std(uncorrected - at_cg)
    assert moved > 0.1 * np.std(at_cg)
    assert np.std(found - at_cg) < 0.02 * moved
