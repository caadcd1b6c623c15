"""Whole diagnoses of simulated flights: what was hidden is named, what changed is found, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import six_axes
from out_of_catalogue import AT, CHANGES, UNKNOWN
from parts import few_candidates, without_accelerometers
from scipy import stats
from scipy.signal import lfilter
from stranger import HIDDEN, Recorder, flown
from stranger_six import Fighter, Plane, drawn, fly

from bayes_aero.diagnosis import search as stages
from bayes_aero.diagnosis.components import ChangeScan, Span, spans
from bayes_aero.diagnosis.consistency import Blocks, check_sensors, screen_sensor_errors
from bayes_aero.diagnosis.diagnose import band_of, causes_in_band, diagnose, rivals_of, with_sensor_errors_held
from bayes_aero.diagnosis.result import COEFFICIENTS, TRAJECTORIES, Size, Verdict
from bayes_aero.diagnosis.search import search_in_stages
from bayes_aero.diagnosis.selection import integrated_deviance, noise_shares
from bayes_aero.diagnosis.selection_state import (
    DEFAULT,
    DiagnosisSettings,
    Products,
    candidate_model,
    manoeuvres,
    moved,
)
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import read_card
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import fit_mle
from bayes_aero.model.model import Model
from bayes_aero.model.observations import despiked, join, observe
from bayes_aero.physics.aircraft import required_of
from bayes_aero.progress import quiet
from bayes_aero.report.pages.diagnosis import in_band_sentences
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import Request
from bayes_aero.simulate.injection import Beyond, flyable, hidden_flights, hidden_records, synthetic

# Hide effects, or nothing, in simulated flights and diagnose them; every effect is in test_candidates.py, and the full
# study in benchmarks
QUICK = DiagnosisSettings(gains=False)
ALONE = DiagnosisSettings(gains=False, process_noise=False)


def verify(*rows):
    return [pytest.param(*row, marks=pytest.mark.verify) for row in rows]


@pytest.fixture(scope="module")
def named(card):
    """An error of a sensor and a moment in two flights, and their diagnosis."""
    hidden = {"accel_x_bias": {"accel_x_bias": 0.12}, "alpha_dot_moment": {"Cmadot": -8.0}}
    records = hidden_records(hidden, seed=4101, noise="ar1", seconds=90.0)
    return hidden, diagnose(records, card, seed=4101, settings=QUICK)


def all_named(hidden, found):
    """These are the causes, with their sizes; no parameter changes."""
    assert {c.name for c in found.causes} == set(hidden)
    assert not found.changes
    assert not found.unknown
    for cause in found.causes:
        for parameter, true in hidden[cause.name].items():
            size = cause.parameters[parameter]
            # Five deviations, and a twentieth of the size: recorded regressors carry noise.
            assert abs(size.mean - true) < 5 * size.sd + 0.05 * abs(true), parameter


@pytest.mark.recovery
def test_hidden_effects_are_named_with_their_sizes_and_no_parameter_changes(named):
    all_named(*named)


@pytest.mark.verify
@pytest.mark.parametrize(("name", "seed"), [
    ("accel_x_bias", 4101), ("thrust_moment", 42), ("alpha_scale", 43), ("pitch_rate_lift", 41), ("separation_lag", 45),
    ("mass_scale", 46),
])  # fmt: skip
def test_a_hidden_effect_is_named_alone(name, seed, card):
    hidden, flights = flyable([name], seed=seed, noise="ar1", seconds=90.0)
    all_named(hidden, diagnose([flight.record for flight in flights], card, seed=seed, settings=QUICK))


def test_the_band_is_that_of_the_motion_and_gives_the_size_that_was_hidden(named):
    """A size that differs from it, as a slow model error would leave it, is apart; errors of sensors keep theirs."""
    hidden, found = named
    shown, true = causes_in_band(found), hidden["alpha_dot_moment"]["Cmadot"]
    (size,) = shown.sizes
    mean, sd = size.in_band
    assert size.cause == "alpha_dot_moment"
    assert abs(mean - true) < 3.0 * sd
    assert sd < 0.1 * abs(true)
    assert size.apart < 3.0
    assert "agree: alpha_dot_moment" in in_band_sentences(shown)[0]
    assert in_band_sentences(None) == ()
    # From two periods of the shorter manoeuvre; nearly all power of the pitch rate is inside.
    state = found.aerodynamics.state
    flights = state.responses.flights
    assert shown.band == band_of(flights)
    assert shown.band[0] == pytest.approx(2.0 / 90.04, rel=1e-3)
    q = np.asarray(flights.channels["q"])[: flights.lengths[0]]
    frequency, power = np.fft.rfftfreq(len(q), 0.04), np.abs(np.fft.rfft(q - q.mean())) ** 2
    assert power[frequency <= shown.band[1]].sum() > 0.95 * power.sum()
    cause = next(c for c in found.causes if c.name == size.cause)
    whole = cause.parameters["Cmadot"]
    off = replace(cause, parameters={"Cmadot": replace(whole, mean=whole.mean + 6.0 * whole.sd)})
    moved_away = causes_in_band(replace(found, causes=(off,)))
    assert moved_away.sizes[0].apart > 3.0
    assert "a drift or a slow model error has a part in it" in in_band_sentences(moved_away)[0]
    assert causes_in_band(replace(found, causes=())) is None
    # It is no candidate of the coefficients, and the model in the band has it all the same.
    theta = state.theta.copy()
    theta[state.full.columns(["accel_z_bias"])] = 0.3
    model, start = with_sensor_errors_held(replace(state, theta=theta))
    assert model.values(start)["accel_z_bias"] == 0.3
    assert "accel_z_bias" not in model.names
    assert set(model.names) == {p for n in (*state.full.base, *state.active) for p in state.full.parameters_of(n)}


# In the buffet of the second one a wave of 15 s takes a fifth of what is left of the lift.
@pytest.mark.recovery
@pytest.mark.parametrize(("seed", "noise"), [
    (4202, "ar1"), *verify((141128, "buffet"), (4201, "white"), (4203, "buffet"), (4204, "outliers")),
])  # fmt: skip
def test_nothing_is_found_where_nothing_is_hidden(seed, noise, card):
    found = diagnose(hidden_records({}, seed=seed, noise=noise, seconds=90.0), card, seed=seed, settings=QUICK)
    assert found.verdict is Verdict.NO_EFFECT, [c.name for c in found.causes]
    assert not found.changes
    assert "spoiler_lift" in found.not_testable
    if noise != "outliers":
        assert ("colored" in found.noise.labels) is (noise != "white"), found.noise.lag1


def test_white_noise_is_not_called_coloured(diagnosed):
    noise = diagnosed.view.diagnosis.noise
    assert "colored" not in noise.labels, noise.lag1


# What no effect of the catalogue makes: a wave in time, or a parameter that changes in the second flight
WAVE = {"unknown_CL_wave": 0.05, "unknown_period": 6.0}
SLOSH = {"unknown_Cm_wave": 0.008, "unknown_period": 3.9}  # as fuel makes it: near the short period of the aircraft


@pytest.mark.recovery
@pytest.mark.parametrize(("wave", "name", "size", "seed", "noise"), [
    (WAVE, "Cm0", 0.006, 63, "ar1"),
    (SLOSH, None, 0.0, 110, "buffet"),  # once called alpha_dot_moment
    *verify(
        (WAVE, None, 0.0, 4302, "ar1"), ({}, "CLaM", -0.8, 57, "buffet"), ({}, "Cm0", -0.003, 62, "buffet"),
        ({}, "CLaM", 0.8, 53, "white"), ({}, "CLaM", -1.6, 58, "outliers"),
    ),
])  # fmt: skip
def test_a_wave_has_its_period_and_a_parameter_that_changes_its_time_and_size(wave, name, size, seed, noise, card):
    """Cm0 as a stuck tab or half a degree of elevator changes it; CLaM at Mach 0.3 as ice takes 5 % of the lift."""

    def flights(change):
        beyond = Beyond((*UNKNOWN, *CHANGES), lambda _: wave | change)
        return hidden_records({}, seed=seed, noise=noise, seconds=90.0, beyond=beyond)

    records = [flights({})[0], flights({f"change_{name}": size} if name else {})[1]]
    found = diagnose(records, card, seed=seed, settings=QUICK)
    assert found.verdict is Verdict.UNEXPLAINED
    assert not found.causes
    waves = [u for u in found.unknown if u.channel.startswith("time, period")]
    assert bool(waves) is bool(wave)
    if waves:
        period = float(max(waves, key=lambda u: u.share).channel.split()[2])
        assert period == pytest.approx(wave["unknown_period"], rel=0.03)
    assert [(change.parameter, change.manoeuvre) for change in found.changes] == [(name, records[1].name)] * bool(name)
    for change in found.changes:
        assert change.interval[0] <= AT <= change.interval[1]
        assert abs(change.size[0] - size) < 4.0 * change.size[1]
        assert change.after[0] - change.before[0] == pytest.approx(change.size[0])
        assert change.share > DEFAULT.change_share
        assert change.gain > 3.0


# Records of aircraft that nobody here has seen, from a simulator of their own: the hidden effect, and nothing else
DRAWN = np.random.default_rng(20261).integers(1_000_000, size=2)


def strangers():
    """Seed, hidden effect, gusts, recorder, and by how many standard errors the size may be off."""
    poor, windy = np.random.default_rng(20264), np.random.default_rng(20262)
    seeds, name = poor.integers(1_000_000, size=2), str(poor.choice(["pitch_rate_bias", "thrust_moment", "alpha_bias"]))
    usual, drawn = Recorder(), str(np.random.default_rng(DRAWN[0]).choice(list(HIDDEN)))
    return [(DRAWN[0], drawn, 0.0, usual, 3.0), *verify(
        (DRAWN[1], None, 0.0, usual, 0.0),
        # Noise correlated from sample to sample, a filter of a few hertz, coarse digits: on all channels alike.
        (seeds[0], None, 0.0, Recorder.poor(poor), 0.0), (seeds[1], name, 0.0, Recorder.poor(poor), np.inf),
        # A CG moved aft adds lift to the moment, and takes the vane's noise out of it where it was in both.
        (0, "separated_alpha_moment", 0.0, usual, 3.0), (0, "alpha_squared_moment", 0.0, usual, 3.0),
        # Gusts are in vane and airspeed, and what integrates them wanders off like an offset. Their mean is a wind.
        (windy.integers(1_000_000), None, windy.uniform(0.3, 0.7), usual, 0.0),
        # Of vane and wind the flight path makes nearly one; the coefficients feel the vane and not the wind.
        (20263, "alpha_bias", 0.4, usual, 4.0),
    )]  # fmt: skip


@pytest.mark.recovery
@pytest.mark.parametrize(("seed", "name", "gusts", "recorder", "errors"), strangers())
def test_what_a_stranger_hides_is_named_with_its_size_and_nothing_else(tmp_path, seed, name, gusts, recorder, errors):
    """A random aircraft's two records, read from CSV and diagnosed."""
    p, size, files = flown(tmp_path, np.random.default_rng(seed), name, gusts, recorder)
    card = read_card(str(tmp_path / "card.toml"))
    found = diagnose([read_record(path, card.channels) for path in files], card, seed=int(seed), settings=QUICK)
    if name is None:
        assert not found.unknown
        assert {cause.name for cause in found.causes} <= ({"vertical_wind"} if gusts else set())
        assert gusts or found.verdict is Verdict.NO_EFFECT
        return
    (cause,) = found.causes
    assert cause.name == name
    estimate = cause.parameters[HIDDEN[name][0]]
    assert abs(estimate.mean - size) < errors * estimate.sd
    if seed == DRAWN[0]:
        assert found.verdict is Verdict.EXPLAINED
        own = {"Cma": p.Cma, "Cmq": p.Cmq / 2.0, "Cmde": p.Cmde, "CLa": p.CLa, "e": p.e, "CDX": p.CDX}
        assert {n: found.base_moves[n][1] for n in own} == pytest.approx(own, rel=0.03)


