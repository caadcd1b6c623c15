"""Screening: what a candidate is worth, what only mixes noise, and what a control at rest takes up."""

from dataclasses import replace
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
from parts import part
from scipy.linalg import lstsq

from bayes_aero.diagnosis import diagnose
from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.diagnose import judged_on_held_out_flights
from bayes_aero.diagnosis.result import Verdict, as_absorbed
from bayes_aero.diagnosis.screening import accuracy
from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.screening.autocorrelation import Autocorrelation
from bayes_aero.diagnosis.screening.parameter_fit import PartialledRegression
from bayes_aero.diagnosis.screening.regression import Products, RegressionFit
from bayes_aero.diagnosis.screening.screening import CandidateScore, ScreeningResult, block_jackknife_covariance
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection import forward_selection
from bayes_aero.diagnosis.selection.forward_selection import Extension, worth
from bayes_aero.diagnosis.selection.holdout import Confirmation
from bayes_aero.diagnosis.selection.rivals import Absorbed, absorbed
from bayes_aero.diagnosis.settings import DEFAULT
from bayes_aero.diagnosis.structure.unexplained import left_beside
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.channel import Axis
from bayes_aero.jobs.io.documents import AbsorbedPart, document_schema
from bayes_aero.jobs.provenance import plain
from bayes_aero.model.model import Model
from bayes_aero.report.text.diagnosis import diagnosis_sentences


# What only takes correlated noise out of one coefficient with another gains nothing; nor is doubt a cause
@pytest.fixture
def projected():
    """Noise of one sensor in two of three coefficients; columns: a constant (in the model), that noise, a wave."""
    rng = np.random.default_rng(31)
    n = 2400
    vane = rng.standard_normal(n)
    residual = 0.3 * rng.standard_normal((n, 3))
    residual[:, 0] += vane
    residual[:, 2] += rng.uniform(0.5, 2.0) * vane
    wave = np.sin(np.arange(n) / 9.0)
    residual[:, 2] += rng.uniform(0.8, 1.5) * wave
    S = np.zeros((n, 3, 3))
    S[:, :, 0], S[:, 2, 1], S[:, 2, 2] = 1.0, residual[:, 0], wave
    residual -= residual.mean(axis=0)
    state = part(SelectionState, S=S, noise_growth=np.ones((n, 3)), folds=(slice(0, 1200), slice(1200, n)))
    variance = residual.var(axis=0)
    fit = RegressionFit(np.array([0]), np.zeros(1), np.array([[n * np.sum(1.0 / variance)]]), variance, 0.0)
    return PartialledRegression(state, fit, [np.array([1]), np.array([2])]), residual


def test_a_whole_covariance_leaves_nothing_to_sums_of_outputs(projected):
    given, residual = projected
    right = given.right(residual)
    for block, (mixes, coefficient) in enumerate([(True, 2), (False, 2)]):
        place = given.place[block]
        estimate = given.bread[block] @ right[place]
        left = residual[:, coefficient] - (given.P[:, :, place] @ estimate)[:, coefficient]
        alone = len(left) * np.log(np.mean(residual[:, coefficient] ** 2) / np.mean(left**2))
        together = given.deviance(residual) - given.deviance(residual, block, estimate)
        assert alone > 100.0
        assert (together < 0.05 * alone) if mixes else (together > 0.7 * alone)
    mixed = residual @ np.array([[1.0, 0.0, 0.7], [0.0, 1.0, 0.0], [0.0, -2.0, 1.0]]).T
    unit = np.linalg.det([[1.0, 0.0, 0.7], [0.0, 1.0, 0.0], [0.0, -2.0, 1.0]])
    expected = given.deviance(residual) + 2.0 * len(residual) * np.log(abs(unit))
    assert given.deviance(mixed) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("share", [0.02, 0.3, 1.0])
