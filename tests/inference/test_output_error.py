"""Flights of shipped linear cards whose truth is known; output error: intervals, settings, what it cannot tell."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import linear_cards as cards
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from bayes_aero.diagnosis.result import FITTED
from bayes_aero.dynamics.flight import aircraft_dynamics, linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.errors import InputError
from bayes_aero.flight.card import shipped_cards
from bayes_aero.inference.output_error import (
    MAX_GROWTH,
    SeparatedFlow,
    fit_cascade,
    fit_output_error,
    initial_state_sd,
    trajectories,
)
from bayes_aero.inference.prediction_error import fit_prediction_error
from bayes_aero.inference.results import OutputErrorStatus
from bayes_aero.jobs.fly import fly
from bayes_aero.jobs.results import fly_results
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join
from bayes_aero.parameter import Prior
from bayes_aero.report.pages.fly import fly_sentences, parameter_rows

SHORT_PERIOD, TRUTH = cards.SHORT_PERIOD, cards.SHORT_PERIOD_TRUTH
NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15, "p": 0.004, "r": 0.003}
BEGIN = (0.04, 0.01)
BRIEF = cards.short_period_flight(TRUTH, n=200, x0=BEGIN)  # 8 s


def noisy(channels, seed, name="linear"):
    """A record of these true channels; with white noise unless the seed is None."""
    return cards.record_of(channels, 0.04, NOISE, None if seed is None else np.random.default_rng(seed), name)


def flown_of(text, channels, seed, outputs=None, **options):
    card = cards.card_of(text)
    dynamics = linear_dynamics(card)
    return segments(join([noisy(channels, seed)], card, dynamics.inputs), dynamics, outputs=outputs, **options)


def truth_of(flown):
    return np.array([TRUTH[name] for name in flown.dynamics.names])


def value_of(fit, name, of="estimate"):
    return getattr(fit, of)[fit.names.index(name)]


def by_output_error(flown):
    fit = fit_output_error(flown)
    return fit, fit.sd


def with_process_noise(flown):
    without = fit_output_error(flown)
    F = np.full(len(flown.dynamics.states), 0.01)
    fit = fit_prediction_error(flown, F, without.R, start=without.estimate, priors=False)
    return fit, fit.sd


SPEED = 90.0  # m/s, of the flight by which az follows alpha
SHIPPED_TRUTH = TRUTH | {
    "azalpha": SPEED * TRUTH["Zalpha"], "azde": SPEED * TRUTH["Zde"]
}  # fmt: skip
PROBLEMS = {  # a shipped card: a flight by the matrix exponential, the truth, and what is known to 10 %
    "short_period": (cards.short_period_flight, SHIPPED_TRUTH, ("Zalpha", "Malpha", "Mq", "Mde")),
    "lateral": (cards.lateral_flight, cards.LATERAL_TRUTH, ("Lp", "Lda", "Nr", "Nbeta")),
}


@pytest.mark.parametrize(("engine", "problem"), [
    (by_output_error, "short_period"), (by_output_error, "lateral"), (with_process_noise, "lateral"),
])  # fmt: skip
def test_the_truth_comes_back(engine, problem):
    """In a band of frequencies it does in `test_frequency_fit.py`."""
    simulate, truth, precise = PROBLEMS[problem]
    text = shipped_cards()[problem].read_text()
    mapped = {c.name for c in cards.card_of(text).channels}
    fit, sd = engine(flown_of(text, {name: x for name, x in simulate(truth).items() if name in mapped}, 2))
    assert set(fit.names) == set(truth)
    off = {n: (x - truth[n]) / s for n, x, s in zip(fit.names, fit.estimate, sd, strict=True) if s > 0.0}
    assert max(map(abs, off.values())) < 4.0, off
    for name in precise:
        assert value_of(fit, name) == pytest.approx(truth[name], rel=0.1), name


@pytest.fixture(scope="module")
def windows():
    """Two segments of 4 s."""
    return flown_of(SHORT_PERIOD, BRIEF, 1, window=4.0)


@pytest.fixture(scope="module")
def short_period(windows):
    whole = flown_of(SHORT_PERIOD, BRIEF, 1)
    start = np.array([p.start for p in whole.dynamics.free])
    assert not start.any()
    return whole, fit_cascade([windows, whole], [start])


def test_it_stopped_at_the_optimum(short_period):
    """det R, formed anew from the matrix exponential, is no smaller a deviation to either side."""
    _, fit = short_period
    assert fit.status is OutputErrorStatus.CONVERGED
    assert fit.held_by_prior == ()
    np.testing.assert_allclose(np.sqrt(fit.R), [NOISE[name] for name in fit.flown.outputs], rtol=0.15)
    measured = {name: np.asarray(fit.flown.flights.channels[name]) for name in ("alpha", "q", "az")}
    x0 = [np.polynomial.Polynomial.fit(np.arange(13), measured[name][:13], 1)(0) for name in ("alpha", "q")]
    x0 = np.array(x0) + fit.departure[0]

    def cost(values):
        true = cards.short_period_flight(dict(zip(fit.names, values, strict=True)), n=200, x0=x0)
        return 100.0 * sum(np.log(np.mean((measured[name] - true[name]) ** 2)) for name in measured)

    here = cost(fit.estimate)
    for k, sd in enumerate(fit.sd):
        for sign in (1.0, -1.0):
            moved = fit.estimate.copy()
            moved[k] += sign * sd
            assert cost(moved) > here + 0.3, fit.names[k]


def test_residuals_of_the_last_step_and_deviations_are_those_of_the_simulation(short_period):
    """That step is extrapolated. Cramer-Rao by differences of the matrix exponential, the initial state unknown."""
    _, fit = short_period
    at = trajectories(fit.flown, jnp.asarray(fit.estimate), jnp.asarray(fit.departure))
    inside = fit.flown.inside
    extrapolated = (fit.columns[..., 0] * fit.flown.noise_growth)[inside]
    off = np.abs(extrapolated - np.asarray(at.residual)[inside])
    np.testing.assert_array_less(off, 1e-3 * np.sqrt(fit.R) + np.zeros_like(off))
    np.testing.assert_allclose(np.mean(extrapolated**2, axis=0), fit.R, rtol=1e-6)
    base = np.array([*fit.estimate, *np.asarray(at.trajectory.states)[0, 0]])

    def respond(v):
        flight = cards.short_period_flight(dict(zip(fit.names, v[:-2], strict=True)), n=200, x0=v[-2:])
        return np.concatenate([flight[name] / np.sqrt(R) for name, R in zip(fit.flown.outputs, fit.R, strict=True)])

    S = np.stack([(respond(base + step) - respond(base - step)) / 2e-6 for step in 1e-6 * np.eye(len(base))], axis=1)
    start = initial_state_sd(fit.flown.dynamics) ** -2  # what the sensors say of the initial state
    information = S.T @ S + np.diag([*np.zeros(len(fit.names)), *start])
    np.testing.assert_allclose(fit.sd, np.sqrt(np.diag(np.linalg.inv(information)))[:-2], rtol=0.01)


STILL = cards.short_period_flight(TRUTH | {"Zde": 0.0, "Mde": 0.0}, n=200, x0=(0.1, -0.1))
STILL["elevator"] = np.zeros(200)
PRIORS = """
[parameters.Mde]
prior = { family = "normal", location = -2.5, scale = 0.7 }
[parameters.Zde]
prior = { family = "normal", location = 0.1, scale = 0.3 }
"""


def test_what_the_record_does_not_move_is_held_by_its_prior_or_undetermined(short_period):
    flown = flown_of(SHORT_PERIOD + PRIORS, STILL, 4)
    fit, free = fit_output_error(flown), fit_output_error(flown, prior_weight=0.0)
    assert set(fit.held_by_prior) == set(free.undetermined) == {"Zde", "Mde"}
    assert free.held_by_prior == short_period[1].held_by_prior == ()
    for name, location, scale in (("Mde", -2.5, 0.7), ("Zde", 0.1, 0.3)):
        assert value_of(fit, name) == pytest.approx(location, abs=1e-6)
        assert value_of(fit, name, "sd") == pytest.approx(scale, rel=1e-6)
        assert value_of(fit, name, "sd_corrected") == pytest.approx(scale, rel=1e-6)
        assert value_of(fit, name, "crb") == value_of(free, name, "sd_corrected") == np.inf
    for name in ("Zalpha", "Malpha", "Mq"):
        error = abs(value_of(fit, name) - TRUTH[name])
        assert error < 4.0 * value_of(fit, name, "sd") < 0.4 * abs(TRUTH[name])
        assert value_of(free, name) == pytest.approx(value_of(fit, name), rel=1e-3)
    # Without priors a wrong one does not count.
    text = SHORT_PERIOD + '\n[parameters.Mq]\nprior = { family = "normal", location = 5.0, scale = 0.001 }\n'
    right = short_period[1]
    fit = fit_output_error(flown_of(text, BRIEF, 1), start=right.estimate, prior_weight=0.0)
    assert np.all(np.abs(fit.estimate - right.estimate) < 0.05 * right.crb)
    np.testing.assert_allclose(fit.sd, fit.crb, rtol=1e-6)


def test_what_is_undetermined_and_whose_the_priors_are_is_reported():
    record, card = noisy(STILL, 4, name="flight"), cards.card_of(SHORT_PERIOD + PRIORS)
    free, held = (fly([record], card, priors=priors) for priors in (False, True))
    rows = parameter_rows(free.flown)
    assert {name for name, row in rows.items() if row["undetermined"]} == {"Zde", "Mde"}
    assert {name for name, row in rows.items() if np.isinf(row["sd_corrected"])} == {"Zde", "Mde"}
    assert {row["prior"] for row in rows.values()} == {None}
    assert any("do not determine Zde and Mde" in line for line in fly_sentences(free.flown))
    rows = parameter_rows(held.flown)
    assert rows["Zde"]["prior"]["default"] is False
    assert rows["Mq"]["prior"] == {
        "family": "normal", "location": 0.0, "scale": 1000.0, "source": "flat in effect; our choice", "default": True,
    }  # fmt: skip
    assert fly_results(held, card, [record], {}).initial_states["flight"]["q"].prior_sd == 0.01


def test_a_parameter_that_is_held_keeps_its_value_and_moves_the_others(short_period):
    flown, free = short_period
    fit = fit_output_error(flown, start=free.estimate, held={"Mde": -2.0})
    assert (value_of(fit, "Mde"), value_of(fit, "Mde", "sd")) == (-2.0, 0.0)
    assert fit.status is OutputErrorStatus.CONVERGED
    assert fit.at_bound == ()
    assert fit.cost > free.cost + 10.0
    moved = np.abs(fit.estimate - free.estimate) > 3.0 * free.sd
    assert np.any(moved[[name != "Mde" for name in fit.names]])


def test_segments_that_do_not_count_have_no_say(windows, short_period):
    """Fitted beside a masked segment, a window gives what it gives alone, and the other keeps its measured state."""
    start = short_period[1].estimate
    first = np.arange(len(windows.index)) == 0
    masked = eqx.tree_at(lambda f: f.inside, windows, windows.inside & first[:, None])
    beside, alone = (fit_output_error(f, start=start) for f in (masked, windows.part([0])))
    np.testing.assert_allclose(beside.estimate, alone.estimate, rtol=1e-6)
    np.testing.assert_allclose(beside.sd, alone.sd, rtol=1e-6)
    assert beside.cost == pytest.approx(alone.cost, rel=1e-9)
    assert not beside.departure[~first].any()
    assert beside.columns.shape[:2] == windows.index.shape
    assert not beside.columns[~first].any()


def test_a_bound_in_the_way_is_said():
    flown = flown_of(SHORT_PERIOD + "\n[parameters.Mq]\nstart = -0.3\nbounds = [-0.8, 0.0]\n", BRIEF, 1)
    fit = fit_output_error(flown, start=truth_of(flown))
    assert fit.status is OutputErrorStatus.AT_BOUND
    assert fit.at_bound == ("Mq",)
    assert value_of(fit, "Mq") == -0.8


def test_an_aircraft_that_cannot_fly_the_record_is_said():
    """Held at a static instability that doubles every 50 ms; every number that is reported is one."""
    fit = fit_output_error(flown_of(SHORT_PERIOD.replace("Zq = 1.0", "Zq = 1.0\nMalpha = 200.0"), BRIEF, 1))
    assert fit.status is OutputErrorStatus.LEFT_ENVELOPE
    assert "cannot be simulated" in fit.status.value
    for array in (fit.estimate, fit.departure, fit.R, fit.rms, fit.covariance, fit.cost):
        assert np.all(np.isfinite(array))


def coloured_flown(seed, rho, n=500, biases=(0.0,)):
    """Flights with AR(1) noise of the usual deviations on alpha and q, a constant error of alpha in each."""
    card, rng = cards.card_of(SHORT_PERIOD), np.random.default_rng(seed)
    dynamics = linear_dynamics(card)
    records = []
    for number, bias in enumerate(biases):
        channels = cards.short_period_flight(TRUTH, n=n, x0=(0.04, 0.01 - 0.03 * number))
        for name in ("alpha", "q"):
            white = rng.standard_normal(n) * np.append(1.0, np.full(n - 1, np.sqrt(1.0 - rho**2)))
            channels[name] = channels[name] + NOISE[name] * lfilter([1.0], [1.0, -rho], white)
        channels["alpha"] = channels["alpha"] + bias
        records.append(cards.record_of(channels, name=f"flight {number}"))
    return segments(join(records, card, dynamics.inputs), dynamics, outputs=("alpha", "q"))


def test_flights_of_like_length_share_compiled_programs_and_the_same_estimates():
    """What compiles is the structure and the shapes; samples beyond the flight's end change nothing."""
    flights = [flown_of(SHORT_PERIOD, cards.short_period_flight(TRUTH, n=n), 1) for n in (490, 500)]
    one, other = ([jax.tree.structure(f), *map(np.shape, jax.tree.leaves(f))] for f in (f.nameless for f in flights))
    assert one == other
    plain = {name: getattr(flights[0], name)[:, :490] for name in ("index", "inside", "noise_growth")}
    whole, cut = (fit_output_error(flown, held={"az0": 0.0}) for flown in (flights[0], replace(flights[0], **plain)))
    np.testing.assert_allclose(whole.estimate, cut.estimate, rtol=1e-9)
    np.testing.assert_allclose(whole.sd_corrected, cut.sd_corrected, rtol=1e-9)


