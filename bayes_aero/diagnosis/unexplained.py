"""Structure that no effect of the catalogue explains but that a recorded channel, a period or the change of a parameter
does.

A smooth function of each channel, a sinusoid, or the change, is a candidate like an effect. It is taken for real
only if its score is beyond noise-only replicates and it predicts data left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc

from bayes_aero.diagnosis.accuracy import holdout_deviance_gain, recording_noise
from bayes_aero.diagnosis.candidate_set import DiagnosisSettings, manoeuvres
from bayes_aero.diagnosis.components import Trial, families, in_batches, parts_of, term_of
from bayes_aero.diagnosis.result import ParameterChange, Size, UnexplainedStructure
from bayes_aero.diagnosis.screening import (
    Autocorrelation,
    ScreeningResult,
    SharedNoise,
    autocorrelation_of,
    autocorrelations_of,
    chance_of,
    inflation_along,
    noise_records,
    screen,
    unbiased,
    uncertainty,
)
from bayes_aero.diagnosis.selection import Extension, removed
from bayes_aero.diagnosis.selection_state import (
    TINY,
    Component,
    Products,
    RegressionFit,
    SelectionState,
    inverse,
    moved,
    optimum,
)
from bayes_aero.effect import Kind, Stage
from bayes_aero.inference.covariance import ORDER, nats

# --- A parameter of the model that takes another value during the records: is there one beyond chance, and where.
# The largest gain over all parameters and moments is compared with that in noise-only replicates, which make the same
# choice. Then the change must explain enough and predict parts of the manoeuvres that it was not fitted to.


@dataclass(frozen=True)
class FoundComponent:
    """A component that is taken for real, and the state in which it was found."""

    state: SelectionState
    component: Component
    share: float
    p_value: float


@dataclass(frozen=True)
class FoundChange(FoundComponent):
    """A change of a parameter that is beyond chance, with what it was judged by."""

    at: tuple[int, int]  # its place in the scan (span, parameter)
    unit: float  # what a step of one is of the component
    scan: ChangeScan
    residual: Float[np.ndarray, "m c"]
    folds: tuple[slice, ...]
    colour: Autocorrelation
    gain: float  # deviance that it takes away
    gained: float  # deviance of the parts left out

    @property
    def span(self) -> Span:
        return self.scan.over[self.at[0]]

    @property
    def column(self) -> int:
        return int(self.scan.columns[self.at[1]])


def sought_change(
    state: SelectionState, chosen: Sequence[Component], *, seed: int, least: float = 0.0
) -> FoundChange | None:
    """The change that explains most beside the `chosen` components, if it predicts left-out parts beyond `least`."""
    settings, alone = state.settings, len(state.responses.flights.lengths) == 1
    first = _promising(state, chosen, least) if testable(state) else None
    if first is None:
        return None
    state = _beside(state, [*chosen, first[0]])
    folds = manoeuvres(state.responses.manoeuvre)
    whole = state.with_components((), chosen, folds)
    wider = Trial(state, first[0], chosen, folds).fit
    # Under the variances that it leaves: what it explains itself would pass for noise of its coefficient.
    held = whole.fit_columns(whole.columns(), held=wider.variance)
    scan, residual = ChangeScan(whole, held, first[1].columns, first[1].over, first[1].noise), whole.left(held)
    at = _leader(scan, scan.estimates(residual))[0]
    component, unit = _change(state, scan, at)
    trial, gained = Trial(state, component, chosen, folds), holdout_gain_of(state, component, chosen)
    enough = trial.share >= (settings.single_share if alone else settings.change_share) and gained > least
    if not enough or _by_noise(trial, scan, at, unit):
        return None
    colour, p = _p_value(whole, held, scan, trial.state.left(trial.fit), seed)
    if p > settings.change_false_alarm_rate:
        return None
    gain = whole.fit().deviance - trial.fit.deviance
    return FoundChange(state, component, trial.share, p, at, unit, scan, residual, folds, colour, gain, gained)


def testable(state: SelectionState) -> bool:
    """Whether the state is of coefficients that are modelled, and every manoeuvre long enough to be divided."""
    parts = parts_of(state, state.settings.change_parts)
    long = all(part.stop - part.start > ORDER for part in parts)
    return state.of_coefficients and long and bool(len(_free(state)) and _over(state))


def _promising(state: SelectionState, chosen: Sequence[Component], least: float) -> tuple[Component, ChangeScan] | None:
    """The change that explains most to first order, if that is worth another look."""
    folds = manoeuvres(state.responses.manoeuvre)
    whole = state if not chosen and folds == state.folds else state.with_components((), chosen, folds)
    fit, columns = whole.fit(), _free(state)
    # What noise of the recorded size adds to the sensitivities, scaled as those are. Added once more it adds as much as
    # the noise that is there already, as in `accuracy.noise_effect`.
    flights, rng = state.responses.flights, np.random.default_rng(0)
    added = {n: sd * rng.standard_normal(flights.n) for n, sd in recording_noise(flights).items()}
    noisy = flights.channels | {name: flights.channels[name] + x for name, x in added.items()}
    slopes = state.responses.with_channels(noisy).linearise(state.theta, columns)[1][:, state.kept_outputs]
    noise = slopes / state.noise_growth[:, :, None] - state.scaled[:, :, columns]
    scan = ChangeScan(whole, fit, columns, _over(state), noise)
    leader, gain = _leader(scan, scan.estimates(whole.left(fit)))
    if gain < state.settings.least_share * len(state.residual):
        return None
    component, _ = _change(state, scan, leader)
    return (component, scan) if holdout_gain_of(state, component, chosen) > least else None


def _by_noise(trial: Trial, scan: ChangeScan, place: tuple[int, int], unit: float) -> bool:
    """Whether one value, made too small by noise on either side of the change, explains it."""
    # To first order a share s of noise takes s of a value away; what lies between a value and that with twice as much
    # given back may be its truth.
    column = int(scan.columns[place[1]])
    (at,) = trial.fit.places([column])
    elsewhere = float(trial.state.theta[column] + trial.fit.step[at])
    values = elsewhere + unit * float(trial.fit.step[-1]), elsewhere
    shares = scan.noise_shares[:, place[0], place[1]]
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
    return Trial(state, component, chosen, parts_of(state, state.settings.change_parts)).gain


def _free(state: SelectionState) -> Int[np.ndarray, " p"]:
    moved = [e for e in state.full.model.effects if e.kind is Kind.AERODYNAMICS and e.stage > Stage.INFLOW]
    own, names = {p for e in moved for p in state.full.parameters_of(e.name)}, state.full.model.names
    return np.array([c for c in state.columns() if c < len(names) and names[c] in own], int)


def _over(state: SelectionState) -> list[Span]:
    least = max(1, round(state.settings.change_least / state.responses.seconds))
    return spans(state.responses.manoeuvre, least, state.settings.change_begins)


def _leader(scan: ChangeScan, estimates: Float[np.ndarray, "n p"]) -> tuple[tuple[int, int], float]:
    gains = scan.gains(estimates)
    span, parameter = np.unravel_index(int(np.argmax(gains)), gains.shape)
    return (int(span), int(parameter)), float(gains[span, parameter])


def _change(state: SelectionState, scan: ChangeScan, at: tuple[int, int]) -> tuple[Component, float]:
    """What a change adds, about as large as the residuals, and its size."""
    span, column = scan.over[at[0]], int(scan.columns[at[1]])
    basis = np.zeros((*state.residual.shape, 1))
    basis[span.begin : span.end, :, 0] = state.S[span.begin : span.end, :, column]
    unit = 1.0 / float(np.sqrt(np.max(np.mean(basis**2, axis=0))))
    return Component(state.full.model.names[column], f"blocks from {span.begin}", unit * basis), unit


def _p_value(
    state: SelectionState, fit: RegressionFit, scan: ChangeScan, left: Float[np.ndarray, "m c"], seed: int
) -> tuple[Autocorrelation, float]:
    """The colour of the noise that is `left` with the change in, and how often noise alone shows as much of one."""
    noise = SharedNoise(seed, state.folds, left.shape[1], state.settings)

    def without_leader(residual: Float[np.ndarray, "m c"]) -> Float[np.ndarray, "m c"]:
        estimates = scan.estimates(residual)
        leader, _ = _leader(scan, estimates)
        return residual - scan.explained(*leader, float(estimates[leader]))

    def statistic(residual: Float[np.ndarray, "m c"]) -> float:
        """Deviance that the leader takes away over what it leaves."""
        gain = _leader(scan, scan.estimates(residual))[1]
        return gain / (float(np.sum(residual**2 * scan.weight)) - gain)

    # What was chosen as the best of many makes the noise look faster than it is; replicates measure by how much.
    first = autocorrelation_of(left, state.folds)
    again = np.array([without_leader(record) for record in noise_records(state, fit, first, noise.correction)])
    colour = unbiased(first, autocorrelations_of(again, state.folds))
    nulls = np.array([statistic(record) for record in noise_records(state, fit, colour, noise.replicates)])
    return colour, chance_of(statistic(state.left(fit)), nulls)


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
    """From a block on, to the end of its manoeuvre or of all later ones; `least` blocks at either end are undivided."""
    count, m = int(manoeuvre[-1]) + 1, len(manoeuvre)
    changes = []
    for k in range(count):
        own = np.flatnonzero(manoeuvre == k)
        first, last = int(own[0]), int(own[-1]) + 1
        begins = [*([first] if k else []), *range(first + least, last - least + 1, -(-m // most))]
        # The records may be of one flight, where a change lasts, or of several, where it does not.
        ends = {m} if k == count - 1 else {last, m}
        changes += [Span(k, begin, end) for begin in begins for end in sorted(ends)]
    return changes


class ChangeScan:
    """Directions of the changes of p parameters over each of n spans; recording noise adds `noise` to sensitivities."""

    def __init__(
        self,
        state: SelectionState,
        fit: RegressionFit,
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
        self, fit: RegressionFit, own: Float[np.ndarray, "n p"], cross: Float[np.ndarray, "n p k"]
    ) -> Float[np.ndarray, "2 n p"]:
        """Share of noise in what tells the value of each parameter within each span, and in what tells it elsewhere."""

        def form(x: Float[np.ndarray, "n k"], y: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
            return np.sum((x @ others) * y, axis=1)

        added = np.einsum("mcp,c->mp", self.noise**2, self.weight)
        within = self._summed(added)
        noise = np.stack([within, np.sum(added, axis=0) - within])
        # By it least squares makes that value too small. All other parameters have one value, fitted beside both.
        whole = np.sum(self._S * self._weighed, axis=(0, 1))
        shared, shares = inverse(fit.normal), np.zeros_like(noise)
        for p, column in enumerate(self.columns):
            (at,) = fit.places([column])
            others = shared - np.outer(shared[:, at], shared[at]) / shared[at, at]  # without the parameter itself
            total = np.einsum("mc,mck->k", self._weighed[:, :, p], self._B)
            inside, outside = cross[:, p], total - cross[:, p]
            a, b = own[:, p] - form(inside, inside), whole[p] - own[:, p] - form(outside, outside)
            c = -form(inside, outside)
            information = np.stack([a - c**2 / np.maximum(b, TINY), b - c**2 / np.maximum(a, TINY)])
            shares[:, :, p] = noise[:, :, p] / np.maximum(information, TINY)
        return shares

    def _summed(self, x: Float[np.ndarray, "m ..."]) -> Float[np.ndarray, "n ..."]:
        total = np.concatenate([np.zeros((1, *x.shape[1:])), np.cumsum(x, axis=0)])
        return total[self._end] - total[self._begin]

    def estimates(self, residual: Float[np.ndarray, "m c"]) -> Float[np.ndarray, "n p"]:
        """First-order estimate of each change; zero where it moves nothing that the model cannot."""
        weighed = residual * self.weight
        beside = self._shares @ np.einsum("mck,mc->k", self._B, weighed)
        right = self._summed(np.einsum("mcp,mc->mp", self._S, weighed)) - beside
        return np.where(self._idle, 0.0, right / self.information)

    def gains(self, estimates: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        return estimates**2 * self.information

    def explained(self, span: int, parameter: int, estimate: float) -> Float[np.ndarray, "m c"]:
        """What a change of this size takes away of the residual, scaled as that is."""
        explained = -self._B @ self._shares[span, parameter]
        here = slice(self._begin[span], self._end[span])
        explained[here] += self._S[here, :, parameter]
        return estimate * explained


# --- What is reported of a change: the parameter before and after, when, and what else explains as much.

NEAREST = 200  # moments that are compared with the best one, those that explain most


def reported_change(
    state: SelectionState, change: FoundChange, chosen: Sequence[Component], election: ScreeningResult | None
) -> ParameterChange:
    """A change with its sizes beside all that is in the state and `chosen`; `election` is that which added nothing."""
    span = change.span
    begin = int(np.argmax(state.responses.manoeuvre == span.manoeuvre))
    before, after, size = _sizes(state, change, chosen)
    nearest, rivals, inflation = _as_good(state, change)
    seconds, parameter = state.responses.seconds, state.full.model.free[change.column]  # a block is as fine as it gets
    scores = [] if election is None else election.candidate_scores
    effects = [s.effect for s in scores if nats(change.gain - s.gain, inflation) < state.settings.ambiguous]
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
        share=change.share,
        p_value=change.p_value,
        gain=nats(change.gained, inflation),
        ambiguous_with=tuple(dict.fromkeys([*rivals, *effects])),
    )


Value = tuple[float, float]


def _sizes(state: SelectionState, change: FoundChange, chosen: Sequence[Component]) -> tuple[Value, Value, Value]:
    """Value before, after, and their difference, with standard errors; all that is in is fitted beside."""
    whole = state.with_components((), chosen, manoeuvres(state.responses.manoeuvre))
    fit = whole.fit()
    covariance = uncertainty(whole, fit)
    widths = [c.basis.shape[2] for c in chosen]
    place = len(fit.columns) - sum(widths) + sum(widths[: [c is change.component for c in chosen].index(True)])
    (at,) = fit.places([change.column])
    combinations = np.zeros((3, len(fit.columns)))
    combinations[[0, 1], at], combinations[[1, 2], place] = 1.0, change.unit
    sd = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", combinations, covariance, combinations), 0.0))
    values = combinations @ fit.step + state.theta[change.column] * np.array([1.0, 1.0, 0.0])
    before, after, size = ((float(x), float(s)) for x, s in zip(values, sd, strict=True))
    return before, after, size


def _as_good(state: SelectionState, change: FoundChange) -> tuple[tuple[int, int], list[str], float]:
    """First and last block where it may begin as well; other parameters that explain as much; variance inflation."""
    scan, settings, (span, parameter) = change.scan, state.settings, change.at
    estimates = scan.estimates(change.residual)
    gains, own = scan.gains(estimates), scan.over[span]
    same = [i for i, other in enumerate(scan.over) if (other.manoeuvre, other.end) == (own.manoeuvre, own.end)]
    same = sorted(same, key=lambda i: -gains[i, parameter])[:NEAREST]
    best = np.argmax(gains, axis=0)
    others = [(int(best[p]), p) for p in range(len(scan.columns)) if p != parameter]
    places = [(span, parameter), *((i, parameter) for i in same), *others]

    def explained(place: tuple[int, int]) -> Float[np.ndarray, "m c"]:
        return scan.explained(*place, float(estimates[place]))

    # Two changes are told from each other by the residual along the difference of what they explain.
    leader = explained((span, parameter))
    apart = np.stack([leader, *(leader - explained(place) for place in places[1:])], axis=2)
    inflation = inflation_along(apart, scan.weight, change.folds, change.colour)
    lost = [nats(float(gains[span, parameter] - gains[p]), float(x)) for p, x in zip(places, inflation, strict=True)]
    times = [scan.over[i].begin for i, x in zip(same, lost[1:], strict=False) if x <= settings.change_interval]
    names = [state.full.model.names[scan.columns[p]] for _, p in others]
    rivals = sorted((x, name) for x, name in zip(lost[1 + len(same) :], names, strict=True) if x < settings.ambiguous)
    return (min(times), max(times)), [name for _, name in rivals], float(inflation[0])


@dataclass(frozen=True)
class Left:
    """What the catalogue does not explain."""

    unknown: tuple[UnexplainedStructure, ...]
    replaced: tuple[str, ...]  # named causes that were only its proxies
    changes: tuple[ParameterChange, ...] = ()
    functions: tuple[Component, ...] = ()  # by which the structure was found


def unexplained(extension: Extension, *, seed: int) -> Left:
    """Look at what the extended model leaves; then whether a component explains a named cause better than itself."""
    state, components = extension.state, list[FoundComponent]()
    for number in range(max(state.settings.unnamed_most, len(state.outputs))):
        best = _best(state, [f.component for f in components], seed + number)
        if best is None:
            break
        components.append(best)
        state = best.state
    if components:
        replaced = superfluous(state, extension.causes, [f.component for f in components])
        over = {(f.component.coefficient, f.component.channel) for f in components}
        lines = {n: term_of(state, n) for n in replaced}  # terms of a channel, of which a function of it has all
        line = {n for n, t in lines.items() if t and any((t.component.coefficient, x) in over for x in t.term.channels)}
        return _left(extension, components, tuple(name for name in replaced if name not in line))
    # A component, or the change of a parameter, that predicts unseen data clearly better than all named causes of the
    # coefficients together: they were then stand-ins for something that is in no catalogue.
    proxies = (_changing_in(extension, seed), _standing_in(extension)) if extension.causes else ()
    margins = [proxy for proxy in proxies if proxy is not None]
    if not margins:
        return Left((), ())
    return _left(extension, [max(margins, key=lambda margin: margin[0])[1]], extension.causes)


def offsets_found(extension: Extension, idle: Sequence[str] = ()) -> tuple[UnexplainedStructure, ...]:
    """Each coefficient, not `idle`, whose constant differs between manoeuvres, and what explains that as well."""
    state, structures = extension.state, []
    for name in (n for n in state.apart if n not in idle):
        fewer = moved(state, state.theta, apart=tuple(n for n in state.apart if n != name))
        less, fit = fewer.fit(), state.fit()
        ranking = screen(fewer, less).candidate_scores
        gain = less.deviance - fit.deviance
        rivals = [s.effect for s in ranking if nats(gain - s.gain, state.variance_inflation) < state.settings.ambiguous]
        at = fit.places(constants_of(state, name))
        from_first = np.eye(len(at))[1:] - np.eye(len(at))[0]
        covariance = uncertainty(state, fit)[np.ix_(at, at)]
        size, covariance = from_first @ fit.step[at], from_first @ covariance @ from_first.T
        p = float(chdtrc(len(size), size @ inverse(covariance) @ size))
        if p > state.settings.block_false_alarm_rate:
            continue
        deviation = np.sqrt(np.diag(covariance))
        names = state.responses.flights.names[1:]
        offsets = {n: (float(x), float(sd)) for n, x, sd in zip(names, size, deviation, strict=True)}
        share = float(np.max(1.0 - fit.variance / less.variance))
        structures.append(UnexplainedStructure(name, "manoeuvre", share, p, tuple(dict.fromkeys(rivals)), offsets))
    return tuple(structures)


def constants_of(state: SelectionState, name: str) -> Int[np.ndarray, " k"]:
    """The columns of a coefficient's constants, in the order of the manoeuvres."""
    width, number = len(state.responses.flights.lengths), state.apart.index(name)
    first = len(state.offsets) - width * (len(state.apart) - number)
    return state.offsets[first : first + width]


