"""Settings of a trajectory fit, and noise that grows as the flow separates."""

import json
import tomllib
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight
from scipy.linalg import expm

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.diagnosis.trajectories.results import FITTED
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.linear import linear_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.dynamics.system import integrate
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import NO_AIRCRAFT
from bayes_aero.flight.card.card import parse_card, shipped_cards
from bayes_aero.inference.likelihood.output_error import MAX_GROWTH, SeparatedFlow, fit_output_error, trajectories
from bayes_aero.jobs.fly import fly
from bayes_aero.jobs.io.fly_json import fly_results
from bayes_aero.jobs.provenance import as_json
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.physics.filters import differentiate
from bayes_aero.report.tables.fly import parameter_rows
from bayes_aero.report.text.fly import fly_sentences

# Settings of a trajectory fit: fixed initial states, no priors, held inputs, outputs on request, priors per rate
NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15}
BEGIN = (0.04, 0.01)
SYSTEM = (
    np.array([[SHORT_PERIOD_TRUTH["Zalpha"], 1.0], [SHORT_PERIOD_TRUTH["Malpha"], SHORT_PERIOD_TRUTH["Mq"]]]),
    np.array(
        [[SHORT_PERIOD_TRUTH["Zde"], SHORT_PERIOD_TRUTH["Z0"]], [SHORT_PERIOD_TRUTH["Mde"], SHORT_PERIOD_TRUTH["M0"]]]
    ),
)


def noisy(seed, name="flight", **changes):
    channels = short_period_flight(SHORT_PERIOD_TRUTH, n=200, x0=BEGIN) | changes
    return record_of(channels, noise=NOISE, rng=np.random.default_rng(seed), name=name)


def flown_of(record, card=None, **options):
    card = card or card_of(SHORT_PERIOD)
    dynamics = linear_dynamics(card)
    return segments(join([record], card, dynamics.inputs), dynamics, **options)


def test_a_fixed_initial_state_is_flown_and_given_no_freedom():
    """The true one; estimates are those of a fit with its departure held by force, a prior of no width."""
    flown = flown_of(noisy(4), fixed=dict(zip(("alpha", "q"), BEGIN, strict=True)))
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
    free = fit_output_error(flown_of(noisy(4)))
    assert np.all(found.crb <= free.crb * 1.02)  # a state that is known leaves more to say of the rest
    record = noisy(4)
    flown = flown_of(record, fixed={"q": 0.02})
    theta = jnp.asarray([p.start for p in flown.dynamics.free])
    begin = trajectories(flown, theta, jnp.zeros((1, 2))).trajectory.states[0, 0]
    np.testing.assert_array_equal(begin, [record["alpha"][0], 0.02])
    with pytest.raises(InputError, match="az, which is no state of the model; there are alpha, q"):
        flown_of(noisy(4), fixed={"az": 1.0})


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
    record = record_of({"alpha": states[:, 0], "q": states[:, 1], "elevator": u})
    off = {}
    for held in (True, False):
        found = fit_output_error(flown_of(record, outputs=("alpha", "q"), held=held))
        off[held] = abs(found.estimate[found.names.index("Mde")] - SHORT_PERIOD_TRUTH["Mde"])
    assert off[True] < 1e-3
    assert off[False] > 10.0 * off[True]


def test_without_priors_nothing_but_the_record_counts():
    """An elevator at rest: its two derivatives; all else is known as well as if they were not there."""
    channels = short_period_flight(SHORT_PERIOD_TRUTH | {"Zde": 0.0, "Mde": 0.0}, n=200, x0=(0.1, -0.1))
    record = record_of(channels | {"elevator": np.zeros(200)}, noise=NOISE, rng=np.random.default_rng(3))
    found = fly([record], card_of(SHORT_PERIOD), priors=False)
    fit = found.flown.fit
    assert set(fit.undetermined) == {"Zde", "Mde"}
    assert fit.held_by_prior == ()
    rows = parameter_rows(found.flown)
    for name, row in rows.items():
        assert row["undetermined"] == (name in fit.undetermined)
        assert np.isinf(row["sd_corrected"]) == row["undetermined"]
        assert row["prior"] is None
        if not row["undetermined"]:
            assert abs(row["estimate"] - SHORT_PERIOD_TRUTH[name]) < 4.0 * row["sd_corrected"], name
    assert any("do not determine Zde and Mde" in line for line in fly_sentences(found.flown))
    told = json.loads(as_json(fly_results(found, card_of(SHORT_PERIOD), [record], {})))
    assert told["parameters"]["Mde"]["sd_corrected"] is None
    assert told["setting"] == {"initial_state": "free", "priors": False, "inputs": "linear"}
    table = tomllib.loads(SHORT_PERIOD)
    table["parameters"] = {"Mq": {"prior": {"family": "normal", "location": 5.0, "scale": 0.001}}}
    wrong = parse_card(table, "x", "x.toml")
    record = noisy(4)
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
    record = noisy(4)
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
    card, rng = card_of(SHORT_PERIOD), np.random.default_rng(seed)
    channels = short_period_flight(SHORT_PERIOD_TRUTH, n=N)
    for name, level in SWELL_NOISE.items():
        channels[name] = channels[name] + level * (1.0 + growth * APART) * rng.standard_normal(N)
    dynamics = linear_dynamics(card)
    flown = segments(join([record_of(channels)], card, dynamics.inputs), dynamics, outputs=("alpha", "q"))
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
