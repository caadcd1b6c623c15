"""Every effect of the catalogue, without naming one: what the contract promises; and signs of lateral effects."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.effect import NEUTRAL_FLOW, Effect, Kind, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import Aircraft, Axis
from bayes_aero.report.text.restraints import sign_sentences

AIRCRAFT = Aircraft(
    mass=15000.0, Ix=1e5, Iy=2e5, Iz=3e5, Ixz=1e4,
    wing_area=60.0, chord=3.0, half_span=10.0, aspect_ratio=7.0, tail_arm=15.0,
)  # fmt: skip
INDICES = ("first", "last")
MARKS = ("dt", "start", "elapsed", *INDICES)
WITH_MEMORY = (Stage.CHANNEL, Stage.LAG)
effects = pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)


def signals(n=64, seed=0):
    """Two manoeuvres of 32 samples, every channel that the program knows and their marks."""
    rng = np.random.default_rng(seed)
    s = {
        "alpha": rng.uniform(-0.1, 0.5, n), "alpha_dot": rng.normal(0, 0.05, n), "airspeed": rng.uniform(55, 100, n),
        "q": rng.normal(0, 0.05, n), "elevator": rng.normal(0, 0.1, n), "mach": rng.uniform(0.15, 0.4, n),
        "beta": rng.normal(0, 0.05, n), "density": rng.uniform(0.6, 1.2, n), "thrust": rng.uniform(2e3, 2e4, n),
        "altitude": rng.uniform(4900, 5100, n), "az": rng.normal(-9.8, 1.0, n),
    }  # fmt: skip
    gusts = {d.state: rng.normal(0, 1.0, n) for e in CATALOGUE.values() if (d := e.disturbance) is not None}
    s = {name: rng.normal(0, 0.1, n) for name in STANDARD_CHANNELS} | gusts | s
    s = {key: jnp.asarray(value) for key, value in s.items()}
    index = np.arange(n)
    return s | {
        "dt": jnp.full(n, 0.04), "start": jnp.asarray(index % 32 == 0), "elapsed": jnp.asarray(index % 32 * 0.04),
        "first": jnp.asarray(index // 32 * 32), "last": jnp.asarray(index // 32 * 32 + 31),
    }  # fmt: skip


def known(s, seed=1):
    rng = np.random.default_rng(seed)
    n = s["alpha"].shape[0]
    X = jnp.asarray(rng.uniform(0.01, 0.99, n))
    return {key: jnp.full(n, value) for key, value in NEUTRAL_FLOW.items()} | {
        "incidence": s["alpha"], "X": X, "CL_attached": jnp.asarray(rng.uniform(0, 1.5, n)),
        "X_difference": jnp.asarray(rng.uniform(-1.0, 1.0, n)) * jnp.minimum(X, 1.0 - X),
    }  # fmt: skip


def values(effect: Effect, which: str):
    own = {p.name: jnp.asarray(getattr(p, which)) for p in effect.parameters}
    return {name: jnp.asarray(4.0) for name in effect.uses} | own


def flat(increments):
    """All numbers of an effect's increments, positions too, as one vector."""
    return jnp.concatenate([jnp.ravel(jnp.asarray(x, float)) for x in jax.tree.leaves(increments)])


@effects
def test_neutral_values_give_exactly_nothing(effect):
    s = signals()
    state = known(s)
    if not effect.parameters:  # an effect without parameters is absent where the flow is attached
        state |= {"X": jnp.ones_like(s["alpha"]), "X_difference": jnp.zeros_like(s["alpha"])}
    if effect.name == "flow_separation":
        state |= {"X": jnp.ones_like(s["alpha"])}
    if effect.disturbance is not None:  # a process of no intensity stays at zero
        s |= {effect.disturbance.state: jnp.zeros_like(s["alpha"])}
    assert np.all(np.asarray(flat(effect.increments(values(effect, "neutral"), s, AIRCRAFT, state))) == 0.0)


@effects
@pytest.mark.parametrize("which", ["neutral", "start"])
def test_derivatives_are_finite(effect, which):
    s = signals()
    if not effect.parameters:
        pytest.skip("no parameter to differentiate by")

    def total(v):
        found = flat(effect.increments(v, s, AIRCRAFT, known(s)))
        return jnp.sum(found * jnp.linspace(1.0, 2.0, len(found)))  # what one engine gains, the other loses

    gradient = jax.grad(total)(values(effect, which))
    assert all(np.isfinite(float(g)) for g in gradient.values())
    if which == "start" and effect.disturbance is None:  # whose parameters act through its process
        assert all(float(gradient[p.name]) != 0.0 for p in effect.parameters)


