"""Fits of flights whose truth is known by every engine; output error: intervals, settings, and what it cannot tell."""

import tomllib
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from linear_cards import (
    LATERAL,
    LATERAL_TRUTH,
    SHORT_PERIOD,
    SHORT_PERIOD_TRUTH,
    card_of,
    lateral_flight,
    record_of,
    short_period_flight,
)
from scipy.linalg import expm
from scipy.signal import lfilter

from bayes_aero.diagnosis.result import FITTED
from bayes_aero.diagnosis.selection_state import candidate_model
from bayes_aero.dynamics.flight import aircraft_dynamics, linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.dynamics.system import integrate
from bayes_aero.errors import InputError
from bayes_aero.flight.card import parse_card, shipped_cards
from bayes_aero.inference.frequency import linear_in_band
from bayes_aero.inference.output_error import (
    INITIAL_STATE_SD,
    MAX_GROWTH,
    SeparatedFlow,
    fit_cascade,
    fit_output_error,
    trajectories,
)
from bayes_aero.inference.prediction_error import fit_prediction_error
from bayes_aero.inference.results import OutputErrorStatus
from bayes_aero.jobs.fly import fly
from bayes_aero.jobs.results import fly_results
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join
from bayes_aero.parameter import Prior
from bayes_aero.physics.aircraft import NO_AIRCRAFT
from bayes_aero.physics.filters import differentiate
from bayes_aero.report.pages.fly import fly_sentences, parameter_rows

# Output error on flights whose truth is known: recovery, intervals, and what it says where it cannot tell
NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15, "p": 0.004, "r": 0.003, "p_dot": 0.03}


def noisy(channels, seed, name="linear"):
    """A record of these true channels; with white noise unless the seed is None."""
    return record_of(channels, 0.04, NOISE, None if seed is None else np.random.default_rng(seed), name)


def flown_of(text, channels, seed, outputs=None, **options):
    card = card_of(text)
    dynamics = linear_dynamics(card)
    return segments(join([noisy(channels, seed)], card, dynamics.inputs), dynamics, outputs=outputs, **options)


def by_output_error(flown):
    found = fit_output_error(flown)
    return found, found.sd


def with_process_noise(flown):
    known = fit_output_error(flown)
    F = np.full(len(flown.dynamics.states), 0.01)
    found = fit_prediction_error(flown, F, known.R, start=known.estimate, priors=False)
    return found, found.sd


def in_a_band(flown):
    found = linear_in_band(flown.flights, flown.dynamics, (0.1, 1.5))[0][1]
    return found, found.crb_corrected


ENGINES = [by_output_error, with_process_noise, in_a_band]
SPEED = 90.0  # m/s, of the flight by which az follows alpha
SHIPPED_TRUTH = SHORT_PERIOD_TRUTH | {
    "azalpha": SPEED * SHORT_PERIOD_TRUTH["Zalpha"], "azde": SPEED * SHORT_PERIOD_TRUTH["Zde"]
}  # fmt: skip
PROBLEMS = {  # a card, shipped or its text, a flight by the matrix exponential, the truth, and what is known to 10 %
    "short period": (SHORT_PERIOD, short_period_flight, SHORT_PERIOD_TRUTH, ("Zalpha", "Malpha", "Mq", "Mde")),
    "lateral motion": (LATERAL, lateral_flight, LATERAL_TRUTH, ("Lp", "Lda", "Nr", "Nbeta")),
    "short_period": (None, short_period_flight, SHIPPED_TRUTH, ("Zalpha", "Malpha", "Mq", "Mde")),
    "lateral": (None, lateral_flight, LATERAL_TRUTH | {"Nda": 0.0}, ("Lp", "Lda", "Nr", "Nbeta")),
}


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("engine", ENGINES)
def test_the_truth_comes_back(engine, problem):
    text, fly, truth, known = PROBLEMS[problem]
    text = text or shipped_cards()[problem].read_text()
    mapped = {c.name for c in card_of(text).channels}
    flown = flown_of(text, {name: x for name, x in fly(truth).items() if name in mapped}, 2)
    found, sd = engine(flown)
    assert {*found.names, *getattr(found, "unseen", ())} == set(truth)
    off = {n: (x - truth[n]) / s for n, x, s in zip(found.names, found.estimate, sd, strict=True) if s > 0.0}
    assert max(map(abs, off.values())) < 4.0, off
    for name in known:
        assert found.estimate[found.names.index(name)] == pytest.approx(truth[name], rel=0.1), name


