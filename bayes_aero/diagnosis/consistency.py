"""Do the sensors agree? An answer in absolute terms, before any aerodynamics, with the known error that explains it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.accuracy import Size, sizes
from bayes_aero.diagnosis.candidate_set import CandidateModel, DiagnosisSettings, candidate_model
from bayes_aero.diagnosis.flight_path_check import CALM, gusts_met, path_check
from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.screening import largest_p_value, screen
from bayes_aero.diagnosis.selection import (
    Extension,
    SelectionStep,
    correlated,
    explained,
    forward_selection,
    nats_gained,
    removed,
    without_hold,
    worth,
)
from bayes_aero.diagnosis.selection_state import (
    TINY,
    RegressionFit,
    SelectionState,
    inverse,
    linearised,
    moved,
    partialled,
    refitted,
)
from bayes_aero.effect import Effect, Kind, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Agreement, Consistency, OpenError, PathCheck
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import cluster_covariance, nats
from bayes_aero.model.model import Model, lengths_of, own_effects
from bayes_aero.model.records import Flights, joined, repaired
from bayes_aero.parameter import Prior
from bayes_aero.physics.aircraft import Axis
from bayes_aero.physics.kinematics import PATH_CORE, PATH_NEEDS
from bayes_aero.residuals.base import FlightPathError, rolled_unseen


@dataclass(frozen=True)
class KnownErrors:
    """Errors of the record that were found."""

    effects: tuple[Effect, ...]  # on the record, or on where its sensors are
    errors: Mapping[str, Mapping[str, Any]]  # plain data of each (see `Consistency`)
    open: tuple[OpenError, ...] = ()  # that the flight path cannot decide on


def consistency(
    records: Sequence[FlightRecord], card: Card, *, seed: int = 0, seek: bool = True, known: KnownErrors | None = None
) -> Consistency:
    """Check the flight path of each record in absolute terms; where sensors disagree, `seek` the error that explains
    it."""
    if why := no_flight_path(records, card):
        return Consistency(why)
    flights = _flights(records, card)
    unchecked = tuple(n for n in ("altitude", "beta", "phi") if n not in flights.channels)
    report = Consistency("", unchecked, checks(flights, card, seed))
    if known is None:
        if report.agreement is Agreement.AGREE or not seek:
            return report
        try:
            known = errors_of_path(screen_sensor_errors(list(records), card, seed=seed))
        except InputError as reason:
            return replace(report, unsought=str(reason))
    report = replace(report, errors=known.errors, open=known.open)
    if report.agreement is Agreement.AGREE or not known.effects:
        return report
    # Where the sensors disagree, they are checked again without the errors that are known.
    values = {p: x["mean"] for e in known.errors.values() for p, x in e["parameters"].items()}
    corrected = with_corrections(flights, Model.of(known.effects, axes=tuple(Axis)), values)
    return replace(report, corrected=checks(corrected, card, seed))


def _flights(records: Sequence[FlightRecord], card: Card) -> Flights:
    """The manoeuvres' channels of the flight path, spikes repaired."""
    return repaired(as_the_card_states(joined(records, card, PATH_CORE), card))[0]


def errors_of_path(known: Extension) -> KnownErrors:
    """Errors of sensors and winds that a search along the flight path has found, minor ones included."""
    # One at a parameter bound, or larger than sensors have, explains nothing: another cause is behind it. What was
    # estimated together with such a one is no error by itself, either.
    named = {e.name: e for extension in (known, *known.larger) for e in extension.state.full.candidates}
    joint, out = correlated(known, known.state.active), without_hold(known)
    alone = [
        (extension, name, with_)
        for extension in (known, *known.larger)
        for name, with_ in without_hold(extension).items()
        if with_
    ]
    unheld = {name for _, name, _ in alone}
    effects = [named[name] for name in (*known.causes, *known.minor) if name not in out]
    plain = {e.name: _plain(e, known.sizes, joint.get(e.name, {}), minor=e.name in known.minor) for e in effects}
    undecided = []
    for extension, name, partners in alone:
        (p, *_), joint_ = named[name].parameters, dict(partners)
        x = extension.sizes[p.name]
        undecided.append(OpenError(name, p.unit, x.mean, x.sd, x.sd, False, tuple(partners), 1.0, joint_))
    undecided += [e for e in open_errors(known) if e.name not in unheld]
    return KnownErrors(tuple(effects), plain, tuple(undecided))


