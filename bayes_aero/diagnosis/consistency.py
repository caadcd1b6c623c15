"""Do the sensors agree? An answer in absolute terms, before any aerodynamics, with the known error that explains it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby, pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.fft import next_fast_len

from bayes_aero.diagnosis import selection, selection_state
from bayes_aero.diagnosis.result import Diagnosis, Size
from bayes_aero.diagnosis.screening import largest_p_value, screen
from bayes_aero.diagnosis.selection import Extension, SelectionStep, nats_gained, removed, selected, sizes, without_hold
from bayes_aero.diagnosis.selection_state import DiagnosisSettings, SelectionState, by_manoeuvre, linearised, moved
from bayes_aero.effect import Effect, Kind, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Agreement, Consistency, Departure, OpenError, PathCheck, noise_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import cluster_covariance, nats
from bayes_aero.model.model import Model, lengths_of, own_effects
from bayes_aero.model.records import Flights, despiked, join
from bayes_aero.parameter import Prior
from bayes_aero.physics.aircraft import NO_AIRCRAFT, Axis
from bayes_aero.physics.filters import differentiate_joined
from bayes_aero.physics.kinematics import PATH_CORE, PATH_NEEDS, RATES, STRAIGHT, integral, path_outputs, path_rates
from bayes_aero.processes import blas_threads, side_by_side
from bayes_aero.residuals.base import FlightPathError, rolled_unseen

LIGHT_TURBULENCE = 1.0  # m/s, standard deviation of light turbulence; MIL-F-8785C, 3.7


class KnownErrors(NamedTuple):
    """Errors of the record that were found."""

    effects: tuple[Effect, ...]  # on the record, or on where its sensors are
    errors: Mapping[str, Mapping[str, Any]]  # plain data of each (see `Consistency`)
    open: tuple[OpenError, ...] = ()  # that the flight path cannot decide on


def consistency(
    records: Sequence[FlightRecord],
    card: Card,
    *,
    seed: int = 0,
    seek: bool = True,
    errors: KnownErrors | None = None,
    turbulence: float = LIGHT_TURBULENCE,
    before: Consistency | None = None,
) -> Consistency:
    """Check the flight path of each record; where sensors disagree, `seek` the error that explains it. Air may be as
    rough as all air-data channels show, up to this `turbulence` (m/s). `before` is the same check
    with other errors taken out: what they do not change is taken over; without `errors` all of it is."""
    if before is not None and errors is None:
        return before
    if why := no_flight_path(records, card):
        return Consistency(why)
    flights = _flights(records, card)
    unchecked = tuple(n for n in ("altitude", "beta", "phi") if n not in flights.channels)
    report = Consistency("", unchecked, before.recorded if before else checks(flights, card, seed, turbulence))
    if errors is None:
        if report.agreement is Agreement.AGREE or not seek:
            return report
        try:
            errors = errors_of_path(screen_sensor_errors(list(records), card, seed=seed))
        except InputError as reason:
            return replace(report, unsought=str(reason))
    report = replace(report, errors=errors.errors, open=errors.open)
    if report.agreement is Agreement.AGREE or not errors.effects:
        return report
    if before is not None and before.errors == errors.errors:
        return replace(report, corrected=before.corrected)
    # Where the sensors disagree, they are checked again without the errors that are known.
    values = {p: x["mean"] for e in errors.errors.values() for p, x in e["parameters"].items()}
    corrected = with_corrections(flights, Model.of(errors.effects, axes=tuple(Axis)), values)
    return replace(report, corrected=checks(corrected, card, seed, turbulence))


def _flights(records: Sequence[FlightRecord], card: Card) -> Flights:
    """Without the errors of the record that the card states."""
    flights = join(records, card, PATH_CORE)
    if card.linear is None:
        model = Model.from_card(card)
        stated, fixed = [e for e in model.effects if e.stage is Stage.CHANNEL], dict(model.fixed)
        values = {p.name: fixed.get(p.name, p.start) for e in stated for p in e.parameters}
        flights = with_corrections(flights, Model.of(stated, axes=tuple(Axis)), values) if stated else flights
    return despiked(flights)[0]


def errors_of_path(sensors: Extension) -> KnownErrors:
    """Errors of sensors and winds that a search along the flight path has found, minor ones included."""
    # One at a parameter bound, or larger than sensors have, explains nothing: another cause is behind it. What was
    # estimated together with such a one is no error by itself, either.
    everything, out = (sensors, *sensors.larger), without_hold(sensors)
    joint = selection.correlated(sensors, sensors.state.active)
    named = {e.name: e for extension in everything for e in extension.state.full.candidates}
    effects = [named[name] for name in (*sensors.causes, *sensors.minor) if name not in out]
    plain = {e.name: _plain(e, sensors.sizes, joint.get(e.name, {}), minor=e.name in sensors.minor) for e in effects}
    undecided = []
    for extension in everything:
        for name, partners in without_hold(extension).items():
            if partners:
                parameter = named[name].parameters[0]
                x, others = extension.sizes[parameter.name], (tuple(partners), 1.0, dict(partners))
                undecided.append(OpenError(name, parameter.unit, x.mean, x.sd, x.sd, False, *others))
    unheld = {entry.name for entry in undecided}
    return KnownErrors(tuple(effects), plain, (*undecided, *(e for e in open_errors(sensors) if e.name not in unheld)))


def errors_of_diagnosis(diagnosis: Diagnosis) -> KnownErrors:
    """Errors of the record that a diagnosis has confirmed; those that it names, it does not call undecided, too."""
    named = {e.name: e for e in diagnosis.aerodynamics.state.full.model.effects}
    causes = {c.name: c for c in diagnosis.causes if c.sure and named[c.name].kind in SENSOR_KINDS}
    named_causes = {c.name for c in (*diagnosis.causes, *diagnosis.beyond)}
    undecided = () if diagnosis.sensors is None else open_errors(diagnosis.sensors)
    plain = {name: _plain(named[name], cause.parameters, cause.joint, minor=False) for name, cause in causes.items()}
    still = tuple(e for e in undecided if e.name not in named_causes)
    return KnownErrors(tuple(named[name] for name in causes), plain, still)


def _plain(effect: Effect, estimates: Mapping[str, Size], joint: Mapping[str, float], *, minor: bool) -> dict[str, Any]:
    of = {p: estimates[p.name] for p in effect.parameters}
    parameters = {p.name: {"mean": size.mean, "sd": size.sd, "unit": p.unit} for p, size in of.items()}
    return {"claim": effect.claim, "minor": minor, "parameters": parameters, "joint": dict(joint)}


def checks(flights: Flights, card: Card, seed: int, turbulence: float = LIGHT_TURBULENCE) -> tuple[PathCheck, ...]:
    return tuple(side_by_side(partial(path_check, turbulence=turbulence), _paths(flights, card, seed)))


def in_gusts(records: Sequence[FlightRecord], card: Card, seed: int = 0) -> dict[str, float]:
    """Records whose flight path shows that the air was not calm, with the standard deviation of their gusts, m/s."""
    if no_flight_path(records, card):  # then none are known
        return {}
    gusts_by_record = {path.name: path.gusts_shown() for path in _paths(_flights(records, card), card, seed)}
    return {name: gusts for name, gusts in gusts_by_record.items() if gusts > CALM}


def _paths(flights: Flights, card: Card, seed: int) -> list[_RecordedPath]:
    channels = {n: by_manoeuvre(np.asarray(x), flights) for n, x in flights.channels.items() if n in PATH_NEEDS}
    times, at = by_manoeuvre(np.asarray(flights.time), flights), flights.aircraft.accelerometer
    parts = [{n: x[k] for n, x in channels.items()} for k in range(len(times))]
    return [_RecordedPath(*record, card, at, seed) for record in zip(flights.names, times, parts, strict=True)]


# --- Do the sensors agree? The flight path alone, before any aerodynamics.

SENSOR_KINDS = (Kind.MEASUREMENT, Kind.ENVIRONMENT)
SHORTEST = 4.0  # s of a record that can be checked


def check_sensors(
    full: selection_state.CandidateModel,
    responses: FlightPathError,
    theta: Float[np.ndarray, " k"],
    *,
    seed: int,
    base: Sequence[str] = (),
    priors: Mapping[str, Prior] | None = None,
) -> Extension:
    """Errors of sensors and winds that the flight path asks for beside those of `base`, whose sizes `priors` tell."""
    # Where one is larger than sensors have, all is selected again without it; it stays, and corrects nothing, if the
    # others do not explain the record as well.

    def without(barred: tuple[str, ...]) -> Extension:
        candidates = tuple(e for e in full.candidates if e.kind in SENSOR_KINDS and e.name not in (*base, *barred))
        model = replace(full, base=tuple(base), candidates=candidates, priors=priors or {})
        state = linearised(model, responses, responses.outputs, theta)
        extension = selected(state, seed=seed)
        after = with_several_instead(consistent_across_blocks(extension.state))
        after = consistent_across_blocks(after)  # several errors, too, if stretches bear them out
        return widened(extension, after)

    extension = selection.plausible(without, without_hold)
    first = (extension, *extension.larger)[-1]
    return extension if extension is first or nats_gained(first, extension) > -full.settings.decisive else first


@blas_threads(0)
def screen_sensor_errors(records: list[FlightRecord], card: Card, *, seed: int = 0) -> Extension:
    """Sensor errors and winds that the flight path asks for; `InputError` without one, or of too short a manoeuvre."""
    if why := no_flight_path(records, card):
        raise InputError(why)
    flights = _flights(records, card)
    plain = Model((), (), axes=tuple(Axis), lengths=lengths_of(flights.aircraft))
    whole = selection_state.candidate_model(plain, flights, tuple(own_effects(card.effect_files).values()))
    sensors = tuple(e for e in whole.candidates if e.kind in SENSOR_KINDS)
    model = Model(sensors, tuple(p for e in sensors for p in e.parameters), axes=tuple(Axis))
    full = selection_state.CandidateModel(model, (), sensors, {})
    return check_sensors(full, FlightPathError.of(flights, model), full.neutral_vector, seed=seed)


def no_flight_path(records: Sequence[FlightRecord], card: Card) -> str:
    """Why the flight path cannot be checked at all; empty where it can."""
    flights = join(records, card, ())
    missing = [n for n in PATH_CORE if n not in flights.channels]
    if missing:
        return f"the flight path needs {', '.join(missing)}"
    if not np.isfinite(float(card.aircraft.mass)):
        return "the card states no [aircraft], so the positions of the sensors are unknown"
    if rolled_unseen(flights):
        need = "the flight path needs phi, because the aircraft rolled"
        return f"{need}; map it, or state what did not move under [constants]"
    short = [r.name for r in records if r.time[-1] - r.time[0] < SHORTEST]
    return f"record {short[0]} is shorter than {SHORTEST:g} s" if short else ""


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

    def __init__(self, state: SelectionState) -> None:
        seconds, number = state.responses.seconds, np.full(len(state.residual), -1)  # of its stretch; -1 between folds
        total = seconds * sum(fold.stop - fold.start for fold in state.folds)
        wanted, begin = min(state.settings.block, total / state.settings.fewest_blocks), 0
        for fold in state.folds:
            length = fold.stop - fold.start
            parts = max(1, int(length * seconds / wanted + 0.5))
            number[fold] = begin + np.arange(length) * parts // length
            begin += parts
        self.state, self.number = state.wide, number
        self._inside, self._own, self.freedom = number >= 0, number[number >= 0], int(number.max())
        self.left = self._centred(state.left())
        self.weight = 1.0 / np.maximum(np.mean(self.left**2, axis=0), 1e-300)

    def _centred(self, x: np.ndarray) -> np.ndarray:
        """(m, ...) to the blocks inside stretches, (i, ...)."""
        x, sums = x[self._inside], np.zeros((self.freedom + 1, *x.shape[1:]))
        np.add.at(sums, self._own, x)
        return x - (sums / np.bincount(self._own).reshape(-1, *[1] * (x.ndim - 1)))[self._own]

    def judge(self, effect: str) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]] | None:
        """What stretches add to an effect's parameters, and its covariance by their scatter; None without effect."""
        state = self.state
        at = state.full.own_columns(effect)
        others = np.setdiff1d(state.columns([e for e in state.active if e != effect]), [*at, *state.offsets])
        S, B = (self._centred(state.scaled[:, :, columns]) for columns in (at, others))
        if not np.all(np.any(S != 0.0, axis=(0, 1))):
            return None
        both = selection_state.partialled(np.concatenate([S, self.left[:, :, None]], axis=2), B, self.weight)
        S, left = both[:, :, :-1], both[:, :, -1]
        bread = selection_state.inverse(np.einsum("mci,c,mcj->ij", S, self.weight, S, optimize=True))
        step = bread @ np.einsum("mci,c,mc->i", S, self.weight, left, optimize=True)
        rows = np.einsum("mci,c,mc->mi", S, self.weight, left - S @ step, optimize=True)
        return step, bread @ cluster_covariance(rows, self._own) @ bread

    def p_value(self, effect: str) -> float:
        """The chance that stretches which disagree as they do show as much of the best candidate (Bonferroni)."""
        if (judged := self.judge(effect)) is None:
            return 1.0
        away = self.state.departure[self.state.full.own_columns(effect)]
        return largest_p_value(away + judged[0], judged[1], self.freedom, len(self.state.blocks))

    def deviations(self, effect: str, count: int) -> Float[np.ndarray, " k"]:
        """Of an effect's `count` parameters, by how far the stretches disagree; zero where nothing is known."""
        judged = self.judge(effect)
        return np.zeros(count) if judged is None else np.sqrt(np.diag(judged[1]))