@pytest.fixture(scope="module")
def short_period():
    whole, windows = (flown_of(SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH), 1, window=w) for w in (None, 2.0))
    start = np.array([p.start for p in whole.dynamics.free])
    assert not start.any()
    return whole, fit_cascade([windows, whole], [start])


def test_it_stopped_at_the_optimum(short_period):
    """det R, formed anew from the matrix exponential, is no smaller a deviation to either side."""
    _, found = short_period
    assert found.status is OutputErrorStatus.CONVERGED
    assert found.held_by_prior == ()
    np.testing.assert_allclose(np.sqrt(found.R), [NOISE[name] for name in found.flown.outputs], rtol=0.1)
    measured = {name: np.asarray(found.flown.flights.channels[name]) for name in ("alpha", "q", "az")}
    x0 = [np.polynomial.Polynomial.fit(np.arange(13), measured[name][:13], 1)(0) for name in ("alpha", "q")]
    x0 = np.array(x0) + found.departure[0]

    def cost(values):
        true = short_period_flight(dict(zip(found.names, values, strict=True)), x0=x0)
        return 250.0 * sum(np.log(np.mean((measured[name] - true[name]) ** 2)) for name in measured)

    here = cost(found.estimate)
    for k, sd in enumerate(found.sd):
        for sign in (1.0, -1.0):
            moved = found.estimate.copy()
            moved[k] += sign * sd
            assert cost(moved) > here + 0.3, found.names[k]


def test_the_extrapolated_last_step_is_that_of_a_simulation(short_period):
    """The last step is extrapolated, not evaluated."""
    _, found = short_period
    flown = trajectories(found.flown, jnp.asarray(found.estimate), jnp.asarray(found.departure)).residual
    inside = found.flown.inside
    told = (found.columns[..., 0] * found.flown.noise_growth)[inside]
    np.testing.assert_array_less(
        np.abs(told - np.asarray(flown)[inside]), 1e-3 * np.sqrt(found.R) + np.zeros_like(told)
    )
    np.testing.assert_allclose(np.mean(told**2, axis=0), found.R, rtol=1e-6)


def test_deviations_are_those_of_a_fisher_information_by_differences():
    """Cramer-Rao at the estimate by differences of the matrix exponential, the initial state unknown as in the fit.

    Four seconds only: there the initial state costs Zalpha two fifths of its precision.
    """
    channels = short_period_flight(SHORT_PERIOD_TRUTH, n=100, x0=(0.1, -0.1))
    found = fit_output_error(flown_of(SHORT_PERIOD, channels, 3, ("alpha", "q")), held={"az0": 0.0})
    names = [name for name in found.names if name != "az0"]
    at = jnp.asarray(found.estimate), jnp.asarray(found.departure)
    x0 = np.asarray(trajectories(found.flown, *at).trajectory.states)[0, 0]
    base = np.array([*(found.estimate[found.names.index(name)] for name in names), *x0])

    def respond(v):
        flight = short_period_flight({"az0": 0.0} | dict(zip(names, v[:-2], strict=True)), n=100, x0=v[-2:])
        return np.concatenate([flight[name] / np.sqrt(R) for name, R in zip(("alpha", "q"), found.R, strict=True)])

    S = np.stack([(respond(base + step) - respond(base - step)) / 2e-6 for step in 1e-6 * np.eye(len(base))], axis=1)
    start = [INITIAL_STATE_SD[name] ** -2 for name in ("alpha", "q")]  # what the sensors say of the initial state
    information = S.T @ S + np.diag([*np.zeros(len(names)), *start])
    expected = np.sqrt(np.diag(np.linalg.inv(information)))[:-2]
    got = [found.sd[found.names.index(name)] for name in names]
    np.testing.assert_allclose(got, expected, rtol=0.01)


