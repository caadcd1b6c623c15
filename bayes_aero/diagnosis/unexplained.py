"""Structure that no effect explains but that a recorded channel, a period, a changing parameter or terms do.

A smooth function of each channel, a sinusoid, or the change, is a candidate like an effect. It is taken for real
only if its score is beyond noise-only replicates and it predicts data left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc

from bayes_aero.diagnosis import components as shapes
from bayes_aero.diagnosis import screening, selection_state
from bayes_aero.diagnosis.components import TermColumn, Trial, columns_of, holdout_gain_of, in_batches
from bayes_aero.diagnosis.result import FoundTerm, ParameterChange, ProductTerm, Size, UnexplainedStructure
from bayes_aero.diagnosis.selection import Extension, LeftOut, holdout_deviance_gain, removed
from bayes_aero.diagnosis.selection_state import (
    Component,
    DiagnosisSettings,
    Products,
    SelectionState,
    inverse,
    moved,
    refitted,
)
from bayes_aero.effect import Kind
from bayes_aero.inference.covariance import nats
from bayes_aero.processes import side_by_side
from bayes_aero.progress import Progress, quiet


class Left(NamedTuple):
    unknown: tuple[UnexplainedStructure, ...] = ()
    replaced: tuple[str, ...] = ()  # named causes that were only its proxies
    changes: tuple[ParameterChange, ...] = ()
    functions: tuple[Component, ...] = ()  # by which the structure was found


def unexplained(extension: Extension, *, seed: int) -> Left:
    """Look at what the extended model leaves; then whether a component explains a named cause better than itself."""
    state, components, replaced = extension.state, list[shapes.FoundComponent](), extension.causes
    most = max(state.settings.unnamed_most, len(state.outputs))
    while len(components) < most and (best := _best(state, [f.component for f in components], seed + len(components))):
        components, state = [*components, best], best.state
    chosen = [f.component for f in components]
    if components:
        replaced, over = superfluous(state, extension.causes, chosen), {(c.coefficient, c.channel) for c in chosen}
        lines = {n: shapes.term_of(state, n) for n in replaced}  # terms of a channel, of which a function of it has all
        line = {n for n, t in lines.items() if t and any((t.component.coefficient, x) in over for x in t.term.channels)}
        replaced = tuple(name for name in replaced if name not in line)
    elif replaced:
        # A component, or the change of a parameter, that predicts unseen data clearly better than all named causes of
        # the coefficients together: they were then stand-ins for something that is in no catalogue.
        margins = [x for x in (_changing_in(extension, seed), _standing_in(extension)) if x is not None]
        components = [max(margins, key=lambda margin: margin[0])[1]] if margins else []
        chosen = [f.component for f in components]
    if not components:
        return Left()
    unknown, changes, last = [], [], extension.steps[-1] if extension.steps else None
    bare = components[-1].state.without([name for name in replaced if name in components[-1].state.active])
    election = None if last is None or last.chosen is not None else last.screening
    for addition in components:
        if isinstance(addition, shapes.FoundChange):
            change = shapes.reported_change(bare, addition, chosen, election)
            if not (change.between and set(change.ambiguous_with) & _constants(bare)):
                changes.append(change)
        else:
            of = addition.component
            unknown.append(UnexplainedStructure(of.coefficient, of.channel, addition.share, addition.p_value))
    functions = tuple(addition.component for addition in components if not isinstance(addition, shapes.FoundChange))
    return Left(tuple(unknown), replaced, tuple(changes), functions)


def offsets_found(extension: Extension, idle: Sequence[str] = ()) -> tuple[UnexplainedStructure, ...]:
    """Each coefficient, not `idle`, whose constant differs between manoeuvres, and what explains that as well."""
    state, structures = extension.state, []
    for name in (n for n in state.apart if n not in idle):
        fewer = moved(state, state.theta, apart=tuple(n for n in state.apart if n != name))
        less, fit = fewer.best, state.best
        ranking = screening.screen(fewer).candidate_scores
        gain = less.deviance - fit.deviance
        rivals = [s.effect for s in ranking if nats(gain - s.gain, state.variance_inflation) < state.settings.ambiguous]
        at = fit.places(constants_of(state, name))
        from_first = np.eye(len(at))[1:] - np.eye(len(at))[0]
        covariance = screening.uncertainty(state)[np.ix_(at, at)]
        size, covariance = from_first @ fit.step[at], from_first @ covariance @ from_first.T
        p = float(chdtrc(len(size), size @ selection_state.inverse(covariance) @ size))
        if p > state.settings.block_false_alarm_rate:
            continue
        deviation = np.sqrt(np.diag(covariance))
        names = state.responses.flights.names[1:]
        offsets = {n: (float(x), float(sd)) for n, x, sd in zip(names, size, deviation, strict=True)}
        share = float(np.max(1.0 - fit.variance / less.variance))
        structures.append(UnexplainedStructure(name, "manoeuvre", share, p, tuple(dict.fromkeys(rivals)), offsets))
    return tuple(structures)


def constants_of(state: SelectionState, name: str) -> Int[np.ndarray, " k"]:
    width, number = len(state.responses.flights.lengths), state.apart.index(name)
    first = len(state.offsets) - width * (len(state.apart) - number)
    return state.offsets[first : first + width]


def _constants(state: SelectionState) -> set[str]:
    """Parameters of the model that are a constant of a coefficient with offsets between manoeuvres."""
    # What these explain as well is no change, for the drag due to lift follows an offset of the lift.
    outputs = [state.outputs.index(name) for name in state.apart]
    S = state.wide.S[:, outputs][:, :, : len(state.theta)]
    constant = np.any((np.ptp(S, axis=0) <= 1e-6 * np.abs(S).max(axis=0)) & (np.abs(S).max(axis=0) > 0.0), axis=0)
    return {name for name, flat in zip(state.full.model.names, constant, strict=True) if flat}


def superfluous(state: SelectionState, causes: Sequence[str], chosen: Sequence[Component]) -> tuple[str, ...]:
    """Named causes of which little is left once the components are in: they had stood in for them."""
    wide, least = state.with_components((), chosen), state.least_share(state.settings.unnamed_share)
    deviance, count = wide.best.deviance, float(wide.products.count.sum())
    more = {n: removed(state, n).with_components((), chosen).best.deviance - deviance for n in causes}
    return tuple(n for n, x in more.items() if 1.0 - np.exp(-max(x, 0.0) / count) < least)


def withdrawn(extension: Extension, names: Sequence[str], sizes: Mapping[str, Size]) -> Extension:
    """Causes `names` of which little is left beside what is unexplained become nuisances; `sizes` are the others'."""
    causes = tuple(name for name in extension.causes if name not in names)
    minor = (*extension.minor, *(name for name in extension.causes if name in names))
    return replace(extension, causes=causes, minor=minor, sizes={**extension.sizes, **sizes})


