"""Simulated manoeuvres beside the recorded ones: their errors, and the chance that they stay inside tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.selection.residuals import theil_parts
from bayes_aero.diagnosis.trajectories.results import Error, Path
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.inference.likelihood.output_error import one_by_one, trajectories
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult, OutputErrorStatus
from bayes_aero.inference.threads import cores
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model

DRAWS = 40  # of the posterior, for the probability of staying inside the tolerances
GIVEN = "given"


def label(flown: SegmentTrajectories, row: int) -> str:
    """The manoeuvre's name; of the halves of a single one, which."""
    name = flown.flights.names[int(flown.manoeuvre[row])]
    if len(flown.flights.lengths) > 1 or len(flown.index) == 1:
        return name
    return f"{name}, {'first' if row == 0 else 'second'} half"


def paths_of(
    fit: OutputErrorResult,
    flown: SegmentTrajectories,
    model: str,
    split: str,
    departure: Float[np.ndarray, "w s"],
    tolerances: Mapping[str, float],
    *,
    drawn: bool = False,
    variance_inflation: float = 1.0,
    seed: int = 0,
) -> list[Path]:
    """Every segment of `flown` that counts, simulated with the parameters of `fit`; `drawn`: with its posterior, too,
    under a likelihood that counts each sample for one in `variance_inflation`."""
    draws = None
    if drawn and fit.status is not OutputErrorStatus.LEFT_ENVELOPE:
        draws = posterior_draws(fit, variance_inflation, seed)
    return simulated(fit.estimate, flown, model, split, departure, tolerances, draws)


def simulated(
    estimate: Float[np.ndarray, " k"],
    flown: SegmentTrajectories,
    model: str,
    split: str,
    departure: Float[np.ndarray, "w s"],
    tolerances: Mapping[str, float],
    draws: Float[np.ndarray, "m k"] | None = None,
) -> list[Path]:
    """The same with given parameters; with `draws` of them, too, the chance to stay inside the tolerances."""
    shown, every = one_by_one(flown, jnp.asarray(estimate), jnp.asarray(departure))
    paths = []
    for row, found in every.items():
        keep = flown.inside[row]
        measured, residual = np.asarray(found.measured[0])[keep], np.asarray(found.residual[0])[keep]
        chance = {} if draws is None else _probabilities(replace(flown, outputs=shown).part([row]), draws, tolerances)
        errors = {
            name: _error(measured[:, c], residual[:, c], tolerances.get(name), chance.get(name))
            for c, name in enumerate(shown)
        }
        paths.append(
            Path(
                manoeuvre=label(flown, row),
                model=model,
                split=split,
                inside=bool(np.asarray(found.trajectory.inside[0])[keep].all()),
                errors=errors,
                time=flown.flights.time[flown.index[row][keep]],
                measured={name: measured[:, c] for c, name in enumerate(shown)},
                simulated={name: measured[:, c] - residual[:, c] for c, name in enumerate(shown)},
            )
        )
    return paths


def _error(measured: np.ndarray, residual: np.ndarray, tolerance: float | None, probability: float | None) -> Error:
    size = np.abs(residual)
    return Error(
        rms=float(np.sqrt(np.mean(residual**2))),
        largest=float(size.max()),
        theil=theil_parts(measured, measured - residual),
        tolerance=tolerance,
        within=None if tolerance is None else float(np.mean(size <= tolerance)),
        probability=probability,
    )


def posterior_covariance(fit: OutputErrorResult, inflation: float) -> Float[np.ndarray, "k k"]:
    """Of the parameters, under a likelihood that counts each sample for one in `inflation`, and their priors."""
    return inflation * fit.covariance


def posterior_draws(
    fit: OutputErrorResult, variance_inflation: float, seed: int, count: int = DRAWS
) -> Float[np.ndarray, "m k"]:
    """Parameters drawn from the posterior, within their bounds."""
    moving = np.flatnonzero(fit.sd > 0.0)
    covariance = posterior_covariance(fit, variance_inflation)[np.ix_(moving, moving)]
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    white = np.random.default_rng(seed).standard_normal((count, len(moving)))
    thetas = np.tile(fit.estimate, (count, 1))
    thetas[:, moving] += (white * np.sqrt(np.maximum(values, 0.0))) @ vectors.T * scale
    lower, upper = (np.array([p.bounds[i] for p in fit.parameters], float) for i in (0, 1))
    return np.clip(thetas, lower, upper)


def _probabilities(
    alone: SegmentTrajectories, draws: Float[np.ndarray, "m k"], tolerances: Mapping[str, float]
) -> dict[str, float]:
    """Share of draws whose whole trajectory, of one segment, stays inside each tolerance and the envelope.

    Draw by draw: a simulation of all of them together would have to be compiled, and takes half as long only.
    """
    still = jnp.zeros((1, len(alone.dynamics.start)))

    def largest(theta):
        found = trajectories(alone, jnp.asarray(theta), still)
        inside = np.all(np.asarray(found.trajectory.inside) | ~alone.inside)
        size = np.max(np.abs(np.asarray(found.residual[0])), axis=0)
        return np.where(inside & np.isfinite(size), size, np.inf)

    with ThreadPoolExecutor(cores()) as pool:
        sizes = np.stack(list(pool.map(largest, draws)))
    return {
        name: float(np.mean(sizes[:, c] <= tolerances[name]))
        for c, name in enumerate(alone.outputs)
        if name in tolerances
    }


def fly_given(
    flights: Flights, model: Model, values: Mapping[str, float], tolerances: Mapping[str, float]
) -> tuple[Path, ...]:
    """Every manoeuvre from its measured initial state, with `values` (SI) by parameter; others have their start.

    Nothing is fitted to the flight.
    """
    dynamics = aircraft_dynamics(model, flights)
    theta = np.array([values.get(p.name, p.start) for p in dynamics.free])
    whole = segments(flights, dynamics, substeps=dynamics.substeps(theta, flights))
    still = np.zeros((len(whole.index), len(dynamics.start)))
    with np.errstate(over="ignore", invalid="ignore"):  # coefficients that fit may still fly anywhere
        return tuple(simulated(theta, whole, GIVEN, GIVEN, still, tolerances))
