"""What differs within a flight: stretches that disagree, and parameters that change."""

from dataclasses import replace

import numpy as np
import pytest
from out_of_catalogue import AT, changed
from scipy import stats
from six_axes import card_text, record
from stranger_six import Plane, drawn, fly

from bayes_aero.diagnosis import search as stages
from bayes_aero.diagnosis.candidate_set import manoeuvres
from bayes_aero.diagnosis.consistency import Blocks, check_sensors, screen_sensor_errors
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import Verdict
from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.screening.selection_state import moved
from bayes_aero.diagnosis.settings import DEFAULT
from bayes_aero.diagnosis.structure.changes import ChangeScan, Span, spans
from bayes_aero.flight.card.card import read_card
from bayes_aero.simulate.injection import draw_hidden, flyable, hidden_records

# Stretches of a flight, and what the coefficients deny
SENSORS = ("alpha_bias", "accel_z_bias", "airspeed_scale", "pitch_rate_bias", "altitude_scale")


@pytest.fixture(scope="module")
def silent():
    return hidden_records({}, seed=413_232, noise="white", seconds=90.0)


def test_stretches_measure_an_error_with_its_uncertainty(card):
    rng = np.random.default_rng(4132)
    seed, name = int(rng.integers(1_000_000)), str(rng.choice(SENSORS))
    truth = draw_hidden(rng, name)
    records = hidden_records({name: truth}, seed=seed, noise="ar1", seconds=90.0)
    found = screen_sensor_errors(records, card, seed=seed)
    assert name in found.causes, (seed, name, truth, found.causes)
    judged = Blocks(found.state, found.fit)
    assert judged.freedom == 2 * round(90.0 / DEFAULT.block) - 1
    step, covariance = judged.judge(name)
    estimate = found.state.theta[found.state.full.columns(list(truth))] + step
    for (parameter, true), x, sd in zip(truth.items(), estimate, np.sqrt(np.diag(covariance)), strict=True):
        assert abs(x - true) < 5.0 * sd + 0.02 * abs(true), (seed, name, truth)
        assert found.sizes[parameter].sd >= 0.999 * sd
    assert judged.p_value(name) < 1e-3


def test_stretches_take_a_wrong_correction_back_and_scatter_by_their_own_estimates(silent, card):
    """A wrong correction moves every stretch by what it is, and the stretches say by how much to take it back."""
    found = screen_sensor_errors(silent, card)
    state, name = found.state, "accel_z_bias"
    theta, wrong = state.theta.copy(), 0.2
    theta[state.full.columns(["accel_z_bias"])] += wrong
    state = moved(state, theta, tuple(dict.fromkeys((*state.active, name))))  # chance may have it in, too small to tell
    (step,), ((variance,),) = Blocks(state, state.fit()).judge(name)
    left = wrong + state.fit().step[list(state.fit().columns).index(state.full.columns(["accel_z_bias"])[0])]
    assert abs(left) < 0.1 * wrong
    assert abs(step) < 5.0 * np.sqrt(variance) + 0.1 * wrong
    # For an effect with equal information in every stretch: the standard error of the mean of estimates.
    judged = Blocks(found.base, found.base_fit)
    name = "pitch_rate_bias"
    step, covariance = judged.judge(name)
    column = found.base.full.columns([name])
    S = judged._centred(found.base.scaled[:, :, column])[:, :, 0] * np.sqrt(judged.weight)
    y = judged.left * np.sqrt(judged.weight)
    own = judged.number[judged.number >= 0]
    parts = [(np.sum(S[own == k] ** 2), np.sum(S[own == k] * y[own == k])) for k in range(judged.freedom + 1)]
    information, right = np.array(parts).T
    mean = right.sum() / information.sum()
    weights = information / information.sum()
    n = len(parts)
    error = np.sqrt(n / (n - 1) * np.sum((weights * (right / information - mean)) ** 2))
    assert step[0] == pytest.approx(mean, rel=1e-9)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(error, rel=1e-9)
    assert stats.variation(information) < 0.5  # near the plain standard error of a mean then
    assert error == pytest.approx(stats.sem(right / information), rel=0.6)