@pytest.mark.verify
@pytest.mark.parametrize(("rho", "flights"), [(0.0, 100), (0.9, 60)])
def test_intervals_cover_the_truth(rho, flights):
    """95 % intervals hold the truth as often as they say; of coloured noise those that take it for white do not."""
    truth = {name: x for name, x in TRUTH.items() if name != "az0"}
    inside = {"crb": [], "sd_corrected": []}
    for seed in range(flights):
        fit = fit_output_error(coloured_flown([9, seed], rho), held={"az0": 0.0})
        assert fit.status is OutputErrorStatus.CONVERGED
        for kind, covered in inside.items():
            covered.append([abs(value_of(fit, n) - x) < 1.96 * value_of(fit, n, kind) for n, x in truth.items()])
    share = np.mean(inside["sd_corrected" if rho else "crb"], axis=0)
    assert rho or np.all((share >= 0.88) & (share <= 0.99)), dict(zip(truth, share, strict=True))
    assert 0.90 + 0.02 * (rho == 0.0) <= np.mean(share) <= 0.98  # standard error 0.016 over the coloured flights
    assert np.mean(inside["crb"]) < 0.6 or not rho


def test_what_one_stretch_alone_tells_has_a_corrected_deviation_of_its_size():
    """A constant error of alpha shows, beside Z0 and M0, only while the motion from a known state dies away."""
    flown = replace(coloured_flown(12, 0.9), fixed=(("alpha", 0.04), ("q", 0.01)))
    biases = {"alpha": Prior("normal", 0.0, 0.1), "q": Prior("normal", 0.0, 0.1)}
    fit = fit_output_error(flown, held={"az0": 0.0}, prior_weight=0.0, biases=biases)
    assert fit.status is OutputErrorStatus.CONVERGED
    truth = TRUTH | {"bias_alpha_1": 0.0, "bias_q_1": 0.0}
    assert set(fit.names) == set(truth)
    for name in set(truth) - {"az0"}:
        crb, sd = (value_of(fit, name, of) for of in ("crb", "sd_corrected"))
        assert abs(value_of(fit, name) - truth[name]) < 4.0 * sd, name
        assert crb < sd < 20.0 * crb, name