def test_what_the_record_does_not_move_and_what_is_held(short_period):
    prior = """
    [parameters.Mde]
    start = 0.0
    prior = { family = "normal", location = -2.5, scale = 0.7 }
    [parameters.Zde]
    prior = { family = "normal", location = 0.1, scale = 0.3 }
    """
    text = SHORT_PERIOD.replace('M0 = "1"\n', "").replace('Z0 = "1"\n', "")
    truth = SHORT_PERIOD_TRUTH | {"Z0": 0.0, "M0": 0.0}
    free = short_period_flight(truth | {"Zde": 0.0, "Mde": 0.0}, x0=(0.08, -0.05))
    free["elevator"] = np.zeros(len(free["elevator"]))
    found = fit_output_error(flown_of(text + prior, free, 4, ("alpha", "q")))
    assert set(found.held_by_prior) == {"Zde", "Mde", "az0"}  # az is not compared here
    estimate = dict(zip(found.names, found.estimate, strict=True))
    assert estimate["Mde"] == pytest.approx(-2.5, abs=1e-6)
    assert estimate["Zde"] == pytest.approx(0.1, abs=1e-6)
    for name, deviation in {"Mde": 0.7, "Zde": 0.3}.items():
        assert found.sd[found.names.index(name)] == pytest.approx(deviation, rel=1e-6)
        assert found.crb[found.names.index(name)] == np.inf
        assert found.sd_corrected[found.names.index(name)] == pytest.approx(deviation, rel=1e-6)
    for name in ("Zalpha", "Malpha", "Mq"):
        k = found.names.index(name)
        assert abs(found.estimate[k] - truth[name]) < 4.0 * found.sd[k] < 0.4 * abs(truth[name])
    assert "Mde" not in short_period[1].held_by_prior
    flown, free = short_period
    found = fit_output_error(flown, start=free.estimate, held={"Mde": -2.0})
    k = found.names.index("Mde")
    assert found.estimate[k] == -2.0
    assert found.sd[k] == 0.0
    assert found.status is OutputErrorStatus.CONVERGED
    assert "Mde" not in found.at_bound
    assert found.cost > free.cost + 10.0
    others = [i for i in range(len(found.names)) if i != k]
    assert np.any(np.abs(found.estimate - free.estimate)[others] > 3.0 * free.sd[others])


def test_segments_that_do_not_count_have_no_say(short_period):
    """Fitted beside masked segments, a window gives what it gives alone, and the others keep their measured state."""
    _, free = short_period
    windows = flown_of(SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH), 1, window=8.0)
    first = np.arange(len(windows.index)) == 0
    masked = eqx.tree_at(lambda f: f.inside, windows, windows.inside & first[:, None])
    beside, alone = (fit_output_error(f, start=free.estimate) for f in (masked, windows.part([0])))
    np.testing.assert_allclose(beside.estimate, alone.estimate, rtol=1e-6)
    np.testing.assert_allclose(beside.sd, alone.sd, rtol=1e-6)
    assert beside.cost == pytest.approx(alone.cost, rel=1e-9)
    assert not beside.departure[~first].any()
    assert beside.columns.shape[:2] == windows.index.shape
    assert not beside.columns[~first].any()


def test_a_bound_in_the_way_is_said_and_a_bias_of_nothing_refused():
    text = SHORT_PERIOD + "\n[parameters.Mq]\nstart = -0.3\nbounds = [-0.8, 0.0]\n"
    flown = flown_of(text, short_period_flight(SHORT_PERIOD_TRUTH), 1)
    found = fit_output_error(flown, start=np.array([SHORT_PERIOD_TRUTH[name] for name in flown.dynamics.names]))
    assert found.status is OutputErrorStatus.AT_BOUND
    assert found.at_bound == ("Mq",)
    assert found.estimate[found.names.index("Mq")] == -0.8
    with pytest.raises(InputError, match="altitude cannot have a bias"):
        fit_output_error(coloured_flown(5, 0.0), biases={"altitude": Prior("normal", 0.0, 1.0)})