def test_the_coefficients_deny_a_correction_that_harms_them(silent, card, monkeypatch):
    """An airspeed that is right is corrected by 2 m/s: lift over dynamic pressure tells."""

    def wrong(full, responses, theta, **options):
        found = check_sensors(full, responses, theta, **options)
        state, name = found.state, "airspeed_bias"
        theta = state.theta.copy()
        theta[state.full.columns(["airspeed_bias"])] = 2.0
        state = moved(state, theta, tuple(dict.fromkeys((*state.active, name))))
        sizes = {**found.sizes, name: Size(2.0, 0.1, "m/s")}
        return replace(found, state=state, fit=state.fit(), sizes=sizes, causes=(name,))

    monkeypatch.setattr(stages, "check_sensors", wrong)
    found = diagnose(silent, card, gains_wanted=False)
    assert found.verdict is Verdict.NO_EFFECT, [c.name for c in found.causes]
    assert any("airspeed_bias" in note for note in found.notes)


# A parameter that changes during simulated records is found, at its time and of its size; where nothing changes, no
# change is claimed
def test_spans_are_blocks_of_a_manoeuvre_but_those_at_its_ends():
    found = spans(np.repeat([0, 1], [6, 5]), least=2, most=100)
    first = [Span(0, begin, end) for begin in (2, 3, 4) for end in (6, 11)]  # in the first alone, or from then on
    second = [Span(1, begin, 11) for begin in (6, 8, 9)]  # from the second on, or within it
    assert found == [*first, *second]
    found = spans(np.repeat([0, 1, 2], 4), least=2, most=100)
    assert Span(1, 4, 8) in found
    assert Span(1, 4, 12) in found
    begins = {span.begin for span in spans(np.zeros(5000, int), least=30, most=1000)}
    assert len(begins) <= 1000
    assert np.ptp(np.diff(sorted(begins))) == 0


def test_a_change_is_what_least_squares_with_its_column_finds(diagnosed):
    """Against the library's least squares with the column written out; priors are rows of their own."""
    own = diagnosed.view.diagnosis.aerodynamics.state
    state = own.with_components((), (), manoeuvres(own.responses.manoeuvre))
    fit, columns = state.fit(), state.full.columns(["Cm0", "CLaM"])
    over = [Span(0, 100, 200), Span(0, 170, len(state.residual))]
    sound = np.zeros((*state.residual.shape, len(columns)))
    scan, residual = ChangeScan(state, fit, columns, over, sound), state.left(fit)
    assert np.all(scan.noise_shares == 0.0)
    estimates = scan.estimates(residual)
    gains = scan.gains(estimates)
    root = np.sqrt(scan.weight)[:, None]
    free = (state.scaled[:, :, fit.columns] * root).reshape(-1, len(fit.columns))
    left = (residual * root[:, 0]).reshape(-1)
    prior = np.diag(np.sqrt(state.precision[fit.columns]))

    def least_squares(A, rows):
        unit = np.linalg.norm(np.vstack([A, rows]), axis=0)
        found = np.linalg.lstsq(np.vstack([A, rows]) / unit, np.append(left, np.zeros(len(rows))), rcond=None)[0]
        return found / unit, float(np.sum((left - A @ (found / unit)) ** 2) + np.sum((rows @ (found / unit)) ** 2))

    _, without = least_squares(free, prior)
    for i, span in enumerate(over):
        for p, column in enumerate(columns):
            own = np.zeros_like(state.residual)
            own[span.begin : span.end] = state.scaled[span.begin : span.end, :, column]
            A = np.column_stack([free, (own * root[:, 0]).reshape(-1)])
            found, deviance = least_squares(A, np.column_stack([prior, np.zeros(len(prior))]))
            assert estimates[i, p] == pytest.approx(found[-1], rel=1e-3)
            assert gains[i, p] == pytest.approx(without - deviance, rel=1e-3, abs=1e-6)
            told = scan.explained(i, p, float(estimates[i, p]))
            assert np.sum(scan.weight * told * residual) == pytest.approx(gains[i, p], rel=1e-3)


