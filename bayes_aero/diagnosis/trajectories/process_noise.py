"""The same parameters by a filter that estimates gusts, process noise and measurement noise with them."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np

from bayes_aero.diagnosis.trajectories.drift import with_drift
from bayes_aero.diagnosis.trajectories.results import GustHistory, ProcessNoise, TrajectoryFit
from bayes_aero.dynamics.filtering.innovations import neighbour_correlation
from bayes_aero.dynamics.filtering.kalman import smoothed
from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.disturbed import fit_disturbed
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult, PredictionErrorStatus
from bayes_aero.inference.threads import blas_threads


@blas_threads(0)
def with_process_noise(flown: TrajectoryFit, drifting: Sequence[str] = ()) -> ProcessNoise:
    """Fit again, from the estimates of output error, in gusts and with noise of every state that is compared.

    Parameters that are `drifting` drift in a further fit.
    """
    fit = flown.fit
    gusty, found = fit_disturbed(fit.flown, fit.estimate, fit.R, priors=flown.setting.priors)
    inside = fit.flown.inside
    count = int(inside.sum())
    still = -0.5 * count * float(np.sum(np.log(2.0 * np.pi * fit.R) + 1.0)) - float(
        np.log(fit.flown.noise_growth[inside]).sum()
    )
    estimates = {n: (float(x), float(s)) for n, x, s in zip(found.names, found.estimate, found.sd, strict=True)}
    own = fit.flown.dynamics.names
    return ProcessNoise(
        found.status.value,
        found.status is PredictionErrorStatus.CONVERGED,
        found.log_likelihood - still,
        {name: value for name, value in estimates.items() if name in own},
        {n: float(x) for n, x in zip(found.states, found.F, strict=True) if n in fit.flown.dynamics.states},
        dict(zip(found.outputs, map(float, np.sqrt(found.R)), strict=True)),
        dict(zip(found.outputs, map(float, neighbour_correlation(found.found)), strict=True)),
        {name: value for name, value in estimates.items() if name not in own},
        _histories(gusty, found),
        with_drift(gusty, found, drifting, priors=flown.setting.priors) if drifting else None,
    )


_smoothed = eqx.filter_jit(jax.vmap(smoothed))


def _histories(gusty: SegmentTrajectories, found: PredictionErrorResult) -> tuple[GustHistory, ...]:
    """By manoeuvre, by the smoother; only gusts that have an intensity."""
    dynamics, known = gusty.dynamics, dict(zip(found.names, found.estimate, strict=True))
    processes = dynamics.model.disturbances if isinstance(dynamics, AircraftDynamics) else ()
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
