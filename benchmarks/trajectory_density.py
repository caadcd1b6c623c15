"""The posterior density of an output-error fit: parameters, initial states and noise levels, for any sampler."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.segments import SegmentTrajectories, simulate
from bayes_aero.inference.likelihood.normal_equations import initial_state_sd
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult
from bayes_aero.model.log_density import LogDensity
from bayes_aero.parameter import Parameter, Prior

SPREAD = 1.0  # of the logarithm of a noise level about the fit's: a factor of seven either way


class TrajectoryDensity(LogDensity):
    """White residuals of every output, each sample counting for one in `cost` where the residuals are coloured.

    Parameters: the dynamics' free ones, the departure of each segment's initial state (named state_segment), and the
    standard deviation of each output's residual (sigma_output). Values `held` are fixed.
    """

    flown: SegmentTrajectories
    scale: tuple[float, ...] = eqx.field(static=True)  # noise levels of the fit
    cost: float = eqx.field(static=True, default=1.0)

    @property
    def noise_label(self) -> str:
        """White, or white with the share that a sample counts for."""
        return "white" if self.cost == 1.0 else f"white, a sample counting 1/{self.cost:.0f}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Of the dynamics, of the initial states, of the noise."""
        dynamics = self.flown.dynamics
        states = [
            Parameter(
                f"{name}_{row + 1}", "SI", 0.0, 0.0, f"departure of {name} at the start of segment {row + 1}",
                Prior("normal", 0.0, float(deviation)),
            )
            for row in range(len(self.flown.index))
            for name, deviation in zip(dynamics.states, initial_state_sd(dynamics), strict=True)
        ]  # fmt: skip
        noise = [
            Parameter(
                f"sigma_{name}", "SI", 0.0, level, f"deviation of the {name} residual",
                Prior("lognormal", level, SPREAD), (0.0, np.inf),
            )
            for name, level in zip(self.flown.outputs, self.scale, strict=True)
        ]  # fmt: skip
        return (*self.flown.dynamics.free, *states, *noise)

    def log_likelihood(self, x: Float[Array, " k"]) -> Float[Array, ""]:
        """Of all residuals; minus infinity where a trajectory leaves the envelope."""
        k, (w, _) = len(self.flown.dynamics.free), self.flown.index.shape
        s, c = len(self.flown.dynamics.states), len(self.flown.outputs)
        found = simulate(self.flown, x[:k], x[k : k + w * s].reshape(w, s))
        sigma = x[-c:] * self.flown.noise_growth
        z = found.residual / sigma
        each = -0.5 * jnp.square(z) - jnp.log(sigma) - 0.5 * jnp.log(2.0 * jnp.pi)
        total = jnp.sum(jnp.where(self.flown.inside[:, :, None], each, 0.0)) / self.cost
        inside = jnp.all(found.trajectory.inside | ~self.flown.inside)
        return jnp.where(inside & jnp.isfinite(total), total, -jnp.inf)

    def __call__(self, u: Float[Array, " k"]) -> Float[Array, ""]:
        """Log-density of `u`; differentiated forward, for a scan of thousands of steps would be stored backward."""
        return _forward(u, self)

    def start(self, fit: OutputErrorResult) -> Float[np.ndarray, " k"]:
        """The fit as a point of this density."""
        return np.concatenate([fit.estimate, fit.departure.ravel(), np.sqrt(fit.R)])


def trajectory_density(fit: OutputErrorResult, cost: float = 1.0) -> TrajectoryDensity:
    """The density whose mode, up to the noise levels' priors, is the fit with `prior_weight` = `cost`."""
    return TrajectoryDensity(fit.flown, tuple(float(x) for x in np.sqrt(fit.R)), cost)


def _plain(u: Float[Array, " k"], density: TrajectoryDensity) -> Float[Array, ""]:
    return LogDensity.__call__(density, u)


_forward = eqx.filter_custom_vjp(_plain)


@_forward.def_fwd
def _ahead(_perturbed: Any, u: Float[Array, " k"], density: TrajectoryDensity):
    directions = jnp.eye(u.shape[0])
    return jax.vmap(lambda t: jax.jvp(lambda v: _plain(v, density), (u,), (t,)), out_axes=(None, 0))(directions)


@_forward.def_bwd
def _back(slope: Any, cotangent: Any, *_: Any):
    return cotangent * slope