def _best(state: SelectionState, chosen: Sequence[Component], seed: int) -> shapes.FoundComponent | None:
    """The change, function of a channel, or sinusoid, that explains what is left beyond chance and predicts left-out
    data best; a term where there is neither function nor sinusoid."""
    smooth, terms = shapes.families(state)
    sought = _of_family(state, *smooth, chosen, seed), shapes.sought_waves(state, chosen, seed)
    found = [best for best in (next(x, None) for x in sought) if best is not None]
    found = found or list(islice(_of_family(state, *terms, chosen, seed), 1))
    gains = [(holdout_gain_of(state, best.component, chosen), best) for best in found]
    change = shapes.sought_change(state, chosen, seed=seed)
    gains = gains if change is None else [(change.gained, change), *gains]
    return max(gains, key=lambda pair: pair[0], default=(0.0, None))[1]


def _of_family(
    state: SelectionState, components: list[Component], least: float, chosen: Sequence[Component], seed: int
) -> Iterator[shapes.FoundComponent]:
    """Those of a family beyond chance, the highest score first."""
    tried, rate = state.settings.unnamed_tried, state.settings.unnamed_false_alarm_rate
    batches, leaders = in_batches(state, components), list[tuple[float, Component]]()
    for batch in batches:
        trials, by_label = state.with_components(batch, chosen), {c.label: c for c in batch}
        noise = screening.SharedNoise(seed, trials.folds, len(trials.outputs), trials.settings)
        scores = screening.screen(trials, noise=noise).candidate_scores[:tried]
        leaders += [(standing.score, by_label[standing.effect]) for standing in scores]
    for _, component in sorted(leaders, key=lambda leader: -leader[0])[:tried]:
        trial = Trial(state, component, chosen)
        if trial.gain > 0.0 and trial.share >= least:
            p = trial.chance([state.with_components(batch, chosen) for batch in batches], seed)
            if p <= rate:
                yield shapes.FoundComponent(state, component, trial.share, p)


def _changing_in(extension: Extension, seed: int) -> tuple[float, shapes.FoundComponent] | None:
    """A change in place of the causes, and by how much more than they must it predicts."""
    state = extension.state
    bare = state.without(extension.causes)
    if not shapes.testable(bare):
        return None
    parts, columns = shapes.parts_of(state, state.settings.change_parts), state.full.own_columns(*extension.causes)
    divided = replace(bare, products=Products.of(bare.residual / bare.noise_growth, bare.scaled, parts), folds=parts)
    of_causes = holdout_deviance_gain(divided, np.append(bare.columns(), columns))
    change = shapes.sought_change(bare, (), seed=seed, least=max(of_causes, 0.0))
    margin = -math.inf if change is None else _margin(state, change.gained, of_causes)
    return (margin, change) if change is not None and margin > 0.0 else None


def _margin(state: SelectionState, gained: float, of_causes: float) -> float:
    return gained - state.settings.stand_in * max(of_causes, 0.0) - 6.0 * state.variance_inflation