def consistent_across_blocks(state: SelectionState) -> SelectionState:
    """The state without additions that the stretches do not bear out, the least first."""
    while state.active:
        judged = Blocks(state)
        chances = {effect: judged.p_value(effect) for effect in state.active}
        worst = max(chances, key=lambda effect: chances[effect])
        if chances[worst] <= state.settings.block_false_alarm_rate:
            break
        state = selection_state.refitted(removed(state, worst))
    return state


def widened(extension: Extension, state: SelectionState) -> Extension:
    """The extension that ended in `state`, deviations no smaller than the stretches' disagreement makes them."""
    judged = Blocks(state)
    estimates = sizes(state)
    for effect in state.active:
        names = state.full.parameters_of(effect)
        wide = zip(names, judged.deviations(effect, len(names)), strict=True)
        estimates |= {n: replace(estimates[n], sd=max(estimates[n].sd, float(x))) for n, x in wide if n in estimates}
    last = screen(state)  # the last election is held anew
    scores = tuple(
        s if s.value is not None else replace(s, sd=tuple(np.maximum(s.sd, judged.deviations(s.effect, len(s.sd)))))
        for s in last.candidate_scores
    )
    closing = SelectionStep(None, float("nan"), replace(last, candidate_scores=scores))
    causes, minor = selection.worth(state, estimates)
    steps = (*extension.steps, closing)
    return replace(extension, state=state, steps=steps, sizes=estimates, causes=causes, minor=minor)


