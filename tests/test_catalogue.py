"""Every effect of the catalogue, without naming one: what the contract promises."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.effect import NEUTRAL_FLOW, Effect, Kind
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.aircraft import Aircraft

AIRCRAFT = Aircraft(
    mass=15000.0, Ix=1e5, Iy=2e5, Iz=3e5, Ixz=1e4,
    wing_area=60.0, chord=3.0, half_span=10.0, aspect_ratio=7.0, tail_arm=15.0,
)  # fmt: skip
effects = pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)


def signals(n=64, seed=0):
    rng = np.random.default_rng(seed)
    s = {
        "alpha": rng.uniform(-0.1, 0.5, n), "alpha_dot": rng.normal(0, 0.05, n), "airspeed": rng.uniform(55, 100, n),
        "q": rng.normal(0, 0.05, n), "elevator": rng.normal(0, 0.1, n), "mach": rng.uniform(0.15, 0.4, n),
        "beta": rng.normal(0, 0.05, n),
    }  # fmt: skip
    s = {key: jnp.asarray(value) for key, value in s.items()}
    return s | {"dt": jnp.full(n, 0.04), "start": jnp.asarray(np.arange(n) % 32 == 0)}


def known(s, seed=1):
    rng = np.random.default_rng(seed)
    n = s["alpha"].shape[0]
    X = jnp.asarray(rng.uniform(0.01, 0.99, n))
    return {key: jnp.full(n, value) for key, value in NEUTRAL_FLOW.items()} | {
        "incidence": s["alpha"], "X": X, "CL_attached": jnp.asarray(rng.uniform(0, 1.5, n))
    }  # fmt: skip


def values(effect: Effect, which: str):
    own = {p.name: jnp.asarray(getattr(p, which)) for p in effect.parameters}
    return {name: jnp.asarray(4.0) for name in effect.uses} | own


@effects
def test_neutral_values_give_exactly_nothing(effect):
    s = signals()
    state = known(s)
    if not effect.parameters:  # an effect without parameters is absent where the flow is attached
        state |= {"X": jnp.ones_like(s["alpha"])}
    if effect.name == "flow_separation":
        state |= {"X": jnp.ones_like(s["alpha"])}
    for increment in effect.increments(values(effect, "neutral"), s, AIRCRAFT, state).values():
        assert np.all(np.asarray(increment) == 0.0)


@effects
@pytest.mark.parametrize("which", ["neutral", "start"])
def test_derivatives_are_finite(effect, which):
    s = signals()
    if not effect.parameters:
        pytest.skip("no parameter to differentiate by")

    def total(v):
        return sum(jnp.sum(x) for x in effect.increments(v, s, AIRCRAFT, known(s)).values())

    gradient = jax.grad(total)(values(effect, which))
    assert all(np.isfinite(float(g)) for g in gradient.values())
    if which == "start":
        assert all(float(gradient[p.name]) != 0.0 for p in effect.parameters)


@effects
def test_derivatives_match_finite_differences(effect):
    s = signals()
    start = values(effect, "start")

    def response(v):
        return jnp.concatenate([jnp.atleast_1d(x) for x in effect.increments(v, s, AIRCRAFT, known(s)).values()])

    for p in effect.parameters:
        h = 1e-5 * max(1.0, abs(p.start))
        up, down = (response(start | {p.name: start[p.name] + sign * h}) for sign in (1, -1))
        tangent = {k: jnp.asarray(float(k == p.name)) for k in start}
        _, slope = jax.jvp(response, (start,), (tangent,))
        np.testing.assert_allclose(slope, (up - down) / (2 * h), rtol=1e-5, atol=1e-8)


@effects
def test_worked_example_comes_out(effect):
    example = effect.example
    assert example.source
    one = {k: jnp.asarray([v]) for k, v in example.signals.items()} | {
        k: jnp.asarray([bool(v)]) for k, v in example.signals.items() if k == "start"
    }
    state = {k: jnp.asarray([v]) for k, v in NEUTRAL_FLOW.items()}
    state |= {"incidence": one.get("alpha", jnp.zeros(1))} | {
        k: jnp.asarray([v]) for k, v in (example.known or {}).items()
    }
    found = effect.increments({k: jnp.asarray(v) for k, v in example.parameters.items()}, one, AIRCRAFT, state)
    assert set(found) == set(example.increments)
    for key, expected in example.increments.items():
        assert np.asarray(found[key]).item() == pytest.approx(expected, rel=1e-9, abs=1e-12)


@effects
def test_it_says_what_it_is_and_where_it_comes_from(effect):
    assert isinstance(effect.kind, Kind)
    assert effect.claim.endswith(".")
    assert effect.source
    for p in effect.parameters:
        assert p.unit
        assert p.description
        assert p.prior.source
        assert p.bounds[0] <= p.start <= p.bounds[1]
        assert np.isfinite(float(p.prior.log_density(jnp.asarray(p.start))))


@effects
def test_one_sample_or_many_give_the_same(effect):
    if effect.name == "separation_lag":
        pytest.skip("a lag needs the history; a simulation carries X as a state instead")
    s = signals()
    v, state = values(effect, "start"), known(s)
    many = effect.increments(v, s, AIRCRAFT, state)
    one = effect.increments(v, {k: x[5] for k, x in s.items()}, AIRCRAFT, {k: x[5] for k, x in state.items()})
    for key, array in many.items():
        assert float(one[key]) == pytest.approx(float(array[5]), rel=1e-12)