def _standing_in(extension: Extension) -> tuple[float, shapes.FoundComponent] | None:
    """The same of a function, of whose share a part must be left where the causes are in."""
    # A cause that is a proxy leaves a part of what it stands in for. The true one leaves nothing, and still predicts
    # less than a function of its own channel where the parameters of the model beside it extrapolate.
    state, best = extension.state, None
    columns = state.full.own_columns(*state.active)
    parts = [(batch, least) for every, least in shapes.families(state) for batch in in_batches(state, every)]
    for components, least in parts:
        trial = state.with_components(components, ())
        bare, every = trial.columns(()), trial.component_columns
        products = trial.products.shifted(columns, -state.departure[columns])
        taken_out = replace(trial, products=products, active=())
        of_causes = holdout_deviance_gain(taken_out, np.concatenate([bare, columns]), bare)
        width, dummy = max(map(len, every)), trial.S.shape[2] - 1
        rows = [np.concatenate([bare, c, np.full(width - len(c), dummy)]) for c in every]
        deviance = products.fit_many(np.array(rows, int), trial.mean, trial.precision)[3]
        for i in np.argsort(deviance)[: state.settings.unnamed_tried]:
            gained = holdout_deviance_gain(taken_out, np.concatenate([bare, every[i]]), bare)
            margin, share = _margin(state, gained, of_causes), taken_out.share_of(every[i])
            left = trial.share_of(every[i]) if margin > 0.0 and share >= least else 0.0
            if left > 0.0 and left_beside(share, left, state.settings) and (best is None or margin > best[0]):
                best = (margin, shapes.FoundComponent(state, components[i], share, float("nan")))
    return best


def left_beside(alone: float, beside: float, settings: DiagnosisSettings) -> bool:
    """Whether the share that a function explains `beside` its causes is no small part of that `alone`, without them."""
    return beside >= (settings.stand_in - 1.0) * alone


# --- Which form has unexplained structure: forward selection of terms by what they predict of left-out folds.
# Of what coefficients leave, noise-only replicates say what is beyond chance. Where a model meets the record in flight,
# terms are screened by what they make of the residuals to first order, and must be beyond chance by how far they move
# when a part of the flights is left out: a window of trajectories, or some seconds of innovations.

NEAR = 0.5  # of the best term's gain, below which no other is compared with it; our choice
AS_GOOD = 0.1  # of what the function gains, what terms may gain less: it bends as it likes; our choice
SWING = {"CL": 0.01, "CD": 0.001, "Cm": 0.002, "CY": 0.01, "Cl": 0.001, "Cn": 0.001}
"""The least change of a coefficient worth modelling, as in the catalogue."""


@dataclass(frozen=True)
class SelectedTerm:
    """A term that was added, with the deviance that it gains on left-out folds, and those that are as good."""

    column: TermColumn
    gain: float
    share: float
    inflation: float
    weight: float
    others: tuple[tuple[ProductTerm, float], ...]
    p_value: float
    among: int  # terms of which it was chosen
    elsewhere: tuple[str, ...] = ()  # terms of other coefficients that explain as much

    @property
    def cost(self) -> float:
        """Nats of a parameter and of the choice of a term."""
        return 1.0 + float(np.log(self.among))


def components_of(terms: Sequence[SelectedTerm]) -> list[Component]:
    return [term.column.component for term in terms]


def terms_of_coefficient(
    state: SelectionState, coefficient: str, functions: Sequence[Component], *, seed: int
) -> list[SelectedTerm]:
    """Terms that describe what is left of a coefficient as well as the `functions` by which it was found."""
    columns, terms, settings = columns_of(state, coefficient), list[SelectedTerm](), state.settings
    for number in range(settings.terms_most):
        best, _ = leader(state, [columns], [f.column for f in terms])
        if nats(best.gain, best.inflation) < settings.ambiguous or best.share < settings.unnamed_share:
            break
        taken = components_of(terms)
        trial = state.with_components([c.component for c in columns if c.component not in taken], taken)
        at = trial.component_columns[trial.components.index(best.column.component)]
        wider = trial.fit(trial.wider(at))
        colour = screening.autocorrelation_of(trial.left(wider), trial.folds)
        p = screening.chance_of(best.share, screening.null_shares(trial, colour, wider.variance, seed + number))
        if p > settings.unnamed_false_alarm_rate:
            break
        terms.append(replace(best, p_value=p))
    if not (terms := reconsidered(state, terms)):
        return []

    def gain(components: Sequence[Component]) -> float:
        wide = state.with_components((), components)
        return holdout_deviance_gain(wide, wide.columns(), state.columns())

    inflation, least = max(best.inflation for best in terms), gain(functions)
    missed = nats(least - gain(components_of(terms)), inflation)
    return terms if missed < max(settings.ambiguous, AS_GOOD * nats(least, inflation)) else []


def reconsidered(state: SelectionState, terms: Sequence[SelectedTerm]) -> list[SelectedTerm]:
    """The terms that are still worth their place beside all others, with what each gains there."""
    left = list(terms)
    for term in terms:
        trial = Trial(state, term.column.component, components_of([f for f in left if f is not term]))
        at, least = left.index(term), state.least_share(state.settings.unnamed_share)
        worth = trial.share >= least and trial.gain > 0.0
        left[at : at + 1] = [replace(term, share=trial.share, gain=trial.gain)] if worth else []
    return left