def test_noise_of_a_recorded_channel_bends_a_slope_by_no_more_than_residuals_permit(monkeypatch, share):
    """y = a x, x recorded with noise: least squares gives a V/(V + s2), and a true slope is within the bounds.

    `share` of what is left is that noise, of whatever colour. Closed form: the lowest bias is -r2/(a var(x)), r2 what
    is left and a, var(x) as estimated and recorded; to first order in it.
    """
    rng, n, slope, sd = np.random.default_rng(8), 40_000, -0.8, 0.02
    true = 0.1 * np.sin(np.arange(n) / 9.0)
    beta = true + sd * rng.standard_normal(n)
    y = slope * true + abs(slope) * sd * np.sqrt(1.0 / share - 1.0) * rng.standard_normal(n)
    found = float(beta @ y / (beta @ beta))
    left = float(np.mean((y - found * beta) ** 2))

    def linearise(x):
        return lambda theta, _: ((y - theta[0] * x)[:, None], x[:, None, None])

    responses = SimpleNamespace(
        flights=SimpleNamespace(channels={"beta": beta}, n=n),
        with_channels=lambda channels: SimpleNamespace(linearise=linearise(channels["beta"])),
        outputs=("CY",),
    )
    monkeypatch.setattr(accuracy, "recording_noise", lambda _: {"beta": sd})
    effect = CATALOGUE["sideslip_side_force"]
    full = part(CandidateModel, candidates=(effect,), model=Model.of([effect], axes=(Axis.LATERAL,)))
    state = part(
        SelectionState, active=(effect.name,), full=full, responses=responses, outputs=("CY",), folds=(slice(0, n),),
        theta=np.array([found]), residual=(y - found * beta)[:, None], S=beta[:, None, None],
        noise_growth=np.ones((n, 1)),
    )  # fmt: skip
    fit = RegressionFit(np.array([0]), np.zeros(1), np.array([[beta @ beta / left]]), np.array([left]), 0.0)
    ((low, high),) = accuracy.largest_noise_bias(state, fit).values()
    exact = -left / (found * np.mean(beta**2))
    assert sorted((low, high)) == pytest.approx(sorted((0.0, exact)), rel=0.05, abs=1e-6)
    assert found - high <= slope + 0.01 <= found - low + 0.02 or share < 0.1
    if share == 1.0:
        assert found - exact == pytest.approx(slope, rel=0.02)


@pytest.mark.parametrize(("scores", "named"), [((0.2, 2.4), False), ((2.6, 30.0), True)])
def test_a_size_that_may_as_well_be_none_is_no_cause(monkeypatch, scores, named):
    score = np.random.default_rng(int(1e3 * scores[0])).uniform(*scores)
    least = CATALOGUE["cg_shift"].sizes["cg_shift"][0]
    size = 2.0 * least
    full = part(CandidateModel, candidates=(CATALOGUE["cg_shift"],), model=Model.of(["cg_shift"]))
    state = part(SelectionState, active=("cg_shift",), full=full)
    monkeypatch.setattr(forward_selection, "largest_noise_bias", lambda *_: {})
    fit = RegressionFit(np.zeros(0, int), np.zeros(0), np.zeros((0, 0)), np.ones(1), 0.0)
    causes, minor = worth(state, fit, {"cg_shift": Size(size, size / score, "m")})
    assert (causes, minor) == ((("cg_shift",), ()) if named else ((), ("cg_shift",)))
    assert scores[0] > DEFAULT.least_score or not named


def ranked(monkeypatch, *standing) -> CandidateModel:
    """A screening of effects by name, gain, step and gain under the whole covariance; the candidates are they."""
    scores = tuple(
        CandidateScore(name, (0,), None, gain, 12.0, 1.0, 50.0, (step,), (0.01,), together, 1.0)
        for name, gain, step, together in standing
    )
    monkeypatch.setattr(diagnose, "screen", lambda *_, **__: part(ScreeningResult, candidate_scores=scores))
    return part(CandidateModel, candidates=tuple(CATALOGUE[one.effect] for one in scores), settings=DEFAULT)


