"""Which effects are candidates; each one hidden leads the screening; what hold-out data and flight leave of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import six_axes
from parts import few_candidates
from stranger_six import Plane, fly

from bayes_aero.diagnosis.consistency import SENSOR_KINDS
from bayes_aero.diagnosis.screening import screen
from bayes_aero.diagnosis.selection import LeftOut, confirmation, explained, noise_effect, sizes, truncated
from bayes_aero.diagnosis.selection_state import (
    DEFAULT,
    CandidateModel,
    SelectionState,
    candidate_model,
    linearised,
    refitted,
)
from bayes_aero.effect import Kind, sized
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import fit_mle
from bayes_aero.model.model import Model, lengths_of
from bayes_aero.model.observations import despiked, join, observe
from bayes_aero.model.records import Flights
from bayes_aero.physics.aircraft import Axis
from bayes_aero.residuals.base import FlightPathError
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.injection import FLOWN_AXES, flyable, hidden_records


# Which effects are candidates
def test_stand_ins_are_no_candidates_but_serve_on_a_card(card, model, clean_records):
    flights = join(clean_records, card)
    stand_ins = {name for name, e in CATALOGUE.items() if not e.candidate and e.disturbance is None}
    assert stand_ins == {
        "alpha_drag", "speed_drag", "speed_lift", "speed_moment", "stabilizer_lift", "stabilizer_drag",
        "heading_delay", "pitot_position",
    }  # fmt: skip
    full = candidate_model(model, flights)
    assert len(full.candidates) > 20
    gusts = {name for name, effect in CATALOGUE.items() if effect.disturbance is not None}
    assert gusts == {"longitudinal_gust", "vertical_gust", "lateral_gust", "buffet"}  # random: a filter estimates them
    assert not (stand_ins | gusts) & ({e.name for e in full.model.effects} | set(full.not_testable))
    for fixed, place in (({}, "base"), ({"CLV": 0.0}, "candidates")):  # fixed at neutral it is written, so asked for
        full = candidate_model(Model.of([*card.effects, "speed_lift"], {"tau1": 0.0} | fixed), flights)
        assert stand_ins & {e.name for e in full.model.effects} == {"speed_lift"}
        names = {"base": full.base, "candidates": [e.name for e in full.candidates]}
        assert [where for where, those in names.items() if "speed_lift" in those] == [place]


WAVE = np.sin(np.linspace(0.0, 9.0, 200))


@pytest.mark.parametrize(("channels", "effect", "why"), [
    ({}, "thrust_moment", None),  # density and thrust stand still: T/(qbar S) moves with the airspeed
    ({}, "thrust_lift", None),
    ({"airspeed": 80.0}, "thrust_lift", "channel thrust, density, airspeed does not move in this record"),
    ({"airspeed": 80.0, "thrust": 9e3 + WAVE}, "thrust_moment", None),
    ({"thrust": 0.0}, "thrust_moment", "channel thrust, density does not move in this record"),
    ({"spoiler_left": 0.0, "spoiler_right": 0.1 * WAVE}, "spoiler_lift", None),
    ({"spoiler_left": 0.0, "spoiler_right": 0.1}, "spoiler_lift", "does not move"),
    ({"mach": 0.3}, "mach_lift", "channel mach does not move in this record"),  # the slope CLa says it already
    ({"canard": 0.1 * WAVE}, "canard_moment", None),
    ({"flap": 0.3}, "flap_lift", "channel flap does not move in this record"),
])  # fmt: skip
def test_an_effect_can_be_tested_where_what_it_acts_through_moves(card, channels, effect, why):
    base = {
        "alpha": 0.1 + 0.05 * WAVE, "q": 0.05 * WAVE, "airspeed": 80.0 + 5.0 * WAVE, "elevator": -0.05 * WAVE,
        "ax": 0.1 * WAVE, "az": -9.8 + WAVE, "p": 0.0, "r": 0.0, "density": 0.9, "thrust": 9e3,
    } | channels  # fmt: skip
    arrays = {name: np.broadcast_to(x, len(WAVE)) for name, x in base.items()}
    record = FlightRecord.from_arrays("run", np.arange(len(WAVE)) * 0.04, arrays)
    names = ["attached_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag"]
    full = candidate_model(Model.of(names), join([record], replace(card, sums={}, constants={})))
    assert (effect in {e.name for e in full.candidates}) == (why is None)
    assert why is None or why in full.not_testable[effect]


def test_sizes_worth_modelling_are_in_the_card_s_lengths(card, clean_records):
    """Per q c/2V Cmq is twice as large; with moments over half the span Clp is, too."""
    a = card.aircraft
    halved = replace(card, aircraft=replace(a, rate_length=a.chord / 2.0, lateral_length=a.half_span))
    worth = []
    for one in (card, halved):
        model = Model.from_card(replace(one, effects=tuple(name for name in one.effects if name != "pitch_damping")))
        full = candidate_model(model, join(clean_records, one))
        worth += [e.sizes["Cmq"] for e in full.candidates if e.name == "pitch_damping"]
    usual, twice = worth
    assert twice == pytest.approx([2.0 * x for x in usual])
    roll, lengths = CATALOGUE["roll_damping"], lengths_of(halved.aircraft)
    assert sized(roll, lengths).sizes["Clp"] == pytest.approx([2.0 * x for x in roll.sizes["Clp"]])
    assert sized(roll, lengths) is sized(roll, lengths), "a model is hashed by its effects"
    # Of the catalogue's transport with 21.5 m of span a vane is at most 20 m ahead, of a trainer with 10 m 9.3 m.
    vane = CATALOGUE["vane_position"]
    transport, trainer = (sized(vane, lengths_of(replace(a, half_span=x))) for x in (10.75, 5.0))
    assert transport is vane
    assert trainer.sizes["vane_position"] == pytest.approx((3.0 * 10.0 / 21.5, 20.0 * 10.0 / 21.5))


@pytest.mark.parametrize("swing", [0.0, 0.05])
def test_nothing_is_scaled_or_delayed_that_shows_noise_alone(card, model, clean_records, swing):
    """Of lateral channels without a manoeuvre constants are left: a scale would be fitted to the noise of the vane."""
    rng, noisy = np.random.default_rng(5), []
    for record in clean_records:
        wave = swing * np.sin(0.7 * record.time)
        lateral = {n: wave + 0.001 * rng.standard_normal(record.n) for n in ("beta", "phi", "p", "r", "ay")}
        noisy.append(replace(record, channels={**record.channels, **lateral}))
    full = candidate_model(model, join(noisy, card))
    moved = {"sideslip_scale", "bank_angle_scale", "roll_rate_scale", "yaw_rate_scale", "sideslip_lift"}
    names = {e.name for e in full.candidates}
    assert {"sideslip_bias", "bank_angle_bias", "roll_rate_bias", "alpha_scale", "pitch_rate_scale"} <= names
    assert moved & names == (moved if swing else set())
    assert swing or full.not_testable["sideslip_scale"] == "channel beta shows nothing but noise in this record"


def test_every_effect_can_be_asked_where_all_channels_are_noise(card, model, clean_records):
    """No effect of the catalogue fails for want of what others make, whatever channel is noise."""
    rng = np.random.default_rng(6)
    level = {n: np.mean(x) for n, x in clean_records[0].channels.items()}
    calm = [
        replace(r, channels={n: x + 1e-3 * rng.standard_normal(r.n) for n, x in level.items()}) for r in clean_records
    ]
    for one in (model, Model.of(["attached_lift", "pitching_moment"])):
        assert "alpha_scale" in candidate_model(one, join(calm, card)).not_testable


# Every effect of the catalogue, hidden in two simulated stalls, leads the first screening; where nothing is hidden,
# none explains as much as is worth a name. Windows of 40 s about the stall, sensor noise, one length: one compiled
# program serves all. `make verify` hides each longitudinal one; of the lateral ones those of `ERRORS` and `OF_PLANE`
SEED, BEGIN, END = 43, 20.0, 60.0  # s of each flight that are looked at
MOVED = {name: {} for name in ("rudder_moment", "spoiler_lift", "dlc_lift", "flap_lift")}  # surfaces, always deflected
CANARD = [name for name in CATALOGUE if name.startswith("canard")]  # no simulated flight has one
BASE = [e.name for e in CATALOGUE.values() if {p.name for p in e.parameters} & (set(TRUTH) - {"tau1"})]
RANDOM = [e.name for e in CATALOGUE.values() if e.disturbance is not None or e.kind is Kind.NOISE]  # test_terms
ON_PATH = ["heading_delay"]  # of a channel that bayes-aero path alone compares: test_flight_path
OTHERS = {*BASE, *RANDOM, *ON_PATH, *CANARD}
FLOWN = [e for e in CATALOGUE.values() if e.acts_on(FLOWN_AXES)]  # the others: LATERAL
CANDIDATES = [e.name for e in FLOWN if e.parameters and e.name not in OTHERS]
STAND_INS = [name for name in CANDIDATES if not CATALOGUE[name].candidate]
EXTRA = [replace(CATALOGUE[name], candidate=True) for name in STAND_INS]  # the same objects always: compiled once
ABSORBED = {  # by parameters of the card, whatever their size
    "density_scale": "every coefficient by the same factor",
    "elevator_scale": "Cmde by the inverse of its factor",
}
ABSENT = ("separated_drag", "separated_moment", "reattachment_hysteresis")
# Of the middle size, in its logarithm; with more incidence of the ailerons, these reverse and nothing balances.
TIMES = {"drag_offset": 4.0, "accel_y_scale": 2.0, "aileron_incidence": 0.4}


def middle(name: str) -> dict[str, float]:
    """Each parameter half way, in its logarithm, from the least size worth a name to the largest."""
    effect, values = CATALOGUE[name], {}
    for p in effect.parameters:
        size = TIMES.get(name, 1.0) * np.sqrt(np.prod(effect.sizes[p.name]))
        values[p.name] = next(x for x in (p.neutral + size, p.neutral - size) if p.bounds[0] < x < p.bounds[1])
    return values


def named(state: SelectionState) -> list[str]:
    """Of one screening: effects that explain enough, at a size worth a name; the most explaining first."""
    names = []
    for score in screen(state).candidate_scores:
        sizes = CATALOGUE[score.effect].sizes.values()
        large = any(abs(step) >= least for step, (least, _) in zip(score.step, sizes, strict=False))
        if large and explained(state, score) >= DEFAULT.least_share:
            names.append(score.effect)
    return list(dict.fromkeys(names))


@dataclass(frozen=True)
class Case:
    """Flights, all effects in one model, and the card's estimates."""

    flights: Flights
    full: CandidateModel
    theta: np.ndarray

    @classmethod
    def of(cls, records: Sequence[FlightRecord], card, model) -> Case:
        flights, _ = despiked(join(records, card))
        full = candidate_model(model, flights, EXTRA)
        fit = fit_mle(model, observe(records, card, model), seed=0, extra_starts=0)
        estimates = dict(zip(fit.names, fit.estimate, strict=True))
        return cls(flights, full, full.vector({n: x for n, x in estimates.items() if n in full.neutral}))

    def without(self, name: str) -> Case:
        """The same where the card lacks one of its effects, which is a candidate then."""
        base = tuple(e for e in self.full.base if e != name)
        full = replace(self.full, base=base, candidates=(*self.full.candidates, CATALOGUE[name]))
        return replace(self, full=full, theta=full.at_neutral(self.theta, [name]))

    def only(self, name: str = "") -> Case:
        """The same without the terms that stand in for others, but for that one."""
        kept = tuple(e for e in self.full.candidates if e.name == name or e.name not in STAND_INS)
        return replace(self, full=replace(self.full, candidates=kept))

    def screening(self, name: str) -> SelectionState:
        """That of the flight path where the effect shows there, else that of the coefficients."""
        path = self.path() if CATALOGUE[name].kind in SENSOR_KINDS else None
        return path if path and name in {block[0] for block in path.blocks} else self.coefficients()

    def path(self) -> SelectionState:
        full = replace(self.full, base=(), candidates=tuple(e for e in self.full.candidates if e.kind in SENSOR_KINDS))
        responses = FlightPathError.of(self.flights, full.model)
        return linearised(full, responses, responses.outputs, self.theta)

    def coefficients(self, *added: str) -> SelectionState:
        """With these effects in, whether they deserve it or not."""
        responses = EquationError.of(self.flights, self.full.model)
        return linearised(self.full, responses, self.full.model.coefficients, self.theta, added)


