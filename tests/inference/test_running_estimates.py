"""Estimates while the record grows: the batch transform at the end, and the published recursive results."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from linear_cards import LATERAL, LATERAL_TRUTH, card_of, lateral_flight, record_of

from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.frequency.running import SPACING, RunningTransform, running_estimates
from bayes_aero.model.joined_channels import join

BOOK = Path(__file__).resolve().parents[3] / "shared" / "book"
BAND, DT = (0.2, 1.5), 0.04
CASES = {
    "TC03": ("attas_roll_yaw", ("fAttasAilRud1.mat", "fAttasAilRud2.mat")),
    "TC11": ("attas_short_period", ("fAttasElv1.mat", "fAttasElv2.mat")),
}
OURS = {"Zal": "Zalpha", "Mal": "Malpha"}
COLUMNS = {"p": 7, "q": 8, "r": 9, "alpha": 13, "beta": 14, "elevator": 22, "aileron_left": 28, "aileron_right": 29,
           "rudder": 30}  # fmt: skip
FREQUENCIES = np.arange(BAND[0], BAND[1] + 1e-9, SPACING)


def flown(*channels, dt=DT):
    card = card_of(LATERAL)
    dynamics = linear_dynamics(card)
    return join([record_of(c, dt, name=f"flight_{k}") for k, c in enumerate(channels)], card, dynamics.inputs), dynamics


def test_the_sums_are_the_batch_transform():
    x = np.random.default_rng(3).standard_normal((1000, 4))
    transform = RunningTransform(FREQUENCIES, DT, 4, ends=False)
    for i, row in enumerate(x):
        transform.add(row, begins=i == 0)
    batch = np.exp(-2j * np.pi * np.outer(FREQUENCIES, np.arange(1000) * DT)) @ x
    np.testing.assert_allclose(transform.signals(), batch, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(transform.derivatives(), 2j * np.pi * FREQUENCIES[:, None] * batch, rtol=1e-10)


def test_the_last_estimates_are_those_of_the_whole_record():
    """Complex least squares on the whole record's transforms, by the formula of the book."""
    channels = lateral_flight(LATERAL_TRUTH, n=500)
    flights, dynamics = flown(channels)
    found = running_estimates(flights, dynamics, BAND, ends=False)
    aileron = 0.5 * (channels["aileron_left"] - channels["aileron_right"])
    x = np.stack([channels["p"], channels["r"], channels["beta"], aileron, channels["rudder"]], axis=1)
    x = x - x[:10].mean(axis=0)
    F = np.exp(-2j * np.pi * np.outer(FREQUENCIES, np.arange(500) * DT)) @ x
    for name, state, use in (("L", 0, [0, 1, 2, 3, 4]), ("N", 1, [0, 1, 2, 4])):
        X, Z = F[:, use], 2j * np.pi * FREQUENCIES * F[:, state]
        expected = np.linalg.solve(np.real(X.conj().T @ X), np.real(X.conj().T @ Z))
        left = Z - X @ expected
        variance = np.sum(np.abs(left) ** 2) / (2 * len(Z) - len(use))
        bound = np.sqrt(variance * np.diag(np.linalg.inv(np.real(X.conj().T @ X))) / (SPACING * 500 * DT))
        own = [f"{name}{x}" for i, x in enumerate(("p", "r", "beta", "da", "dr")) if i in use]
        at = [found.names.index(n) for n in own]
        np.testing.assert_allclose(found.value[-1, at], expected, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(found.sd[-1, at], bound, rtol=1e-8)
    assert found.time[-1] == pytest.approx(20.0)


def test_with_the_ends_of_the_integral_estimates_hold_during_a_manoeuvre():
    """In motion from the first sample to the last, in two manoeuvres that do not join."""
    first, second = lateral_flight(LATERAL_TRUTH, n=700), lateral_flight(LATERAL_TRUTH, n=600, x0=(-0.05, 0.03))
    right, left_out = (running_estimates(*flown(first, second), BAND, ends=ends) for ends in (True, False))
    truth = np.array([LATERAL_TRUTH[name] for name in right.names])
    error, without = (np.abs(one.value / truth - 1.0) for one in (right, left_out))
    late = right.time > 15.0
    assert np.max(error[late]) < 0.02
    assert np.max(without[late]) > 1.0


def test_sampling_times_that_differ_are_refused():
    channels = lateral_flight(LATERAL_TRUTH)
    card = card_of(LATERAL)
    dynamics = linear_dynamics(card)
    records = [record_of(channels, dt, name=f"at {dt:g}") for dt in (0.04, 0.05)]
    with pytest.raises(InputError, match="different sampling times"):
        running_estimates(join(records, card, dynamics.inputs), dynamics, BAND)


@pytest.mark.parametrize("case", CASES)
def test_published_recursive_estimates_are_reproduced(case):
    """The published program runs through both files, counts a line as one residual, and takes the last five."""
    if not (BOOK / "references.json").is_file():
        pytest.skip(f"the data of the book and the published results are not in {BOOK}")
    published = json.loads((BOOK / "references.json").read_text(encoding="utf-8"))["cases"][case]["methods"]["ftr"]
    card, tables = read_card(CASES[case][0]), []
    for name in CASES[case][1]:
        tables += [x for key, x in scipy.io.loadmat(BOOK / name).items() if not key.startswith("_")]
    table = np.deg2rad(np.concatenate(tables))
    channels = {name: table[:, column - 1] for name, column in COLUMNS.items()}
    dynamics = linear_dynamics(card)
    flights = join([FlightRecord.from_arrays(case, DT * np.arange(len(table)), channels)], card, dynamics.inputs)
    for ends, most in ((False, 0.01), (True, 0.3)):
        found = running_estimates(flights, dynamics, BAND, ends=ends)
        assert {OURS.get(name, name) for name in published["parameters"]} == set(found.names)
        for name, theirs in published["parameters"].items():
            i = found.names.index(OURS.get(name, name))
            last, sd = found.value[-5:, i].mean(), found.sd[-5:, i].mean()
            assert abs(last - theirs["estimate"]) < most * theirs["std"], name
            if not ends:  # real parameters: 2 m residuals; theirs m complex ones
                m, terms = len(FREQUENCIES), {"TC03": 5, "TC11": 3}[case]
                assert sd / theirs["std"] == pytest.approx(np.sqrt((m - terms) / (2 * m - terms)), rel=0.015), name
