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
from itertools import combinations_with_replacement
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from jaxtyping import Array, Float, Int
from numpyro.distributions.transforms import ExpTransform
from scipy.linalg import get_lapack_funcs, solve_triangular

from bayes_aero.errors import InputError
from bayes_aero.processes import blas_threads


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


# --- Emulator of the n x n statistics near the optimum: polynomials in (log l, log g), fitted with gradients.
#
# `logdet` and the logarithmic Cholesky factor of `gram` are smooth functions of u = (log l_1..d, log g), d + 1 numbers;
# every exact evaluation gives their values and all first derivatives, so a few tens of evaluations determine a full
# cubic. `posterior.reweight` measures the error of the stand-in on exact evaluations and removes it.

DEGREE = 4  # also the order of the coefficient tensor below
# With fewer rows than this times its terms, a degree is too high.
ROWS_PER_TERM = (0.0, 2.0, 2.0, 2.0, 3.0)
REACH = 2.0  # whitened distance from a supporting point up to which the stand-in is used
SUPPORT_GAP = 12.0  # nats below the best point up to which a point supports; others train with a small weight
PAD = 64  # the list of supporting points is padded to this times a power of two: few lengths, few compiled samplers


class ExactPoint(NamedTuple):
    """One exact evaluation for training: u, the statistics and, where they were computed, their derivatives."""

    u: Float[np.ndarray, " u"]
    stats: ReducedStats
    gradient: ReducedGradient | None


class Emulator(eqx.Module):
    """Polynomial stand-in of degree <= 4 in the whitened t: coefficients of s_a s_b, where s = (t, 1) x (t, 1)."""

    # Each monomial keeps one place in that tensor, the others are zero: dense products beat gathers in XLA, and the
    # shape does not depend on the degree, so that one compiled sampler serves every round.
    centre: Float[Array, " u"]
    whiten: Float[Array, "u u"]
    coefficients: Float[Array, "pairs pairs outputs"]
    support: Float[Array, "points u"]

    def __call__(self, u: Float[Array, " u"]) -> tuple[Float[Array, ""], Float[Array, "m m"], Float[Array, ""]]:
        """(logdet, gram, penalty) at u; the penalty, <= 0, excludes regions far from exact points."""
        t = self.whiten @ (u - self.centre)
        away = t - self.support
        squares = jnp.sum(away * away, axis=1)
        nearest = jnp.argmin(squares)
        distance = jnp.sqrt(squares[nearest] + 1e-12)
        outside = jnp.maximum(distance - REACH, 0.0)
        t = t - away[nearest] * outside / distance  # a polynomial is wrong far from its data: hold it at the border
        t1 = jnp.append(t, 1.0)
        pairs = (t1[:, None] * t1).ravel()
        z = pairs @ jnp.tensordot(pairs, self.coefficients, 1)
        m = u.shape[0] + 1
        lower = jnp.zeros((m, m)).at[np.tril_indices(m, -1)].set(z[m + 1 :])
        lower = lower + jnp.diag(jnp.exp(z[1 : m + 1]))
        return z[0], lower @ lower.T, -8.0 * outside**2


def outputs(point: ExactPoint) -> tuple[Float[np.ndarray, " outputs"], Float[np.ndarray, "u outputs"]]:
    """(logdet, log diagonal, strict lower part of chol gram) and their derivatives by u, NaN if unknown."""
    m = point.stats.gram.shape[0]
    lower = np.linalg.cholesky(point.stats.gram)
    rows = np.tril_indices(m, -1)

    def pack(logdet, diagonal, factor):
        return np.concatenate([[logdet], diagonal, factor[rows]])

    value, slopes = pack(point.stats.logdet, np.log(np.diag(lower)), lower), []
    if point.gradient is None:
        return value, np.full((point.u.size, value.size), np.nan)
    for d_logdet, d_gram in zip(point.gradient.logdet, point.gradient.gram, strict=True):
        inner = solve_triangular(lower, d_gram, lower=True)
        inner = solve_triangular(lower, inner.T, lower=True)
        d_lower = lower @ (np.tril(inner, -1) + 0.5 * np.diag(np.diag(inner)))
        slopes.append(pack(d_logdet, np.diag(d_lower) / np.diag(lower), d_lower))
    return value, np.array(slopes)