@effects
def test_derivatives_match_finite_differences(effect):
    s = signals()
    at = {p.name: jnp.asarray(p.start + 0.3 * effect.sizes[p.name][0]) for p in effect.parameters}
    at = values(effect, "start") | at  # a little off the start: a delay of exactly a sample has a kink at the ends

    def response(v):
        return flat(effect.increments(v, s, AIRCRAFT, known(s)))

    for p in effect.parameters:
        h = 1e-5 * max(1.0, abs(p.start))
        up, down = (response(at | {p.name: at[p.name] + sign * h}) for sign in (1, -1))
        tangent = {k: jnp.asarray(float(k == p.name)) for k in at}
        _, slope = jax.jvp(response, (at,), (tangent,))
        scale = max(1.0, float(jnp.max(jnp.abs(slope))))
        np.testing.assert_allclose(slope, (up - down) / (2 * h), rtol=1e-5, atol=1e-8 * scale)


@effects
def test_worked_example_comes_out(effect):
    example = effect.example
    assert example.source
    kinds = {"start": bool} | dict.fromkeys(INDICES, int)
    one = {k: jnp.atleast_1d(jnp.asarray(v, kinds.get(k, float))) for k, v in example.signals.items()}
    state = {k: jnp.asarray([v]) for k, v in NEUTRAL_FLOW.items()}
    state |= {"incidence": one.get("alpha", jnp.zeros(1))} | {
        k: jnp.asarray([v]) for k, v in (example.known or {}).items()
    }
    found = effect.increments({k: jnp.asarray(v) for k, v in example.parameters.items()}, one, AIRCRAFT, state)
    assert set(found) == set(example.increments)
    for key, expected in example.increments.items():
        number = np.asarray(jnp.asarray(found[key]))
        np.testing.assert_allclose(number, np.broadcast_to(expected, number.shape), rtol=1e-9, atol=1e-12)


@effects
def test_it_says_what_it_is_and_where_it_comes_from(effect):
    assert isinstance(effect.kind, Kind)
    assert effect.claim.endswith(".")
    assert effect.formula.endswith(".")
    assert effect.source
    for p in effect.parameters:
        assert p.unit
        assert p.description
        assert p.prior.source
        assert p.bounds[0] <= p.start <= p.bounds[1]
        assert np.isfinite(float(p.prior.log_density(jnp.asarray(p.start))))


@effects
def test_every_parameter_has_a_least_and_a_largest_size(effect):
    assert set(effect.sizes) == {p.name for p in effect.parameters}
    for least, largest in effect.sizes.values():
        assert 0.0 < least < largest < np.inf
    bounds = {p.name: p.bounds for p in effect.parameters}
    for name, scanned in effect.scan.items():
        assert scanned
        assert all(bounds[name][0] < value < bounds[name][1] for value in scanned)


@effects
def test_it_reads_only_the_channels_it_names(effect):
    s = {name: value for name, value in signals().items() if name in (*effect.channels, *MARKS)}
    effect.increments(values(effect, "start"), s, AIRCRAFT, known(signals()))  # a channel not named is a KeyError


@effects
def test_increments_fit_what_they_are_added_to(effect):
    s = signals()
    found = effect.increments(values(effect, "start"), s, AIRCRAFT, known(s))
    shape = {
        Stage.CHANNEL: lambda k: s[k].shape,
        Stage.INFLOW: lambda k: s[k].shape,
        Stage.AIRCRAFT: lambda k: np.shape(getattr(AIRCRAFT, k)),
    }
    for key, increment in found.items():
        expected = shape.get(effect.stage, lambda k: known(s)[k].shape)(key)
        assert np.shape(jnp.asarray(increment)) == expected
        if effect.stage is Stage.CHANNEL:
            assert key not in MARKS


@effects
def test_one_sample_or_many_give_the_same(effect):
    if effect.stage in WITH_MEMORY:
        pytest.skip("it needs the history; a simulation carries X as a state instead")
    if effect.stage is Stage.AIRCRAFT:
        pytest.skip("it has no samples")
    s = signals()
    v, state = values(effect, "start"), known(s)
    many = effect.increments(v, s, AIRCRAFT, state)
    one = effect.increments(v, {k: x[5] for k, x in s.items()}, AIRCRAFT, {k: x[5] for k, x in state.items()})
    for key, array in many.items():
        assert float(one[key]) == pytest.approx(float(array[5]), rel=1e-12)


