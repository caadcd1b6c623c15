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

import enum
import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import get_lapack_funcs
from scipy.optimize import minimize

from bayes_aero.arrays import AnyArray, namespace, xp
from bayes_aero.errors import InputError
from bayes_aero.processes import blas_threads

Theta = Float[np.ndarray, " p"]
LengthsAndNoise = Float[np.ndarray, " u"]


def length_slice(d: int) -> slice:
    """Positions of the d log length scales in theta."""
    return slice(d + 2, 2 * d + 2)


def noise_to_signal(theta: Theta) -> LengthsAndNoise:
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
    def of(cls, X: Float[np.ndarray, "n d"], y: Float[np.ndarray, " n"], names: tuple[str, ...]) -> Scaling:
        """Scaling of training inputs and output; data that cannot be fitted are refused."""
        n, d = X.shape
        if n < 2 * d + 4:
            raise InputError(f"{n} samples cannot determine {2 * d + 3} hyperparameters; give more samples.")
        mean, sd = X.mean(axis=0), X.std(axis=0)
        flat = sd <= 1e-12 * (np.abs(mean) + np.max(np.abs(X), axis=0))
        if np.any(flat):
            which = ", ".join(n for n, f in zip(names, flat, strict=True) if f)
            raise InputError(f"Input {which} does not vary over the training samples; leave it out of the GP.")
        rms = float(np.sqrt(np.mean(y**2)))
        if not (np.isfinite(X).all() and 0.0 < rms < np.inf):
            raise InputError("An input or the output is not finite, or the output is zero at every training sample.")
        return cls(mean, sd, rms)

    def inputs(self, X: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
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

    half-normal: `a` is the scale. log-normal: `a` is the median, `b` the sd of the logarithm. frechet: `a` is the
    scale, `b` the shape, P(x < a/c) = exp(-c^b): a steep lower end, a power law above.
    """

    family: Literal["half-normal", "log-normal", "frechet"]
    a: float = 1.0
    b: float = 1.0

    def slopes(self, t: Float[AnyArray, "*s"]) -> tuple[Any, Any]:
        """Log density of each t = log x, and its derivative."""
        z = self.b * (t - math.log(self.a))
        if self.family == "half-normal":
            x2 = xp.exp(2.0 * t) / self.a**2
            return 0.5 * math.log(2.0 / math.pi) - math.log(self.a) - 0.5 * x2 + t, 1.0 - x2
        if self.family == "log-normal":
            z = z / self.b**2
            return -0.5 * z**2 - math.log(self.b * math.sqrt(2.0 * math.pi)), -z / self.b
        y = xp.exp(-z)
        return math.log(self.b) - z - y, self.b * (y - 1.0)

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Draws of t = log x."""
        if self.family == "frechet":  # the logarithm of a Frechet variable is a Gumbel one
            return math.log(self.a) + rng.gumbel(size=shape) / self.b
        normal = rng.standard_normal(shape)
        return np.log(self.a * np.abs(normal)) if self.family == "half-normal" else math.log(self.a) + self.b * normal


@dataclass(frozen=True)
class Priors:
    """q(theta): constant s0, linear s_i, signal sf, length scales l_i, noise sn (linear and length per input)."""

    # All our choice. The output has rms 1: its offset is not likely beyond 2, one sd of an input moves it by no more
    # than about its own rms, and the non-linear part is not larger than it; half-normal on sds after the Stan User's
    # Guide, Gaussian processes. Length scales: 95 % between 0.14 and 7 sd of the input, from finer than any buffet
    # cycle resolves to longer than the whole flown range. Noise: 95 % between 1.4 % and 71 % of the output's rms.
    constant: HyperPrior = HyperPrior("half-normal")
    linear: HyperPrior = HyperPrior("half-normal")
    signal: HyperPrior = HyperPrior("half-normal")
    length: HyperPrior = HyperPrior("log-normal")
    noise: HyperPrior = HyperPrior("log-normal", 0.1)

    @classmethod
    def quasi_steady(cls) -> Priors:
        """For quasi-steady coefficients of a manoeuvre: no feature much finer than the flown range of an input."""
        # The likelihood takes its errors for white and everywhere alike. In flight they are neither: on the ATTAS
        # records the error of CD is 5 times larger in the stall than before it, nearly all of it buffet at 7.7 Hz,
        # which is no function of alpha, elevator, pitch rate or airspeed. With n in the thousands that likelihood
        # outbids any weak prior by hundreds of nats to explain buffet by short length scales, and the process then
        # swings between the samples of a steep passage. So the lower end has to be as steep as the data's push is: a
        # Frechet density charges (6/l)^10 nats for a length scale of l sd: 95 % between 5.3 and 8.7 sd of the input,
        # about the flown range (4 to 10 sd on ATTAS), over which a sample function bends about once, as a stall does.
        return cls(length=HyperPrior("frechet", 6.0, 10.0))

    @property
    def each(self) -> tuple[HyperPrior, ...]:
        """Those of the five groups of hyperparameters, in the order of theta."""
        return self.constant, self.linear, self.signal, self.length, self.noise

    def slopes(self, theta: Float[AnyArray, " p"]) -> tuple[Any, Any]:
        """log q(theta) and its gradient."""
        lib, d = namespace(theta), (theta.size - 3) // 2
        pieces = lib.split(theta, [1, d + 1, d + 2, 2 * d + 2])
        values, slopes = zip(*(q.slopes(t) for q, t in zip(self.each, pieces, strict=True)), strict=True)
        return sum(v.sum() for v in values), lib.concatenate(slopes)

    def sample(self, rng: np.random.Generator, d: int, draws: int) -> Float[np.ndarray, "draws p"]:
        """Draws of theta."""
        return np.hstack([q.sample(rng, (draws, k)) for q, k in zip(self.each, (1, d, 1, d, 1), strict=True)])


# --- The n x n part of the marginal likelihood: what is needed of (length scales, noise-to-signal), and no more.
# Write K = sf^2 (R + F D F'), R = SE(l) + g I, F = [1, X], D = diag(s0^2, s_1^2 .. s_d^2)/sf^2. Then log|K| and
# y'K^-1 y follow exactly, by the matrix determinant and inversion lemmas, from
# logdet = log|R| and gram = [F y]' R^-1 [F y], (d + 2) x (d + 2),
# which depend on u = (log l_1..d, log g) alone. So the expensive function has d + 1 arguments, not 2d + 3, and
# smooth, small outputs; the other hyperparameters cost microseconds (`slopes`).
# The gradient is analytic. With V = R^-1 [F y]: d gram = -V' dR V, and d logdet = tr(R^-1 dR). The SE part has
# dR/dlog l_k = SE o (x_ik - x_jk)^2 (elementwise), and sum_ij M_ij (x_ik - x_jk)^2 for a symmetric M needs only M's
# row sums and M x: no n x n x p array is ever formed. LAPACK potrf + potri, n^3 flops together.

dpotrf, dpotrs, dpotri = get_lapack_funcs(("potrf", "potrs", "potri"), dtype=np.float64)


class ReducedData(NamedTuple):
    """Scaled training data: inputs x (n, d) and F_y = [1, x, y] (n, d + 2)."""

    x: Float[np.ndarray, "n d"]
    fy: Float[np.ndarray, "n m"]

    @classmethod
    def of(cls, x: Float[np.ndarray, "n d"], y: Float[np.ndarray, " n"]) -> ReducedData:
        return cls(np.ascontiguousarray(x), np.column_stack([np.ones(len(x)), x, y]))

    @property
    def n(self) -> int:
        return self.x.shape[0]


class ExactPoint(NamedTuple):
    """logdet = log|R| and gram = [F y]'R^-1[F y] at u, with their derivatives by u; NaN where R is not positive
    definite, and derivatives also where they were not asked for."""

    u: LengthsAndNoise
    logdet: float
    gram: Float[np.ndarray, "m m"]
    d_logdet: LengthsAndNoise
    d_gram: Float[np.ndarray, "u m m"]

    @property
    def ok(self) -> bool:
        return math.isfinite(self.logdet)


def exact_point(u: LengthsAndNoise, data: ReducedData, *, slopes: bool = True) -> ExactPoint:
    """The exact statistics at u: one factorisation, and one inversion for their `slopes`."""
    d, m = data.x.shape[1], data.fy.shape[1]
    d_logdet, d_gram = np.full(d + 1, np.nan), np.full((d + 1, m, m), np.nan)
    with blas_threads(data.n):
        x, g = data.x / np.exp(u[:d]), float(np.exp(u[d]))
        r = scaled_distance_kernel(x, x)
        se = r.copy() if slopes else None
        np.fill_diagonal(r, 1.0 + g)
        # r is symmetric and C-ordered, so its transpose is the Fortran array that LAPACK overwrites without a copy.
        lower, info = dpotrf(r.T, lower=1, clean=1, overwrite_a=1)
        if info != 0:
            return ExactPoint(u, math.nan, np.full((m, m), np.nan), d_logdet, d_gram)
        v = dpotrs(lower, data.fy, lower=1)[0]
        gram, logdet = data.fy.T @ v, 2.0 * float(np.sum(np.log(np.diagonal(lower))))
        if se is not None:
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
    return ExactPoint(u, logdet, 0.5 * (gram + gram.T), d_logdet, d_gram)


# --- The most probable hyperparameters: many fast starts on thinned data, the best few refined at all n points.
# Only u = (log l, log g) is searched at n x n cost. For each u the other d + 2 hyperparameters are brought to their own
# optimum, which costs no factorisation, and the derivative of the profile is the partial derivative there
# (envelope theorem; variable projection). DPSE has poor local optima (on ATTAS, CD has several), hence the starts.

LENGTH_BOUNDS = (-4.6, 6.9)  # log of scaled length scales: 0.01 to 1000 sd of the input
NOISE_BOUNDS = (-20.0, 16.0)  # log sn^2/sf^2; the lower end keeps R factorisable in double precision
SCREEN_SIZE, MIDDLE_SIZE = 300, 1000
DIFFERENCE_STEP = 0.05  # of log l and log g, for the curvature at an optimum
SAME_OPTIMUM = 0.5  # two optima closer than this in every log l and log g are one


def search_box(d: int) -> Float[np.ndarray, "u 2"]:
    """Bounds of u."""
    return np.array([LENGTH_BOUNDS] * d + [NOISE_BOUNDS])


class MapStatus(enum.Enum):
    """How the search for the most probable hyperparameters ended; the value says what to do."""

    converged = "Converged to the best optimum of all starts."
    at_bound = (
        "Converged, but a hyperparameter sits on its search bound: the data do not determine it; "
        "give it a proper prior or leave that input out."
    )
    iteration_limit = "Stopped at the iteration limit; raise max_iterations or look for a redundant input."
    not_positive_definite = (
        "The covariance matrix could not be factorised: the noise is too small for the data's duplicates; "
        "give the noise a prior with a larger median."
    )


class Optimum(NamedTuple):
    """A local optimum: theta (2d + 3,), its log posterior and the largest gradient component left in u."""

    theta: Theta
    value: float
    gradient: float
    status: MapStatus

    @property
    def u(self) -> LengthsAndNoise:
        return noise_to_signal(self.theta)


class ProfilePosterior:
    """max over w of log q + log p(y | w, u), its gradient, and theta; `w` is the next start."""

    def __init__(self, data: ReducedData, priors: Priors, w: Float[np.ndarray, " w"] | None = None):
        self.data, self.priors = data, priors
        self.w = np.zeros(data.x.shape[1] + 2) if w is None else w

    def inner(self, point: ExactPoint) -> Slopes:
        """The posterior at the best w; `LinAlgError` where a matrix is not positive definite."""
        if not point.ok:
            raise np.linalg.LinAlgError
        self.w, best = best_sizes(self.w, point, self.data.n, self.priors)
        return best

    def __call__(self, u: LengthsAndNoise) -> tuple[float, LengthsAndNoise, Theta]:
        point = exact_point(u, self.data)
        best = self.inner(point)
        gradient = -0.5 * point.d_logdet + np.tensordot(point.d_gram, best.by_gram, 2)
        gradient[:-1] += best.by_theta[length_slice(u.size - 1)]
        gradient[-1] += 0.5 * best.by_theta[-1]
        return best.value, gradient, assemble(self.w, u)


def maximise(
    u: LengthsAndNoise,
    data: ReducedData,
    priors: Priors,
    *,
    w: Float[np.ndarray, " w"] | None = None,
    max_iterations: int = 60,
    tolerance: float = 1e-9,
) -> Optimum:
    """Local optimum from u (and w) by L-BFGS-B over u; `tolerance` is relative in the log posterior."""
    profile, box = ProfilePosterior(data, priors, w), search_box(u.size - 1)
    best: tuple[float, np.ndarray, np.ndarray] | None = None

    def negative(at):
        nonlocal best
        value, gradient, theta = profile(np.clip(at, *box.T))
        if best is None or value > best[0]:
            best = value, gradient, theta
        return -value, -gradient

    options = {"ftol": tolerance, "gtol": 1e-4, "maxls": 25, "maxiter": max_iterations}
    try:
        out = minimize(negative, np.clip(u, *box.T), jac=True, method="L-BFGS-B", bounds=box, options=options)
        status = MapStatus.iteration_limit if out.status == 1 else MapStatus.converged
    except np.linalg.LinAlgError:
        status = MapStatus.not_positive_definite
    if best is None:
        return Optimum(assemble(profile.w, u), -np.inf, np.inf, status)
    value, gradient, theta = best
    at = noise_to_signal(theta)
    near = np.any(np.isclose(at, box[:, 0], atol=1e-6) | np.isclose(at, box[:, 1], atol=1e-6))
    near |= np.any(np.isclose(theta[: u.size + 1, None], SD_BOUNDS, atol=1e-6))
    if status is MapStatus.converged and near:
        status = MapStatus.at_bound
    return Optimum(theta, value, float(np.max(np.abs(gradient))), status)


def distinct(optima: list[Optimum], count: int) -> list[Optimum]:
    """The best `count` optima that are not the same one in u, best first; unbounded directions count as equal."""
    kept: list[Optimum] = []
    for optimum in sorted(optima, key=lambda o: -o.value):
        at = np.minimum(optimum.u, 2.5)  # beyond 12 sd of the input a length scale is "flat", wherever it is
        if all(np.max(np.abs(at - np.minimum(k.u, 2.5))) > SAME_OPTIMUM for k in kept):
            kept.append(optimum)
    return kept[:count]


def find_map(data: ReducedData, priors: Priors, *, starts: int = 16, polish: int = 2, seed: int = 0) -> list[Optimum]:
    """The distinct optima found, best first: `starts` on 300 points, the best 4 on 1000, the best `polish` on n."""
    d, rows = data.x.shape[1], [np.random.default_rng(seed + i).permutation(data.n) for i in (0, 1)]
    screen, middle = (ReducedData(data.x[at], data.fy[at]) for at in (rows[0][:SCREEN_SIZE], rows[1][:MIDDLE_SIZE]))
    rng = np.random.default_rng([seed, 2])
    drawn = np.hstack([priors.length.sample(rng, (starts, d)), 2.0 * priors.noise.sample(rng, (starts, 1))])
    points = np.concatenate([[[0.0] * d + [-3.0], [1.0] * d + [-3.0], [-1.0] * d + [-1.0]], drawn])[:starts]
    optima = distinct([maximise(u, screen, priors, max_iterations=30, tolerance=1e-5) for u in points], 4)
    if middle.n > screen.n:
        limits: Any = {"max_iterations": 40, "tolerance": 1e-7}
        optima = distinct([maximise(o.u, middle, priors, w=o.theta[: d + 2], **limits) for o in optima], polish)
    return distinct([maximise(o.u, data, priors, w=o.theta[: d + 2]) for o in optima[:polish]], polish)


def curvature(optimum: Optimum, data: ReducedData, priors: Priors) -> Float[np.ndarray, "u u"]:
    """Laplace covariance of u (standard deviation at most 1.5 in undetermined directions)."""
    profile, u = ProfilePosterior(data, priors, optimum.theta[: data.x.shape[1] + 2].copy()), optimum.u
    base = profile(u)[1]
    rows = np.array([(profile(u + step)[1] - base) / DIFFERENCE_STEP for step in DIFFERENCE_STEP * np.eye(u.size)])
    values, vectors = np.linalg.eigh(-0.5 * (rows + rows.T))
    covariance = (vectors / np.maximum(values, 1.0 / 1.5**2)) @ vectors.T
    return 0.5 * (covariance + covariance.T)


# --- The most probable s0, s_i and sf at given length scales and noise-to-signal ratio, within bounds.
# They are of a dozen unknowns at most and asked for tens of thousands of times: calls into compiled code, and compiling
# it anew for every number of inputs, would cost more than the sums. With r = s/sf, B = 1 + r G r and y = B^-1 r b (G
# and b are parts of the gram, Rasmussen and Williams, sec. 2.7)
# d log p/d log s_i = y_i^2/sf^2 - 1 + (B^-1)_ii.

SD_BOUNDS = (-10.0, 6.0)  # log of scaled sds: 5e-5 to 400 times the output's rms


class Slopes(NamedTuple):
    """Log posterior at theta, with its derivatives by theta (p,), by w (k,) and by gram; by logdet it is -1/2."""

    value: float
    by_theta: Float[np.ndarray, " p"]
    by_w: Float[np.ndarray, " k"]
    by_gram: Float[np.ndarray, "m m"]


def assemble(w: Float[np.ndarray, " w"], u: LengthsAndNoise) -> Float[np.ndarray, " p"]:
    """theta from w = log (s0, s_i, sf) and u = (log l, log g)."""
    return np.concatenate([w, u[:-1], [w[-1] + 0.5 * u[-1]]])


def slopes(w: Float[np.ndarray, " k"], point: ExactPoint, n: int, priors: Priors) -> Slopes:
    """The posterior at (w, point.u) of n samples; derivatives by w let log sn move with log sf, by theta not."""
    m, gram, log_sf = w.size - 1, point.gram, w[-1]
    G, b, c, e = gram[:m, :m], gram[:m, m], gram[m, m], np.exp(-2.0 * log_sf)
    r = np.exp(w[:m] - log_sf)
    lower = np.linalg.cholesky(np.eye(m) + r[:, None] * G * r)
    P = np.linalg.inv(lower)
    P = P.T @ P
    y = P @ (r * b)
    quadratic = (c - (r * b) @ y) * e
    log_k = 2.0 * n * log_sf + point.logdet + 2.0 * np.sum(np.log(np.diagonal(lower)))
    density, slope = priors.slopes(assemble(w, point.u))
    value = -0.5 * (quadratic + log_k + n * np.log(2.0 * np.pi)) + density
    of_sizes = y**2 * e - 1.0 + np.diagonal(P)
    by_theta = slope.copy()
    by_theta[: m + 1] += np.append(of_sizes, quadratic - n - of_sizes.sum())
    by_w = by_theta[: m + 1].copy()
    by_w[m] += slope[-1]
    z = r * y
    by_gram = np.zeros_like(gram)
    by_gram[:m, :m] = -0.5 * (e * np.outer(z, z) + r[:, None] * P * r)
    by_gram[:m, m] = e * z
    by_gram[m, m] = -0.5 * e
    return Slopes(float(value), by_theta, by_w, by_gram)


def density_at(theta: Theta, point: ExactPoint, n: int, priors: Priors) -> float:
    """The log posterior given the statistics; NaN where there are none, or sds too far apart for double precision."""
    try:
        return slopes(theta[: point.u.size + 1], point, n, priors).value if point.ok else math.nan
    except np.linalg.LinAlgError:
        return math.nan


def best_sizes(
    w: Float[np.ndarray, " k"], point: ExactPoint, n: int, priors: Priors
) -> tuple[Float[np.ndarray, " k"], Slopes]:
    """w at the top of the posterior at point.u, from a start `w`, within `SD_BOUNDS`; and the posterior there."""

    def negative(w: np.ndarray) -> tuple[float, np.ndarray]:
        try:
            at = slopes(w, point, n, priors)
        except np.linalg.LinAlgError:  # sds too far apart for double precision
            return 1e300, np.zeros(w.size)
        return -at.value, -at.by_w

    options, bounds = {"ftol": 0.0, "gtol": 1e-6, "maxiter": 500}, [SD_BOUNDS] * w.size
    w = np.clip(w, *SD_BOUNDS)
    for _ in range(3):  # anew from its end, where a nearly flat direction had too short a step
        w = minimize(negative, w, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
    return w, slopes(w, point, n, priors)