def leader(
    state: SelectionState, library: Sequence[Sequence[TermColumn]], chosen: Sequence[TermColumn]
) -> tuple[SelectedTerm, float]:
    """The best term, of the library of each coefficient, beside those chosen; and the nats that it explains."""
    components, labels = [c.component for c in chosen], {c.component.label for c in chosen}
    start = state.with_components((), components)
    fit, growth, inside = start.best, start.noise_growth[:, :, None], start.inside[:, None, None]
    weight, left, B = 1.0 / fit.variance, start.left(), np.where(inside, start.scaled[:, :, fit.columns], 0.0)
    normal, beside, n = inverse(fit.normal), np.tensordot(left * weight, B, 2), float(np.count_nonzero(start.inside))
    gram = np.einsum("mck,c,mcl->kl", B, weight, B, optimize=True)

    def explained(columns: Sequence[TermColumn]) -> tuple[np.ndarray, ...]:
        """What columns make, what parameters of the model make of that, its estimates, and gains in deviance."""
        X = np.where(inside, np.concatenate([c.component.basis for c in columns], axis=2) / growth, 0.0)
        reached = np.any(X != 0.0, axis=(0, 2))  # of hundreds of terms only inner products, over the outputs they reach
        of_terms = X[:, reached] * np.sqrt(weight[reached])[:, None]
        cross = np.einsum("mck,c,mcj->kj", B[:, reached], np.sqrt(weight[reached]), of_terms, optimize=True)
        made = normal @ cross
        change = (2.0 * cross - gram @ made) * made
        # With the prior of the fits: a term that the parameters make as well has no other information: no gain.
        information = np.einsum("mcj,mcj->j", of_terms, of_terms) - change.sum(axis=0) + state.flat_prior(1)[1]
        right = np.tensordot(left * weight, X, 2) - beside @ made
        return X, made, right / information, -n * np.log1p(-np.minimum(right**2 / information / n, 1.0 - 1e-9))

    groups = [[c for c in columns if c.component.label not in labels] for columns in library]
    every = [(gain, c) for columns in groups if columns for gain, c in zip(explained(columns)[3], columns, strict=True)]
    most = max(gain for gain, _ in every)
    near = [c for gain, c in sorted(every, key=lambda pair: -pair[0]) if gain >= NEAR * most]
    X, made, estimate, gains = explained(near)
    best = Trial(state, near[0].component, components)
    after = best.state.left(best.fit)
    # Two terms are told from each other by the residual along the difference of what they explain.
    explain = (X - B @ made) * estimate
    apart = np.concatenate([explain[:, :, :1], explain[:, :, :1] - explain[:, :, 1:]], axis=2)
    colour, parts = screening.autocorrelation_of(after, state.folds), (after, state.responses.parts)
    along = screening.inflation_along(apart, weight, state.folds, colour, parts)
    lost = np.array([0.0, *map(nats, gains[0] - gains[1:], along[1:])])
    weights = weights_of(lost, [c.term.cost for c in near])
    equal = [i for i in range(len(near)) if lost[i] < state.settings.ambiguous]
    first = max(equal, key=lambda i: weights[i])
    rivals, own = sorted((i for i in equal if i != first), key=lambda i: -weights[i]), near[first].component.coefficient
    trial, inflation = best if first == 0 else Trial(state, near[first].component, components), float(along[0])
    term = SelectedTerm(
        near[first], trial.gain, trial.share, inflation, float(weights[first]),
        tuple((near[i].term, float(weights[i])) for i in rivals if near[i].component.coefficient == own), float("nan"),
        len(every), tuple(near[i].component.label for i in rivals if near[i].component.coefficient != own),
    )  # fmt: skip
    return term, nats(fit.deviance - trial.fit.deviance, inflation)


def weights_of(lost: Float[np.ndarray, " j"], costs: Sequence[int]) -> Float[np.ndarray, " j"]:
    log = -lost - np.log(2.0) * np.array(costs)
    weights = np.exp(log - log.max())
    return weights / weights.sum()


def sized_terms(state: SelectionState, terms: Sequence[SelectedTerm]) -> tuple[FoundTerm, ...]:
    whole = state.with_components((), components_of(terms))
    fit, errors = whole.best, screening.jackknife_errors(whole, state.responses.parts)
    deviation = np.maximum(np.sqrt(np.diag(screening.uncertainty(whole))), errors)
    at, sizes = slice(len(fit.columns) - len(terms), None), []
    for term, size, sd in zip(terms, fit.step[at], deviation[at], strict=True):
        column, coefficient = term.column, term.column.component.coefficient
        factor, gain = (float(size) / column.scale, float(sd) / column.scale), nats(term.gain, term.inflation)
        least = SWING[coefficient] / max(column.spread, 1e-12)
        sizes.append(FoundTerm(coefficient, column.term, factor, term.share, gain, term.weight, term.others, least))
    return tuple(sizes)


def terms_of_flights(state: SelectionState) -> list[SelectedTerm]:
    """Terms of all coefficients, the first added first."""
    library = [columns_of(state, name) for name in state.responses.model.coefficients]
    left = list[SelectedTerm]()
    while len(left) < state.settings.unnamed_most and (best := _next(state, library, left)):
        left.append(best)
    left = reconsidered(state, left)
    while left:  # those of which, beside the others, nothing sure is left go out, the least sure first
        scores = [abs(best.size[0]) / best.size[1] for best in sized_terms(state, left)]
        if min(scores) >= state.settings.least_score:
            break
        left.pop(scores.index(min(scores)))
    return left


