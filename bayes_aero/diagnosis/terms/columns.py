"""The library's terms as columns of a regression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import moves, noise_channels
from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState
from bayes_aero.diagnosis.terms.library import Signals, Term, library
from bayes_aero.physics.coefficient_names import LATERAL
from bayes_aero.physics.filters import smooth_joined
from bayes_aero.residuals.added_coefficients import AddedCoefficients
from bayes_aero.residuals.added_to_filter import AddedToFilter
from bayes_aero.residuals.filter_error import FilterError
from bayes_aero.residuals.output_error import OutputError

SEPARATES = 0.9  # X below which a flight tells what acts in separated flow alone; our choice


SAME = 0.999  # squared cosine of what an effect and a term do to a coefficient, beyond which they are one; our choice


@dataclass(frozen=True)
class Column:
    """A term of one coefficient as these flights show it: `component` is what `scale` times the term adds to the
    residuals, about as large as these; `spread` is the term's own deviation."""

    term: Term
    component: Component
    scale: float
    spread: float


def columns_of(state: SelectionState, coefficient: str) -> list[Column]:
    """The library's terms in one coefficient, as the residuals show them.

    Where these are of coefficients: smoothed and averaged over blocks as the coefficient is, to unit root mean square.
    Where they are of flights: flown, to first order (see `AddedCoefficients`, `AddedToFilter`).
    """
    if isinstance(state.responses, OutputError):
        return _flown(state, coefficient)
    responses = state.responses
    flights, signals = responses.flights, responses.evaluate(state.theta)[1]
    terms = _terms(state, signals, coefficient)
    ends = tuple(np.asarray(flights.channels[name]) for name in ("first", "last"))
    raw = [smooth_joined(t.evaluate(signals, flights.aircraft), *ends) for t in terms]
    rows = np.asarray(responses.block(np.stack(raw, axis=1)))
    scale, at, found = np.sqrt(np.mean(rows**2, axis=0)), state.outputs.index(coefficient), []
    for term, x, size in zip(terms, rows.T, scale, strict=True):
        if size > 0.0:
            basis = np.zeros((len(x), len(state.outputs), 1))
            basis[:, at, 0] = x / size
            found.append(Column(term, _component(coefficient, term, basis), float(size), float(x.std())))
    return found


def _flown(state: SelectionState, coefficient: str) -> list[Column]:
    """Sensitivities of flown residuals, each as large as the residual of the median output, all outputs counted."""
    responses = state.responses
    assert isinstance(responses, OutputError)
    of = AddedToFilter if isinstance(responses, FilterError) else AddedCoefficients
    added = of(responses, state.theta)  # pyright: ignore[reportArgumentType]
    signals = added.signals()
    terms = _terms(state, signals, coefficient)

    def made(signals: Signals) -> Float[np.ndarray, "d n"]:
        return np.stack([t.evaluate(signals, responses.flights.aircraft) for t in terms])

    series, keep = made(signals), [responses.outputs.index(name) for name in state.outputs]
    slopes = added.slopes(coefficient, made)[:, :, keep]
    deviation = np.std(state.residual / state.noise_growth, axis=0)
    scale = np.sqrt(np.mean((slopes / deviation) ** 2, axis=(1, 2))) * float(np.median(deviation))
    return [
        Column(term, _component(coefficient, term, S[:, :, None] / size), float(size), float(x.std()))
        for term, S, size, x in zip(terms, slopes, scale, series, strict=True)
        if np.isfinite(size) and size > 0.0
    ]


def term_of(state: SelectionState, effect: str) -> Column | None:
    """The term of one coefficient that an effect of one parameter is, by another name; None where it is none."""
    one = next(e for e in state.full.model.effects if e.name == effect)
    acts_on = {name.removesuffix("_attached") for name in one.example.increments}
    if len(one.parameters) > 1 or len(acts_on) > 1 or not acts_on <= set(state.outputs):
        return None
    (coefficient,) = acts_on
    at, found = state.outputs.index(coefficient), columns_of(state, coefficient)
    L = np.stack([column.component.basis[:, at, 0] for column in found])
    x = state.S[:, at, state.full.own_columns(effect)[0]]
    alike = (L @ x) ** 2 / np.maximum(np.sum(L**2, axis=1) * (x @ x), 1e-300)
    return found[int(np.argmax(alike))] if np.max(alike, initial=0.0) > SAME else None


def _component(coefficient: str, term: Term, basis: Float[np.ndarray, "m c 1"]) -> Component:
    return Component(f"{coefficient} over {term.name}", basis)


def _terms(state: SelectionState, signals: Signals, coefficient: str) -> Sequence[Term]:
    """Terms that these flights can tell."""
    flights = state.responses.flights
    noise = noise_channels(flights)

    def able(channel: str) -> bool:
        return channel in signals and channel not in noise and moves(signals[channel], flights, 1e-6)

    separated = bool(np.min(np.asarray(signals["X"])) < SEPARATES)
    return library(signals, flights.aircraft, able, lateral=coefficient in LATERAL, separated=separated)