def test_biases_of_manoeuvres_are_recovered_and_free_the_parameters():
    """An alpha vane that stands off by another constant in each flight."""
    flown = coloured_flown(5, 0.0, biases=(0.02, -0.015))
    start = truth_of(flown)
    plain = fit_output_error(flown, start=start, held={"az0": 0.0})
    fit = fit_output_error(flown, start=start, held={"az0": 0.0}, biases={"alpha": Prior("normal", 0.0, 0.02)})
    assert fit.names == (*plain.names, "bias_alpha_1", "bias_alpha_2")
    assert fit.status is OutputErrorStatus.CONVERGED
    # A bias that all flights share cannot be told from the constants Z0 and M0; their difference can.
    apart = np.array([*np.zeros(len(plain.names)), 1.0, -1.0])
    deviation = np.sqrt(apart @ fit.covariance @ apart)
    assert deviation < 0.001
    assert apart @ fit.estimate == pytest.approx(0.035, abs=4.0 * deviation)
    for name in ("Zalpha", "Zde", "Malpha", "Mq", "Mde"):
        assert abs(value_of(fit, name) - TRUTH[name]) < 4.0 * value_of(fit, name, "sd"), name
    # Without biases the slope follows the flights' offsets.
    wrong, right = (abs(value_of(one, "Zalpha") - TRUTH["Zalpha"]) for one in (plain, fit))
    assert wrong > 2.0 * right
    assert value_of(plain, "Zalpha", "sd") > 3.0 * value_of(fit, "Zalpha", "sd")
    with pytest.raises(InputError, match="altitude cannot have a bias"):
        fit_output_error(flown, biases={"altitude": Prior("normal", 0.0, 1.0)})