# A linear model flown into the stall: diagnosis finds the separation of the flow and what depends on it
LINEAR = (
    "attached_lift", "mach_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag",
)  # fmt: skip
STALL = {"flow_separation", "reattachment_hysteresis", "separated_moment", "separated_drag"}


@pytest.mark.verify
def test_a_linear_model_is_extended_to_the_stall_that_was_flown(card):
    seed = int(np.random.default_rng(611).integers(1_000_000))
    flights = hidden_flights({}, seed=seed, noise="ar1", seconds=90.0)
    records, truth = [flight.record for flight in flights], flights[0].values
    found = diagnose(records, card, model=Model.of(LINEAR), seed=seed, settings=QUICK)
    assert {cause.name for cause in found.causes} == STALL
    assert found.causes[0].name == "flow_separation"
    for cause in found.causes:
        for name, size in cause.parameters.items():
            assert size.mean == pytest.approx(truth[name], rel=0.15), name
    assert not found.unknown


SUSPECTS = (
    "flow_separation", "kirchhoff_lift", "separated_drag", "drag_offset", "alpha_squared_moment", "pitch_rate_lift",
    "alpha_dot_lift", "elevator_drag", "mass_scale", "cg_shift", "thrust_scale", "alpha_bias", "accel_z_bias",
    "flap_lift", "flap_moment", "rudder_moment",
)  # fmt: skip


