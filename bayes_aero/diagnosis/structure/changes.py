"""A parameter of the model that takes another value during the records: is there one beyond chance, and where.

The largest gain over all parameters and moments is compared with that in noise-only replicates, which make the same
choice. Then the change must explain enough and predict parts of the manoeuvres that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.candidate_set import moves, noise_channels
from bayes_aero.diagnosis.result import ParameterChange
from bayes_aero.diagnosis.screening.accuracy import recording_noise
from bayes_aero.diagnosis.screening.autocorrelation import (
    Autocorrelation,
    SharedNoise,
    autocorrelation_of,
    autocorrelations_of,
    unbiased,
)
from bayes_aero.diagnosis.screening.parameter_fit import inflation_along, optimum
from bayes_aero.diagnosis.screening.regression import Fit, Products, inverse
from bayes_aero.diagnosis.screening.screening import ScreeningResult, explained_shares, uncertainty, without_active
from bayes_aero.diagnosis.screening.selection_state import TINY, Component, SelectionState, manoeuvre_constants, moved
from bayes_aero.diagnosis.selection.holdout import holdout_deviance_gain
from bayes_aero.diagnosis.terms.columns import columns_of
from bayes_aero.effect import Kind, Stage
from bayes_aero.inference.covariance import ORDER, nats
from bayes_aero.physics.coefficient_names import LATERAL


@dataclass(frozen=True)
class Change:
    """The change of the parameter in `column` over a span: what it adds, of which a step of one is `unit`; `at` is its
    place in the scan (span, parameter) that found it."""

    column: int
    span: Span
    component: Component
    unit: float
    at: tuple[int, int]


@dataclass(frozen=True)
class Sought:
    """A change that is beyond chance, with what it was judged by.

    `gain` is the deviance that it takes away, `gained` that of the parts left out.
    """

    change: Change
    state: SelectionState
    scan: ChangeScan
    residual: Float[np.ndarray, "m c"]
    folds: tuple[slice, ...]
    colour: Autocorrelation
    share: float
    p_value: float
    gain: float
    gained: float


def sought_change(
    state: SelectionState, chosen: Sequence[Component], *, seed: int, least: float = 0.0
) -> Sought | None:
    """The change that explains most of what the active effects and the `chosen` components leave, if it is real.

    It must gain more than `least` deviance on parts left out. Without it the other parameters were fitted to both
    values of the changed one, so the problem is linearised again where they are with the change beside them.
    """
    settings, alone = state.settings, len(state.responses.flights.lengths) == 1
    first = _promising(state, chosen, least) if testable(state) else None
    if first is None:
        return None
    state = _beside(state, [*chosen, first[0].component])
    folds = manoeuvres(state)
    whole = with_components(state, (), chosen, folds)
    columns, over, noise = first[1].columns, first[1].over, first[1].noise
    _, wider = fit_with(state, first[0].component, chosen, folds)
    # Under the variances that it leaves: what it explains itself would pass for noise of its coefficient.
    held = whole.products.fit(whole.columns(), whole.mean, whole.precision, held=wider.variance)
    scan, residual = ChangeScan(whole, held, columns, over, noise), whole.left(held)
    change = _change(state, scan, _leader(scan, scan.estimates(residual))[0])
    trial, wider = fit_with(state, change.component, chosen, folds)
    share, gained = share_of(trial, trial.component_columns[0]), holdout_gain_of(state, change.component, chosen)
    if share < (settings.single_share if alone else settings.change_share) or gained <= least:
        return None
    if _by_noise(trial, wider, change, scan):
        return None
    colour, p = _p_value(whole, held, scan, trial.left(wider), seed)
    if p > settings.change_false_alarm_rate:
        return None
    gain = whole.fit().deviance - wider.deviance
    return Sought(change, state, scan, residual, folds, colour, share, p, gain, gained)


def testable(state: SelectionState) -> bool:
    """Whether the state is of coefficients that are modelled, and every manoeuvre long enough to be divided."""
    parts = parts_of(state, state.settings.change_parts)
    long = all(part.stop - part.start > ORDER for part in parts)
    return state.outputs == state.responses.model.coefficients and long and bool(len(_free(state)) and _over(state))


def _promising(state: SelectionState, chosen: Sequence[Component], least: float) -> tuple[Change, ChangeScan] | None:
    """The change that explains most to first order, if that is worth another look."""
    folds = manoeuvres(state)
    whole = state if not chosen and folds == state.folds else with_components(state, (), chosen, folds)
    fit = whole.fit()
    columns = _free(state)
    scan = ChangeScan(whole, fit, columns, _over(state), _noise(state, columns))
    leader, gain = _leader(scan, scan.estimates(whole.left(fit)))
    if gain < state.settings.least_share * len(state.residual):
        return None
    change = _change(state, scan, leader)
    return (change, scan) if holdout_gain_of(state, change.component, chosen) > least else None


def _noise(state: SelectionState, columns: Int[np.ndarray, " p"], seed: int = 0) -> Float[np.ndarray, "m c p"]:
    """What noise of the recorded size adds to the sensitivities to these parameters, scaled as those are.

    Added once more it adds as much as the noise that is there already, as in `accuracy.noise_effect`.
    """
    flights, rng = state.responses.flights, np.random.default_rng(seed)
    added = {n: sd * rng.standard_normal(flights.n) for n, sd in recording_noise(flights).items()}
    noisy = flights.channels | {name: flights.channels[name] + x for name, x in added.items()}
    slopes = state.responses.with_channels(noisy).linearise(state.theta, columns)[1]
    keep = [state.responses.outputs.index(name) for name in state.outputs]
    return slopes[:, keep] / state.noise_growth[:, :, None] - state.scaled[:, :, columns]


def _by_noise(state: SelectionState, fit: Fit, change: Change, scan: ChangeScan) -> bool:
    """Whether one value, made too small by noise on either side of the change, explains it.

    To first order a share s of noise takes s of a value away; what lies between a value and that with twice as much
    given back may be its truth.
    """
    at = int(np.flatnonzero(fit.columns == change.column)[0])
    elsewhere = float(state.theta[change.column] + fit.step[at])
    values = elsewhere + change.unit * float(fit.step[-1]), elsewhere
    shares = scan.noise_shares[:, change.at[0], change.at[1]]
    least, most = np.sort([np.array([x, x / max(1.0 - 2.0 * s, TINY)]) for x, s in zip(values, shares, strict=True)]).T
    return bool(np.max(least) <= np.min(most))


def _beside(state: SelectionState, components: Sequence[Component]) -> SelectionState:
    """The state at the optimum of all active parameters, these components free beside them."""
    place = len(state.theta) + state.nuisance
    columns = np.concatenate([c.basis for c in components], axis=2)
    S = np.concatenate([state.S[:, :, :place], columns, state.S[:, :, place:]], axis=2)
    mean, precision = (np.insert(x, [place] * columns.shape[2], 0.0) for x in (state.mean, state.precision))
    nuisance = state.nuisance + columns.shape[2]
    wide = replace(state, S=S, mean=mean, precision=precision, nuisance=nuisance)
    return moved(state, optimum(wide, range(len(state.folds))))


def holdout_gain_of(state: SelectionState, component: Component, chosen: Sequence[Component]) -> float:
    """Deviance that a component gains on parts of the manoeuvres that were left out, each predicted from the others."""
    trial = with_components(state, (component,), chosen, parts_of(state, state.settings.change_parts))
    return holdout_deviance_gain(trial, np.concatenate([trial.columns(), trial.component_columns[0]]))


def fit_with(
    state: SelectionState, component: Component, chosen: Sequence[Component], folds: Sequence[slice]
) -> tuple[SelectionState, Fit]:
    """A state in which one component is the candidate, and the fit with it in."""
    trial = with_components(state, (component,), chosen, folds)
    wide = np.concatenate([trial.columns(), trial.component_columns[0]])
    return trial, trial.products.fit(wide, trial.mean, trial.precision)


def manoeuvres(state: SelectionState) -> tuple[slice, ...]:
    """The blocks of each manoeuvre."""
    edges = np.flatnonzero(np.diff(state.responses.manoeuvre, prepend=-1, append=-1))
    return tuple(slice(int(a), int(b)) for a, b in pairwise(edges))


def _free(state: SelectionState) -> Int[np.ndarray, " p"]:
    """Columns of the aerodynamic parameters that are free in the model."""
    owners = {p: e for e in state.full.model.effects for p in state.full.parameters_of(e.name)}
    found = []
    for column in state.columns():
        if column < len(state.theta):
            owner = owners[state.full.model.names[column]]
            if owner.kind is Kind.AERODYNAMICS and owner.stage > Stage.INFLOW:
                found.append(column)
    return np.array(found, int)


def _over(state: SelectionState) -> list[Span]:
    least = max(1, round(state.settings.change_least / state.responses.seconds))
    return spans(state.responses.manoeuvre, least, state.settings.change_begins)


def _leader(scan: ChangeScan, estimates: Float[np.ndarray, "n p"]) -> tuple[tuple[int, int], float]:
    """The change that takes most deviance away, and how much."""
    gains = scan.gains(estimates)
    span, parameter = np.unravel_index(int(np.argmax(gains)), gains.shape)
    return (int(span), int(parameter)), float(gains[span, parameter])


def _change(state: SelectionState, scan: ChangeScan, at: tuple[int, int]) -> Change:
    span, column = scan.over[at[0]], int(scan.columns[at[1]])
    basis = np.zeros((*state.residual.shape, 1))
    basis[span.begin : span.end, :, 0] = state.S[span.begin : span.end, :, column]
    unit = 1.0 / float(np.sqrt(np.max(np.mean(basis**2, axis=0))))
    label = f"{state.full.model.names[column]} from block {span.begin}"
    return Change(column, span, Component(label, unit * basis), unit, at)


def _p_value(
    state: SelectionState, fit: Fit, scan: ChangeScan, left: Float[np.ndarray, "m c"], seed: int
) -> tuple[Autocorrelation, float]:
    """The colour of the noise that is `left` with the change in, and how often noise alone shows as much of one.

    What was chosen as the best of many makes the noise look faster than it is; replicates measure by how much.
    """
    noise = SharedNoise(seed, state.folds, left.shape[1], state.settings)

    def drawn(colour: Autocorrelation, white: Float[np.ndarray, "t f r c"]) -> Float[np.ndarray, "r m c"]:
        return without_active(state, fit, colour.coloured(white, state.folds, len(state.residual)))

    def without_leader(residual: Float[np.ndarray, "m c"]) -> Float[np.ndarray, "m c"]:
        estimates = scan.estimates(residual)
        leader, _ = _leader(scan, estimates)
        return residual - scan.explained(*leader, float(estimates[leader]))

    def statistic(residual: Float[np.ndarray, "m c"]) -> float:
        """Deviance that the leader takes away over what it leaves."""
        gain = _leader(scan, scan.estimates(residual))[1]
        return gain / (float(np.sum(residual**2 * scan.weight)) - gain)

    found = autocorrelation_of(left, state.folds)
    again = np.array([without_leader(one) for one in drawn(found, noise.correction)])
    colour = unbiased(found, autocorrelations_of(again, state.folds))
    nulls = np.array([statistic(one) for one in drawn(colour, noise.replicates)])
    return colour, float((1 + np.sum(nulls >= statistic(state.left(fit)))) / (1 + len(nulls)))


# --- Every moment at which a parameter may take another value, all parameters at once, from cumulated products.
# The direction of a change is the parameter's sensitivity from that moment on, the free parameters of the model
# projected out. Inner products of such directions are differences of sums over time, so a record of minutes costs
# milliseconds.
# What a parameter acts through is recorded with noise, which makes its value too small: where a slope is attenuated
# by noise alone, the parameter has not changed.

NOTHING = 1e-9  # of the information of the whole parameter, below which a change of it moves nothing
NOISY = 0.5  # share of noise beyond which a value is that of noise


class Span(NamedTuple):
    """Blocks over which a parameter has another value, [begin, end); `manoeuvre` is the number of that of the first."""

    manoeuvre: int
    begin: int
    end: int


def spans(manoeuvre: Int[np.ndarray, " m"], least: int, most: int) -> list[Span]:
    """From a block on, to the end of its manoeuvre or of all later ones; between manoeuvres, from the begin of a later
    one on, or in one of the middle alone.

    `least` blocks at either end of a manoeuvre are not divided; about `most` begins are tried. The records may be of
    one flight, where a change lasts, or of several, where it does not.
    """
    count, m = int(manoeuvre[-1]) + 1, len(manoeuvre)
    found = []
    for k in range(count):
        own = np.flatnonzero(manoeuvre == k)
        first, last = int(own[0]), int(own[-1]) + 1
        begins = [*([first] if k else []), *range(first + least, last - least + 1, -(-m // most))]
        ends = {m} if k == count - 1 else {last, m}
        found += [Span(k, begin, end) for begin in begins for end in sorted(ends)]
    return found


class ChangeScan:
    """Directions of the changes of p parameters (`columns` of the state) over each of n spans.

    `noise` is what recording noise adds to the sensitivities to the p parameters, scaled as those are.
    """

    def __init__(
        self,
        state: SelectionState,
        fit: Fit,
        columns: Int[np.ndarray, " p"],
        over: Sequence[Span],
        noise: Float[np.ndarray, "m c p"],
    ) -> None:
        self.columns, self.over, self.noise, self.weight = columns, over, noise, 1.0 / fit.variance
        self._S, self._B = state.scaled[:, :, columns], state.scaled[:, :, fit.columns]
        self._begin, self._end = (np.array([getattr(span, side) for span in over]) for side in ("begin", "end"))
        self._weighed = self._S * self.weight[:, None]
        own = self._summed(np.sum(self._S * self._weighed, axis=1))
        cross = self._summed(np.matmul(np.moveaxis(self._weighed, 1, 2), self._B))
        self._shares = cross @ inverse(fit.normal)  # n p k
        information = own - np.sum(self._shares * cross, axis=2)
        whole = np.sum(self._S * self._weighed, axis=(0, 1))
        self.noise_shares = self._noise_shares(fit, own, cross)
        noisy = np.any(self.noise_shares > NOISY, axis=0)
        self._idle = noisy | (information <= NOTHING * whole)  # what the model can do as well
        self.information = np.where(self._idle, 1.0, information)

    def _noise_shares(
        self, fit: Fit, own: Float[np.ndarray, "n p"], cross: Float[np.ndarray, "n p k"]
    ) -> Float[np.ndarray, "2 n p"]:
        """Share of noise in what tells the value of each parameter within each span, and in what tells it elsewhere.

        By it least squares makes that value too small. All other parameters have one value, fitted beside both.
        """
        added = np.einsum("mcp,c->mp", self.noise**2, self.weight)
        within = self._summed(added)
        noise = np.stack([within, np.sum(added, axis=0) - within])
        whole = np.sum(self._S * self._weighed, axis=(0, 1))
        shared, found = inverse(fit.normal), np.zeros_like(noise)
        for p, column in enumerate(self.columns):
            at = int(np.flatnonzero(fit.columns == column)[0])
            others = shared - np.outer(shared[:, at], shared[at]) / shared[at, at]  # without the parameter itself
            total = np.einsum("mc,mck->k", self._weighed[:, :, p], self._B)
            inside, outside = cross[:, p], total - cross[:, p]
            a, b = own[:, p] - _form(inside, others, inside), whole[p] - own[:, p] - _form(outside, others, outside)
            c = -_form(inside, others, outside)
            told = np.stack([a - c**2 / np.maximum(b, TINY), b - c**2 / np.maximum(a, TINY)])
            found[:, :, p] = noise[:, :, p] / np.maximum(told, TINY)
        return found

    def _summed(self, x: Float[np.ndarray, "m ..."]) -> Float[np.ndarray, "n ..."]:
        """Sums over each span."""
        total = np.concatenate([np.zeros((1, *x.shape[1:])), np.cumsum(x, axis=0)])
        return total[self._end] - total[self._begin]

    def estimates(self, residual: Float[np.ndarray, "m c"]) -> Float[np.ndarray, "n p"]:
        """First-order estimate of each change; zero where it moves nothing that the model cannot."""
        weighed = residual * self.weight
        beside = self._shares @ np.einsum("mck,mc->k", self._B, weighed)
        right = self._summed(np.einsum("mcp,mc->mp", self._S, weighed)) - beside
        return np.where(self._idle, 0.0, right / self.information)

    def gains(self, estimates: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        """Deviance that each change takes away, variances held."""
        return estimates**2 * self.information

    def explained(self, span: int, parameter: int, estimate: float) -> Float[np.ndarray, "m c"]:
        """What a change of this size takes away of the residual, scaled as that is."""
        found = -self._B @ self._shares[span, parameter]
        here = slice(self._begin[span], self._end[span])
        found[here] += self._S[here, :, parameter]
        return estimate * found


def _form(
    x: Float[np.ndarray, "n k"], A: Float[np.ndarray, "k k"], y: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, " n"]:
    return np.sum((x @ A) * y, axis=1)


# --- What is reported of a change: the parameter before and after, when, and what else explains as much.

NEAREST = 200  # moments that are compared with the best one, those that explain most


def told(
    state: SelectionState, found: Sought, chosen: Sequence[Component], election: ScreeningResult | None
) -> ParameterChange:
    """A change with its sizes beside all that is in the state and `chosen`; `election` is that which added nothing."""
    change, span = found.change, found.change.span
    begin = int(np.argmax(state.responses.manoeuvre == span.manoeuvre))
    before, after, size = _sizes(state, change, chosen)
    nearest, rivals, inflation = _as_good(state, found)
    seconds, parameter = state.responses.seconds, state.full.model.free[change.column]  # a block is as fine as it gets
    known = [] if election is None else election.candidate_scores
    effects = [s.effect for s in known if nats(found.gain - s.gain, inflation) < state.settings.ambiguous]
    return ParameterChange(
        parameter=parameter.name,
        unit=parameter.unit,
        manoeuvre=state.responses.flights.names[span.manoeuvre],
        at=(span.begin - begin) * seconds,
        interval=(max(nearest[0] - 1 - begin, 0) * seconds, (nearest[1] + 1 - begin) * seconds),
        lasts=span.end == len(state.residual),
        before=before,
        after=after,
        size=size,
        share=found.share,
        p_value=found.p_value,
        gain=nats(found.gained, inflation),
        ambiguous_with=tuple(dict.fromkeys([*rivals, *effects])),
    )


Value = tuple[float, float]


def _sizes(state: SelectionState, change: Change, chosen: Sequence[Component]) -> tuple[Value, Value, Value]:
    """Value before, after, and their difference, with standard errors; all that is in is fitted beside."""
    whole = with_components(state, (), chosen, manoeuvres(state))
    fit = whole.fit()
    covariance = uncertainty(whole, fit, autocorrelation_of(whole.left(fit), whole.folds))
    widths = [c.basis.shape[2] for c in chosen]
    own = len(fit.columns) - sum(widths) + sum(widths[: [c is change.component for c in chosen].index(True)])
    at = int(np.flatnonzero(fit.columns == change.column)[0])
    combinations = np.zeros((3, len(fit.columns)))
    combinations[[0, 1], at], combinations[[1, 2], own] = 1.0, change.unit
    sd = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", combinations, covariance, combinations), 0.0))
    values = combinations @ fit.step + state.theta[change.column] * np.array([1.0, 1.0, 0.0])
    before, after, size = ((float(x), float(s)) for x, s in zip(values, sd, strict=True))
    return before, after, size


def _as_good(state: SelectionState, found: Sought) -> tuple[tuple[int, int], list[str], float]:
    """First and last block from which the change may as well begin; other parameters that explain about as much; and
    the variance inflation of the change itself.

    Two changes are told from each other by the residual along the difference of what they explain.
    """
    scan, settings, (span, parameter) = found.scan, state.settings, found.change.at
    estimates = scan.estimates(found.residual)
    gains, own = scan.gains(estimates), scan.over[span]
    same = [i for i, one in enumerate(scan.over) if (one.manoeuvre, one.end) == (own.manoeuvre, own.end)]
    same = sorted(same, key=lambda i: -gains[i, parameter])[:NEAREST]
    best = np.argmax(gains, axis=0)
    others = [(int(best[p]), p) for p in range(len(scan.columns)) if p != parameter]
    places = [(span, parameter), *((i, parameter) for i in same), *others]

    def explained(place: tuple[int, int]) -> Float[np.ndarray, "m c"]:
        return scan.explained(*place, float(estimates[place]))

    leader = explained((span, parameter))
    apart = np.stack([leader, *(leader - explained(place) for place in places[1:])], axis=2)
    inflation = inflation_along(apart, scan.weight, found.folds, found.colour)
    lost = [nats(float(gains[span, parameter] - gains[p]), float(x)) for p, x in zip(places, inflation, strict=True)]
    times = [scan.over[i].begin for i, x in zip(same, lost[1:], strict=False) if x <= settings.change_interval]
    names = [state.full.model.names[scan.columns[p]] for _, p in others]
    rivals = sorted((x, name) for x, name in zip(lost[1 + len(same) :], names, strict=True) if x < settings.ambiguous)
    return (min(times), max(times)), [name for _, name in rivals], float(inflation[0])


# --- Functions that are candidates in place of effects: smooth ones of channels, periods, products of channels.

PERIODS = tuple(np.round(np.geomspace(0.6, 30.0, 48), 3))  # s
_OVER_TIME = " over time, period "
ODD = ("beta", "p", "r", "aileron", "rudder")
SKIPPED = ("ax", "ay", "az", "p_dot", "q_dot", "r_dot", "alpha_dot")  # responses themselves, not causes


def has_chunks(state: SelectionState) -> bool:
    """Whether every manoeuvre is long enough for a sinusoid to be fitted to parts of it and predict the others."""
    return all(part.stop - part.start > ORDER for part in _chunks(state))


BYTES = 2e9  # of memory that inner products may take


def families(state: SelectionState) -> tuple[tuple[Sequence[slice], list[Component], float], ...]:
    """The kinds of components that the record can test: the folds by which they must predict, themselves, and the least
    share of a verdict."""
    s, alone = state.settings, len(state.responses.flights.lengths) == 1
    channel, wave = (s.single_share, s.single_share) if alone else (s.unnamed_share, s.periodic_share)
    smooth = state.folds, smooth_components(state), channel
    periodic = [(_chunks(state), periodic_components(state), wave)] if has_chunks(state) else []
    return (smooth, *periodic, (state.folds, term_components(state), channel))


def smooth_components(state: SelectionState) -> list[Component]:
    """A smooth function of every recorded channel that moves within a manoeuvre, in each coefficient.

    Not of white noise about a constant, which explains a channel's own noise, and that is what it leaves. CL, CD and Cm
    do not change with the sign of what changes its sign with the wings.
    """
    signals = state.responses.evaluate(state.theta)[1]
    skipped = (*SKIPPED, *noise_channels(state.responses.flights))
    names = [n for n in (*state.responses.flights.recorded, "elapsed", "X") if n in signals and n not in skipped]
    found = []
    for name in names:
        if not moves(signals[name], state.responses.flights, 1e-6):
            continue
        x = np.asarray(state.responses.block(signals[name]))
        either, even = (_basis(y, state.settings.knots) for y in (x, np.abs(x) if name in ODD else x))
        found += [
            _of_one(state.outputs, f"{c} over {name}", c, either if c in LATERAL else even) for c in state.outputs
        ]
    return found


def term_components(state: SelectionState) -> list[Component]:
    """Every term of the library in each coefficient; a product is no function of one channel."""
    return [column.component for name in state.outputs for column in columns_of(state, name)]


def is_periodic(component: Component) -> bool:
    """Whether it is a sinusoid, whose phases another manoeuvre does not know."""
    return _OVER_TIME in component.label


def periodic_components(state: SelectionState) -> list[Component]:
    """A sinusoid of each period and free phase in each manoeuvre, in each coefficient."""
    elapsed = np.asarray(state.responses.block(state.responses.flights.channels["elapsed"]))
    manoeuvre = state.responses.manoeuvre
    found = []
    longest = np.bincount(manoeuvre).min() * state.responses.seconds  # of which every manoeuvre shows a whole one
    for period in PERIODS:
        if not 4.0 * state.responses.seconds <= period <= longest:
            continue
        phase = 2.0 * np.pi * elapsed / period
        wave = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        basis = np.concatenate([wave * (manoeuvre == k)[:, None] for k in range(int(manoeuvre[-1]) + 1)], axis=1)
        found += [_of_one(state.outputs, f"{c}{_OVER_TIME}{period:.3g} s", c, basis) for c in state.outputs]
    return found


def offsets_left(state: SelectionState, *, seed: int) -> tuple[str, ...]:
    """Coefficients whose mean residual differs between manoeuvres beyond chance, as that of a function must."""
    left = [c for c in state.outputs if c not in state.apart]
    if len(state.responses.flights.lengths) == 1 or not left or not has_chunks(state):
        return ()
    folds, manoeuvre = _chunks(state), state.responses.manoeuvre
    components = [Component(c, manoeuvre_constants(manoeuvre, state.outputs, c)[:, :, 1:]) for c in left]
    whole, found = with_components(state, components, (), folds), []
    for component in components:
        trial = with_components(state, [component], (), folds)
        wide = np.concatenate([trial.columns(), trial.component_columns[0]])
        share = share_of(trial, trial.component_columns[0])
        if share < state.settings.unnamed_share or holdout_deviance_gain(trial, wide) <= 0.0:
            continue
        wider = trial.products.fit(wide, trial.mean, trial.precision)
        noise = autocorrelation_of(trial.left(wider), folds), wider.variance
        if chance_of(share, null_shares(whole, *noise, seed)) <= state.settings.unnamed_false_alarm_rate:
            found.append(component.label)
    return tuple(found)


def _of_one(outputs: Sequence[str], label: str, coefficient: str, basis: Float[np.ndarray, "m w"]) -> Component:
    """A component that acts on one coefficient."""
    block = np.zeros((len(basis), len(outputs), basis.shape[1]))
    block[:, outputs.index(coefficient)] = basis
    return Component(label, block)


def _basis(x: Float[np.ndarray, " m"], count: int) -> Float[np.ndarray, "m w"]:
    """A line and radial bumps between quantiles, scaled to unit deviation; constants belong to the model."""
    knots = np.quantile(x, np.linspace(0.02, 0.98, count))
    width = max((knots[-1] - knots[0]) / (count - 1), 1e-12)
    columns = [x - x.mean(), *(np.exp(-0.5 * ((x - k) / width) ** 2) for k in knots[1:-1])]
    B = np.stack(columns, axis=1)
    B = B - B.mean(axis=0)
    return B / np.maximum(B.std(axis=0), 1e-12)


def _chunks(state: SelectionState) -> tuple[slice, ...]:
    return parts_of(state, state.settings.manoeuvre_parts)


def parts_of(state: SelectionState, count: int) -> tuple[slice, ...]:
    """Every manoeuvre in `count` parts, some blocks between neighbours left out."""
    edges = [np.flatnonzero(state.responses.manoeuvre == k) for k in range(len(state.responses.flights.lengths))]
    parts = [part for e in edges for part in np.array_split(e, count)]
    return tuple(slice(int(p[0]) + 2, int(p[-1]) - 1) for p in parts)


def in_batches(state: SelectionState, components: Sequence[Component], folds: Sequence[slice]) -> list[list[Component]]:
    """The components in as few sets as memory allows: inner products of all columns grow with their number squared."""
    each = 8.0 * len(folds) * state.residual.shape[1]  # bytes of one pair of columns
    most = max(int(np.sqrt(BYTES / each)) - state.S.shape[2], 1)
    found: list[list[Component]] = [[]]
    width = 0
    for component in components:
        wide = component.basis.shape[2]
        if found[-1] and width + wide > most:
            found.append([])
            width = 0
        found[-1].append(component)
        width += wide
    return found


def with_components(
    state: SelectionState, components: Sequence[Component], chosen: Sequence[Component], folds: Sequence[slice]
) -> SelectionState:
    """The state in which components are the candidates in place of effects; those `chosen` are in."""
    extra, width = [], 0
    for component in (*chosen, *components):
        extra.append(component.basis)
        width += component.basis.shape[2]
    S = np.concatenate([state.S[:, :, :-1], *extra, state.S[:, :, -1:]], axis=2)
    size = float(np.median(np.std(state.residual / state.noise_growth, axis=0)))
    precision = np.concatenate(
        [state.precision[:-1], np.full(width, state.variance_inflation / (10 * size) ** 2), [1.0]]
    )
    mean = np.concatenate([state.mean[:-1], np.zeros(width), [0.0]])
    products = Products.of(state.residual / state.noise_growth, S / state.noise_growth[:, :, None], folds)
    return replace(
        state, S=S, mean=mean, precision=precision, products=products, folds=tuple(folds),
        components=tuple(components), chosen=tuple(chosen),
    )  # fmt: skip


def share_of(state: SelectionState, own: np.ndarray) -> float:
    """Share of a coefficient's remaining variance that a component takes away, at best over the coefficients."""
    before = state.fit()
    after = state.products.fit(np.concatenate([before.columns, own]), state.mean, state.precision)
    return float(np.max(1.0 - after.variance / before.variance))


def null_shares(
    trial: SelectionState, colour: Autocorrelation, variance: Float[np.ndarray, " c"], seed: int
) -> Float[np.ndarray, " r"]:
    """Largest share that any component explains in noise-only records, of this autocorrelation and these variances.

    Both are what is left with the component in whose share is judged: with it out, structure would pass for slow noise,
    and noise of the other outputs for a share of it.
    """
    fit = trial.products.fit(trial.columns(), trial.mean, trial.precision, variance)
    return explained_shares(trial, fit, colour, seed, trial.settings.unnamed_replicates)


def chance_of(share: float, null: Float[np.ndarray, " r"]) -> float:
    """p-value of a share among those of noise-only records."""
    return float((1 + np.sum(null >= share)) / (1 + len(null)))
