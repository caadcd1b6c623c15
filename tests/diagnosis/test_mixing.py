"""What only takes correlated noise out of one coefficient with another gains nothing; nor is doubt a cause."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_aero.diagnosis import diagnose
from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.screening import accuracy
from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.screening.partialled_regression import PartialledRegression
from bayes_aero.diagnosis.screening.regression import Fit
from bayes_aero.diagnosis.screening.screening import CandidateScore, ScreeningResult
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection import forward_selection
from bayes_aero.diagnosis.selection.forward_selection import Extension, worth
from bayes_aero.diagnosis.settings import DEFAULT
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.axes import Axis
from bayes_aero.model.model import Model


def part(kind, **given):
    """An instance of a dataclass with these fields alone: what is judged here needs no aircraft."""
    made = object.__new__(kind)
    for name, value in given.items():
        assert name in {f.name for f in fields(kind)}
        object.__setattr__(made, name, value)
    return made


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
    fit = Fit(np.array([0]), np.zeros(1), np.array([[n * np.sum(1.0 / variance)]]), variance, 0.0)
    return PartialledRegression(state, fit, [np.array([1]), np.array([2])]), residual


def test_a_sum_of_outputs_gains_under_single_variances_and_nothing_under_a_whole_covariance(projected):
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


def test_the_whole_covariance_does_not_ask_which_outputs_were_chosen(projected):
    given, residual = projected
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
    fit = Fit(np.array([0]), np.zeros(1), np.array([[beta @ beta / left]]), np.array([left]), 0.0)
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
    fit = Fit(np.zeros(0, int), np.zeros(0), np.zeros((0, 0)), np.ones(1), 0.0)
    causes, minor = worth(state, fit, {"cg_shift": Size(size, size / score, "m")})
    assert (causes, minor) == ((("cg_shift",), ()) if named else ((), ("cg_shift",)))
    assert scores[0] > DEFAULT.least_score or not named


@pytest.mark.parametrize(("together", "rivals"), [(-140.0, ()), (480.0, ("cg_shift",))])
def test_what_only_mixes_noise_is_no_rival(monkeypatch, together, rivals):
    """A centre of gravity that adds CY to Cn takes the vane's noise out of Cn, whatever else is missing there."""

    def standing(name, gain, together):
        return CandidateScore(name, (0,), None, gain, 12.0, 1.0, 50.0, (0.1,), (0.01,), together, 1.0)

    ranked = (standing("cg_shift", 500.0, together), standing("sideslip_cubed_yaw", 250.0, 400.0))
    monkeypatch.setattr(diagnose, "screen", lambda *_, **__: part(ScreeningResult, candidate_scores=ranked))
    candidates = tuple(CATALOGUE[one.effect] for one in ranked)
    full = part(CandidateModel, candidates=candidates, settings=DEFAULT)
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

    def standing(name, gain, step):
        return CandidateScore(name, (0,), None, gain, 12.0, 1.0, 50.0, (step,), (0.01,), gain, 1.0)

    ranked = (standing("vane_position", 260.0, step), standing("alpha_bias", 250.0, 0.01))
    monkeypatch.setattr(diagnose, "screen", lambda *_, **__: part(ScreeningResult, candidate_scores=ranked))
    full = part(CandidateModel, candidates=tuple(CATALOGUE[one.effect] for one in ranked), settings=DEFAULT)
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
