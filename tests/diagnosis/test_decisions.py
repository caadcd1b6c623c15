"""Every decision of a diagnosis follows from the number that is cited for it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from parts import cause, part
from scipy.special import erfc
from scipy.stats import norm

from bayes_aero.diagnosis import accuracy, consistency, unexplained
from bayes_aero.diagnosis import diagnose as decided
from bayes_aero.diagnosis.accuracy import Confirmation, LeftOut, backward_elimination
from bayes_aero.diagnosis.candidate_set import DEFAULT, CandidateModel
from bayes_aero.diagnosis.consistency import errors_of_diagnosis
from bayes_aero.diagnosis.flights import left_out_of
from bayes_aero.diagnosis.result import Cause, Diagnosis
from bayes_aero.diagnosis.screening import ScreeningResult
from bayes_aero.diagnosis.search import SearchResult
from bayes_aero.diagnosis.selection import Extension
from bayes_aero.diagnosis.selection_state import RegressionFit, SelectionState
from bayes_aero.diagnosis.trajectory_result import SimulatedManoeuvre
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.health.finding import OpenError
from bayes_aero.inference.scores import Scores, ScoreStatus
from bayes_aero.report.text.diagnosis import diagnosis_sentences


def contradictions(d: Diagnosis) -> list[str]:
    """Where what a diagnosis decides is at odds with a number that it reports."""
    found, settings = [], DEFAULT
    undecided = {e.name for e in errors_of_diagnosis(d).open}
    for c in d.causes:
        if c.name in d.not_testable or c.name in undecided:
            found.append(f"{c.name} is named and not testable")
        for rival, gain in c.rival_gains.items():
            if rival in c.ambiguous_with and settings.degrades(*gain):
                found.append(f"{rival} explains the data about as well at {gain}")
        if c.ambiguous_with and advised(d, c.name):
            found.append(f"{c.name} is chosen among its rivals")
        if any(one.name in c.joint for one in d.beyond):
            found.append(f"{c.name} is named, and estimated together with an error that no sensor has")
        if not c.confirmed:
            continue
        if c.missed[0] <= settings.hold_out * c.missed[1] or settings.degrades(c.gain.elpd, c.gain.elpd_se):
            found.append(f"{c.name} is confirmed and not missed")
        if c.gain.degraded:
            found.append(f"{c.name} is confirmed and predicts {', '.join(c.gain.degraded)} worse")
    return found


def advised(d: Diagnosis, name: str) -> bool:
    """Whether the report says how to put a cause on the card."""
    begins = (f"To include {name} ", f"{name}: correct the record")
    return any(s.startswith(begins) for s in diagnosis_sentences(d))


def test_a_diagnosis_has_no_contradictions_nor_where_held_out_flights_deny_it(diagnosed):
    assert not contradictions(diagnosed.view.diagnosis)
    d = diagnosed.view.diagnosis
    name = d.causes[0].name
    flights = Confirmation((), {name: (90.0, 5.0)}, {name: {"q": (-111.6, 20.0)}})
    found = decided.judged_on_held_out_flights(d, flights)
    assert not found.causes[0].confirmed
    assert not contradictions(found)
    told = next(s for s in diagnosis_sentences(found) if s.startswith(f"{name}: "))
    assert "with it they are predicted worse: log density of q -111.6 ± 20.0" in told


class Told(LeftOut):
    """Hold-out data with these additions, by what each gains: of all, and of Cm."""

    def __init__(self, effects: Sequence[str], all_of: dict, of_Cm: dict) -> None:
        object.__setattr__(self, "known", (frozenset(effects), all_of, of_Cm))

    def gain(self, before) -> tuple[float, float]:
        (name,) = self.known[0] - before.known[0]
        return self.known[1][name]

    def output_gains(self, before) -> dict[str, tuple[float, float]]:
        (name,) = self.known[0] - before.known[0]
        return {"CL": (1.0, 0.5), "Cm": self.known[2][name]}


@pytest.mark.parametrize(("of_Cm", "kept"), [
    ((-223.0, 30.0), ("drag_offset",)),  # worse beyond noise, however much the others gain, and in first order
    ((-20.0, 15.0), ("rudder_moment", "drag_offset")),  # worse, within noise
    ((-2.0, 0.1), ("rudder_moment", "drag_offset")),  # within the margin of models that are as good
])  # fmt: skip
def test_a_cause_with_which_a_coefficient_is_predicted_worse_is_not_kept(of_Cm, kept):
    gains = {"rudder_moment": (90.0, 5.0), "drag_offset": (80.0, 4.0)}
    told = partial(Told, all_of=gains, of_Cm={"rudder_moment": of_Cm, "drag_offset": (0.0, 0.0)})
    found = backward_elimination(("rudder_moment", "drag_offset"), told, told)
    assert found.kept == kept
    assert found.harmed == ({} if "rudder_moment" in kept else {"rudder_moment": {"Cm": of_Cm}})


def test_the_gain_of_each_coefficient_is_that_of_its_mean_square():
    """Log density of n residuals at their own mean square s2: -n/2 (log 2 pi s2 + 1), over the variance inflation."""
    rng, n = np.random.default_rng(6), 200
    before = rng.standard_normal((n, 3))
    after = before * np.array([0.1, 1.0, np.sqrt(9.7 / 1.04)])  # R2 of Cm from -0.04 to -8.70
    plain = np.ones((n, 3)), np.ones(n, bool), ("CL", "CD", "Cm"), (100, 100), 2.0
    less, whole = (LeftOut(x, *plain) for x in (before, after))
    gains = whole.output_gains(less)
    expected = {"CL": 50.0 * np.log(100.0), "CD": 0.0, "Cm": -50.0 * np.log(9.7 / 1.04)}
    assert {name: gain for name, (gain, _) in gains.items()} == pytest.approx(expected, abs=1e-9)
    assert whole.gain(less)[0] == pytest.approx(sum(expected.values()))
    assert sum(expected.values()) > 0.0  # all together they confirm it
    assert DEFAULT.degrades(*gains["Cm"])


@pytest.mark.parametrize("compared", ["coefficients", "innovations", "trajectories", "flight path"])
def test_an_output_that_is_predicted_worse_denies_a_cause_however_the_model_meets_the_record(compared, monkeypatch):
    """Mean squares times 0.01, 1 and 9.7 / 1.04: all together gain, the last loses 50 log(9.7 / 1.04) nats of 200
    samples at a variance inflation of 2. Of the flight path, which wanders, coefficients say what becomes worse."""
    n, outputs = 200, ("CL", "CD", "Cm") if compared == "coefficients" else ("V", "q", "h")
    noise = np.random.default_rng(6).standard_normal((n, 3))

    def left(effects):
        return noise * np.array([0.1, 1.0, np.sqrt(9.7 / 1.04)]) if effects else noise

    if compared == "trajectories":
        flown = part(
            SegmentTrajectories, outputs=outputs, noise_growth=np.ones((2, 100, 3)), inside=np.ones((2, 100), bool)
        )

        def unseen(effects):
            rest = {"simulated": dict.fromkeys(outputs, np.zeros(100)), "inside": True}
            halves = [dict(zip(outputs, x.T, strict=True)) for x in np.split(left(effects), 2)]
            paths = [part(SimulatedManoeuvre, measured=x, **rest) for x in halves]
            return left_out_of(paths, flown, 2.0)

        found = backward_elimination(("rudder_moment",), unseen, unseen)
    else:
        monkeypatch.setattr(LeftOut, "first_order", lambda state, effects: LeftOut._of(state, left(effects)))
        monkeypatch.setattr(LeftOut, "refitted", lambda told: LeftOut._of(told[0], left(told[1])))
        monkeypatch.setattr(accuracy, "truncated", lambda state, effects: (state, effects))
        responses = SimpleNamespace(
            model=SimpleNamespace(coefficients=("CL", "CD", "Cm")), kinematic=compared == "flight path",
            flights=SimpleNamespace(lengths=(100, 100)),
        )  # fmt: skip
        found = accuracy.confirmation(part(
            SelectionState, responses=responses, outputs=outputs, folds=(slice(0, 100), slice(100, n)),
            variance_inflation=2.0, active=("rudder_moment",), full=part(CandidateModel, settings=DEFAULT),
            theta=np.zeros(0), S=np.zeros((n, 3, 1)), noise_growth=np.ones((n, 3)),
        ))  # fmt: skip
    assert found.missed["rudder_moment"][0] == pytest.approx(50.0 * np.log(100.0 * 1.04 / 9.7))
    if compared == "flight path":
        assert found.kept == ("rudder_moment",)
        return
    assert found.kept == ()
    ((worse, (gain, se)),) = found.harmed["rudder_moment"].items()
    assert worse == outputs[2]
    assert gain == pytest.approx(-50.0 * np.log(9.7 / 1.04))
    assert DEFAULT.degrades(gain, se)


@pytest.mark.parametrize("outputs", [1, 3, 8])
def test_outputs_that_are_asked_at_once_share_the_chance_of_one(outputs):
    """Standard errors by which the largest of so many losses is beyond noise in 5 %, each at its share."""
    limit = norm.isf(0.05 / outputs)
    for away, lost in ((0.99, False), (1.01, True)):
        gains = {"one": (-20.0, 20.0 / (away * limit)), **{str(k): (1.0, 1.0) for k in range(outputs - 1)}}
        assert ("one" in DEFAULT.degraded(gains)) == lost


def searched(*names: str, forms: Mapping[str, tuple[str, float]] | None = None, **not_testable: str) -> SearchResult:
    """A search of coefficients that added these causes, with forms that explain as well."""
    full = part(
        CandidateModel, candidates=tuple(CATALOGUE[n] for n in names), not_testable=not_testable, settings=DEFAULT
    )
    one = part(
        Extension, state=part(SelectionState, active=names), fit=None, causes=names, minor=(), steps=(),
        sizes={p: x for n in names for p, x in cause(n).parameters.items()},
    )  # fmt: skip
    return part(SearchResult, full=full, stages=(("coefficients", one),), forms=forms or {})


@pytest.fixture
def stated(monkeypatch):
    """What is computed from flights, stated instead."""

    def state(**values):
        for name, value in {
            "_excited": True, "own_share": 0.5, "correlated": {}, "implausible": {}, "rivals_of": (0.9, ()),
            "gains_of": {}, "rival_gains": {}, "noise_shares": dict.fromkeys(CATALOGUE, 0.0),
        }.items():  # fmt: skip
            given = values.get(name, value)
            monkeypatch.setattr(decided, name, given if callable(given) else lambda *_, given=given, **__: given)
        monkeypatch.setattr(decided, "confirmation", lambda _: values["confirmation"])

    return state


@pytest.mark.parametrize(
    ("gain", "rivals"),
    [((-269.0, 35.0), ()), ((-4.0, 0.5), ()), ((-20.0, 15.0), ("mass_scale",)), ((1.9, 1.4), ("mass_scale",))],
)
def test_a_rival_is_as_good_only_where_hold_out_data_say_so(stated, diagnosed, gain, rivals):
    """To first order it is within 3 nats; fitted in place of the cause, the hold-out data decide."""

    def rivals_of(_, __, worse=(), noise=0.0):  # noqa: ARG001
        return (1.0, ()) if "mass_scale" in worse else (0.55, ("mass_scale",))

    stated(
        confirmation=Confirmation(("thrust_scale",), {"thrust_scale": (40.0, 5.0)}), rivals_of=rivals_of,
        rival_gains={"mass_scale": gain}, gains_of={"thrust_scale": cause().gain},
    )  # fmt: skip
    ((found,), kept, _) = decided._confirmed(searched("thrust_scale"), None)
    assert kept == {"coefficients": ("thrust_scale",)}
    assert found.ambiguous_with == rivals
    assert found.probability == (0.55 if rivals else 1.0)
    d = replace(diagnosed.view.diagnosis, causes=(found,), beyond=())
    assert not contradictions(d)
    told = next(s for s in diagnosis_sentences(d) if s.startswith("thrust_scale: "))
    assert (f"log density of hold-out data {gain[0]:+.1f} ± {gain[1]:.1f}" in told) == bool(rivals)
    assert advised(d, "thrust_scale") != bool(rivals)


@pytest.mark.parametrize(("less", "probability"), [(0.0, 9.0 / 19.0), (np.log(9.0), 9.0 / 11.0), (-200.0, 0.0)])
def test_a_form_that_explains_as_well_as_a_cause_is_its_rival(stated, diagnosed, less, probability):
    """Odds of 9 to 1 against the effects, and of exp(`less`) to 1 against the form: p = 1 / (1 / 0.9 + exp(-less))."""
    stated(
        confirmation=Confirmation(("thrust_scale",), {"thrust_scale": (40.0, 5.0)}),
        gains_of={"thrust_scale": cause().gain},
    )
    search = searched("thrust_scale", forms={"thrust_scale": ("a form (CD over alpha^2)", less)})
    ((found,), _, _) = decided._confirmed(search, None)
    assert found.ambiguous_with == ("a form (CD over alpha^2)",)
    assert found.probability == pytest.approx(probability)
    assert found.sure == (probability > 0.5)
    d = replace(diagnosed.view.diagnosis, causes=(found,), beyond=())
    told = next(s for s in diagnosis_sentences(d) if s.startswith("thrust_scale: "))
    assert "a form (CD over alpha^2) would explain the data about as well" in told


SCORES = [Scores(0.5, 0.1, 0.5, r2, ScoreStatus.ok) for r2 in (-0.04, -8.70)]


@pytest.mark.parametrize("worse", [
    {"elpd": -30.0, "elpd_se": 5.0},  # loses beside the causes before it, though the others miss it
    {"degraded": {"Cm": (-223.0, 30.0)}, "before": {"Cm": SCORES[0]}, "after": {"Cm": SCORES[1]}},
])  # fmt: skip
def test_a_cause_that_loses_on_hold_out_data_is_not_confirmed_and_said_so(stated, diagnosed, worse):
    gain = replace(cause().gain, **worse)
    stated(confirmation=Confirmation(("thrust_scale",), {"thrust_scale": (40.0, 5.0)}), gains_of={"thrust_scale": gain})
    ((found,), kept, _) = decided._confirmed(searched("thrust_scale"), None)
    assert not found.confirmed
    assert not found.sure
    assert kept == {"coefficients": ()}
    d = replace(diagnosed.view.diagnosis, causes=(found,), beyond=())
    assert not contradictions(d)
    assert contradictions(replace(d, causes=(replace(found, confirmed=True),)))
    told = next(s for s in diagnosis_sentences(d) if s.startswith("thrust_scale: "))
    assert "do not confirm it" in told
    assert ("Cm -223.0 ± 30.0, R² from -0.04 to -8.70" in told) == ("degraded" in worse)


def test_what_was_added_or_named_is_not_called_untestable(diagnosed, monkeypatch):
    """A lag is a state of its own and is tried last: one that was found is not called untestable."""
    found = searched("separation_lag", separation_lag="a lag is a state of its own", flap_lift="flap does not move")
    assert found.not_testable == {"flap_lift": "flap does not move"}
    # Named, if not surely; the flight path alone cannot part it from others, which the cause itself says.
    d = diagnosed.view.diagnosis
    sensor = next(c for c in d.causes if c.stage == "flight path")
    doubtful: Cause = replace(sensor, probability=0.3)
    one = OpenError(sensor.name, "1", 0.1, 0.01, 0.1, False, ("alpha_scale",), 0.99)
    monkeypatch.setattr(consistency, "open_errors", lambda _: (one, replace(one, name="accel_x_bias")))
    unsure = replace(d, causes=(doubtful,))
    assert not contradictions(unsure)
    assert [e.name for e in errors_of_diagnosis(unsure).open] == ["accel_x_bias"]


def test_half_of_a_joint_estimate_is_no_cause(diagnosed):
    """A bias of 10.7 m/s is larger than any sensor has; the scale holds only beside it."""
    pair = ("airspeed_scale", "airspeed_bias")
    scale, bias = (
        replace(
            cause(name, size, sd), kind="measurement", stage="flight path", joint={other: -0.97}, missed=(90.0, 5.0)
        )
        for name, other, size, sd in zip(pair, reversed(pair), (-0.0614, 10.7), (0.0043, 0.48), strict=True)
    )
    bias = replace(bias, implausible={"airspeed_bias": 8.0})
    d = replace(diagnosed.view.diagnosis, causes=(scale,), beyond=(bias,))
    assert contradictions(d)
    causes, beyond = decided.without_conditional((scale,), (bias,))
    assert (causes, beyond) == ((), (bias, scale))
    d = replace(d, causes=causes, beyond=beyond)
    assert not contradictions(d)
    assert not advised(d, "airspeed_scale")
    told = [s for s in diagnosis_sentences(d) if s.startswith("The estimate of airspeed_scale")]
    assert "airspeed_bias (correlation -0.97)" in told[0]
    assert decided.without_conditional((scale,), ()) == ((scale,), ())


@pytest.mark.parametrize(("deviations", "told"), [(0.358, False), (1.9, False), (2.1, True)])
def test_an_offset_between_manoeuvres_is_told_only_beyond_chance(monkeypatch, deviations, told):
    """Two manoeuvres: p = erfc(d / sqrt 2) of an offset of d standard errors, .72 at 0.358 and .05 at 1.96."""
    at, step = np.array([0, 1]), np.array([0.0, deviations * np.sqrt(2.0)])
    fit, less = (RegressionFit(at, step, np.eye(2), np.array([variance]), 0.0) for variance in (1.0, 1.25))
    state = part(
        SelectionState, apart=("Cm",), theta=np.zeros(0), nuisance=2, variance_inflation=1.0, folds=(),
        full=part(CandidateModel, settings=DEFAULT),
        responses=SimpleNamespace(flights=SimpleNamespace(names=("one", "two"), lengths=(9, 9))),
    )  # fmt: skip
    monkeypatch.setattr(SelectionState, "fit", lambda one: fit if one.apart else less)
    monkeypatch.setattr(SelectionState, "left", lambda *_: np.zeros((18, 1)))
    for name, given in {
        "moved": lambda *_, **__: part(SelectionState, apart=()),
        "screen": lambda *_, **__: part(ScreeningResult, candidate_scores=()), "uncertainty": lambda *_: np.eye(2),
    }.items():  # fmt: skip
        monkeypatch.setattr(unexplained, name, given)
    found = unexplained.offsets_found(part(Extension, state=state))
    assert [(one.coefficient, one.channel) for one in found] == ([("Cm", "manoeuvre")] if told else [])
    for one in found:
        assert one.p_value == pytest.approx(erfc(deviations / np.sqrt(2.0)))
        assert one.offsets == {"two": pytest.approx((deviations * np.sqrt(2.0), np.sqrt(2.0)))}


@pytest.mark.parametrize("level", [0.01, 0.05])
def test_the_threshold_that_figures_show_is_the_level_at_which_causes_are_selected(level):
    """Of 200 replicates with scores 1 to 200, (1 + k) / 201 is at most 1 % for k of 1: beyond 199. For 5 %: k of 9."""
    found = part(ScreeningResult, nulls=np.random.default_rng(0).permutation(np.arange(1.0, 201.0)))
    assert found.threshold(level) == {0.01: 199.0, 0.05: 191.0}[level]
    assert found.p_value(found.threshold(level) + 0.5) <= level < found.p_value(found.threshold(level) - 0.5)
    assert np.isnan(part(ScreeningResult, nulls=np.zeros(0)).threshold(level))
