"""The same parameters by a filter: process noise and measurement noise estimated with them, beside output error."""

from __future__ import annotations

import numpy as np

from bayes_aero.diagnosis.trajectories.results import ProcessNoise, TrajectoryFit
from bayes_aero.inference.likelihood.prediction_error import (
    PredictionErrorResult,
    PredictionErrorStatus,
    fit_prediction_error,
)
from bayes_aero.inference.threads import blas_threads

FIRST_F, FIRST_R = 0.3, 0.1  # of output error's residuals: process noise in a second, share that is measurement noise


@blas_threads(0)
def with_process_noise(flown: TrajectoryFit) -> ProcessNoise:
    """Fit again, from the estimates of output error, with process noise on every state that is compared.

    States without a sensor (a lagging separation point) follow the motion without noise of their own.
    """
    fit = flown.fit
    segments, sd = fit.flown, np.sqrt(fit.R)
    outputs = segments.outputs
    F = np.array([FIRST_F * sd[outputs.index(name)] if name in outputs else 0.0 for name in segments.dynamics.states])
    found = fit_prediction_error(segments, F, FIRST_R * fit.R, start=fit.estimate, priors=flown.setting.priors)
    inside = segments.inside
    count = int(inside.sum())
    still = -0.5 * count * float(np.sum(np.log(2.0 * np.pi * fit.R) + 1.0)) - float(
        np.log(segments.noise_growth[inside]).sum()
    )
    return ProcessNoise(
        found.status.value,
        found.status is PredictionErrorStatus.CONVERGED,
        found.log_likelihood - still,
        {n: (float(x), float(s)) for n, x, s in zip(found.names, found.estimate, found.sd, strict=True)},
        dict(zip(found.states, map(float, found.F), strict=True)),
        dict(zip(found.outputs, map(float, np.sqrt(found.R)), strict=True)),
        _autocorrelation(found),
    )


def _autocorrelation(found: PredictionErrorResult) -> dict[str, float]:
    """Correlation of neighbouring innovations by output, over all segments; 0 where there are too few."""
    scaled = np.asarray(found.found.innovation / np.sqrt(found.found.variance))
    used, result = np.asarray(found.found.used), {}
    for c, name in enumerate(found.outputs):
        both = used[:, 1:, c] & used[:, :-1, c]
        one, next_one = scaled[:, :-1, c][both], scaled[:, 1:, c][both]
        power = float(np.sqrt(np.sum(one**2) * np.sum(next_one**2)))
        result[name] = float(np.sum(one * next_one)) / power if power > 0.0 else 0.0
    return result