def _next(
    state: SelectionState, library: Sequence[Sequence[TermColumn]], terms: Sequence[SelectedTerm]
) -> SelectedTerm | None:
    """The best term beside those found; None where none is beyond chance, large enough and useful."""
    chosen, among = [term.column for term in terms], sum(map(len, library))
    for _ in range(state.settings.candidates_tried):
        best, explained = leader(state, library, chosen)
        p = _chance(Trial(state, best.column.component, components_of(terms)), best, among)
        if explained > 0.0 and p <= state.settings.unnamed_false_alarm_rate:
            return replace(best, p_value=p)
        library = [[c for c in columns if c is not best.column] for columns in library]
    return None


def _chance(trial: Trial, term: SelectedTerm, among: int) -> float:
    """The chance that noise lets some of `among` terms look as good; 1 where it is too small or predicts nothing."""
    settings, alone = trial.state.settings, len(trial.state.responses.flights.lengths) == 1
    least = trial.state.least_share(settings.single_share if alone else settings.unnamed_share)
    if term.share < least or nats(term.gain, term.inflation) < settings.ambiguous:
        return 1.0
    # No stationary colour holds in windows, with a term in or out; and innovations are white only as far as the noise
    # of the filter is right. So it is how far the estimate moves without each part of the flights, Bonferroni over the
    # library.
    at = trial.state.component_columns[0]
    return screening.jackknife_p_value(trial.state, trial.fit, at, trial.fit.step[-1:], among)


class Forms(NamedTuple):
    """Terms that were found, and what they are instead of."""

    terms: tuple[FoundTerm, ...]
    replaced: tuple[str, ...]  # causes of which little is left beside them
    idle: tuple[str, ...] = ()  # coefficients whose offsets between manoeuvres the terms explain
    rivals: Mapping[str, tuple[str, float]] = MappingProxyType({})  # terms as good as a cause; nats they explain less
    sizes: Mapping[str, Size] = MappingProxyType({})  # of parameters of causes that are left, beside the terms
    functions: tuple[tuple[Component, float], ...] = ()  # polynomials beside the terms, and their shares
    unknown: tuple[UnexplainedStructure, ...] = ()  # the structure that terms of flights describe


@dataclass(frozen=True, eq=False)
class _Model:
    """What explains the flights: a state with its additions and offsets, terms, and polynomials for what is left."""

    state: SelectionState
    terms: tuple[SelectedTerm, ...] = ()
    functions: tuple[Component, ...] = ()

    @property
    def wide(self) -> SelectionState:
        return self.state.with_components((), self.components)

    @property
    def components(self) -> tuple[Component, ...]:
        return (*components_of(self.terms), *self.functions)

    @cached_property
    def fitted(self) -> tuple[selection_state.RegressionFit, Float[np.ndarray, "m c"]]:
        """The fit of `wide` and what it leaves, from the columns that are in alone."""
        state, bases, columns = self.state, [component.basis for component in self.components], self.state.columns()
        S = np.concatenate([state.S[:, :, columns], *bases], axis=2) / state.noise_growth[:, :, None]
        residual, flat = state.residual / state.noise_growth, state.flat_prior(S.shape[2] - len(columns))
        mean, precision = (np.append(x[columns], y) for x, y in zip((state.mean, state.precision), flat, strict=True))
        best = Products.of(residual, S, state.folds).fit(np.arange(S.shape[2]), mean, precision)
        return best, residual - S @ best.step

    @cached_property
    def cost(self) -> float:
        """Nats of its parameters, and of the choices that they are."""
        state, effects = self.state, {e.name: e for e in self.state.full.candidates}
        causes = sum(len(effects[name].parameters) + np.log(len(effects)) for name in state.active)
        offsets = len(state.apart) * (len(state.responses.flights.lengths) - 1)
        waves = [np.log(len(shapes.frequencies(state))) for f in self.functions if f.periodic]
        functions = sum(f.basis.shape[2] + 1.0 for f in self.functions) + sum(waves)
        return float(causes + offsets + functions + sum(term.cost for term in self.terms))

    def less(self, item: str | SelectedTerm) -> _Model:
        if isinstance(item, SelectedTerm):
            return replace(self, terms=tuple(term for term in self.terms if term is not item))
        state, kept = self.state, self.state.lessened  # terms go out one after another beside the same state
        if item not in kept:
            apart = tuple(n for n in state.apart if n != item)
            kept[item] = moved(state, state.theta, apart=apart) if item in state.apart else removed(state, item)
        return replace(self, state=kept[item])

    def beyond(self, other: _Model, least: float = -math.inf) -> float:
        """Nats by which it explains more than another, costs counted; at most these where not above `least`."""
        # What tells the two apart is the residual along the difference of what they explain.
        state, fits, lefts = self.state, (self.fitted[0], other.fitted[0]), (self.fitted[1], other.fitted[1])
        most = nats(max(fits[1].deviance - fits[0].deviance, 0.0), 1.0) - self.cost + other.cost  # were it not coloured
        if most <= least:
            return most
        better = int(fits[1].deviance < fits[0].deviance)
        D, weight = np.where(state.inside[:, None], lefts[0] - lefts[1], 0.0)[:, :, None], 1.0 / fits[better].variance
        colour, left = screening.autocorrelation_of(lefts[better], state.folds), (lefts[better], state.responses.parts)
        (inflation,) = screening.inflation_along(D, weight, state.folds, colour, left)
        return nats(fits[1].deviance - fits[0].deviance, float(inflation)) - self.cost + other.cost

    def degrades(self, other: _Model) -> bool:
        """Whether it predicts left-out data worse: manoeuvres, or parts of each where there is a wave."""
        models, state = (other, self), self.state
        waves = any(f.periodic for f in (*self.functions, *other.functions))
        folds = shapes.chunks(state) if waves else state.folds
        wide = [(x.state.with_components((), x.components, folds), x.state.active) for x in models]
        before, after = (LeftOut.first_order(*pair) for pair in wide)
        return state.settings.degrades(*after.gain(before))

    def curved(self, curves: Sequence[Component], waves: Sequence[Component] = ()) -> _Model:
        """With the polynomials that earn their cost; before them the waves, if that explains more."""
        model, plain = self, self.curved(curves) if waves else self
        for curve in (*waves, *curves):
            wider = replace(model, functions=(*model.functions, curve))
            model = wider if wider.beyond(model, 0.0) > 0.0 else model
        return model if not waves or model.beyond(plain, 0.0) > 0.0 else plain

    def refitted(self) -> _Model:
        return replace(self, state=moved(self.state, selection_state.optimum(self.wide, range(len(self.state.folds)))))

    def eliminated(self, items: Sequence[str], curves: Sequence[Component]) -> _Model:
        """Without what does not earn its cost, the least useful first; functions may take the place of causes."""
        model = self
        while True:
            inside = [item for item in items if item in (*model.state.active, *model.state.apart)]
            trials = side_by_side(model.less, (*inside, *model.terms))
            others = [_other_forms(model.state, [item], curves) for item in inside]
            rivals = [replace(x, functions=tuple(c)) for x, c in zip(trials, others, strict=False)]
            rivals += trials[len(inside) :]
            gains = [rival.beyond(model, 0.0) for rival in rivals]
            if not gains or max(gains) <= 0.0:
                return model.curved(curves)
            best = trials[int(np.argmax(gains))]
            model = best if best.state is model.state else best.refitted()

    @cached_property
    def _tried(self) -> dict[str, _Model]:
        return {}

    def in_place_of(self, causes: Sequence[str]) -> list[_Model]:
        """For each cause the model with terms in its place; kept, for it is asked for again."""
        new = [name for name in causes if name not in self._tried]
        self._tried.update(zip(new, side_by_side(self.with_terms_for, new), strict=True))
        return [self._tried[name] for name in causes]

    def with_terms_for(self, name: str) -> _Model:
        state = _without(self.state, [name], self.state.apart)
        reached = _reached(state, self.state, ())
        terms = tuple(_beside(state, reached, self.terms, [name], self.state))
        curves = list[Component]()
        if _as_term(self.state, name) is None:  # polynomials would explain what is not asked of a term
            curves = [curve for coefficient in reached for curve in shapes.polynomials(state, coefficient)]
            curves = _other_forms(self.state, [name], curves)
        return _Model(state, terms, self.functions).curved(curves, shapes.waves(state, reached))

    def lagging(self, name: str) -> _Model:
        """The model of `with_terms_for` with lags beside its terms. Lags are rivals of a cause and replace none."""
        model = self.in_place_of([name])[0]
        reached = _reached(model.state, self.state, ())
        return replace(model, terms=tuple(_beside(model.state, reached, model.terms, [name], self.state, _is_lag)))


