"""Causes that the verdict may rest on, sizes that no aircraft has, terms that cancel, and names too many."""

from dataclasses import asdict, dataclass, replace

import numpy as np
import pytest
import six_axes
from parts import cause, part, with_candidates
from stranger_six import Plane, drawn, fly

from bayes_aero.diagnosis import result
from bayes_aero.diagnosis import selection as selecting
from bayes_aero.diagnosis.accuracy import Confirmation, Size, implausible
from bayes_aero.diagnosis.candidate_set import DEFAULT, CandidateModel
from bayes_aero.diagnosis.design import standard
from bayes_aero.diagnosis.diagnose import (
    as_structure,
    attributed,
    diagnose,
    judged_on_held_out_flights,
    own_share,
    sensors_not_missed,
    stand_ins,
    structure_of,
)
from bayes_aero.diagnosis.result import UnexplainedStructure, Verdict, verdict_of
from bayes_aero.diagnosis.screening import autocorrelation_of, uncertainty
from bayes_aero.diagnosis.search import SearchResult
from bayes_aero.diagnosis.selection import Extension, cancelling
from bayes_aero.diagnosis.selection_state import RegressionFit, SelectionState, linearised
from bayes_aero.effect import sized
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import read_card
from bayes_aero.model.model import lengths_of
from bayes_aero.physics.aircraft import NAMES, NO_AIRCRAFT
from bayes_aero.report.text.diagnosis import diagnosis_sentences
from bayes_aero.report.text.phrases import verdict_sentence
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.injection import hidden_records

PAIR = ("pitch_rate_lift", "alpha_dot_lift")
LEFT = (UnexplainedStructure("Cm", "phi", 0.2, 0.01),)


def test_the_verdict_rests_on_what_is_confirmed_and_likely():
    sure, open_, unlikely = cause(), cause(confirmed=False), cause(probability=0.17)
    assert verdict_of([], ()) is Verdict.NO_EFFECT
    assert verdict_of([sure, open_], ()) is Verdict.EXPLAINED
    assert verdict_of([sure, unlikely], LEFT) is Verdict.PARTLY_EXPLAINED
    for doubtful in (open_, unlikely, cause(implausible={"thrust_scale": 0.3})):
        assert verdict_of([doubtful], ()) is Verdict.UNEXPLAINED
        assert verdict_of([doubtful], LEFT) is Verdict.UNEXPLAINED
    of_a_sensor = replace(
        cause(name="roll_rate_scale", mean=0.22, implausible={"roll_rate_scale": 0.15}), stage="flight path"
    )
    assert verdict_of([of_a_sensor], ()) is Verdict.NO_EFFECT  # that sensors disagree is no fault of the card's model
    bounded = replace(sure, parameters={"thrust_scale": Size(-0.9, 0.01, "1", at_bound=True)})
    assert verdict_of([bounded], ()) is Verdict.UNEXPLAINED


def test_sizes_that_aircraft_do_not_have_are_implausible_in_the_aircraft_s_lengths():
    effect = CATALOGUE["thrust_scale"]
    assert implausible(effect, cause(mean=-0.48, sd=0.02).parameters) == {"thrust_scale": 0.3}
    assert implausible(effect, cause(mean=-0.48, sd=0.15).parameters)  # a record that does not know it shows nothing
    assert not implausible(effect, cause(mean=-0.08, sd=0.004).parameters)
    # Pitch rate makes lift at the tail: 2 a V_H per q c/2V, some 5 per q c/V. Three real records gave 20.
    assert implausible(CATALOGUE["pitch_rate_lift"], {"CLq": Size(19.6, 1.1, "1")})
    assert not implausible(CATALOGUE["pitch_rate_lift"], {"CLq": Size(5.0, 1.1, "1")})
    # Of induced drag 1/e counts, which is zero without it: no wing has an e of 0.2, and 0.8 is that of most.
    assert implausible(CATALOGUE["induced_drag"], {"e": Size(0.2, 0.01, "1")}) == {"1/e": 3.0}
    assert not implausible(CATALOGUE["induced_drag"], {"e": Size(0.8, 0.01, "1")})
    # Of the catalogue's transport with 21.5 m of span a vane stands 20 m ahead at most, of a trainer with 10 m 9.3.
    vane = CATALOGUE["vane_position"]
    transport, trainer = (
        sized(vane, lengths_of(replace(read_card("attas").aircraft, half_span=x))) for x in (10.75, 5.0)
    )
    assert transport is vane
    assert trainer.sizes["vane_position"] == pytest.approx((3.0 * 10.0 / 21.5, 20.0 * 10.0 / 21.5))
    recorded = {"vane_position": Size(15.0, 1.0, "m")}
    assert not implausible(transport, recorded)
    assert implausible(trainer, recorded)
    assert sized(CATALOGUE["alpha_bias"], lengths_of(NO_AIRCRAFT)) is CATALOGUE["alpha_bias"]