def errors_of_diagnosis(diagnosis: Diagnosis) -> KnownErrors:
    """Errors of the record that a diagnosis has confirmed; those that it names, it does not call undecided, too."""
    named = {e.name: e for e in diagnosis.aerodynamics.state.full.model.effects}
    causes = {c.name: c for c in diagnosis.causes if c.sure and named[c.name].kind in SENSOR_KINDS}
    named_causes = {c.name for c in (*diagnosis.causes, *diagnosis.beyond)}
    return KnownErrors(
        tuple(named[name] for name in causes),
        {name: _plain(named[name], cause.parameters, cause.joint, minor=False) for name, cause in causes.items()},
        ()
        if diagnosis.sensors is None
        else tuple(e for e in open_errors(diagnosis.sensors) if e.name not in named_causes),
    )


def _plain(effect: Effect, sizes: Mapping[str, Size], joint: Mapping[str, float], *, minor: bool) -> dict[str, Any]:
    parameters = {
        p.name: {"mean": sizes[p.name].mean, "sd": sizes[p.name].sd, "unit": p.unit} for p in effect.parameters
    }
    return {"claim": effect.claim, "minor": minor, "parameters": parameters, "joint": dict(joint)}


def checks(flights: Flights, card: Card, seed: int) -> tuple[PathCheck, ...]:
    """`path_check` of each manoeuvre, with the sensors where `flights` say that they are."""
    card = replace(card, aircraft=flights.aircraft)
    return tuple(path_check(name, time, channels, card, seed) for name, time, channels in _manoeuvres(flights))


def in_gusts(records: Sequence[FlightRecord], card: Card, seed: int = 0) -> dict[str, float]:
    """Records whose flight path shows that the air was not calm, with the standard deviation of their gusts, m/s."""
    if no_flight_path(records, card):  # then none are known
        return {}
    flights = _flights(records, card)
    gusts_by_record = {name: gusts_met(time, channels, card, seed) for name, time, channels in _manoeuvres(flights)}
    return {name: gusts for name, gusts in gusts_by_record.items() if gusts > CALM}


def _manoeuvres(flights: Flights) -> Iterator[tuple[str, np.ndarray, dict[str, np.ndarray]]]:
    """Name, time, and channels of the flight path of each."""
    begin = 0
    for name, length in zip(flights.names, flights.lengths, strict=True):
        part = slice(begin, begin + length)
        channels = {n: np.asarray(x)[part] for n, x in flights.channels.items() if n in PATH_NEEDS}
        yield name, np.asarray(flights.time)[part], channels
        begin += length


# --- Do the sensors agree? The flight path alone, before any aerodynamics.

SENSOR_KINDS = (Kind.MEASUREMENT, Kind.ENVIRONMENT)
SHORTEST = 4.0  # s of a record that can be checked


def check_sensors(
    full: CandidateModel,
    responses: FlightPathError,
    theta: Float[np.ndarray, " k"],
    *,
    seed: int,
    known: Sequence[str] = (),
    priors: Mapping[str, Prior] | None = None,
) -> Extension:
    """Sensor errors and winds that the flight path asks for beside the `known` ones, of whose parameters `priors` tell.
    Where one is larger than sensors have, all is selected again without it; it stays, and corrects nothing, if the
    others do not explain the record as well."""

    def checked(state: SelectionState, fit: RegressionFit) -> tuple[SelectionState, RegressionFit]:
        """What stretches bear out, or several errors in place of one of these, if stretches bear them out, too."""
        return consistent_across_blocks(*with_several_instead(*consistent_across_blocks(state, fit)))

    def selected(barred: Sequence[str]) -> Extension:
        candidates = tuple(e for e in full.candidates if e.kind in SENSOR_KINDS and e.name not in (*known, *barred))
        own = replace(full, base=tuple(known), candidates=candidates, priors=priors or {})
        state = linearised(own, responses, responses.outputs, theta)
        extension = forward_selection(state, seed=seed, checked=checked)
        return widened(extension, extension.state, extension.fit)

    first = extension = selected(())
    out: tuple[str, ...] = ()
    while extension.implausible:
        out = (*out, *without_hold(extension))
        extension = replace(selected(out), too_large=extension)
    return extension if extension is first or nats_gained(first, extension) > -full.settings.decisive else first