def forms_of(extension: Extension, left: Left, *, seed: int) -> Forms:
    """Terms for all structure that is `left`; periods have none."""
    forms = contest(extension, left)
    if forms.terms or forms.replaced:
        return forms._replace(unknown=described(left.unknown, forms))
    by_coefficient: dict[str, list[Component]] = {}
    for function in left.functions:
        if not function.periodic:
            by_coefficient.setdefault(function.coefficient, []).append(function)

    def sought(state: SelectionState) -> list[SelectedTerm]:
        return [t for n, group in by_coefficient.items() for t in terms_of_coefficient(state, n, group, seed=seed)]

    bare = extension.state.without([name for name in left.replaced if name in extension.state.active])
    causes = [name for name in extension.causes if name not in left.replaced]
    forms, _ = _with_terms(forms, bare, causes, sought)
    return forms._replace(unknown=described(left.unknown, forms))


def flown_forms(extension: Extension, *, progress: Progress = quiet) -> Forms:
    """Terms of all coefficients for what an extended model leaves of trajectories or innovations."""
    progress("terms", 0.0)
    instead, terms = contest(extension), list[SelectedTerm]()
    forms, unknown = instead, list[UnexplainedStructure]()
    if not (instead.terms or instead.replaced):
        forms, terms = _with_terms(instead, extension.state, extension.causes, terms_of_flights)
    for term, c in zip(terms, components_of(terms), strict=True):
        unknown.append(UnexplainedStructure(c.coefficient, c.channel, term.share, term.p_value, term.elsewhere))
    return forms._replace(unknown=described(unknown, instead))


def _with_terms(
    forms: Forms, state: SelectionState, causes: Sequence[str], sought: Callable[[SelectionState], list[SelectedTerm]]
) -> tuple[Forms, list[SelectedTerm]]:
    """Terms beside a state, if there are any without causes that only stood in for one: then without these."""
    terms, replaced = sought(state), ()
    if terms and (replaced := superfluous(state, causes, components_of(terms))):
        bare = state.without(replaced)
        again = sought(bare)
        state, terms, replaced = (bare, again, replaced) if again else (state, terms, ())
    return (forms._replace(terms=sized_terms(state, terms), replaced=replaced) if terms else forms), terms


