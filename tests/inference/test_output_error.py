"""Output error on flights whose truth is known: recovery, intervals, and what it says where it cannot tell."""

from dataclasses import replace

import equinox as eqx
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
    multistep,
    record_of,
    short_period_flight,
)
from scipy.signal import lfilter

from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import LinearFit, calibration
from bayes_aero.inference.output_error import fit_cascade, fit_output_error, trajectories
from bayes_aero.inference.output_error_result import INITIAL_STATE_SD, NormalEquations, NormalPriors, OutputErrorStatus
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join
from bayes_aero.parameter import Prior

# Output error on flights whose truth is known: recovery, intervals, and what it says where it cannot tell
NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15, "p": 0.004, "r": 0.003, "p_dot": 0.03}


def flown_of(text, channels, seed, outputs=None, dt=0.04, **options):
    card = card_of(text)
    dynamics = linear_dynamics(card)
    record = record_of(channels, dt, NOISE, np.random.default_rng(seed))
    return segments(join([record], card, dynamics.inputs), dynamics, outputs=outputs, **options)


def scores(found, truth):
    return (found.estimate - np.array([truth[name] for name in found.names])) / found.sd


@pytest.fixture(scope="module")
def short_period():
    whole, windows = (flown_of(SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH), 1, window=w) for w in (None, 2.0))
    start = np.array([p.start for p in whole.dynamics.free])
    assert not start.any()
    return whole, fit_cascade([windows, whole], [start])


@pytest.fixture(scope="module")
def lateral():
    return fit_output_error(flown_of(LATERAL, lateral_flight(LATERAL_TRUTH), 2))


def test_short_period_and_lateral_motion_are_recovered(short_period, lateral):
    _, found = short_period
    assert found.status is OutputErrorStatus.CONVERGED
    assert set(found.names) == set(SHORT_PERIOD_TRUTH)
    assert np.all(np.abs(scores(found, SHORT_PERIOD_TRUTH)) < 4.0)
    for name in ("Zalpha", "Malpha", "Mq", "Mde"):
        k = found.names.index(name)
        assert found.estimate[k] == pytest.approx(SHORT_PERIOD_TRUTH[name], rel=0.05)
    np.testing.assert_allclose(np.sqrt(found.R), [NOISE[name] for name in found.flown.outputs], rtol=0.1)
    assert found.held_by_prior == ()
    assert lateral.status is OutputErrorStatus.CONVERGED
    assert np.all(np.abs(scores(lateral, LATERAL_TRUTH)) < 4.0)
    for name in ("Lp", "Lda", "Nr", "Nbeta"):
        k = lateral.names.index(name)
        assert lateral.estimate[k] == pytest.approx(LATERAL_TRUTH[name], rel=0.1)


def test_it_stopped_at_the_optimum(short_period):
    """det R, formed anew from the matrix exponential, is no smaller a deviation to either side."""
    _, found = short_period
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


def test_the_extrapolated_last_step_is_that_of_a_simulation(short_period, lateral):
    """The last step is extrapolated, not evaluated."""
    for found in (short_period[1], lateral):
        flown = trajectories(found.flown, jnp.asarray(found.estimate), jnp.asarray(found.departure)).residual
        inside = found.flown.inside
        told = (found.columns[..., 0] * found.flown.noise_growth)[inside]
        np.testing.assert_array_less(
            np.abs(told - np.asarray(flown)[inside]), 1e-3 * np.sqrt(found.R) + np.zeros_like(told)
        )
        np.testing.assert_allclose(np.mean(told**2, axis=0), found.R, rtol=1e-6)


def test_the_extrapolation_of_initial_states_is_exact_where_the_system_is_linear():
    flown = flown_of(SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH), 3, window=4.0)
    rng = np.random.default_rng(4132)
    theta = np.array([SHORT_PERIOD_TRUTH[p.name] for p in flown.dynamics.free])
    w, s = flown.index.shape[0], len(flown.dynamics.states)
    equations, steps = NormalEquations(flown, NormalPriors.of(flown, 1.0)), 0.02 * rng.standard_normal((2, w, s))
    here, there = equations.evaluate(theta, steps[0]), equations.evaluate(theta, steps[0] + steps[1])
    found = equations.extrapolate(here, np.zeros(len(theta)), steps[1])
    assert abs(there.cost - here.cost) > 1.0
    assert found.cost == pytest.approx(there.cost, rel=1e-9)
    states = [0, *range(1 + len(theta), 1 + len(theta) + s)]  # sensitivities to parameters do change
    gram, seen = (point.products.gram[:, :, 0, states] for point in (found, there))
    np.testing.assert_allclose(gram, seen, rtol=1e-6, atol=1e-9)
    for a, b in zip(found.products.columns, there.products.columns, strict=True):
        np.testing.assert_allclose(a[..., 0], b[..., 0], atol=1e-9)


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