def _left(extension: Extension, components: Sequence[FoundComponent], replaced: tuple[str, ...]) -> Left:
    unknown, changes, chosen = [], [], [f.component for f in components]
    bare = components[-1].state.without([name for name in replaced if name in components[-1].state.active])
    last = extension.steps[-1] if extension.steps else None
    election = None if last is None or last.chosen is not None else last.screening
    for component in components:
        if isinstance(component, FoundChange):
            change = reported_change(bare, component, chosen, election)
            if not (change.between and set(change.ambiguous_with) & _constants(bare)):
                changes.append(change)
        else:
            of = component.component
            unknown.append(UnexplainedStructure(of.coefficient, of.channel, component.share, component.p_value))
    functions = tuple(component.component for component in components if not isinstance(component, FoundChange))
    return Left(tuple(unknown), replaced, tuple(changes), functions)


def _constants(state: SelectionState) -> set[str]:
    """Parameters of the model that are a constant of a coefficient with offsets between manoeuvres."""
    # What these explain as well is no change, for the drag due to lift follows an offset of the lift.
    outputs = [state.outputs.index(name) for name in state.apart]
    S = state.S[:, outputs][:, :, : len(state.theta)]
    constant = np.any((np.ptp(S, axis=0) <= 1e-6 * np.abs(S).max(axis=0)) & (np.abs(S).max(axis=0) > 0.0), axis=0)
    return {name for name, own in zip(state.full.model.names, constant, strict=True) if own}


