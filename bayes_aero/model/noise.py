"""Noise of the measured coefficients: white, first-order autoregressive, and that with stall buffet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.aircraft import NAMES
from bayes_aero.physics.filters import recurrence


class Colour(StrEnum):
    """Assumed distribution of the residuals of one coefficient."""

    WHITE = "white"  # independent, one variance
    AR1 = "ar1"  # r[k] = rho r[k-1] + e[k], stationary within a manoeuvre
    BUFFET_AR1 = "buffet-ar1"  # the same, its standard deviation growing as 1 + buffet (1 - X)


DEFAULT = Colour.BUFFET_AR1  # near the stall a steep model also amplifies the noise of the vane


@dataclass(frozen=True)
class Noise:
    """A noise model of `coefficients`: `sigma_*` (stationary sd, attached flow), `rho_*`, `buffet_*`."""

    colour: Colour
    coefficients: tuple[str, ...] = NAMES

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of all coefficients."""
        sigma = Prior("lognormal", 0.02, 1.0, "a factor of 7 either way with 95 %; our choice")
        rho = Prior("uniform", -1.0, 2.0, "flat over the stationary range; our choice")
        buffet = Prior("halfnormal", 0.0, 3.0, "buffet up to several times the attached-flow noise; our choice")
        rows = [("sigma", 0.02, "stationary deviation of the {} residual", sigma, (0.0, jnp.inf))]
        if self.colour is not Colour.WHITE:
            rows.append(("rho", 0.5, "lag-1 correlation of the {} residual", rho, (-1.0, 1.0)))
        if self.colour is Colour.BUFFET_AR1:
            rows.append(("buffet", 0.5, "growth of the {} noise with 1 - X", buffet, (0.0, jnp.inf)))
        return tuple(
            Parameter(f"{kind}_{name}", "1", 0.0, start, text.format(name), prior, bounds)
            for kind, start, text, prior, bounds in rows
            for name in self.coefficients
        )

    def innovation(
        self,
        name: str,
        values: Mapping[str, Any],
        residual: Float[Array, " n"],
        X: Float[Array, " n"],
        start: Bool[Array, " n"],
    ) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        """Innovations of one coefficient over their standard deviation, and the logarithm of that standard deviation.

        `residual` is measured minus modelled. At `start` the innovation is the residual itself with the stationary
        standard deviation, so that manoeuvres are independent and the density is exact.
        """
        sigma = values[f"sigma_{name}"]
        log_growth = jnp.zeros(())
        if self.colour is Colour.BUFFET_AR1:
            noise_growth = 1.0 + values[f"buffet_{name}"] * (1.0 - X)
            residual, log_growth = residual / noise_growth, jnp.log(noise_growth)
        if self.colour is Colour.WHITE:
            return residual / sigma, jnp.broadcast_to(jnp.log(sigma), residual.shape)
        rho = values[f"rho_{name}"]
        innovation_sd = jnp.sqrt(1.0 - rho**2)
        before = jnp.concatenate([jnp.zeros(1), residual[:-1]])
        z = jnp.where(start, residual, (residual - rho * before) / innovation_sd) / sigma
        return z, jnp.where(start, jnp.log(sigma), jnp.log(sigma * innovation_sd)) + log_growth

    def log_density(
        self,
        name: str,
        values: Mapping[str, Any],
        residual: Float[Array, " n"],
        X: Float[Array, " n"],
        start: Bool[Array, " n"],
    ) -> Float[Array, " n"]:
        """Log-density of each sample of one coefficient given the ones before it in its manoeuvre."""
        z, log_deviation = self.innovation(name, values, residual, X, start)
        return -0.5 * (z**2 + jnp.log(2.0 * jnp.pi)) - log_deviation

    def simulate(
        self, values: Mapping[str, Any], white: Float[Array, "n c"], X: Float[Array, " n"], start: Bool[Array, " n"]
    ) -> Float[Array, "n c"]:
        """Residuals made from standard normal `white`: the inverse of `innovation`."""
        sigma = jnp.stack([values[f"sigma_{name}"] for name in self.coefficients])
        if self.colour is Colour.WHITE:
            return white * sigma
        rho = jnp.stack([values[f"rho_{name}"] for name in self.coefficients])
        first = start[:, None]
        drive = white * sigma * jnp.where(first, 1.0, jnp.sqrt(1.0 - rho**2))
        keep = jnp.where(first, 0.0, jnp.broadcast_to(rho, drive.shape))
        residual = recurrence(keep, drive)
        if self.colour is Colour.BUFFET_AR1:
            buffet = jnp.stack([values[f"buffet_{name}"] for name in self.coefficients])
            residual = residual * (1.0 + buffet * (1.0 - X)[:, None])
        return residual
