"""Fits in a band: exact transforms, recovery of known truths, bounds against scatter, and what drift does to them."""

from pathlib import Path

import linear_cards as cards
import numpy as np
import pytest
import scipy.io

from bayes_aero.dynamics.flight import linear_dynamics
from bayes_aero.dynamics.pilot import multisines
from bayes_aero.dynamics.segments import segments
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.frequency import fit_in_band, linear_in_band
from bayes_aero.inference.output_error import fit_cascade
from bayes_aero.model.observations import join
from bayes_aero.residuals.equation_error import (
    LinearFrequencyError,
    LinearFrequencyOutputError,
    lines_in,
    transform_rows,
    without_trend,
)

DT, BAND = 0.04, (0.1, 1.5)
NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15, "p": 0.004, "r": 0.003}
BOOK = Path(__file__).resolve().parents[3] / "shared" / "book"
CASES = {
    "TC03": ("attas_roll_yaw", ("fAttasAilRud1.mat", "fAttasAilRud2.mat")),
    "TC11": ("attas_short_period", ("fAttasElv1.mat", "fAttasElv2.mat")),
}
OURS = {"Zal": "Zalpha", "Mal": "Malpha"}
UNSTABLE = cards.SHORT_PERIOD_TRUTH | {"Malpha": 2.0, "Mq": -1.0}  # eigenvalues +0.46 and -2.36 1/s


def flown_of(text, *channels, seed=None, dt=DT):
    card = cards.card_of(text)
    rng = None if seed is None else np.random.default_rng(seed)
    records = [cards.record_of(c, dt, NOISE, rng, name=f"flight_{k}") for k, c in enumerate(channels)]
    dynamics = linear_dynamics(card, tuple(record.n for record in records))
    return join(records, card, dynamics.inputs), dynamics


def output_error(flights, dynamics, truth, band=BAND):
    """Output error in the band, from starts a fifth off the truth."""
    start = np.array([0.8 * truth[p.name] for p in dynamics.free])
    return fit_in_band(LinearFrequencyOutputError.in_band(flights, dynamics, band), dynamics.free, start, band)


def z_scores(found, truth, sd):
    return {n: (x - truth[n]) / s for n, x, s in zip(found.names, found.estimate, sd, strict=True)}


def test_rows_keep_white_noise_and_lose_straight_lines_and_a_sine_is_one_line():
    n = 500
    plain = transform_rows(lines_in(BAND, n, DT, "it"), n, DT)
    rows = without_trend(plain)
    np.testing.assert_allclose(rows @ np.array([np.ones(n), np.arange(n)]).T, 0.0, atol=1e-10)
    np.testing.assert_allclose(plain @ plain.T, np.eye(len(plain)), atol=1e-12)
    np.testing.assert_allclose(np.diag(rows @ rows.T), 1.0, rtol=1e-12)
    # sin(w t) over whole periods: -j sqrt(n/2) at w, nothing elsewhere.
    n, lines = 500, lines_in(BAND, 500, DT, "it")
    found = transform_rows(lines, n, DT) @ np.sin(2.0 * np.pi * 0.5 * np.arange(n) * DT)
    expected = np.zeros(2 * len(lines))
    expected[len(lines) + int(np.argmin(np.abs(lines - 0.5)))] = -np.sqrt(n / 2.0)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("truth", [cards.SHORT_PERIOD_TRUTH, UNSTABLE], ids=["stable", "unstable"])
def test_fits_in_a_band_are_exact_without_noise(truth):
    """Inputs linear between samples, a start out of trim, an end in motion, an eigenvalue to the right of zero."""
    channels = cards.short_period_flight(truth), cards.short_period_flight(truth, n=400, x0=(0.0, -0.02))
    flown = flown_of(cards.SHORT_PERIOD, *channels)
    fits = [(output_error(*flown, truth), 1e-6)]
    if truth is not UNSTABLE:  # the filter of equation error rings at edges of the input
        fits.append((linear_in_band(*flown, BAND)[0][0], 0.01))
    for fit, rel in fits:
        assert fit.converged
        assert set(fit.unseen) == {"Z0", "M0", "az0"}
        assert fit.estimate == pytest.approx([truth[name] for name in fit.names], rel=rel)


