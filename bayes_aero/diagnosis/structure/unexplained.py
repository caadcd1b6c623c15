"""Structure that no effect of the catalogue explains but that a recorded channel, a period or the change of a parameter
does.

A smooth function of each channel, a sinusoid, or the change, is a candidate like an effect. It is taken for real
only if its score is beyond noise-only replicates and it predicts data left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int
from scipy.special import chdtrc

from bayes_aero.diagnosis.result import ParameterChange, UnexplainedStructure
from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.screening.regression import Products, inverse
from bayes_aero.diagnosis.screening.screening import screen, uncertainty
from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState, moved
from bayes_aero.diagnosis.selection.forward_selection import Extension, removed
from bayes_aero.diagnosis.selection.holdout import holdout_deviance_gain
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.diagnosis.structure.changes import (
    FoundChange,
    FoundComponent,
    holdout_gain_of,
    sought_change,
    testable,
    told,
)
from bayes_aero.diagnosis.structure.components import (
    Trial,
    chance_of,
    families,
    in_batches,
    null_shares,
    parts_of,
    term_of,
)
from bayes_aero.inference.covariance import nats


@dataclass(frozen=True)
class Left:
    """What the catalogue does not explain."""

    unknown: tuple[UnexplainedStructure, ...]
    replaced: tuple[str, ...]  # named causes that were only its proxies
    changes: tuple[ParameterChange, ...] = ()
    functions: tuple[Component, ...] = ()  # by which the structure was found


def unexplained(extension: Extension, *, seed: int) -> Left:
    """Look at what the extended model leaves; then whether a component explains a named cause better than itself."""
    state, found = extension.state, list[FoundComponent]()
    for number in range(max(state.settings.unnamed_most, len(state.outputs))):
        one = _best(state, [f.component for f in found], seed + number)
        if one is None:
            break
        found.append(one)
        state = one.state
    if found:
        replaced = superfluous(state, extension.causes, [f.component for f in found])
        over = {(f.component.coefficient, f.component.channel) for f in found}
        lines = {n: term_of(state, n) for n in replaced}  # terms of a channel, of which a function of it has all
        line = {n for n, t in lines.items() if t and any((t.component.coefficient, x) in over for x in t.term.channels)}
        return _left(extension, found, tuple(name for name in replaced if name not in line))
    # A component, or the change of a parameter, that predicts unseen data clearly better than all named causes of the
    # coefficients together: they were then stand-ins for something that is in no catalogue.
    proxies = [] if not extension.causes else [_changing_in(extension, seed), _standing_in(extension)]
    margins = [proxy for proxy in proxies if proxy is not None]
    if not margins:
        return Left((), ())
    return _left(extension, [max(margins, key=lambda margin: margin[0])[1]], extension.causes)


def offsets_found(extension: Extension, idle: Sequence[str] = ()) -> tuple[UnexplainedStructure, ...]:
    """Each coefficient not among the `idle` ones, which terms explain, whose constant differs between manoeuvres beyond
    chance, and additions that explain it as well."""
    state, found = extension.state, []
    for name in (n for n in state.apart if n not in idle):
        fewer = moved(state, state.theta, apart=tuple(n for n in state.apart if n != name))
        less, fit = fewer.fit(), state.fit()
        ranking = screen(fewer, less, seed=0, nulls=False).candidate_scores
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
        found.append(UnexplainedStructure(name, "manoeuvre", share, p, tuple(dict.fromkeys(rivals)), offsets))
    return tuple(found)


def constants_of(state: SelectionState, name: str) -> Int[np.ndarray, " k"]:
    """The columns of a coefficient's constants, in the order of the manoeuvres."""
    width, number = len(state.responses.flights.lengths), state.apart.index(name)
    first = len(state.offsets) - width * (len(state.apart) - number)
    return state.offsets[first : first + width]


def _left(extension: Extension, found: Sequence[FoundComponent], replaced: tuple[str, ...]) -> Left:
    """What was found, as it is reported."""
    unknown, changes, chosen = [], [], [f.component for f in found]
    bare = found[-1].state.without([name for name in replaced if name in found[-1].state.active])
    last = extension.steps[-1] if extension.steps else None
    election = None if last is None or last.chosen is not None else last.screening
    for one in found:
        if isinstance(one, FoundChange):
            change = told(bare, one, chosen, election)
            if not (change.between and set(change.ambiguous_with) & _constants(bare)):
                changes.append(change)
        else:
            of = one.component
            unknown.append(UnexplainedStructure(of.coefficient, of.channel, one.share, one.p_value))
    functions = tuple(one.component for one in found if not isinstance(one, FoundChange))
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


def withdrawn(found: Extension, names: Sequence[str], sizes: Mapping[str, Size]) -> Extension:
    """Causes `names` of which little is left beside what is unexplained become nuisances; `sizes` are the others'."""
    causes = tuple(name for name in found.causes if name not in names)
    minor = (*found.minor, *(name for name in found.causes if name in names))
    return replace(found, causes=causes, minor=minor, sizes={**found.sizes, **sizes})


def _best(state: SelectionState, chosen: Sequence[Component], seed: int) -> FoundComponent | None:
    """The component, or the change of a parameter, that explains what is left, is beyond chance and predicts what was
    left out. Of both, the one that predicts it better."""
    smooth, change = _best_function(state, chosen, seed), sought_change(state, chosen, seed=seed)
    if change is not None and (smooth is None or change.gained >= holdout_gain_of(state, smooth.component, chosen)):
        return change
    return smooth


def _best_function(state: SelectionState, chosen: Sequence[Component], seed: int) -> FoundComponent | None:
    """The best function of a channel or of time."""
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
            # How often noise alone lets some component explain so large a share.
            noise = trial.colour, trial.fit.variance, seed
            nulls = [null_shares(state.with_components(batch, chosen, folds), *noise) for batch in batches]
            p = chance_of(trial.share, np.max(nulls, axis=0))
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
    known = holdout_deviance_gain(replace(bare, products=products, folds=parts), np.append(bare.columns(), own))
    found = sought_change(bare, (), seed=seed, least=max(known, 0.0))
    if found is None:
        return None
    margin = _margin(state, found.gained, known)
    return (margin, found) if margin > 0.0 else None


def _margin(state: SelectionState, gained: float, known: float) -> float:
    """Deviance by which a component predicts more than it must to take the place of causes that gain `known`."""
    return gained - state.settings.stand_in * max(known, 0.0) - 6.0 * state.variance_inflation


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
        known = holdout_deviance_gain(taken_out, np.concatenate([bare, own]), bare)
        width = max(len(columns) for columns in trial.component_columns)
        dummy = trial.S.shape[2] - 1
        rows = [np.append(np.append(bare, c), np.full(width - len(c), dummy)) for c in trial.component_columns]
        deviance = products.fit_many(np.array(rows, int), trial.mean, trial.precision)[3]
        for i in np.argsort(deviance)[: state.settings.unnamed_tried]:
            columns = trial.component_columns[i]
            gained = holdout_deviance_gain(taken_out, np.concatenate([bare, columns]), bare)
            margin = _margin(state, gained, known)
            share = taken_out.share_of(columns)
            left = trial.share_of(columns) if margin > 0.0 and share >= least else 0.0
            if left > 0.0 and left_beside(share, left, state.settings) and (best is None or margin > best[0]):
                best = (margin, FoundComponent(state, components[i], share, float("nan")))
    return best


def left_beside(alone: float, beside: float, settings: DiagnosisSettings) -> bool:
    """Whether the share that a function explains `beside` its causes is no small part of that `alone`, without them."""
    return beside >= (settings.stand_in - 1.0) * alone