def screen_sensor_errors(records: list[FlightRecord], card: Card, *, seed: int = 0) -> Extension:
    """Sensor errors and winds that the flight path asks for; `InputError` without one, or of too short a manoeuvre."""
    if why := no_flight_path(records, card):
        raise InputError(why)
    flights = _flights(records, card)
    plain = Model((), (), axes=tuple(Axis), lengths=lengths_of(flights.aircraft))
    whole = candidate_model(plain, flights, tuple(own_effects(card.effect_files).values()))
    sensors = tuple(e for e in whole.candidates if e.kind in SENSOR_KINDS)
    model = Model(sensors, tuple(p for e in sensors for p in e.parameters), axes=tuple(Axis))
    full = CandidateModel(model, (), sensors, {})
    return check_sensors(full, FlightPathError.of(flights, model), full.neutral_vector, seed=seed)


def no_flight_path(records: Sequence[FlightRecord], card: Card) -> str:
    """Why the flight path cannot be checked at all; empty where it can."""
    flights = joined(records, card, ())
    missing = [n for n in PATH_CORE if n not in flights.channels]
    if missing:
        return f"the flight path needs {', '.join(missing)}"
    if not np.isfinite(float(card.aircraft.mass)):
        return "the card states no [aircraft], so the positions of the sensors are unknown"
    if rolled_unseen(flights):
        return (
            "the flight path needs phi, because the aircraft rolled; map it, or state what did not move under "
            "[constants]"
        )
    short = [r.name for r in records if r.time[-1] - r.time[0] < SHORTEST]
    return f"record {short[0]} is shorter than {SHORTEST:g} s" if short else ""


def as_the_card_states(flights: Flights, card: Card) -> Flights:
    """Flights without the errors of the record that the card states."""
    if card.linear is not None:
        return flights
    model = Model.from_card(card)
    stated = [e for e in model.effects if e.stage is Stage.CHANNEL]
    if not stated:
        return flights
    fixed = dict(model.fixed)
    values = {p.name: fixed.get(p.name, p.start) for e in stated for p in e.parameters}
    return with_corrections(flights, Model.of(stated, axes=tuple(Axis)), values)


def with_corrections(flights: Flights, model: Model, values: Mapping[str, Any]) -> Flights:
    """Flights as a model of errors of the record, and of where its sensors are, makes them true."""
    true = model.corrected(values, flights.channels, flights.aircraft)
    aircraft = model.actual_aircraft(values, flights.aircraft)
    return replace(flights, channels={name: np.asarray(true[name]) for name in flights.channels}, aircraft=aircraft)


# --- Do the stretches of a flight agree about an error of a sensor?
# Gusts are in the vane and in the airspeed, and what integrates them wanders off as slowly as an error of a sensor
# would make it: no autoregression tells the two apart over a record of a minute or two. In short stretches, each from
# where it began, little has wandered, and how far they disagree says how far an estimate can be trusted, whatever the
# colour.


class Blocks:
    """Residuals and sensitivities of a fit, less each stretch's own mean: where it began is free."""

    def __init__(self, state: SelectionState, fit: RegressionFit) -> None:
        seconds, number = state.responses.seconds, np.full(len(state.residual), -1)  # of its stretch; -1 between folds
        total = seconds * sum(fold.stop - fold.start for fold in state.folds)
        wanted, begin = min(state.settings.block, total / state.settings.fewest_blocks), 0
        for fold in state.folds:
            length = fold.stop - fold.start
            parts = max(1, int(length * seconds / wanted + 0.5))
            number[fold] = begin + np.arange(length) * parts // length
            begin += parts
        self.state, self.number = state, number
        self._inside, self._own = number >= 0, number[number >= 0]
        self.left = self._centred(state.left(fit))
        self.weight = 1.0 / np.maximum(np.mean(self.left**2, axis=0), 1e-300)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the disagreement."""
        return int(self._own.max())

    def _centred(self, x: np.ndarray) -> np.ndarray:
        """(m, ...) to the blocks inside stretches, (i, ...)."""
        x = x[self._inside]
        sums = np.zeros((self._own.max() + 1, *x.shape[1:]))
        np.add.at(sums, self._own, x)
        count = np.bincount(self._own).reshape(-1, *[1] * (x.ndim - 1))
        return x - (sums / count)[self._own]

    def judge(self, effect: str) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]] | None:
        """What the stretches add to an effect's parameters, the other additions free, and its covariance from how far
        they disagree; None where the effect moves nothing here."""
        state = self.state
        own = state.full.own_columns(effect)
        others = np.setdiff1d(state.columns([e for e in state.active if e != effect]), [*own, *state.offsets])
        S, B = (self._centred(state.scaled[:, :, columns]) for columns in (own, others))
        if not np.all(np.any(S != 0.0, axis=(0, 1))):
            return None
        both = partialled(np.concatenate([S, self.left[:, :, None]], axis=2), B, self.weight)
        S, left = both[:, :, :-1], both[:, :, -1]
        bread = inverse(np.einsum("mci,c,mcj->ij", S, self.weight, S, optimize=True))
        step = bread @ np.einsum("mci,c,mc->i", S, self.weight, left, optimize=True)
        rows = np.einsum("mci,c,mc->mi", S, self.weight, left - S @ step, optimize=True)
        return step, bread @ cluster_covariance(rows, self._own) @ bread

    def p_value(self, effect: str) -> float:
        """The chance that stretches which disagree as they do show as much of the best candidate (Bonferroni)."""
        judged = self.judge(effect)
        if judged is None:
            return 1.0
        away = self.state.departure[self.state.full.own_columns(effect)]
        return largest_p_value(away + judged[0], judged[1], self.freedom, len(self.state.blocks))

    def deviations(self, effect: str, count: int) -> Float[np.ndarray, " k"]:
        """Of an effect's `count` parameters, by how far the stretches disagree; zero where nothing is known."""
        judged = self.judge(effect)
        return np.zeros(count) if judged is None else np.sqrt(np.diag(judged[1]))