def test_an_aircraft_that_cannot_fly_the_record_is_said(card):
    """Held at a strong static instability the simulation tumbles; every number that is reported is one."""
    n = 400
    rest = np.zeros(n)
    channels = {
        "airspeed": rest + 100.0, "alpha": rest + 0.08, "theta": rest + 0.08, "q": rest, "altitude": rest + 4000.0,
        "elevator": multistep(n, 0.04, 1.0, 0.5, 0.03), "thrust_left": rest + 1e4, "thrust_right": rest + 1e4,
    } | dict.fromkeys(("p", "r", "beta", "phi", "ay", "p_dot", "r_dot"), rest)  # fmt: skip
    model = Model.of(["attached_lift", "elevator_moment", "pitching_moment", "profile_drag"])
    flights = join([FlightRecord.from_arrays("tumble", np.arange(n) * 0.04, channels)], card, ())
    dynamics = aircraft_dynamics(model, flights)
    flown = segments(flights, dynamics)
    values = {"CL0": 0.2, "CLa": 4.5, "Cmde": -0.8, "Cm0": 0.05, "Cma": 8.0, "CD0": 0.04}
    found = fit_output_error(flown, held=values)
    assert found.status is OutputErrorStatus.LEFT_ENVELOPE
    assert "cannot be simulated" in found.status.value
    for array in (found.estimate, found.departure, found.R, found.rms, found.covariance):
        assert np.all(np.isfinite(array))
    assert np.isfinite(found.cost)


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
def test_corrected_intervals_cover_the_truth_under_coloured_noise():
    """AR(1) noise of rho 0.9: 95 % intervals that take it for white hold the truth far less often than they say."""
    truth = {name: x for name, x in SHORT_PERIOD_TRUTH.items() if name != "az0"}
    white, corrected = [], []
    for seed in range(60):
        found = fit_output_error(coloured_flown([9, seed], 0.9), held={"az0": 0.0})
        assert found.status is OutputErrorStatus.CONVERGED
        own = [found.names.index(name) for name in truth]
        off = np.abs(found.estimate[own] - np.array(list(truth.values())))
        white.append(off < 1.96 * found.sd[own])
        corrected.append(off < 1.96 * found.sd_corrected[own])
    assert np.mean(white) < 0.6
    assert 0.90 <= np.mean(corrected) <= 0.98  # standard error 0.016 over the flights


def test_corrected_deviations_are_nearly_the_plain_ones_under_white_noise():
    """On average: wider by what the estimated autocovariance is uncertain alone."""
    fits = [fit_output_error(coloured_flown([8, seed], 0.0), held={"az0": 0.0}) for seed in range(12)]
    own = [k for k, name in enumerate(fits[0].names) if name != "az0"]
    ratio = np.mean([(found.sd_corrected / np.where(found.sd > 0, found.sd, 1.0))[own] for found in fits], axis=0)
    assert np.all((ratio > 0.95) & (ratio < 1.15))


def linear_fit(S, own):
    """Of one output with variance 1: one parameter, and initial states without a prior."""
    n, S, own = len(S), np.reshape(S, (1, -1, 1, 1)), np.reshape(own, (1, len(S), 1, -1))
    states = np.linalg.pinv(own[0, :, 0]) @ S[0, :, 0]
    S = S - own @ states
    D = 1.0 / np.sum(S**2, axis=(0, 1))
    return LinearFit(D, S, own, np.zeros(own.shape[3]), np.ones(1), np.ones((1, n), bool))


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_corrected_intervals_of_a_mean_hold_95_percent(rho):
    """Of 400 first-order autoregressions; by the autocovariance alone they hold less, however long the record."""
    rng, n, inside = np.random.default_rng(14), 200, []
    fit = linear_fit(np.ones(n), np.zeros((n, 0)))
    for _ in range(400):
        noise = np.asarray(lfilter([1.0], [1.0, -rho], rng.standard_normal(n + 100)))[100:]
        residual = (noise - noise.mean())[None, :, None]
        plain = fit.corrected(residual)[0]
        sd = np.sqrt(np.array([1.0, calibration(fit, residual, 0.2)[0]]) * plain)
        inside.append(abs(noise.mean()) < 1.96 * sd)
    plain, calibrated = np.mean(inside, axis=0)
    assert plain < 0.92
    assert calibrated == pytest.approx(0.95, abs=3.0 * np.sqrt(0.95 * 0.05 / 400))


