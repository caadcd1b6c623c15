"""Whole diagnoses of simulated flights: what was hidden is named, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import six_axes
from out_of_catalogue import unknown
from scipy.signal import lfilter
from stranger import HIDDEN, Recorder, flown
from stranger_six import Fighter, Plane, drawn, fly

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.diagnosis.diagnose import diagnose, rivals_of
from bayes_aero.diagnosis.result import TRAJECTORIES, Verdict
from bayes_aero.diagnosis.screening.regression import Products
from bayes_aero.diagnosis.search import search_in_stages
from bayes_aero.diagnosis.selection.forward_selection import noise_shares
from bayes_aero.diagnosis.selection.holdout import integrated_deviance
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.physics.coefficient_names import required_of
from bayes_aero.report.text.diagnosis import diagnosis_sentences
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import Request
from bayes_aero.simulate.injection import flyable, hidden_flights, hidden_records
from bayes_aero.simulate.synthetic_record import synthetic

# Hide an effect, or nothing, in simulated flights and diagnose them; every effect is in test_candidates.py, and the
# full study in benchmarks
# Clearly visible at every size in their range; the study covers the whole catalogue and the edge of detection.
SENSORS = ("alpha_scale", "airspeed_bias", "pitch_rate_bias", "accel_x_bias")
OTHERS = ("thrust_moment", "stabilizer_trim", "sideslip_drag", "pitch_rate_lift", "mass_scale", "elevator_delay")


def draw(seed: int, names: tuple[str, ...]) -> str:
    return str(np.random.default_rng([seed, 7]).choice(names))


@pytest.mark.recovery
@pytest.mark.parametrize("seed", [4101, pytest.param(4102, marks=pytest.mark.verify)])
@pytest.mark.parametrize("family", [SENSORS, OTHERS])
def test_a_hidden_effect_is_named_with_its_size(seed, family, card):
    name = draw(seed, family)
    effects, flights = flyable([name], seed=seed, noise="ar1", seconds=90.0)
    found = diagnose([flight.record for flight in flights], card, seed=seed, gains_wanted=False)
    assert found.causes, (name, effects)
    first = found.causes[0]
    assert first.name == name or name in first.ambiguous_with
    assert not found.changes
    if first.name == name:
        for parameter, true in effects[name].items():
            size = first.parameters[parameter]
            # Five deviations, and a twentieth of the size: recorded regressors carry noise.
            assert abs(size.mean - true) < 5 * size.sd + 0.05 * abs(true), parameter


@pytest.mark.recovery
@pytest.mark.parametrize("seed", [4301, pytest.param(4302, marks=pytest.mark.verify)])
def test_a_hidden_wave_is_called_unexplained_by_its_period(seed, card):
    flights = hidden_flights({}, seed=seed, noise="ar1", beyond=unknown("periodic"), seconds=90.0)
    found = diagnose([flight.record for flight in flights], card, seed=seed, gains_wanted=False)
    assert found.verdict is Verdict.UNEXPLAINED, [c.name for c in found.causes]
    waves = [u for u in found.unknown if u.channel.startswith("time, period")]
    assert waves, found.unknown
    period = float(max(waves, key=lambda u: u.share).channel.split()[2])
    assert period == pytest.approx(float(flights[0].values["unknown_period"]), rel=0.1)


# In the buffet of the last one a wave of 15 s takes a fifth of what is left of the lift.
SILENT = [(4202, "ar1"), (141128, "buffet")]
MORE = [pytest.param(*x, marks=pytest.mark.verify) for x in ((4201, "white"), (4203, "buffet"), (4204, "outliers"))]


@pytest.mark.recovery
@pytest.mark.parametrize(("seed", "noise"), [*SILENT, *MORE])
def test_nothing_is_found_where_nothing_is_hidden(seed, noise, card):
    found = diagnose(hidden_records({}, seed=seed, noise=noise, seconds=90.0), card, seed=seed, gains_wanted=False)
    assert found.verdict is Verdict.NO_EFFECT, [c.name for c in found.causes]
    assert "spoiler_lift" in found.not_testable or "spoiler_lift" not in CATALOGUE


# Records of aircraft that nobody here has seen, from a simulator of their own: the hidden effect, and nothing else
DRAWN = np.random.default_rng(20261).integers(1_000_000, size=2)


def diagnosed(folder, seed, name=None, gusts=0.0, recorder=Recorder()):
    """A random aircraft's two records, read from CSV and diagnosed."""
    p, size, files = flown(folder, np.random.default_rng(seed), name, gusts, recorder)
    card = read_card(str(folder / "card.toml"))
    records = [read_record(path, card.channels) for path in files]
    return p, size, diagnose(records, card, seed=int(seed), gains_wanted=False)