@pytest.mark.recovery
@pytest.mark.parametrize(("felt", "candidates"), [(True, SUSPECTS), *verify((True, CATALOGUE), (False, CATALOGUE))])
def test_a_wrong_form_of_the_coefficients_is_no_stall_and_no_camber(tmp_path, monkeypatch, felt, candidates):
    """A fighter of polynomials, by a simulator that shares no code, from 2 to 24 deg: what is found are forms.

    With the linear card `drag_offset` and `flow_separation` explain most of what is left, and CL differs between
    manoeuvres, whose angles of attack do. None of that is there. CZq is -30 per q c/2V: lift by pitch rate is 15 qhat.
    Where accelerations were not `felt`, forms are sought to first order, so few of them are sure.
    """
    few_candidates(monkeypatch, candidates)
    rng, plane, speeds = np.random.default_rng([1, 54]), Fighter(), np.repeat([190.0, 120.0, 90.0, 75.0], 2)
    flights = [fly(plane, "elevator", rng, seconds=10.0, V=float(V)) for V in speeds]
    records = [six_axes.record(f"m{k}", flight, rng) for k, flight in enumerate(flights)]
    card = six_axes.card_in(tmp_path, plane, six_axes.LONGITUDINAL, ("longitudinal",))
    found = diagnose(records if felt else [*map(without_accelerometers, records)], card, seed=1, settings=ALONE)
    assert found.compared == (COEFFICIENTS if felt else TRAJECTORIES)
    assert not found.causes
    assert {term.coefficient for term in found.terms} == {"CL", "CD", "Cm"}
    assert "alpha" in next(t for t in found.terms if t.coefficient == "CL").term.channels
    if felt:
        assert not any(structure.offsets for structure in found.unknown)
        assert {c for t in found.terms for c in t.term.channels} <= {"alpha", "q", "airspeed", "elevator"}
        ((mean, sd),) = [t.size for t in found.terms if (t.coefficient, t.term.name) == ("CL", "qhat")]
        assert abs(mean - 15.0) < 4.0 * sd


