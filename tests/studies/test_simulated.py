"""Simulated records: what is hidden, and only that, is in them; truth comes back at any sampling rate."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.dynamics.trim import can_simulate
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.reading import check_record
from bayes_aero.inference.mle import fit_mle
from bayes_aero.jobs.identify import identify
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.model.records import Forming, plain_marks, with_sums
from bayes_aero.simulate.demo import TRUTH, Request
from bayes_aero.simulate.injection import FLOWN_AXES, draw_hidden, flyable, hidden_flights, hidden_records, synthetic

QUIET = {"noise": "white", "sensor_noise": 0.0}
CHANNEL = [e.name for e in CATALOGUE.values() if e.stage is Stage.CHANNEL and e.acts_on(FLOWN_AXES)]
EDGE = 30  # samples at the ends of a record that a delay takes from beyond it, and derivatives from one side


def rms(x) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def beyond_the_model(flight, card) -> dict:
    """Coefficients flown less those of the card's model with the true values, by name."""
    model = Model.of(card.effects)
    values = {p.name: flight.values[p.name] for p in model.parameters}
    signals = {k: jnp.asarray(v) for k, v in (dict(flight.true) | {"alpha_dot": flight.flown["alpha_dot"]}).items()}
    known = model.flow(values, signals, card.aircraft, X=jnp.asarray(flight.flown["X"]))
    return {name: flight.flown[name] - np.asarray(known[name]) for name in ("CL", "CD", "Cm")}


@pytest.mark.parametrize("name", CHANNEL)
def test_corrected_gives_back_what_was_flown(name, card):
    """Recorded plus the hidden effect's increments is true, on a record without noise."""
    rng = np.random.default_rng(3)
    effects = {name: draw_hidden(rng, name)}
    (flight,) = hidden_flights(effects, seed=11, manoeuvres=1, **QUIET)
    record = flight.record
    model = Model.of([name])
    recorded = {key: jnp.asarray(x) for key, x in with_sums(record, card).items()}
    found = model.corrected(effects[name], recorded | plain_marks(record.n, record.dt), card.aircraft)
    changed = 0.0
    for channel in recorded:
        if channel in flight.true:
            size = np.max(np.abs(flight.true[channel])) + 1e-3
            error = np.asarray(found[channel]) - flight.true[channel]
            assert np.max(np.abs(error[EDGE:-EDGE])) < 1e-6 * size, channel
            changed = max(changed, np.max(np.abs(np.asarray(recorded[channel]) - flight.true[channel])) / size)
    assert changed > 1e-4


@pytest.mark.parametrize(
    "names", [("mach_moment", "cg_shift"), ("separation_lag",), ("thrust_scale", "alpha_scale")], ids=" ".join
)
def test_the_true_model_explains_a_quiet_record(names, card):
    """With every hidden value given, the coefficients of the record are the model's; without it they are not."""
    rng = np.random.default_rng(5)
    effects = {name: draw_hidden(rng, name) for name in names}
    flights = hidden_flights(effects, seed=7, **QUIET)
    records = [flight.record for flight in flights]
    chosen = dict.fromkeys((*card.effects, *names))
    model = Model.of(chosen)
    early = [p.name for e in model.effects if e.stage <= Stage.AIRCRAFT for p in e.parameters]
    model = Model.of(chosen, {name: flights[0].values[name] for name in early})
    theta = jnp.asarray([flights[0].values[name] for name in model.names])
    seen = observe(records, card, model)
    error = np.asarray(seen.measured - eqx.filter_jit(model.predicted)(theta, seen.signals, seen.aircraft))
    inner = np.concatenate([(np.arange(r.n) >= EDGE) & (np.arange(r.n) < r.n - EDGE) for r in records])
    for column, limit in enumerate((6e-3, 2e-3, 1e-3)):  # smoothing of alpha over 15 samples in the quickest stall
        assert rms(error[inner, column]) < limit, (column, rms(error[inner, column]))
    flown = np.concatenate([np.stack([f.flown[c] for c in ("CL", "CD", "Cm")], axis=-1) for f in flights])
    for column, limit in enumerate((5e-4, 2e-4, 1e-3)):
        off = rms((np.asarray(seen.measured) - flown)[inner, column])
        assert off < limit, (column, off)


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(k, marks=pytest.mark.verify) for k in range(4, 20))])
def test_flights_stay_in_the_envelope(seed):
    """With nothing hidden and with one effect: alpha, airspeed, and the reader's checks."""
    names = [name for name, effect in CATALOGUE.items() if can_simulate(effect) and effect.acts_on(FLOWN_AXES)]
    plain = hidden_flights({}, seed=seed)
    _, laden = flyable([names[(3 * seed) % len(names)]], seed=seed)
    for flight in (*plain, *laden):
        assert 90.0 <= flight.record.time[-1] <= 100.0
        assert np.all((flight.true["alpha"] > 0.0) & (flight.true["alpha"] < np.deg2rad(25.0)))
        assert np.all((flight.true["airspeed"] > 50.0) & (flight.true["airspeed"] < 130.0))
        assert all(np.all(np.isfinite(x)) for x in flight.record.channels.values())
    for flight in plain:
        check_record(flight.record)
        assert np.max(np.abs(flight.true["phi"])) > np.deg2rad(10.0)
        assert np.max(np.abs(flight.true["beta"])) > np.deg2rad(2.0)
        assert np.min(flight.flown["X"]) < 0.6