def described(unknown: Sequence[UnexplainedStructure], forms: Forms) -> tuple[UnexplainedStructure, ...]:
    """Structure by the first function that shows it, where terms describe all of it."""
    by_coefficient = {term.coefficient: term for term in reversed(forms.terms)}
    first = {u.coefficient: u for u in reversed(unknown)}
    shapes, named = [(c, t.term.name, t.share) for c, t in by_coefficient.items()], {**first, **by_coefficient}
    shapes = [shape for shape in shapes if shape[0] not in first]
    shapes += [(f.coefficient, f.channel, share) for f, share in forms.functions if f.coefficient not in named]
    more = [UnexplainedStructure(*shape, float("nan")) for shape in shapes]
    return (*(u for u in unknown if u.coefficient not in by_coefficient or u is first[u.coefficient]), *more)


def contest(extension: Extension, left: Left = Left()) -> Forms:
    """Terms in place of causes and offsets that only stood in for them; and those that explain as well as causes."""
    # A wrong form of a coefficient leaves residuals that follow the state, as a stall or the error of a sensor does,
    # and differ between manoeuvres, as offsets do. So terms are sought without all of them; then everything is in, and
    # what does not earn its cost goes out, the least useful first.
    state, causes = extension.state, extension.causes
    named = {name: component for name in causes if (component := _as_term(state, name)) is not None}
    rest = [name for name in causes if name not in named]
    if not (causes or state.apart):
        return Forms((), ())
    start, named_only = _Model(state), _without(state, rest, ())
    reached = _reached(named_only, state, {f.coefficient for f in left.functions})
    named = {name: component for name, component in named.items() if component.coefficient in reached}
    models = list[_Model]()
    for apart in ((), state.apart) if state.apart else ((),):
        terms = _beside(_without(state, [*rest, *named], apart), reached, (), rest, state)
        by_name = {n: [f for f in components_of(terms) if f.coefficient == c.coefficient] for n, c in named.items()}
        alone = [name for name, group in by_name.items() if [f.label for f in group] in ([], [named[name].label])]
        same = {named[name].label for name in alone}
        out = [*(name for name in named if name not in alone), *left.replaced]
        more = tuple(term for term in terms if term.column.component.label not in same)
        models += [_Model(_without(state, out, state.apart), more)] if more else []
    curves = [curve for coefficient in reached for curve in shapes.polynomials(named_only, coefficient)]
    waves = shapes.waves(named_only, reached)
    models += [_Model(state, (), (wave,)) for wave in waves if _Model(named_only).curved([wave]).functions]
    bare = [replace(model, state=_without(model.state, rest, ())) for model in models]
    wholes, items = [model.curved(curves, waves).refitted() for model in bare], [*causes, *state.apart]
    tried = [model.eliminated(items, whole.functions) for model, whole in zip(models, wholes, strict=True)]
    best = _best_model(start, tried)
    if best is start:
        model, better = start, [(0.0, start)]
        while better:  # terms in place of one cause after another, as long as they are decisively better
            model = max(better, key=lambda pair: pair[0])[1]
            others = model.in_place_of([name for name in causes if name in model.state.active])
            least = state.settings.decisive
            better = [(x, other) for other in others if (x := other.beyond(model, least)) > least]
        tried.append(model.eliminated(items, curves))
        best = _best_model(start, tried)
    idle = _idle(replace(best, functions=()), curves)
    rivals = _rivals(best, [name for name in causes if name in best.state.active], [*wholes, *tried])
    functions = [*best.functions, *(f for f in idle.values() if f not in best.functions)]
    shares = [(f, Trial(best.state, f, [c for c in best.components if c is not f]).share) for f in functions]
    least = state.least_share(state.settings.unnamed_share)
    shown = tuple((f, share) for f, share in shares if share >= least)
    if best is start:
        return Forms((), (), idle=tuple(idle), rivals=rivals, functions=shown)
    gone = tuple(name for name in causes if name not in best.state.active)
    # Offsets that are, beside the terms, smaller than what is worth modelling.
    columns, step = list(best.state.columns()), best.fitted[0].step
    places = {n: [columns.index(column) for column in constants_of(best.state, n)] for n in best.state.apart}
    negligible = [name for name, at in places.items() if np.ptp(step[at]) < SWING[name]]
    gone_apart = (*idle, *(name for name in state.apart if name not in best.state.apart), *negligible)
    sizes = _sizes_beside(best, [name for name in causes if name not in gone])
    return Forms(sized_terms(best.state, best.terms), gone, tuple(dict.fromkeys(gone_apart)), rivals, sizes, shown)


def _without(state: SelectionState, effects: Sequence[str], apart: tuple[str, ...]) -> SelectionState:
    """The state without some of its additions and of its offsets, at the optimum of what is left."""
    kept = tuple(name for name in state.active if name not in effects)
    return refitted(moved(state, state.full.at_neutral(state.theta, effects), kept, apart))