# --- What the flight path cannot decide about errors of sensors: those it asks for in vain, and those that others
# imitate. An offset of the pitch attitude turns gravity in the body axes. Accelerometers that are off by as much as
# that look the same, so without another measurement (the altitude, a calm wind) the record knows the sum of both and
# neither of them.


def open_errors(extension: Extension) -> tuple[OpenError, ...]:
    """Each error of one parameter that is asked for and not confirmed, or imitated by others; the former first."""
    state, settings = extension.state, extension.state.settings
    effects, columns, gram, right = _information_of_errors(state)
    # Priors weigh against a white likelihood as against the coloured one: see `SelectionState.variance_inflation`.
    covariance = selection_state.inverse(gram + np.diag(state.precision[columns]))
    among = np.sqrt(state.variance_inflation * np.diag(covariance))
    jointly = covariance @ (right + gram @ state.departure[columns])
    screening = extension.steps[-1].screening
    undecided = []
    for place, effect in enumerate(effects):
        parameter = effect.parameters[0]
        least, _ = effect.sizes[parameter.name]
        standing = None if effect.name in state.active else screening.of(effect.name)
        if standing is None:
            mean, sd, sought = extension.sizes[parameter.name].mean, extension.sizes[parameter.name].sd, False
        else:  # were it the only one; and whether one worth a name would explain much of what is left if confirmed
            mean, sd = float(standing.step[0]), float(standing.sd[0])
            clear = standing.score >= settings.least_score and standing.log_bayes > 0.0 and abs(mean) >= least
            sought = clear and selection.explained(state, standing) >= settings.open_share
        wide = max(sd, float(among[place]))
        there = max(least, abs(mean)) if standing is None else least
        nearest = (p for p in _nearest(gram, effects, place, settings, there) if p[1] >= settings.imitated)
        imitators, share = next(nearest, ((), 0.0))
        decided = standing is None and abs(jointly[place]) >= settings.least_score * wide
        if decided or settings.least_score * wide < least:  # nobody hides an error that is worth a name
            imitators, share = (), 0.0
        if sought or imitators:
            undecided.append(OpenError(effect.name, parameter.unit, mean, sd, wide, sought, imitators, share))
    rank = {standing.effect: k for k, standing in reversed(list(enumerate(screening.candidate_scores)))}
    return tuple(sorted(undecided, key=lambda e: (not e.asked, rank.get(e.name, len(rank)))))