def superfluous(state: SelectionState, causes: Sequence[str], chosen: Sequence[Component]) -> tuple[str, ...]:
    """Named causes of which little is left once the components are in: they had stood in for them."""
    wide, least = state.with_components((), chosen), state.least_share(state.settings.unnamed_share)
    dropped, deviance, count = [], wide.fit().deviance, float(wide.products.count.sum())
    for name in causes:
        rest = removed(state, name).with_components((), chosen).fit().deviance
        if 1.0 - np.exp(-max(rest - deviance, 0.0) / count) < least:
            dropped.append(name)
    return tuple(dropped)


def withdrawn(extension: Extension, names: Sequence[str], sizes: Mapping[str, Size]) -> Extension:
    """Causes `names` of which little is left beside what is unexplained become nuisances; `sizes` are the others'."""
    causes = tuple(name for name in extension.causes if name not in names)
    minor = (*extension.minor, *(name for name in extension.causes if name in names))
    return replace(extension, causes=causes, minor=minor, sizes={**extension.sizes, **sizes})


def _best(state: SelectionState, chosen: Sequence[Component], seed: int) -> FoundComponent | None:
    """The component, or change, that explains what is left beyond chance and predicts left-out data best."""
    smooth, change = _best_function(state, chosen, seed), sought_change(state, chosen, seed=seed)
    if change is not None and (smooth is None or change.gained >= holdout_gain_of(state, smooth.component, chosen)):
        return change
    return smooth


