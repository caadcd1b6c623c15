"""Normal equations of an output-error step: inner products of residuals and sensitivities, with the priors.

Each segment has its own initial state, which is eliminated from the equations of that segment.
"""

from __future__ import annotations

import math
import os
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft import POINTS
from bayes_aero.dynamics.flight import Dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, simulate
from bayes_aero.inference.compiled_programs import cores

INITIAL_STATE_SD = {"airspeed": 1.0, "alpha": 0.01, "theta": 0.01, "q": 0.01, "altitude": 3.0} | dict.fromkeys(
    POINTS, 0.1
)
"""Standard deviation of the measured initial state, SI: the accuracy of flight-test sensors; our choice."""
INITIAL_STATE_SD_BY_UNIT = {"m/s": 1.0, "m": 3.0}  # of states with another name, by unit
DEFAULT_INITIAL_STATE_SD = 0.05
TINY = 1e-300
MAX_GRAM = 1e100  # inner products beyond this: the motion is not unique
REGULARISATION = 1e-12  # added to a diagonal, relative: above rounding, below the information of any record
ENVELOPE_PENALTY = 1e6  # cost of a trajectory that is wholly outside the envelope: worse than any inside


def initial_state_sd(dynamics: Dynamics) -> Float[np.ndarray, " s"]:
    """Standard deviations of the measured initial state, SI."""
    own = {name: INITIAL_STATE_SD_BY_UNIT.get(unit, DEFAULT_INITIAL_STATE_SD) for name, unit in dynamics.units.items()}
    return np.array([INITIAL_STATE_SD.get(name, own.get(name, DEFAULT_INITIAL_STATE_SD)) for name in dynamics.start])


@dataclass(frozen=True)
class NormalPriors:
    """Normal priors; the precisions are times `weight`, the variance inflation of coloured residuals (0: none)."""

    mean: Float[np.ndarray, " k"]  # of theta
    precision: Float[np.ndarray, " k"]
    states: Float[np.ndarray, " s"]  # precision of the corrections of the initial states
    weight: float = 1.0
    fixed: bool = False  # the initial states are not corrected

    @classmethod
    def of(cls, flown: SegmentTrajectories, weight: float, without: Collection[str] = ()) -> NormalPriors:
        """Normal approximations of all priors, times `weight`; the parameters `without` have no prior."""
        pairs = np.array([p.prior.normal for p in flown.dynamics.free]).reshape(-1, 2)
        deviations = initial_state_sd(flown.dynamics)
        with_prior = np.array([p.name not in without for p in flown.dynamics.free], float)
        precisions = weight * with_prior * pairs[:, 1] ** -2.0, weight * deviations**-2.0
        return cls(pairs[:, 0], *precisions, weight, flown.fixed is not None)


class InnerProducts(NamedTuple):
    """Inner products of residuals and sensitivities of w segments, c outputs, k parameters and s initial states."""

    gram: Float[np.ndarray, "w c j j"]  # j = 1 + k + s: the residual comes first
    count: Float[np.ndarray, " w"]  # samples
    inside: float  # share of the samples inside the envelope
    columns: tuple[np.ndarray, ...]  # residuals and sensitivities (w, n, c, j) over the noise growth, in parts along w


@eqx.filter_jit
def _inner_products(flown: SegmentTrajectories, theta: Float[Array, " k"], departure: Float[Array, "w s"]):
    """Gram matrices, samples inside the envelope, and columns; forward sensitivities, all directions at once."""
    k, s = theta.shape[0], departure.shape[1]

    def residual(theta, shared):
        found = simulate(flown, theta, departure + shared)
        return found.residual, found.trajectory.inside

    point = (theta, jnp.zeros(s))
    towards = (jnp.concatenate([jnp.eye(k), jnp.zeros((s, k))]), jnp.concatenate([jnp.zeros((k, s)), jnp.eye(s)]))
    r, slope, inside = jax.vmap(lambda t: jax.jvp(residual, point, t, has_aux=True), out_axes=(None, -1, None))(towards)
    columns = jnp.concatenate([r[..., None], -slope], axis=-1) / flown.noise_growth[..., None]  # w n c j
    return jnp.einsum("wnci,wncj->wcij", columns, columns), jnp.sum(inside & flown.inside, axis=1), columns


