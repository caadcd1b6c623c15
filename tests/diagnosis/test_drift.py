"""Parameters that change in mid-record, by simulators that share no code: which, when and by how much."""

from __future__ import annotations

import numpy as np
import pytest
from gusty_flight import gusty_flight
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, first_order_hold, multistep, record_of

from bayes_aero.flight.card.card import read_card
from bayes_aero.jobs.fly import fly

DT, N = 0.04, 750
NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15}
STEP, AT = -0.01, 35.0  # of Cm0, s


def changing_flight(seed, change):
    """Half a minute of the short period, each sample by the matrix exponential of its own derivatives."""
    u = sum(
        multistep(N, DT, begin, 0.6, size) for begin, size in ((1.0, 0.03), (8.0, -0.03), (15.0, 0.03), (22.0, -0.03))
    )
    x, rows = np.array([0.04, 0.01]), []
    for k in range(N):
        now = SHORT_PERIOD_TRUTH | {name: SHORT_PERIOD_TRUTH[name] + more(DT * k) for name, more in change.items()}
        az = now["az0"] + 90.0 * (now["Zalpha"] * x[0] + now["Zde"] * u[k])
        rows.append([*x, u[k], az])
        A = np.array([[now["Zalpha"], 1.0], [now["Malpha"], now["Mq"]]])
        B = np.array([[now["Zde"], now["Z0"]], [now["Mde"], now["M0"]]])
        ends = np.array([[u[k], 1.0], [u[min(k + 1, N - 1)], 1.0]])
        x = first_order_hold(A, B, x, ends, DT)[1]
    channels = dict(zip(("alpha", "q", "elevator", "az"), np.array(rows).T, strict=True))
    return record_of(channels, noise=NOISE, rng=np.random.default_rng(seed), name="changing")


def flown(seed, drift, **change):
    return fly([changing_flight(seed, change)], card_of(SHORT_PERIOD), drift=drift)


def within_band(drift, name, truth):
    """Share of the samples at which the truth lies within two standard deviations."""
    (history,) = drift.histories
    value, sd, _ = history.values[name]
    return np.mean(np.abs(value - truth(history.time)) < 2.0 * sd)


def test_a_centre_of_gravity_that_moves_aft_is_found_and_nothing_else():
    """Malpha ramps by a fifth within 6 s; Mq, which stays, is asked for as well."""
    ramp = lambda t: 0.4 * np.clip((t - 12.0) / 6.0, 0.0, 1.0)
    found = flown(1, "Malpha, Mq", Malpha=ramp)
    drift = found.process_noise.drift
    assert drift.usable
    assert drift.coloured == ()
    assert drift.changed == ("Malpha",)
    moved = drift.parameters["Malpha"].changes["changing"]
    assert moved.seen
    assert abs(moved.size[0] - 0.4) < 2.5 * moved.size[1]
    assert moved.size[1] < 0.1
    tenth, half, most = moved.times
    assert half == pytest.approx(15.0, abs=1.5)
    assert tenth < half < most
    assert within_band(drift, "Malpha", lambda t: SHORT_PERIOD_TRUTH["Malpha"] + ramp(t)) > 0.85
    said = found.sentences[:2]
    assert said[0].startswith("Malpha changed during the record (p < 1e-12) by 0.")
    assert said[1].startswith("No change of Mq during the record is distinguishable from noise (p = ")


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_where_nothing_drifts_nothing_is_found(seed):
    found = flown(seed, ["Malpha", "M0"])
    drift = found.process_noise.drift
    assert drift.usable
    assert drift.changed == ()
    assert min(p.p for p in drift.parameters.values()) > 0.1
    assert drift.p > 0.1
    estimate, sd = drift.estimates["Malpha"]
    assert abs(estimate - SHORT_PERIOD_TRUTH["Malpha"]) < 3.5 * sd


@pytest.fixture(scope="module")
def gusty():
    """A minute in gusts in which a stuck tab changes the moment by 0.01."""
    record = gusty_flight(5, change={"Cm0": lambda t: STEP * (t > AT)})
    return fly([record], read_card("hfb320"), drift="Cm0", outputs="airspeed,alpha,theta,q,ax,az")


@pytest.mark.verify
def test_a_moment_that_steps_in_gusts_is_found_in_time_and_size(gusty):
    drift = gusty.process_noise.drift
    assert drift.changed == ("Cm0",)
    moved = drift.parameters["Cm0"].changes["gusty"]
    assert abs(moved.size[0] - STEP) < 2.0 * moved.size[1]
    assert moved.size[1] < 0.25 * abs(STEP)
    assert moved.times[1] == pytest.approx(AT, abs=1.0)
    assert gusty.sentences[0].startswith("Cm0 changed during the record (p < 1e-12) by -0.01")


@pytest.mark.verify
def test_its_history_lies_within_its_bands(gusty):
    """Value and change; but for the sample of the step, at which a walk is not there yet."""
    drift = gusty.process_noise.drift
    (history,) = drift.histories
    value, sd, change_sd = history.values["Cm0"]
    truth = 0.139 + STEP * (history.time > AT)
    away = np.abs(history.time - AT) > 0.5
    assert np.all(np.abs(value - truth)[away] < 2.0 * sd[away])
    assert np.mean(np.abs(value - value[0] - (truth - truth[0]))[away] < 2.0 * change_sd[away]) > 0.9
    assert change_sd[0] == pytest.approx(0.0, abs=1e-12)