def test_an_aircraft_that_cannot_fly_the_record_is_said():
    """Held at a static instability that doubles every 50 ms; every number that is reported is one."""
    text = SHORT_PERIOD.replace("Zq = 1.0", "Zq = 1.0\nMalpha = 200.0")
    found = fit_output_error(flown_of(text, short_period_flight(SHORT_PERIOD_TRUTH), 1))
    assert found.status is OutputErrorStatus.LEFT_ENVELOPE
    assert "cannot be simulated" in found.status.value
    for array in (found.estimate, found.departure, found.R, found.rms, found.covariance, found.cost):
        assert np.all(np.isfinite(array))


def coloured_flown(seed, rho, n=500, biases=(0.0,)):
    """Flights with AR(1) noise of the usual deviations on alpha and q, a constant error of alpha in each."""
    card, rng = card_of(SHORT_PERIOD), np.random.default_rng(seed)
    dynamics = linear_dynamics(card)
    records = []
    for number, bias in enumerate(biases):
        channels = short_period_flight(SHORT_PERIOD_TRUTH, n=n, x0=(0.04, 0.01 - 0.03 * number))
        for name in ("alpha", "q"):
            white = rng.standard_normal(n) * np.append(1.0, np.full(n - 1, np.sqrt(1.0 - rho**2)))
            channels[name] = channels[name] + NOISE[name] * lfilter([1.0], [1.0, -rho], white)
        channels["alpha"] = channels["alpha"] + bias
        records.append(record_of(channels, name=f"flight {number}"))
    return segments(join(records, card, dynamics.inputs), dynamics, outputs=("alpha", "q"))


@pytest.mark.verify
@pytest.mark.parametrize(("rho", "flights"), [(0.0, 100), (0.9, 60)])
def test_intervals_cover_the_truth(rho, flights):
    """95 % intervals hold the truth as often as they say; of coloured noise those that take it for white do not."""
    truth = {name: x for name, x in SHORT_PERIOD_TRUTH.items() if name != "az0"}
    inside = {"crb": [], "sd_corrected": []}
    for seed in range(flights):
        found = fit_output_error(coloured_flown([9, seed], rho), held={"az0": 0.0})
        assert found.status is OutputErrorStatus.CONVERGED
        own = [found.names.index(name) for name in truth]
        off = np.abs(found.estimate[own] - np.array(list(truth.values())))
        for kind, held in inside.items():
            held.append(off < 1.96 * getattr(found, kind)[own])
    share = np.mean(inside["sd_corrected" if rho else "crb"], axis=0)
    assert rho or np.all((share >= 0.88) & (share <= 0.99)), dict(zip(truth, share, strict=True))
    assert 0.90 + 0.02 * (rho == 0.0) <= np.mean(share) <= 0.98  # standard error 0.016 over the coloured flights
    assert np.mean(inside["crb"]) < 0.6 or not rho


def test_what_one_stretch_alone_tells_has_a_corrected_deviation_of_its_size():
    """A constant error of alpha shows, beside Z0 and M0, only while the motion from a known state dies away."""
    flown = replace(coloured_flown(12, 0.9), fixed=(("alpha", 0.04), ("q", 0.01)))
    biases = {"alpha": Prior("normal", 0.0, 0.1), "q": Prior("normal", 0.0, 0.1)}
    found = fit_output_error(flown, held={"az0": 0.0}, prior_weight=0.0, biases=biases)
    assert found.status is OutputErrorStatus.CONVERGED
    truth = SHORT_PERIOD_TRUTH | {"bias_alpha_1": 0.0, "bias_q_1": 0.0, "az0": 0.0}
    for name, at, crb, sd in zip(found.names, found.estimate, found.crb, found.sd_corrected, strict=True):
        if name != "az0":
            assert abs(at - truth[name]) < 4.0 * sd, name
            assert crb < sd < 20.0 * crb, name