def _information_of_errors(state: SelectionState) -> tuple[list[Effect], np.ndarray, np.ndarray, np.ndarray]:
    """Errors of one parameter that move the flight path, their columns, information, and what is left for them."""
    state = state.wide
    single = [e for e in state.full.candidates if len(e.parameters) == 1 and not e.scan and e.sizes]
    effects = [e for e in single if np.any(state.S[:, :, state.full.own_columns(e.name)])]
    columns = state.full.columns([e.parameters[0].name for e in effects])
    X, begin = (state.scaled[state.inside][:, :, at] for at in (columns, state.offsets))
    weight = 1.0 / state.best.variance
    X = selection_state.partialled(X, begin, weight)
    right = np.einsum("mci,c,mc->i", X, weight, state.left()[state.inside])
    return effects, columns, np.einsum("mci,c,mcj->ij", X, weight, X), right


def with_several_instead(state: SelectionState) -> SelectionState:
    """The state with an addition exchanged for several errors that together do the same and explain decisively more."""
    # Offset and scale of an airspeed come one by one, and neither gains what an offset of its pitot pressure does.
    effects, _, gram, _ = _information_of_errors(state)
    for place, effect in enumerate(effects):
        if effect.name not in state.active:
            continue
        others = [name for name in state.active if name != effect.name]
        neutral = state.full.at_neutral(state.theta, [effect.name])
        least, _ = effect.sizes[effect.parameters[0].name]  # those of absurd size are taken out afterwards
        for together, share in _nearest(gram, effects, place, state.settings, least):
            if len(together) < 2 or share < state.settings.imitated or set(together) & set(others):
                continue
            wider = selection_state.refitted(moved(state, neutral, (*others, *together)))
            gained = nats(state.best.deviance - wider.best.deviance, state.variance_inflation)
            if gained - (len(together) - 1) * math.log(len(state.full.candidates)) > state.settings.decisive:
                return with_several_instead(wider)
    return state


