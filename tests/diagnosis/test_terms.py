"""Terms that nobody listed: their library, their sensitivities along flights, and the searches for one."""

from collections import defaultdict
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import jsonschema
import numpy as np
import pytest
import six_axes as six
import stranger_six
from calling import called
from gusty_flight import DT, GUST, LENGTH, SECONDS, TRUTH, gusty_flight
from parts import few_candidates, without_accelerometers
from scipy.signal import lfilter

from bayes_aero.diagnosis import search as searches
from bayes_aero.diagnosis.components import QUANTITIES, SAME, SEPARATED, Trial, WaveScan, columns_of, imitated, library
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import INNOVATIONS, FoundTerm, ProductTerm
from bayes_aero.diagnosis.selection import plausible_selection
from bayes_aero.diagnosis.selection_state import (
    CandidateModel,
    Component,
    DiagnosisSettings,
    SelectionState,
    linearised,
    refitted,
)
from bayes_aero.diagnosis.unexplained import NEAR, _beside, _is_lag, _Model, _rivals, flown_forms, leader
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.kalman import filter_segments
from bayes_aero.dynamics.segments import segments
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import read_card
from bayes_aero.inference.prediction_error import PredictionErrorResult, disturbed, fit_disturbed
from bayes_aero.jobs.documents import document_schema
from bayes_aero.jobs.preparing import effect_file, write_effects
from bayes_aero.jobs.results import term_part
from bayes_aero.jobs.store import plain
from bayes_aero.model.model import Model, own_effects
from bayes_aero.model.observations import join
from bayes_aero.physics.aircraft import FLIGHT, Aircraft
from bayes_aero.report.pages.diagnosis import sentences, terms_table
from bayes_aero.residuals.output_error import AddedCoefficients, AddedToFilter, FilterError, OutputError

