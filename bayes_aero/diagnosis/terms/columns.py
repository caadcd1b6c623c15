"""The library's terms as columns of a regression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_aero.diagnosis.candidate_set import noise_channels
from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState
from bayes_aero.diagnosis.terms.library import Term, library
from bayes_aero.physics.coefficient_names import LATERAL
from bayes_aero.physics.filters import smooth_joined

SEPARATES = 0.9  # X below which a flight tells what acts in separated flow alone; our choice


@dataclass(frozen=True)
class Column:
    """A term of one coefficient as these flights show it: `component` has unit root mean square, `scale` is its own."""

    term: Term
    component: Component
    scale: float


def columns_of(state: SelectionState, coefficient: str) -> list[Column]:
    """The library's terms in one coefficient, smoothed and averaged over blocks as its residual is."""
    responses = state.responses
    flights, signals = responses.flights, responses.evaluate(state.theta)[1]
    noise = noise_channels(flights)

    def able(channel: str) -> bool:
        x = np.asarray(signals[channel]) if channel in signals and channel not in noise else np.zeros(1)
        return bool(np.ptp(x) > 1e-6 * max(1.0, float(np.abs(x).max())))

    separated = bool(np.min(np.asarray(signals["X"])) < SEPARATES)
    terms = library(signals, flights.aircraft, able, lateral=coefficient in LATERAL, separated=separated)
    ends = tuple(np.asarray(flights.channels[name]) for name in ("first", "last"))
    raw = [smooth_joined(t.evaluate(signals, flights.aircraft), *ends) for t in terms]
    rows = np.asarray(responses.block(np.stack(raw, axis=1)))
    scale, at, found = np.sqrt(np.mean(rows**2, axis=0)), state.outputs.index(coefficient), []
    for term, x, size in zip(terms, rows.T, scale, strict=True):
        if size > 0.0:
            basis = np.zeros((len(x), len(state.outputs), 1))
            basis[:, at, 0] = x / size
            found.append(Column(term, Component(f"{coefficient} over {term.name}", basis), float(size)))
    return found
