"""Structure that no effect of the catalogue explains but that a recorded channel, or a period, predicts.

A smooth function of each channel, or a sinusoid, stands for election like an effect. It is taken for real only if its
score is beyond noise-only replicates and it predicts data left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.result import UnexplainedStructure
from bayes_aero.diagnosis.screening.autocorrelation import autocorrelation_of
from bayes_aero.diagnosis.screening.regression import Fit, Products
from bayes_aero.diagnosis.screening.screening import explained_shares, screen
from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState
from bayes_aero.diagnosis.selection.cross_validation import holdout_deviance_gain
from bayes_aero.diagnosis.selection.forward_selection import Extension, removed
from bayes_aero.inference.variance.autoregression import ORDER

PERIODS = tuple(np.round(np.geomspace(0.6, 30.0, 48), 3))  # s
SKIPPED = ("ax", "ay", "az", "p_dot", "q_dot", "r_dot", "alpha_dot")  # responses themselves, not causes


@dataclass(frozen=True)
class Left:
    """Unknown structure, and named causes that were only its proxies."""

    unknown: tuple[UnexplainedStructure, ...]
    replaced: tuple[str, ...]


def unexplained(extension: Extension, *, seed: int) -> Left:
    """Look at what the extended model leaves; then whether a component explains a named cause better than itself."""
    found: list[UnexplainedStructure] = []
    state = extension.state
    chosen: list[Component] = []
    for number in range(state.settings.unnamed_most):
        one = _best(state, chosen, seed + number)
        if one is None:
            break
        component, share, p = one
        chosen.append(component)
        coefficient, channel = component.label.split(" over ")
        found.append(UnexplainedStructure(coefficient, channel, share, p))
    if found:
        return Left(tuple(found), _superfluous(extension, chosen))
    stand_ins = _proxies(extension)
    if stand_ins is None:
        return Left((), ())
    component, share, names = stand_ins
    coefficient, channel = component.label.split(" over ")
    return Left((UnexplainedStructure(coefficient, channel, share, float("nan")),), names)


def _superfluous(extension: Extension, chosen: Sequence[Component]) -> tuple[str, ...]:
    """Named causes of which little is left once the components are in: they had stood in for them."""
    state = extension.state
    deviance, count = _with(state, chosen)
    dropped = []
    for name in extension.causes:
        rest, _ = _with(removed(state, name), chosen)
        if 1.0 - np.exp(-max(rest - deviance, 0.0) / count) < state.settings.unnamed_share:
            dropped.append(name)
    return tuple(dropped)


def _with(state: SelectionState, chosen: Sequence[Component]) -> tuple[float, float]:
    """Deviance of the active effects and the chosen components together, and the number of blocks."""
    wide = with_components(state, (), chosen, state.folds)
    return wide.fit().deviance, float(wide.products.count.sum())


def _best(state: SelectionState, chosen: Sequence[Component], seed: int) -> tuple[Component, float, float] | None:
    """The component that explains most of what is left, if it is beyond chance and predicts what was left out."""
    for folds, components, least in _families(state):
        trial = with_components(state, components, chosen, folds)
        fit = trial.fit()
        leaders = screen(trial, fit, seed=seed, nulls=False).candidate_scores[: state.settings.unnamed_tried]
        for standing in leaders:
            own = np.array(standing.columns, int)
            wide = np.concatenate([trial.columns(), own])
            gained = holdout_deviance_gain(trial, wide)
            share = _share(trial, own)
            if gained <= 0.0 or share < least:
                continue
            p = _p_value(trial, fit, trial.products.fit(wide, trial.mean, trial.precision), share, seed)
            if p <= state.settings.unnamed_false_alarm_rate:
                return next(c for c in components if c.label == standing.effect), share, p
    return None


def _p_value(state: SelectionState, fit: Fit, wider: Fit, share: float, seed: int) -> float:
    """How often noise alone lets some component explain so large a share.

    The noise has the colour that is left with the component in: with it out, the structure itself would pass for slow
    noise, under which anything goes.
    """
    colour = autocorrelation_of(state.left(wider), state.folds)
    shares = explained_shares(state, fit, colour, seed, state.settings.unnamed_replicates)
    return float((1 + np.sum(shares >= share)) / (1 + len(shares)))


def _share(state: SelectionState, own: np.ndarray) -> float:
    """Share of a coefficient's remaining variance that the component takes away, at best over the coefficients."""
    before = state.fit()
    after = state.products.fit(np.concatenate([before.columns, own]), state.mean, state.precision)
    return float(np.max(1.0 - after.variance / before.variance))