@pytest.mark.recovery
def test_what_was_hidden_is_named_with_its_size(tmp_path):
    name = str(np.random.default_rng(DRAWN[0]).choice(list(HIDDEN)))
    p, size, found = diagnosed(tmp_path, DRAWN[0], name)
    assert [cause.name for cause in found.causes] == [name]
    assert found.verdict is Verdict.EXPLAINED
    estimate = found.causes[0].parameters[HIDDEN[name][0]]
    assert abs(estimate.mean - size) < 3.0 * estimate.sd + 0.01 * abs(size)
    for base, own in (
        ("Cma", p.Cma),
        ("Cmq", p.Cmq / 2.0),
        ("Cmde", p.Cmde),
        ("CLa", p.CLa),
        ("e", p.e),
        ("CDX", p.CDX),
    ):
        assert found.base_moves[base][1] == pytest.approx(own, rel=0.03), base


@pytest.mark.recovery
def test_nothing_is_named_where_nothing_is_hidden(tmp_path):
    found = diagnosed(tmp_path, DRAWN[1])[2]
    assert found.verdict is Verdict.NO_EFFECT


@pytest.mark.verify
def test_a_poor_recorder_is_no_effect_and_hides_none(tmp_path):
    """Noise correlated from sample to sample, a filter of a few hertz, coarse digits: on all channels alike."""
    rng = np.random.default_rng(20264)
    seeds, name = rng.integers(1_000_000, size=2), str(rng.choice(["pitch_rate_bias", "thrust_moment", "alpha_bias"]))
    silent, named = tmp_path / "silent", tmp_path / "named"
    silent.mkdir(), named.mkdir()
    assert diagnosed(silent, seeds[0], recorder=Recorder.poor(rng))[2].verdict is Verdict.NO_EFFECT
    found = diagnosed(named, seeds[1], name, recorder=Recorder.poor(rng))[2]
    assert [cause.name for cause in found.causes] == [name]


@pytest.mark.verify
@pytest.mark.parametrize("name", ["separated_alpha_moment", "alpha_squared_moment"])
def test_noise_of_the_vane_in_lift_and_moment_at_once_is_no_shift_of_the_cg(tmp_path, name):
    """A CG moved aft adds lift to the moment, and takes the vane's noise out of it where it was in both."""
    _, size, found = diagnosed(tmp_path, 0, name)
    assert [cause.name for cause in found.causes] == [name]
    estimate = found.causes[0].parameters[HIDDEN[name][0]]
    assert abs(estimate.mean - size) < 3.0 * estimate.sd


@pytest.mark.verify
def test_gusts_are_no_error_of_a_sensor(tmp_path):
    """They are in vane and airspeed, and what integrates them wanders off like an offset. Their mean is a wind."""
    rng = np.random.default_rng(20262)
    found = diagnosed(tmp_path, rng.integers(1_000_000), gusts=rng.uniform(0.3, 0.7))[2]
    assert {cause.name for cause in found.causes} <= {"vertical_wind"}
    assert not found.unknown


