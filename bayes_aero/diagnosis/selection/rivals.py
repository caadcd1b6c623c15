"""What else explains a cause: constants, collinear effects, and errors of sensors that a record leaves undecided.

A rudder that is held aside makes a yawing moment that stays, as uneven engines do. Where it does not move, its
derivative is known from that constant alone. It takes up what else is constant, and the selection finds nothing. The
record then does not decide between an unusual derivative and the other cause.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.screening.parameter_fit import refitted
from bayes_aero.diagnosis.screening.regression import TINY, RegressionFit, inverse, partialled
from bayes_aero.diagnosis.screening.screening import uncertainty
from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved
from bayes_aero.diagnosis.selection.forward_selection import Extension, explained
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.effect import Effect
from bayes_aero.flight.health.finding import OpenError
from bayes_aero.inference.covariance import nats

CONTROLS = (
    "elevator", "stabilizer", "canard", "flap", "spoiler", "dlc", "aileron", "rudder", "spoiler_left", "spoiler_right",
)  # fmt: skip
AT_REST = 0.1  # of a sensitivity's root mean square, its deviation within the manoeuvres; our choice


@dataclass(frozen=True)
class Absorbed:
    """A `parameter` of the card's `effect` that acts through a `control` at rest, and what it may have taken up."""

    effect: str
    parameter: str
    unit: str
    control: str
    estimate: tuple[float, float]  # its value in the fit, with its deviation
    usual: tuple[float, float]  # that of its prior
    # By effect, how large each would be, were it the whole cause and the parameter as usual, with a deviation that
    # knows the prior's width.
    sizes: dict[str, Size]

    @property
    def members(self) -> frozenset[str]:
        """The effects among which the record does not decide, the card's own included."""
        return frozenset((self.effect, *self.sizes))


def absorbed(found: Extension) -> tuple[Absorbed, ...]:
    """Parameters of the card that may have taken up an effect that is large enough for a name.

    Such an effect is beyond `least_score` deviations at the least size worth modelling if the parameter is held, and
    below if it is free within its prior; and it would be of a size that aircraft have, and worth a name, were the
    parameter as usual.
    """
    state, fit, told = found.state, found.fit, []
    if state.outputs != state.responses.model.coefficients:
        return ()

    def at_rest(column: int) -> bool:
        """Whether what a parameter acts through stays where it is in all manoeuvres together, and not at zero."""
        S = state.S[state.inside][:, :, column]
        square = float(np.sum(S**2))
        return square > 0.0 and float(np.sum((S - S.mean(axis=0)) ** 2)) < AT_REST**2 * square

    for effect in (e for e in state.full.model.effects if e.name in state.full.base):
        controls = [c for c in effect.channels if c in CONTROLS]
        for parameter in effect.parameters if len(controls) == 1 else ():
            name, unit = parameter.name, parameter.unit
            if name not in state.full.model.names:
                continue
            column = int(state.full.columns([name])[0])
            if column not in fit.columns or not at_rest(column):
                continue
            if sizes := _taken_up(found, column):
                prior = state.full.priors.get(name, parameter.prior)
                estimate = float(state.theta[column]), found.sizes[name].sd
                told.append(Absorbed(effect.name, name, unit, controls[0], estimate, prior.normal, sizes))
    return tuple(told)


def _taken_up(found: Extension, column: int) -> dict[str, Size]:
    """Sizes of the candidates that the parameter of a column hides, by name."""
    state, fit = found.state, found.fit
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
        mean, sd = _size(found, column, int(at), fewer)
        if least <= abs(mean) <= largest:
            hidden[effect.name] = Size(mean, sd, parameter.unit)
    return hidden


def _size(found: Extension, column: int, at: int, fewer: Int[np.ndarray, " k"]) -> tuple[float, float]:
    """Size of a candidate and its deviation, the parameter of `column` held where its prior has it."""
    state, columns = found.state, np.append(fewer, at)
    away = float(state.mean[column])
    products = state.products.shifted(np.array([column]), np.array([away]))
    fit = products.fit(columns, state.mean, state.precision, held=found.fit.variance)
    here = state.products.fit(columns, state.mean, state.precision, held=found.fit.variance)
    slope = (fit.step[-1] - here.step[-1]) / away if away else 0.0
    variance = inverse(fit.normal)[-1, -1] + slope**2 / state.precision[column]
    return float(fit.step[-1]), float(np.sqrt(state.variance_inflation * variance))