class NormalEquations:
    """Normal equations of one set of segments, evaluated at many points; the segments are divided among the cores."""

    # XLA runs a scan on one core. The first evaluation takes the parts one by one, so that only one thread compiles. A
    # part without samples is not simulated.
    def __init__(self, flown: SegmentTrajectories, prior: NormalPriors):
        w = len(flown.index)
        size = -(-w // min(w, os.cpu_count() or 1))
        self.prior = prior
        self.count = flown.inside.sum(axis=1).astype(float)
        self.noise_growth = float(np.log(flown.noise_growth[flown.inside]).sum())
        self._rows = [np.minimum(np.arange(a, a + size), w - 1) for a in range(0, w, size)]  # the last may repeat
        self._parts = {
            number: jax.tree.map(jnp.asarray, flown.nameless.part(rows))
            for number, rows in enumerate(self._rows)
            if flown.inside[rows].any()
        }
        self._compiled = False

    def evaluate(self, theta: Float[np.ndarray, " k"], departure: Float[np.ndarray, "w s"]) -> Point:
        """Cost and normal equations at parameters and initial states."""
        at, w = jnp.asarray(theta), len(departure)

        def one(number):
            found = _inner_products(self._parts[number], at, jnp.asarray(departure[self._rows[number]]))
            return tuple(np.asarray(x) for x in found)

        if len(self._parts) > 1 and self._compiled:
            with ThreadPoolExecutor(min(len(self._parts), cores())) as pool:
                found = dict(zip(self._parts, pool.map(one, self._parts), strict=True))
        else:
            found = {number: one(number) for number in self._parts}
        self._compiled = True
        zeros = tuple(np.zeros_like(x) for x in next(iter(found.values())))
        gram, within, columns = zip(*(found.get(i, zeros) for i in range(len(self._rows))), strict=True)
        gram, within = np.concatenate(gram)[:w], np.concatenate(within)[:w]
        products = InnerProducts(gram, self.count, float(within.sum() / self.count.sum()), columns)
        return _point(theta, departure, products, self.prior, self.noise_growth)

    def extrapolate(self, point: Point, step: Float[np.ndarray, " k"], own: Float[np.ndarray, "w s"]) -> Point:
        """Normal equations after a short step of parameters and initial states, with residuals linear in the step."""
        w = len(own)
        all_steps = np.concatenate([np.tile(step, (w, 1)), own], axis=1)
        transform = np.tile(np.eye(1 + all_steps.shape[1]), (w, 1, 1))
        transform[:, 1:, 0] = -all_steps
        gram = np.einsum("wia,wcij,wjb->wcab", transform, point.products.gram, transform, optimize=True)
        columns = []
        for rows, part in zip(self._rows, point.products.columns, strict=True):
            shifted = part.copy()
            shifted[..., 0] -= np.einsum("wncj,wj->wnc", part[..., 1:], all_steps[rows])
            columns.append(shifted)
        products = point.products._replace(gram=gram, columns=tuple(columns))
        return _point(point.theta + step, point.departure + own, products, self.prior, self.noise_growth)


class Point(NamedTuple):
    """Normal equations at one point: parameters, corrections of the initial states, residual variances R, cost."""

    theta: Float[np.ndarray, " k"]
    departure: Float[np.ndarray, "w s"]
    products: InnerProducts
    R: Float[np.ndarray, " c"]
    cost: float


def _point(
    theta: np.ndarray, departure: np.ndarray, products: InnerProducts, prior: NormalPriors, noise_growth: float
) -> Point:
    """`noise_growth`: sum of its logarithms over all samples and outputs, a term of the likelihood."""
    gram, total = products.gram, products.count.sum()
    if not np.all(np.abs(gram) < MAX_GRAM):
        return Point(theta, departure, products._replace(inside=0.0), np.ones(gram.shape[1]), math.inf)
    R = np.maximum(gram[:, :, 0, 0].sum(axis=0) / total, TINY)
    cost = 0.5 * total * float(np.sum(np.log(R))) + noise_growth
    cost += 0.5 * float(prior.precision @ (theta - prior.mean) ** 2) + 0.5 * float(np.sum(departure**2 @ prior.states))
    if products.inside < 1.0:
        cost += ENVELOPE_PENALTY * (1.0 - products.inside)
    return Point(theta, departure, products, R, cost)


class EliminatedStates(NamedTuple):
    """Eliminated initial states of the segments, as functions of the step of theta."""

    inverse: Float[np.ndarray, "w s s"]
    cross: Float[np.ndarray, "w s k"]
    gradient: Float[np.ndarray, "w s"]
    gain: float

    def step(self, theta: Float[np.ndarray, " k"]) -> Float[np.ndarray, "w s"]:
        """Optimal step of the initial states (w, s) for a step of theta (k,)."""
        return np.einsum("wij,wj->wi", self.inverse, self.gradient - self.cross @ theta)


def reduced_equations(
    point: Point, prior: NormalPriors
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"], EliminatedStates]:
    """Information and gradient of theta with the initial states eliminated, including the priors."""
    A, g, states = segment_equations(point, prior)
    A = A.sum(axis=0) + np.diag(prior.precision)
    return A, g.sum(axis=0) - prior.precision * (point.theta - prior.mean), states


def segment_equations(
    point: Point, prior: NormalPriors
) -> tuple[Float[np.ndarray, "w k k"], Float[np.ndarray, "w k"], EliminatedStates]:
    """Information and gradient of theta by segment with the initial states eliminated, without the priors of theta."""
    k = len(point.theta)
    N = np.einsum("wcij,c->wij", point.products.gram, 1.0 / point.R)
    if prior.fixed:
        w, s = point.departure.shape
        states = EliminatedStates(np.zeros((w, s, s)), np.zeros((w, s, k)), np.zeros((w, s)), 0.0)
        return N[:, 1 : k + 1, 1 : k + 1], N[:, 1 : k + 1, 0], states
    own = N[:, k + 1 :, k + 1 :] + np.diag(prior.states)
    cross, gradient = N[:, k + 1 :, 1 : k + 1], N[:, k + 1 :, 0] - prior.states * point.departure
    # Cholesky factors keep the digits of A - cross' own^-1 cross where a trial is unstable.
    one = np.eye(own.shape[-1])
    own = own + one * (own == 0.0)  # a state without information and prior is not corrected
    try:
        L = np.linalg.cholesky(own)
    except np.linalg.LinAlgError:  # rounding makes the matrix of an unstable flight indefinite
        L = np.linalg.cholesky(own + REGULARISATION * own * one)
    Y, y = np.linalg.solve(L, cross), np.linalg.solve(L, gradient[:, :, None])[:, :, 0]
    A = N[:, 1 : k + 1, 1 : k + 1] - np.einsum("wia,wib->wab", Y, Y)
    g = N[:, 1 : k + 1, 0] - np.einsum("wia,wi->wa", Y, y)
    gain = 0.5 * float(np.sum(y**2))
    inverse = np.linalg.inv(L)
    inverse = np.swapaxes(inverse, 1, 2) @ inverse
    return A, g, EliminatedStates(inverse, cross, gradient, gain)