def flown_with(effects: Mapping[str, Mapping[str, float]], seed: int = SEED) -> list[FlightRecord]:
    records = hidden_records(MOVED | dict(effects), seed=seed, noise="white", seconds=END)
    return [record.window(BEGIN, END) for record in records]


@pytest.fixture(scope="module")
def silent(card, model):
    """Nothing hidden."""
    return Case.of(flown_with({}), card, model)


def some(names: Sequence[str], each: int) -> list:
    """The names, of which `make verify` runs all and the suite one of so many."""
    marks = [() if k % each == 0 else pytest.mark.verify for k in range(len(names))]
    return [pytest.param(name, marks=mark) for name, mark in zip(names, marks, strict=True)]


@pytest.mark.parametrize("name", some(CANDIDATES, 4))
def test_what_is_hidden_leads(name, card, model):
    found = named(Case.of(flown_with({name: middle(name)}), card, model).only(name).screening(name))
    if name in ABSORBED:
        assert name not in found, ABSORBED[name]
    elif name in STAND_INS:
        assert name in found  # what it stands in for explains as much
    else:
        assert found[:1] == [name]


@pytest.mark.parametrize("name", some(BASE, 3))
def test_what_the_card_lacks_leads(name, silent):
    """Terms that every flight has."""
    assert named(silent.only().without(name).coefficients())[:1] == [name]