def _best_function(state: SelectionState, chosen: Sequence[Component], seed: int) -> FoundComponent | None:
    tried = state.settings.unnamed_tried
    for folds, components, least in families(state):
        batches, leaders = in_batches(state, components, folds), []
        for batch in batches:
            trials = state.with_components(batch, chosen, folds)
            scores = screen(trials, trials.fit(), seed=seed, nulls=False).candidate_scores[:tried]
            leaders += [(standing.score, next(c for c in batch if c.label == standing.effect)) for standing in scores]
        leaders.sort(key=lambda leader: -leader[0])
        for _, component in leaders[:tried]:
            trial = Trial(state, component, chosen, folds)
            if trial.gain <= 0.0 or trial.share < least:
                continue
            p = trial.chance([state.with_components(batch, chosen, folds) for batch in batches], seed)
            if p <= state.settings.unnamed_false_alarm_rate:
                return FoundComponent(state, component, trial.share, p)
    return None


def _changing_in(extension: Extension, seed: int) -> tuple[float, FoundComponent] | None:
    """A change in place of the causes, and by how much more than they must it predicts."""
    state = extension.state
    bare = state.without(extension.causes)
    if not testable(bare):
        return None
    parts = parts_of(state, state.settings.change_parts)
    products = Products.of(bare.residual / bare.noise_growth, bare.scaled, parts)
    own = state.full.own_columns(*extension.causes)
    of_causes = holdout_deviance_gain(replace(bare, products=products, folds=parts), np.append(bare.columns(), own))
    change = sought_change(bare, (), seed=seed, least=max(of_causes, 0.0))
    if change is None:
        return None
    margin = _margin(state, change.gained, of_causes)
    return (margin, change) if margin > 0.0 else None