def design(
    t: Float[np.ndarray, "points u"], powers: Int[np.ndarray, "terms degree"]
) -> Float[np.ndarray, "rows terms"]:
    """Rows of the least-squares problem: monomial values at t, then their derivatives by each coordinate."""
    points, d = t.shape
    padded = np.hstack([t, np.ones((points, 1))])
    factors = padded[:, powers]  # (points, terms, degree)
    blocks = [factors.prod(axis=2)]
    for k in range(d):
        slope = np.zeros(factors.shape[:2])
        for j in range(powers.shape[1]):
            others = np.delete(factors, j, axis=2).prod(axis=2)
            slope += np.where(powers[:, j] == k, others, 0.0)
        blocks.append(slope)
    return np.concatenate(blocks)


def fit_emulator(
    points: list[ExactPoint], log_posterior: Float[np.ndarray, " points"], degree: int = DEGREE
) -> Emulator:
    """Weighted least squares on values and gradients of `points`, with the highest degree that they determine."""
    # The weight of a point follows from its `log_posterior`. Coordinates are whitened by the points near the best one.
    u, gap = np.array([p.u for p in points]), np.max(log_posterior) - log_posterior
    d = u.shape[1]
    near = gap <= max(SUPPORT_GAP, np.sort(gap)[min(3 * d, gap.size - 1)])
    centre, root = u[near].mean(axis=0), np.linalg.cholesky(np.cov(u[near].T))
    whiten = solve_triangular(root, np.eye(d), lower=True)
    t = (u - centre) @ whiten.T
    rows = sum(1 if p.gradient is None else d + 1 for p in points)
    while degree > 1 and ROWS_PER_TERM[degree] * math.comb(d + degree, degree) > rows:
        degree -= 1
    # Factor indices of every monomial up to this degree, padded with d (which stands for 1).
    powers = np.array(list(combinations_with_replacement(range(d + 1), degree)))
    values, slopes = zip(*(outputs(p) for p in points), strict=True)
    by_t = np.einsum("jk,pjz->kpz", root, np.array(slopes)).reshape(d * len(u), -1)
    weight = np.tile(1.0 / (1.0 + gap / SUPPORT_GAP) ** 2, d + 1)[:, None]
    left, right = design(t, powers) * weight, np.vstack([values, by_t]) * weight
    known = np.all(np.isfinite(right), axis=1)
    coefficients, *_ = np.linalg.lstsq(left[known], right[known], rcond=1e-12)
    support = t[near]
    length = PAD * 2 ** max(0, math.ceil(math.log2(len(support) / PAD)))
    support = np.concatenate([support, np.repeat(support[:1], length - len(support), axis=0)])
    padded = np.pad(powers, ((0, 0), (0, DEGREE - powers.shape[1])), constant_values=d)
    tensor = np.zeros(((d + 1) ** 4, coefficients.shape[1]))
    tensor[np.ravel_multi_index(tuple(padded.T), (d + 1,) * 4)] = coefficients
    tensor = tensor.reshape((d + 1) ** 2, (d + 1) ** 2, -1)
    return Emulator(jnp.asarray(centre), jnp.asarray(whiten), jnp.asarray(tensor), jnp.asarray(support))


# --- The n x n part of the marginal likelihood: what is needed of (length scales, noise-to-signal), and no more.
# Write K = sf^2 (R + F D F'), R = SE(l) + g I, F = [1, X], D = diag(s0^2, s_1^2 .. s_d^2)/sf^2. Then log|K| and
# y'K^-1 y follow exactly, by the matrix determinant and inversion lemmas, from
# logdet = log|R| and gram = [F y]' R^-1 [F y], (d + 2) x (d + 2),
# which depend on u = (log l_1..d, log g) alone. So the expensive function has d + 1 arguments, not 2d + 3, and
# smooth, small outputs; the other hyperparameters cost microseconds (`optimum.slopes`).
# The gradient is analytic. With V = R^-1 [F y]: d gram = -V' dR V, and d logdet = tr(R^-1 dR). The SE part has
# dR/dlog l_k = SE o (x_ik - x_jk)^2 (elementwise), and sum_ij M_ij (x_ik - x_jk)^2 for a symmetric M needs only M's
# row sums and M x: no n x n x p array is ever formed. LAPACK potrf + potri, n^3 flops together.

DEPENDENT = 1e-6  # of singular values: its square is lost in the rounding of a gram that R^-1 stretches
dpotrf, dpotrs, dpotri = get_lapack_funcs(("potrf", "potrs", "potri"), dtype=np.float64)


