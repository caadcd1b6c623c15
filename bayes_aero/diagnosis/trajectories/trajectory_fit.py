"""One model fitted to trajectories: parameters, initial states, variance inflation, errors by flight."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.trajectories.holdout_fits import Noise
from bayes_aero.diagnosis.trajectories.results import FITTED, START, Setting, TrajectoryFit
from bayes_aero.diagnosis.trajectories.time_histories import label, paths_of
from bayes_aero.diagnosis.trajectories.trajectories import FIRST_INFLATION, LEFT, WINDOW
from bayes_aero.dynamics.flight import AircraftDynamics, Dynamics
from bayes_aero.dynamics.output_biases import biased_dynamics, unbiased
from bayes_aero.dynamics.segments import segments
from bayes_aero.inference.likelihood.output_error import fit_cascade, fit_output_error, trajectories
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult, OutputErrorStatus
from bayes_aero.inference.threads import blas_threads
from bayes_aero.model.joined_channels import Flights
from bayes_aero.parameter import Prior
from bayes_aero.progress import Progress


@blas_threads(0)
def fit_trajectories(
    flights: Flights,
    dynamics: Dynamics,
    units: Mapping[str, str],
    *,
    starts: Sequence[Float[np.ndarray, " k"]] = (),
    window: float = WINDOW,
    tolerances: Mapping[str, float] | None = None,
    biases: Mapping[str, Prior] | None = None,
    setting: Setting | None = None,
    progress: Progress | None = None,
) -> TrajectoryFit:
    """Fit windows of `window` s from the parameters' own start and every one of `starts`, then whole manoeuvres.

    Colour, and growth as the flow separates, of what is missed are measured on the way; the last fit weighs its priors
    by the one and its samples by the other, as `trajectory.fly_both` does. `biases`: outputs recorded with a constant
    error of each manoeuvre's own; these are fitted with the rest. Windows begin where they are measured, and
    what finds the start of the reported fit has priors of initial states and biases whatever the `setting`.
    """
    setting = setting or Setting()

    def tell(text: str, share: float) -> None:
        if progress:
            progress(text, share)

    left = LEFT if isinstance(dynamics, AircraftDynamics) else ()
    dynamics = biased_dynamics(dynamics, flights, biases or {})
    first = np.array([p.start for p in dynamics.free])
    starts = [np.append(s, first[len(s) :]) for s in starts]
    shown = tuple(name for name in dynamics.outputs if name in flights.channels)
    compared = tuple(n for n in shown if n not in left) if setting.outputs is None else setting.outputs
    options = {"outputs": compared, "substeps": dynamics.substeps(first, flights), "held": setting.held}
    short = segments(flights, dynamics, window=window, **options)
    whole = segments(flights, dynamics, fixed=setting.initial, **options)
    stages = [whole] if len(short.index) == len(whole.index) else [short, whole]
    tell("windows, then whole manoeuvres", 0.0)
    without = () if setting.priors else unbiased(dynamics).names
    fit = fit_cascade(stages, [first, *starts], prior_weight=FIRST_INFLATION, without=without)
    if len(stages) == 1 and fit.status is OutputErrorStatus.NOT_CONVERGED:  # a first stage stops early
        again = {"departure": fit.departure, "prior_weight": FIRST_INFLATION, "without": without}
        fit = fit_output_error(whole, start=fit.estimate, **again)
    inflation, noise_growth = math.nan, {}
    if math.isfinite(fit.cost) and fit.status is not OutputErrorStatus.LEFT_ENVELOPE:
        tell("autocorrelation of the residuals", 0.7)
        noise = Noise.of(fit)
        inflation, whole, noise_growth = noise.variance_inflation, noise.on(whole), noise.told(whole.outputs)
        weight = inflation if setting.priors else 0.0
        fit = fit_output_error(whole, start=fit.estimate, departure=fit.departure, prior_weight=weight)
    tell("errors of the trajectories", 0.9)
    bands, still = tolerances or {}, np.zeros_like(fit.departure)
    with np.errstate(over="ignore", invalid="ignore"):  # a first guess may fly anywhere
        paths = paths_of(replace(fit, estimate=first), whole, START, START, still, bands)
        paths += paths_of(fit, whole, FITTED, FITTED, fit.departure, bands)
    return TrajectoryFit(
        fit, first, tuple(paths), _initial(fit, shown), inflation, shown, dict(units), window, noise_growth, setting
    )


def _initial(fit: OutputErrorResult, shown: tuple[str, ...]) -> dict[str, dict[str, tuple[float, float]]]:
    wide, theta = replace(fit.flown, outputs=shown), jnp.asarray(fit.estimate)
    initial = {}
    for row, departure in enumerate(fit.departure):  # one by one as the paths, for which it is compiled already
        alone = trajectories(wide.part([row]), theta, jnp.asarray(departure[None]))
        begin = np.asarray(alone.begin)[0]
        named = zip(fit.flown.dynamics.start, begin, departure, strict=True)
        initial[label(fit.flown, row)] = {name: (float(at), float(away)) for name, at, away in named}
    return initial