def test_biases_of_manoeuvres_are_recovered_and_free_the_parameters():
    """An alpha vane that stands off by another constant in each flight."""
    flown = coloured_flown(5, 0.0, biases=(0.02, -0.015))
    start = np.array([SHORT_PERIOD_TRUTH[name] for name in flown.dynamics.names])
    plain = fit_output_error(flown, start=start, held={"az0": 0.0})
    found = fit_output_error(flown, start=start, held={"az0": 0.0}, biases={"alpha": Prior("normal", 0.0, 0.02)})
    assert plain.names == flown.dynamics.names
    assert found.names == (*plain.names, "bias_alpha_1", "bias_alpha_2")
    assert found.status is OutputErrorStatus.CONVERGED
    # A bias that all flights share cannot be told from the constants Z0 and M0; their difference can.
    apart = np.array([*np.zeros(len(plain.names)), 1.0, -1.0])
    deviation = np.sqrt(apart @ found.covariance @ apart)
    assert deviation < 0.001
    assert apart @ found.estimate == pytest.approx(0.035, abs=4.0 * deviation)
    for name in ("Zalpha", "Zde", "Malpha", "Mq", "Mde"):
        k = plain.names.index(name)
        assert abs(found.estimate[k] - SHORT_PERIOD_TRUTH[name]) < 4.0 * found.sd[k], name
    k = plain.names.index("Zalpha")  # without biases the slope follows the flights' offsets
    wrong, right = (abs(fit.estimate[k] - SHORT_PERIOD_TRUTH["Zalpha"]) for fit in (plain, found))
    assert wrong > 2.0 * right
    assert plain.sd[k] > 3.0 * found.sd[k]


# Settings of a trajectory fit: fixed initial states, no priors, held inputs, outputs on request, priors per rate
BEGIN = (0.04, 0.01)
SYSTEM = (
    np.array([[SHORT_PERIOD_TRUTH["Zalpha"], 1.0], [SHORT_PERIOD_TRUTH["Malpha"], SHORT_PERIOD_TRUTH["Mq"]]]),
    np.array([[SHORT_PERIOD_TRUTH[name] for name in row] for row in (("Zde", "Z0"), ("Mde", "M0"))]),
)
BRIEF = short_period_flight(SHORT_PERIOD_TRUTH, n=200, x0=BEGIN)