def _margin(state: SelectionState, gained: float, of_causes: float) -> float:
    return gained - state.settings.stand_in * max(of_causes, 0.0) - 6.0 * state.variance_inflation


def _standing_in(extension: Extension) -> tuple[float, FoundComponent] | None:
    """The same of a function, of whose share a part must be left where the causes are in."""
    # A cause that is a proxy leaves a part of what it stands in for. The true one leaves nothing, and still predicts
    # less than a function of its own channel where the parameters of the model beside it extrapolate.
    state = extension.state
    own = state.full.own_columns(*state.active)
    best = None
    parts = [(f, batch, least) for f, every, least in families(state) for batch in in_batches(state, every, f)]
    for folds, components, least in parts:
        trial = state.with_components(components, (), folds)
        bare = trial.columns(())
        products = trial.products.shifted(own, -state.departure[own])
        taken_out = replace(trial, products=products, active=())
        of_causes = holdout_deviance_gain(taken_out, np.concatenate([bare, own]), bare)
        width = max(len(columns) for columns in trial.component_columns)
        dummy = trial.S.shape[2] - 1
        rows = [np.append(np.append(bare, c), np.full(width - len(c), dummy)) for c in trial.component_columns]
        deviance = products.fit_many(np.array(rows, int), trial.mean, trial.precision)[3]
        for i in np.argsort(deviance)[: state.settings.unnamed_tried]:
            columns = trial.component_columns[i]
            gained = holdout_deviance_gain(taken_out, np.concatenate([bare, columns]), bare)
            margin = _margin(state, gained, of_causes)
            share = taken_out.share_of(columns)
            left = trial.share_of(columns) if margin > 0.0 and share >= least else 0.0
            if left > 0.0 and left_beside(share, left, state.settings) and (best is None or margin > best[0]):
                best = (margin, FoundComponent(state, components[i], share, float("nan")))
    return best


def left_beside(alone: float, beside: float, settings: DiagnosisSettings) -> bool:
    """Whether the share that a function explains `beside` its causes is no small part of that `alone`, without them."""
    return beside >= (settings.stand_in - 1.0) * alone