def _nearest(
    gram: Float[np.ndarray, "k k"], effects: Sequence[Effect], place: int, settings: DiagnosisSettings, size: float
) -> Iterator[tuple[tuple[str, ...], float]]:
    """One other error, two, and so on, of possible sizes, that do most of what one of this size does; their share."""

    def share(others: Sequence[int]) -> float:
        """Share of what the error does that `others` do; none if they must be too large."""
        at = np.array(others)
        factors = selection_state.inverse(gram[np.ix_(at, at)]) @ gram[at, place]
        largest = np.array([effects[k].sizes[effects[k].parameters[0].name][1] for k in others])
        if np.any(np.abs(factors) * size > largest):
            return 0.0
        return float(factors @ gram[at, place]) / max(float(gram[place, place]), selection_state.TINY)

    chosen: list[int] = []
    for _ in range(settings.imitators):
        shares = {k: share([*chosen, k]) for k in range(len(effects)) if k != place and k not in chosen}
        if not shares:
            return
        best = max(shares, key=lambda k: shares[k])
        chosen.append(best)
        yield tuple(effects[k].name for k in chosen), shares[best]


# --- Where a record leaves its flight path by more than the sensors' noise permits.
# Airspeed, flow angles, attitude and altitude must move as accelerometers and gyros say. What does not is compared with
# the same of records of noise by three measures of each channel: its root mean square over the record;
# the same once the best constant errors are taken out; and over windows of ten seconds. The largest of all, in units of
# what noise leaves there, decides: the rate of false alarms is that of a whole record, not of each window.