@pytest.mark.verify
def test_an_offset_of_the_vane_is_named_in_gusts_and_no_wind_beside_it(tmp_path):
    """From the flight path alone the two are nearly one; the coefficients feel the vane and not the wind."""
    _, size, found = diagnosed(tmp_path, 20263, "alpha_bias", gusts=0.4)
    assert [cause.name for cause in found.causes] == ["alpha_bias"]
    estimate = found.causes[0].parameters["alpha_bias"]
    assert abs(estimate.mean - size) < 4.0 * estimate.sd


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
    found = diagnose(records, card, model=Model.of(LINEAR), seed=seed, gains_wanted=False)
    assert {cause.name for cause in found.causes} == STALL
    assert found.causes[0].name == "flow_separation"
    for cause in found.causes:
        for name, size in cause.parameters.items():
            assert size.mean == pytest.approx(truth[name], rel=0.15), name
    assert not found.unknown


FORMS = {
    "pitch_rate_lift", "aileron_side_force", "roll_rate_side_force", "sideslip_alpha_roll", "sideslip_alpha_yaw",
    "sideslip_cubed_roll", "sideslip_cubed_yaw", "sideslip_lift", "sideslip_drag", "sideslip_moment",
    "alpha_squared_moment", "alpha_drag", "elevator_drag", "cg_shift",
}  # fmt: skip


SLOWER = [(speed, "elevator") for speed in (190.0, 120.0, 90.0, 75.0) for _ in range(2)]


def polynomial_fighter(folder, plane, plan, rng, seconds, *axes):
    """A linear card and records of manoeuvres (speed, kind)."""
    effects = six_axes.LONGITUDINAL + (six_axes.LATERAL if len(axes) > 1 else ())
    flights = [fly(plane, kind, rng, seconds=seconds, V=speed) for speed, kind in plan]
    records = [six_axes.record(f"m{k}_{speed:.0f}", flights[k], rng) for k, (speed, _) in enumerate(plan)]
    return records, six_axes.card_in(folder, plane, effects, axes)


@pytest.mark.recovery
def test_a_wrong_form_of_the_coefficients_is_no_stall_and_no_camber(tmp_path):
    """A fighter of polynomials, by a simulator that shares no code, from 2 to 24 deg: what is found are forms.

    With the linear card `drag_offset` and `flow_separation` explain most of what is left, and CL differs between
    manoeuvres, whose angles of attack do. None of that is there. CZq is -30 per q c/2V: lift by pitch rate is 15 qhat.
    """
    records, card = polynomial_fighter(
        tmp_path, Fighter(), SLOWER, np.random.default_rng([1, 54]), 10.0, "longitudinal"
    )
    found = diagnose(records, card, seed=1, gains_wanted=False, process_noise=False)
    assert not found.causes
    assert not any(structure.offsets for structure in found.unknown)
    assert {term.coefficient for term in found.terms} == {"CL", "CD", "Cm"}
    assert {channel for term in found.terms for channel in term.term.channels} <= {"alpha", "q", "airspeed", "elevator"}
    ((mean, sd),) = [term.size for term in found.terms if (term.coefficient, term.term.name) == ("CL", "qhat")]
    assert abs(mean - 15.0) < 4.0 * sd


@pytest.mark.verify
def test_a_wrong_form_is_no_camber_where_trajectories_are_compared(tmp_path):
    """The same fighter without accelerometers. Forms are sought to first order there, so few of them are sure."""
    records, card = polynomial_fighter(
        tmp_path, Fighter(), SLOWER, np.random.default_rng([1, 54]), 10.0, "longitudinal"
    )
    kept = [{name: x for name, x in r.channels.items() if name not in ("ax", "ay", "az")} for r in records]
    flown = [FlightRecord.from_arrays(r.name, r.time, x) for r, x in zip(records, kept, strict=True)]
    found = diagnose(flown, card, seed=1, gains_wanted=False, process_noise=False)
    assert found.compared == TRAJECTORIES
    assert not found.causes
    assert {term.coefficient for term in found.terms} == {"CL", "CD", "Cm"}
    assert "alpha" in next(t for t in found.terms if t.coefficient == "CL").term.channels