def consistent_across_blocks(state: SelectionState, fit: RegressionFit) -> tuple[SelectionState, RegressionFit]:
    """The state without additions that the stretches do not bear out, the least first."""
    while state.active:
        judged = Blocks(state, fit)
        chances = {effect: judged.p_value(effect) for effect in state.active}
        worst = max(chances, key=lambda effect: chances[effect])
        if chances[worst] <= state.settings.block_false_alarm_rate:
            break
        state, fit = refitted(removed(state, worst))
    return state, fit


def widened(extension: Extension, state: SelectionState, fit: RegressionFit) -> Extension:
    """The extension that ended in `state`, deviations no smaller than the stretches' disagreement makes them."""
    judged = Blocks(state, fit)
    estimates = dict(extension.sizes) if state is extension.state else sizes(state, fit)
    for effect in state.active:
        names = state.full.parameters_of(effect)
        wide = zip(names, judged.deviations(effect, len(names)), strict=True)
        estimates |= {n: replace(estimates[n], sd=max(estimates[n].sd, float(x))) for n, x in wide if n in estimates}
    last = screen(state, fit, seed=0, nulls=False)  # the last election is held anew
    scores = tuple(
        s if s.value is not None else replace(s, sd=tuple(np.maximum(s.sd, judged.deviations(s.effect, len(s.sd)))))
        for s in last.candidate_scores
    )
    closing = SelectionStep(None, float("nan"), replace(last, candidate_scores=scores), float("nan"))
    causes, minor = worth(state, fit, estimates)
    steps = (*extension.steps, closing)
    return replace(extension, state=state, fit=fit, steps=steps, sizes=estimates, causes=causes, minor=minor)


# --- What the flight path cannot decide about errors of sensors: those it asks for in vain, and those that others
# imitate.
# An offset of the pitch attitude turns gravity in the body axes. Accelerometers that are off by as much as that look
# the same, so without another measurement (the altitude, a calm wind) the record knows the sum of both and neither
# of them.


