"""Flights that would decide tolerances: what more records make of the parameters, and so of the probability to pass.

A record narrows the distribution of the parameters. A flight departs from the simulation in proportion to their errors,
so that its part by the parameters shrinks with them, and errors of the structure and gusts stay. A tolerance that stays
undecided with known parameters is decided by no record: the model must become better. It is assumed that the estimates
do not move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.design.information import Information, noise_of
from bayes_aero.diagnosis.design.next_test_points import best_points, possible_points, refused_points, variants_of
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised
from bayes_aero.errors import InputError
from bayes_aero.flight.envelope import Envelope
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model
from bayes_aero.physics.coefficient_names import required_of
from bayes_aero.qualification.result import FAILS_TO, PASSES_FROM, Further, Kind, OpenTolerance
from bayes_aero.residuals.equation_error import EquationError

KEPT = 1e-10  # of the largest eigenvalue of a scaled covariance: directions below it are known


@dataclass(frozen=True)
class OpenTest:
    """An undecided test: what drawn parameters and all else add to each of m flights at n samples, SI."""

    kind: Kind
    manoeuvre: str
    output: str
    tolerance: float
    by_parameters: Float[np.ndarray, "m n"]
    by_all_else: Float[np.ndarray, "m n"]


@dataclass(frozen=True)
class _Linear:
    """An open test whose part by the parameters is linear in their errors, as far as `slope` (k, n) says."""

    test: OpenTest
    slope: Float[np.ndarray, "k n"]
    worst: int

    @classmethod
    def of(cls, test: OpenTest, errors: Float[np.ndarray, "m k"]) -> _Linear:
        """From the draws."""
        sound = np.all(np.isfinite(test.by_parameters), axis=1)
        slope = np.linalg.lstsq(errors[sound], test.by_parameters[sound], rcond=None)[0]
        total = np.nan_to_num(test.by_parameters + test.by_all_else, nan=np.inf)
        return cls(test, slope, int(np.argmax(np.quantile(np.abs(total), PASSES_FROM, axis=0))))

    def probability(self, errors: Float[np.ndarray, "m k"], shrunk: Float[np.ndarray, "m k"]) -> float:
        """To stay inside, with `shrunk` errors of the parameters in place of `errors`."""
        flights = self.test.by_parameters + (shrunk - errors) @ self.slope + self.test.by_all_else
        return float(np.mean(np.all(np.abs(np.nan_to_num(flights, nan=np.inf)) <= self.test.tolerance, axis=1)))

    def deviation(self, covariance: Float[np.ndarray, "k k"]) -> float:
        """By the parameters, where the flight leaves the band most easily, SI."""
        g = self.slope[:, self.worst]
        return float(np.sqrt(max(g @ covariance @ g, 0.0)))


def further_flights(
    tests: Sequence[OpenTest],
    names: Sequence[str],
    errors: Float[np.ndarray, "m k"],
    flights: Flights,
    model: Model,
    values: dict[str, float],
    envelope: Envelope,
) -> Further:
    """Test points for the undecided tolerances.

    Args:
        tests: the undecided tests.
        names: the k parameters.
        errors: of drawn parameters, by which `tests` were flown.
        flights: the fitted records.
        model: whose parameters these are.
        values: their estimates, SI.
        envelope: inside which manoeuvres are proposed.

    Raises:
        InputError: the coefficients cannot be formed, or the model cannot be flown.
    """
    scale = np.std(errors, axis=0)
    moving = np.flatnonzero(scale > 0.0)
    names, errors = [names[int(k)] for k in moving], errors[:, moving] / scale[moving]
    open_ = [_Linear.of(test, errors) for test in tests]
    known = [one.probability(errors, np.zeros_like(errors)) for one in open_]
    useful = [one for one, chance in zip(open_, known, strict=True) if _decided(chance)]
    first = np.cov(errors, rowvar=False).reshape(len(names), len(names))
    points, refused = (), {}
    if useful:
        state = _state(flights, model, values)
        variants = variants_of(state, (), envelope)
        possible = [
            replace(one, told=_precision(one.told, names, scale[moving]))
            for one in possible_points(state, variants, (), noise_of(state), envelope)
        ]
        refused = refused_points(variants, envelope)
        points = best_points(
            possible,
            np.zeros_like(first),
            nats=lambda told: _nats(useful, first, told),
            expected=lambda told: tuple(one.probability(errors, _shrunk(errors, first, told)) for one in open_),
            decided=lambda told: all(_decided(one.probability(errors, _shrunk(errors, first, told))) for one in useful),
        )
    questions = tuple(
        OpenTolerance(t.kind, t.manoeuvre, t.output, one.probability(errors, errors), chance)
        for t, one, chance in zip(tests, open_, known, strict=True)
    )
    return Further(questions, tuple(points), refused)


def _decided(chance: float) -> bool:
    return not FAILS_TO < chance < PASSES_FROM


def _nats(useful: Sequence[_Linear], first: np.ndarray, told: np.ndarray) -> float:
    """Log of how many times the part by the parameters is narrowed, the sum of all tests that they leave open."""
    after = _after(first, told)
    ratios = [one.deviation(first) / max(one.deviation(after), 1e-300) for one in useful if one.deviation(first) > 0.0]
    return float(np.sum(np.log(ratios)))


def _after(first: Float[np.ndarray, "k k"], told: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """Covariance with further information."""
    return first - first @ told @ np.linalg.solve(np.eye(len(first)) + first @ told, first)


def _shrunk(errors: np.ndarray, first: np.ndarray, told: np.ndarray) -> Float[np.ndarray, "m k"]:
    """Errors of the covariance that is left, made of the drawn ones."""
    return errors @ np.linalg.pinv(_root(first)) @ _root(_after(first, told))


def _root(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    size, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    size = np.where(size > KEPT * max(size[-1], 0.0), size, 0.0)
    return (vectors * np.sqrt(size)) @ vectors.T


def _precision(told: Information, names: Sequence[str], scale: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
    """Of a record by itself on scaled parameters, under coloured noise: I M^-1 I."""
    at = [k for k, label in enumerate(told.labels) if label in names]
    place = [list(names).index(told.labels[k]) for k in at]
    unit = np.outer(scale[place], scale[place])
    matrix, score = told.matrix[np.ix_(at, at)] * unit, told.score_variance[np.ix_(at, at)] * unit
    whole = np.zeros((len(names), len(names)))
    whole[np.ix_(place, place)] = matrix @ np.linalg.pinv(score, rcond=KEPT, hermitian=True) @ matrix
    return whole


def _state(flights: Flights, model: Model, values: dict[str, float]) -> SelectionState:
    """The model at its estimates on the fitted records, by coefficients."""
    missing = [n for n in required_of(model.axes) if n not in flights.channels]
    if missing:
        raise InputError(f"test points are judged by coefficients, and {missing[0]} was not recorded")
    full = CandidateModel(model, tuple(e.name for e in model.effects if e.parameters), (), {})
    theta = np.array([values[name] for name in model.names])
    return linearised(full, EquationError.of(flights, model), model.coefficients, theta)