def test_a_delay_of_an_output_is_found():
    """az is recorded two samples late; in the band a delay is a phase."""
    channels = cards.short_period_flight(cards.SHORT_PERIOD_TRUTH, n=700, x0=(0.0245, 0.0217))
    late = {name: x[2:] if name != "az" else x[:-2] for name, x in channels.items()}
    text = cards.SHORT_PERIOD.replace("[linear.fixed]", '[linear.delays]\naz = "lag"\n[linear.fixed]')
    flights, dynamics = flown_of(text, late)
    found = output_error(flights, dynamics, cards.SHORT_PERIOD_TRUTH | {"lag": 0.05})
    assert found.estimate[found.names.index("lag")] == pytest.approx(2 * DT, abs=0.002)


def test_bounds_are_the_scatter_of_output_error():
    """White noise on the outputs, 40 flights: squared scores are chi-squared. The published bound would give half."""
    scores, corrected = [], []
    for seed in range(40):
        flights, dynamics = flown_of(cards.LATERAL, cards.lateral_flight(cards.LATERAL_TRUTH), seed=[7, seed])
        found = output_error(flights, dynamics, cards.LATERAL_TRUTH)
        scores.append(list(z_scores(found, cards.LATERAL_TRUTH, found.crb).values()))
        corrected.append(found.crb_corrected / found.crb)
    mean = float(np.mean(np.square(scores), axis=0).mean())
    assert 0.75 < mean < 1.35  # of 40 flights and 9 correlated parameters: standard deviation below 0.1
    assert 0.95 < float(np.median(corrected)) < 1.4


@pytest.fixture(scope="module")
def drifting():
    """A multisine flight of an exact short period with noise, and the same with biases and drifts of the sensors."""
    n = 1250
    time = np.arange(n) * DT
    u = 0.03 * multisines(time, 25.0, (0.1, 1.4), 1)[0]
    k = cards.SHORT_PERIOD_TRUTH
    A, B = cards.short_period_matrices(k)
    trim = np.linalg.solve(-A, B @ [0.0, 1.0])
    x = cards.first_order_hold(A, B, trim, np.stack([u, np.ones(n)], axis=1), DT)
    az = k["az0"] + 90.0 * (k["Zalpha"] * x[:, 0] + k["Zde"] * u)
    true = {"alpha": x[:, 0], "q": x[:, 1], "elevator": u, "az": az}
    late = time / time[-1]
    errors = {"alpha": 0.01 + 0.03 * late, "q": 0.005 - 0.02 * late, "az": 0.5 + 2.0 * late, "elevator": 0.01}
    return true, {name: x + errors[name] for name, x in true.items()}


def both_domains(channels):
    flights, dynamics = flown_of(cards.SHORT_PERIOD, channels, seed=11)
    fits, responses = linear_in_band(flights, dynamics, BAND)
    stages = [segments(flights, dynamics, window=window) for window in (5.0, None)]
    return fit_cascade(stages, [np.zeros(len(dynamics.free))], prior_weight=0.0), fits, responses


def test_drift_moves_the_time_domain_and_not_the_band_whose_responses_are_the_transfer_function(drifting):
    """Zalpha is a sixth off in the time domain, with a standard error that is twenty times that in the band."""
    fit, in_band, _ = both_domains(drifting[1])
    i, second = fit.names.index("Zalpha"), in_band[1]
    assert abs(fit.estimate[i] - cards.SHORT_PERIOD_TRUTH["Zalpha"]) > max(4.0 * fit.crb[i], 0.1)
    assert fit.sd_corrected[i] > 10.0 * second.crb_corrected[second.names.index("Zalpha")]
    assert max(map(abs, z_scores(second, cards.SHORT_PERIOD_TRUTH, second.crb_corrected).values())) < 4.0
    assert second.unseen == ("Z0", "M0", "az0")
    assert {*second.names, *second.unseen} == set(cards.SHORT_PERIOD_TRUTH)
    fit, calm, responses = both_domains(drifting[0])
    for one, other in zip(in_band, calm, strict=True):
        assert np.all(np.abs(one.estimate - other.estimate) < 0.03 * one.crb)  # the noise is the same
    assert all(second.crb[second.names.index(n)] < 1.3 * fit.crb[fit.names.index(n)] for n in second.names)
    assert {(r.input, r.output) for r in responses} == {("elevator", n) for n in ("alpha", "q", "az")}
    pitch = next(r for r in responses if r.output == "q")
    k, s = cards.SHORT_PERIOD_TRUTH, 2j * np.pi * pitch.frequency
    numerator = k["Mde"] * s + k["Malpha"] * k["Zde"] - k["Mde"] * k["Zalpha"]
    exact = numerator / (s**2 - (k["Zalpha"] + k["Mq"]) * s + k["Zalpha"] * k["Mq"] - k["Malpha"])
    np.testing.assert_allclose(pitch.modelled, exact, rtol=0.1)
    assert np.all(np.abs(pitch.modelled - exact) < 5.0 * np.std(pitch.draws, axis=0))
    assert np.all(np.abs(pitch.measured - exact) < 5.0 * pitch.error + 0.05 * np.abs(exact))
    assert np.median(pitch.coherence) > 0.9


