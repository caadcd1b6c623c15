"""Extend the model by what earns its place, until nothing is left to add; what else explains a selected cause."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product

import numpy as np
from jaxtyping import Int

from bayes_aero.diagnosis.accuracy import addition_gain, implausible, largest_noise_bias, sizes, truncated
from bayes_aero.diagnosis.result import Absorbed, CancellingPair, Size
from bayes_aero.diagnosis.screening import (
    CandidateScore,
    PartialledRegression,
    RefitScore,
    ScreeningResult,
    SharedNoise,
    jackknife_errors,
    jackknife_p_value,
    log_bayes,
    noise_growth_of,
    null_scores,
    screen,
    uncertainty,
)
from bayes_aero.diagnosis.selection_state import (
    RegressionFit,
    SelectionState,
    constant_of,
    inverse,
    moved,
    refitted,
)
from bayes_aero.effect import Effect, Stage
from bayes_aero.inference.covariance import median_inflation, nats
from bayes_aero.parameter import Parameter
from bayes_aero.progress import Progress

OF_NOISE = 0.5  # largest share of an addition that noise may make: beyond, it would take over its regressor's own slope


@dataclass(frozen=True)
class SelectionStep:
    """One election: the screening, the chosen effect (None: nobody), its p-value, and its gain on folds left out."""

    chosen: str | None
    p_value: float
    screening: ScreeningResult
    unseen: float


@dataclass(frozen=True)
class Extension:
    """The state before and after additions, with fits and elections."""

    base: SelectionState
    base_fit: RegressionFit
    state: SelectionState
    fit: RegressionFit
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
        """Every `too_large` extension, the last first."""
        return () if self.too_large is None else (self.too_large, *self.too_large.larger)


Checked = Callable[[SelectionState, RegressionFit], tuple[SelectionState, RegressionFit]]


def forward_selection(
    state: SelectionState,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    most: int | None = None,
    checked: Checked = lambda state, fit: (state, fit),
    barred: Sequence[str] = (),
) -> Extension:
    """Add effects to `state` until none is both beyond chance and useful on data left out, and size them."""
    extension = selected(state, seed=seed, most=most, progress=progress, barred=barred)
    after, fit = checked(extension.state, extension.fit)
    return sized(replace(extension, state=after, fit=fit))


def plausible(
    select: Callable[[tuple[str, ...]], Extension],
    out: Callable[[Extension], Iterable[str]] = lambda extension: extension.implausible,
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


def plausible_selection(
    state: SelectionState, *, seed: int = 0, progress: Progress | None = None, most: int | None = None
) -> Extension:
    """`forward_selection` of what is no larger than aircraft have."""
    return plausible(lambda barred: forward_selection(state, seed=seed, progress=progress, most=most, barred=barred))


def selected(
    state: SelectionState,
    *,
    seed: int = 0,
    most: int | None = None,
    progress: Progress | None = None,
    barred: Sequence[str] = (),
) -> Extension:
    """Add at most `most` effects (default: the settings') that are not `barred`; p-values are family-wise."""
    most = state.settings.max_effects if most is None else most
    state, fit = refitted(state)
    inflations = [s.variance_inflation for s in screen(state, fit).candidate_scores]
    noise_growth, inflation = noise_growth_of(state, fit), median_inflation(np.array(inflations))
    state, fit = refitted(moved(replace(state, noise_growth=noise_growth, variance_inflation=inflation), state.theta))
    first, first_fit = state, fit
    steps: list[SelectionStep] = []
    noisy: tuple[str, ...] = ()
    for number in range(most + state.settings.candidates_tried):
        if len(state.active) - len(first.active) >= most:
            break
        if progress:
            progress("causes", len(state.active) / max(most, 1))
        winner, standing_in = None, ("",)
        while standing_in:
            step = _election(state, fit, seed + number, (*barred, *noisy), first=number == 0)
            winner = None if step.chosen is None else step.screening.of(step.chosen)
            standing_in = () if winner is None else _offsets_instead(state, fit, winner)
            if standing_in:
                state, fit = refitted(moved(state, state.theta, apart=(*state.apart, *standing_in)))
        steps.append(step)
        if winner is None:
            break
        wider, wider_fit = refitted(added(state, winner))
        if noise_shares(wider, wider_fit)[winner.effect] > OF_NOISE:
            noisy, steps[-1] = (*noisy, winner.effect), replace(step, chosen=None)
            continue
        state, fit = _reconsidered(wider, wider_fit, barred)
        noisy = ()  # with less left, noise can make less
    for name in state.apart:  # offsets between manoeuvres that explain nothing beside what was added after them
        fewer, less = refitted(moved(state, state.theta, apart=tuple(n for n in state.apart if n != name)))
        gained = nats(less.deviance - fit.deviance, state.variance_inflation) - len(state.folds) + 1
        if gained < state.settings.ambiguous:
            state, fit = fewer, less
    return Extension(first, first_fit, state, fit, tuple(steps))


def _offsets_instead(state: SelectionState, fit: RegressionFit, winner: CandidateScore) -> tuple[str, ...]:
    """Coefficients whose offsets between manoeuvres stand in for an addition."""
    # What differs between manoeuvres alone (a trim, a flap, the throttle) explains any offset that is left there. So an
    # addition must be identified within manoeuvres, with the same sign, and offsets must not be decisively better.
    if state.of_coefficients:
        moved_ones = np.any(state.S[:, :, np.array(winner.columns, int)] != 0.0, axis=(0, 2))
        reached = [n for n, moves in zip(state.outputs, moved_ones, strict=True) if moves]
    else:  # in flight all whose constant the card has; none along the flight path
        card = {p for e in state.full.base for p in state.full.parameters_of(e)} & set(state.full.model.names)
        coefficients = () if state.responses.kinematic else state.responses.model.coefficients
        reached = [n for n in coefficients if constant_of(n) in card]
    outputs = tuple(n for n in reached if n not in state.apart)
    count = len(state.responses.flights.lengths)
    if count == 1 or not outputs:
        return ()
    wider = moved(state, state.theta, apart=(*state.apart, *outputs))
    there = wider.fit()
    within = screen(wider, there).of(winner.effect)
    identified = within is not None and within.score >= state.settings.least_score and within.log_bayes > 0.0
    if within is None or not identified or float(np.dot(within.step, winner.step)) <= 0.0:
        return outputs
    better = nats(fit.deviance - there.deviance - winner.gain, winner.variance_inflation)
    return outputs if better - (count - 1) * len(outputs) > state.settings.decisive else ()


def sized(extension: Extension) -> Extension:
    """What was added, with sizes, and which of it are causes."""
    state, fit = extension.state, extension.fit
    names, errors = state.full.model.names, jackknife_errors(state, fit, state.responses.stretch)
    least = {names[c]: float(x) for c, x in zip(fit.columns, errors, strict=True) if c < len(names)}
    estimates = {name: replace(size, sd=max(size.sd, least[name])) for name, size in sizes(state, fit).items()}
    causes, minor = worth(state, fit, estimates)
    return replace(extension, sizes=estimates, causes=causes, minor=minor)


def noise_shares(state: SelectionState, fit: RegressionFit) -> dict[str, float]:
    """Largest share of each addition that noise of the recorded channels can make, by effect."""
    # Noise in a regressor makes of whatever moves with it a second recording of the same.
    bias, away = largest_noise_bias(state, fit), dict(zip(state.full.model.names, state.departure, strict=True))
    shares = {}
    for effect in state.active:
        names = [n for n in state.full.parameters_of(effect) if n in bias]
        made = [abs(bias[n][int(away[n] > 0.0)]) / max(abs(away[n]), 1e-300) for n in names]
        shares[effect] = float(min(1.0, *made)) if made else 0.0
    return shares


def _election(
    state: SelectionState, fit: RegressionFit, seed: int, barred: Sequence[str], first: bool
) -> SelectionStep:
    """The most explaining candidate, not `barred`, that is beyond chance, matters, and predicts folds left out."""
    settings = state.settings
    noise = SharedNoise(seed, state.folds, len(state.outputs), settings)
    screening = screen(state, fit, seed=seed, nulls=first, noise=noise)
    able: list[tuple[CandidateScore, float]] = []
    seen = set(barred)
    for standing in screening.candidate_scores:
        if standing.effect in seen:
            continue
        seen.add(standing.effect)
        if len(seen) > settings.candidates_tried + len(barred):
            break
        if explained(state, standing) < state.least_share(settings.least_share) or mixes_noise(state, standing):
            continue
        gain = addition_gain(state, state.wider(standing.columns))
        if not gain > 0.0:
            continue
        able.append((standing, gain))
        if standing.score < settings.least_score or standing.log_bayes <= 0.0:
            continue
        if not len(screening.nulls):
            projected = PartialledRegression(state, fit, [b[1] for b in state.blocks if b[0] not in state.active])
            screening = replace(screening, nulls=null_scores(state, fit, projected, screening.colour, noise))
        p = screening.p_value(standing.score)
        if p <= settings.false_alarm_rate:
            return SelectionStep(standing.effect, p, screening, gain)
    if state.responses.freedom:  # no stationary colour holds, with a leader in or out
        for standing, gain in able[: settings.candidates_refitted]:
            wider = refitted(added(state, standing))
            p = between_p_value(*wider, standing.effect, len(screening.candidate_scores))
            if p <= settings.refit_false_alarm_rate:
                return SelectionStep(standing.effect, p, screening, gain)
        able = []
    for standing, gain in able:
        look = RefitScore(state, standing, noise)
        if look.score < settings.least_score or look.log_bayes <= 0.0:
            continue
        if (p := look.p_value()) <= settings.false_alarm_rate:
            return SelectionStep(standing.effect, p, screening, gain)
    highest = max((s.score for s in screening.candidate_scores if s.effect not in barred), default=0.0)
    p = screening.p_value(highest) if len(screening.nulls) else math.nan
    return SelectionStep(None, p, screening, math.nan)


def between_p_value(wider: SelectionState, fit: RegressionFit, effect: str, among: int) -> float:
    """p-value of an addition by how far it moves without each stretch, Bonferroni over `among` candidates."""
    # It is in, and all is fitted again: a large effect that is out bends the first-order residuals, and the stretches
    # then seem to disagree more than they do.
    columns = wider.full.own_columns(effect)
    if not np.all(np.isin(columns, fit.columns)):
        return 1.0
    return jackknife_p_value(wider, fit, columns, wider.departure[columns], among)


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
    """The state with a candidate in, its parameters at their first-order estimate (or the scanned value)."""
    theta = state.theta.copy()
    at = state.full.own_columns(winner.effect)
    if winner.value is not None:
        scan = next(s for s in state.scans if s.effect == winner.effect and s.value == winner.value)
        theta[state.full.columns([scan.parameter])[0]] = winner.value
    else:
        bounds = np.array([state.full.model.free[i].bounds for i in at])
        theta[at] = np.clip(theta[at] + np.array(winner.step), bounds[:, 0], bounds[:, 1])
    return moved(state, theta, (*state.active, winner.effect))


def removed(state: SelectionState, effect: str) -> SelectionState:
    return truncated(state, [e for e in state.active if e != effect])


def _reconsidered(
    state: SelectionState, fit: RegressionFit, barred: Sequence[str]
) -> tuple[SelectionState, RegressionFit]:
    """Look at each earlier addition again: drop it if it is superfluous by now, exchange it if it was a proxy."""
    least = state.least_share(state.settings.least_share)
    for effect in state.active[:-1]:
        ranking = screen(state, fit, without=effect)
        own = ranking.of(effect)
        able = (s for s in ranking.candidate_scores if s.effect not in barred and not mixes_noise(state, s))
        best = next(able, ranking.candidate_scores[0])
        faint = own is not None and own.log_bayes < 0.0 and _bayes_within(state, fit, own) < 0.0
        if own is None or faint or explained(state, own) < least or mixes_noise(state, own):
            state, fit = refitted(removed(state, effect))
        elif best.effect != effect:
            more = best.gain - (1.0 + state.settings.exchange_margin) * own.gain
            if nats(more, best.variance_inflation_apart) > 1.0:
                other, other_fit = refitted(added(removed(state, effect), best))
                if noise_shares(other, other_fit)[best.effect] <= OF_NOISE:
                    state, fit = other, other_fit
    return state, fit


def _bayes_within(state: SelectionState, fit: RegressionFit, own: CandidateScore) -> float:
    """Log Bayes factor of an addition under the colour that is left with it in."""
    columns = state.full.own_columns(own.effect)
    away = state.departure[columns]
    if not (np.all(np.isfinite(away)) and np.all(np.isin(columns, fit.columns))):
        return own.log_bayes
    at = fit.places(columns)
    covariance = uncertainty(state, fit)[np.ix_(at, at)]
    return log_bayes(away, covariance, state.mean[columns] + away, state.precision[columns] / state.variance_inflation)


def worth(
    state: SelectionState, fit: RegressionFit, estimates: Mapping[str, Size]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Additions large enough to be worth modelling, and nuisances: small, uncertain, or perhaps noise."""
    added = {e.name: e for e in state.full.candidates if e.name in state.active}

    def least_away(parameter: Parameter, bias: tuple[float, float]) -> tuple[float, float]:
        """How far a parameter is from neutral with whichever bias brings it nearest, and its deviation."""
        size = estimates[parameter.name]
        ends = [parameter.away(size.mean - b, size.sd) for b in (*bias, 0.0)]
        passes = min(away for away, _ in ends) * max(away for away, _ in ends) <= 0.0
        nearest = min(ends, key=lambda end: abs(end[0]))
        return (0.0, nearest[1]) if passes else nearest

    def large_ones(bias: Mapping[str, tuple[float, float]]) -> list[str]:
        chosen = []
        for name in state.active:
            sized = [p for p in added[name].parameters if p.name in added[name].sizes and p.name in estimates]
            away = {p.name: least_away(p, bias.get(p.name, (0.0, 0.0))) for p in sized}
            if large(added[name], away, state.settings.least_score):
                chosen.append(name)
        return chosen

    causes = large_ones(largest_noise_bias(state, fit)) if large_ones({}) else []
    return tuple(causes), tuple(name for name in state.active if name not in causes)


def large(effect: Effect, away: Mapping[str, tuple[float, float]], least_score: float) -> bool:
    """Whether any parameter of an effect is as far from neutral (`away`) as is worth a name, and beyond its error."""
    rows = [(abs(size), sd, effect.sizes[p][0]) for p, (size, sd) in away.items()]
    return not rows or any(size + sd >= least and size >= least_score * sd for size, sd, least in rows)


def nats_gained(old: Extension, new: Extension) -> float:
    """Log likelihood that another extension gains, the colour counted, less what the choice of each addition costs."""

    def deviance(state: SelectionState, fit: RegressionFit) -> float:
        return fit.deviance + 2.0 * float(np.sum(np.log(state.noise_growth[state.inside])))

    additions = len(new.state.active) - len(old.state.active)
    gained = deviance(old.state, old.fit) - deviance(new.state, new.fit)
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
    state, fit, parameters = extension.state, extension.fit, []
    if not state.of_coefficients:
        return ()
    for effect in (e for e in state.full.model.effects if e.name in state.full.base):
        controls = [c for c in effect.channels if c in CONTROLS]
        free = [p for p in effect.parameters if p.name in state.full.model.names and len(controls) == 1]
        for parameter, column in ((p, int(state.full.columns([p.name])[0])) for p in free):
            S = state.S[state.inside][:, :, column]  # what it acts through stays in all manoeuvres, and not at zero
            square, moved = float(np.sum(S**2)), float(np.sum((S - S.mean(axis=0)) ** 2))
            at_rest = square > 0.0 and moved < AT_REST**2 * square
            if column in fit.columns and at_rest and (sizes := _taken_up(extension, column)):
                name, usual = parameter.name, state.full.priors.get(parameter.name, parameter.prior).normal
                estimate = float(state.theta[column]), extension.sizes[name].sd
                parameters.append(Absorbed(effect.name, name, parameter.unit, controls[0], estimate, usual, sizes))
    return tuple(parameters)


def _taken_up(extension: Extension, column: int) -> dict[str, Size]:
    """Sizes of the candidates that the parameter of a column hides, by name."""
    state, fit = extension.state, extension.fit
    fewer, hidden = fit.columns[fit.columns != column], {}

    def deviations(at: int, size: float, columns: Int[np.ndarray, " k"]) -> float:
        """By how many an effect of this size is seen, `columns` free within their priors."""
        A, weight = state.scaled[state.inside][:, :, columns], 1.0 / fit.variance
        signal = size * state.scaled[state.inside][:, :, at]
        normal = np.einsum("mci,c,mcj->ij", A, weight, A, optimize=True) + np.diag(state.precision[columns])
        right = np.einsum("mci,c,mc->i", A, weight, signal, optimize=True)
        information = float(np.einsum("mc,c,mc->", signal, weight, signal) - right @ inverse(normal) @ right)
        return float(np.sqrt(max(information, 0.0) / state.variance_inflation))

    scanned = {scan.effect for scan in state.scans}
    for effect in state.full.candidates:  # those of one parameter, with a slope at neutral, and a size worth a name
        if len(effect.parameters) != 1 or effect.name in (*state.active, *scanned):
            continue
        (parameter,) = effect.parameters
        if parameter.name not in effect.sizes:
            continue
        (at,) = state.full.own_columns(effect.name)
        least, largest = effect.sizes[parameter.name]
        if not deviations(at, least, fit.columns) < state.settings.least_score <= deviations(at, least, fewer):
            continue
        mean, sd = _size(extension, column, int(at), fewer)
        if least <= abs(mean) <= largest:
            hidden[effect.name] = Size(mean, sd, parameter.unit)
    return hidden


def _size(extension: Extension, column: int, at: int, fewer: Int[np.ndarray, " k"]) -> tuple[float, float]:
    """Size of a candidate and its deviation, the parameter of `column` held where its prior has it."""
    state, columns = extension.state, np.append(fewer, at)
    away = float(state.mean[column])
    products = state.products.shifted(np.array([column]), np.array([away]))
    fit = products.fit(columns, state.mean, state.precision, held=extension.fit.variance)
    here = state.products.fit(columns, state.mean, state.precision, held=extension.fit.variance)
    slope = (fit.step[-1] - here.step[-1]) / away if away else 0.0
    variance = inverse(fit.normal)[-1, -1] + slope**2 / state.precision[column]
    return float(fit.step[-1]), float(np.sqrt(state.variance_inflation * variance))


# --- Two named terms that cancel: what the record knows of them is one combination, not either.
# Pitch rate and the rate of the angle of attack move together in most manoeuvres. A fit then sets a large term
# against another large one; neither is measured. The combination of the two with the least variance is.


def cancelling(extension: Extension, causes: Sequence[str]) -> tuple[CancellingPair, ...]:
    """Pairs of causes whose contributions cancel, each with its combination of least variance."""
    state, pairs = extension.state, []
    for effects, names, C in _correlated_parameters(extension, causes):
        i, j = map(int, state.full.columns(names))
        weight = 1.0 / np.mean(state.residual[state.inside] ** 2, axis=0)
        moved = [state.scaled[state.inside][:, :, c] * state.departure[c] for c in (i, j)]
        moved = [x - x.mean(axis=0) for x in moved]
        one, other, both = (float(np.sum(weight * x**2)) for x in (*moved, moved[0] + moved[1]))
        if both >= min(one, other):  # what they do to the outputs, means aside, is less together than either alone
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
    """Additions whose estimates are correlated, each with its partners and the correlation: no size holds alone."""
    partners: dict[str, dict[str, float]] = {}
    for (one, other), _, C in _correlated_parameters(extension, effects):
        partners.setdefault(one, {})[other] = partners.setdefault(other, {})[one] = _correlation(C)
    return partners


def without_hold(extension: Extension) -> dict[str, Mapping[str, float]]:
    """Additions that are no error by themselves: too large, at a bound, or estimated together with such a one."""
    state, joint = extension.state, correlated(extension, extension.state.active)
    out = {n for n in state.active if any(extension.sizes[p].at_bound for p in state.full.parameters_of(n))}
    out |= set(extension.implausible)
    return {n: joint.get(n, {}) for n in state.active if n in out or out & set(joint.get(n, {}))}


def _correlated_parameters(
    extension: Extension, effects: Sequence[str]
) -> Iterator[tuple[tuple[str, str], tuple[str, str], np.ndarray]]:
    """Pairs of effects, one parameter of each, and the covariance of these two where they are correlated."""
    state, fit = extension.state, extension.fit
    if len(effects) < 2:
        return
    covariance = uncertainty(state, fit)
    at = {int(c): k for k, c in enumerate(fit.columns)}
    for one, other in combinations(effects, 2):
        for a, b in product(state.full.parameters_of(one), state.full.parameters_of(other)):
            places = [at[c] for c in map(int, state.full.columns([a, b])) if c in at]
            C = covariance[np.ix_(places, places)]
            if len(places) == 2 and abs(_correlation(C)) > state.settings.correlated:
                yield (one, other), (a, b), C


def _correlation(C: np.ndarray) -> float:
    return float(C[0, 1] / np.sqrt(C[0, 0] * C[1, 1]))
