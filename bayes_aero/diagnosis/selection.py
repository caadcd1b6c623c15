"""Extend the model by what earns its place, until nothing is left to add; what else explains a selected cause."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linprog

from bayes_aero.diagnosis import screening, selection_state
from bayes_aero.diagnosis.result import Absorbed, CancellingPair, Confirmation, Size
from bayes_aero.diagnosis.screening import CandidateScore, ScreeningResult, screen, uncertainty
from bayes_aero.diagnosis.selection_state import SelectionState, by_manoeuvre, inverse, moved, refitted
from bayes_aero.effect import Effect, Stage
from bayes_aero.inference.covariance import log_density, log_score_gain, median_inflation, nats
from bayes_aero.inference.results import Scores, score
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Parameter
from bayes_aero.processes import side_by_side
from bayes_aero.progress import Progress, quiet
from bayes_aero.residuals.base import ResidualModel

OF_NOISE = 0.5  # largest share of an addition that noise may make: beyond, it would take over its regressor's own slope


class SelectionStep(NamedTuple):
    """One election: the screening, the chosen effect (None: nobody), and its p-value."""

    chosen: str | None
    p_value: float
    screening: ScreeningResult


@dataclass(frozen=True)
class Extension:
    """The state before and after additions, with fits and elections."""

    base: SelectionState
    state: SelectionState
    steps: tuple[SelectionStep, ...]
    sizes: Mapping[str, Size] = field(default_factory=dict)  # of what is in
    causes: tuple[str, ...] = ()  # additions worth a name (see `worth`)
    minor: tuple[str, ...] = ()  # additions that are not
    too_large: Extension | None = None  # that with additions larger than aircraft have, without which all was repeated

    @property
    def implausible(self) -> tuple[str, ...]:
        """Additions of this selection that are larger than aircraft have."""
        candidates = {e.name: e for e in self.state.full.candidates if e.name not in self.base.active}
        return tuple(n for n in self.state.active if n in candidates and implausible(candidates[n], self.sizes))

    @property
    def larger(self) -> tuple[Extension, ...]:
        return () if self.too_large is None else (self.too_large, *self.too_large.larger)


def plausible(
    select: Callable[[tuple[str, ...]], Extension], out: Callable[[Extension], Iterable[str]] = lambda x: x.implausible
) -> Extension:
    """What `select` finds without what is barred, made again without what is larger than aircraft have, and `out`."""
    # That explains nothing, and what was selected beside it is judged without it.
    barred: tuple[str, ...] = ()
    before: Extension | None = None
    while True:
        extension = replace(select(barred), too_large=before)
        if not extension.implausible:
            return extension
        barred, before = (*barred, *out(extension)), extension


def plausible_selection(state: SelectionState, **options: Any) -> Extension:
    """Effects added as by `selected`, sized, and no larger than aircraft have."""
    return plausible(lambda barred: sized(selected(state, barred=barred, **options)))


def selected(
    state: SelectionState, *, seed: int, most: int | None = None, progress: Progress = quiet, barred: Sequence[str] = ()
) -> Extension:
    """Add at most `most` effects (default: the settings') that are not `barred`; p-values are family-wise."""
    most = state.settings.max_effects if most is None else most
    state = refitted(state)
    inflation = median_inflation(np.array([s.variance_inflation for s in screen(state).candidate_scores]))
    state = replace(state, noise_growth=screening.noise_growth_of(state), variance_inflation=inflation)
    first = state = refitted(moved(state, state.theta))
    steps: list[SelectionStep] = []
    noisy: tuple[str, ...] = ()
    for number in range(most + state.settings.candidates_tried):
        if len(state.active) - len(first.active) >= most:
            break
        progress("causes", len(state.active) / max(most, 1))
        winner, standing_in = None, ("",)
        while standing_in:
            step = _election(state, seed + number, (*barred, *noisy), first=number == 0)
            winner = None if step.chosen is None else step.screening.of(step.chosen)
            standing_in = () if winner is None else _offsets_instead(state, winner)
            if standing_in:
                state = refitted(moved(state, state.theta, apart=(*state.apart, *standing_in)))
        steps.append(step)
        if winner is None:
            break
        wider = refitted(added(state, winner))
        if noise_shares(wider, winner.effect)[winner.effect] > OF_NOISE:
            noisy, steps[-1] = (*noisy, winner.effect), step._replace(chosen=None)
            continue
        state = _reconsidered(wider, barred)
        noisy = ()  # with less left, noise can make less
    for name in state.apart:  # offsets between manoeuvres that explain nothing beside what was added after them
        fewer = refitted(moved(state, state.theta, apart=tuple(n for n in state.apart if n != name)))
        gained = nats(fewer.best.deviance - state.best.deviance, state.variance_inflation) - len(state.folds) + 1
        if gained < state.settings.ambiguous:
            state = fewer
    return Extension(first, state, tuple(steps))


def _offsets_instead(state: SelectionState, winner: CandidateScore) -> tuple[str, ...]:
    """Coefficients whose offsets between manoeuvres stand in for an addition."""
    # What differs between manoeuvres alone (a trim, a flap, the throttle) explains any offset that is left there. So an
    # addition must be identified within manoeuvres, with the same sign, and offsets must not be decisively better.
    if state.of_coefficients:
        moved_ones = np.any(state.wide.S[:, :, np.array(winner.columns, int)] != 0.0, axis=(0, 2))
        reached = [n for n, moves in zip(state.outputs, moved_ones, strict=True) if moves]
    else:  # in flight all whose constant the card has; none along the flight path
        card = {p for e in state.full.base for p in state.full.parameters_of(e)} & set(state.full.model.names)
        coefficients = () if state.responses.kinematic else state.responses.model.coefficients
        reached = [n for n in coefficients if f"{n}0" in card]
    outputs = tuple(n for n in reached if n not in state.apart)
    count = len(state.responses.flights.lengths)
    if count == 1 or not outputs:
        return ()
    wider = moved(state, state.theta, apart=(*state.apart, *outputs))
    within = screen(wider).of(winner.effect)
    identified = within is not None and within.score >= state.settings.least_score and within.log_bayes > 0.0
    if within is None or not identified or float(np.dot(within.step, winner.step)) <= 0.0:
        return outputs
    better = nats(state.best.deviance - wider.best.deviance - winner.gain, winner.variance_inflation)
    return outputs if better - (count - 1) * len(outputs) > state.settings.decisive else ()


def sized(extension: Extension) -> Extension:
    state, names = extension.state, extension.state.full.model.names
    errors = screening.jackknife_errors(state, state.responses.stretch)
    least = {names[c]: float(x) for c, x in zip(state.best.columns, errors, strict=True) if c < len(names)}
    estimates = {name: replace(size, sd=max(size.sd, least[name])) for name, size in sizes(state).items()}
    causes, minor = worth(state, estimates)
    return replace(extension, sizes=estimates, causes=causes, minor=minor)


def noise_shares(state: SelectionState, *effects: str) -> dict[str, float]:
    """Largest share of each addition (default: all) that noise of the recorded channels can make, by effect."""
    # Noise in a regressor makes of whatever moves with it a second recording of the same.
    bias, away = largest_noise_bias(state, effects), dict(zip(state.full.model.names, state.departure, strict=True))
    shares = {}
    for effect in effects or state.active:
        names = [n for n in state.full.parameters_of(effect) if n in bias]
        made = [abs(bias[n][int(away[n] > 0.0)]) / max(abs(away[n]), 1e-300) for n in names]
        shares[effect] = float(min(1.0, *made)) if made else 0.0
    return shares


def _election(state: SelectionState, seed: int, barred: Sequence[str], first: bool) -> SelectionStep:
    """The most explaining candidate, not `barred`, that is beyond chance, matters, and predicts folds left out."""
    settings, noise = state.settings, screening.SharedNoise(seed, state.folds, len(state.outputs), state.settings)
    state = state.wide
    ranking, able = screen(state, nulls=first, noise=noise), list[CandidateScore]()
    leaders: dict[str, CandidateScore] = {}
    for standing in (s for s in ranking.candidate_scores if s.effect not in barred):
        leaders.setdefault(standing.effect, standing)
    for standing in list(leaders.values())[: settings.candidates_tried]:
        if explained(state, standing) < state.least_of_effect or mixes_noise(state, standing):
            continue
        if not addition_gain(state, state.wider(standing.columns)) > 0.0:
            continue
        able.append(standing)
        if standing.score < settings.least_score or standing.log_bayes <= 0.0:
            continue
        if not len(ranking.nulls):
            blocks = [b[1] for b in state.blocks if b[0] not in state.active]
            projected = screening.PartialledRegression(state, state.best, blocks)
            ranking = replace(ranking, nulls=projected.nulls(ranking.colour, noise.replicates))
        if (p := ranking.p_value(standing.score)) <= settings.false_alarm_rate:
            return SelectionStep(standing.effect, p, ranking)
    among, alone = len(ranking.candidate_scores), not state.responses.freedom
    for standing in able if alone else able[: settings.candidates_refitted]:
        if alone:
            p, limit = screening.refit_p_value(state, standing, noise), settings.false_alarm_rate
        else:  # no stationary colour holds, with a leader in or out
            p = between_p_value(refitted(added(state, standing)), standing.effect, among)
            limit = settings.refit_false_alarm_rate
        if p <= limit:
            return SelectionStep(standing.effect, p, ranking)
    highest = max((s.score for s in ranking.candidate_scores if s.effect not in barred), default=0.0)
    return SelectionStep(None, ranking.p_value(highest) if len(ranking.nulls) else math.nan, ranking)


def between_p_value(wider: SelectionState, effect: str, among: int) -> float:
    """p-value of an addition by how far it moves without each stretch, Bonferroni over `among` candidates."""
    # It is in, and all is fitted again: a large effect that is out bends the first-order residuals, and the stretches
    # then seem to disagree more than they do.
    columns = wider.full.own_columns(effect)
    if not np.all(np.isin(columns, wider.best.columns)):
        return 1.0
    return screening.jackknife_p_value(wider, wider.best, columns, wider.departure[columns], among)


def mixes_noise(state: SelectionState, standing: CandidateScore) -> bool:
    """Whether a candidate's gain vanishes when noise of the coefficients may correlate."""
    # Noise of the angle of attack is in CL and in Cm at once. A shift of the CG adds CL to Cm, which hides that noise
    # under a diagonal covariance and explains nothing. Only constants of the aircraft mix coefficients as measured;
    # what any other effect leaves out of one of them may rightly be in another, too.
    if not state.of_coefficients or standing.together >= state.settings.least_share_correlated * standing.gain:
        return False
    return any(e.name == standing.effect and e.stage is Stage.AIRCRAFT for e in state.full.candidates)


def explained(state: SelectionState, standing: CandidateScore) -> float:
    """Share of the remaining variance that a candidate takes away, were it all in one output."""
    return 1.0 - float(np.exp(-max(standing.gain, 0.0) / state.products.count.sum()))


def added(state: SelectionState, winner: CandidateScore) -> SelectionState:
    """The state with a candidate in, its parameters at their first-order estimate (or the scanned value), or nearer
    to neutral where the model diverges there."""
    theta = state.theta.copy()
    at = state.full.own_columns(winner.effect)
    if winner.value is not None:
        (scan,) = (e.scan for e in state.full.candidates if e.name == winner.effect)
        theta[state.full.columns([p for p, values in scan.items() if winner.value in values])] = winner.value
    else:
        bounds = np.array([state.full.model.free[i].bounds for i in at])
        theta[at] = np.clip(theta[at] + np.array(winner.step), bounds[:, 0], bounds[:, 1])
    trials = [state.theta + share * (theta - state.theta) for share in (1.0, 0.5, 0.2, 0.05)]
    able = (x for x in trials if np.all(np.abs(state.responses.residuals(x, state.outputs)) < selection_state.LARGEST))
    return moved(state, next(able, state.theta), (*state.active, winner.effect))


def removed(state: SelectionState, effect: str) -> SelectionState:
    return truncated(state, [e for e in state.active if e != effect])


def _reconsidered(state: SelectionState, barred: Sequence[str]) -> SelectionState:
    """Look at each earlier addition again: drop it if it is superfluous by now, exchange it if it was a proxy."""
    least = state.least_of_effect

    def bayes_within(candidate: CandidateScore) -> float:
        """Log Bayes factor of an addition under the colour that is left with it in."""
        columns = state.full.own_columns(candidate.effect)
        away = state.departure[columns]
        if not (np.all(np.isfinite(away)) and np.all(np.isin(columns, state.best.columns))):
            return candidate.log_bayes
        at, precision = state.best.places(columns), state.precision[columns] / state.variance_inflation
        return screening.log_bayes(away, uncertainty(state)[np.ix_(at, at)], state.mean[columns] + away, precision)

    for effect in state.active[:-1]:
        ranking = screen(state, without=effect)
        standing = ranking.of(effect)
        able = (s for s in ranking.candidate_scores if s.effect not in barred and not mixes_noise(state, s))
        best = next(able, ranking.candidate_scores[0])
        faint = standing is not None and standing.log_bayes < 0.0 and bayes_within(standing) < 0.0
        if standing is None or faint or explained(state, standing) < least or mixes_noise(state, standing):
            state = refitted(removed(state, effect))
        elif best.effect != effect:
            more = best.gain - (1.0 + state.settings.exchange_margin) * standing.gain
            if nats(more, best.variance_inflation_apart) > 1.0:
                other = refitted(added(removed(state, effect), best))
                state = other if noise_shares(other, best.effect)[best.effect] <= OF_NOISE else state
    return state


def worth(state: SelectionState, estimates: Mapping[str, Size]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Additions large enough to be worth modelling, and nuisances: small, uncertain, or perhaps noise."""
    added = [e for name in state.active for e in state.full.candidates if e.name == name]

    def large_ones(bias: Mapping[str, tuple[float, float]]) -> list[str]:
        """Those far from neutral with whichever bias brings them nearest."""
        chosen = []
        for effect in added:
            away = {}
            for p in (p for p in effect.parameters if p.name in effect.sizes and p.name in estimates):
                size = estimates[p.name]
                ends = [p.away(size.mean - b, size.sd) for b in (*bias.get(p.name, ()), 0.0)]
                passes = min(x for x, _ in ends) * max(x for x, _ in ends) <= 0.0
                x, sd = min(ends, key=lambda end: abs(end[0]))
                away[p.name] = (0.0 if passes else x), sd
            if large(effect, away, state.settings.least_score):
                chosen.append(effect.name)
        return chosen

    causes = large_ones(largest_noise_bias(state)) if large_ones({}) else []
    return tuple(causes), tuple(name for name in state.active if name not in causes)


def large(effect: Effect, away: Mapping[str, tuple[float, float]], least_score: float) -> bool:
    """Whether any parameter of an effect is as far from neutral (`away`) as is worth a name, and beyond its error."""
    rows = [(abs(size), sd, effect.sizes[p][0]) for p, (size, sd) in away.items()]
    return not rows or any(size + sd >= least and size >= least_score * sd for size, sd, least in rows)


def nats_gained(old: Extension, new: Extension) -> float:
    """Log likelihood that another extension gains, the colour counted, less what the choice of each addition costs."""

    def deviance(state: SelectionState) -> float:
        return state.best.deviance + 2.0 * float(np.sum(np.log(state.noise_growth[state.inside])))

    additions = len(new.state.active) - len(old.state.active)
    gained = deviance(old.state) - deviance(new.state)
    choice = math.log(max(len(new.state.full.candidates), 1))
    return nats(gained, max(old.state.variance_inflation, new.state.variance_inflation)) - additions * choice


# --- What else explains a cause: constants, collinear effects, and errors of sensors that a record leaves undecided.
# A rudder that is held aside makes a yawing moment that stays, as uneven engines do. Where it does not move, its
# derivative is known from that constant alone. It takes up what else is constant, and the selection finds nothing. The
# record then does not decide between an unusual derivative and the other cause.

CONTROLS = (
    "elevator", "stabilizer", "canard", "flap", "spoiler", "dlc", "aileron", "rudder", "spoiler_left", "spoiler_right",
)  # fmt: skip
AT_REST = 0.1  # of a sensitivity's root mean square, its deviation within the manoeuvres; our choice


def absorbed(extension: Extension) -> tuple[Absorbed, ...]:
    """Parameters of the card that may have taken up an effect large enough for a name."""
    # It is seen with the parameter held, and not seen with it free within its prior.
    state, parameters = extension.state, []
    if not state.of_coefficients:
        return ()
    for effect in (e for e in state.full.model.effects if e.name in state.full.base):
        controls = [c for c in effect.channels if c in CONTROLS]
        free = [p for p in effect.parameters if p.name in state.full.model.names and len(controls) == 1]
        for parameter, column in ((p, int(state.full.columns([p.name])[0])) for p in free):
            S = state.S[state.inside][:, :, column]  # what it acts through stays in all manoeuvres, and not at zero
            square, varied = float(np.sum(S**2)), float(np.sum((S - S.mean(axis=0)) ** 2))
            at_rest = square > 0.0 and varied < AT_REST**2 * square
            if column in state.best.columns and at_rest and (sizes := _taken_up(extension, column)):
                name, usual = parameter.name, state.full.priors.get(parameter.name, parameter.prior).normal
                estimate = float(state.theta[column]), extension.sizes[name].sd
                parameters.append(Absorbed(effect.name, name, parameter.unit, controls[0], estimate, usual, sizes))
    return tuple(parameters)


def _taken_up(extension: Extension, column: int) -> dict[str, Size]:
    """Sizes of the candidates that the parameter of a column hides, by name."""
    state, fit, scale = extension.state.wide, extension.state.best, extension.state.settings.least_score
    fewer, hidden = fit.columns[fit.columns != column], {}
    S, weight = state.scaled[state.inside], 1.0 / fit.variance

    def deviations(at: int, size: float, columns: Int[np.ndarray, " k"]) -> float:
        """By how many an effect of this size is seen, `columns` free within their priors."""
        A, signal = S[:, :, columns], size * S[:, :, at]
        normal = np.einsum("mci,c,mcj->ij", A, weight, A, optimize=True) + np.diag(state.precision[columns])
        right = np.einsum("mci,c,mc->i", A, weight, signal, optimize=True)
        information = float(np.einsum("mc,c,mc->", signal, weight, signal) - right @ inverse(normal) @ right)
        return float(np.sqrt(max(information, 0.0) / state.variance_inflation))

    def size_of(at: int) -> tuple[float, float]:
        """Of a candidate and its deviation, the parameter of `column` held where its prior has it."""
        columns, away = np.append(fewer, at), float(state.mean[column])
        given = columns, state.mean, state.precision, fit.variance
        there = state.products.shifted(np.array([column]), np.array([away])).fit(*given)
        here = state.products.fit(*given)
        slope = (there.step[-1] - here.step[-1]) / away if away else 0.0
        variance = inverse(there.normal)[-1, -1] + slope**2 / state.precision[column]
        return float(there.step[-1]), float(np.sqrt(state.variance_inflation * variance))

    for effect in state.full.candidates:  # those of one parameter, with a slope at neutral, and a size worth a name
        out = {*state.active, *(scan.effect for scan in state.scans)}
        if len(effect.parameters) == 1 and effect.name not in out and effect.parameters[0].name in effect.sizes:
            (at,), (least, largest) = state.full.own_columns(effect.name), effect.sizes[effect.parameters[0].name]
            if deviations(at, least, fit.columns) < scale <= deviations(at, least, fewer):
                mean, sd = size_of(int(at))
                if least <= abs(mean) <= largest:
                    hidden[effect.name] = Size(mean, sd, effect.parameters[0].unit)
    return hidden


# --- Two named terms that cancel: what the record knows of them is one combination, not either.
# Pitch rate and the rate of the angle of attack move together in most manoeuvres. A fit then sets a large term
# against another large one; neither is measured. The combination of the two with the least variance is.


def cancelling(extension: Extension, causes: Sequence[str]) -> tuple[CancellingPair, ...]:
    """Pairs of causes whose contributions cancel, each with its combination of least variance."""
    state, pairs = extension.state, []
    for effects, names, C in _correlated_parameters(extension, causes):
        i, j = map(int, state.full.columns(names))
        weight = 1.0 / np.mean(state.residual[state.inside] ** 2, axis=0)
        shifts = [state.scaled[state.inside][:, :, c] * state.departure[c] for c in (i, j)]
        shifts = [x - x.mean(axis=0) for x in shifts]
        first, second, both = (float(np.sum(weight * x**2)) for x in (*shifts, shifts[0] + shifts[1]))
        if both >= min(first, second):  # what they do to the outputs, means aside, is less together than either alone
            continue
        units = [state.full.model.free[c].unit for c in (i, j)]
        factor = -float(C[0, 1] / C[1, 1])
        if units[0] == units[1] and abs(abs(factor) - 1.0) < state.settings.near_one:
            factor = float(np.sign(factor))
        variance = float(C[0, 0] + 2.0 * factor * C[0, 1] + factor**2 * C[1, 1])
        mean, sd = float(state.departure[i] + factor * state.departure[j]), float(np.sqrt(max(variance, 0.0)))
        pairs.append(CancellingPair(effects, names, factor, mean, sd, units[0], _correlation(C)))
    return tuple(pairs)


def correlated(extension: Extension, effects: Sequence[str]) -> dict[str, dict[str, float]]:
    partners: dict[str, dict[str, float]] = {}
    for (effect, other), _, C in _correlated_parameters(extension, effects):
        partners.setdefault(effect, {})[other] = partners.setdefault(other, {})[effect] = _correlation(C)
    return partners


def without_hold(extension: Extension) -> dict[str, Mapping[str, float]]:
    """Additions that are no error by themselves: too large, at a bound, or estimated together with such a one."""
    state, joint = extension.state, correlated(extension, extension.state.active)
    bounded = [n for n in state.active if any(extension.sizes[p].at_bound for p in state.full.parameters_of(n))]
    out = {*bounded, *extension.implausible}
    return {n: joint.get(n, {}) for n in state.active if n in out or out & set(joint.get(n, {}))}


def _correlated_parameters(extension: Extension, effects: Sequence[str]) -> Iterator[tuple]:
    """Pairs of effects, one parameter of each, and the covariance of these two where they are correlated."""
    state = extension.state
    if len(effects) < 2:
        return
    covariance, at = uncertainty(state), {int(c): k for k, c in enumerate(state.best.columns)}
    for effect, other in combinations(effects, 2):
        for a, b in product(state.full.parameters_of(effect), state.full.parameters_of(other)):
            places = [at[c] for c in map(int, state.full.columns([a, b])) if c in at]
            C = covariance[np.ix_(places, places)]
            if len(places) == 2 and abs(_correlation(C)) > state.settings.correlated:
                yield (effect, other), (a, b), C


def _correlation(C: np.ndarray) -> float:
    return float(C[0, 1] / np.sqrt(C[0, 0] * C[1, 1]))


# --- How far estimates may be off: the residuals' colour, and the noise of what the regressors were recorded with.
# What effects act through is recorded with noise, then smoothed and differentiated. Least squares on such regressors is
# not consistent, and its residuals do not show it. Noise of the size that is there already, added once more, moves the
# estimates by about as much as the noise that is there has moved them: the bias grows with the noise's variance.
# Source: simulation extrapolation (SIMEX), Cook and Stefanski 1994, J. Am. Stat. Assoc. 89, 1314.

PAIRS = 10  # of records with the same noise added and subtracted, which cancels what is linear in it
REGRESSORS = ("alpha", "airspeed", "q", "elevator")
AT_BOUND = 1e-6  # of a parameter's value, within which it lies on a bound: fits stop 1e-9 short
SLOW = 100.0  # largest variance of slow noise over that of the white noise beside it: ten times its size; our choice
LOW = 3.0  # deviations of a lognormal prior below its median, beyond which no aircraft has a parameter; our choice
FILTERED = -0.5  # lag-1 correlation of third differences above which they are not white noise's


def implausible(effect: Effect, sizes: Mapping[str, Size]) -> dict[str, float]:
    """Parameters beyond the largest plausible size, and that; 1/e for one infinite at neutral, or one too small."""
    exceeded = {}
    for p in (p for p in effect.parameters if p.name in effect.sizes and p.name in sizes):
        largest, finite = effect.sizes[p.name][1], math.isfinite(p.neutral)
        if abs(p.away(sizes[p.name].mean, sizes[p.name].sd)[0]) > largest:
            exceeded[p.name if finite else f"1/{p.name}"] = largest
        elif finite and p.prior.family == "lognormal":  # the distance from neutral does not say what is too small
            least = p.prior.location * math.exp(-LOW * p.prior.scale)
            exceeded |= {f"1/{p.name}": 1.0 / least} if sizes[p.name].mean < least else {}
    return exceeded


def implausible_candidate(effect: Effect, standing: CandidateScore) -> bool:
    """Whether a candidate would be `implausible` at its first-order estimate, or at the value at which it was tried."""
    if standing.value is None:
        values = {p.name: p.neutral + x for p, x in zip(effect.parameters, standing.step, strict=False)}
    else:
        values = {next(name for name, tried in effect.scan.items() if standing.value in tried): standing.value}
    return bool(implausible(effect, {n: Size(x, 0.0, "") for n, x in values.items() if math.isfinite(x)}))


def filtered_channels(flights: Flights) -> tuple[str, ...]:
    """Channels behind the regressors whose noise was filtered before it was recorded, so that it cannot be read off."""
    # Third differences of white noise have a lag-1 correlation of -0.75; what is filtered, or motion, has not.
    filtered = []
    for name in (name for name in REGRESSORS if name in flights.recorded):
        rough = np.concatenate([np.diff(part, 3) for part in by_manoeuvre(np.asarray(flights.channels[name]), flights)])
        limit = 5.0 * np.median(np.abs(rough))
        inside = np.clip(rough, -limit, limit)
        if limit > 0.0 and np.corrcoef(inside[1:], inside[:-1])[0, 1] > FILTERED:
            filtered.append(name)
    return tuple(filtered)


def noise_effect(state: SelectionState) -> tuple[Float[np.ndarray, " k"], ...]:
    """What recording noise does to each estimate of a fit at its optimum: its bias, and its standard deviation."""
    flights, rng, fit = state.responses.flights, np.random.default_rng(0), state.best
    noise, parameters = flights.noise, fit.columns < len(state.theta)
    at = fit.columns[parameters]

    def step(extra: Mapping[str, np.ndarray], sign: float = 1.0) -> np.ndarray:
        channels = flights.channels | {name: flights.channels[name] + sign * e for name, e in extra.items()}
        there = replace(state, responses=state.responses.with_channels(channels))
        # Variances held: grown by the noise they would let the prior pull more, which is no bias of the regressors.
        stepped, _ = selection_state.local_fit(there, state.theta, at, range(len(state.folds)), fit.variance)
        return stepped.step[: len(at)]

    drawn = ({name: sd * rng.standard_normal(flights.n) for name, sd in noise.items()} for _ in range(PAIRS))
    there, back = np.array([(step(extra), step(extra, -1.0)) for extra in drawn]).transpose(1, 0, 2)
    bias, spread = np.zeros((2, len(fit.columns)))
    bias[parameters] = np.mean((there + back) / 2.0, axis=0) - step({})
    spread[parameters] = np.sqrt(np.mean(((there - back) / 2.0) ** 2, axis=0))
    return bias, spread


@lru_cache(maxsize=4)
def largest_noise_bias(state: SelectionState, effects: tuple[str, ...] = ()) -> dict[str, tuple[float, float]]:
    """Lowest and highest bias of additions' parameters (default: all) by any recording noise that residuals permit."""
    # It is linear in the channels' variances, which sum up to no more than is left of an output; noise may be `SLOW`
    # times what is read off as white. Source: Klepper and Leamer, Econometrica 52 (1984) 163.
    fit, keep, parameters = state.best, state.kept_outputs, state.best.columns < len(state.theta)
    at, additions = fit.columns[parameters], state.full.own_columns(*(effects or state.active))
    covariance = inverse(fit.normal)[np.isin(fit.columns, additions)][:, parameters]
    directions = np.zeros((len(covariance), len(state.theta)))
    directions[:, at] = covariance
    S, weight = state.scaled[state.inside][:, :, at] @ covariance.T, 1.0 / fit.variance
    noisy = state.responses.noisy.values()

    def made(there: ResidualModel) -> tuple[np.ndarray, np.ndarray]:
        """What noise of one channel adds to the outputs' variances, and its bias of the additions."""
        residual, slopes = there.along(state.theta, directions)
        dr = ((residual[:, keep] - state.residual) / state.noise_growth)[state.inside]
        dS = (slopes[:, keep] / state.noise_growth[:, :, None])[state.inside] - S
        return np.mean(dr**2, axis=0) * weight, np.tensordot(dr * weight, dS, 2)

    added, biases = zip(*side_by_side(made, noisy), strict=True) if noisy else ((), ())
    if not np.any(added):
        return {}
    scale = np.maximum(np.max(added, axis=1), 1e-12)  # a channel that adds to no output has no bias either
    limits = np.array(added).T / scale
    most = [(0.0, min(1.0, SLOW * float(x))) for x in scale]

    def least(row: Float[np.ndarray, " f"]) -> float:
        """Least of row x with limits x <= 1 and x within `most`; without the limits where the solver fails."""
        size = float(np.max(np.abs(row)))
        if size == 0.0:
            return 0.0
        value = linprog(row / size, limits, np.ones(len(limits)), bounds=most).fun
        return float(size * value) if value is not None else float(np.minimum(row, 0.0) @ np.array(most)[:, 1])

    names = [state.full.model.names[column] for column in fit.columns[np.isin(fit.columns, additions)]]
    return {name: (least(row), -least(-row)) for name, row in zip(names, np.array(biases).T / scale, strict=True)}


def normal_draws(
    mean: Float[np.ndarray, " k"],
    columns: Int[np.ndarray, " j"],
    covariance: Float[np.ndarray, "j j"],
    parameters: Sequence[Parameter],
    seed: int,
    count: int,
) -> Float[np.ndarray, "r k"]:
    """Parameters drawn from the normal distribution of estimates, `columns` of which vary, within their bounds."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    white = np.random.default_rng(seed).standard_normal((count, len(columns)))
    draws = np.tile(mean, (count, 1))
    draws[:, columns] += (white * np.sqrt(np.maximum(values, 0.0))) @ vectors.T * scale
    lower, upper = np.array([p.bounds for p in parameters], float).reshape(-1, 2).T
    return np.clip(draws, np.minimum(lower, mean), np.maximum(upper, mean))


def sizes(state: SelectionState) -> dict[str, Size]:
    """Every active parameter with its deviation: what coloured residuals leave, what recording noise makes of it."""
    # Recording noise that is integrated along the flight path wanders, and the fit follows it, so the residuals may
    # show less of it than there is: the larger of both deviations counts. The mean is the estimate without its bias,
    # which is itself known to first order only: it counts as a deviation, too.
    variance = np.maximum(np.diag(uncertainty(state)), 0.0)
    bias, spread = noise_effect(state)
    deviation = np.sqrt(np.maximum(variance, spread**2) + bias**2)
    estimates, free = {}, state.full.model.free
    for c, shift, sd in zip(state.best.columns, bias, deviation, strict=True):
        if c < len(free):
            mean, (low, high) = state.theta[c], free[c].bounds
            at_bound = min(abs(mean - low), abs(mean - high)) < AT_BOUND * abs(mean)
            mean = float(np.clip(mean - shift, low, high))
            estimates[free[c].name] = Size(mean, float(sd), free[c].unit, bool(at_bound))
    return estimates


# --- What an extension gains on data that it was not fitted to, however the model meets the record.


def split_name(state: SelectionState) -> str:
    return "manoeuvre" if len(state.responses.flights.lengths) > 1 else "block"


@dataclass(frozen=True)
class LeftOut:
    """Residuals of every fold (or flown segment) with parameters fitted to the others."""

    residual: Float[np.ndarray, "m c"]
    noise_growth: Float[np.ndarray, "m c"]
    inside: Bool[np.ndarray, " m"]  # rows that belong to a fold
    names: tuple[str, ...]  # of the outputs
    lengths: Sequence[int]  # rows of each part that is independent of the others
    variance_inflation: float
    by_output: bool = True  # False along the flight path: of its errors the coefficients say what they make worse
    flyable: bool = True  # whether a simulation stays in the envelope

    @classmethod
    def refitted(cls, state: SelectionState) -> LeftOut:
        """With the effects that are in, every fit brought to its own optimum."""
        fitted = partial(selection_state.optimum, state, most=state.settings.hold_out_steps)
        return cls._of(state, state.responses.holdout(state.folds, fitted, state.outputs))

    @classmethod
    def first_order(cls, state: SelectionState, effects: Sequence[str]) -> LeftOut:
        """With only `effects` of those that are in, from the sensitivities: a hundredth of the time of `refitted`."""
        fewer = state.without([e for e in state.active if e not in effects])
        residual, columns = fewer.residual.copy(), fewer.columns()
        parameters = ~np.isin(columns, state.offsets)
        for number, fold in enumerate(state.folds):
            step = fewer.products.without(number).fit(columns, fewer.mean, fewer.precision).step
            residual[fold] -= state.S[fold][:, :, columns[parameters]] @ step[parameters]
        return cls._of(state, residual)

    @classmethod
    def _of(cls, state: SelectionState, residual: Float[np.ndarray, "m c"]) -> LeftOut:
        residual, offsets = np.where(state.inside[:, None], residual, 0.0), state.S[:, :, state.offsets]
        if offsets.shape[2]:  # where a flight-path integral began is the left-out fold's own to find
            residual -= offsets @ (np.einsum("mco,mc->o", offsets, residual) / np.sum(offsets**2, axis=(0, 1)))
        lengths = [fold.stop - fold.start for fold in state.folds]
        if len(state.responses.flights.lengths) == 1:  # blocks of one flight, one after the other: their colour runs on
            lengths = [sum(lengths)]
        growth, inflation, by_output = state.noise_growth, state.variance_inflation, not state.responses.kinematic
        return cls(residual, growth, state.inside, state.outputs, lengths, inflation, by_output)

    def densities(self) -> Float[np.ndarray, "m c"]:
        """Log predictive density of every row by output: independent and normal."""
        # With the variance that the left-out residuals themselves have: the variance of the fitted ones would punish a
        # model for the other manoeuvre's stall, whatever its mean.
        residual, noise_growth = self.residual[self.inside], self.noise_growth[self.inside]
        return log_density(residual, np.mean((residual / noise_growth) ** 2, axis=0) * noise_growth**2)

    def gain(self, before: LeftOut) -> tuple[float, float]:
        densities = before.densities().sum(axis=1), self.densities().sum(axis=1)
        return log_score_gain(*densities, self.variance_inflation, self.lengths)

    def output_gains(self, before: LeftOut) -> dict[str, tuple[float, float]]:
        """`gain` of each output by itself; empty where that says nothing."""
        if not (self.by_output and before.flyable):
            return {}
        densities = before.densities(), self.densities()
        pairs = zip(self.names, *(density.T for density in densities), strict=True)
        return {n: log_score_gain(x, y, self.variance_inflation, self.lengths) for n, x, y in pairs}

    def scores(self, measured: Float[np.ndarray, "m c"]) -> dict[str, Scores]:
        return scores_of(self.names, measured[self.inside], self.residual[self.inside])


def scores_of(names: Sequence[str], z: Float[np.ndarray, "m c"], e: Float[np.ndarray, "m c"]) -> dict[str, Scores]:
    return {name: score(z[:, c], z[:, c] - e[:, c]) for c, name in enumerate(names)}


def measured_blocks(state: SelectionState) -> Float[np.ndarray, "m c"]:
    """Coefficients as the card reconstructs them from the record, averaged over blocks."""
    card = state.full.card_only(state.theta)
    return np.asarray(state.responses.block(state.responses.predict(card)["measured"]))


def truncated(state: SelectionState, effects: Sequence[str]) -> SelectionState:
    """The state with only `effects` of its additions in, the others' parameters at neutral."""
    theta = state.full.at_neutral(state.theta, [e for e in state.active if e not in effects])
    return moved(state, theta, tuple(effects))


def holdout_deviance_gain(state: SelectionState, wide: np.ndarray, narrow: np.ndarray | None = None) -> float:
    """Deviance that columns `wide` gain over `narrow` (default: the active ones) on folds that were left out."""

    def deviance(columns: np.ndarray) -> float:
        """n log(mean square) over folds and outputs; the offsets are each fold's own."""
        used = np.unique(np.concatenate([columns, state.offsets]))
        products, mean, precision = state.products.only(used), state.mean[used], state.precision[used]
        columns, offsets = (np.searchsorted(used, indices) for indices in (columns, state.offsets))
        parameters, flat, total = ~np.isin(columns, offsets), np.zeros(len(used)), 0.0
        for fold in range(len(state.folds)):
            step = products.without(fold).fit(columns, mean, precision).step
            left = products.over([fold]).shifted(columns[parameters], step[parameters])
            if len(offsets):
                total += left.fit(offsets, flat, flat).deviance
            else:
                n = float(left.count.sum())
                total += float(n * np.sum(np.log(left.gram[0, :, 0, 0] / n)))
        return total

    return deviance(state.columns() if narrow is None else narrow) - deviance(wide)


def addition_gain(state: SelectionState, wide: np.ndarray) -> float:
    """Deviance that additions `wide` gain on folds that were left out, where unlike manoeuvres predict each other."""
    gain, card = holdout_deviance_gain(state, wide), state.columns(())
    of_card = np.any(card < len(state.theta))  # sensors along the flight path have no such parameters
    if gain > 0.0 or not of_card or len(state.responses.flights.lengths) < 2:
        return gain
    used = np.unique(np.concatenate([wide, state.columns(), card]))
    everything, active, card = (np.searchsorted(used, columns) for columns in (wide, state.columns(), card))
    of = state.products.only(used), (state.mean[used], state.precision[used]), state.variance_inflation
    folds, both = range(len(state.folds)), (active, everything)
    deviances = [[integrated_deviance(*of, fold, columns, card) for columns in both] for fold in folds]
    return float(np.sum([without - within for without, within in deviances]))


def integrated_deviance(
    products: selection_state.Products, prior: tuple, inflation: float, fold: int, columns: np.ndarray, card: np.ndarray
) -> float:
    """Deviance of a fold by these columns, those beyond the card's integrated out over their posterior elsewhere."""
    others, at = products.without(fold).fit(columns, *prior), np.flatnonzero(~np.isin(columns, card))
    precision_elsewhere = 1.0 / np.diag(inverse(others.normal))[at]
    mean, precision = (x.copy() for x in prior)
    mean[columns[at]], precision[columns[at]] = others.step[at], precision_elsewhere
    posterior = products.over([fold]).fit(columns, mean, precision)
    narrowed = 1.0 / np.diag(inverse(posterior.normal))[at] / precision_elsewhere
    return posterior.deviance + inflation * float(np.sum(np.log(np.maximum(narrowed, 1.0))))


# --- Which additions unseen data confirm.
# An election asks only that a candidate gains at all on data left out, and adds one after the other. Taken together
# some are superfluous, and what is superfluous harms elsewhere: a delay that fits one manoeuvre's noise spoils the
# simulation of the next. So additions are taken out again one at a time, the least useful first, as long as unseen
# data do not miss them, or an output is predicted worse with them than without.


Predicted = Callable[[Sequence[str]], LeftOut]  # unseen data as the model with some of its additions predicts them


def backward_elimination(
    additions: Sequence[str], first_order: Predicted, refitted: Predicted, settings: selection_state.DiagnosisSettings
) -> Confirmation:
    """Each addition in turn, least missed to first order first, is taken out and everything fitted again."""

    def gain(without: LeftOut, whole: LeftOut) -> tuple[float, float]:
        return whole.gain(without) if without.flyable else (np.inf, 0.0)

    plain, kept, missed, waiting = settings.hold_out_first_order, list(additions), {}, list(additions)
    harmed: dict[str, Mapping[str, tuple[float, float]]] = {}
    whole: LeftOut | None = None
    while waiting:
        less = {e: [other for other in kept if other != e] for e in waiting}
        near, fewer = first_order(kept), {e: first_order(less[e]) for e in waiting}
        losses = {e: gain(fewer[e], near) for e in waiting}
        harmful = [e for e in waiting if settings.degraded(near.output_gains(fewer[e]))]
        least = min(harmful or waiting, key=lambda e: losses[e][0] - plain * losses[e][1])
        if not harmful and losses[least][0] > plain * losses[least][1]:
            missed |= losses
            break
        whole, without = whole or refitted(kept), refitted(less[least])
        missed[least] = gain(without, whole)
        worse = settings.degraded(whole.output_gains(without))
        if worse or not missed[least][0] > settings.hold_out * missed[least][1]:
            kept, whole = less[least], without
            harmed |= {least: worse} if worse else {}
        waiting.remove(least)
    return Confirmation(tuple(kept), {e: missed[e] for e in additions}, harmed)


def confirmation(state: SelectionState) -> Confirmation:
    near = partial(LeftOut.first_order, state)
    return backward_elimination(state.active, near, lambda e: LeftOut.refitted(truncated(state, e)), state.settings)
