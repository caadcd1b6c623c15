"""The most probable hyperparameters: many fast starts on thinned data, the best few refined at all n points.

Only u = (log l, log g) is searched at n x n cost. For each u the other d + 2 hyperparameters are brought to their own
optimum, which costs no factorisation, and the derivative of the profile is the partial derivative there
(envelope theorem; variable projection). DPSE has poor local optima (on ATTAS, CD has several), hence the starts.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from bayes_aero.inference.gp.kernel import (
    ExactPoint,
    HyperPrior,
    Priors,
    ReducedData,
    ReducedStats,
    length_slice,
    noise_to_signal,
    stats_and_gradient,
)

LENGTH_BOUNDS = (-4.6, 6.9)  # log of scaled length scales: 0.01 to 1000 sd of the input
NOISE_BOUNDS = (-20.0, 16.0)  # log sn^2/sf^2; the lower end keeps R factorisable in double precision
SCREEN_SIZE, MIDDLE_SIZE = 300, 1000
GRADIENT_TOLERANCE = 0.05  # nats per unit of u at which BFGS stops: under 0.01 nat below the optimum
DIFFERENCE_STEP = 0.05  # of log l and log g, for the curvature at an optimum
SAME_OPTIMUM = 0.5  # two optima closer than this in every log l and log g are one


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

    theta: Float[np.ndarray, " p"]
    value: float
    gradient: float
    status: MapStatus

    @property
    def u(self) -> Float[np.ndarray, " u"]:
        """(log l, log g) of the optimum."""
        return noise_to_signal(self.theta)


class _NotPositiveDefiniteError(Exception):
    """R has no Cholesky factor at this u."""


class ProfilePosterior:
    """max over w of log q + log p(y | w, u); `w` is the next start, `points` has every exact evaluation."""

    def __init__(self, data: ReducedData, priors: Priors, w: Float[np.ndarray, " w"] | None = None):
        self.data, self.priors, self.n = data, priors, float(data.n)
        self.w = np.zeros(data.x.shape[1] + 2) if w is None else w
        self.points: list[ExactPoint] = []

    def inner(self, u: Float[np.ndarray, " u"], stats: ReducedStats) -> Slopes:
        """The log posterior at the optimal w for this u; stores it in `self.w`."""
        try:
            self.w, found = best_sizes(self.w, u, stats, self.n, self.priors)
        except np.linalg.LinAlgError:
            raise _NotPositiveDefiniteError from None
        return found

    def __call__(self, u: Float[np.ndarray, " u"]) -> tuple[float, Float[np.ndarray, " u"], Float[np.ndarray, " p"]]:
        """Profile value at u, its gradient in u, and the theta that attains it."""
        stats, du = stats_and_gradient(u, self.data)
        self.points.append(ExactPoint(u, stats, du))
        if not stats.ok:
            raise _NotPositiveDefiniteError
        best = self.inner(u, stats)
        gradient = best.by_logdet * du.logdet + np.tensordot(du.gram, best.by_gram, 2)
        gradient[:-1] += best.by_theta[length_slice(u.size - 1)]
        gradient[-1] += 0.5 * best.by_theta[-1]
        return best.value, gradient, assemble(self.w, u)


def maximise(
    u: Float[np.ndarray, " u"],
    data: ReducedData,
    priors: Priors,
    *,
    w: Float[np.ndarray, " w"] | None = None,
    covariance: Float[np.ndarray, "u u"] | None = None,
    max_iterations: int = 60,
    tolerance: float = 1e-9,
) -> Optimum:
    """Local optimum from u (and w) by L-BFGS-B over u; `tolerance` is relative in the log posterior."""
    # Where a guess of the Laplace `covariance` of u is at hand, BFGS starts from it: half the evaluations.
    profile = ProfilePosterior(data, priors, w)
    box = np.array([LENGTH_BOUNDS] * (u.size - 1) + [NOISE_BOUNDS])
    best: tuple[float, np.ndarray, np.ndarray] | None = None

    def negative(at):
        nonlocal best
        value, gradient, theta = profile(np.clip(at, box[:, 0], box[:, 1]))
        if best is None or value > best[0]:
            best = value, gradient, theta
        return -value, -gradient

    start = np.clip(u, box[:, 0], box[:, 1])
    if covariance is None:
        method, options = "L-BFGS-B", {"ftol": tolerance, "gtol": 1e-4, "maxls": 25}
    else:
        method, options = "BFGS", {"hess_inv0": covariance, "gtol": GRADIENT_TOLERANCE}
    options["maxiter"] = max_iterations
    limits = box if covariance is None else None
    try:
        out = minimize(negative, start, jac=True, method=method, bounds=limits, options=options)
        status = MapStatus.iteration_limit if out.status == 1 else MapStatus.converged
    except _NotPositiveDefiniteError:
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


def starting_points(priors: Priors, d: int, count: int, seed: int) -> Float[np.ndarray, "starts u"]:
    """`count` starts in u: three fixed ones, the rest from the prior (log-normal(1, 1) where it is flat)."""
    length, noise = priors.length, priors.noise
    length = HyperPrior("log-normal", 1.0, 1.0) if length.family == "flat" else length
    noise = HyperPrior("log-normal", 0.1, 1.0) if noise.family == "flat" else noise
    fixed = np.array([[0.0] * d + [-3.0], [1.0] * d + [-3.0], [-1.0] * d + [-1.0]])
    keys = jax.random.split(jax.random.PRNGKey(seed))
    lengths = np.asarray(length.sample(keys[0], (count, d)))
    noises = 2.0 * np.asarray(noise.sample(keys[1], (count, 1)))
    return np.concatenate([fixed, np.hstack([lengths, noises])])[:count]


def thinned(data: ReducedData, size: int, seed: int) -> ReducedData:
    """At most `size` of the samples, chosen at random with `seed`."""
    if data.n <= size:
        return data
    rows = np.sort(np.random.default_rng(seed).choice(data.n, size, replace=False))
    return ReducedData(data.x[rows], data.fy[rows])


def distinct(optima: list[Optimum], count: int) -> list[Optimum]:
    """The best `count` optima that are not the same one in u, best first; unbounded directions count as equal."""
    kept: list[Optimum] = []
    for optimum in sorted(optima, key=lambda o: -o.value):
        at = np.minimum(optimum.u, 2.5)  # beyond 12 sd of the input a length scale is "flat", wherever it is
        if all(np.max(np.abs(at - np.minimum(k.u, 2.5))) > SAME_OPTIMUM for k in kept):
            kept.append(optimum)
    return kept[:count]


def find_map(
    data: ReducedData,
    priors: Priors,
    *,
    starts: int = 16,
    polish: int = 2,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> list[Optimum]:
    """The distinct optima found, best first: `starts` on 300 points, the best 4 on 1000, the best `polish` on n."""
    tell = progress or (lambda _: None)
    d = data.x.shape[1]
    screen = thinned(data, SCREEN_SIZE, seed)
    tell(f"screening {starts} starts on {screen.n} points")
    points = starting_points(priors, d, starts, seed)
    optima = [maximise(u, screen, priors, max_iterations=30, tolerance=1e-5) for u in points]
    optima = distinct(optima, 4)
    middle = thinned(data, MIDDLE_SIZE, seed + 1)
    if middle.n > screen.n:
        tell(f"refining {len(optima)} optima on {middle.n} points")
        optima = [maximise(o.u, middle, priors, w=o.theta[: d + 2], max_iterations=40, tolerance=1e-7) for o in optima]
        optima = distinct(optima, polish)
    tell(f"polishing {len(optima[:polish])} optima on all {data.n} points")
    whole = []
    for o in optima[:polish]:
        guess = None
        if data.n > middle.n and o.status is MapStatus.converged:  # the curvature grows with n
            guess = curvature(o, middle, priors)[0] * middle.n / data.n
        whole.append(maximise(o.u, data, priors, w=o.theta[: d + 2], covariance=guess))
    return distinct(whole, polish)


def curvature(optimum: Optimum, data: ReducedData, priors: Priors) -> tuple[Float[np.ndarray, "u u"], list[ExactPoint]]:
    """Laplace covariance of u (standard deviation at most 1.5 in undetermined directions), and its exact points."""
    profile = ProfilePosterior(data, priors, optimum.theta[: data.x.shape[1] + 2].copy())
    u = optimum.u
    _, base, _ = profile(u)
    rows = [(profile(u + step)[1] - base) / DIFFERENCE_STEP for step in DIFFERENCE_STEP * np.eye(u.size)]
    values, vectors = np.linalg.eigh(-0.5 * (np.array(rows) + np.array(rows).T))
    covariance = (vectors / np.maximum(values, 1.0 / 1.5**2)) @ vectors.T
    return 0.5 * (covariance + covariance.T), profile.points


# --- The most probable s0, s_i and sf at given length scales and noise-to-signal ratio, by Newton's method.
# The density is `posterior.small_posterior`, of a dozen unknowns at most and asked for tens of thousands of times:
# calls into compiled code, and compiling it anew for every number of inputs, would cost more than the sums. With r =
# s/sf, B = 1 + r G r and y = B^-1 r b (G and b are parts of the gram, Rasmussen and Williams, sec. 2.7)
# d log p/d log s_i = y_i^2/sf^2 - 1 + (B^-1)_ii,
# and second derivatives follow in the same way.

SD_BOUNDS = (-10.0, 6.0)  # log of scaled sds: 5e-5 to 400 times the output's rms
GAIN_TOLERANCE = 1e-12  # expected gain of the last Newton step, relative to the log posterior (at least 1000 nats)
MIN_CURVATURE = 1e-3  # of a direction, so that steps along nearly flat ones stay finite
MAX_STEP, FIRST_STEP = 4.0, 2.0  # in log units
MIN_STEP, MAX_STEPS = 1e-9, 100


class Slopes(NamedTuple):
    """Log posterior at theta, with its derivatives by theta (p,), by w (k,) once and twice, by logdet and by gram."""

    value: float
    by_theta: Float[np.ndarray, " p"]
    by_w: Float[np.ndarray, " k"]
    by_w_twice: Float[np.ndarray, "k k"]
    by_logdet: float
    by_gram: Float[np.ndarray, "m m"]


def assemble(w: Float[np.ndarray, " w"], u: Float[np.ndarray, " u"]) -> Float[np.ndarray, " p"]:
    """theta from w = log (s0, s_i, sf) and u = (log l, log g)."""
    return np.concatenate([w, u[:-1], [w[-1] + 0.5 * u[-1]]])


def slopes(
    w: Float[np.ndarray, " k"], u: Float[np.ndarray, " u"], stats: ReducedStats, n: float, priors: Priors
) -> Slopes:
    """The posterior at (w, u) given the statistics at u; derivatives by w let log sn move with log sf, by theta not."""
    m, gram, log_sf = w.size - 1, stats.gram, w[-1]
    G, b, c, e = gram[:m, :m], gram[:m, m], gram[m, m], np.exp(-2.0 * log_sf)
    r = np.exp(w[:m] - log_sf)
    lower = np.linalg.cholesky(np.eye(m) + r[:, None] * G * r)
    P = np.linalg.inv(lower)
    P = P.T @ P
    y = P @ (r * b)
    quadratic = (c - (r * b) @ y) * e
    log_k = 2.0 * n * log_sf + stats.logdet + 2.0 * np.sum(np.log(np.diagonal(lower)))
    theta = assemble(w, u)
    density, slope, bend = priors.slopes(theta)
    value = -0.5 * (quadratic + log_k + n * np.log(2.0 * np.pi)) + density

    first = np.empty(m + 1)
    first[:m] = y**2 * e - 1.0 + np.diagonal(P)
    first[m] = quadratic - n - first[:m].sum()
    inner = 2.0 * P * (P + 2.0 * e * np.outer(y, y)) - 2.0 * np.diag(e * y**2 + np.diagonal(P))
    mixed = -2.0 * e * y**2
    second = np.empty((m + 1, m + 1))
    second[:m, :m] = inner
    second[:m, m] = second[m, :m] = mixed - inner.sum(axis=1)
    second[m, m] = -2.0 * quadratic - 2.0 * mixed.sum() + inner.sum()

    by_theta = slope.copy()
    by_theta[: m + 1] += first
    first, second = first + slope[: m + 1], second + np.diag(bend[: m + 1])
    first[m], second[m, m] = first[m] + slope[-1], second[m, m] + bend[-1]
    z = r * y
    by_gram = np.zeros_like(gram)
    by_gram[:m, :m] = -0.5 * (e * np.outer(z, z) + r[:, None] * P * r)
    by_gram[:m, m] = e * z
    by_gram[m, m] = -0.5 * e
    return Slopes(float(value), by_theta, first, second, -0.5, by_gram)


def best_sizes(
    w: Float[np.ndarray, " k"], u: Float[np.ndarray, " u"], stats: ReducedStats, n: float, priors: Priors
) -> tuple[Float[np.ndarray, " k"], Slopes]:
    """w at the top of the posterior at u, from a start `w`, within `SD_BOUNDS`; and the posterior there."""
    # Curvatures count by their size, so that the step leads uphill where the posterior is not concave, too.
    low, high = SD_BOUNDS
    w = np.clip(w, low, high)
    at, radius = slopes(w, u, stats, n, priors), FIRST_STEP
    for _ in range(MAX_STEPS):
        held = ((w <= low) & (at.by_w < 0.0)) | ((w >= high) & (at.by_w > 0.0))
        g = np.where(held, 0.0, at.by_w)
        H = np.where(held[:, None] | held, 0.0, at.by_w_twice)
        values, vectors = np.linalg.eigh(H)
        step = vectors @ (vectors.T @ g / np.maximum(np.abs(values), MIN_CURVATURE))
        promised, length = g @ step, np.max(np.abs(step))
        step *= min(1.0, radius / max(length, 1e-300))
        there = np.clip(w + step, low, high)
        try:
            new = slopes(there, u, stats, n, priors)
        except np.linalg.LinAlgError:  # sds too far apart for double precision
            new = None
        if new is not None and new.value >= at.value:
            w, at, radius = there, new, min(2.0 * radius, MAX_STEP)
        else:
            radius = 0.25 * min(length, radius)
        if promised < GAIN_TOLERANCE * max(1e3, abs(at.value)) or radius < MIN_STEP:
            break
    return w, at