# Terms that nobody listed: the library by hand, the effect file that states one, and what is refused
AIRCRAFT = Aircraft(
    mass=15000.0, Ix=1e5, Iy=2e5, Iz=3e5, Ixz=1e4,
    wing_area=60.0, chord=3.0, half_span=10.0, aspect_ratio=7.0, tail_arm=15.0,
)  # fmt: skip
N = 100
SIGNALS = {
    "alpha": np.linspace(0.1, 0.2, N), "q": np.full(N, 0.2), "elevator": np.full(N, -0.2), "airspeed": np.full(N, 60.0),
    "beta": np.linspace(-0.1, 0.1, N), "p": np.full(N, 0.3), "aileron": np.full(N, 0.05), "X": np.full(N, 0.25),
    "thrust": np.full(N, 5400.0), "density": np.full(N, 1.0), "dt": np.full(N, 0.05),
    "first": np.repeat([0, N // 2], N // 2),
}  # fmt: skip
BY_NAME = {q.name: q for q in (*QUANTITIES, SEPARATED)}


def product(*names):
    return ProductTerm(tuple(BY_NAME[name] for name in names))


def terms(*, lateral=False, separated=True):
    found = library(SIGNALS, AIRCRAFT, lambda name: name in SIGNALS, lateral=lateral, separated=separated)
    assert len({t.name for t in found}) == len(found)
    return {t.name: t for t in found}


@pytest.mark.parametrize(("factors", "name", "unit", "value"), [
    (("alpha", "alpha", "elevator"), "alpha^2 elevator", "1/rad^3", 0.1 * 0.1 * -0.2),
    (("qhat", "(1 - X)"), "qhat (1 - X)", "1", 0.2 * 3.0 / 60.0 * 0.75),
    (("phat", "aileron"), "phat aileron", "1/rad", 0.3 * 10.0 / 60.0 * 0.05),
    (("CT",), "CT", "1", 5400.0 / (0.5 * 3600.0 * 60.0)),
])  # fmt: skip
def test_a_product_has_the_value_and_the_unit_of_its_factors(factors, name, unit, value):
    term = product(*factors)
    assert (term.name, term.unit) == (name, unit)
    assert term.evaluate(SIGNALS, AIRCRAFT)[0] == pytest.approx(value, rel=1e-12)


def test_the_library_has_every_product_to_third_order_with_the_symmetry_of_the_aircraft():
    """Of k quantities (k + 3 choose 3) - 1 products; of separated flow the product with at most two of the others."""
    found = terms(separated=False)
    products = [t for t in found.values() if all(f.cost == 1 for f in t.factors)]
    longitudinal = {"alpha", "qhat", "elevator", "CT"}
    own = [t for t in products if {f.name for f in t.factors} <= longitudinal]
    assert len(own) == 34
    flown = [t for t in terms().values() if {f.name for f in t.factors} <= {*longitudinal, "(1 - X)"}]
    assert len([t for t in flown if "(1 - X)" in t.name]) == 1 + 4 + 10
    assert "mach" not in found
    # Seen in a mirror CL, CD and Cm stay the same, and CY, Cl and Cn change sign: so does every term of theirs.
    mirror = {name: -x if name in ("beta", "p", "r", "aileron", "rudder") else x for name, x in SIGNALS.items()}
    for lateral in (False, True):
        for name, term in terms(lateral=lateral).items():
            there, here = term.evaluate(mirror, AIRCRAFT), term.evaluate(SIGNALS, AIRCRAFT)
            assert there == pytest.approx(-here if lateral else here, abs=1e-12), name
    assert "alpha" in terms()
    assert {"beta", "alpha beta"} <= set(terms(lateral=True))
    assert any(name.startswith("sign(beta) max(|beta| - ") for name in terms(lateral=True))


@pytest.mark.parametrize(("noise", "lowest"), [(0.0, 0.005), (0.01, 0.03)])
def test_no_break_of_a_lateral_quantity_lies_within_its_noise(noise, lowest):
    """Near zero noise decides the sign of beta: what that takes off the slope there looks like a dead band."""
    beta = SIGNALS["beta"] + noise * np.random.default_rng(1).standard_normal(N)
    found = library({**SIGNALS, "beta": beta}, AIRCRAFT, lambda n: n in SIGNALS, lateral=True, separated=True)
    named = [t.name for t in found if t.name.startswith("sign(beta) max(|beta| - ")]
    places = [float(name.split(" - ")[1].split(",")[0]) for name in named]
    assert places
    assert min(places) == pytest.approx(lowest, rel=0.4)


def test_breaks_and_bumps_lie_where_it_was_flown_and_memory_begins_anew():
    found = terms()
    at_half = found["max(alpha - 0.15, 0)"]
    assert at_half.evaluate(SIGNALS, AIRCRAFT) == pytest.approx(np.maximum(SIGNALS["alpha"] - 0.15, 0.0), abs=1e-12)
    bump = found["exp(-((alpha - 0.15)/0.0192)^2/2)"]
    assert bump.evaluate(SIGNALS, AIRCRAFT).max() == pytest.approx(1.0, abs=1e-3)
    # A step passes as 1 - exp(-t V/(T c)), sampled at the end of each interval.
    step = np.where(np.arange(N) % 50 < 10, 0.0, 1.0)
    lagged = terms()["lag(elevator, 15 c/V)"].evaluate(SIGNALS | {"elevator": step}, AIRCRAFT)
    t = np.maximum(np.arange(50) - 9, 0) * 0.05
    assert lagged == pytest.approx(np.tile(1.0 - np.exp(-t * 60.0 / (15.0 * 3.0)), 2), abs=1e-12)
    assert terms()["lag(elevator, 15 c/V)"].code is None


FOUND = FoundTerm(
    "Cm", product("alpha", "qhat", "(1 - X)"), (-12.0, 0.5), 0.4, 55.0, 0.7, ((product("alpha", "qhat"), 0.3),), 0.5
)
MEMORY = replace(FOUND, term=terms()["lag(alpha, 5 c/V)"])


def test_an_effect_file_states_what_the_library_evaluates_and_nothing_else(tmp_path):
    both = terms() | terms(lateral=True)
    stated = [t for t in both.values() if t.code is not None]
    path = tmp_path / "found.py"
    path.write_text(effect_file([replace(FOUND, term=t) for t in stated], ["run1"]), encoding="utf-8")
    effects = own_effects([path])
    assert len(effects) == len(stated)
    for term, effect in zip(stated, effects.values(), strict=True):
        (parameter,) = effect.parameters
        added = effect.increments({parameter.name: 2.0}, SIGNALS, AIRCRAFT, {"X": SIGNALS["X"]})
        assert np.asarray(added["Cm"]) == pytest.approx(2.0 * term.evaluate(SIGNALS, AIRCRAFT), rel=1e-12)
        assert set(effect.channels) == set(term.channels)
        assert effect.sizes[parameter.name] == (0.5, 60.0)
    unstated = tmp_path / "unstated.py"
    assert "was not written" in write_effects([MEMORY], ["run1"], unstated)
    assert not unstated.exists()
    write_effects([FOUND], ['x"""\nraise SystemExit("run")\n"""{0}'], path)
    (effect,) = own_effects([path]).values()
    assert effect.name == "cm_alpha_qhat_separated"


def test_a_term_is_written_and_said_with_its_factor_and_its_rivals(diagnosed):
    schema = document_schema("diagnosis")
    one = schema["properties"]["terms"] | {"$defs": schema["$defs"]}
    jsonschema.validate(plain([term_part(FOUND), term_part(MEMORY)]), one)
    assert term_part(FOUND).ambiguous_with == {"alpha qhat": 0.3}
    d = replace(diagnosed.view.diagnosis, terms=(FOUND, replace(MEMORY, others=())))
    said = [s for s in sentences(d) if s.startswith("Form: ")]
    assert len(said) == 3
    for told in ("Cm has a term alpha qhat (1 - X)", "40%", "+55", "from alpha qhat (30%)"):
        assert told in said[0]
    assert "depends on the past" in said[1]
    assert "No other term" in said[1]
    rows = terms_table(d).frame().reset_index().to_dict("records")
    assert (rows[0]["term"], rows[0]["size"], rows[0]["size_sd"]) == ("alpha qhat (1 - X)", -12.0, 0.5)


@pytest.mark.parametrize(("name", "said"), [("there.py", "exists"), ("effect.txt", "ends in .py")])
def test_a_file_that_is_there_or_is_no_python_is_refused_before_anything_is_done(tmp_path, name, said):
    (tmp_path / "there.py").write_text("kept = 1\n")
    done = called(tmp_path, "diagnose", "--write-effect", name, "--out", "results")
    assert done.code == 2
    assert said in done.err
    assert (tmp_path / "there.py").read_text() == "kept = 1\n"
    assert not (tmp_path / "results").exists()


# By what they make of simulated flights: their sensitivities, and a search for one
TWO = (11, 12)  # seeds of two flights
STEP = 1e-5


@pytest.fixture(scope="module")
def hfb320():
    return read_card("hfb320")


def in_calm_air(card, truth, *added, late=0, **beyond) -> SelectionState:
    """Where a search without a catalogue begins, in two simulated flights, at the values without `truth`; effects that
    are `added` are in, and alpha is recorded `late` samples."""
    flown = [gusty_flight(seed, gust={"w": 0.0, "u": 0.0}, truth=truth, **beyond) for seed in TWO]
    late_alpha = [{"alpha": np.r_[[r["alpha"][0]] * late, r["alpha"]][: r.n]} for r in flown]
    flown = [replace(r, name=f"run{k}", channels=r.channels | late_alpha[k]) for k, r in enumerate(flown)]
    model, flights = Model.from_card(card), join(list(map(without_accelerometers, flown)), card, FLIGHT)
    full = CandidateModel(model.extended(*added), tuple(e.name for e in model.effects), added, {})
    responses = OutputError.of(flights, aircraft_dynamics(full.model, flights))
    theta = np.array([TRUTH.get(p.name, p.start) for p in full.model.free])
    return linearised(full, responses, responses.outputs, theta, tuple(e.name for e in added))


@pytest.fixture(scope="module")
def calm(hfb320):
    return in_calm_air(hfb320, {})


def test_a_hidden_term_is_found_in_trajectories_and_their_silent_twins_have_none(hfb320, calm):
    searched, silent = (
        flown_forms(plausible_selection(state, seed=1)) for state in (in_calm_air(hfb320, {"Cma2": 0.15}), calm)
    )
    (term,) = searched.terms
    assert (term.coefficient, term.term.name) == ("Cm", "alpha^2")
    assert abs(term.size[0] - 0.15) < 1.96 * term.size[1]
    assert [(u.coefficient, u.channel) for u in searched.unknown] == [("Cm", "alpha^2")]
    assert silent.terms == ()


def test_a_lag_is_the_rival_of_a_delay_that_stands_in_for_it_and_of_none_that_is_true(hfb320, calm):
    """A lift that follows alpha with a lag of 0.44 s (15 chords of 3 m at 104 m/s), and alpha recorded late."""
    last = [0.0, 0.1]

    def late(t, _, alpha, *__):
        last[:] = t, alpha + (last[1] - alpha) * np.exp((last[0] - t) / 0.44) if t > 0.0 else alpha
        return 0.2 * (last[1] - alpha), 0.0, 0.0  # a large lag is screened among others: variances are held

    lagging = in_calm_air(hfb320, {}, beyond=late)
    lags, none = ([t.column.term.name for t in _beside(x, ["CL"], (), [], x, _is_lag)] for x in (lagging, calm))
    assert (lags, none) == (["lag(alpha, 15 c/V)"], [])
    delay = CATALOGUE["alpha_delay"]
    lagging, delayed = (in_calm_air(hfb320, {}, delay, **given) for given in ({"beyond": late}, {"late": 2}))
    of_lag, of_delay = (_rivals(_Model(refitted(x)), [delay.name], ()) for x in (lagging, delayed))
    assert "lag(alpha, 15 c/V)" in of_lag[delay.name][0]
    assert of_lag[delay.name][1] < 0.0
    assert of_delay == {}


def test_what_is_not_worth_its_cost_is_told_as_soon_as_from_all_that_the_colour_says(calm):
    """Of coloured residuals what a simpler model loses may be little, though it loses many nats were they white."""
    rng, m, c = np.random.default_rng(3), len(calm.S), calm.outputs.index("alpha")
    wave, slow = np.zeros((2, *calm.residual.shape))
    wave[:, c] = np.sin(np.arange(m) / 40.0)
    slow[:, c] = lfilter([1.0], [1.0, -0.9], np.std(calm.residual[:, c]) * rng.standard_normal(m))
    pairs, white = [], 0
    for size in np.geomspace(0.1, 1.0, 8):
        state = replace(calm, residual=calm.residual + slow + size * np.std(slow[:, c]) * wave)
        models = _Model(state), _Model(state, functions=(Component("CL", "slow", wave[:, :, None]),))
        pairs += [models, models[::-1]]
    for model, other in pairs:
        exact = model.beyond(other)
        for least in (-3.0, 0.0, 3.0):
            assert (model.beyond(other, least) > least) == (exact > least)
        loss = 0.5 * (other.fitted[0].deviance - model.fitted[0].deviance)
        white += exact > 0.0 > loss - model.cost + other.cost
    assert white > 0  # some pair is one that white residuals would decide otherwise


def test_the_leader_explains_as_much_as_a_regression_says_and_is_nothing_that_a_parameter_makes(calm):
    columns = columns_of(calm, "Cm")[:12]
    basis = calm.S[:, :, calm.full.columns(["Cma"])]
    again = replace(columns[0], component=Component("Cm", "again", basis / np.std(basis)))
    term, explained = leader(calm, [[*columns, again]], ())
    assert term.column is not again
    more = {c.component.label: calm.best.deviance - Trial(calm, c.component).fit.deviance for c in columns}
    label = term.column.component.label
    assert more[label] >= NEAR * max(more.values())
    assert explained == pytest.approx(0.5 * more[label] / max(term.inflation, 1.0), rel=1e-9)


def test_a_wave_explains_what_a_regression_on_its_sine_and_cosine_says(calm):
    scan = WaveScan(calm, calm.best, "Cm", np.array([0.11, 0.34]))
    shares, B = scan.shares(calm.left()[None])[0], calm.scaled[:, :, calm.best.columns]
    for hertz, share in zip(scan.hertz, shares, strict=True):
        A = np.concatenate([B, scan.component(hertz).basis, calm.left()[:, :, None]], axis=2)
        A, left = np.split((A / np.sqrt(calm.best.variance)[:, None]).reshape(-1, A.shape[2]), [-1], axis=1)
        normal, k = A.T @ A, B.shape[2]
        normal[:k, :k] = calm.best.normal  # with the priors of the parameters
        right = A.T @ left
        gain = right.T @ np.linalg.solve(normal, right) - right[:k].T @ np.linalg.solve(normal[:k, :k], right[:k])
        assert share == pytest.approx(gain.item() / np.sum(left**2), rel=1e-4)


def test_a_form_is_the_effect_itself_as_far_as_it_makes_what_the_effect_makes(calm):
    (name,) = (e.name for e in calm.full.model.effects if "Cmq" in calm.full.parameters_of(e.name))
    own, deviation = calm.full.own_columns(name), np.std(calm.residual, axis=0)[:, None]
    slopes, reached = calm.S[:, :, own], np.any(calm.S[:, :, own] != 0.0, axis=(0, 2))
    columns = [c for c in columns_of(calm, "Cm") if c.term.name not in ("alpha", "elevator")][:6]  # Cma, Cmde
    shares = imitated(calm, [name], [Component("Cm", "itself", slopes), *(c.component for c in columns)])
    beside = calm.S[:, :, [c for c in calm.columns() if c < len(calm.theta) and c not in own]]
    for share, basis in zip(shares, [slopes, *(c.component.basis for c in columns)], strict=True):
        X, *others = ((x / deviation)[:, reached].reshape(-1, x.shape[2]) for x in (slopes, beside, basis))
        others = [A / np.linalg.norm(A, axis=0) for A in others]
        lost = [np.sum((X - A @ np.linalg.lstsq(A, X, rcond=1e-12)[0]) ** 2) for A in (others[0], np.hstack(others))]
        assert share == pytest.approx(1.0 - lost[1] / lost[0], abs=1e-5)
    assert shares[0] > SAME


def test_offsets_are_central_differences_along_initial_states(calm):
    """Windows, each with an initial state of its own, of which the others know nothing."""
    responses, theta = calm.responses, calm.theta
    offsets, states = responses.offsets(theta, responses.outputs), responses.windows.dynamics.start
    window = np.asarray(responses.stretch)
    residual = eqx.filter_jit(lambda shared: responses.residual(jnp.asarray(theta), shared))
    for k in range(len(states)):
        step = STEP * (np.arange(len(states)) == k)
        ahead, behind = (np.asarray(residual(jnp.asarray(sign * step))) for sign in (1, -1))
        slope = (behind - ahead) / (2.0 * STEP)
        for w in (0, window.max()):
            own = offsets[:, :, w * len(states) + k]
            np.testing.assert_allclose(own[window == w], slope[window == w], atol=1e-7 * np.abs(slope).max())
            assert not own[window != w].any()


# By what they make of the innovations of a filter in gusts, by a simulator that shares no code: the filter finds the
# gusts, and the search a curved moment, as an effect or, where it is in no catalogue, as a term
Cma2, GUSTS_SEED = -3.0, 5  # 1/rad2
FEW = (
    "alpha_squared_moment", "airspeed_scale", "alpha_scale", "pitch_attitude_bias", "thrust_scale", "flap_lift",
    "thrust_moment", "pitch_rate_lift",
)  # fmt: skip


def searched_in_gusts(card, truth) -> tuple[searches.SearchResult, PredictionErrorResult]:
    """A search in a minute in gusts, flaps where they are, and the fit with which it began."""
    flight, fits = gusty_flight(GUSTS_SEED, truth=truth), []
    flight = replace(flight, channels={**flight.channels, "flap": np.full(len(flight.time), 0.1)})
    with pytest.MonkeyPatch.context() as patch:
        few_candidates(patch, FEW)
        patch.setattr(searches, "fit_disturbed", lambda *a, **k: fits.append(fit_disturbed(*a, **k)) or fits[-1])
        settings = DiagnosisSettings(max_effects=3)
        return searches.Search([flight], card, Model.from_card(card), (), settings, 0).innovations(), fits[0][1]


@pytest.fixture(scope="module")
def gusty(hfb320):
    return searched_in_gusts(hfb320, {"Cma2": Cma2})


def test_what_is_hidden_is_found_in_gusts_as_an_effect_or_as_a_term_beside_what_is_on_the_card(gusty):
    searched, _ = gusty
    # Derivatives of flaps at rest would share the coefficients' constants.
    assert "flap_lift" in searched.full.not_testable
    assert list(searched.stages) == [INNOVATIONS]
    assert searched.model.causes == ("alpha_squared_moment",)
    size = searched.model.sizes["Cma2"]
    assert abs(size.mean - Cma2) < 3.0 * size.sd
    assert size.sd < 0.2 * abs(Cma2)
    for name in ("CLa", "CDa", "Cmq", "Cmde"):
        size = searched.model.sizes[name]
        assert abs(size.mean - TRUTH[name]) < 4.0 * size.sd, name
    assert searched.terms == ()
    begun = replace(searched.model, state=searched.model.base, causes=(), minor=(), steps=(), sizes={})
    forms = flown_forms(begun)
    (term,) = forms.terms
    assert [(u.coefficient, u.channel) for u in forms.unknown] == [("Cm", "alpha^2")]
    assert (term.coefficient, term.term.name) == ("Cm", "alpha^2")
    assert abs(term.size[0] - Cma2) < 1.96 * term.size[1]


@pytest.mark.parametrize("name", ["airspeed_scale", "alpha_scale", "pitch_attitude_bias", "CLa", "Cma2"])
def test_sensitivities_of_innovations_are_those_of_finite_differences(gusty, name):
    """An error of scale makes the sensor's noise larger, too, which its sensitivity must hold; of the largest within
    1e-3, for the motion is linearised once a step, in its middle."""
    state = gusty[0].model.base
    directions, step = np.zeros((16, len(state.theta))), 1e-5
    directions[0, state.full.columns([name])[0]] = 1.0
    _, slope = state.responses.slopes(state.theta, directions)
    up, down = (state.responses.evaluate(state.theta + sign * step * directions[0])[0] for sign in (1, -1))
    difference = (np.asarray(down) - np.asarray(up)) / (2.0 * step)
    np.testing.assert_allclose(slope[0], difference, atol=1e-3 * np.abs(difference).max())


def test_gusts_have_their_size_and_nothing_is_found_where_nothing_is_hidden(hfb320):
    silent, fit = searched_in_gusts(hfb320, {})
    assert silent.model.causes == silent.terms == silent.unknown == ()
    # Correlation of neighbouring samples within 4 / sqrt(n), n of them.
    noise = silent.noise
    assert noise.of_innovations
    assert max(abs(r) for r in noise.lag1.values()) < 4.0 / np.sqrt(SECONDS / DT)
    assert noise.coloured == ()
    gusts = dict(zip(fit.names, zip(fit.estimate, fit.sd, strict=True), strict=True))
    for name, truth in (("vertical_gust", GUST["w"]), ("longitudinal_gust", GUST["u"])):
        estimate, sd = gusts[name]
        assert abs(estimate - truth) < 3.0 * sd
        assert sd < 0.4 * truth
        length, length_sd = gusts[f"{name}_length"]
        assert abs(length - LENGTH) < 3.0 * length_sd


@pytest.mark.parametrize(("way", "factors", "tolerances"), [
    (AddedCoefficients, ("alpha", "alpha", "qhat"), (1e-9, 1e-4)),
    (AddedToFilter, ("elevator", "CT"), (1e-8, 5e-3)),  # the card's tail arm is 1e9 m; at steps of the elevator
])  # fmt: skip
def test_terms_fly_as_the_parameter_of_the_card_and_as_the_effect_of_a_file(
    way, factors, tolerances, calm, gusty, tmp_path
):
    """Cm += Cmde elevator: the recorded elevator is linear between samples, as the integration takes it."""
    state = calm if way is AddedCoefficients else gusty[0].model.base
    responses, theta = state.responses, state.theta
    added = way(responses, theta)
    (slope,) = added.slopes("Cm", lambda signals: signals["elevator"][None])
    expected = responses.linearise(theta, np.array([responses.model.names.index("Cmde")]))[1][:, :, 0]
    np.testing.assert_allclose(slope, expected, atol=tolerances[0] * np.abs(expected).max())
    # Central differences of residuals with the effect, gains held; between samples the product is taken as linear.
    term = product(*factors)
    path, step = tmp_path / "found.py", 1e-3
    path.write_text(effect_file([FoundTerm("Cm", term, (1.0, 0.1), 0.5, 9.0, 1.0, (), 0.1)], ["run"]), encoding="utf-8")
    (effect,) = own_effects([path]).values()
    model = responses.model.extended(effect)
    windows = replace(responses.windows, dynamics=replace(responses.windows.dynamics, model=model))
    wider = replace(responses, windows=windows, model=model)
    (slope,) = added.slopes("Cm", lambda signals: term.evaluate(signals, responses.flights.aircraft)[None])
    at = model.names.index(effect.parameters[0].name)
    less, more = (np.asarray(wider.evaluate(np.insert(theta, at, size))[0]) for size in (-step, step))
    expected = (less - more) / (2.0 * step)
    np.testing.assert_allclose(slope, expected, atol=tolerances[1] * np.abs(expected).max())


def test_blocks_lie_within_a_manoeuvre_and_the_least_share_is_that_of_one_sample(gusty):
    state = gusty[0].model.base
    parts, manoeuvre = state.responses.parts, state.responses.manoeuvre
    assert set(np.bincount(parts) * state.responses.seconds) == {5.0}
    assert len(set(zip(parts.tolist(), manoeuvre.tolist(), strict=True))) == parts.max() + 1 == SECONDS / 5.0
    # A constant in white noise: the share of the variance that it takes, by numpy.
    x = 0.02 + np.random.default_rng(3).standard_normal((20_000, 5))
    single, mean = (0.02**2 / np.mean(np.square(part)) for part in (x, x.mean(axis=1)))
    assert state.least_share(mean) == pytest.approx(single, rel=0.03)


@pytest.mark.verify
@pytest.mark.parametrize("hidden", [None, "rudder_yaw", "sideslip_scale"])
def test_an_effect_of_six_axes_is_named_in_gusts_and_none_where_none_is_hidden(hidden, tmp_path):
    """Three manoeuvres in gusts of 0.7 m/s: a derivative that the card lacks, or a vane that shows a fifth too little.

    The standard error of the vane's scale is some 0.02: the gusts move the vane, and the derivatives take up the rest.
    """
    plane, rng = stranger_six.Plane(**six.ATTACHED), np.random.default_rng(3)
    effects = [n for n in (*six.LONGITUDINAL, *six.LATERAL) if n != hidden]
    seen, records = 0.8 if hidden == "sideslip_scale" else 1.0, []
    for kind in ("elevator", "aileron", "rudder"):
        flight = stranger_six.fly(plane, kind, rng, gust=0.7)
        records.append(six.record(kind, {**flight, "beta": seen * flight["beta"]}, rng))
    card = six.card_in(tmp_path, plane, effects)
    found = diagnose(records, card, settings=DiagnosisSettings(max_effects=2, process_noise=True, gains=False))
    truth = {"rudder_yaw": ("Cndr", plane.Cndr), "sideslip_scale": ("sideslip_scale", seen - 1.0)}
    assert [c.name for c in found.causes] == [hidden] * (hidden is not None)
    assert not found.unknown
    for found_cause in found.causes:
        name, true = truth[found_cause.name]
        size = found_cause.parameters[name]
        assert abs(size.mean - true) < 3.0 * size.sd


# In six degrees of freedom
def filtered(card, records, values, noise):
    """Records by a filter at these values and deviations of the sensors' `noise`, as `FilterError.after` asks."""
    flights = join(records, card, FLIGHT)
    flown = disturbed(segments(flights, aircraft_dynamics(Model.from_card(card), flights)))
    theta = np.array([values.get(p.name, p.start) for p in flown.dynamics.free])
    R = np.array([noise[name] for name in flown.outputs]) ** 2
    sd = np.array([noise[name] if name in FLIGHT else 0.0 for name in flown.dynamics.states])
    return flown, theta, R, eqx.filter_jit(filter_segments)(flown, jnp.asarray(theta), sd, 1e-3 * sd, R)


@pytest.mark.verify
@pytest.mark.parametrize("gusts", [False, True])
def test_a_term_of_six_degrees_of_freedom_flies_and_is_foreseen_as_its_parameter(tmp_path, gusts):
    """Cn += Cndr rudder; compilation takes most of a minute."""
    plane, rng = stranger_six.Plane(**six.ATTACHED), np.random.default_rng(3)
    card = six.card_in(tmp_path, plane)
    records = [six.record("rudder", stranger_six.fly(plane, "rudder", rng, seconds=5.0), rng)]
    model = Model.from_card(card)
    values = {p.name: getattr(plane, p.name) for p in model.free}
    if gusts:
        flown, theta, *rest = filtered(card, records, values, defaultdict(lambda: 0.01))
        responses = FilterError.after(flown, theta, *rest, flown.dynamics)
    else:
        flights, theta = join(records, card, ()), np.array(list(values.values()))
        responses = OutputError.of(flights, aircraft_dynamics(model, flights))
    added = (AddedToFilter if gusts else AddedCoefficients)(responses, theta)
    (slope,) = added.slopes("Cn", lambda signals: signals["rudder"][None])
    wanted = responses.linearise(theta, np.array([responses.model.names.index("Cndr")]))[1][:, :, 0]
    np.testing.assert_allclose(slope, wanted, atol=1e-9 * np.abs(wanted).max())


MORE = (
    "sideslip_scale", "bank_angle_bias", "sideslip_vane_position", "rudder_roll", "sideslip_incidence",
    "wing_lift_difference",
)  # fmt: skip


def test_innovations_of_six_degrees_of_freedom_change_as_their_sensitivities_say(tmp_path):
    """Of effects that the filter's model lacks, one of which parts its separation point in two; central differences.

    The states of the filter are angles of attitude. Effects at neutral leave its innovations. The motion is linearised
    in the middle of each step.
    """
    plane, rng = stranger_six.Plane(tau1=20.0), np.random.default_rng(3)
    lateral = ("sideslip_side_force", "sideslip_roll", "roll_damping", "sideslip_yaw", "yaw_damping")
    effects = [n for n in (*six.LONGITUDINAL, *lateral, *six.STALL) if n not in MORE]
    card = six.card_in(tmp_path, plane, effects)
    flight = stranger_six.fly(plane, "stall_in_bank", rng, gust=0.7)
    records = [six.record("stall", {name: x[-100:] for name, x in flight.items()}, rng)]
    values = {p.name: getattr(plane, p.name) for p in Model.from_card(card).free}
    flown, theta, *rest = filtered(card, records, values, defaultdict(lambda: 0.01, altitude=1.0, airspeed=0.1))
    dynamics = flown.dynamics
    own = FilterError.after(flown, theta, *rest, dynamics)
    assert dynamics.states[6:9] == ("phi", "theta", "psi")
    model = own.model.extended(*MORE)
    simulated = aircraft_dynamics(model, own.flights)  # its states are a quaternion, and two separation points
    wider = FilterError.after(flown, theta, *rest, simulated)
    assert wider.windows.dynamics.states == (*dynamics.states[:-1], "X_right", "X_left")
    at = dict(zip(own.model.names, theta, strict=True))
    wide = np.array([at.get(p.name, p.neutral) for p in model.free])
    residual = lambda x: np.asarray(wider.evaluate(x)[0])
    np.testing.assert_allclose(residual(wide), np.asarray(own.evaluate(theta)[0]), atol=1e-9)
    sought = [model.names.index(name) for name in ("Cnbe", *(p.name for p in model.free if p.name not in at))]
    slopes = wider.linearise(wide, np.array(sought))[1]
    for slope, place in zip(np.moveaxis(slopes, -1, 0), sought, strict=True):
        size = np.abs(slope).max()
        assert size > 1e-6, model.names[place]
        step = 1e-4 / size * np.eye(len(wide))[place]  # the altitude, of thousands of metres, is rounded
        difference = (residual(wide - step) - residual(wide + step)) / 2e-4 * size
        np.testing.assert_allclose(slope, difference, atol=1e-3 * size, err_msg=model.names[place])