def test_the_gain_is_the_bayes_factor_under_the_other_fold_s_posterior():
    """One addition, no parameter of the card: each fold's evidence with the normal prior that the other fold gives.

    Twice the log of a normal evidence, with the variance of each fold's residuals: squares at the joint estimate, and
    the log of how many times the fold narrows its prior.
    """
    rng, n = np.random.default_rng(2), 4000
    x = rng.standard_normal(2 * n)
    y = 0.2 * x + rng.standard_normal(2 * n)
    folds = (slice(0, n), slice(n, 2 * n))
    products = Products.of(y[:, None], np.stack([x, np.zeros_like(x)], axis=1)[:, None, :], folds)
    prior, nothing = (np.zeros(2), np.array([1e-9, 1.0])), np.array([1])
    expected = 0.0
    for own, other in ((folds[0], folds[1]), (folds[1], folds[0])):
        told = x[other] @ x[other] / np.var(y[other] - 0.2 * x[other])
        mean = x[other] @ y[other] / (x[other] @ x[other])
        S = x[own] @ x[own]
        variance = np.mean((y[own] - 0.2 * x[own]) ** 2)
        estimate = (S / variance * (x[own] @ y[own] / S) + told * mean) / (S / variance + told)
        left = np.sum((y[own] - estimate * x[own]) ** 2) / variance + told * (estimate - mean) ** 2
        before = n * np.log(np.mean(y[own] ** 2))
        after = n * np.log(variance) + (left - n) + np.log((S / variance + told) / told)
        expected += before - after
    found = 0.0
    for fold in (0, 1):
        with_it = integrated_deviance(products, prior, 1.0, fold, np.array([0, 1]), nothing)
        found += integrated_deviance(products, prior, 1.0, fold, nothing, nothing) - with_it
    assert found == pytest.approx(expected, rel=0.02)