def test_the_share_of_noise_is_that_of_the_normal_equations(diagnosed):
    """Noise over what is left of a column beside all others: the diagonal of the inverse of the information."""
    own = diagnosed.view.diagnosis.aerodynamics.state
    state = own.with_components((), (), manoeuvres(own.responses.manoeuvre))
    fit, columns, span = state.fit(), state.full.columns(["CLaM"]), Span(0, 100, 200)
    noise = 0.1 * np.random.default_rng(1).standard_normal((*state.residual.shape, 1))
    shares = ChangeScan(state, fit, columns, [span], noise).noise_shares[:, 0, 0]
    root = np.sqrt(1.0 / fit.variance)[:, None]
    within = np.zeros((len(state.residual), 1, 1))
    within[span.begin : span.end] = 1.0
    whole = state.scaled[:, :, columns]
    others = fit.columns[fit.columns != columns[0]]
    A = np.concatenate([state.scaled[:, :, others], whole * within, whole * (1.0 - within)], axis=2) * root
    A = A.reshape(-1, A.shape[2])
    information = A.T @ A + np.diag(np.append(state.precision[others], [0.0, 0.0]))
    unit = np.sqrt(np.diag(information))
    told = 1.0 / np.diag(np.linalg.inv(information / np.outer(unit, unit)))[-2:] * unit[-2:] ** 2
    added = [float(np.sum((noise * side * root) ** 2)) for side in (within, 1.0 - within)]
    assert shares == pytest.approx(np.array(added) / told, rel=0.01)


@pytest.mark.recovery
@pytest.mark.parametrize("seed", [9, *(pytest.param(s, marks=pytest.mark.verify) for s in (1, 2, 3))])
def test_a_slope_that_noise_of_the_vane_attenuates_is_no_change(seed, tmp_path):
    """One elevator, one aileron and one rudder manoeuvre: sideslip is noise alone in the first, and Clbe is too small
    there."""
    rng = np.random.default_rng(seed)
    plane = Plane() if seed == 9 else drawn(rng)
    records = [record(k, fly(plane, k, rng, seconds=20.0), rng) for k in ("elevator", "aileron", "rudder")]
    (tmp_path / "plane.toml").write_text(card_text(plane), encoding="utf-8")
    found = diagnose(records, read_card(str(tmp_path / "plane.toml")), seed=seed, gains_wanted=False)
    assert found.verdict is Verdict.NO_EFFECT
    assert not found.changes


# Cm0 as a stuck tab or half a degree of elevator changes it; CLaM at Mach 0.3 as ice that takes 5 % of the lift slope.
HIDDEN = [("Cm0", 0.006, 63, "ar1")]
MORE = [
    ("CLaM", -0.8, 57, "buffet"), ("Cm0", -0.003, 62, "buffet"), ("CLaM", 0.8, 53, "white"),
    ("CLaM", -1.6, 58, "outliers"),
]  # fmt: skip


@pytest.mark.recovery
@pytest.mark.parametrize(
    ("name", "size", "seed", "noise"), [*HIDDEN, *(pytest.param(*x, marks=pytest.mark.verify) for x in MORE)]
)
def test_a_parameter_that_changes_is_found_with_its_time_and_size(name, size, seed, noise, card):
    records = changed(name, size, seed=seed, noise=noise, seconds=90.0)
    found = diagnose(records, card, seed=seed, gains_wanted=False)
    assert found.verdict is Verdict.UNEXPLAINED
    assert not found.causes
    (change,) = found.changes
    assert (change.parameter, change.manoeuvre) == (name, records[1].name)
    assert change.interval[0] <= AT <= change.interval[1]
    assert abs(change.size[0] - size) < 4.0 * change.size[1]
    assert change.after[0] - change.before[0] == pytest.approx(change.size[0])
    assert change.share > found.aerodynamics.state.settings.change_share
    assert change.gain > 3.0


@pytest.mark.recovery
@pytest.mark.parametrize("seed", [62, *(pytest.param(s, marks=pytest.mark.verify) for s in (57, 63))])
def test_in_the_silent_twin_nothing_changes(seed, card):
    found = diagnose(changed(None, 0.0, seed=seed, noise="ar1", seconds=90.0), card, seed=seed, gains_wanted=False)
    assert found.verdict is Verdict.NO_EFFECT
    assert not found.changes


HELD = (("thrust_moment", 42),)
OTHERS = (
    ("alpha_scale", 43), ("pitch_rate_lift", 41), ("separation_lag", 45), ("mass_scale", 46),
    ("stabilizer_trim", 40),
)  # fmt: skip


@pytest.mark.recovery
@pytest.mark.parametrize(("name", "seed"), [*HELD, *(pytest.param(*x, marks=pytest.mark.verify) for x in OTHERS)])
def test_an_effect_of_the_catalogue_is_no_change_of_a_parameter(name, seed, card):
    _, flights = flyable([name], seed=seed, noise="ar1", seconds=90.0)
    found = diagnose([flight.record for flight in flights], card, seed=seed, gains_wanted=False)
    assert [cause.name for cause in found.causes] == [name]
    assert not found.changes
    assert not found.unknown