# --- Two named terms that cancel: what the record knows of them is one combination, not either.
# Pitch rate and the rate of the angle of attack move together in most manoeuvres. A fit then sets a large term
# against another large one; neither is measured. The combination of the two with the least variance is.


@dataclass(frozen=True)
class CancellingPair:
    """The combination `parameters[0] + factor parameters[1]` of two effects' departures from neutral, SI."""

    effects: tuple[str, str]
    parameters: tuple[str, str]
    factor: float
    mean: float
    sd: float
    unit: str
    correlation: float  # of the two estimates


def cancelling(extension: Extension, causes: Sequence[str]) -> tuple[CancellingPair, ...]:
    """Pairs of the named causes whose estimates are correlated and whose contributions cancel, each with its
    combination of least variance; a sum or a difference where that is nearly it."""
    state, found = extension.state, []
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
        found.append(CancellingPair(effects, names, factor, mean, sd, units[0], _correlation(C)))
    return tuple(found)


def correlated(extension: Extension, effects: Sequence[str]) -> dict[str, dict[str, float]]:
    """Additions whose estimates are correlated, each with its partners and the correlation: no size holds alone."""
    found: dict[str, dict[str, float]] = {}
    for (one, other), _, C in _correlated_parameters(extension, effects):
        found.setdefault(one, {})[other] = found.setdefault(other, {})[one] = _correlation(C)
    return found


def without_hold(found: Extension) -> dict[str, Mapping[str, float]]:
    """Additions that are no error by themselves: larger than aircraft have, at a parameter bound, or estimated together
    with such a one; each with its partners and the correlation."""
    state, joint = found.state, correlated(found, found.state.active)
    out = {n for n in state.active if any(found.sizes[p].at_bound for p in state.full.parameters_of(n))}
    out |= set(found.implausible)
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


# --- What the flight path cannot decide about errors of sensors: those it asks for in vain, and those that others
# imitate.
# An offset of the pitch attitude turns gravity in the body axes. Accelerometers that are off by as much as that look
# the same, so without another measurement (the altitude, a calm wind) the record knows the sum of both and neither
# of them.


def open_errors(found: Extension) -> tuple[OpenError, ...]:
    """Each error of one parameter that is asked for and not confirmed, or imitated by others; the former first.

    One that was added and is beyond absence, estimated with all others, is decided.

    Args:
        found: the search along the flight path, ended by `widened`.
    """
    state, settings = found.state, found.state.settings
    effects, columns, gram, right = _information_of_errors(state, found.fit)
    # Priors weigh against a white likelihood as against the coloured one: see `SelectionState.variance_inflation`.
    covariance = inverse(gram + np.diag(state.precision[columns]))
    among = np.sqrt(state.variance_inflation * np.diag(covariance))
    jointly = covariance @ (right + gram @ state.departure[columns])
    screening = found.steps[-1].screening
    told = []
    for place, effect in enumerate(effects):
        parameter = effect.parameters[0]
        least, _ = effect.sizes[parameter.name]
        standing = None if effect.name in state.active else screening.of(effect.name)
        if standing is None:
            mean, sd, asked = found.sizes[parameter.name].mean, found.sizes[parameter.name].sd, False
        else:  # were it the only one; and whether one worth a name would explain much of what is left if confirmed
            mean, sd = float(standing.step[0]), float(standing.sd[0])
            clear = standing.score >= settings.least_score and standing.log_bayes > 0.0 and abs(mean) >= least
            asked = clear and explained(state, standing) >= settings.open_share
        wide = max(sd, float(among[place]))
        there = max(least, abs(mean)) if standing is None else least
        imitators, share = next(
            (one for one in _nearest(gram, effects, place, settings, there) if one[1] >= settings.imitated), ((), 0.0)
        )
        decided = standing is None and abs(jointly[place]) >= settings.least_score * wide
        if decided or settings.least_score * wide < least:  # nobody hides an error that is worth a name
            imitators, share = (), 0.0
        if asked or imitators:
            told.append(OpenError(effect.name, parameter.unit, mean, sd, wide, asked, imitators, share))
    rank = {standing.effect: k for k, standing in reversed(list(enumerate(screening.candidate_scores)))}
    return tuple(sorted(told, key=lambda e: (not e.asked, rank.get(e.name, len(rank)))))


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
    """The state with an addition exchanged for several errors that together do nearly the same, where these explain the
    record decisively better.

    Offset and scale of an airspeed come one by one. Neither gains what an offset of its pitot pressure does.
    """
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