class ReducedData(NamedTuple):
    """Scaled training data: inputs x (n, d) and F_y = [1, x, y] (n, d + 2)."""

    x: Float[np.ndarray, "n d"]
    fy: Float[np.ndarray, "n m"]

    @classmethod
    def of(cls, x: Float[np.ndarray, "n d"], y: Float[np.ndarray, " n"]) -> "ReducedData":
        """From scaled inputs and output."""
        return cls(np.ascontiguousarray(x), np.column_stack([np.ones(len(x)), x, y]))

    @property
    def n(self) -> int:
        """Number of training samples."""
        return self.x.shape[0]

    @property
    def dependent(self) -> bool:
        """Whether a column of F_y is a combination of the others: an input given twice, or an output that is linear."""
        values = np.linalg.svd(self.fy / np.linalg.norm(self.fy, axis=0), compute_uv=False)
        return bool(values[-1] <= DEPENDENT * values[0])


class ReducedStats(NamedTuple):
    """logdet = log|R| and gram = [F y]'R^-1[F y]. Not positive definite: `ok` is False and both are NaN."""

    logdet: float
    gram: Float[np.ndarray, "m m"]
    ok: bool = True


class ReducedGradient(NamedTuple):
    """Derivatives of logdet (d + 1,) and gram (d + 1, m, m) with respect to u."""

    logdet: Float[np.ndarray, " u"]
    gram: Float[np.ndarray, "u m m"]


def factorise(
    u: Float[np.ndarray, " u"], data: ReducedData, se: Float[np.ndarray, "n n"] | None = None
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n m"]] | None:
    """Lower Cholesky factor of R at u = (log l, log g), and R^-1 [F y]; None if R has none. `se`: SE(l), if known."""
    d = data.x.shape[1]
    x = data.x / np.exp(u[:d])
    r = scaled_distance_kernel(x, x) if se is None else se.copy()
    np.fill_diagonal(r, 1.0 + np.exp(u[d]))
    # r is symmetric and C-ordered, so its transpose is the Fortran array that LAPACK overwrites without a copy.
    lower, info = dpotrf(r.T, lower=1, clean=1, overwrite_a=1)
    return None if info != 0 else (lower, dpotrs(lower, data.fy, lower=1)[0])


def _stats(factor: tuple[np.ndarray, np.ndarray] | None, data: ReducedData) -> ReducedStats:
    if factor is None:
        m = data.fy.shape[1]
        return ReducedStats(np.nan, np.full((m, m), np.nan), ok=False)
    lower, v = factor
    gram = data.fy.T @ v
    return ReducedStats(2.0 * float(np.sum(np.log(np.diagonal(lower)))), 0.5 * (gram + gram.T))


def reduced_stats(u: Float[np.ndarray, " u"], data: ReducedData) -> ReducedStats:
    """logdet and gram at u = (log l, log g): one Cholesky factorisation."""
    return _stats(factorise(u, data), data)


def stats_and_gradient(u: Float[np.ndarray, " u"], data: ReducedData) -> tuple[ReducedStats, ReducedGradient]:
    """logdet, gram and their derivatives with respect to u: one factorisation and one inversion."""
    d, m = data.x.shape[1], data.fy.shape[1]
    d_logdet, d_gram = np.full(d + 1, np.nan), np.full((d + 1, m, m), np.nan)
    with blas_threads(data.n):
        x, g = data.x / np.exp(u[:d]), float(np.exp(u[d]))
        se = scaled_distance_kernel(x, x)
        factor = factorise(u, data, se)
        stats = _stats(factor, data)
        if factor is None:
            return stats, ReducedGradient(d_logdet, d_gram)
        lower, v = factor
        xv = [x[:, [k]] * v for k in range(d)]
        se_v = se @ np.concatenate([v, *xv], axis=1)
        for k in range(d):
            cross = (x[:, [k]] * xv[k]).T @ se_v[:, :m]
            d_gram[k] = 2.0 * xv[k].T @ se_v[:, m * (k + 1) : m * (k + 2)] - cross - cross.T
        d_gram[d] = -g * v.T @ v
        inverse, _ = dpotri(lower, lower=1, overwrite_c=1)
        d_logdet[d] = g * np.trace(inverse)
        half = np.multiply(inverse.T, se, out=se)  # one triangle of R^-1 o SE, the other is zero
        d_logdet[:d] = 2.0 * ((x * x).T @ (half.sum(axis=0) + half.sum(axis=1)))
        d_logdet[:d] -= 4.0 * np.einsum("ij,ij->j", x, half @ x)
    return stats, ReducedGradient(d_logdet, d_gram)