def open_errors(extension: Extension) -> tuple[OpenError, ...]:
    """Each error of one parameter that is asked for and not confirmed, or imitated by others; the former first."""
    state, settings = extension.state, extension.state.settings
    effects, columns, gram, right = _information_of_errors(state, extension.fit)
    # Priors weigh against a white likelihood as against the coloured one: see `SelectionState.variance_inflation`.
    covariance = inverse(gram + np.diag(state.precision[columns]))
    among = np.sqrt(state.variance_inflation * np.diag(covariance))
    jointly = covariance @ (right + gram @ state.departure[columns])
    screening = extension.steps[-1].screening
    undecided = []
    for place, effect in enumerate(effects):
        parameter = effect.parameters[0]
        least, _ = effect.sizes[parameter.name]
        standing = None if effect.name in state.active else screening.of(effect.name)
        if standing is None:
            mean, sd, asked = extension.sizes[parameter.name].mean, extension.sizes[parameter.name].sd, False
        else:  # were it the only one; and whether one worth a name would explain much of what is left if confirmed
            mean, sd = float(standing.step[0]), float(standing.sd[0])
            clear = standing.score >= settings.least_score and standing.log_bayes > 0.0 and abs(mean) >= least
            asked = clear and explained(state, standing) >= settings.open_share
        wide = max(sd, float(among[place]))
        there = max(least, abs(mean)) if standing is None else least
        imitators, share = next(
            (pair for pair in _nearest(gram, effects, place, settings, there) if pair[1] >= settings.imitated),
            ((), 0.0),
        )
        decided = standing is None and abs(jointly[place]) >= settings.least_score * wide
        if decided or settings.least_score * wide < least:  # nobody hides an error that is worth a name
            imitators, share = (), 0.0
        if asked or imitators:
            undecided.append(OpenError(effect.name, parameter.unit, mean, sd, wide, asked, imitators, share))
    rank = {standing.effect: k for k, standing in reversed(list(enumerate(screening.candidate_scores)))}
    return tuple(sorted(undecided, key=lambda e: (not e.asked, rank.get(e.name, len(rank)))))


def _information_of_errors(
    state: SelectionState, fit: RegressionFit
) -> tuple[list[Effect], Int[np.ndarray, " k"], Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
    """Effects of one parameter without break point that move the flight path; their columns, the information on them
    where integrals begin being free, and the right side of what is left."""
    effects = [
        e
        for e in state.full.candidates
        if len(e.parameters) == 1 and not e.scan and e.sizes and np.any(state.S[:, :, state.full.own_columns(e.name)])
    ]
    columns = state.full.columns([e.parameters[0].name for e in effects])
    X, begin = (state.scaled[state.inside][:, :, own] for own in (columns, state.offsets))
    weight = 1.0 / fit.variance
    X = partialled(X, begin, weight)
    right = np.einsum("mci,c,mc->i", X, weight, state.left(fit)[state.inside])
    return effects, columns, np.einsum("mci,c,mcj->ij", X, weight, X), right


def with_several_instead(state: SelectionState, fit: RegressionFit) -> tuple[SelectionState, RegressionFit]:
    """The state with an addition exchanged for several errors that together do nearly the same and explain decisively
    more: offset and scale of an airspeed come one by one, and neither gains what an offset of its pitot pressure
    does."""
    effects, _, gram, _ = _information_of_errors(state, fit)
    for place, effect in enumerate(effects):
        if effect.name not in state.active:
            continue
        others = [name for name in state.active if name != effect.name]
        neutral = state.full.at_neutral(state.theta, [effect.name])
        least, _ = effect.sizes[effect.parameters[0].name]  # those of absurd size are taken out afterwards
        for together, share in _nearest(gram, effects, place, state.settings, least):
            if len(together) < 2 or share < state.settings.imitated or set(together) & set(others):
                continue
            wider, wider_fit = refitted(moved(state, neutral, (*others, *together)))
            choice = (len(together) - 1) * math.log(len(state.full.candidates))
            if nats(fit.deviance - wider_fit.deviance, state.variance_inflation) - choice > state.settings.decisive:
                return with_several_instead(wider, wider_fit)
    return state, fit


def _nearest(
    gram: Float[np.ndarray, "k k"], effects: Sequence[Effect], place: int, settings: DiagnosisSettings, size: float
) -> Iterator[tuple[tuple[str, ...], float]]:
    """One other error, two, and so on, each of a size that sensors have, that do most of what one error of this size
    does; and their share of it."""

    def share(others: Sequence[int]) -> float:
        """Share of what the error does that `others` do; none if they must be too large."""
        at = np.array(others)
        factors = inverse(gram[np.ix_(at, at)]) @ gram[at, place]
        largest = np.array([effects[k].sizes[effects[k].parameters[0].name][1] for k in others])
        if np.any(np.abs(factors) * size > largest):
            return 0.0
        return float(factors @ gram[at, place]) / max(float(gram[place, place]), TINY)

    chosen: list[int] = []
    for _ in range(settings.imitators):
        shares = {k: share([*chosen, k]) for k in range(len(effects)) if k != place and k not in chosen}
        if not shares:
            return
        best = max(shares, key=lambda k: shares[k])
        chosen.append(best)
        yield tuple(effects[k].name for k in chosen), shares[best]
