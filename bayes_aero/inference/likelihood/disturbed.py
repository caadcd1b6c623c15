"""A fit with all disturbances of a flight: gusts, and process noise of the states for what gusts do not explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_aero.dynamics.flight import Dynamics, EffectDynamics
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult, fit_prediction_error

GUSTS = ("vertical_gust", "longitudinal_gust")
FIRST_F = 0.3  # process noise at the start of a fit, in standard deviations of output error's residuals a second
FIRST_F_GUSTS = 0.03  # the same in gusts: from a larger value, process noise of the states takes the place of a gust
FIRST_R = 0.1  # measurement noise at the start, as a share of the variance of output error's residuals
MIN_SHARE = 0.1  # of these starting values, below which a fit never starts


def disturbed(flown: SegmentTrajectories) -> SegmentTrajectories:
    """The same segments in gusts; linear systems have no gusts.

    Where the model has buffet, the noise of the sensors does not grow as the flow separates.
    """
    dynamics = flown.dynamics
    if not isinstance(dynamics, EffectDynamics):
        return flown
    dynamics = dynamics.for_filter()
    if not dynamics.meets_gusts:
        return replace(flown, dynamics=dynamics)
    gusts = (*GUSTS, *(("lateral_gust",) if "beta" in dynamics.states and "beta" in flown.outputs else ()))
    absent = [name for name in gusts if name not in {e.name for e in dynamics.model.acting}]
    model = dynamics.model.extended(*absent)
    steady = np.ones_like(flown.noise_growth) if model.has_buffet else flown.noise_growth
    return replace(flown, dynamics=replace(dynamics, model=model), noise_growth=steady)


def fit_disturbed(
    flown: SegmentTrajectories,
    estimate: Float[np.ndarray, " k"],
    R: Float[np.ndarray, " c"],
    *,
    priors: bool = True,
    exact: bool = True,
    similar: PredictionErrorResult | None = None,
) -> tuple[SegmentTrajectories, PredictionErrorResult]:
    """Fit with process noise, from the estimates of output error.

    States that a sensor measures have process noise of their own; gusts have theirs; other states have none.

    Args:
        flown: segments of flights.
        estimate: parameters of output error, (k,).
        R: variances of its residuals, (c,), SI.
        priors: whether the parameters' priors count.
        exact: as of `fit_prediction_error`.
        similar: a fit of a model that differs by one effect; gusts and noise start from its estimates.

    Returns:
        The segments in gusts, and the fit.
    """
    gusty, outputs = disturbed(flown), flown.outputs
    known = dict(zip(flown.dynamics.names, estimate, strict=True))
    start = np.array([known.get(p.name, p.start) for p in gusty.dynamics.free])
    sd = np.sqrt(R)
    first = FIRST_F if gusty.dynamics.names == flown.dynamics.names else FIRST_F_GUSTS
    F = np.array([first * sd[outputs.index(n)] if n in outputs else 0.0 for n in gusty.dynamics.states])
    R = FIRST_R * R
    if similar is not None:
        start, F, R = _start_from(similar, gusty.dynamics, start, F)
    return gusty, fit_prediction_error(gusty, F, R, start=start, priors=priors, exact=exact)


def _start_from(
    similar: PredictionErrorResult, dynamics: Dynamics, start: Float[np.ndarray, " k"], F: Float[np.ndarray, " s"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " s"], Float[np.ndarray, " c"]]:
    """Gusts, process noise and measurement noise of a similar fit, none so small that the likelihood is flat."""
    known = {
        n: float(x)
        for n, x in zip(similar.names, similar.estimate, strict=True)
        if n in dynamics.disturbance_parameters
    }
    noise = dict(zip(similar.states, similar.F, strict=True))
    start = np.array(
        [max(known[n], MIN_SHARE * x) if n in known else x for n, x in zip(dynamics.names, start, strict=True)]
    )
    F = np.array([max(float(noise.get(n, x)), MIN_SHARE * x) for n, x in zip(dynamics.states, F, strict=True)])
    return start, F, similar.R
