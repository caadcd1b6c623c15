"""The seed paper's kernel ("DPSE"), its eleven hyperparameters and their scaling.

k(x, x') = s0^2 + sum_i s_i^2 x_i x_i' + sf^2 exp(-1/2 sum_i (x_i - x_i')^2 / l_i^2) + sn^2 delta      (Eq. 3-5)

theta = log [s0, s_1..s_d, sf, l_1..l_d, sn], 2d + 3 numbers, in scaled units: inputs minus training mean over
training sd, output over training rms but not centred, because the prior mean is zero and s0 carries the offset.

Caveat, true of every number this package prints from a GP: sn is *white* noise, while the residuals of 25 Hz
flight data have a lag-1 correlation up to 0.98. The GP then takes correlated error for signal in its inputs
(length scales too short), its intervals are too narrow for a new manoeuvre, and a random split, which leaks
neighbours, hides both. Judge it on the manoeuvre split.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.distributions.transforms import ExpTransform

from bayes_aero.errors import InputError


def length_slice(d: int) -> slice:
    """Positions of the d log length scales in theta."""
    return slice(d + 2, 2 * d + 2)


def hyper_names(input_names: tuple[str, ...]) -> list[str]:
    """Flat names in the order of theta, for labels and messages."""
    linear = [f"linear[{name}]" for name in input_names]
    length = [f"length_scale[{name}]" for name in input_names]
    return ["constant", *linear, "signal", *length, "noise"]


def noise_to_signal(theta: Float[np.ndarray, " p"]) -> Float[np.ndarray, " u"]:
    """u = (log l_1..d, log g), g = sn^2/sf^2: the only directions in which an n x n factorisation is needed."""
    d = (theta.size - 3) // 2
    return np.append(theta[length_slice(d)], 2 * (theta[-1] - theta[d + 1]))


def scaled_distance_kernel(a: Float[np.ndarray, "n d"], b: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "n m"]:
    """exp(-1/2 |a - b|^2) for inputs already divided by their length scales; one n x m array, worked in place."""
    # |a - b|^2 is expanded, a.b - a.a/2 - b.b/2; rounding can leave it barely positive, hence the clip at zero.
    e = a @ b.T
    e -= 0.5 * np.einsum("ij,ij->i", a, a)[:, None]
    e -= 0.5 * np.einsum("ij,ij->i", b, b)
    np.minimum(e, 0.0, out=e)
    # exp(-300) = 1e-130 is zero beside the diagonal of 1, but far smaller numbers are subnormal, which are slow.
    np.maximum(e, -300.0, out=e)
    return np.exp(e, out=e)


@dataclass(frozen=True, eq=False)
class Scaling:
    """Training mean (d,) and sd (d,) of the inputs, rms of the output: conversion to scaled units and back."""

    mean: Float[np.ndarray, " d"]
    sd: Float[np.ndarray, " d"]
    rms: float

    @classmethod
    def of(cls, X: np.ndarray, y: np.ndarray, names: tuple[str, ...]) -> "Scaling":
        """Scaling of training inputs (n, d) and output (n,); data that cannot be fitted are refused."""
        if X.ndim != 2 or y.shape != X.shape[:1] or len(names) != X.shape[1]:
            raise InputError(f"Inputs {X.shape}, output {y.shape} and {len(names)} input names do not go together.")
        n, d = X.shape
        if n < 2 * d + 4:
            raise InputError(f"{n} samples cannot determine {2 * d + 3} hyperparameters; give more samples.")
        for name, column in (*zip(names, X.T, strict=True), ("output", y)):
            if not np.all(np.isfinite(column)):
                at = int(np.flatnonzero(~np.isfinite(column))[0])
                raise InputError(f"{name} is not finite at sample {at}; remove or repair that sample.")
        mean, sd, rms = X.mean(axis=0), X.std(axis=0), float(np.sqrt(np.mean(y**2)))
        flat = sd <= 1e-12 * (np.abs(mean) + np.max(np.abs(X), axis=0))
        if np.any(flat):
            which = ", ".join(n for n, f in zip(names, flat, strict=True) if f)
            raise InputError(f"Input {which} does not vary over the training samples; leave it out of the GP.")
        if not rms > 0:
            raise InputError("The output is zero at every training sample; there is nothing to model.")
        return cls(mean, sd, rms)

    def inputs(self, X: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """Physical inputs to scaled ones."""
        return (X - self.mean) / self.sd

    def physical(self, theta: Float[np.ndarray, "*draws p"]) -> dict[str, np.ndarray]:
        """Hyperparameters in physical units, from log scaled theta (..., 2d + 3)."""
        # `constant`, `signal`, `noise`: unit of the output. `linear` (..., d): sd of the slope about the training mean,
        # output unit per input unit. `length_scale` (..., d): unit of the input.
        d, x = self.sd.size, np.exp(theta)
        return {
            "constant": np.asarray(x[..., 0] * self.rms),
            "linear": x[..., 1 : d + 1] * self.rms / self.sd,
            "signal": np.asarray(x[..., d + 1] * self.rms),
            "length_scale": x[..., length_slice(d)] * self.sd,
            "noise": np.asarray(x[..., -1] * self.rms),
        }


# --- Hyperparameter priors q(theta), all in one place, in the scaled units of this module.
# Each prior speaks of a positive hyperparameter x (a standard deviation or a length scale); the engine works with t
# = log x, so every density here carries the Jacobian x. Scaled units: inputs have training mean 0 and sd 1, the
# output has training rms 1, so that one set of numbers serves every coefficient and no prior depends on units.


@dataclass(frozen=True)
class HyperPrior:
    """Prior of one positive hyperparameter.

    half-normal: `a` is the scale. log-normal: `a` is the median, `b` the sd of the logarithm.
    inverse-gamma: `a` is the concentration, `b` the scale. frechet: `a` is the scale, `b` the shape, P(x < a/c) =
    exp(-c^b): a steep lower end, a power law above. flat: constant in log x, improper, for benchmarks.
    """

    family: Literal["half-normal", "log-normal", "inverse-gamma", "frechet", "flat"]
    a: float = 1.0
    b: float = 1.0
    source: str = "our choice"

    def __post_init__(self):
        if not (self.a > 0 and self.b > 0):
            raise InputError(f"The {self.family} prior needs positive parameters, got a = {self.a}, b = {self.b}.")

    def distribution(self) -> dist.Distribution:
        """The density of x; a flat prior has none."""
        if self.family == "half-normal":
            return dist.HalfNormal(self.a)
        if self.family == "log-normal":
            return dist.LogNormal(jnp.log(self.a), self.b)
        if self.family == "inverse-gamma":
            return dist.InverseGamma(self.a, self.b)
        if self.family == "frechet":  # the logarithm of a Frechet variable is a Gumbel one
            return dist.TransformedDistribution(dist.Gumbel(jnp.log(self.a), 1.0 / self.b), ExpTransform())
        raise InputError("A flat hyperparameter prior is improper and cannot be drawn from; give a proper one.")

    def log_density(self, t: Float[Array, "..."]) -> Float[Array, "..."]:
        """Log density of t = log x."""
        if self.family == "flat":
            return jnp.zeros_like(t)
        return jnp.asarray(self.distribution().log_prob(jnp.exp(t))) + t

    def slopes(self, t: Float[np.ndarray, " k"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`log_density` at each t, and its first and second derivatives."""
        one = np.ones_like(t)
        if self.family == "half-normal":
            x2 = np.exp(2.0 * t) / self.a**2
            return 0.5 * math.log(2.0 / math.pi) - math.log(self.a) - 0.5 * x2 + t, 1.0 - x2, -2.0 * x2
        if self.family == "log-normal":
            z = (t - math.log(self.a)) / self.b
            return -0.5 * z**2 - math.log(self.b * math.sqrt(2.0 * math.pi)), -z / self.b, -one / self.b**2
        if self.family == "inverse-gamma":
            y = self.b * np.exp(-t)
            return self.a * (math.log(self.b) - t) - y - math.lgamma(self.a), y - self.a, -y
        if self.family == "frechet":
            z = self.b * (t - math.log(self.a))
            y = np.exp(-z)
            return math.log(self.b) - z - y, self.b * (y - 1.0), -(self.b**2) * y
        return 0.0 * t, 0.0 * t, 0.0 * t

    def sample(self, key: Array, shape: tuple[int, ...]) -> Float[Array, "..."]:
        """Draws of t = log x."""
        return jnp.log(self.distribution().sample(key, shape))  # pyright: ignore[reportArgumentType]