def test_nothing_is_worth_a_name_where_nothing_is_hidden(silent):
    case = silent.only()
    assert len(case.full.candidates) == len(CANDIDATES) - len(STAND_INS)
    assert named(case.path()) == named(case.coefficients()) == []
    for name in STAND_INS:  # a term that stands in for others is not either
        assert named(silent.only(name).coefficients()) == []


def test_what_neither_card_nor_aircraft_has_is_not_worth_a_name(card, model):
    """Of an aircraft that has none of these, and a card that has them."""
    neutral = {name: CATALOGUE[name].neutral_values for name in ABSENT}
    case = Case.of(flown_with(neutral), card, model).only()
    assert not [name for name in ABSENT if name in named(case.without(name).coefficients())]


# Lateral effects lead, too, in flights of a simulator that shares no code: of the aircraft, or of what is recorded
PLANE = Plane(**six_axes.ATTACHED)
CHANNELS = {
    "sideslip": "beta", "bank_angle": "phi", "roll_rate": "p", "yaw_rate": "r", "accel_y": "ay", "aileron": "aileron",
    "rudder": "rudder",
}  # fmt: skip
WRONG = {
    "bias": lambda x, t, size: x + size,  # noqa: ARG005
    "scale": lambda x, t, size: (1.0 + size) * x,  # noqa: ARG005
    "delay": lambda x, t, size: np.interp(t - size, t, x),
}
LATERAL = [name for name, e in CATALOGUE.items() if e.axes == (Axis.LATERAL,)]
ERRORS = [f"{of}_{error}" for of in CHANNELS for error in WRONG if f"{of}_{error}" in LATERAL]
OF_PLANE = {
    "lateral_cg_shift": {"aside": 0.1}, "thrust_asymmetry": {"uneven": 0.1}, "sideslip_cubed_yaw": {"Cnbbb": 3.0},
    "roll_inertia_scale": {"Ix": 1.15 * PLANE.Ix}, "yaw_inertia_scale": {"Iz": 1.15 * PLANE.Iz},
}  # fmt: skip
LATERAL_ABSORBED = {  # by parameters of the card, whatever their size
    "aileron_scale": "Clda and Cnda by the inverse of its factor",
    "rudder_scale": "CYdr, Cldr and Cndr by the inverse of its factor",
}