@pytest.mark.recovery
def test_what_is_set_between_manoeuvres_is_an_offset_and_no_cause(tmp_path, monkeypatch):
    """Three manoeuvres of 8 s of another simulator whose constants differ, as the recorded flap and rudder trim do."""
    few_candidates(monkeypatch, SUSPECTS)
    rng, usual, planes, records = np.random.default_rng([2, 53]), Plane(**six_axes.ATTACHED), [], []
    for k in range(3):
        constants = {"CL0": 0.03, "CD0": 0.004, "Cm0": 0.01}
        planes.append(replace(usual, **{n: getattr(usual, n) + rng.normal(0.0, sd) for n, sd in constants.items()}))
        record = six_axes.record(f"m{k}", fly(planes[-1], "elevator", rng, dt=0.02, seconds=8.0), rng)
        rudder = record.channels["rudder"] + np.radians(rng.uniform(-3.0, 3.0))
        flap = np.full(record.n, np.radians(rng.uniform(0.0, 5.0)))
        records.append(replace(record, channels={**record.channels, "rudder": rudder, "flap": flap}))
    card = six_axes.card_in(tmp_path, usual, six_axes.LONGITUDINAL, ("longitudinal",))
    found = diagnose(records, card, seed=1, settings=ALONE)
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.causes == found.terms == found.changes == ()
    offsets = {u.coefficient: u.offsets for u in found.unknown if u.channel == "manoeuvre"}
    assert set(offsets) == {"CL", "CD", "Cm"}
    assert len(found.unknown) == 3
    for name in ("CL", "Cm"):  # the drag due to lift is in CD
        for plane, (mean, sd) in zip(planes[1:], offsets[name].values(), strict=True):
            assert abs(mean - getattr(plane, f"{name}0") + getattr(planes[0], f"{name}0")) < 4.0 * sd, name
    assert {"flap_lift", "flap_moment", "rudder_moment"} <= set(found.not_testable)
    assert found.not_testable["flap_lift"] == "channel flap differs only between manoeuvres, as an offset does"