def test_sizes_that_no_sensor_or_aircraft_has_are_said(diagnosed):
    off = replace(
        cause("alpha_bias", np.radians(9.0), np.radians(0.5), implausible={"alpha_bias": np.radians(3.0)}),
        kind="measurement",
    )
    said = diagnosis_sentences(replace(diagnosed.view.diagnosis, beyond=(off,)))
    (sentence,) = [one for one in said if "alpha_bias" in one]
    assert "9.00 ± 0.50 deg" in sentence
    assert "at most 3 deg" in sentence
    d = diagnosed.view.diagnosis
    found = replace(next(c for c in d.causes if c.name == "alpha_squared_moment"), ambiguous_with=())
    searched = SearchResult(d.aerodynamics.state.full, ((found.stage, d.aerodynamics),), (), d.noise, (), ())
    large = replace(found, implausible={"Cma2": 0.1})
    (left,) = structure_of(searched, [large])
    assert (left.coefficient, left.channel, left.rivals) == ("Cm", "alpha", ("alpha_squared_moment",))
    assert structure_of(searched, [replace(large, kind="measurement")]) == ()
    said = diagnosis_sentences(replace(d, beyond=(replace(large, implausible=dict.fromkeys(large.parameters, 0.1)),)))
    assert any("On this aircraft" in one and "left out of the model" in one for one in said)


def test_more_than_five_names_and_errors_that_no_sensor_has_are_no_cause():
    names = ("mass_scale", "drag_offset", "accel_x_bias", "density_scale", "mach_drag")
    few, many = cause(ambiguous_with=names[: DEFAULT.most_names - 1]), cause(ambiguous_with=names)
    assert attributed([few, many]) == ((few,), (), (many,))
    unlikely, open_ = cause(probability=0.33), cause(confirmed=False)
    assert attributed([unlikely, open_]) == ((unlikely, open_), (), ())
    neither = replace(unlikely, confirmed=False)
    assert attributed([neither]) == ((), (), (neither,))
    scale = cause(name="roll_rate_scale", mean=0.22, implausible={"roll_rate_scale": 0.15})
    of_a_sensor, of_the_model = replace(scale, kind="measurement"), replace(scale, kind="aerodynamics")
    assert attributed([of_a_sensor, of_the_model]) == ((), (of_a_sensor, of_the_model), ())


def test_what_is_larger_than_on_any_aircraft_leaves_and_all_is_selected_without_it(monkeypatch):
    """The second selection is that of the model, and it never sees what the first found too large."""

    def of(size, *active):
        full = part(CandidateModel, candidates=tuple(CATALOGUE[n] for n in ("alpha_dot_lift", "mach_drag")))
        base, state = (part(SelectionState, full=full, active=names) for names in ((), active))
        sizes = {"CLadot": Size(size, 20.0, "1"), "CDM": Size(0.1, 0.01, "1")}
        no_fit = part(RegressionFit)
        return Extension(base, no_fit, state, no_fit, (), sizes, active, ())

    asked: list[tuple[str, ...]] = []
    given = [of(-42.9, "alpha_dot_lift", "mach_drag"), of(0.0)]

    def once(_, *, barred, **__):
        asked.append(tuple(barred))
        return given[len(asked) - 1]

    monkeypatch.setattr(selecting, "forward_selection", once)
    found = selecting.plausible_selection(given[0].base)
    assert asked == [(), ("alpha_dot_lift",)]
    assert found.state.active == ()
    assert found.larger[0].implausible == ("alpha_dot_lift",)


@pytest.mark.verify
def test_a_size_that_no_aircraft_has_is_told_and_nothing_else_is_named():
    """CLq is 25, of at most 10: no name of the catalogue stands in for it."""
    found = diagnose(
        hidden_records({"pitch_rate_lift": {"CLq": 25.0}}, seed=12, noise="white"),
        read_card("attas"),
        gains_wanted=False,
    )
    assert not found.causes
    told = {c.name: c for c in found.beyond}["pitch_rate_lift"].parameters["CLq"]
    assert told.mean == pytest.approx(25.0, abs=3.0 * told.sd)
    assert ("CL", "q") in {(u.coefficient, u.channel) for u in found.unknown}
    assert "pitch_rate_lift" not in found.aerodynamics.state.active