@pytest.fixture(scope="module")
def six(tmp_path_factory):
    """Makes such flights; the card's parameters have their true values, candidates are those of the lateral axis."""
    card = six_axes.card_in(tmp_path_factory.mktemp("card"), PLANE)

    def made(name: str = "") -> Case:
        rng, records = np.random.default_rng(4), []
        for kind in ("aileron", "rudder", "elevator"):
            flight = fly(replace(PLANE, **OF_PLANE.get(name, {})), kind, rng, seconds=15.0)
            if name in ERRORS:
                of, error = name.rsplit("_", 1)
                (size,) = middle(name).values()
                flight |= {CHANNELS[of]: WRONG[error](flight[CHANNELS[of]], flight["time"], size)}
            records.append(six_axes.record(kind, flight, rng))
        flights, own = join(records, card), Model.from_card(card)
        with pytest.MonkeyPatch.context() as patch:
            few_candidates(patch, LATERAL)
            full = candidate_model(own, flights)
        return Case(flights, full, full.vector({p.name: getattr(PLANE, p.name) for p in own.free}))

    return made


@pytest.mark.parametrize("name", some([*ERRORS, *OF_PLANE], 4))
def test_a_hidden_lateral_effect_leads(name, six):
    case = six(name)
    assert name in {e.name for e in case.full.candidates}
    leaders = named(case.coefficients())
    if name in LATERAL_ABSORBED:
        assert name not in leaders, LATERAL_ABSORBED[name]
    else:
        assert leaders[:1] == [name]


