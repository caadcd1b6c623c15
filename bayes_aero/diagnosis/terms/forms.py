"""Names for unexplained structure: terms in place of the functions by which it was found, and of causes beside it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.result import FoundTerm, UnexplainedStructure
from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.screening.autocorrelation import autocorrelation_of
from bayes_aero.diagnosis.screening.parameter_fit import inflation_along, optimum, refitted
from bayes_aero.diagnosis.screening.regression import Products, RegressionFit
from bayes_aero.diagnosis.screening.screening import uncertainty
from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState, moved
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.diagnosis.selection.holdout import LeftOut, truncated
from bayes_aero.diagnosis.structure.components import (
    SAME,
    Trial,
    columns_of,
    is_periodic,
    likeness,
    polynomials,
    term_of,
)
from bayes_aero.diagnosis.structure.unexplained import Left, constants_of, superfluous
from bayes_aero.diagnosis.terms.library import SEPARATED, ProductTerm
from bayes_aero.diagnosis.terms.search import (
    SWING,
    SelectedTerm,
    components_of,
    leader,
    sized,
    terms_of_coefficient,
    terms_of_flights,
)
from bayes_aero.effect import Kind
from bayes_aero.inference.covariance import nats
from bayes_aero.progress import Progress


class Forms(NamedTuple):
    """Terms that were found, and what they are instead of."""

    terms: tuple[FoundTerm, ...]
    replaced: tuple[str, ...]  # causes of which little is left beside them
    idle: tuple[str, ...] = ()  # coefficients whose offsets between manoeuvres the terms explain
    rivals: Mapping[str, tuple[str, float]] = MappingProxyType({})  # terms as good as a cause; nats they explain less
    sizes: Mapping[str, Size] = MappingProxyType({})  # of parameters of causes that are left, beside the terms
    functions: tuple[tuple[Component, float], ...] = ()  # polynomials beside the terms, and their shares
    unknown: tuple[UnexplainedStructure, ...] = ()  # the structure that terms of flights describe


NOTHING = Left((), ())
SHOWN = 4  # parts of a form that are listed beside a cause


@dataclass(frozen=True, eq=False)
class _Model:
    """What explains the flights: a state with its additions and offsets, terms, and polynomials for what is left."""

    state: SelectionState
    terms: tuple[SelectedTerm, ...] = ()
    functions: tuple[Component, ...] = ()

    @property
    def wide(self) -> SelectionState:
        """The state with the terms in."""
        return self.state.with_components((), self.components)

    @property
    def components(self) -> tuple[Component, ...]:
        """Terms and polynomials."""
        return (*components_of(self.terms), *self.functions)

    @cached_property
    def fitted(self) -> tuple[RegressionFit, Float[np.ndarray, "m c"]]:
        """The fit of `wide` and what it leaves, from the columns that are in alone."""
        state, own, columns = self.state, [one.basis for one in self.components], self.state.columns()
        S = np.concatenate([state.S[:, :, columns], *own], axis=2) / state.noise_growth[:, :, None]
        residual, more = state.residual / state.noise_growth, S.shape[2] - len(columns)
        size = float(np.median(np.std(residual, axis=0)))
        precision = np.append(state.precision[columns], np.full(more, state.variance_inflation / (10 * size) ** 2))
        mean = np.append(state.mean[columns], np.zeros(more))
        best = Products.of(residual, S, state.folds).fit(np.arange(S.shape[2]), mean, precision)
        return best, residual - S @ best.step

    @cached_property
    def cost(self) -> float:
        """Nats of its parameters, and of the choices that they are."""
        state, own = self.state, {e.name: e for e in self.state.full.candidates}
        causes = sum(len(own[name].parameters) + np.log(len(own)) for name in state.active)
        offsets = len(state.apart) * (len(state.responses.flights.lengths) - 1)
        functions = sum(f.basis.shape[2] + 1.0 for f in self.functions)
        return float(causes + offsets + functions + sum(one.cost for one in self.terms))

    def less(self, item: str | SelectedTerm) -> _Model:
        """Without a term, a cause, or the offsets of a coefficient; the others as they were."""
        state = self.state
        if isinstance(item, SelectedTerm):
            return replace(self, terms=tuple(one for one in self.terms if one is not item))
        if item in state.apart:
            return replace(self, state=moved(state, state.theta, apart=tuple(n for n in state.apart if n != item)))
        return replace(self, state=truncated(state, [name for name in state.active if name != item]))

    def beyond(self, other: _Model) -> float:
        """Nats by which it explains more than another, the costs of both counted."""
        # What tells the two apart is the residual along the difference of what they explain.
        state, fits, lefts = self.state, (self.fitted[0], other.fitted[0]), (self.fitted[1], other.fitted[1])
        better = int(fits[1].deviance < fits[0].deviance)
        D, weight = np.where(state.inside[:, None], lefts[0] - lefts[1], 0.0)[:, :, None], 1.0 / fits[better].variance
        colour, blocks = autocorrelation_of(lefts[better], state.folds), state.responses.jackknife_blocks
        (inflation,) = inflation_along(D, weight, state.folds, colour, lefts[better], blocks)
        return nats(fits[1].deviance - fits[0].deviance, float(inflation)) - self.cost + other.cost

    def degrades(self, other: _Model) -> bool:
        """Whether hold-out data are predicted worse than by another."""
        before, after = (LeftOut.first_order(one.wide, one.state.active) for one in (other, self))
        return self.state.settings.degrades(*after.gain(before))


def forms_of(extension: Extension, left: Left, *, seed: int) -> Forms:
    """Terms for all structure that is `left`; periods have none."""
    functions: dict[str, list[Component]] = {}
    for function in left.functions:
        if not is_periodic(function):
            functions.setdefault(function.coefficient, []).append(function)

    def sought(state: SelectionState) -> list[SelectedTerm]:
        found = [terms_of_coefficient(state, name, own, seed=seed) for name, own in functions.items()]
        return [one for terms in found for one in terms]

    instead = contest(extension, left)
    if instead.terms or instead.replaced:
        return instead
    causes = [name for name in extension.causes if name not in left.replaced]
    state = extension.state.without([name for name in left.replaced if name in extension.state.active])
    found = sought(state)
    if not found:
        return instead
    replaced = superfluous(state, causes, components_of(found))
    if replaced:  # terms are sought again without causes that only stood in for one
        state = state.without(replaced)
        found = sought(state)
    return instead._replace(terms=sized(state, found), replaced=replaced if found else ())


def flown_forms(extension: Extension, *, seed: int, progress: Progress | None = None) -> Forms:
    """Terms of all coefficients for what an extended model leaves of trajectories or innovations."""
    if progress:
        progress("terms", 0.0)
    instead, state = contest(extension), extension.state
    if instead.terms or instead.replaced:
        return instead._replace(unknown=described((), instead))
    found, replaced = terms_of_flights(state, seed), ()
    if found and (replaced := superfluous(state, extension.causes, components_of(found))):
        bare = state.without(replaced)
        again = terms_of_flights(bare, seed)
        state, found, replaced = (bare, again, replaced) if again else (state, found, ())
    shown = [(one, one.column.component) for one in found]
    unknown = [UnexplainedStructure(c.coefficient, c.channel, f.share, f.p_value, f.elsewhere) for f, c in shown]
    forms = instead._replace(terms=sized(state, found), replaced=replaced) if found else instead
    return forms._replace(unknown=described(unknown, instead))


def described(unknown: Sequence[UnexplainedStructure], found: Forms) -> tuple[UnexplainedStructure, ...]:
    """Structure by the first function that shows it, where terms describe all of it."""
    known = {term.coefficient: term for term in reversed(found.terms)}
    first = {u.coefficient: u for u in reversed(unknown)}
    more = [UnexplainedStructure(c, t.term.name, t.share, float("nan")) for c, t in known.items() if c not in first]
    more += [
        UnexplainedStructure(function.coefficient, function.channel, share, float("nan"))
        for function, share in found.functions
        if function.coefficient not in {**first, **known}
    ]
    return (*(u for u in unknown if u.coefficient not in known or u is first[u.coefficient]), *more)


def contest(extension: Extension, left: Left = NOTHING) -> Forms:
    """Terms in place of causes, and of offsets between manoeuvres, that only stood in for them; and those that explain
    as well as causes that are left.

    A wrong form of a coefficient leaves residuals that follow the state, as a stall or the error of a sensor does, and
    differ between manoeuvres at different states, as offsets do. Terms are sought without all of them; then everything
    is in, and what does not earn its cost goes out, the least useful first. A term of the library that is an effect of
    the aerodynamics is no rival of it; beside other terms of its coefficient it is one of them.

    Args:
        extension: by the catalogue.
        left: structure, and causes that are replaced already.
    """
    state, causes = extension.state, extension.causes
    aerodynamic = {e.name for e in state.full.candidates if e.kind is Kind.AERODYNAMICS}
    columns = {name: term_of(state, name) for name in causes if name in aerodynamic}
    named = {name: c.component for name, c in columns.items() if c is not None and _is_smooth(c.term)}
    rest = [name for name in causes if name not in named]
    if not (rest or state.apart):
        return Forms((), ())
    start, named_only = _Model(state), _without(state, rest, ())
    reached = _reached(named_only, state, {f.coefficient for f in left.functions})
    named = {name: component for name, component in named.items() if component.coefficient in reached}
    models = list[_Model]()
    for apart in ((), state.apart) if state.apart else ((),):
        terms = _beside(_without(state, [*rest, *named], apart), reached, (), rest, state)
        by_name = {
            name: [f for f in components_of(terms) if f.coefficient == c.coefficient] for name, c in named.items()
        }
        alone = [name for name, own in by_name.items() if [f.label for f in own] in ([], [named[name].label])]
        same = {named[name].label for name in alone}
        out = [*(name for name in named if name not in alone), *left.replaced]
        more = tuple(one for one in terms if one.column.component.label not in same)
        models += [_Model(_without(state, out, state.apart), more)] if more else []
    curves = [one for coefficient in reached for one in polynomials(named_only, coefficient)]
    bare = [replace(model, state=_without(model.state, rest, ())) for model in models]
    wholes, items = [_fitted(_curved(model, curves)) for model in bare], [*rest, *state.apart]
    tried = [_eliminated(model, items, whole.functions) for model, whole in zip(models, wholes, strict=True)]
    best = _best(start, tried)
    if best is start:
        tried.append(_eliminated(_one_by_one(start, rest), items, curves))
        best = _best(start, tried)
    idle = _idle(replace(best, functions=()), curves)
    rivals = _rivals(best, [name for name in rest if name in best.state.active], [*wholes, *tried])
    functions = [*best.functions, *(f for f in idle.values() if f not in best.functions)]
    shares = [(f, Trial(best.state, f, [c for c in best.components if c is not f]).share) for f in functions]
    least = state.least_share(state.settings.unnamed_share)
    shown = tuple((f, share) for f, share in shares if share >= least)
    if best is start:
        return Forms((), (), idle=tuple(idle), rivals=rivals, functions=shown)
    gone = tuple(name for name in causes if name not in best.state.active)
    gone_apart = (*idle, *(name for name in state.apart if name not in best.state.apart), *_negligible(best))
    terms, sizes = sized(best.state, best.terms), _sizes(best, [name for name in causes if name not in gone])
    return Forms(terms, gone, tuple(dict.fromkeys(gone_apart)), rivals, sizes, shown)


def _without(state: SelectionState, effects: Sequence[str], apart: tuple[str, ...]) -> SelectionState:
    """The state without some of its additions and of its offsets, at the optimum of what is left."""
    kept = tuple(name for name in state.active if name not in effects)
    return refitted(moved(state, state.full.at_neutral(state.theta, effects), kept, apart))[0]


def _reached(bare: SelectionState, state: SelectionState, shown: Collection[str]) -> list[str]:
    """Coefficients that lack something without what is contested: all, where the residuals are no coefficients."""
    if state.outputs != state.responses.model.coefficients:
        return list(state.responses.model.coefficients)
    more = float(state.products.count.sum()) * np.log(bare.fit().variance / state.fit().variance)
    lacking = [nats(x, state.variance_inflation) > state.settings.ambiguous for x in more]
    return [n for n, lacks in zip(state.outputs, lacking, strict=True) if lacks or n in shown or n in state.apart]


def _is_smooth(term: ProductTerm) -> bool:
    """Whether it is a function of the state of motion: memory and separated flow are none."""
    return all(f.code is not None and f is not SEPARATED for f in term.factors)


def _beside(
    state: SelectionState,
    reached: Sequence[str],
    chosen: Sequence[SelectedTerm],
    effects: Sequence[str],
    full: SelectionState,
) -> list[SelectedTerm]:
    """Smooth terms, no other form of `effects`, that earn their cost beside those chosen, the best first."""
    found = list(chosen)
    for name in reached:
        columns = [c for c in columns_of(state, name) if _is_smooth(c.term) and likeness(full, effects, c) <= SAME]
        for _ in range(state.settings.terms_most):
            one, explained, _ = leader(state, columns, [f.column for f in found])
            if explained <= one.cost:
                break
            found.append(one)
    return found


def _curved(model: _Model, curves: Sequence[Component]) -> _Model:
    """With the functions that earn their cost."""
    for one in curves:
        wider = replace(model, functions=(*model.functions, one))
        model = wider if wider.beyond(model) > 0.0 else model
    return model


def _idle(model: _Model, curves: Sequence[Component]) -> dict[str, Component]:
    """Coefficients whose offsets a polynomial explains as well, and that."""
    found, least = dict[str, Component](), -model.state.settings.ambiguous
    for name in model.state.apart:
        own = [(_fitted(_instead(model, name, [f])).beyond(model), f) for f in curves if f.coefficient == name]
        gain, best = max(own, key=lambda pair: pair[0])
        found |= {name: best} if gain > least else {}
    return found


def _negligible(model: _Model) -> list[str]:
    """Coefficients whose offsets, beside the terms, are smaller than what is worth modelling."""
    columns, step = list(model.state.columns()), model.fitted[0].step
    places = {n: [columns.index(column) for column in constants_of(model.state, n)] for n in model.state.apart}
    return [name for name, at in places.items() if np.ptp(step[at]) < SWING[name]]


def _instead(model: _Model, item: str, functions: Sequence[Component]) -> _Model:
    """With functions in place of a cause or of offsets."""
    return replace(model.less(item), functions=tuple(functions))


def _eliminated(model: _Model, items: Sequence[str], curves: Sequence[Component]) -> _Model:
    """Without what does not earn its cost, the least useful first: causes and offsets `items` must explain more than
    functions in their place, terms more than nothing."""
    while True:
        inside = [item for item in items if item in (*model.state.active, *model.state.apart)]
        trials = [model.less(item) for item in (*inside, *model.terms)]
        rivals = [*(_instead(model, item, curves) for item in inside), *trials[len(inside) :]]
        gains = [rival.beyond(model) for rival in rivals]
        if not gains or max(gains) <= 0.0:
            return _curved(model, curves)
        best = trials[int(np.argmax(gains))]
        model = best if best.state is model.state else _fitted(best)


def _fitted(model: _Model) -> _Model:
    """With the parameters at the optimum beside the terms."""
    state = model.wide
    return replace(model, state=moved(model.state, optimum(state, range(len(state.folds)))))


def _best(start: _Model, models: Sequence[_Model]) -> _Model:
    """The model that explains most of those that take the place of the first, if it is decisively better; or that."""

    def takes_its_place(model: _Model) -> bool:
        """Whether terms are there in place of something, are identified within manoeuvres, as causes must be, and
        predict hold-out data no worse."""
        inside = replace(model, state=moved(model.state, model.state.theta, apart=start.state.apart))
        fewer = model.state.active != start.state.active or model.state.apart != start.state.apart
        there = inside.beyond(replace(inside, terms=(), functions=())) > 0.0
        return bool(fewer) and there and not inside.degrades(start)

    able = [model for model in models if model.beyond(start) > start.state.settings.decisive]
    able = [model for model in able if takes_its_place(model)]
    return max(able, key=lambda model: model.beyond(start), default=start)


def _less_one(best: _Model, name: str) -> _Model:
    """With terms, and functions, in place of one cause."""
    state = _without(best.state, [name], best.state.apart)
    reached = _reached(state, best.state, ())
    terms = tuple(_beside(state, reached, best.terms, [name], best.state))
    curves = [one for coefficient in reached for one in polynomials(state, coefficient)]
    return _curved(_Model(state, terms, best.functions), curves)


def _one_by_one(model: _Model, causes: Sequence[str]) -> _Model:
    """With terms in place of one cause after another, as long as they are decisively better."""
    while True:
        others = [_less_one(model, name) for name in causes if name in model.state.active]
        better = [(gain, other) for other in others if (gain := other.beyond(model)) > model.state.settings.decisive]
        if not better:
            return model
        model = max(better, key=lambda pair: pair[0])[1]


def _rivals(best: _Model, causes: Sequence[str], others: Sequence[_Model]) -> dict[str, tuple[str, float]]:
    """Forms of `others`, or in place of one cause, that explain as well as causes, and by how many nats less."""
    settings, found = best.state.settings, dict[str, tuple[str, float]]()
    for other in (*others, *(_less_one(best, name) for name in causes)):
        gone = [name for name in causes if name not in other.state.active]
        had = {one.label for one in best.components}
        own = [one.label for one in other.components if one.label not in had]
        if not (gone and own) or (lost := best.beyond(other)) >= settings.ambiguous or other.degrades(best):
            continue
        form = ", ".join(own[:SHOWN]) + (f" and {len(own) - SHOWN} more" if len(own) > SHOWN else "")
        found |= {name: (f"a form ({form})", lost) for name in gone if name not in found or lost < found[name][1]}
    return found


def _sizes(model: _Model, causes: Sequence[str]) -> dict[str, Size]:
    """Parameters of causes beside terms and polynomials, to first order."""
    wide = model.wide
    fit, free = wide.fit(), wide.full.model.free
    sds = np.sqrt(np.diag(uncertainty(wide, fit)))
    step, sd = (dict(zip(fit.columns, x, strict=True)) for x in (fit.step, sds))
    own = [int(column) for column in wide.full.own_columns(*causes) if column in step]
    return {
        free[c].name: Size(float(np.clip(x, *free[c].bounds)), float(sd[c]), free[c].unit, not low < x < high)
        for c in own
        for x, (low, high) in [(wide.theta[c] + step[c], free[c].bounds)]
    }
