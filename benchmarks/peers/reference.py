"""The published stall model and its white-noise posterior in plain NumPy and SciPy: what the benchmarks race against.

Written from the published equations (Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 12, as its
companion program runs them), not from this package's effects, and as fast as vectorised NumPy reasonably goes: logs
and constants that do not change between calls are worked out once.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import log_expit

if TYPE_CHECKING:  # a peer's process reads a pickled reference and must not carry the weight of JAX
    from bayes_aero.model.observations import Density, Observations

PARAMETERS = ("CL0", "CLa", "CLaM", "Cmde", "Cm0", "Cma", "Cmq", "CD0", "e", "tau2", "a1", "alpha_star", "CDX", "CmX")


class Reference:
    """CL, CD, Cm of the 14-parameter model at the samples of `observations`; a parameter vector follows `names`."""

    def __init__(self, observations: Observations, names: tuple[str, ...]) -> None:
        if sorted(names) != sorted(PARAMETERS):
            raise ValueError(f"the reference has the parameters {PARAMETERS}, not {names}")
        self.order = [names.index(name) for name in PARAMETERS]
        s = {key: np.asarray(value) for key, value in observations.signals.items()}
        a = observations.aircraft
        self.measured = np.ascontiguousarray(np.asarray(observations.measured).T)  # (3, n)
        self.alpha, self.mach, self.elevator = s["alpha"], s["mach"], s["elevator"]
        self.qhat = s["q"] * a.chord / s["airspeed"]
        self.falling = a.chord / s["airspeed"] * np.minimum(s["alpha_dot"], 0.0)  # rad a chord, where alpha falls
        self.lever = float(a.chord / a.tail_arm)
        self.pi_aspect = math.pi * float(a.aspect_ratio)

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        """CL, CD, Cm as rows, (3, n)."""
        CL0, CLa, CLaM, Cmde, Cm0, Cma, Cmq, CD0, e, tau2, a1, alpha_star, CDX, CmX = theta[self.order]
        X = (1.0 - np.tanh(a1 * (self.alpha - tau2 * self.falling - alpha_star))) / 2.0
        separated = 1.0 - X
        attached = CL0 + (CLa + CLaM * self.mach) * self.alpha - Cmde * self.lever * self.elevator
        out = np.empty_like(self.measured)
        out[0] = attached + CLa * self.alpha * (((1.0 + np.sqrt(X)) / 2.0) ** 2 - 1.0)
        out[1] = CD0 + attached**2 / (e * self.pi_aspect) + CDX * separated
        out[2] = Cm0 + Cma * self.alpha + Cmq * self.qhat + Cmde * self.elevator + CmX * separated
        return out


class WhitePosterior:
    """Log-density of one walker: white Gaussian noise, the card's priors, and the Jacobian of the unbounded scale.

    `u` is on the unbounded scale of `density` (identity, log or logit of the bounds), 14 model parameters, then three
    noise deviations; the value is that of `density` itself.
    """

    def __init__(self, density: Density) -> None:
        self.model = Reference(density.observations, density.names[:-3])
        self.n = density.observations.n
        parameters = density.parameters
        self.lower, self.upper = (np.array([p.bounds[i] for p in parameters]) for i in (0, 1))
        self.above = np.isfinite(self.lower) & np.isinf(self.upper)
        self.between = np.isfinite(self.lower) & np.isfinite(self.upper)
        if np.any(np.isinf(self.lower) & np.isfinite(self.upper)):
            raise ValueError("a parameter with an upper bound alone is not needed here")
        self.width = self.upper[self.between] - self.lower[self.between]
        self.log_width = float(np.sum(np.log(self.width)))
        family = np.array([p.prior.family for p in parameters])
        if set(family) - {"normal", "lognormal", "halfnormal"}:
            raise ValueError(f"the priors are {set(family)}; the reference knows normal, lognormal and halfnormal")
        self.in_logs = family == "lognormal"
        self.half = family == "halfnormal"
        self.centre = np.array([p.prior.location for p in parameters])
        self.floor = self.centre[self.half]
        self.centre[self.in_logs] = np.log(self.centre[self.in_logs])
        scale = np.array([p.prior.scale for p in parameters])
        self.per_scale = 1.0 / scale
        self.constant = -float(np.sum(np.log(scale))) - 0.5 * len(scale) * math.log(2.0 * math.pi)
        self.constant += float(np.sum(self.half)) * math.log(2.0) - 1.5 * self.n * math.log(2.0 * math.pi)

    def bounded(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Parameters of `u`, (..., 17), within their bounds, and the logarithm of the map's Jacobian, (...)."""
        x, above, inner = u.copy(), u[..., self.above], u[..., self.between]
        x[..., self.above] = self.lower[self.above] + np.exp(above)
        log_share = log_expit(inner)
        x[..., self.between] = self.lower[self.between] + self.width * np.exp(log_share)
        slope = np.sum(above, axis=-1) + np.sum(log_share + log_expit(-inner), axis=-1) + self.log_width
        return x, slope

    def __call__(self, u: np.ndarray) -> float:
        """Log-density at `u`, shape (17,)."""
        x, slope = self.bounded(u)
        if np.any(x[self.half] < self.floor):
            return -math.inf
        z = x.copy()
        z[self.in_logs] = np.log(x[self.in_logs])
        prior = -0.5 * np.sum(((z - self.centre) * self.per_scale) ** 2) - np.sum(z[self.in_logs])
        sigma = x[-3:]
        with np.errstate(over="ignore", invalid="ignore"):  # a wild walker is refused below
            squared = np.sum((self.model.measured - self.model(x[:-3])) ** 2, axis=1)
            value = prior + slope + self.constant - self.n * np.sum(np.log(sigma)) - 0.5 * np.sum(squared / sigma**2)
        return float(value) if np.isfinite(value) else -math.inf


def agree(ours: np.ndarray, theirs: np.ndarray, limit: float = 1e-10) -> float:
    """Largest difference relative to the size of `theirs`; an error beyond `limit`."""
    apart = float(np.max(np.abs(ours - theirs)) / np.max(np.abs(theirs)))
    if not apart <= limit:
        raise AssertionError(f"the reference and the package differ by {apart:.1e}; they must be the same model")
    return apart