def test_what_a_lateral_card_lacks_leads_and_nothing_does_where_nothing_is_hidden(six):
    """Terms that every flight has."""
    level = six()
    assert named(level.coefficients()) == []
    for name in six_axes.LATERAL:  # sideslip that goes with r/V, where Clr and Cnr are free, is side force by yaw rate
        alike = ["sideslip_vane_position"] if name == "yaw_rate_side_force" else [name]
        assert named(level.without(name).coefficients())[:1] in ([name], alike)


# Of what was added, unseen data confirm what the flights have in them, and nothing else
THERE = ("thrust_moment", "pitch_rate_lift", "drag_offset")
NOT_THERE = ("sideslip_drag", "alpha_dot_lift", "mach_drag", "elevator_drag")
DRAWN = np.random.default_rng(515).integers(1_000_000, size=6)


@pytest.mark.recovery
@pytest.mark.parametrize("seed", [DRAWN[0], *(pytest.param(s, marks=pytest.mark.verify) for s in DRAWN[1:4])])
def test_what_was_flown_is_confirmed_and_what_was_not_is_taken_out(card, model, seed):
    rng = np.random.default_rng(seed)
    true, absent = str(rng.choice(THERE)), [str(name) for name in rng.choice(NOT_THERE, 2, replace=False)]
    sizes = {p: float(rng.uniform(4.0, 8.0)) * least for p, (least, _) in CATALOGUE[true].sizes.items()}
    hidden = {"stabilizer_trim": {}} | ({} if seed == DRAWN[3] else {true: sizes})  # as in the flights before
    case = Case.of(flown_with(hidden, int(seed)), card, model)
    added = NOT_THERE if seed == DRAWN[3] else (*absent, true)
    unseen = confirmation(refitted(case.coefficients(*added)))
    assert unseen.kept == (() if seed == DRAWN[3] else (true,))
    assert set(unseen.missed) == set(added)
    for name, (lost, deviation) in unseen.missed.items():
        assert (lost > 1.645 * deviation) == (name in unseen.kept)


def test_first_order_is_the_whole_truth_for_an_effect_that_enters_linearly(card, model):
    """Cm alone is linear in a thrust arm; what is fitted again finds the same as the sensitivities say."""
    arm = {"thrust_arm": 3.0 * CATALOGUE["thrust_moment"].sizes["thrust_arm"][0]}
    state = refitted(Case.of(flown_with({"thrust_moment": arm}), card, model).coefficients("thrust_moment"))
    for effects in ((), ("thrust_moment",)):
        linear, full = LeftOut.first_order(state, effects), LeftOut.refitted(truncated(state, effects))
        assert np.allclose(linear.residual.std(axis=0), full.residual.std(axis=0), rtol=0.1)
    near = LeftOut.first_order(state, ("thrust_moment",)).gain(LeftOut.first_order(state, ()))
    whole = LeftOut.refitted(state).gain(LeftOut.refitted(truncated(state, ())))
    assert near[0] == pytest.approx(whole[0], rel=0.2)


@pytest.mark.verify
def test_size_freed_of_what_noise_adds_is_nearer_to_the_truth(card, model):
    """Ten times the usual noise of the sensors biases least squares by a tenth of Cma2, for alpha squared is noisy."""
    name, plain, freed, seen = "alpha_squared_moment", [], [], 0
    for seed in np.random.default_rng(77).integers(100_000, size=3):
        effects, flights = flyable([name], seed=int(seed), noise="white", seconds=90.0, sensor_noise=10.0)
        state = refitted(Case.of([flight.record for flight in flights], card, model).coefficients(name))
        fit, truth = state.fit(), effects[name]["Cma2"]
        column = int(state.full.columns(["Cma2"])[0])
        plain.append(abs(state.theta[column] - truth))
        freed.append(abs(sizes(state)["Cma2"].mean - truth))
        bias, spread = noise_effect(state)
        at = list(fit.columns).index(column)
        if abs(bias[at]) > spread[at]:  # else chance may decide the sign
            assert np.sign(bias[at]) == np.sign(state.theta[column] - truth)
            seen += 1
    assert seen > 0
    assert np.sum(freed) < 0.7 * np.sum(plain)
