"""Simulated manoeuvres beside the recorded ones, and the growth of their errors by process noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.screening.accuracy import normal_draws
from bayes_aero.diagnosis.trajectories.results import (
    Error,
    GustHistory,
    ProcessNoise,
    SimulatedManoeuvre,
    TrajectoryFit,
    theil_parts,
)
from bayes_aero.dynamics.flight import EffectDynamics, aircraft_dynamics
from bayes_aero.dynamics.innovations import neighbour_correlation, prediction_errors
from bayes_aero.dynamics.kalman import smooth
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.inference.calibration import one_step
from bayes_aero.inference.nuts import sample_innovations
from bayes_aero.inference.output_error import fit_disturbed, one_by_one, trajectories
from bayes_aero.inference.output_error_result import OutputErrorResult
from bayes_aero.inference.prediction_error import PredictionErrorResult, PredictionErrorStatus
from bayes_aero.inference.results import Posterior
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model
from bayes_aero.processes import blas_threads, cores
from bayes_aero.progress import Progress

DRAWS = 40  # of the posterior, for the probability of staying inside the tolerances
GIVEN = "given"


def label(flown: SegmentTrajectories, row: int) -> str:
    """The manoeuvre's name; of the halves of a single one, which."""
    name = flown.flights.names[int(flown.manoeuvre[row])]
    if len(flown.flights.lengths) > 1 or len(flown.index) == 1:
        return name
    return f"{name}, {'first' if row == 0 else 'second'} half"


