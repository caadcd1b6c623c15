"""A fit with all that may disturb a flight: gusts, and noise of the states for what gusts do not explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_aero.dynamics.flight import Dynamics, EffectDynamics
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult, fit_prediction_error

GUSTS = ("vertical_gust", "longitudinal_gust")
FIRST_F, FIRST_R = 0.3, 0.1  # of output error's residuals: process noise in a second, share that is measurement noise
LEAST = 0.1  # of these, with which a fit begins beside another
BESIDE_GUSTS = 0.03  # the first of these in gusts: begun larger, noise of the states takes the place of a gust


def disturbed(flown: SegmentTrajectories) -> SegmentTrajectories:
    """The same segments in gusts; linear systems have none of their own.

    Where the model has buffet the noise of the sensors does not grow as the flow separates.
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
    steady = np.ones_like(flown.noise_growth) if model.shaken else flown.noise_growth
    return replace(flown, dynamics=replace(dynamics, model=model), noise_growth=steady)


def fit_disturbed(
    flown: SegmentTrajectories,
    estimate: Float[np.ndarray, " k"],
    R: Float[np.ndarray, " c"],
    *,
    priors: bool = True,
    exact: bool = True,
    near: PredictionErrorResult | None = None,
) -> tuple[SegmentTrajectories, PredictionErrorResult]:
    """Fit with process noise, from what output error found.

    States that are compared with a sensor have noise of their own; gusts are driven by theirs; others follow.

    Args:
        flown: segments of flights.
        estimate: parameters of output error, (k,).
        R: variances of its residuals, (c,), SI.
        priors: whether the parameters' priors count.
        exact: as of `fit_prediction_error`.
        near: a fit of a model that differs by an effect; gusts and noise begin there.

    Returns:
        The segments in gusts, and the fit.
    """
    gusty, outputs = disturbed(flown), flown.outputs
    known = dict(zip(flown.dynamics.names, estimate, strict=True))
    start = np.array([known.get(p.name, p.start) for p in gusty.dynamics.free])
    sd = np.sqrt(R)
    first = FIRST_F if gusty.dynamics.names == flown.dynamics.names else BESIDE_GUSTS
    F = np.array([first * sd[outputs.index(n)] if n in outputs else 0.0 for n in gusty.dynamics.states])
    R = FIRST_R * R
    if near is not None:
        start, F, R = _begun(near, gusty.dynamics, start, F)
    return gusty, fit_prediction_error(gusty, F, R, start=start, priors=priors, exact=exact)


def _begun(
    near: PredictionErrorResult, dynamics: Dynamics, start: Float[np.ndarray, " k"], F: Float[np.ndarray, " s"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " s"], Float[np.ndarray, " c"]]:
    """Gusts, process noise and measurement noise of a fit; none so small that the likelihood would be flat there."""
    known = {n: float(x) for n, x in zip(near.names, near.estimate, strict=True) if n in dynamics.of_disturbances}
    noise = dict(zip(near.states, near.F, strict=True))
    start = np.array(
        [max(known[n], LEAST * x) if n in known else x for n, x in zip(dynamics.names, start, strict=True)]
    )
    F = np.array([max(float(noise.get(n, x)), LEAST * x) for n, x in zip(dynamics.states, F, strict=True)])
    return start, F, near.R