@pytest.mark.parametrize(("together", "rivals"), [(-140.0, ()), (480.0, ("cg_shift",))])
def test_what_only_mixes_noise_is_no_rival(monkeypatch, together, rivals):
    """A centre of gravity that adds CY to Cn takes the vane's noise out of Cn, whatever else is missing there."""
    full = ranked(monkeypatch, ("cg_shift", 500.0, 0.1, together), ("sideslip_cubed_yaw", 250.0, 0.1, 400.0))
    responses = SimpleNamespace(model=SimpleNamespace(coefficients=("CY", "Cl", "Cn")))
    state = part(SelectionState, full=full, responses=responses, outputs=("CY", "Cl", "Cn"))
    probability, close = diagnose.rivals_of(part(Extension, state=state, fit=None), "sideslip_cubed_yaw")
    assert close == rivals
    assert probability == pytest.approx(0.5 if rivals else 1.0)


@pytest.mark.parametrize(("size", "close"), [(0.9, ("vane_position",)), (1.1, ())])
@pytest.mark.parametrize("told", ["first order", "fitted before"])
def test_what_must_be_larger_than_aircraft_have_is_no_rival(monkeypatch, size, close, told):
    """A vane farther ahead than on any aircraft explains nothing, however well it fits."""
    largest = CATALOGUE["vane_position"].sizes["vane_position"][1]
    step = size * largest if told == "first order" else 0.5 * largest
    full = ranked(monkeypatch, ("vane_position", 260.0, step, 260.0), ("alpha_bias", 250.0, 0.01, 250.0))
    responses = SimpleNamespace(model=SimpleNamespace(coefficients=("CL",)))
    state = part(SelectionState, full=full, responses=responses, outputs=("V",), active=("vane_position",))
    before = part(
        Extension, base=part(SelectionState, active=()), state=state, too_large=None,
        sizes={"vane_position": Size(size * largest, 1.0, "m")},
    )  # fmt: skip
    found = part(Extension, state=state, fit=None, too_large=before if told == "fitted before" else None)
    probability, rivals = diagnose.rivals_of(found, "alpha_bias")
    assert rivals == close
    assert probability == pytest.approx(0.5 if close else 1.0)


# A derivative of a control at rest takes up what is constant: by how much, in closed form, and where it does not
OUTPUTS = ("CY", "Cl", "Cn")
NOISE, SAMPLES = 1e-5, 400
USUAL, WIDTH = CATALOGUE["rudder_yaw"].parameters[0].prior.normal


def fitted(rudder: np.ndarray, hidden: float) -> Extension:
    """A card that knows of yaw only the rudder, fitted to a rudder as usual and a yawing moment without cause."""
    model = Model.of(["rudder_yaw", "yaw_offset"], axes=tuple(Axis))
    full = CandidateModel(model, ("rudder_yaw",), (CATALOGUE["yaw_offset"],), {})
    S = np.zeros((SAMPLES, 3, 3))
    S[:, 2, model.names.index("Cndr")], S[:, 2, model.names.index("Cn0")] = rudder, 1.0
    folds = (slice(0, 200), slice(200, SAMPLES))
    measured = NOISE * np.random.default_rng(5).standard_normal((SAMPLES, 3))
    measured[:, 2] += hidden + USUAL * rudder

    def at(theta: np.ndarray) -> SelectionState:
        residual = measured - S[:, :, :2] @ theta
        mean, precision = full.prior(range(2), theta)
        mean, precision = np.append(mean, 0.0), np.append(precision, 1.0)
        return part(
            SelectionState, full=full, outputs=OUTPUTS, theta=theta, residual=residual, S=S, folds=folds, scans=(),
            noise_growth=np.ones((SAMPLES, 3)), products=Products.of(residual, S, folds), mean=mean, nuisance=0,
            precision=precision, active=(), chosen=(), components=(), variance_inflation=1.0,
            responses=SimpleNamespace(model=SimpleNamespace(coefficients=OUTPUTS)),
        )  # fmt: skip

    theta = np.zeros(2)
    theta[model.names.index("Cndr")] = at(theta).fit().step.sum()  # one, or none where the rudder makes nothing
    state = at(theta)
    sizes = {"Cndr": Size(float(theta[model.names.index("Cndr")]), 1e-3, "1/rad")}
    return part(Extension, state=state, fit=state.fit(), sizes=sizes)