# Settings of a trajectory fit: fixed initial states, held inputs, outputs on request
def test_a_fixed_initial_state_is_flown_and_given_no_freedom(short_period):
    flown = flown_of(SHORT_PERIOD, BRIEF, 1, fixed=dict(zip(("alpha", "q"), BEGIN, strict=True)))
    fit = fit_output_error(flown, start=short_period[1].estimate)
    assert np.all(fit.departure == 0.0)
    begin = trajectories(flown, jnp.asarray(fit.estimate), jnp.asarray(fit.departure)).trajectory.states[0, 0]
    np.testing.assert_allclose(begin, BEGIN, rtol=1e-14)
    truth = truth_of(flown)
    assert np.all(np.abs(fit.estimate - truth) < 4.0 * fit.sd)
    assert np.all(fit.crb <= short_period[1].crb * 1.02)  # a state that is known leaves more to say of the rest
    flown = flown_of(SHORT_PERIOD, BRIEF, 1, fixed={"q": 0.02})
    begin = trajectories(flown, jnp.asarray(fit.estimate), jnp.zeros((1, 2))).trajectory.states[0, 0]
    np.testing.assert_array_equal(begin, [noisy(BRIEF, 1)["alpha"][0], 0.02])
    with pytest.raises(InputError, match="az, which is no state of the model; there are alpha, q"):
        flown_of(SHORT_PERIOD, BRIEF, 1, fixed={"az": 1.0})