def test_a_fixed_initial_state_is_flown_and_given_no_freedom():
    """The true one; estimates are those of a fit with its departure held by force, a prior of no width."""
    flown = flown_of(SHORT_PERIOD, BRIEF, 4, fixed=dict(zip(("alpha", "q"), BEGIN, strict=True)))
    found = fit_output_error(flown)
    assert np.all(found.departure == 0.0)
    begin = trajectories(flown, jnp.asarray(found.estimate), jnp.asarray(found.departure)).trajectory.states[0, 0]
    np.testing.assert_allclose(begin, BEGIN, rtol=1e-14)
    truth = np.array([SHORT_PERIOD_TRUTH[name] for name in found.names])
    assert np.all(np.abs(found.estimate - truth) < 4.0 * found.sd)
    theta = found.estimate

    def residual(theta):
        return trajectories(flown, theta, jnp.zeros((1, 2))).residual[0]

    J = np.asarray(jax.jacfwd(residual)(jnp.asarray(theta)))
    expected = np.einsum("ncj,c,nck->jk", J, 1.0 / found.R, J)
    np.testing.assert_allclose(found.information, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
    free = fit_output_error(flown_of(SHORT_PERIOD, BRIEF, 4))
    assert np.all(found.crb <= free.crb * 1.02)  # a state that is known leaves more to say of the rest
    flown = flown_of(SHORT_PERIOD, BRIEF, 4, fixed={"q": 0.02})
    theta = jnp.asarray([p.start for p in flown.dynamics.free])
    begin = trajectories(flown, theta, jnp.zeros((1, 2))).trajectory.states[0, 0]
    np.testing.assert_array_equal(begin, [noisy(BRIEF, 4)["alpha"][0], 0.02])
    with pytest.raises(InputError, match="az, which is no state of the model; there are alpha, q"):
        flown_of(SHORT_PERIOD, BRIEF, 4, fixed={"az": 1.0})


def held_flight(u, dt):
    """Angle of attack and pitch rate where the elevator is held between samples: a matrix exponential each."""
    A, B = SYSTEM
    step = expm(np.block([[A, B], [np.zeros((2, 4))]]) * dt)
    x = [np.array(BEGIN)]
    for value in u[:-1]:
        x.append(step[:2] @ [*x[-1], value, 1.0])
    return np.array(x)


def test_held_inputs_are_a_zero_order_hold_and_find_the_truth():
    """Against one matrix exponential a sample; the derivative by the initial state against differences."""
    n, dt = 120, 0.04
    u = np.random.default_rng(2).normal(0.0, 0.03, n)
    A = SYSTEM[0]
    x = held_flight(u, dt)
    dynamics = linear_dynamics(card_of(SHORT_PERIOD))
    system = dynamics.system(SHORT_PERIOD_TRUTH | {"Zq": 1.0}, NO_AIRCRAFT)
    inputs = {"elevator": jnp.asarray(u), "1": jnp.ones(n)}

    def last(start):
        return integrate(system, start, inputs, dt, held=True).states

    np.testing.assert_allclose(last(jnp.array(BEGIN)), x, rtol=0.0, atol=1e-7)
    slope = jax.jvp(last, (jnp.array(BEGIN),), (jnp.array([1.0, 0.0]),))[1]
    np.testing.assert_allclose(slope, [expm(A * dt * k)[:, 0] for k in range(n)], rtol=0.0, atol=1e-6)
    linear = integrate(system, jnp.array(BEGIN), inputs, dt).states
    assert np.abs(linear - x).max() > 1e-3
    # Mde from a digital actuator's record without noise; linear between samples it is off by more.
    n, dt = 200, 0.04
    u = np.repeat(np.random.default_rng(7).normal(0.0, 0.03, n // 10), 10)
    states = held_flight(u, dt)
    channels = {"alpha": states[:, 0], "q": states[:, 1], "elevator": u}
    off = {}
    for held in (True, False):
        found = fit_output_error(flown_of(SHORT_PERIOD, channels, None, ("alpha", "q"), held=held))
        off[held] = abs(found.estimate[found.names.index("Mde")] - SHORT_PERIOD_TRUTH["Mde"])
    assert off[True] < 1e-3
    assert off[False] > 10.0 * off[True]


def test_without_priors_nothing_but_the_record_counts():
    """An elevator at rest: its two derivatives; all else is known as well as if they were not there."""
    channels = short_period_flight(SHORT_PERIOD_TRUTH | {"Zde": 0.0, "Mde": 0.0}, n=200, x0=(0.1, -0.1))
    record = noisy(channels | {"elevator": np.zeros(200)}, 3)
    found = fly([record], card_of(SHORT_PERIOD), priors=False)
    fit = found.flown.fit
    assert set(fit.undetermined) == {"Zde", "Mde"}
    assert fit.held_by_prior == ()
    rows = parameter_rows(found.flown)
    assert set(rows) == set(SHORT_PERIOD_TRUTH)
    for name, row in rows.items():
        assert row["undetermined"] == (name in fit.undetermined)
        assert np.isinf(row["sd_corrected"]) == row["undetermined"]
        assert row["prior"] is None
        if not row["undetermined"]:
            assert abs(row["estimate"] - SHORT_PERIOD_TRUTH[name]) < 4.0 * row["sd_corrected"], name
    assert any("do not determine Zde and Mde" in line for line in fly_sentences(found.flown))
    table = tomllib.loads(SHORT_PERIOD)
    table["parameters"] = {"Mq": {"prior": {"family": "normal", "location": 5.0, "scale": 0.001}}}
    wrong = parse_card(table, "x", "x.toml")
    record = noisy(BRIEF, 4, name="flight")
    found = [fly([record], card, priors=False).flown for card in (card_of(SHORT_PERIOD), wrong)]
    first, second = (one.fit for one in found)
    assert np.all(np.abs(first.estimate - second.estimate) < 0.05 * first.crb)
    np.testing.assert_allclose(first.sd, first.crb, rtol=1e-6)
    rows = parameter_rows(fly([record], wrong).flown)
    assert rows["Mq"]["prior"]["default"] is False
    assert rows["Zde"]["prior"] == {
        "family": "normal", "location": 0.0, "scale": 1000.0, "source": "flat in effect; our choice", "default": True,
    }  # fmt: skip


def test_a_velocity_of_the_card_s_own_may_depart_by_as_much_as_a_velocity():
    """w = V alpha at 100 m/s with 0.3 m/s of noise: the state at the first sample comes right, as it does for alpha."""
    text = SHORT_PERIOD.replace('alpha = { label = "alpha", unit = "deg" }', 'w = { label = "w", unit = "m/s" }')
    card = card_of(text[: text.index("[linear.outputs")].replace('"alpha"', '"w"').replace("rates.alpha", "rates.w"))
    true = short_period_flight(SHORT_PERIOD_TRUTH, n=200, x0=BEGIN)
    w = 100.0 * true["alpha"] + np.random.default_rng(8).normal(0.0, 0.3, 200)
    record = record_of({"w": w, "q": true["q"], "elevator": true["elevator"]}, name="flight")
    found = fly([record], card)
    assert found.flown.initial["flight"]["w"][0] == pytest.approx(100.0 * BEGIN[0], abs=0.15)
    told = fly_results(found, card, [record], {}).initial_states["flight"]
    assert (told["w"].prior_sd, told["q"].prior_sd) == (1.0, 0.01)


def test_outputs_are_those_asked_for_and_det_R_is_theirs():
    record = noisy(BRIEF, 4, name="flight")
    found = fly([record], card_of(SHORT_PERIOD), outputs="alpha, q", initial_state="fixed").flown
    assert found.fit.flown.outputs == ("alpha", "q")
    assert set(found.path("flight", FITTED).errors) == {"alpha", "q", "az"}
    residual = [found.path("flight", FITTED).errors[name].rms for name in ("alpha", "q")]
    assert found.fit.det_R == pytest.approx(np.prod(np.square(residual)), rel=1e-3)
    assert found.initial["flight"]["alpha"] == (pytest.approx(record["alpha"][0]), 0.0)
    with pytest.raises(InputError, match="the output beta was not recorded or is not simulated; there are alpha, q"):
        fly([record], card_of(SHORT_PERIOD), outputs=["beta"])
    with pytest.raises(InputError, match="initial state is 'known'; use free or fixed"):
        fly([record], card_of(SHORT_PERIOD), initial_state="known")


def test_pitch_acceleration_is_an_output_on_request_alone(card, clean_records):
    """The simulated one is the derivative of the simulated pitch rate."""
    record = clean_records[0]
    record = replace(record, channels=dict(record.channels) | {"q_dot": np.zeros(record.n)})
    flights = join([record], card)
    model = Model.from_card(card)
    assert "q_dot" not in aircraft_dynamics(model, flights).outputs
    dynamics = aircraft_dynamics(model, flights, ("q", "q_dot"))
    flown = segments(flights, dynamics, outputs=("q", "q_dot"), window=20.0)
    first = flown.part([0])
    found = trajectories(first, jnp.asarray([p.start for p in dynamics.free]), jnp.zeros((1, len(dynamics.states))))
    q, q_dot = (np.asarray(found.trajectory.outputs[name][0]) for name in ("q", "q_dot"))
    slope = np.asarray(differentiate(jnp.asarray(q), record.dt))
    inner = slice(20, -20)
    assert np.std(q_dot[inner]) > 0.0
    assert np.abs(slope - q_dot)[inner].max() < 0.02 * np.abs(q_dot[inner]).max()


def test_defaults_of_derivatives_per_rate_follow_the_card_s_length(card, clean_records):
    """With half the chord they are twice as large, on the card and for candidates; what the card states stays."""
    table = tomllib.loads(shipped_cards()["attas"].read_text())
    table["aircraft"]["rate_length"] = "1.5795 m"
    half = parse_card(table, "half", "half.toml")
    usual, other = (candidate_model(Model.from_card(c), join(clean_records, c)).model.parameters for c in (card, half))
    scaled = {"Cmq", "CLq", "CLadot", "Cmadot", "CmqX"}
    assert scaled <= {p.name for p in usual}
    for before, after in zip(usual, other, strict=True):
        times = 2.0 if before.name in scaled else 1.0
        assert after.start == pytest.approx(times * before.start), before.name
        assert after.prior.normal == pytest.approx(tuple(times * x for x in before.prior.normal)), before.name
        assert (before.prior.source == after.prior.source) == (before.name not in scaled)
    table["parameters"]["Cmq"] = {"start": -20.0, "prior": {"family": "normal", "location": -20.0, "scale": 5.0}}
    stated = {p.name: p for p in Model.from_card(parse_card(table, "own", "own.toml")).parameters}["Cmq"]
    assert (stated.start, stated.prior.normal) == (-20.0, (-20.0, 5.0))


# Noise of trajectories that grows as the flow separates: its size is found, and what it does to estimates
SWELL_NOISE = {"alpha": 0.002, "q": 0.003}
GROWTH = 9.0
N = 500
APART = np.where((np.arange(N) > 300) & (np.arange(N) < 400), 1.0, 0.0)  # a stall of four seconds


def swell_flown(seed, growth=GROWTH):
    rng, channels = np.random.default_rng(seed), short_period_flight(SHORT_PERIOD_TRUTH, n=N)
    for name, level in SWELL_NOISE.items():
        channels[name] = channels[name] + level * (1.0 + growth * APART) * rng.standard_normal(N)
    flown = flown_of(SHORT_PERIOD, channels, None, ("alpha", "q"))
    return flown, np.array([SHORT_PERIOD_TRUTH[name] for name in flown.dynamics.names])


def swelling(fit):
    return SeparatedFlow(fit.columns[..., 0], np.broadcast_to(APART, fit.flown.inside.shape), fit.flown.inside)


@pytest.mark.parametrize("growth", [GROWTH, 0.0])
def test_the_growth_of_noise_is_found(growth):
    """Of a hundred samples of separated flow a deviation is known to 7 %."""
    flown, truth = swell_flown(4132, growth)
    fit = fit_output_error(flown, start=truth, held={"az0": 0.0})
    found = swelling(fit).growths()
    assert found == pytest.approx(growth, abs=4.0 * 0.08 * (1.0 + growth))
    noise_growth = swelling(fit).noise_growth()
    assert noise_growth.shape == (1, N, 2)
    np.testing.assert_allclose(noise_growth[0, APART == 0.0], 1.0)


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


def test_weighed_estimates_are_nearer_the_truth():
    """Weighted least squares beats plain least squares; R is that of attached flow, rms that of all as recorded."""
    plain, weighed, sd = [], [], []
    for seed in range(20):
        flown, truth = swell_flown([4, seed])
        noise_growth = 1.0 + GROWTH * np.broadcast_to(APART[None, :, None], (1, N, 2))
        for found, one in ((plain, flown), (weighed, replace(flown, noise_growth=noise_growth))):
            fit = fit_output_error(one, start=truth, held={"az0": 0.0})
            own = fit.sd > 0.0
            found.append((fit.estimate - truth)[own])
        sd.append(fit.sd[own])
    np.testing.assert_allclose(fit.R, [x**2 for x in SWELL_NOISE.values()], rtol=0.3)
    residual = fit.columns[0, :, :, 0] * noise_growth[0]
    np.testing.assert_allclose(fit.rms[0], np.sqrt(np.mean(residual**2, axis=0)))
    ratio = np.mean(np.square(weighed), axis=0) / np.mean(np.square(plain), axis=0)
    assert np.median(ratio) < 0.7
    z = np.array(weighed) / np.array(sd)
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.25


def test_a_steady_swell_changes_nothing_but_the_scale_of_R():
    flown, truth = swell_flown(3, 0.0)
    twice = replace(flown, noise_growth=np.full((1, N, 2), 2.0))
    plain, scaled = (fit_output_error(f, start=truth, held={"az0": 0.0}) for f in (flown, twice))
    np.testing.assert_allclose(scaled.estimate, plain.estimate, rtol=1e-6)
    np.testing.assert_allclose(scaled.sd, plain.sd, rtol=1e-6)
    np.testing.assert_allclose(4.0 * scaled.R, plain.R, rtol=1e-8)
    assert scaled.cost == pytest.approx(plain.cost, rel=1e-9)
