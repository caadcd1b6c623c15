"""Flow-angle sensors on a boom, hidden in simulated stalls: told from a lag, sized, and moved back by a card."""

import numpy as np
import pytest
import six_axes
from stranger_six import drawn, fly

from bayes_aero.diagnosis.consistency.sensor_errors import screen_sensor_errors
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.simulate.injection import hidden_records

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
    path = tmp_path / "another.toml"
    path.write_text(six_axes.card_text(plane), encoding="utf-8")
    records = []
    for kind in ("aileron", "rudder", "elevator"):
        flight = fly(plane, kind, rng)
        dot = {n: np.gradient(flight[n], flight["time"]) for n in "pqr"}
        flight |= BESIDE[name][1](flight, dot) if name else {}
        records.append(six_axes.record(kind, flight, rng))
    found = screen_sensor_errors(records, read_card(str(path)))
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