def _proxies(extension: Extension) -> tuple[Component, float, tuple[str, ...]] | None:
    """A single component that predicts unseen data clearly better than all named causes of the coefficients together.

    The causes were then stand-ins for something that is in no catalogue. Effects are taken out to first order.
    """
    state = extension.state
    if not extension.causes:
        return None
    own = state.full.own_columns(*state.active)
    best = None
    for folds, components, least in _families(state):
        trial = with_components(state, components, (), folds)
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
            margin, share = (
                gained - state.settings.stand_in * max(known, 0.0) - 6.0 * state.variance_inflation,
                _share(taken_out, columns),
            )
            if margin > 0.0 and share >= least and (best is None or margin > best[0]):
                best = (margin, components[i], share)
    return None if best is None else (best[1], best[2], extension.causes)


def has_chunks(state: SelectionState) -> bool:
    """Whether every manoeuvre is long enough for a sinusoid to be fitted to parts of it and predict the others."""
    return all(part.stop - part.start > ORDER for part in _chunks(state))


def _families(state: SelectionState) -> tuple[tuple[Sequence[slice], list[Component], float], ...]:
    """The kinds of components that the record can test: the folds by which they must predict, themselves, and the least
    share of a verdict."""
    s, alone = state.settings, len(state.responses.flights.lengths) == 1
    channel, wave = (s.single_share, s.single_share) if alone else (s.unnamed_share, s.periodic_share)
    smooth = state.folds, smooth_components(state), channel
    return (smooth, (_chunks(state), periodic_components(state), wave)) if has_chunks(state) else (smooth,)


def smooth_components(state: SelectionState) -> list[Component]:
    """A smooth function of every recorded channel that moves, in each coefficient."""
    signals = state.responses.evaluate(state.theta)[1]
    names = [n for n in (*state.responses.flights.recorded, "elapsed", "X") if n in signals and n not in SKIPPED]
    found = []
    for name in names:
        x = np.asarray(state.responses.block(signals[name]))
        if np.ptp(x) <= 1e-6 * max(1.0, float(np.abs(x).max())):
            continue
        basis = _basis(x, state.settings.knots)
        found += [Component(f"{c} over {name}", c, basis) for c in state.outputs]
    return found


def periodic_components(state: SelectionState) -> list[Component]:
    """A sinusoid of each period and free phase in each manoeuvre, in each coefficient."""
    elapsed = np.asarray(state.responses.block(state.responses.flights.channels["elapsed"]))
    manoeuvre = state.responses.manoeuvre
    found = []
    for period in PERIODS:
        if period < 4.0 * state.responses.seconds:
            continue
        phase = 2.0 * np.pi * elapsed / period
        wave = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        basis = np.concatenate([wave * (manoeuvre == k)[:, None] for k in range(int(manoeuvre[-1]) + 1)], axis=1)
        found += [Component(f"{c} over time, period {period:.3g} s", c, basis) for c in state.outputs]
    return found


def _basis(x: Float[np.ndarray, " m"], count: int) -> Float[np.ndarray, "m w"]:
    """A line and radial bumps between quantiles, scaled to unit deviation; constants belong to the model."""
    knots = np.quantile(x, np.linspace(0.02, 0.98, count))
    width = max((knots[-1] - knots[0]) / (count - 1), 1e-12)
    columns = [x - x.mean(), *(np.exp(-0.5 * ((x - k) / width) ** 2) for k in knots[1:-1])]
    B = np.stack(columns, axis=1)
    B = B - B.mean(axis=0)
    return B / np.maximum(B.std(axis=0), 1e-12)


def _chunks(state: SelectionState) -> tuple[slice, ...]:
    edges = [np.flatnonzero(state.responses.manoeuvre == k) for k in range(len(state.responses.flights.lengths))]
    parts = [part for e in edges for part in np.array_split(e, state.settings.manoeuvre_parts)]
    return tuple(slice(int(p[0]) + 2, int(p[-1]) - 1) for p in parts)


def with_components(
    state: SelectionState, components: Sequence[Component], chosen: Sequence[Component], folds: Sequence[slice]
) -> SelectionState:
    """The state in which components stand for election in place of effects; those `chosen` are in."""
    extra, width = [], 0
    for component in (*chosen, *components):
        block = np.zeros((*state.residual.shape, component.basis.shape[1]))
        block[:, state.outputs.index(component.coefficient)] = component.basis
        extra.append(block)
        width += component.basis.shape[1]
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