# Slow noise of every sensor and surface, in flights of a simulator that shares no code: it names nothing
NOISE = six_axes.NOISE | dict.fromkeys(("elevator", "aileron", "rudder"), 1e-3)
SLOW, DT = 0.15, 0.02  # s


def searched(tmp_path, seed, times, left_out=None, scale=1.0):
    """Causes of three flights of 26 s at 50 Hz, half of the noise's variance with a time constant of .15 s; `times` as
    large as usual, with an effect that the card lacks or a lateral accelerometer of another `scale`."""
    rng = np.random.default_rng([seed, 17])
    plane, keep = drawn(rng, **six_axes.ATTACHED), np.exp(-DT / SLOW)
    effects = [e for e in (*six_axes.LONGITUDINAL, *six_axes.LATERAL) if e != left_out]
    card, records = six_axes.card_in(tmp_path, plane, effects), []
    for kind in ("elevator", "aileron", "rudder"):
        flight = fly(plane, kind, rng, dt=DT, seconds=26.0)
        flight["ay"] = scale * flight["ay"]
        shown = {}
        for name in six_axes.RECORDED:
            white, shock = rng.standard_normal((2, len(flight["time"])))
            slow = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], shock)
            shown[name] = flight[name] + times * NOISE.get(name, 0.0) * np.sqrt(0.5) * (white + slow)
        shown["thrust"] = shown["thrust_left"] + shown["thrust_right"]
        records.append(FlightRecord.from_arrays(kind, flight["time"], shown, "simulated"))
    return in_stages(records, card)


def in_stages(records, card):
    """What the flight path and the coefficients find, and what these deny."""
    model = Model.from_card(card)
    flights, _ = despiked(join(records, card, required_of(model.axes)))
    full, fit = candidate_model(model, flights), fit_mle(model, observe(records, card, model), seed=0)
    theta = full.vector(dict(zip(fit.names, fit.estimate, strict=True)))
    return search_in_stages(full, EquationError.of(flights, full.model), theta, seed=0, progress=quiet)[:3]


@pytest.mark.verify
@pytest.mark.parametrize(("seed", "times", "left_out", "scale", "causes"), [
    (1, 3.0, None, 1.0, ()), (2, 3.0, None, 1.0, ()), (3, 1.0, "rudder_side_force", 1.0, ("rudder_side_force",)),
    (1, 1.0, None, 0.85, ("accel_y_scale",)), (3, 1.0, None, 0.85, ("accel_y_scale",)),
])  # fmt: skip
def test_noise_of_the_regressors_is_no_error_of_a_sensor(tmp_path, seed, times, left_out, scale, causes):
    """r_dot, which is recorded well, then tells more of sideslip and rudder than their own channels: a lateral
    accelerometer 2 to 3 m away, were it believed. With the usual noise the missing effect is named."""
    sensors, aerodynamics, _ = searched(tmp_path, seed, times, left_out, scale)
    assert aerodynamics.causes == causes
    if scale == 1.0:
        assert sensors is not None
        assert sensors.causes == ()
    else:
        size = aerodynamics.sizes["accel_y_scale"]
        assert abs(size.mean + 0.15) < 1.96 * size.sd


@pytest.mark.verify
@pytest.mark.parametrize("seed", [1, 3])
def test_what_outdoes_its_rival_by_less_noise_alone_is_not_named_alone(tmp_path, seed):
    """With three times the noise an accelerometer 2 m away explains more than the missing effect of the rudder."""
    found = searched(tmp_path, seed, 3.0, "rudder_side_force")[1]
    noise = noise_shares(found.state)
    for name in found.causes:
        assert "rudder_side_force" in (name, *rivals_of(found, name, noise=noise[name])[1])


# Stretches of a flight, and what the coefficients deny


@pytest.fixture(scope="module")
def silent():
    return hidden_records({}, seed=413_232, noise="white", seconds=90.0)