FLAT = HyperPrior("flat", source="constant in the logarithm: the paper's and scikit-learn's silent choice")


@dataclass(frozen=True)
class Priors:
    """q(theta): constant s0, linear s_i, signal sf, length scales l_i, noise sn (linear and length per input)."""

    constant: HyperPrior = HyperPrior(
        "half-normal", 1.0, source="our choice: the output has rms 1, its offset is not likely beyond 2"
    )
    linear: HyperPrior = HyperPrior(
        "half-normal",
        1.0,
        source="our choice: one sd of an input moves the output by no more than about its own rms; "
        "half-normal on sds after the Stan User's Guide, Gaussian processes, 'Priors for marginal sd'",
    )
    signal: HyperPrior = HyperPrior(
        "half-normal", 1.0, source="our choice, as for the linear part: the non-linear part is not larger than y"
    )
    length: HyperPrior = HyperPrior(
        "log-normal",
        1.0,
        1.0,
        source="our choice: 95 % between 0.14 and 7 sd of the input, from finer than any buffet cycle resolves "
        "to longer than the whole flown range, beyond which the linear part takes over",
    )
    noise: HyperPrior = HyperPrior(
        "log-normal", 0.1, 1.0, source="our choice: 95 % between 1.4 % and 71 % of the output's rms"
    )

    @classmethod
    def flat(cls) -> "Priors":
        """No prior at all: maximum marginal likelihood. Improper, so it can be optimised but not sampled."""
        return cls(FLAT, FLAT, FLAT, FLAT, FLAT)

    @classmethod
    def quasi_steady(cls) -> "Priors":
        """For quasi-steady coefficients of a manoeuvre: no feature much finer than the flown range of an input."""
        # The likelihood takes its errors for white and everywhere alike. In flight they are neither: on the ATTAS
        # records the error of CD is 5 times larger in the stall than before it, nearly all of it buffet at 7.7 Hz,
        # which is no function of alpha, elevator, pitch rate or airspeed. With n in the thousands that likelihood
        # outbids any weak prior by hundreds of nats to explain buffet by short length scales, and the process then
        # swings between the samples of a steep passage. So the lower end has to be as steep as the data's push is: a
        # Frechet density charges (6/l)^10 nats for a length scale of l sd.
        length = HyperPrior(
            "frechet",
            6.0,
            10.0,
            source="our choice: 95 % between 5.3 and 8.7 sd of the input, about the flown range (4 to 10 sd on ATTAS), "
            "over which a sample function bends about once, as a stall does",
        )
        return cls(length=length)

    @property
    def proper(self) -> bool:
        """Whether every hyperparameter has a normalisable prior."""
        parts = (self.constant, self.linear, self.signal, self.length, self.noise)
        return all(p.family != "flat" for p in parts)

    def per_parameter(self, d: int) -> list[HyperPrior]:
        """The 2d + 3 priors in the order of theta."""
        return [self.constant, *[self.linear] * d, self.signal, *[self.length] * d, self.noise]

    def log_density(self, theta: Float[Array, " p"]) -> Float[Array, ""]:
        """log q(theta) of theta (2d + 3,), logs of the scaled hyperparameters."""
        d = (theta.shape[0] - 3) // 2
        return (
            self.constant.log_density(theta[0])
            + jnp.sum(self.linear.log_density(theta[1 : d + 1]))
            + self.signal.log_density(theta[d + 1])
            + jnp.sum(self.length.log_density(theta[length_slice(d)]))
            + self.noise.log_density(theta[2 * d + 2])
        )

    def slopes(self, theta: Float[np.ndarray, " p"]) -> tuple[float, Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """log q(theta), its gradient, and the diagonal of its second derivatives, beside which there is nothing."""
        d = (theta.size - 3) // 2
        parts = (self.constant, 1), (self.linear, d), (self.signal, 1), (self.length, d), (self.noise, 1)
        pieces = np.split(theta, np.cumsum([count for _, count in parts])[:-1])
        values, slopes, bends = zip(
            *(prior.slopes(piece) for (prior, _), piece in zip(parts, pieces, strict=True)), strict=True
        )
        return float(sum(v.sum() for v in values)), np.concatenate(slopes), np.concatenate(bends)

    def sample(self, key: Array, d: int, draws: int) -> Float[Array, "draws p"]:
        """Draws of theta from the prior."""
        keys = jax.random.split(key, 2 * d + 3)
        parts = zip(keys, self.per_parameter(d), strict=True)
        return jnp.stack([prior.sample(k, (draws,)) for k, prior in parts], axis=1)