def test_what_stands_in_for_structure_tells_where_and_how_much(diagnosed):
    """The hidden curvature of the pitching moment, as if a linear term did nearly the same."""
    d = diagnosed.view.diagnosis
    found = next(c for c in d.causes if c.name == "alpha_squared_moment")
    extensions = {found.stage: d.aerodynamics}
    for share, output, taken in ((0.01, "Cm", True), (0.01, "CL", False), (0.03, "Cm", False)):
        one = replace(found, own_share=share)
        names = stand_ins([one], extensions, [UnexplainedStructure(output, "phi", 0.5, 0.01)])
        assert names == ((found.name,) if taken else ())
        assert attributed([one], stand_ins=names) == (((), (), (one,)) if taken else ((one,), (), ()))
    # The hidden curvature of the pitching moment, as if five others explained it as well.
    names = ("mass_scale", "drag_offset", "accel_x_bias", "density_scale", "mach_drag")
    effect = CATALOGUE[found.name]
    unknown = as_structure(replace(found, ambiguous_with=names), d.aerodynamics, effect)
    assert (unknown.coefficient, unknown.channel) == ("Cm", "alpha")
    assert 0.04 < unknown.share < 1.0
    assert unknown.rivals == (found.name, *names)


def test_what_flight_does_not_miss_or_cannot_test_is_not_confirmed(diagnosed):
    d = diagnosed.view.diagnosis
    names = [c.name for c in d.causes]
    assert d.verdict is not Verdict.UNEXPLAINED
    nothing = judged_on_held_out_flights(d, Confirmation((), dict.fromkeys(names, (1.0, 2.0))))
    assert not any(c.confirmed for c in nothing.causes)
    assert nothing.verdict is Verdict.UNEXPLAINED
    assert judged_on_held_out_flights(d, Confirmation((), {})) == d
    # The joint estimate has seen the flight that is left out.
    untested = replace(d, causes=tuple(replace(c, missed=(float("nan"), float("nan"))) for c in d.causes))
    found = judged_on_held_out_flights(untested, Confirmation((), {}), {"Cma2"})
    assert {c.name for c in found.causes if not c.confirmed} == {"alpha_squared_moment"}
    assert "named, but not tested on hold-out data: alpha_squared_moment" in verdict_sentence(found)
    # Noise of the regressors bends coefficients as an error of a sensor may; a simulated flight has none.
    scale = replace(cause("accel_y_scale", -0.22, 0.05), kind="measurement")
    of_the_path = replace(scale, name="alpha_scale", stage="flight path")
    d = replace(d, causes=(scale, of_the_path, *d.causes))
    flights = Confirmation((), {c.name: (-4.0, 16.0) for c in d.causes})
    doubtful = sensors_not_missed(d, flights)
    assert set(doubtful.missed) == {"accel_y_scale"}
    assert [c.name for c in judged_on_held_out_flights(d, doubtful).causes if not c.confirmed] == ["accel_y_scale"]
    assert not sensors_not_missed(d, replace(flights, kept=("accel_y_scale",))).missed


@pytest.fixture(scope="module")
def both(card, model):
    """The card's model and lift due to pitch rate and to alpha-dot, at the truth of a simulated stall without them."""
    return with_candidates(card, model, (*PAIR, "sideslip_drag"))


def on(both, flights, values) -> Extension:
    """Both terms in, with these values, on a record."""
    model = both.full.model
    theta = both.theta.copy()
    theta[both.full.columns(list(values))] = list(values.values())
    state = linearised(both.full, EquationError.of(flights, model), NAMES, theta, PAIR)
    fit = state.fit()
    return Extension(state, fit, state, fit, (), {}, PAIR, ())