WINDOW = 10.0  # s
REPLICATES = 200  # records of noise: one in 200 that are as noisy as permitted exceeds them all in a kind of measure
SPREAD = 0.6  # of the windows: a channel that exceeds in more of them does so over the whole record
THINNED = 2000  # samples that constant errors are fitted to
RANK = 1e-8  # constant errors that make a column weaker than this, beside others, make none of their own
TOGETHER = 8  # records that are measured at a time

Series = Float[np.ndarray, " n"]


class _RecordedPath:
    """The channels of one record, zeros for those that are absent, and what the flight path leaves of them."""

    def __init__(
        self, name: str, time: Series, channels: Mapping[str, Series], card: Card, at: tuple[float, ...], seed: int
    ) -> None:
        self.name, self.time, self.channels = name, time, {n: channels[n] for n in PATH_NEEDS if n in channels}
        self.full = {n: np.zeros(len(time)) for n in PATH_NEEDS} | self.channels
        self.outputs, self.dt = path_outputs(channels), float(time[-1] - time[0]) / (len(time) - 1)
        self.white, self.constant, self.shown = sensor_noise(self.channels, card)
        self.aircraft, self.rng = replace(NO_AIRCRAFT, accelerometer=at), np.random.default_rng([seed, 31])
        self.recorded = self.residuals({"q": np.zeros((1, len(time)))})
        edges = np.linspace(0, len(time), max(1, round(len(time) * self.dt / WINDOW)) + 1).astype(int)
        self.windows = [slice(int(a), int(b)) for a, b in pairwise(edges)]

    def residuals(self, added: Mapping[str, Float[np.ndarray, "r n"]]) -> Float[np.ndarray, "r n c"]:
        """Recorded minus integrated from the start, for each of r disturbances that are `added` to some channels."""
        n, count = len(self.time), len(next(iter(added.values())))
        steps, start = np.full(n, self.dt), np.arange(n) == 0
        first, last = np.zeros(n, int), np.full(n, n - 1)
        residuals = np.empty((count, n, len(self.outputs)))
        for begin in range(0, count, TOGETHER):
            part = slice(begin, begin + TOGETHER)
            s = {name: x + added[name][part] if name in added else x for name, x in self.full.items()}
            s |= {f"{name}_dot": differentiate_joined(s[name], steps, first, last) for name in RATES}
            rates = path_rates(s, self.aircraft)
            for c, name in enumerate(self.outputs):
                residuals[part, :, c] = s[name] - integral(rates[name], steps, start, first)
        return residuals

    def local(self, x: Float[np.ndarray, "r n c"]) -> Float[np.ndarray, "r w c"]:
        parts = []
        for part in (x[:, window] for window in self.windows):
            n = part.shape[1]
            line = np.linalg.qr(np.stack([np.ones(n), np.arange(n)], axis=1))[0]
            parts.append(np.sqrt(np.mean((part - line @ (line.T @ part)) ** 2, axis=1)))
        return np.stack(parts, axis=1)

    def gusts_shown(self) -> float:
        """Standard deviation of gusts (m/s) that the calmest of the air-data channels shows within windows, for air is
        alike in all directions (MIL-F-8785C, 3.7.2.2): an error of one sensor is no gust."""
        V, levels = self.full["airspeed"], []
        for name in (name for name in AIR_DATA if name in self.outputs):
            along = name == "airspeed"
            unit = gusts(self.rng, 16, len(V), self.dt, float(np.median(V)), across=not along)
            share = float(np.mean(np.median(self.local(unit[:, :, None])[..., 0] ** 2, axis=1)))
            scale = np.ones_like(V) if along else V
            inside = self.local((self.recorded[:, :, self.outputs.index(name)] * scale)[:, :, None])[0, :, 0]
            white = self.shown[name] * float(np.median(scale))
            levels.append(float(np.median(np.maximum(inside**2 - white**2, 0.0))) / max(share, 1e-12))
        return float(np.sqrt(min(levels, default=0.0)))

    def disturbances(self, turbulence: float, count: int) -> dict[str, Float[np.ndarray, "r n"]]:
        """What `count` sensors and airs of this kind add to the channels; `turbulence` in m/s."""
        V, rng = np.maximum(self.full["airspeed"], 1.0), self.rng
        added = {
            name: sd * rng.standard_normal((count, len(V))) + self.constant[name] * rng.standard_normal((count, 1))
            for name, sd in self.white.items()
        }
        for name in (name for name in AIR_DATA if name in added):
            along = name == "airspeed"
            gust = turbulence * gusts(rng, count, len(V), self.dt, float(np.median(V)), across=not along)
            added[name] += gust if along else gust / V
        return added


