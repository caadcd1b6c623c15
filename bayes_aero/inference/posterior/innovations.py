"""The posterior of a flight fitted with process noise: parameters, process noise and measurement noise, jointly.

The density is that of `likelihood.prediction_error`, with the parameters' priors instead of their normal
approximations, and weak lognormal priors of the noise, so that the posterior is proper where a process noise is not
distinguishable from zero.

A noise or gust of hardly any size has a posterior that is flat in its logarithm below what the record can tell, and
falls off steeply above. Samplers therefore work on the logarithm of small and on the size of large ones (`knee`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.dynamics.filtering.density import NoisePoint, innovations_density
from bayes_aero.dynamics.segments import SegmentTrajectories
from bayes_aero.inference.likelihood.disturbed import FIRST_F, FIRST_R
from bayes_aero.inference.likelihood.normal_equations import initial_state_sd
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult
from bayes_aero.inference.posterior.ensemble import EnsembleLength, sample_ensemble
from bayes_aero.inference.posterior.laplace import find_mode, inside
from bayes_aero.inference.posterior.nuts import NutsLength, WarmUp, sample_nuts
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.model.log_density import LogDensity
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.progress import Progress

ENGINES = ("emcee", "nuts")  # the faster one first
KNEE_OF_PROCESS, KNEE_OF_MEASUREMENT = 0.5, 0.03  # of the median, see `Parameter.knee`
KNEE_OF_INTENSITY = 0.05  # of the prior's width
SPREAD = 2.0  # standard deviation of the logarithm of a process or measurement noise: a factor of 50 either way, 95 %


class NoiseLevels(NamedTuple):
    """Medians of the priors: process noise by state (s,), 0 where there is none, and standard deviations of the
    measurement noise by output (c,); SI."""

    process: tuple[float, ...]
    measurement: tuple[float, ...]

    @classmethod
    def of(cls, R: Float[np.ndarray, " c"], outputs: tuple[str, ...], states: tuple[str, ...]) -> NoiseLevels:
        """From the residual variances of output error, by `FIRST_F` and `FIRST_R` as at the start of the fit. States
        without a sensor have no process noise."""
        sd = dict(zip(outputs, map(float, np.sqrt(R)), strict=True))
        return cls(
            tuple(FIRST_F * sd[name] if name in sd else 0.0 for name in states),
            tuple(float(np.sqrt(FIRST_R)) * sd[name] for name in outputs),
        )


class InnovationsDensity(LogDensity):
    """Parameters: the dynamics' free ones, F_state (process noise), sigma_output (measurement noise)."""

    flown: SegmentTrajectories
    deviation: tuple[float, ...] = eqx.field(static=True)  # of the measured initial state
    levels: NoiseLevels = eqx.field(static=True)

    @property
    def noise_label(self) -> str:
        """White in the states and in the measurements."""
        return "white, of states and measurements"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Of the dynamics, of the process noise, of the measurement noise."""
        states, outputs = self.flown.dynamics.states, self.flown.outputs
        process = [
            _noise(
                f"F_{name}", f"process noise of {name}, in its unit per square root of a second", level, KNEE_OF_PROCESS
            )
            for name, level in zip(states, self.levels.process, strict=True)
            if level > 0.0
        ]
        measurement = [
            _noise(f"sigma_{name}", f"standard deviation of the noise of {name}", level, KNEE_OF_MEASUREMENT)
            for name, level in zip(outputs, self.levels.measurement, strict=True)
        ]
        return (*map(self._with_knee, self.flown.dynamics.free), *process, *measurement)

    def _with_knee(self, parameter: Parameter) -> Parameter:
        """An intensity, whose posterior may reach zero, with a knee; any other parameter as it is."""
        prior = parameter.prior
        if parameter.name not in self.flown.dynamics.disturbance_parameters or prior.family != "halfnormal":
            return parameter
        return parameter.changed(knee=KNEE_OF_INTENSITY * prior.scale)

    @property
    def disturbed(self) -> Int[np.ndarray, " f"]:
        """Indices of the states with process noise."""
        return np.flatnonzero(np.array(self.levels.process) > 0.0)

    def log_likelihood(self, x: Float[Array, " k"]) -> Float[Array, ""]:
        """Log likelihood of the innovations; minus infinity where the filter diverges."""
        k, c = len(self.flown.dynamics.free), len(self.flown.outputs)
        F = jnp.zeros(len(self.levels.process)).at[self.disturbed].set(x[k:-c])
        point = NoisePoint(x[:k], F, x[-c:] ** 2)
        total = innovations_density(self.flown, point, jnp.asarray(self.deviation))
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)

    def start(self, fit: PredictionErrorResult) -> Float[np.ndarray, " k"]:
        """The fit as a point of this density, moved inside its bounds."""
        least = np.exp(-2.0 * SPREAD)  # times the median: a process noise of the fit may vanish, a lognormal does not
        F = np.maximum(fit.F, least * np.array(self.levels.process))[self.disturbed]
        free = zip(fit.estimate, self.flown.dynamics.free, strict=True)
        return np.array([*(inside(value, p.bounds) for value, p in free), *F, *np.sqrt(fit.R)])


def _noise(name: str, text: str, median: float, knee: float) -> Parameter:
    prior = Prior("lognormal", median, SPREAD, "weak, about output error's residuals; our choice")
    return Parameter(name, "SI", 0.0, median, text, prior, (0.0, np.inf), knee=knee * median)


SHORT = WarmUp(100, acceptance=0.8, metric=False)  # on a scale that the mode gives well


class PosteriorLength(NamedTuple):
    """Chains of both samplers for densities that take milliseconds: two each, one for each core of a small machine."""

    nuts: NutsLength = NutsLength(chains=2, warmup=SHORT, max_blocks=5)
    emcee: EnsembleLength = EnsembleLength(ensembles=2, max_steps=600)


def sample_innovations(
    flown: SegmentTrajectories,
    fit: PredictionErrorResult,
    R: Float[np.ndarray, " c"],
    *,
    seed: int = 0,
    length: PosteriorLength = PosteriorLength(),
    engines: Sequence[str] = ENGINES,
    progress: Progress | None = None,
) -> dict[str, Posterior]:
    """The posterior by emcee and by NUTS, or one of them, from the fit.

    Both use coordinates scaled by the curvature at the mode, which is searched from the fit.

    Args:
        flown: the fitted segments, of a fit with priors.
        fit: result of `fit_disturbed`.
        R: variances of output error's residuals, (c,), SI: the scale of the priors of the noise.
        seed: of the samplers.
        length: of the chains.
        engines: the samplers.
        progress: called with a text and the share that is done.
    """
    density = innovations_posterior(flown, R)
    mode = find_mode(density, density.start(fit))
    asked: Any = {"seed": seed, "progress": progress, "predictive": False}
    samplers = {
        "emcee": lambda: sample_ensemble(density, mode, length=length.emcee, **asked),
        "nuts": lambda: sample_nuts(density, mode, length=length.nuts, **asked),
    }
    return {engine: samplers[engine]() for engine in engines}


def innovations_posterior(flown: SegmentTrajectories, R: Float[np.ndarray, " c"]) -> InnovationsDensity:
    """The density; `R` (c,) are variances of output error's residuals. A fixed initial state has no deviation."""
    dynamics = flown.dynamics
    deviation = np.zeros(len(dynamics.states)) if flown.fixed is not None else initial_state_sd(dynamics)
    levels = NoiseLevels.of(R, flown.outputs, dynamics.states)
    return InnovationsDensity(flown.nameless, tuple(map(float, deviation)), levels)