@effects
def test_nothing_crosses_the_seam_between_manoeuvres(effect):
    if effect.stage is not Stage.CHANNEL:
        pytest.skip("it acts on one sample, or is a lag that starts anew by itself")
    s = signals()
    other = {k: jnp.concatenate([x[:32], x[32:] if k in MARKS else x[:31:-1]]) for k, x in s.items()}
    v = {p.name: jnp.asarray(p.start + 0.7 * effect.sizes[p.name][1]) for p in effect.parameters}
    one, two = (effect.increments(v, channels, AIRCRAFT, {}) for channels in (s, other))
    for key in one:
        np.testing.assert_allclose(one[key][:32], two[key][:32], rtol=1e-12, atol=1e-15)


def test_parameters_have_one_owner_in_the_whole_catalogue():
    names = [p.name for effect in CATALOGUE.values() for p in effect.parameters]
    assert len(names) == len(set(names))
    assert {name for effect in CATALOGUE.values() for name in effect.uses} <= set(names)


BOTH = tuple(Axis)
REST = {"alpha": 0.1, "beta": 0.0, "p": 0.0, "r": 0.0, "aileron": 0.0, "rudder": 0.0, "airspeed": 80.0}

STABLE = [  # a motion to the right, and the side on which a stable aircraft of usual controls answers it
    ("sideslip_side_force", "beta", "CY", -1),  # the wind from the right pushes to the left
    ("sideslip_roll", "beta", "Cl", -1),  # the right wing rises
    ("sideslip_yaw", "beta", "Cn", +1),  # the nose turns into the wind
    ("roll_damping", "p", "Cl", -1),
    ("yaw_damping", "r", "Cn", -1),
    ("yaw_rate_roll", "r", "Cl", +1),  # the left wing is faster and rises
    ("roll_rate_yaw", "p", "Cn", -1),  # lift of the right wing, which goes down, leans forward
    ("aileron_roll", "aileron", "Cl", -1),  # the right aileron down lifts the right wing
    ("rudder_side_force", "rudder", "CY", +1),  # the trailing edge left pushes the fin to the right
    ("rudder_yaw", "rudder", "Cn", -1),  # and the nose to the left
]


@pytest.mark.parametrize(("name", "channel", "coefficient", "side"), STABLE)
def test_defaults_have_the_sign_of_a_stable_aircraft(card, name, channel, coefficient, side):
    model = Model.of([name], axes=BOTH)
    signals = {key: np.array([x]) for key, x in (REST | {channel: 0.1}).items()}
    known = model.flow({p.name: p.start for p in model.parameters}, signals, card.aircraft)
    assert side * float(known[coefficient][0]) > 0.0
    others = {"CL", "CD", "Cm", "CY", "Cl", "Cn"} - {coefficient}
    assert all(float(known[key][0]) == 0.0 for key in others)


@pytest.mark.parametrize(("name", "said"), [
    ("CYbe", "wrong sign"), ("Clbe", "wrong sign"), ("Cnbe", "wrong sign"), ("Clda", "sign of aileron is"),
    ("Cndr", "sign of rudder is"), ("CYdr", "sign of rudder"), ("Clp", "impossible"), ("Cnr", "impossible"),
])  # fmt: skip
def test_an_estimate_on_the_other_side_is_told(name, said):
    parameters = [p for effect in CATALOGUE.values() for p in effect.parameters]
    (usual,) = (p.start for p in parameters if p.name == name)
    (sentence,) = sign_sentences({name: (-usual, 0.001)}, parameters)
    assert said in sentence
    assert sign_sentences({name: (usual, 0.001)}, parameters) == []


def test_spoilers_of_one_side_roll_and_yaw_to_it_and_alike_ones_do_nothing(card):
    model = Model.of(["spoiler_roll", "spoiler_yaw"], axes=BOTH)
    values = {"Clds": 0.1, "Cnds": 0.02}
    deflected = {"alpha": [0.1, 0.1], "spoiler_left": [0.0, 0.3], "spoiler_right": [0.3, 0.3]}
    known = model.flow(values, {name: np.array(x) for name, x in deflected.items()}, card.aircraft)
    assert np.asarray(known["Cl"]) == pytest.approx([0.015, 0.0], abs=1e-15)
    assert np.asarray(known["Cn"]) == pytest.approx([0.003, 0.0], abs=1e-15)