def path_check(path: _RecordedPath, turbulence: float) -> PathCheck:
    """Compare the flight path of one record, in SI and without known errors of sensors, with what noise and no more
    than this `turbulence` permit."""
    met, constant = path.gusts_shown(), path.constant
    turbulence = float(np.clip(MARGIN * met, CALM, turbulence))
    drawn = path.residuals(path.disturbances(turbulence, REPLICATES)) - path.recorded
    each = zip(constant.items(), np.eye(len(constant)), strict=True)
    # A constant error of each sensor by itself, as large as is permitted.
    added = {n: np.outer(unit, sd * np.ones(len(path.time))) for (n, sd), unit in each}
    measured = _measures(path, drawn, path.residuals(added) - path.recorded)
    recorded, usual = measured[0], np.sqrt(np.mean(measured[1:] ** 2, axis=0))
    # As many times a measure's usual size as the largest of its kind in any record of noise.
    largest = np.max(measured[1:] / usual, axis=(0, 2))
    permitted = usual * np.concatenate([largest[:2], np.full(len(largest) - 2, largest[2:].max())])[:, None]
    shape = {n: (float(recorded[1, c]), float(permitted[1, c])) for c, n in enumerate(path.outputs)}
    assumed, departures = tuple(n for n in STRAIGHT if n not in path.channels), []
    begins, ends = (np.array([path.time[window][k] for window in path.windows]) for k in (0, -1))
    begins, ends = (np.concatenate([[x, x], parts]) for x, parts in ((path.time[0], begins), (path.time[-1], ends)))
    for c, name in enumerate(path.outputs):  # windows that touch make one departure, many the whole record
        ratio = recorded[:, c] / permitted[:, c]
        over = recorded[:, c] > permitted[:, c]
        chosen = [list(run) for exceeds, run in groupby(range(2, len(ratio)), over.__getitem__) if exceeds]
        if not chosen or over[2:].sum() > SPREAD * len(path.windows):
            chosen = [[int(np.argmax(ratio[:2]))]] if over[:2].any() else chosen
        for run in chosen:
            worst = max(run, key=lambda i: ratio[i])
            sizes = float(recorded[worst, c]), float(permitted[worst, c])
            departures.append(Departure(path.name, name, float(begins[run[0]]), float(ends[run[-1]]), *sizes))
    return PathCheck(path.name, tuple(departures), shape, turbulence, met, assumed)


