"""Every decision follows from the number that is cited for it: verdicts, names, sizes, rivals and hold-out data."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from parts import cause, part
from scipy.special import erfc
from scipy.stats import norm

from bayes_aero.diagnosis import consistency, result, unexplained
from bayes_aero.diagnosis import diagnose as decided
from bayes_aero.diagnosis import selection as selecting
from bayes_aero.diagnosis.consistency import errors_of_diagnosis
from bayes_aero.diagnosis.screening import ScreeningResult, autocorrelation_of, uncertainty
from bayes_aero.diagnosis.search import SearchResult
from bayes_aero.diagnosis.selection import Extension, LeftOut, backward_elimination, cancelling, implausible
from bayes_aero.diagnosis.selection_state import DEFAULT, CandidateModel, RegressionFit, SelectionState, linearised
from bayes_aero.diagnosis.trajectories import left_out_of
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.health import OpenError
from bayes_aero.inference.results import Scores
from bayes_aero.physics.aircraft import NAMES
from bayes_aero.report.pages.diagnosis import sentences
from bayes_aero.residuals.equation_error import EquationError


def advised(d: result.Diagnosis, name: str) -> bool:
    """Whether the report says how to put a cause on the card."""
    return any(s.startswith("In [model] of the card add ") and f'"{name}"' in s for s in sentences(d))


def test_held_out_flights_that_are_predicted_worse_deny_a_cause(diagnosed):
    d = diagnosed.view.diagnosis
    name = d.causes[0].name
    flights = result.Confirmation((), {name: (90.0, 5.0)}, {name: {"q": (-111.6, 20.0)}})
    judged = decided.judged_on_held_out_flights(d, flights)
    assert not judged.causes[0].confirmed
    told = next(s for s in sentences(judged) if s.startswith(f"{name}: "))
    assert "with it they are predicted worse: log density of q -111.6 ± 20.0" in told


class Told(LeftOut):
    """Hold-out data with these additions, by what each gains whatever else is in: of all, and of Cm."""

    def __init__(self, effects: Sequence[str], gains: dict, of_Cm: dict) -> None:
        object.__setattr__(self, "known", (frozenset(effects), gains, of_Cm))

    def gain(self, before) -> tuple[float, float]:
        (name,) = self.known[0] - before.known[0]
        return self.known[1][name], 1.0

    def output_gains(self, before) -> dict[str, tuple[float, float]]:
        (name,) = self.known[0] - before.known[0]
        return {"CL": (1.0, 0.5), "Cm": self.known[2].get(name, (0.0, 0.0))}


@pytest.mark.parametrize(("gains", "factor", "of_Cm", "kept", "refitted"), [
    ({"a": 9.0, "b": 1.0, "c": -3.0, "d": 2.0}, 1.0, {}, "ad", ["abcd", "abd", "ad", "a"]),  # of none nothing is fitted
    ({"a": 9.0, "b": 3.0}, 2.0, {}, "ab", []),  # to first order both are missed beyond doubt
    ({"a": 90.0, "b": 80.0}, 1.0, {"a": (-223.0, 30.0)}, "b", []),  # worse beyond noise, however much the others gain
    ({"a": 90.0, "b": 80.0}, 1.0, {"a": (-20.0, 15.0)}, "ab", []),  # worse, within noise
    ({"a": 90.0, "b": 80.0}, 1.0, {"a": (-2.0, 0.1)}, "ab", []),  # within the margin of models that are as good
])  # fmt: skip
def test_additions_go_out_the_least_missed_first_and_are_fitted_again_in_doubt(gains, factor, of_Cm, kept, refitted):
    refits = []

    def again(effects):
        refits.append("".join(effects))
        return Told(effects, gains, of_Cm)

    first_order = partial(Told, gains={name: factor * x for name, x in gains.items()}, of_Cm=of_Cm)
    found = backward_elimination(tuple(gains), first_order, again, DEFAULT)
    assert "".join(found.kept) == kept
    assert refits == refitted or of_Cm
    assert found.harmed == ({} if kept != "b" else of_Cm and {"a": {"Cm": of_Cm["a"]}})
    if factor == 1.0:
        assert list(found.missed.items()) == [(name, (x, 1.0)) for name, x in gains.items()]


@pytest.mark.parametrize("compared", ["coefficients", "innovations", "trajectories", "flight path"])
def test_an_output_that_is_predicted_worse_denies_a_cause_however_the_model_meets_the_record(compared, monkeypatch):
    """Mean squares times 0.01, 1 and 9.7 / 1.04: all together gain, the last loses 50 log(9.7 / 1.04) nats of 200
    samples at a variance inflation of 2. Of the flight path, which wanders, coefficients say what becomes worse."""
    n, outputs = 200, ("CL", "CD", "Cm") if compared == "coefficients" else ("V", "q", "h")
    noise = np.random.default_rng(6).standard_normal((n, 3))

    def left(effects):
        return noise * np.array([0.1, 1.0, np.sqrt(9.7 / 1.04)]) if effects else noise

    if compared == "trajectories":  # of segments of different length, in which noise has grown
        inside = np.arange(110) < np.array([[90], [110]])
        flown = part(SegmentTrajectories, outputs=outputs, noise_growth=np.full((2, 110, 3), 2.0), inside=inside)

        def unseen(effects):
            parts = [dict(zip(outputs, x.T, strict=True)) for x in np.split(left(effects), [90])]
            still = [dict.fromkeys(outputs, np.zeros(length)) for length in (90, 110)]
            paths = [
                part(result.SimulatedManoeuvre, measured=x, simulated=y, inside=True)
                for x, y in zip(parts, still, strict=True)
            ]
            return left_out_of(paths, flown, 2.0)

        found = backward_elimination(("rudder_moment",), unseen, unseen, DEFAULT)
    else:
        monkeypatch.setattr(LeftOut, "first_order", lambda state, effects: LeftOut._of(state, left(effects)))
        monkeypatch.setattr(LeftOut, "refitted", lambda told: LeftOut._of(told[0], left(told[1])))
        monkeypatch.setattr(selecting, "truncated", lambda state, effects: (state, effects))
        responses = SimpleNamespace(
            model=SimpleNamespace(coefficients=("CL", "CD", "Cm")), kinematic=compared == "flight path",
            flights=SimpleNamespace(lengths=(100, 100)),
        )  # fmt: skip
        found = selecting.confirmation(part(
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
        Extension, state=part(SelectionState, active=names), causes=names, minor=(), steps=(),
        sizes={p: x for n in names for p, x in cause(n).parameters.items()},
    )  # fmt: skip
    return part(SearchResult, full=full, stages={"coefficients": one}, forms=forms or {})


@pytest.fixture
def stated(monkeypatch):
    """What is computed from flights, stated instead."""

    def state(**values):
        for name, value in {
            "_excited": True, "own_share": 0.5, "correlated": {}, "implausible": {}, "rivals_of": (0.9, ()),
            "gains_of": {}, "rival_gains": {}, "noise_shares": dict.fromkeys(CATALOGUE, 0.0),
        }.items():  # fmt: skip
            given = values.get(name, value)
            where = decided if hasattr(decided, name) else selecting
            monkeypatch.setattr(where, name, given if callable(given) else lambda *_, given=given, **__: given)
        monkeypatch.setattr(selecting, "confirmation", lambda _: values["confirmation"])

    return state


def decided_on(stated, diagnosed, forms=None, **values):
    """A cause that held-out flights miss, kept by stage, a diagnosis of it alone, and what is said of it."""
    values = {"gains_of": {"thrust_scale": cause().gain}} | values
    stated(confirmation=result.Confirmation(("thrust_scale",), {"thrust_scale": (40.0, 5.0)}), **values)
    ((found,), kept, _) = decided._confirmed(searched("thrust_scale", forms=forms), lambda *_: None)
    d = replace(diagnosed.view.diagnosis, causes=(found,), beyond=())
    return found, kept, d, next(s for s in sentences(d) if s.startswith("thrust_scale: "))


@pytest.mark.parametrize(
    ("gain", "rivals"),
    [((-269.0, 35.0), ()), ((-4.0, 0.5), ()), ((-20.0, 15.0), ("mass_scale",)), ((1.9, 1.4), ("mass_scale",))],
)
def test_a_rival_is_as_good_only_where_hold_out_data_say_so(stated, diagnosed, gain, rivals):
    """To first order it is within 3 nats; fitted in place of the cause, the hold-out data decide."""

    def rivals_of(_, __, worse=(), noise=0.0):  # noqa: ARG001
        return (1.0, ()) if "mass_scale" in worse else (0.55, ("mass_scale",))

    found, kept, d, told = decided_on(stated, diagnosed, rivals_of=rivals_of, rival_gains={"mass_scale": gain})
    assert kept == {"coefficients": ("thrust_scale",)}
    assert found.ambiguous_with == rivals
    assert found.probability == (0.55 if rivals else 1.0)
    assert (f"log density of hold-out data {gain[0]:+.1f} ± {gain[1]:.1f}" in told) == bool(rivals)
    assert advised(d, "thrust_scale") != bool(rivals)


@pytest.mark.parametrize(("less", "probability"), [(0.0, 9.0 / 19.0), (np.log(9.0), 9.0 / 11.0), (-200.0, 0.0)])
def test_a_form_that_explains_as_well_as_a_cause_is_its_rival(stated, diagnosed, less, probability):
    """Odds of 9 to 1 against the effects, and of exp(`less`) to 1 against the form: p = 1 / (1 / 0.9 + exp(-less))."""
    form = "a form (CD over alpha^2)"
    found, _, _, told = decided_on(stated, diagnosed, forms={"thrust_scale": (form, less)})
    assert found.ambiguous_with == (form,)
    assert found.probability == pytest.approx(probability)
    assert found.sure == (probability > 0.5)
    assert f"{form} would explain the data about as well" in told


SCORES = [Scores(0.5, 0.1, 0.5, r2) for r2 in (-0.04, -8.70)]


@pytest.mark.parametrize("worse", [
    {"elpd": -30.0, "elpd_se": 5.0},  # loses beside the causes before it, though the others miss it
    {"degraded": {"Cm": (-223.0, 30.0)}, "before": {"Cm": SCORES[0]}, "after": {"Cm": SCORES[1]}},
])  # fmt: skip
def test_a_cause_that_loses_on_hold_out_data_is_not_confirmed_and_said_so(stated, diagnosed, worse):
    gains = {"thrust_scale": replace(cause().gain, **worse)}
    found, kept, _, told = decided_on(stated, diagnosed, gains_of=gains)
    assert not found.confirmed
    assert not found.sure
    assert kept == {"coefficients": ()}
    assert "do not confirm it" in told
    assert ("Cm -223.0 ± 30.0" in told) == ("degraded" in worse)


def test_what_was_added_or_named_is_not_called_untestable(diagnosed, monkeypatch):
    """A lag is a state of its own and is tried last: one that was found is not called untestable."""
    lagged = searched("separation_lag", separation_lag="a lag is a state of its own", flap_lift="flap does not move")
    assert lagged.not_testable == {"flap_lift": "flap does not move"}
    # Named, if not surely; the flight path alone cannot part it from others, which the cause itself says.
    d = diagnosed.view.diagnosis
    sensor = next(c for c in d.causes if c.stage == "flight path")
    error = OpenError(sensor.name, "1", 0.1, 0.01, 0.1, False, ("alpha_scale",), 0.99)
    monkeypatch.setattr(consistency, "open_errors", lambda _: (error, replace(error, name="accel_x_bias")))
    unsure = errors_of_diagnosis(replace(d, causes=(replace(sensor, probability=0.3),)))
    assert [e.name for e in unsure.open] == ["accel_x_bias"]
    assert not unsure.errors
    (size,) = errors_of_diagnosis(d).errors["pitch_rate_bias"]["parameters"].values()
    assert size["mean"] == pytest.approx(diagnosed.hidden["pitch_rate_bias"]["pitch_rate_bias"], abs=4.0 * size["sd"])


def test_half_of_a_joint_estimate_is_no_cause(diagnosed):
    """A bias of 10.7 m/s is larger than any sensor has; the scale holds only beside it."""
    measured = {"kind": "measurement", "stage": "flight path", "missed": (90.0, 5.0)}
    scale = replace(cause("airspeed_scale", -0.0614, 0.0043), joint={"airspeed_bias": -0.97}, **measured)
    bias = replace(cause("airspeed_bias", 10.7, 0.48), joint={"airspeed_scale": -0.97}, **measured)
    bias = replace(bias, implausible={"airspeed_bias": 8.0})
    causes, beyond = decided.without_conditional((scale,), (bias,))
    assert (causes, beyond) == ((), (bias, scale))
    d = replace(diagnosed.view.diagnosis, causes=causes, beyond=beyond)
    assert not advised(d, "airspeed_scale")
    (said,) = [s for s in sentences(d) if s.startswith("airspeed_scale was estimated together")]
    assert "airspeed_bias (correlation -0.97)" in said
    assert decided.without_conditional((scale,), ()) == ((scale,), ())


@pytest.mark.parametrize("level", [0.01, 0.05])
def test_the_threshold_that_figures_show_is_the_level_at_which_causes_are_selected(level):
    """Of 200 replicates with scores 1 to 200, (1 + k) / 201 is at most 1 % for k of 1: beyond 199. For 5 %: k of 9."""
    found = part(ScreeningResult, nulls=np.random.default_rng(0).permutation(np.arange(1.0, 201.0)))
    assert found.threshold(level) == {0.01: 199.0, 0.05: 191.0}[level]
    assert found.p_value(found.threshold(level) + 0.5) <= level < found.p_value(found.threshold(level) - 0.5)
    assert np.isnan(part(ScreeningResult, nulls=np.zeros(0)).threshold(level))


PAIR = ("pitch_rate_lift", "alpha_dot_lift")
LEFT = (result.UnexplainedStructure("Cm", "phi", 0.2, 0.01),)


def test_the_verdict_rests_on_what_is_confirmed_and_likely():
    sure, open_, unlikely = cause(), cause(confirmed=False), cause(probability=0.17)
    assert result.verdict_of([], ()) is result.Verdict.NO_EFFECT
    assert result.verdict_of([sure, open_], ()) is result.Verdict.EXPLAINED
    assert result.verdict_of([sure, unlikely], LEFT) is result.Verdict.PARTLY_EXPLAINED
    for doubtful in (open_, unlikely, cause(implausible={"thrust_scale": 0.3})):
        assert result.verdict_of([doubtful], ()) is result.Verdict.UNEXPLAINED
        assert result.verdict_of([doubtful], LEFT) is result.Verdict.UNEXPLAINED
    of_a_sensor = replace(
        cause(name="roll_rate_scale", mean=0.22, implausible={"roll_rate_scale": 0.15}), stage="flight path"
    )
    assert (
        result.verdict_of([of_a_sensor], ()) is result.Verdict.NO_EFFECT
    )  # that sensors disagree is no fault of the card's model
    bounded = replace(sure, parameters={"thrust_scale": result.Size(-0.9, 0.01, "1", at_bound=True)})
    assert result.verdict_of([bounded], ()) is result.Verdict.UNEXPLAINED


@pytest.mark.parametrize(("parameter", "effect", "mean", "sd", "largest"), [
    ("thrust_scale", "thrust_scale", -0.48, 0.02, {"thrust_scale": 0.3}),
    ("thrust_scale", "thrust_scale", -0.48, 0.15, {"thrust_scale": 0.3}),  # a record that does not know it, too
    ("thrust_scale", "thrust_scale", -0.08, 0.004, {}),
    # Pitch rate makes lift at the tail: 2 a V_H per q c/2V, some 5 per q c/V. Three real records gave 20.
    ("CLq", "pitch_rate_lift", 19.6, 1.1, {"CLq": 10.0}), ("CLq", "pitch_rate_lift", 5.0, 1.1, {}),
    # Of induced drag 1/e counts, which is zero without it: no wing has an e of 0.2, and 0.8 is that of most.
    ("e", "induced_drag", 0.2, 0.01, {"1/e": 3.0}), ("e", "induced_drag", 0.8, 0.01, {}),
    # A stall is abrupt: 20/rad times or over e^0.7. At three of these X falls from 0.9 to 0.1 over 51 deg.
    ("a1", "flow_separation", 1.34, 0.3, {"1/a1": pytest.approx(np.exp(2.1) / 20.0)}),
    ("a1", "flow_separation", 4.0, 2.0, {}), ("a1", "flow_separation", 60.0, 20.0, {}),
])  # fmt: skip
def test_sizes_that_no_aircraft_has_are_implausible(parameter, effect, mean, sd, largest):
    assert implausible(CATALOGUE[effect], {parameter: result.Size(mean, sd, "1")}) == largest


def test_sizes_that_no_sensor_or_aircraft_has_are_said(diagnosed):
    d = diagnosed.view.diagnosis
    off = cause("alpha_bias", np.radians(9.0), np.radians(0.5), implausible={"alpha_bias": np.radians(3.0)})
    found = replace(next(c for c in d.causes if c.name == "alpha_squared_moment"), ambiguous_with=())
    large = replace(found, implausible={"Cma2": 0.1})
    said = sentences(replace(d, beyond=(replace(off, kind="measurement"), large)))
    (sentence,) = [x for x in said if "alpha_bias" in x]
    assert "9.00 ± 0.50 deg" in sentence
    assert "at most 3 deg" in sentence
    assert any("on this aircraft" in x and "left out of the model" in x for x in said)
    search = part(SearchResult, full=d.aerodynamics.state.full, stages={found.stage: d.aerodynamics}, unknown=())
    (left,) = decided.structure_of(search, [large])
    assert (left.coefficient, left.channel, left.rivals) == ("Cm", "alpha", ("alpha_squared_moment",))
    assert decided.structure_of(search, [replace(large, kind="measurement")]) == ()


def test_more_than_five_names_and_errors_that_no_sensor_has_are_no_cause():
    names = ("mass_scale", "drag_offset", "accel_x_bias", "density_scale", "mach_drag")
    few, many = cause(ambiguous_with=names[: DEFAULT.most_names - 1]), cause(ambiguous_with=names)
    assert decided.attributed([few, many]) == ((few,), (), (many,))
    unlikely, open_ = cause(probability=0.33), cause(confirmed=False)
    assert decided.attributed([unlikely, open_]) == ((unlikely, open_), (), ())
    neither = replace(unlikely, confirmed=False)
    assert decided.attributed([neither]) == ((), (), (neither,))
    scale = cause(name="roll_rate_scale", mean=0.22, implausible={"roll_rate_scale": 0.15})
    of_a_sensor, of_the_model = replace(scale, kind="measurement"), replace(scale, kind="aerodynamics")
    assert decided.attributed([of_a_sensor, of_the_model]) == ((), (of_a_sensor, of_the_model), ())


def test_what_is_larger_than_on_any_aircraft_leaves_and_all_is_selected_without_it(monkeypatch):
    """The second selection is that of the model, and it never sees what the first found too large."""

    def of(size, *active):
        full = part(CandidateModel, candidates=tuple(CATALOGUE[n] for n in ("alpha_dot_lift", "mach_drag")))
        base, state = (part(SelectionState, full=full, active=names) for names in ((), active))
        sizes = {"CLadot": result.Size(size, 20.0, "1"), "CDM": result.Size(0.1, 0.01, "1")}
        return Extension(base, state, (), sizes, active, ())

    asked: list[tuple[str, ...]] = []
    given = [of(-42.9, "alpha_dot_lift", "mach_drag"), of(0.0)]

    def once(_, *, barred, **__):
        asked.append(tuple(barred))
        return given[len(asked) - 1]

    monkeypatch.setattr(selecting, "selected", once)
    monkeypatch.setattr(selecting, "sized", lambda found: found)
    found = selecting.plausible_selection(given[0].base)
    assert asked == [(), ("alpha_dot_lift",)]
    assert found.state.active == ()
    assert found.larger[0].implausible == ("alpha_dot_lift",)


def test_what_stands_in_for_structure_tells_where_and_how_much(diagnosed):
    """The hidden curvature of the pitching moment, as if a linear term did nearly the same."""
    d = diagnosed.view.diagnosis
    found = next(c for c in d.causes if c.name == "alpha_squared_moment")
    extensions = {found.stage: d.aerodynamics}
    for share, output, taken in ((0.01, "Cm", True), (0.01, "CL", False), (0.03, "Cm", False)):
        one = replace(found, own_share=share)
        names = decided.stand_ins([one], extensions, {output})
        assert names == ((found.name,) if taken else ())
        assert decided.attributed([one], stand_ins=names) == (((), (), (one,)) if taken else ((one,), (), ()))
    # The hidden curvature of the pitching moment, as if five others explained it as well.
    names = ("mass_scale", "drag_offset", "accel_x_bias", "density_scale", "mach_drag")
    effect = CATALOGUE[found.name]
    unknown = decided.as_structure(replace(found, ambiguous_with=names), d.aerodynamics, effect)
    assert (unknown.coefficient, unknown.channel) == ("Cm", "alpha")
    assert 0.04 < unknown.share < 1.0
    assert unknown.rivals == (found.name, *names)


def test_what_flight_does_not_miss_or_cannot_test_is_not_confirmed(diagnosed):
    d = diagnosed.view.diagnosis
    names = [c.name for c in d.causes]
    assert d.verdict is not result.Verdict.UNEXPLAINED
    nothing = decided.judged_on_held_out_flights(d, result.Confirmation((), dict.fromkeys(names, (1.0, 2.0))))
    assert not any(c.confirmed for c in nothing.causes)
    assert nothing.verdict is result.Verdict.UNEXPLAINED
    assert decided.judged_on_held_out_flights(d, result.Confirmation((), {})) == d
    # The joint estimate has seen the flight that is left out.
    untested = replace(d, causes=tuple(replace(c, missed=(float("nan"), float("nan"))) for c in d.causes))
    found = decided.judged_on_held_out_flights(untested, result.Confirmation((), {}), {"Cma2"})
    assert {c.name for c in found.causes if not c.confirmed} == {"alpha_squared_moment"}
    assert "alpha_squared_moment: named, but not tested on hold-out data." in sentences(found)
    # Noise of the regressors bends coefficients as an error of a sensor may; a simulated flight has none.
    scale = replace(cause("accel_y_scale", -0.22, 0.05), kind="measurement")
    of_the_path = replace(scale, name="alpha_scale", stage="flight path")
    d = replace(d, causes=(scale, of_the_path, *d.causes))
    flights = result.Confirmation((), {c.name: (-4.0, 16.0) for c in d.causes})
    doubtful = decided.sensors_not_missed(d, flights)
    assert set(doubtful.missed) == {"accel_y_scale"}
    judged = decided.judged_on_held_out_flights(d, doubtful)
    assert [c.name for c in judged.causes if not c.confirmed] == ["accel_y_scale"]
    assert not decided.sensors_not_missed(d, replace(flights, kept=("accel_y_scale",))).missed


def on(state, flights, values) -> Extension:
    """Both terms in, with these values, on a record."""
    theta = state.theta.copy()
    theta[state.full.columns(list(values))] = list(values.values())
    both = linearised(state.full, EquationError.of(flights, state.full.model), NAMES, theta, PAIR)
    return Extension(both, both, (), {}, PAIR, ())


def test_two_terms_that_cancel_are_known_by_their_sum_and_their_own_share(state, flights):
    """In a doublet the flight path bends little: alpha-dot is pitch rate, and large opposite terms are their sum."""
    doublet = flights.flown["elevator_doublet"]
    found = on(state, doublet, {"CLq": 19.6, "CLadot": -18.2})
    (pair,) = cancelling(found, PAIR)
    assert pair.parameters == ("CLq", "CLadot")
    assert pair.correlation < -0.9
    assert pair.mean == pytest.approx(19.6 - 18.2 * pair.factor)
    assert pair.factor == pytest.approx(1.0, abs=0.1)
    # Of a combination with correlation near -1 little is left of either deviation: closed form of a sum's variance.
    columns = found.state.full.columns(["CLq", "CLadot"])
    colour = autocorrelation_of(found.state.left(), found.state.folds)
    at = [int(np.flatnonzero(found.state.best.columns == c)[0]) for c in columns]
    C = uncertainty(found.state, colour)[np.ix_(at, at)]
    assert pair.sd**2 == pytest.approx(C[0, 0] + 2 * pair.factor * C[0, 1] + pair.factor**2 * C[1, 1])
    assert pair.sd < 0.1 * np.sqrt(C[0, 0])
    turn = on(state, flights.flown["bank_to_bank"], {"CLq": 19.6, "CLadot": -18.2})
    assert not cancelling(turn, PAIR)  # it has pitch rate at constant alpha
    assert not cancelling(on(state, doublet, {"CLq": 4.0, "CLadot": 2.0}), PAIR)  # nothing cancels
    # Closed form: what a regression on the others leaves of the effect's sensitivity, over its spread.
    recorded = on(state, state.responses.flights, {"CLq": 4.0}).state
    fit, own = recorded.best, int(recorded.full.columns(["CLq"])[0])
    weighed = recorded.scaled[recorded.inside] / np.sqrt(fit.variance)[:, None]
    S = weighed.reshape(-1, recorded.S.shape[2])
    x, others = S[:, own], S[:, [c for c in fit.columns if c != own]]
    scale = np.sqrt(np.sum(others**2, axis=0))
    left = x - (others / scale) @ np.linalg.lstsq(others / scale, x, rcond=None)[0]
    spread = np.sum((weighed[:, :, own] - weighed[:, :, own].mean(axis=0)) ** 2)
    assert decided.own_share(recorded, "pitch_rate_lift") == pytest.approx(left @ left / spread, rel=1e-3)
    assert np.isnan(decided.own_share(recorded, "sideslip_drag"))  # not in


@pytest.mark.parametrize(("deviations", "reported"), [(0.358, False), (1.9, False), (2.1, True)])
def test_an_offset_between_manoeuvres_is_reported_only_beyond_chance(monkeypatch, deviations, reported):
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
        monkeypatch.setattr(unexplained if name == "moved" else unexplained.screening, name, given)
    found = unexplained.offsets_found(part(Extension, state=state))
    assert [(one.coefficient, one.channel) for one in found] == ([("Cm", "manoeuvre")] if reported else [])
    for one in found:
        assert one.p_value == pytest.approx(erfc(deviations / np.sqrt(2.0)))
        assert one.offsets == {"two": pytest.approx((deviations * np.sqrt(2.0), np.sqrt(2.0)))}


@pytest.mark.parametrize(("left", "verdict"), [(1.2, result.Verdict.PARTLY_EXPLAINED), (0.3, result.Verdict.EXPLAINED)])
def test_trajectories_alone_claim_no_more_than_was_tested(diagnosed, left, verdict):
    """One sure cause, and the simulation still off by 1.2 m/s where the sensor is off by 0.3 m/s, or not."""
    d = replace(diagnosed.view.diagnosis, causes=(cause(),), unknown=(), verdict=verdict)
    tested = result.Tested({"airspeed": result.OutputMiss(0.3, left, 1.2)})
    headline, detail, *_ = sentences(replace(d, tested=tested))
    assert ("explain" in headline) is (verdict is result.Verdict.EXPLAINED)
    assert ("V 1.2 m/s" in headline) is (verdict is not result.Verdict.EXPLAINED)
    assert "(noise 0.30 m/s)" in detail
    off = result.Tested({"q": result.OutputMiss(0.0, 1.0, 1.0)})
    assert "57 deg/s" in sentences(replace(d, causes=(), verdict=result.Verdict.UNDECIDED, tested=off))[0]
    assert "was not computed" in sentences(replace(d, tested=result.Tested({})))[0]