def test_what_a_rudder_at_rest_takes_up_has_the_size_that_it_has_with_a_usual_rudder():
    """Cn0 = (Cndr - usual) dr, and its deviation that of the prior times dr."""
    held, hidden = 0.0075, 9e-4
    (found,) = absorbed(fitted(np.full(SAMPLES, held), hidden))
    assert (found.effect, found.parameter, found.control) == ("rudder_yaw", "Cndr", "rudder")
    assert found.estimate[0] == pytest.approx(USUAL + hidden / held, abs=0.01)
    assert found.usual == (USUAL, WIDTH)
    assert found.members == {"rudder_yaw", "yaw_offset"}
    size = found.sizes["yaw_offset"]
    mean, sd = size.mean, size.sd
    assert mean == pytest.approx(hidden, rel=0.02)
    assert sd == pytest.approx(WIDTH * held, rel=0.05)


@pytest.mark.parametrize(("held", "moves", "hidden"), [
    (0.0075, 0.02, 9e-4),  # it moves, and tells its derivative
    (0.0, 0.0, 9e-4),  # neutral, it makes nothing
    (1e-4, 0.0, 9e-4),  # so little aside that it would need a derivative that no rudder has
    (0.0075, 0.0, 2e-4),  # what it takes up is not worth a name
    (0.0075, 0.0, 0.02),  # nor is there so much on any aircraft
])  # fmt: skip
def test_elsewhere_nothing_is_taken_up(held, moves, hidden):
    rudder = held + moves * np.sin(np.arange(SAMPLES) / 9.0)
    assert absorbed(fitted(rudder, hidden)) == ()


def test_what_is_taken_up_is_in_the_verdict_the_text_and_the_file(diagnosed):
    found = absorbed(fitted(np.full(SAMPLES, 0.0075), 9e-4))
    assert as_absorbed(Verdict.NO_EFFECT, found) is Verdict.UNDECIDED
    assert as_absorbed(Verdict.NO_EFFECT, ()) is Verdict.NO_EFFECT
    assert as_absorbed(Verdict.EXPLAINED, found) is Verdict.EXPLAINED
    silent = replace(diagnosed.view.diagnosis, causes=(), unknown=(), changes=(), tested=None)
    for taken_up, verdict in ((found, Verdict.UNDECIDED), ((), Verdict.NO_EFFECT)):
        after = judged_on_held_out_flights(replace(silent, absorbed=taken_up), Confirmation((), {}))
        assert after.verdict is verdict
    sizes = {"thrust_scale": Size(-0.1, 0.2, "1")}
    one = Absorbed("elevator_moment", "Cmde", "1/rad", "elevator", (-0.2, 0.01), (-1.0, 0.5), sizes)
    said = diagnosis_sentences(replace(diagnosed.view.diagnosis, absorbed=(one,)))
    (sentence,) = (x for x in said if "elevator does not move" in x)
    for told in ("Cmde", "-0.200 ± 0.010", "-1.00 ± 0.50", "thrust_scale", "cannot tell which"):
        assert told in sentence
    schema = document_schema("diagnosis")
    written = plain([AbsorbedPart.of(one)])
    jsonschema.validate(written, schema["properties"]["absorbed"] | {"$defs": schema["$defs"]})
    assert written[0]["usual"] == {"mean": -1.0, "sd": 0.5}
    assert written[0]["sizes"] == {"thrust_scale": {"mean": -0.1, "sd": 0.2, "unit": "1"}}