def _reached(bare: SelectionState, state: SelectionState, shown: Collection[str]) -> list[str]:
    """Coefficients that lack something without what is contested: all, where the residuals are no coefficients."""
    if not state.of_coefficients:
        return list(state.responses.model.coefficients)
    more = float(state.products.count.sum()) * np.log(bare.best.variance / state.best.variance)
    lacking = [nats(x, state.variance_inflation) > state.settings.ambiguous for x in more]
    return [n for n, lacks in zip(state.outputs, lacking, strict=True) if lacks or n in shown or n in state.apart]


def _as_term(state: SelectionState, cause: str) -> Component | None:
    """The smooth term of one coefficient that an effect of the aerodynamics is, by another name."""
    aerodynamic = any(e.name == cause and e.kind is Kind.AERODYNAMICS for e in state.full.candidates)
    column = shapes.term_of(state, cause) if aerodynamic else None
    return column.component if column is not None and _is_smooth(column.term) else None


def _is_smooth(term: ProductTerm) -> bool:
    """Whether it is a function of the state of motion: memory and separated flow are none."""
    return not _is_lag(term) and shapes.SEPARATED not in term.factors


def _is_lag(term: ProductTerm) -> bool:
    return any(factor.code is None for factor in term.factors)


def _other_forms(state: SelectionState, effects: Sequence[str], components: Sequence[Component]) -> list[Component]:
    """The components that are no additions `effects` in other words."""
    by_coefficient = {c.coefficient: [x for x in components if x.coefficient == c.coefficient] for c in components}
    groups = [(group, shapes.imitated(state, effects, group)) for group in by_coefficient.values()]
    return [c for group, made in groups for c, share in zip(group, made, strict=True) if share <= shapes.SAME]


def _beside(
    state: SelectionState,
    reached: list[str],
    chosen: Sequence[SelectedTerm],
    effects: list[str],
    full: SelectionState,
    able: Callable[[ProductTerm], bool] = _is_smooth,
) -> list[SelectedTerm]:
    """Terms that are `able`, no other form of `effects`, and earn their cost beside those chosen, the best first."""
    terms = list(chosen)
    for name in reached:
        those = {c.component.label: c for c in columns_of(state, name) if able(c.term)}
        columns = [those[c.label] for c in _other_forms(full, effects, [c.component for c in those.values()])]
        for _ in range(state.settings.terms_most if columns else 0):
            best, explained = leader(state, [columns], [f.column for f in terms])
            if explained <= best.cost:
                break
            terms.append(best)
    return terms


def _idle(model: _Model, curves: Sequence[Component]) -> dict[str, Component]:
    """Coefficients whose offsets a polynomial explains as well, and that."""
    explained, least = dict[str, Component](), -model.state.settings.ambiguous
    for name in model.state.apart:
        bare = model.less(name)
        gains = [(replace(bare, functions=(f,)).refitted().beyond(model), f) for f in curves if f.coefficient == name]
        gain, best = max(gains, key=lambda pair: pair[0])
        explained |= {name: best} if gain > least else {}
    return explained


def _best_model(start: _Model, models: Sequence[_Model]) -> _Model:
    """The model that explains most of those that take the place of the first, if it is decisively better; or that."""

    def able(model: _Model) -> bool:
        """Whether terms replace something, are identified within manoeuvres, and predict hold-out data no worse."""
        least = start.state.settings.decisive
        if not model.beyond(start, least) > least:
            return False
        inside = replace(model, state=moved(model.state, model.state.theta, apart=start.state.apart))
        fewer = model.state.active != start.state.active or model.state.apart != start.state.apart
        there = inside.beyond(replace(inside, terms=(), functions=()), 0.0) > 0.0
        return bool(fewer) and there and not inside.degrades(start)

    return max(filter(able, models), key=lambda model: model.beyond(start), default=start)


SHOWN = 4  # parts of a form that are listed beside a cause


def _rivals(best: _Model, causes: Sequence[str], others: Sequence[_Model]) -> dict[str, tuple[str, float]]:
    """Forms of `others`, or in place of one cause, that explain as well as causes, and by how many nats less."""
    settings, rivals = best.state.settings, dict[str, tuple[str, float]]()
    for other in (*others, *best.in_place_of(causes), *side_by_side(best.lagging, causes)):
        gone = [name for name in causes if name not in other.state.active]
        had = {component.label for component in best.components}
        labels = [component.label for component in other.components if component.label not in had]
        if not (gone and labels) or (lost := best.beyond(other)) >= settings.ambiguous or other.degrades(best):
            continue
        more = f" and {len(labels) - SHOWN} more" if len(labels) > SHOWN else ""
        form = f"a form ({', '.join(labels[:SHOWN])}{more})"
        rivals |= {name: (form, lost) for name in gone if name not in rivals or lost < rivals[name][1]}
    return rivals


def _sizes_beside(model: _Model, causes: Sequence[str]) -> dict[str, Size]:
    wide = model.wide
    fit, free = wide.best, wide.full.model.free
    sds = np.sqrt(np.diag(screening.uncertainty(wide)))
    step, sd = (dict(zip(fit.columns, x, strict=True)) for x in (fit.step, sds))
    columns = [int(column) for column in wide.full.own_columns(*causes) if column in step]
    return {
        free[c].name: Size(float(np.clip(x, *free[c].bounds)), float(sd[c]), free[c].unit, not low < x < high)
        for c in columns
        for x, (low, high) in [(wide.theta[c] + step[c], free[c].bounds)]
    }
