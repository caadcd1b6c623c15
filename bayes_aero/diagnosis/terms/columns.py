"""The library's terms as columns of a regression."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import moves, noise_channels
from bayes_aero.diagnosis.screening.selection_state import Component, SelectionState
from bayes_aero.diagnosis.terms.library import QUANTITIES, THRUST, Signals, Term, library
from bayes_aero.physics.coefficient_names import LATERAL
from bayes_aero.physics.filters import smooth_joined
from bayes_aero.residuals.output_error import AddedCoefficients, AddedToFilter, FilterError, OutputError

SEPARATES = 0.9  # X below which a flight tells what acts in separated flow alone; our choice


DEGREES = 4  # columns of a polynomial of the angle of attack; our choice
SAME = 0.999  # squared cosine of what an effect and a term do to a coefficient, beyond which they are one; our choice


@dataclass(frozen=True)
class Column:
    """A term of one coefficient as these flights show it: `component` is what `scale` times the term adds to the
    residuals, about as large as these; `spread` is the term's own deviation."""

    term: Term
    component: Component
    scale: float
    spread: float


def columns_of(state: SelectionState, coefficient: str, given: Sequence[Term] = ()) -> list[Column]:
    """The library's terms in one coefficient, or those `given`, as the residuals show them.

    Where these are of coefficients: smoothed and averaged over blocks as the coefficient is, to unit root mean square.
    Where they are of flights: flown, to first order (see `AddedCoefficients`, `AddedToFilter`).
    """
    if isinstance(state.responses, OutputError):
        return _flown(state, coefficient, given)
    responses = state.responses
    flights, signals = responses.flights, responses.evaluate(state.theta)[1]
    terms = _computable(given, signals) if given else _terms(state, signals, coefficient)
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


def _flown(state: SelectionState, coefficient: str, given: Sequence[Term]) -> list[Column]:
    """Sensitivities of flown residuals, each as large as the residual of the median output, all outputs counted."""
    responses = state.responses
    assert isinstance(responses, OutputError)
    of = AddedToFilter if isinstance(responses, FilterError) else AddedCoefficients
    added = of(responses, state.theta)  # pyright: ignore[reportArgumentType]
    signals = added.signals()
    terms = _computable(given, signals) if given else _terms(state, signals, coefficient)

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


def _computable(given: Sequence[Term], signals: Signals) -> Sequence[Term]:
    """The terms whose channels are there: a simulation has no channel that its model does not read."""
    return [term for term in given if all(channel in signals for channel in term.channels)]


def polynomials(state: SelectionState, coefficient: str) -> list[Component]:
    """Polynomials of the angle of attack in one coefficient: themselves, and as factors of what else it depends on."""
    able, lateral = _able(state, state.responses.flights.channels), coefficient in LATERAL
    alpha, *others = (q for q in QUANTITIES if q is not THRUST and all(map(able, q.channels)))
    if alpha.name != "alpha":
        return []
    own = [q for q in others if q.lateral == lateral]
    of = {f"{q.name} times a polynomial of alpha": [Term((alpha,) * k + (q,)) for k in range(DEGREES)] for q in own}
    of |= {} if lateral else {"a polynomial of alpha": [Term((alpha,) * k) for k in range(2, 2 + DEGREES)]}
    wanted = [t for terms in of.values() for t in terms]
    basis = {c.term.name: c.component.basis for c in columns_of(state, coefficient, wanted)}
    whole = [(x, [basis[t.name] for t in terms if t.name in basis]) for x, terms in reversed(of.items())]
    return [
        Component(f"{coefficient} over {x}", _apart(state, np.concatenate(parts, axis=2)))
        for x, parts in whole
        if parts
    ]


def _apart(state: SelectionState, basis: Float[np.ndarray, "m c w"]) -> Float[np.ndarray, "m c v"]:
    """What the parameters that are in leave of powers, apart from one another, each of unit root mean square."""
    deviation = np.std(state.residual / state.noise_growth, axis=0)[:, None]
    inside = state.columns()
    own = state.S[:, :, inside[inside < len(state.theta)]]
    X, B = ((x / deviation)[:, np.any(basis != 0.0, axis=(0, 2))].reshape(-1, x.shape[2]) for x in (basis, own))
    B = B / np.maximum(np.sqrt(np.sum(B**2, axis=0)), 1e-300)
    U, size, _ = np.linalg.svd(X - B @ np.linalg.lstsq(B, X, rcond=1e-10)[0], full_matrices=False)
    U = U[:, size > 1e-6 * np.sqrt(np.sum(X**2, axis=0)).max()]
    found = np.zeros((*basis.shape[:2], U.shape[1]))
    found[:, np.any(basis != 0.0, axis=(0, 2))] = np.sqrt(len(U)) * U.reshape(len(basis), -1, U.shape[1])
    return found * deviation / np.median(deviation)


def term_of(state: SelectionState, effect: str) -> Column | None:
    """The term of one coefficient that an effect of one parameter is, by another name; None where it is none."""
    one = next(e for e in state.full.model.effects if e.name == effect)
    acts_on = {name.removesuffix("_attached") for name in one.example.increments}
    if len(one.parameters) > 1 or len(acts_on) > 1 or not acts_on <= set(state.responses.model.coefficients):
        return None
    (coefficient,) = acts_on
    found = columns_of(state, coefficient)
    alike = [likeness(state, [effect], column) for column in found]
    return found[int(np.argmax(alike))] if max(alike, default=0.0) > SAME else None


def likeness(state: SelectionState, effects: Sequence[str], column: Column) -> float:
    """Largest squared cosine of what parameters of effects and a term do to the outputs that the term reaches."""
    x = column.component.basis[:, :, 0]
    reached = np.any(x != 0.0, axis=0)
    x, S = x[:, reached], state.S[:, reached][:, :, state.full.own_columns(*effects)]
    alike = np.einsum("mc,mck->k", x, S) ** 2 / np.maximum(np.sum(x**2) * np.sum(S**2, axis=(0, 1)), 1e-300)
    return float(np.max(alike, initial=0.0))


def _component(coefficient: str, term: Term, basis: Float[np.ndarray, "m c 1"]) -> Component:
    return Component(f"{coefficient} over {term.name}", basis)


def _terms(state: SelectionState, signals: Signals, coefficient: str) -> Sequence[Term]:
    """Terms that these flights can tell."""
    separated, able = bool(np.min(np.asarray(signals["X"])) < SEPARATES), _able(state, signals)
    aircraft, lateral = state.responses.flights.aircraft, coefficient in LATERAL
    return library(signals, aircraft, able, lateral=lateral, separated=separated)


def _able(state: SelectionState, signals: Signals) -> Callable[[str], bool]:
    """Whether a channel was recorded and moves."""
    flights = state.responses.flights
    noise = noise_channels(flights)
    return lambda channel: channel in signals and channel not in noise and moves(signals[channel], flights, 1e-6)