# What a candidate is worth where folds have gaps between them, as those of a single manoeuvre do
@pytest.mark.parametrize("gap", [0, 40])
def test_information_is_what_the_model_cannot_follow_in_the_folds(gap):
    """Against least squares on the folds alone; a candidate that the model follows everywhere has none."""
    rng = np.random.default_rng(gap)
    n, k = 900, 4
    folds = tuple(slice(begin, begin + 300 - gap) for begin in (0, 300, 600))
    S = np.cumsum(rng.standard_normal((n, 3, k + 2)), axis=0) + rng.uniform(3.0, 9.0, k + 2)
    S[:, :, k] = S[:, :, :k] @ rng.standard_normal(k)
    residual = rng.standard_normal((n, 3)) * [1.0, 0.1, 3.0]
    active = np.arange(k)
    fit = Products.of(residual, S, folds).fit(active, np.zeros(k + 2), np.zeros(k + 2))
    state = part(SelectionState, S=S, noise_growth=np.ones((n, 3)), folds=folds)
    found = PartialledRegression(state, fit, [np.array([k]), np.array([k + 1])]).information
    inside = np.concatenate([np.arange(n)[fold] for fold in folds])
    A = (S[inside] / np.sqrt(fit.variance)[:, None]).reshape(-1, k + 2)
    left = A[:, k + 1] - A[:, :k] @ lstsq(A[:, :k], A[:, k + 1])[0]
    assert found[1, 1] == pytest.approx(left @ left, rel=1e-6)
    assert found[0, 0] < 1e-12 * (A[:, k] @ A[:, k])


def test_two_rivals_are_told_apart_by_the_noise_along_what_parts_them():
    """Log likelihood ratios of two simple hypotheses have a variance of twice their mean; so has the white one, over
    `apart`, under a colour that white noise does not know."""
    rng = np.random.default_rng(4132)
    n, phi = 800, rng.uniform(0.5, 0.9)
    colour = Autocorrelation(np.array([[phi, 0.0, 0.0]]), np.array([np.sqrt(1.0 - phi**2)]))
    folds = (slice(0, n),)
    t = np.linspace(0.0, 1.0, n)
    period = rng.uniform(0.05, 0.4)
    S = np.stack([np.ones(n), t, np.sin(2.0 * np.pi * t / period), t**2, np.zeros(n)], axis=1)[:, None, :]
    fit = Products.of(colour.simulate(1, folds, n, rng)[0], S, folds).fit(np.arange(2), np.zeros(5), np.zeros(5))
    fit = replace(fit, variance=np.ones(1), normal=S[:, 0, :2].T @ S[:, 0, :2])
    projected = PartialledRegression(
        part(SelectionState, S=S, noise_growth=np.ones((n, 1)), folds=folds), fit, [np.array([2]), np.array([3])]
    )
    sizes = [np.array([0.3]), np.array([2.0])]
    apart = projected.apart(np.zeros((n, 1)), sizes, 0, colour, None)
    assert apart[0] == 1.0
    d = projected.P[:, 0, :] @ np.array([-sizes[0][0], sizes[1][0]])
    covariance = phi ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    assert apart[1] == pytest.approx(d @ covariance @ d / (d @ d), rel=0.05)  # but for the ends of the record
    ratios = (0.5 * d @ d - colour.simulate(4000, folds, n, rng)[:, :, 0] @ d) / apart[1]
    assert ratios.var() == pytest.approx(2.0 * ratios.mean(), rel=0.15)


def test_stretches_that_disagree_more_than_the_colour_says_part_rivals_less():
    rng = np.random.default_rng(4132)
    n, stretches = 400, np.repeat(np.arange(20), 20)
    S = np.stack([np.ones(n), *rng.standard_normal((2, n)) + np.repeat(rng.standard_normal((2, 20)), 20, axis=1)])
    S = np.append(S, np.zeros((1, n)), axis=0).T[:, None, :]
    residual = np.repeat(rng.standard_normal(20), 20)[:, None]
    folds, white = (slice(0, n),), Autocorrelation(np.zeros((1, 3)), np.ones(1))
    fit = Products.of(residual, S, folds).fit(np.arange(1), np.zeros(4), np.zeros(4))
    projected = PartialledRegression(
        part(SelectionState, S=S, noise_growth=np.ones((n, 1)), folds=folds), fit, [np.array([1]), np.array([2])]
    )
    estimates = [np.zeros(1), np.ones(1)]
    alone, together = (projected.apart(residual, estimates, 0, white, s)[1] for s in (None, stretches))
    sums = np.add.reduceat(projected.P[:, 0, 1] * residual[:, 0], np.arange(0, n, 20)) / fit.variance[0]
    assert together == pytest.approx(np.sum(sums**2) * 20 / 19 / np.sum(projected.P[:, 0, 1] ** 2 / fit.variance[0]))
    assert together > alone