def test_held_inputs_are_a_zero_order_hold_and_find_the_truth():
    """A digital actuator's record, a matrix exponential each sample; linear between samples Mde is off by more."""
    n, truth = 200, TRUTH | {"Zq": 1.0}
    u = np.repeat(np.random.default_rng(7).normal(0.0, 0.03, n // 10), 10)
    motion = [[truth[k + name] for name in ("alpha", "q", "de", "0")] for k in "ZM"]
    step = expm(np.concatenate([motion, np.zeros((2, 4))]) * 0.04)
    x = [np.array(BEGIN)]
    for value in u[:-1]:
        x.append(step[:2] @ [*x[-1], value, 1.0])
    alpha, q = np.array(x).T
    az = truth["az0"] + 90.0 * (truth["Zalpha"] * alpha + truth["Zde"] * u)
    channels, off = {"alpha": alpha, "q": q, "elevator": u, "az": az}, {}
    for held in (True, False):
        fit = fit_output_error(flown_of(SHORT_PERIOD, channels, None, held=held))
        off[held] = abs(value_of(fit, "Mde") - truth["Mde"])
        assert (np.sqrt(fit.R[:2]) < 1e-6).all() == held
    assert off[True] < 1e-3
    assert off[False] > 10.0 * off[True]


def test_a_velocity_of_the_card_s_own_may_depart_by_as_much_as_a_velocity():
    text = SHORT_PERIOD.replace('alpha = { label = "alpha", unit = "deg" }', 'w = { label = "w", unit = "m/s" }')
    card = cards.card_of(
        text[: text.index("[linear.outputs")].replace('"alpha"', '"w"').replace("rates.alpha", "rates.w")
    )
    np.testing.assert_array_equal(initial_state_sd(linear_dynamics(card)), [1.0, 0.01])


def test_outputs_are_those_asked_for_and_det_R_is_theirs(card, clean_records):
    record = noisy(BRIEF, 4, name="flight")
    done = fly([record], cards.card_of(SHORT_PERIOD), outputs="alpha, q", initial_state="fixed").flown
    assert done.fit.flown.outputs == ("alpha", "q")
    errors = done.path("flight", FITTED).errors
    assert set(errors) == {"alpha", "q", "az"}
    assert done.fit.det_R == pytest.approx(np.prod([errors[name].rms ** 2 for name in ("alpha", "q")]), rel=1e-3)
    assert done.initial["flight"]["alpha"] == (pytest.approx(record["alpha"][0]), 0.0)
    with pytest.raises(InputError, match="the output beta was not recorded or is not simulated; there are alpha, q"):
        fly([record], cards.card_of(SHORT_PERIOD), outputs=["beta"])
    with pytest.raises(InputError, match="initial state is 'known'; use free or fixed"):
        fly([record], cards.card_of(SHORT_PERIOD), initial_state="known")
    # Pitch acceleration, where it was recorded, is one on request alone.
    stall = clean_records[0]
    stall = replace(stall, channels=dict(stall.channels) | {"q_dot": np.zeros(stall.n)})
    flights, model = join([stall], card), Model.from_card(card)
    assert "q_dot" not in aircraft_dynamics(model, flights).outputs
    assert segments(flights, aircraft_dynamics(model, flights, ("q_dot",)), outputs=("q_dot",)).outputs == ("q_dot",)


# Noise of trajectories that grows as the flow separates: its size is found, and what it does to estimates
GROWTH = 9.0
N = 500
APART = np.where((np.arange(N) > 300) & (np.arange(N) < 400), 1.0, 0.0)  # a stall of four seconds


def longer(flown, x):
    """(n,) samples of the one segment, and zeros to its end."""
    return np.pad(x, (0, flown.inside.shape[1] - len(x)))[None]


def growing_flown(seed, growth=GROWTH):
    rng, channels = np.random.default_rng(seed), cards.short_period_flight(TRUTH, n=N)
    for name in ("alpha", "q"):
        channels[name] = channels[name] + NOISE[name] * (1.0 + growth * APART) * rng.standard_normal(N)
    flown = flown_of(SHORT_PERIOD, channels, None, ("alpha", "q"))
    return flown, truth_of(flown)


@pytest.mark.parametrize("growth", [GROWTH, 0.0])
def test_the_growth_of_noise_is_found(growth):
    """Of a hundred samples of separated flow a deviation is known to 7 %."""
    flown, truth = growing_flown(4132, growth)
    fit = fit_output_error(flown, start=truth, held={"az0": 0.0})
    apart = SeparatedFlow(fit.columns[..., 0], longer(fit.flown, APART), fit.flown.inside)
    assert apart.growths() == pytest.approx(growth, abs=4.0 * 0.08 * (1.0 + growth))
    np.testing.assert_allclose(apart.noise_growth()[0, :N][APART == 0.0], 1.0)


def test_growth_has_an_end_and_segments_left_out_no_say():
    inside = np.ones((1, N), bool)
    assert not SeparatedFlow(np.zeros((1, N, 1)), APART[None], inside).growths().any()
    only = (APART[None, :, None] + 1e-9) * np.ones((1, N, 1))
    assert SeparatedFlow(only, APART[None], inside).growths() == pytest.approx(MAX_GROWTH, rel=1e-3)
    residual = np.random.default_rng(1).standard_normal((2, N, 1))
    residual[1] *= 1.0 + GROWTH * APART[:, None]
    parts = SeparatedFlow(residual, np.stack([APART, APART]), np.ones((2, N), bool))
    assert parts.growths(without=1) < 1.0
    assert parts.growths(without=0) > 5.0


def test_weighed_estimates_are_nearer_the_truth_and_a_steady_growth_scales_R_alone():
    """Weighted least squares beats plain least squares; R is that of attached flow, rms that of all as recorded."""
    off, sd = {False: [], True: []}, []
    for seed in range(20):
        flown, truth = growing_flown([4, seed])
        noise_growth = 1.0 + GROWTH * np.repeat(longer(flown, APART)[:, :, None], 2, axis=2)
        for weighed, one in ((False, flown), (True, replace(flown, noise_growth=noise_growth))):
            fit = fit_output_error(one, start=truth, held={"az0": 0.0})
            off[weighed].append((fit.estimate - truth)[fit.sd > 0.0])
        sd.append(fit.sd[fit.sd > 0.0])
    np.testing.assert_allclose(fit.R, [NOISE[name] ** 2 for name in ("alpha", "q")], rtol=0.3)
    residual = (fit.columns[0, :, :, 0] * noise_growth[0])[:N]
    np.testing.assert_allclose(fit.rms[0], np.sqrt(np.mean(residual**2, axis=0)))
    ratio = np.mean(np.square(off[True]), axis=0) / np.mean(np.square(off[False]), axis=0)
    assert np.median(ratio) < 0.7
    assert 0.8 < np.sqrt(np.mean((np.array(off[True]) / np.array(sd)) ** 2)) < 1.25
    flown, truth = growing_flown(3, 0.0)
    twice = replace(flown, noise_growth=np.full_like(flown.noise_growth, 2.0))
    plain, scaled = (fit_output_error(f, start=truth, held={"az0": 0.0}) for f in (flown, twice))
    np.testing.assert_allclose(scaled.estimate, plain.estimate, rtol=1e-6)
    np.testing.assert_allclose(scaled.sd, plain.sd, rtol=1e-6)
    np.testing.assert_allclose(4.0 * scaled.R, plain.R, rtol=1e-8)
    assert scaled.cost == pytest.approx(plain.cost, rel=1e-9)