def _measures(path: _RecordedPath, noise: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Root mean squares of the record and of each of noise: whole, without the best constant errors, by window."""
    # The constant errors that suit all outputs of a record best, of any size, and a steady vertical wind.
    step, wind = max(1, len(path.time) // THINNED), np.zeros_like(columns[:1])
    scale = np.sqrt(np.mean([np.var(x[::step], axis=0) for x in noise], axis=0))
    wind[0, :, -1] = path.time
    B = np.concatenate([columns, wind])[:, ::step]
    B = (B - B.mean(axis=1, keepdims=True)) / scale
    size = np.sqrt(np.mean(B**2, axis=(1, 2)))
    unit = (B / np.maximum(size, 1e-300)[:, None, None])[size > 0.0].reshape(int(np.sum(size > 0.0)), -1).T
    directions, strengths, _ = np.linalg.svd(unit, full_matrices=False)
    basis = directions[:, strengths > RANK * strengths.max(initial=0.0)]
    residual, measures = np.concatenate([path.recorded, noise]), []
    for first in range(0, len(residual), TOGETHER):  # a few records stay in the processor's cache
        some = residual[first : first + TOGETHER]
        centred = some - some.mean(axis=1, keepdims=True)
        thin = centred[:, ::step] / scale
        rows = thin.reshape(len(thin), -1)
        left = (rows - (rows @ basis) @ basis.T).reshape(thin.shape)
        whole = [np.sqrt(np.mean(centred**2, axis=1)), np.sqrt(np.mean(left**2, axis=1)) * scale]
        measures.append(np.concatenate([np.stack(whole, axis=1), path.local(some)], axis=1))
    return np.concatenate(measures)


# --- What the flight path may leave if every sensor is as good as the card says: noise, constant errors, light
# turbulence. Drawn as records of disturbances of the recorded channels, so that whatever is computed from a record can
# be computed from disturbed ones, too, and compared in absolute terms.

DEGREE = math.pi / 180.0
DEFAULT_NOISE = {
    "ax": 0.02, "ay": 0.02, "az": 0.05, "p": 0.02 * DEGREE, "q": 0.02 * DEGREE, "r": 0.02 * DEGREE,
    "phi": 0.1 * DEGREE, "theta": 0.1 * DEGREE, "alpha": 0.1 * DEGREE, "beta": 0.1 * DEGREE,
    "airspeed": 0.3, "altitude": 3.0,
}  # fmt: skip
"""Standard deviation of each sensor's noise where the card states none, SI: a usual flight-test installation."""

NOISIER = 3.0  # times the stated noise: white noise that a record shows is no disagreement up to here
CALM = 0.3  # m/s: air is never taken for calmer
SCALE_LENGTH = 533.0  # m, of turbulence above 2000 ft (1750 ft): MIL-F-8785C, 3.7.2
MARGIN = 2.0  # times the calmest air-data channel's own gusts: turbulence comes and goes within a record
AIR_DATA = ("airspeed", "alpha", "beta")


def sensor_noise(channels: Mapping[str, Series], card: Card) -> tuple[dict[str, float], ...]:
    """Standard deviations by channel, SI: permitted white noise, a constant error, and the white noise shown."""
    stated = {name: float(card.sensors.get(name) or DEFAULT_NOISE[name]) for name in DEFAULT_NOISE if name in channels}
    shown = {name: noise_of(np.asarray(channels[name])) for name in stated}
    permitted = {n: float(np.clip(shown[n], sd, NOISIER * sd)) for n, sd in stated.items()}
    return permitted, stated, shown


def gusts(rng: np.random.Generator, count: int, n: int, dt: float, airspeed: float, *, across: bool) -> np.ndarray:
    """Dryden turbulence of unit standard deviation along or across the path, met at a speed in m/s.

    Source: MIL-F-8785C, 3.7.2, T = L/V: along, 1/(1 + T s); across, (1 + sqrt(3) T s)/(1 + T s)^2.
    """
    keep = math.exp(-dt / (SCALE_LENGTH / max(airspeed, 1.0)))

    def response(n: int) -> Float[np.ndarray, " n"]:
        k = np.arange(n)
        second = math.sqrt(3.0) + (1.0 - math.sqrt(3.0)) * (1.0 - keep) * (k + 1) if across else 1.0
        return keep**k * second

    run_in = min(n, 4000)
    total = n + run_in
    size = next_fast_len(2 * total - 1 - run_in, real=True)  # what wraps around ends within the run-in
    spectrum = np.fft.rfft(response(total), size)
    drawn = np.fft.irfft(np.fft.rfft(rng.standard_normal((count, total)), size) * spectrum, size)
    deviation = np.sqrt(np.sum(response(int(20.0 / -math.log(keep)) + 1) ** 2))
    return drawn[:, run_in:total] / float(deviation)