@pytest.fixture(scope="module")
def nonlinear(request, tmp_path_factory):
    """Curves, tables and what depends on deflections are drawn; three axes in every other flight, few or many."""
    seed = request.param
    rng = np.random.default_rng([seed, 531])
    plane, six, few = Fighter.drawn(rng), seed % 2 == 1, seed > 1
    kinds = ("elevator", "aileron", "rudder") if six else ("elevator", "elevator")
    plan = [(speed, kind) for speed in ((150.0, 100.0) if few else (190.0, 140.0, 110.0, 90.0)) for kind in kinds]
    axes = ("longitudinal", "lateral") if six else ("longitudinal",)
    folder = tmp_path_factory.mktemp("fighter")
    records, card = polynomial_fighter(folder, plane, plan, rng, 8.0 if few else 10.0, *axes)
    return diagnose(records, card, seed=seed, gains_wanted=False, process_noise=False)


NO_FORM = pytest.mark.xfail(strict=True, reason="CL is found over alpha and q, without a form")


@pytest.mark.verify
@pytest.mark.parametrize("nonlinear", range(4), indirect=True)
def test_no_cause_is_sure_that_a_form_of_a_nonlinear_fighter_explains_as_well(nonlinear):
    assert not [c.name for c in nonlinear.causes if c.sure and c.name not in FORMS and not c.ambiguous_with]
    assert {one.coefficient for one in (*nonlinear.terms, *nonlinear.unknown)} >= {"CL", "Cm"}


@pytest.mark.verify
@pytest.mark.parametrize("nonlinear", [0, 1, 2, pytest.param(3, marks=NO_FORM)], indirect=True)
def test_lift_and_pitching_moment_of_a_nonlinear_fighter_have_a_form(nonlinear):
    assert {term.coefficient for term in nonlinear.terms} >= {"CL", "Cm"}


# An effect in two unlike manoeuvres: the gain of an addition by itself in closed form, and a whole diagnosis
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
        with_it = integrated_deviance(products, fold, (np.array([0, 1]), nothing), prior, 1.0)
        found += integrated_deviance(products, fold, (nothing, nothing), prior, 1.0) - with_it
    assert found == pytest.approx(expected, rel=0.02)


def test_what_a_stall_and_a_multistep_show_is_named(card):
    """A fit to the multistep alone has no stall, with the effect or without."""
    hidden = {"alpha_dot_lift": {"CLadot": -9.5}}
    asked = {"elevator_3211": {}, "slow_stall": {"amplitude": 1.5, "airspeed": 114.7, "altitude": 5200.0}}
    records = [
        synthetic(Request(hidden, seed=53600 + 50 * k, manoeuvre=name, **more), card, CATALOGUE, name=name).record
        for k, (name, more) in enumerate(asked.items())
    ]
    found = diagnose(records, card, seed=536, gains_wanted=False, process_noise=False)
    (cause,) = found.causes
    size = cause.parameters["CLadot"]
    assert cause.name == "alpha_dot_lift"
    assert not found.unknown
    assert abs(size.mean + 9.5) < 3.0 * size.sd


def set_between(seed: int):
    """Three manoeuvres of 8 s of another simulator whose constants differ, as the recorded flap and rudder trim do."""
    rng, usual, planes, records = np.random.default_rng([seed, 53]), Plane(**six_axes.ATTACHED), [], []
    for k in range(3):
        constants = {"CL0": 0.03, "CD0": 0.004, "Cm0": 0.01}
        moved = {name: getattr(usual, name) + rng.normal(0.0, sd) for name, sd in constants.items()}
        planes.append(replace(usual, **moved))
        record = six_axes.record(f"m{k}", fly(planes[-1], "elevator", rng, dt=0.02, seconds=8.0), rng)
        rudder = record.channels["rudder"] + np.radians(rng.uniform(-3.0, 3.0))
        flap = np.full(record.n, np.radians(rng.uniform(0.0, 5.0)))
        channels = {**record.channels, "rudder": rudder, "flap": flap}
        records.append(replace(record, channels=channels))
    return planes, records