def test_stretches_take_a_wrong_correction_back_and_scatter_by_their_own_estimates(silent, card):
    """A wrong correction moves every stretch by what it is, and the stretches say by how much to take it back."""
    found = screen_sensor_errors(silent, card)
    state, name = found.state, "accel_z_bias"
    theta, wrong = state.theta.copy(), 0.2
    theta[state.full.columns(["accel_z_bias"])] += wrong
    state = moved(state, theta, tuple(dict.fromkeys((*state.active, name))))  # chance may have it in, too small to tell
    (step,), ((variance,),) = Blocks(state).judge(name)
    left = wrong + state.fit().step[list(state.fit().columns).index(state.full.columns(["accel_z_bias"])[0])]
    assert abs(left) < 0.1 * wrong
    assert abs(step) < 5.0 * np.sqrt(variance) + 0.1 * wrong
    # For an effect with equal information in every stretch: the standard error of the mean of estimates.
    judged = Blocks(found.base)
    assert judged.freedom == 2 * round(90.0 / DEFAULT.block) - 1
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
    # Candidates that are not in are no surer than the stretches let them be, either.
    judged = Blocks(found.state)
    ratios = [
        s.sd[0] / judged.deviations(s.effect, 1)[0]
        for s in found.steps[-1].screening.candidate_scores
        if len(s.sd) == 1
    ]
    assert len(ratios) > 10
    assert min(ratios) == pytest.approx(1.0, abs=1e-9)


def test_the_coefficients_deny_a_correction_that_harms_them(silent, card, monkeypatch):
    """An airspeed that is right is corrected by 2 m/s: lift over dynamic pressure tells."""

    def wrong(full, responses, theta, **options):
        found = check_sensors(full, responses, theta, **options)
        state, name = found.state, "airspeed_bias"
        theta = state.theta.copy()
        theta[state.full.columns(["airspeed_bias"])] = 2.0
        state = moved(state, theta, tuple(dict.fromkeys((*state.active, name))))
        sizes = {**found.sizes, name: Size(2.0, 0.1, "m/s")}
        return replace(found, state=state, sizes=sizes, causes=(name,))

    monkeypatch.setattr(stages, "check_sensors", wrong)
    sensors, aerodynamics, denied = in_stages(silent, card)
    assert denied == ("airspeed_bias",)
    assert sensors.causes == aerodynamics.causes == ()


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


@pytest.mark.verify
@pytest.mark.parametrize("seed", [9, 1, 2, 3])
def test_a_slope_that_noise_of_the_vane_attenuates_is_no_change(seed, tmp_path):
    """One elevator, one aileron and one rudder manoeuvre: sideslip is noise alone in the first, and Clbe is too small
    there."""
    rng = np.random.default_rng(seed)
    plane = Plane() if seed == 9 else drawn(rng)
    records = [six_axes.record(k, fly(plane, k, rng, seconds=20.0), rng) for k in ("elevator", "aileron", "rudder")]
    found = diagnose(records, six_axes.card_in(tmp_path, plane), seed=seed, settings=QUICK)
    assert found.verdict is Verdict.NO_EFFECT
    assert not found.changes


@pytest.mark.verify
def test_what_a_stall_and_a_multistep_show_is_named(card):
    """A fit to the multistep alone has no stall, with the effect or without."""
    hidden = {"alpha_dot_lift": {"CLadot": -9.5}}
    asked = {"elevator_3211": {}, "slow_stall": {"amplitude": 1.5, "airspeed": 114.7, "altitude": 5200.0}}
    records = [
        synthetic(Request(hidden, seed=53600 + 50 * k, manoeuvre=name, **more), card, CATALOGUE, name=name).record
        for k, (name, more) in enumerate(asked.items())
    ]
    found = diagnose(records, card, seed=536, settings=DiagnosisSettings(gains=False, process_noise=False))
    (cause,) = found.causes
    size = cause.parameters["CLadot"]
    assert cause.name == "alpha_dot_lift"
    assert not found.unknown
    assert abs(size.mean + 9.5) < 3.0 * size.sd