def test_both_ailerons_are_one_input():
    flights, dynamics = flown_of(cards.LATERAL, cards.lateral_flight(cards.LATERAL_TRUTH), seed=13)
    *_, responses = linear_in_band(flights, dynamics, BAND)
    assert {r.input for r in responses} == {"aileron_left and aileron_right", "beta", "rudder"}
    roll = next(r for r in responses if (r.output, r.input[:7]) == ("p", "aileron"))
    k, s = cards.LATERAL_TRUTH, 2j * np.pi * roll.frequency  # yaw: r = (Np p + Nda da) / (s - Nr)
    lag = k["Lr"] / (s - k["Nr"])
    np.testing.assert_allclose(roll.modelled, (k["Lda"] + lag * k["Nda"]) / (s - k["Lp"] - lag * k["Np"]), rtol=0.1)


@pytest.mark.parametrize(("band", "said"), [
    ((0.0, 1.0), "the band 0 to 1 Hz is empty"), ((0.101, 0.12), "its lines are 0.05 Hz apart"),
    ((0.1, 12.5), "shows frequencies below"), ((1.0, 0.5), "1 to 0.5 Hz"),
])  # fmt: skip
def test_a_band_without_lines_is_refused(band, said):
    with pytest.raises(InputError, match=said):
        lines_in(band, 500, DT, "it")


def test_records_that_do_not_go_together_or_lack_a_state_are_refused():
    card, channels = cards.card_of(cards.LATERAL), cards.lateral_flight(cards.LATERAL_TRUTH)
    records = [cards.record_of(channels, dt, name=f"at {dt:g}") for dt in (0.04, 0.05)]
    dynamics = linear_dynamics(card, tuple(record.n for record in records))
    with pytest.raises(InputError, match="different sampling times"):
        linear_in_band(join(records, card, dynamics.inputs), dynamics, BAND)
    channels = cards.short_period_flight(cards.SHORT_PERIOD_TRUTH)
    card = cards.card_of(cards.SHORT_PERIOD.replace('"alpha", unit', '"alpha", required = false, unit'))
    record = cards.record_of({name: x for name, x in channels.items() if name != "alpha"})
    dynamics = linear_dynamics(card)
    with pytest.raises(InputError, match="alpha was not recorded"):
        LinearFrequencyError.in_band(join([record], card, ("elevator",)), dynamics, BAND)


@pytest.mark.parametrize("case", CASES)
def test_published_fourier_transform_regression(case, book):
    """Within two published standard deviations: the published lines are 0.04 Hz apart, of both manoeuvres in a row, and
    a complex residual counts as one."""
    published = book[case]["methods"]["ftr"]
    card, records = read_card(CASES[case][0]), []
    for name in CASES[case][1]:
        (table,) = (np.deg2rad(x) for key, x in scipy.io.loadmat(BOOK / name).items() if not key.startswith("_"))
        channels = {c.name: table[:, c.column - 1] for c in card.channels if c.name != "time"}
        records.append(FlightRecord.from_arrays(name, DT * np.arange(len(table)), channels))
    dynamics = linear_dynamics(card)
    flights, band = join(records, card, dynamics.inputs), (0.2, 1.5)
    start = np.array([p.start for p in dynamics.free])
    found = fit_in_band(LinearFrequencyError.in_band(flights, dynamics, band), dynamics.free, start, band)
    for name, theirs in published["parameters"].items():
        i = found.names.index(OURS.get(name, name))
        assert abs(found.estimate[i] - theirs["estimate"]) < 2.0 * theirs["std"], name