@pytest.fixture(scope="module")
def linear_card(tmp_path_factory):
    folder, plane = tmp_path_factory.mktemp("card"), Plane(**six_axes.ATTACHED)
    return six_axes.card_in(folder, plane, six_axes.LONGITUDINAL, ("longitudinal",))


@pytest.mark.recovery
def test_what_is_set_between_manoeuvres_is_an_offset_and_no_cause(linear_card):
    planes, records = set_between(2)
    found = diagnose(records, linear_card, seed=1, gains_wanted=False, process_noise=False)
    assert found.verdict is Verdict.UNEXPLAINED
    assert not found.causes
    assert not found.terms
    assert not found.changes
    assert {(one.coefficient, one.channel) for one in found.unknown} == {(c, "manoeuvre") for c in ("CL", "CD", "Cm")}
    for one in found.unknown:
        if one.coefficient == "CD":  # the drag due to lift is in it
            continue
        for plane, (mean, sd) in zip(planes[1:], one.offsets.values(), strict=True):
            true = getattr(plane, f"{one.coefficient}0") - getattr(planes[0], f"{one.coefficient}0")
            assert abs(mean - true) < 4.0 * sd, one.coefficient
    for name in ("flap_lift", "flap_moment", "rudder_moment"):
        assert name in found.not_testable
    assert found.not_testable["flap_lift"] == "channel flap differs only between manoeuvres, as an offset does"
    said = " ".join(diagnosis_sentences(found))
    assert "The constant of Cm differs between manoeuvres" in said.replace("the constant", "The constant")


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
    model = Model.from_card(card)
    flights, _ = despiked(join(records, card, required_of(model.axes)))
    full = candidate_model(model, flights)
    fit, theta = fit_mle(model, observe(records, card, model), seed=0), full.neutral_vector
    theta[full.columns(fit.names)] = fit.estimate
    return search_in_stages(full, EquationError.of(flights, full.model), theta, seed=0)


@pytest.mark.verify
@pytest.mark.parametrize(("seed", "times", "left_out"), [(1, 3.0, None), (2, 3.0, None), (3, 1.0, "rudder_side_force")])
def test_noise_of_the_regressors_is_no_error_of_a_sensor(tmp_path, seed, times, left_out):
    """r_dot, which is recorded well, then tells more of sideslip and rudder than their own channels: a lateral
    accelerometer 2 to 3 m away, were it believed. With the usual noise the missing effect is named."""
    found = searched(tmp_path, seed, times, left_out)
    assert found.sensors is not None
    assert found.sensors.causes == ()
    assert found.aerodynamics.causes == (() if left_out is None else (left_out,))


@pytest.mark.verify
@pytest.mark.parametrize("seed", [1, 3])
def test_what_outdoes_its_rival_by_less_noise_alone_is_not_named_alone(tmp_path, seed):
    """With three times the noise an accelerometer 2 m away explains more than the missing effect of the rudder."""
    found = searched(tmp_path, seed, 3.0, "rudder_side_force").aerodynamics
    noise = noise_shares(found.state, found.fit)
    for name in found.causes:
        assert "rudder_side_force" in (name, *rivals_of(found, name, noise=noise[name])[1])


@pytest.mark.verify
@pytest.mark.parametrize("seed", [1, 3])
def test_the_scale_of_an_accelerometer_is_found_in_slow_noise(tmp_path, seed):
    found = searched(tmp_path, seed, 1.0, scale=0.85).aerodynamics
    assert found.causes == ("accel_y_scale",)
    size = found.sizes["accel_y_scale"]
    assert abs(size.mean + 0.15) < 1.96 * size.sd