def test_what_a_fit_takes_out_of_a_random_walk_is_in_its_corrected_variance():
    """The slope of a random walk of intensity 1 over T has the variance 6 / (5 T); 6 % of it shows in the residuals."""
    rng, n, dt, plain, calibrated, slopes = np.random.default_rng(15), 100, 0.2, [], [], []
    fit = linear_fit(dt * (np.arange(n) + 0.5), np.ones((n, 1)))  # a state that keeps every disturbance
    for _ in range(150):
        walk = np.cumsum(np.sqrt(dt) * rng.standard_normal(n))[None, :, None]
        slopes.append(np.sum(fit.weights[..., 0] * walk))
        residual = fit.residual(walk)
        plain.append(fit.corrected(residual)[0])
        calibrated.append(plain[-1] * calibration(fit, residual, dt)[0])
    exact = 6.0 / (5.0 * n * dt)
    assert np.mean(np.square(slopes)) == pytest.approx(exact, rel=0.35)  # three standard errors
    assert np.mean(plain) < 0.1 * exact
    assert 0.6 * exact < np.mean(calibrated) < 1.7 * exact


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


def test_a_prior_that_holds_a_parameter_is_its_corrected_deviation_too():
    """The colour of residuals says nothing of what the record does not move."""
    found = fit_output_error(coloured_flown(3, 0.9), prior_weight=7.0)
    k = found.names.index("az0")
    prior = next(p.prior.scale for p in found.parameters if p.name == "az0")
    assert found.sd_corrected[k] == pytest.approx(prior, rel=1e-6)


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


def test_a_second_of_flight_without_input_is_fitted_and_says_what_it_cannot_tell():
    """25 samples before the elevator moves: numbers are finite, and its derivatives are held by their priors."""
    found = fit_output_error(flown_of(SHORT_PERIOD, short_period_flight(SHORT_PERIOD_TRUTH, n=25), 6, ("alpha", "q")))
    assert found.status is OutputErrorStatus.CONVERGED
    assert {"Zde", "Mde", "az0"} <= set(found.held_by_prior)
    for array in (found.estimate, found.sd, found.sd_corrected, found.departure, found.rms):
        assert np.all(np.isfinite(array))


@pytest.mark.verify
def test_cramer_rao_intervals_cover_the_truth():
    """A hundred flights with new noise: 95 % intervals hold the truth as often as they say."""
    truth = {name: x for name, x in SHORT_PERIOD_TRUTH.items() if name != "az0"}
    channels, inside = short_period_flight(SHORT_PERIOD_TRUTH, n=400), []
    for seed in range(100):
        found = fit_output_error(flown_of(SHORT_PERIOD, channels, [7, seed], ("alpha", "q")), held={"az0": 0.0})
        assert found.status is OutputErrorStatus.CONVERGED
        own = [found.names.index(name) for name in truth]
        sd = fit_crb(found, own)
        inside.append(np.abs(found.estimate[own] - np.array(list(truth.values()))) < 1.96 * sd)
    share = np.mean(inside, axis=0)
    assert np.all((share >= 0.88) & (share <= 0.99)), dict(zip(truth, share, strict=True))
    assert 0.92 <= np.mean(inside) <= 0.98


def fit_crb(found, own):
    """Cramer-Rao deviations of the parameters `own`, from the data's information alone."""
    return np.sqrt(np.diag(np.linalg.inv(found.information[np.ix_(own, own)])))


# The linear cards that are shipped: from their starts to the truth of flights by the matrix exponential
SHIPPED_NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15, "p": 0.004, "r": 0.003}
SPEED = 90.0  # m/s, of the flight by which az follows alpha
TRUTH = {
    "short_period": SHORT_PERIOD_TRUTH
    | {"azalpha": SPEED * SHORT_PERIOD_TRUTH["Zalpha"], "azde": SPEED * SHORT_PERIOD_TRUTH["Zde"]},
    "lateral": LATERAL_TRUTH | {"Nda": 0.0},
}
FLIGHT = {"short_period": short_period_flight, "lateral": lateral_flight}


@pytest.mark.parametrize("name", TRUTH)
def test_it_recovers_the_truth(name):
    card, truth = read_card(name), TRUTH[name]
    dynamics = linear_dynamics(card)
    channels = {c.name for c in card.channels}
    true = {k: x for k, x in FLIGHT[name](truth).items() if k in channels}
    record = record_of(true, 0.04, SHIPPED_NOISE, np.random.default_rng(5))
    found = fit_output_error(segments(join([record], card, dynamics.inputs), dynamics))
    assert found.status is OutputErrorStatus.CONVERGED
    assert set(found.names) == set(truth)
    off = (found.estimate - np.array([truth[n] for n in found.names])) / found.sd
    assert np.all(np.abs(off) < 4.0), dict(zip(found.names, off, strict=True))