def simulated(
    estimate: Float[np.ndarray, " k"],
    flown: SegmentTrajectories,
    model: str,
    split: str,
    departure: Float[np.ndarray, "w s"],
    tolerances: Mapping[str, float],
    draws: Float[np.ndarray, "m k"] | None = None,
) -> list[SimulatedManoeuvre]:
    """Every segment of `flown` that counts, with these parameters; with `draws` the chance to stay inside."""
    shown, every = one_by_one(flown, jnp.asarray(estimate), jnp.asarray(departure))
    paths = []
    for row, found in every.items():
        keep = flown.inside[row]
        measured, residual = np.asarray(found.measured[0])[keep], np.asarray(found.residual[0])[keep]
        chance = {} if draws is None else _probabilities(replace(flown, outputs=shown).part([row]), draws, tolerances)
        errors = {}
        for name, z, e in zip(shown, measured.T, residual.T, strict=True):
            tolerance, size = tolerances.get(name), np.abs(e)
            within = None if tolerance is None else float(np.mean(size <= tolerance))
            rms, parts = float(np.sqrt(np.mean(e**2))), theil_parts(z, z - e)
            errors[name] = Error(rms, float(size.max()), parts, tolerance, within, chance.get(name))
        paths.append(
            SimulatedManoeuvre(
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


def posterior_covariance(fit: OutputErrorResult, inflation: float) -> Float[np.ndarray, "k k"]:
    """Of the parameters, under a likelihood that counts each sample for one in `inflation`, and their priors."""
    return inflation * fit.covariance


def posterior_draws(
    fit: OutputErrorResult, variance_inflation: float, seed: int, count: int = DRAWS
) -> Float[np.ndarray, "m k"]:
    """Parameters drawn from the posterior, within their bounds."""
    moving = np.flatnonzero(fit.sd > 0.0)
    covariance = posterior_covariance(fit, variance_inflation)[np.ix_(moving, moving)]
    return normal_draws(fit.estimate, moving, covariance, fit.parameters, seed, count)


def _probabilities(
    alone: SegmentTrajectories, draws: Float[np.ndarray, "m k"], tolerances: Mapping[str, float]
) -> dict[str, float]:
    """Share of draws whose whole trajectory, of one segment, stays inside each tolerance and the envelope."""
    # Draw by draw: a simulation of all of them together would have to be compiled, and takes half as long only.
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
) -> tuple[SimulatedManoeuvre, ...]:
    """Every manoeuvre from its measured initial state, with `values` (SI) of parameters; nothing is fitted."""
    dynamics = aircraft_dynamics(model, flights)
    theta = np.array([values.get(p.name, p.start) for p in dynamics.free])
    whole = segments(flights, dynamics, substeps=dynamics.substeps(theta, flights))
    still = np.zeros((len(whole.index), len(dynamics.start)))
    with np.errstate(over="ignore", invalid="ignore"):  # coefficients that fit may still fly anywhere
        return tuple(simulated(theta, whole, GIVEN, GIVEN, still, tolerances))


# --- The same parameters by a filter that estimates gusts, process noise and measurement noise with them.


@blas_threads(0)
def with_process_noise(
    flown: TrajectoryFit,
) -> tuple[ProcessNoise, Callable[[int, Progress | None, str], dict[str, Posterior]]]:
    """Fit again, from the estimates of output error, in gusts and with noise of every state that is compared; also what
    samples its posterior from a seed by a sampler."""
    fit = flown.fit
    gusty, found = fit_disturbed(fit.flown, fit.estimate, fit.R, priors=flown.setting.priors)

    def sample(seed: int, progress: Progress | None, engine: str) -> dict[str, Posterior]:
        with blas_threads(0):
            return sample_innovations(gusty, found, fit.R, seed=seed, engines=(engine,), progress=progress)

    return _told(flown, gusty, found), sample


def _told(flown: TrajectoryFit, gusty: SegmentTrajectories, found: PredictionErrorResult) -> ProcessNoise:
    fit = flown.fit
    inside = fit.flown.inside
    count = int(inside.sum())
    still = -0.5 * count * float(np.sum(np.log(2.0 * np.pi * fit.R) + 1.0)) - float(
        np.log(fit.flown.noise_growth[inside]).sum()
    )
    estimates = {n: (float(x), float(s)) for n, x, s in zip(found.names, found.estimate, found.sd, strict=True)}
    own = set(fit.flown.dynamics.names) - gusty.dynamics.disturbance_parameters
    converged = found.status is PredictionErrorStatus.CONVERGED
    predicted = None
    if converged:
        errors = np.asarray(prediction_errors(gusty.nameless, jnp.asarray(found.estimate), found.found))
        predicted = one_step(found.found, errors, found.outputs)
    theirs = [i for i, name in enumerate(found.names) if name in own]
    return ProcessNoise(
        found.status.value,
        converged,
        found.log_likelihood - still,
        {name: value for name, value in estimates.items() if name in own},
        {n: float(x) for n, x in zip(found.states, found.F, strict=True) if n in fit.flown.dynamics.start},
        dict(zip(found.outputs, map(float, np.sqrt(found.R)), strict=True)),
        dict(zip(found.outputs, map(float, neighbour_correlation(found.found)), strict=True)),
        {name: value for name, value in estimates.items() if name not in own},
        _histories(gusty, found),
        predicted,
        found.covariance[np.ix_(theirs, theirs)],
    )


_smoothed = eqx.filter_jit(jax.vmap(smooth))


def _histories(gusty: SegmentTrajectories, found: PredictionErrorResult) -> tuple[GustHistory, ...]:
    """By manoeuvre, by the smoother; only gusts that have an intensity."""
    dynamics, known = gusty.dynamics, dict(zip(found.names, found.estimate, strict=True))
    processes = dynamics.model.disturbances if isinstance(dynamics, EffectDynamics) else ()
    met = {d.state: dynamics.states.index(d.state) for d in processes if known.get(d.intensity, 0.0) > 0.0}
    if not met:
        return ()
    x, P = (np.asarray(y) for y in _smoothed(found.found))
    flights, histories = gusty.flights, []
    for number in np.unique(gusty.manoeuvre):
        parts = [(k, gusty.inside[k]) for k in np.flatnonzero(gusty.manoeuvre == number)]
        time = np.concatenate([np.asarray(flights.time)[gusty.index[k][real]] for k, real in parts])
        gusts = {
            name: (
                np.concatenate([x[k, real, i] for k, real in parts]),
                np.sqrt(np.maximum(np.concatenate([P[k, real, i, i] for k, real in parts]), 0.0)),
            )
            for name, i in met.items()
        }
        histories.append(GustHistory(flights.names[number], time - time[0], gusts))
    return tuple(histories)