def test_two_terms_that_cancel_are_known_by_their_sum_and_their_own_share(both):
    """In a doublet the flight path bends little: alpha-dot is pitch rate, and large opposite terms are their sum."""
    flown = standard(both, (*PAIR, "sideslip_drag")).flown
    doublet = flown["elevator_doublet"]
    found = on(both, doublet, {"CLq": 19.6, "CLadot": -18.2})
    (pair,) = cancelling(found, PAIR)
    assert pair.parameters == ("CLq", "CLadot")
    assert pair.correlation < -0.9
    assert pair.mean == pytest.approx(19.6 - 18.2 * pair.factor)
    assert pair.factor == pytest.approx(1.0, abs=0.1)
    # Of a combination with correlation near -1 little is left of either deviation: closed form of a sum's variance.
    columns = found.state.full.columns(["CLq", "CLadot"])
    colour = autocorrelation_of(found.state.left(found.fit), found.state.folds)
    at = [int(np.flatnonzero(found.fit.columns == c)[0]) for c in columns]
    C = uncertainty(found.state, found.fit, colour)[np.ix_(at, at)]
    assert pair.sd**2 == pytest.approx(C[0, 0] + 2 * pair.factor * C[0, 1] + pair.factor**2 * C[1, 1])
    assert pair.sd < 0.1 * np.sqrt(C[0, 0])
    turn = on(both, flown["bank_to_bank"], {"CLq": 19.6, "CLadot": -18.2})
    assert not cancelling(turn, PAIR)  # it has pitch rate at constant alpha
    assert not cancelling(on(both, doublet, {"CLq": 4.0, "CLadot": 2.0}), PAIR)  # nothing cancels
    # Closed form: what a regression on the others leaves of the effect's sensitivity, over its spread.
    found = on(both, both.responses.flights, {"CLq": 4.0})
    state, fit = found.state, found.fit
    own = int(state.full.columns(["CLq"])[0])
    weighed = state.scaled[state.inside] / np.sqrt(fit.variance)[:, None]
    S = weighed.reshape(-1, state.S.shape[2])
    x, others = S[:, own], S[:, [c for c in fit.columns if c != own]]
    scale = np.sqrt(np.sum(others**2, axis=0))
    left = x - (others / scale) @ np.linalg.lstsq(others / scale, x, rcond=None)[0]
    spread = np.sum((weighed[:, :, own] - weighed[:, :, own].mean(axis=0)) ** 2)
    assert own_share(state, fit, "pitch_rate_lift") == pytest.approx(left @ left / spread, rel=1e-3)
    assert np.isnan(own_share(state, fit, "sideslip_drag"))  # not in


def test_trajectories_alone_claim_no_more_than_was_tested(diagnosed):
    """One sure cause, and the simulation still off by 1.2 m/s where the sensor is off by 0.3 m/s."""
    d = replace(diagnosed.view.diagnosis, causes=(cause(),), unknown=())
    for left, verdict, claim in (
        (result.OutputMiss(0.3, 0.6, 1.2), Verdict.PARTLY_EXPLAINED, "cause improves the fit to the trajectories"),
        (result.OutputMiss(0.3, 0.3, 1.2), Verdict.EXPLAINED, "the error of the card's model in the trajectories"),
    ):
        tested = result.Tested({"airspeed": left})
        headline, detail, *_ = diagnosis_sentences(replace(d, tested=tested, verdict=verdict))
        assert claim in headline
        assert ("explain" in headline) is (verdict is Verdict.EXPLAINED)
        assert ("V 1.2 m/s" in headline) is (verdict is not Verdict.EXPLAINED)
        assert "no term of the library describes structure outside the catalogue" in headline
        assert "(noise 0.30 m/s)" in detail
    none = replace(
        d, causes=(), verdict=Verdict.UNDECIDED, tested=result.Tested({"q": result.OutputMiss(0.0, 1.0, 1.0)})
    )
    assert "57 deg/s" in diagnosis_sentences(none)[0]
    assert "cannot decide" in diagnosis_sentences(none)[0]
    flown_not = diagnosis_sentences(replace(d, verdict=Verdict.PARTLY_EXPLAINED, tested=result.Tested({})))[0]
    assert "was not computed" in flown_not


@dataclass(frozen=True)
class RollYaw(Plane):
    """Rolling either way yaws it to the same side, as the slipstream of a propeller does: Cn = K |p b / 2V|."""

    K: float = 0.05

    def loads(self, x, controls):
        force, moment = super().loads(x, controls)
        V = np.sqrt(x[:3] @ x[:3])
        scale = 0.5 * self.density(x[9]) * V**2 * self.S * self.b
        return force, moment + np.array([0.0, 0.0, scale * self.K * abs(x[3]) * self.b / (2.0 * V)])


@pytest.mark.verify
@pytest.mark.parametrize("seed", [1, 2])
def test_yaw_of_the_size_of_the_roll_rate_has_no_cause_in_the_catalogue(tmp_path, seed):
    """It is structure of Cn, which no effect that the catalogue has for a symmetric aircraft explains."""
    rng = np.random.default_rng([seed, 71])
    plane = RollYaw(**asdict(drawn(rng, **six_axes.ATTACHED)))
    records = [six_axes.record(kind, fly(plane, kind, rng), rng) for kind in ("elevator", "aileron", "rudder")]
    found = diagnose(records, six_axes.card_in(tmp_path, plane), gains_wanted=False)
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.causes == ()
    assert {one.coefficient for one in found.unknown} == {"Cn"}