def test_deviations_are_those_of_fits_without_each_stretch():
    """Against least squares done again without each stretch; one of them alone decides the second parameter."""
    rng = np.random.default_rng(4132)
    count, length, k = 8, 30, 3
    n, stretch = count * length, np.repeat(np.arange(count), length)
    S = np.zeros((n, 2, k + count))
    S[:, :, :k] = rng.standard_normal((n, 2, k))
    S[stretch != 3, :, 1] *= 0.05
    for number in range(count):
        S[stretch == number, :, k + number] = 1.0
    residual = rng.standard_normal((n, 2)) * [1.0, 3.0] + np.repeat(rng.standard_normal((count, 2)), length, axis=0)
    precision = np.append(np.full(k, 4.0), np.zeros(count))
    folds = (slice(0, n),)
    known = np.array([1.0, 9.0])
    fit = Products.of(residual, S, folds).fit(np.arange(k + count), np.zeros(k + count), precision, known)
    fit = replace(fit, variance=known)
    state = part(
        SelectionState, S=S, residual=residual, noise_growth=np.ones((n, 2)), folds=folds, precision=precision,
        nuisance=count,
    )  # fmt: skip
    object.__setattr__(state, "theta", np.zeros(k))
    flights = SimpleNamespace(lengths=[length] * count)
    object.__setattr__(state, "responses", SimpleNamespace(jackknife_blocks=stretch, flights=flights))
    columns, covariance = block_jackknife_covariance(state, fit)
    assert list(columns) == [0, 1, 2]
    weight = np.tile(1.0 / np.sqrt(known), n)
    prior = np.hstack([np.diag(np.sqrt(precision[:k])), np.zeros((k, count))])

    def estimate(kept):
        rows = np.repeat(kept, 2)
        A = (S.reshape(2 * n, -1) * weight[:, None])[rows]
        b = (residual.ravel() * weight)[rows]
        return lstsq(np.vstack([A, prior]), np.append(b, np.zeros(k)))[0][:k]

    every = estimate(np.ones(n, bool))
    moves = np.array([estimate(stretch != number) - every for number in range(count)])
    expected = moves.T @ moves * (count - 1) / count
    np.testing.assert_allclose(covariance, expected, rtol=1e-6, atol=1e-6 * np.diag(expected).min())


# When a function of a channel takes the place of a named cause
def share(y, before, more):
    """Share of the variance that least squares leaves with `before` which `more` takes away."""

    def rest(columns):
        X = np.stack([*columns, np.ones(len(y))], axis=1)
        return float(np.sum((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2))

    return 1.0 - rest([*before, *more]) / rest(before)


@pytest.mark.parametrize(("proxy", "replaced"), [(1.0, False), (0.6, True), (0.3, True)])
def test_a_curve_replaces_a_proxy_and_not_the_line_that_is_true(proxy, replaced):
    """CD is a line in the elevator. A cubic of it explains as much alone, and nothing beside the line; beside a cause
    that follows the elevator by a correlation of 0.6 only, it explains what that leaves."""
    rng = np.random.default_rng(8)
    elevator, other, noise = rng.standard_normal((3, 800))
    CD = elevator + noise
    cause = proxy * elevator + np.sqrt(1.0 - proxy**2) * other
    curve = [elevator, elevator**2, elevator**3]
    alone, beside = share(CD, [], curve), share(CD, [cause], curve)
    assert alone == pytest.approx(0.5, abs=0.06)
    assert left_beside(alone, beside, DEFAULT) is replaced