def test_a_seed_is_a_record():
    """The same seed gives the same bytes, another seed others; what is hidden leaves the commands as they were."""
    first, second = (hidden_records({"alpha_bias": {"alpha_bias": 0.01}}, seed=4) for _ in range(2))
    assert [r.sha256 for r in first] == [r.sha256 for r in second]
    (other,) = hidden_records({}, seed=5, manoeuvres=1)
    (plain,) = hidden_records({}, seed=4, manoeuvres=1)
    assert len({first[0].sha256, other.sha256, plain.sha256}) == 3
    np.testing.assert_array_equal(plain["phi"], first[0]["phi"])
    np.testing.assert_allclose((first[0]["alpha"] - plain["alpha"]), 0.01, atol=1e-12)
    (short,) = hidden_records({}, seed=4, manoeuvres=1, seconds=30.0)
    assert short.time[[0, -1]] == pytest.approx([0.0, 30.0])


def test_noise_is_what_it_says():
    quiet, white, outliers = (
        hidden_records({}, seed=6, manoeuvres=1, noise=noise, sensor_noise=scale)[0]
        for noise, scale in (("white", 0.0), ("white", 1.0), ("outliers", 1.0))
    )
    assert np.std(white["az"] - quiet["az"]) == pytest.approx(0.05, rel=0.1)
    thrust = white["thrust_left"] + white["thrust_right"] - 2 * quiet["thrust_left"]
    assert np.std(thrust) == pytest.approx(200, rel=0.1)
    spikes = (outliers["az"] - white["az"]) / 0.05
    assert np.mean(np.abs(spikes) > 1.0) == pytest.approx(0.005, abs=0.004)
    np.testing.assert_allclose(np.abs(spikes[np.abs(spikes) > 1.0]), 10.0)


def test_disturbances_colour_the_coefficients(card):
    """Coefficients flown with an AR(1) disturbance, less those of the same model, have its correlation."""
    for noise, rho in (("ar1", 0.9), ("buffet", 0.6)):
        (flight,) = hidden_flights({}, seed=9, manoeuvres=1, noise=noise, rho=rho)
        residual = beyond_the_model(flight, card)["CD"]
        loose = flight.flown["X"] < 0.4
        growth = np.std(residual[loose]) / np.std(residual[flight.flown["X"] > 0.95])
        assert growth > 1.4 if noise == "buffet" else growth < 1.4
        residual = residual / (1.0 + (noise == "buffet") * (growth - 1.0) * (1.0 - flight.flown["X"]))
        assert np.corrcoef(residual[1:], residual[:-1])[0, 1] == pytest.approx(rho, abs=0.06)


def test_draws_lie_within_the_stated_sizes():
    rng = np.random.default_rng(0)
    for name, effect in CATALOGUE.items():
        for _ in range(20):
            for key, value in draw_hidden(rng, name).items():
                parameter = next(p for p in effect.parameters if p.name == key)
                least, most = effect.sizes[key]
                assert least * (1 - 1e-9) <= abs(value - parameter.neutral) <= most
                assert parameter.bounds[0] < value < parameter.bounds[1]


@pytest.mark.parametrize(("hidden", "options", "said"), [
    ({"canard_lift": {"CLdc": 0.5}}, {}, "cannot fly effect canard_lift: it has no canard"),
    ({"gremlins": {}}, {}, "no effect 'gremlins'"),
    ({"mass_scale": {"mass": 1.0}}, {}, "has the parameters mass_scale"),
    ({"alpha_squared_moment": {"Cma2": 8.0}}, {}, "leaves its envelope"), ({}, {"noise": "pink"}, "no noise 'pink'"),
    ({}, {"seconds": 500.0}, "ask for 1 to 100 s"),
])  # fmt: skip
def test_what_cannot_be_hidden_is_said(hidden, options, said):
    with pytest.raises(InputError, match=said):
        hidden_records(hidden, seed=0, **options)


def test_a_flight_that_breaks_down_after_its_record_leaves_the_record_whole():
    """Simulations are longer than what is kept: this one has no numbers after 31 s, which filters must not spread."""
    hidden = {"alpha_squared_moment": {"Cma2": 3.0}}
    (record,) = hidden_records(hidden, seed=0, manoeuvres=1, seconds=20.0)
    assert all(np.all(np.isfinite(x)) for x in record.channels.values())
    with pytest.raises(InputError, match="leaves its envelope"):
        hidden_records(hidden, seed=0, manoeuvres=1, seconds=50.0)


def test_the_truth_comes_back_from_records_of_two_rates(card, model):
    """At the lower one, as `identify` says; the coefficients as published are formed from lags that differ."""
    asked = [Request({}, noise="white", seed=seed, dt=dt) for seed, dt in ((810, 0.04), (811, 0.01))]
    records = [synthetic(request, card, CATALOGUE, f"s{request.seed}").record for request in asked]
    truth, tau2 = np.array([TRUTH[name] for name in model.names]), model.names.index("tau2")
    found = identify(records, card, IdentifyOptions(sample=False, gp=False))
    assert found.observations.dt == pytest.approx(0.04)
    assert any("25 Hz" in note and "100 Hz" in note for note in found.notes)
    published = fit_mle(model, observe(records, card, model, Forming.PUBLISHED), extra_starts=0)
    matched, other = ((fit.estimate - truth) / fit.crb_corrected for fit in (found.mle, published))
    assert abs(found.mle.estimate[tau2] - 20.0) < 0.4
    assert abs(published.estimate[tau2] - 20.0) > 0.6
    assert rms(matched) < 2.0 < rms(other)
