"""Which candidate explains what the model leaves: evidence of each, and how often noise alone would look as good."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from bayes_aero.criticism.lagged import ROUNDS, Fit, Lagged, inverse, stationary
from bayes_aero.criticism.state import State

REPLICATES = 200  # noise-only replicates behind every p-value
CORRECTION = 40  # replicates that measure the bias of the autoregression
RECHECKED = 5  # candidates per replicate whose noise is re-estimated


@dataclass(frozen=True)
class Standing:
    """One candidate: log of its Bayes factor against the present model, deviance gained, estimate of its step.

    `score` is the square root of the deviance gained: standard errors, for an effect of one parameter.
    """

    effect: str
    columns: tuple[int, ...]
    value: float | None
    log_bayes: float
    score: float
    step: tuple[float, ...]
    sd: tuple[float, ...]


def standings(state: State, fit: Fit, without: str | None = None) -> list[Standing]:
    """All candidates that are not in, the best first; each fitted with all active parameters and the noise free.

    Bayes factors by Laplace's method under the parameters' priors. `without` takes one addition out first, to first
    order: it then stands for election like the others.
    """
    lagged, mean = state.lagged, state.mean
    active = tuple(e for e in state.active if e != without)
    columns = state.columns(active)
    blocks = [b for b in state.blocks if b[0] not in active]
    if without is not None:
        own = state.field.columns(state.field.parameters_of(without))
        neutral = np.array([state.field.neutral[name] for name in state.field.parameters_of(without)])
        lagged = lagged.shifted(own, neutral - state.theta[own])
        mean = mean.copy()
        mean[own] += state.theta[own] - neutral
    if not blocks:
        return []
    result = _elect(lagged, columns, [b[1] for b in blocks], mean, state.precision, fit.phi, ROUNDS)
    found = []
    for j, (effect, own, value) in enumerate(blocks):
        place = np.arange(len(columns), len(columns) + len(own))
        deviation = np.sqrt(np.maximum(np.diag(inverse(result.normal[j])), 0.0))
        possible = value is None or result.step[j, place[0]] * (value - _present(state, effect)) > 0.0
        found.append(
            Standing(
                effect=effect,
                columns=tuple(int(i) for i in own),
                value=value,
                log_bayes=float(result.log_bayes[j]) if possible else -math.inf,
                score=float(np.sqrt(max(0.0, 2.0 * result.gained[j]))),
                step=tuple(float(x) for x in result.step[j, place]),
                sd=tuple(float(x) for x in deviation[place]),
            )
        )
    return sorted(found, key=lambda s: -s.log_bayes)


def _present(state: State, effect: str) -> float:
    """Value of a scanned effect's parameter at the state."""
    scan = next(s for s in state.scans if s.effect == effect)
    return float(state.theta[state.field.columns([scan.parameter])[0]])


class _Elected(NamedTuple):
    log_bayes: np.ndarray  # (j,)
    gained: np.ndarray  # (j,) log-likelihood
    step: np.ndarray  # (j, k)
    normal: np.ndarray  # (j, k, k)


def _elect(
    lagged: Lagged,
    base: np.ndarray,
    blocks: Sequence[np.ndarray],
    mean: np.ndarray,
    precision: np.ndarray,
    phi: np.ndarray,
    rounds: int,
) -> _Elected:
    """Fit the base alone and with each block (the last column of all is zero and fills up short blocks)."""
    dummy = lagged.gram.shape[-1] - 2
    width = max(len(own) for own in blocks)
    rows = np.array([np.concatenate([base, own, np.full(width - len(own), dummy)]) for own in blocks], int)
    step, normal, _, _, likelihood, penalty = lagged.fit_many(rows, mean, precision, rounds, phi)
    _, normal0, _, _, likelihood0, penalty0 = lagged.fit_many(base[None], mean, precision, rounds, phi)
    spread = _log_determinant(normal) - _log_determinant(normal0)
    prior = np.array([np.sum(np.log(precision[own])) for own in blocks])
    gained = (likelihood - penalty) - (likelihood0 - penalty0)
    return _Elected(gained + 0.5 * (prior - spread), likelihood - likelihood0, step, normal)


def _log_determinant(matrices: Float[np.ndarray, "j k k"]) -> Float[np.ndarray, " j"]:
    size = np.maximum(np.diagonal(matrices, axis1=1, axis2=2), 1e-300)
    scaled = matrices / np.sqrt(size[:, :, None] * size[:, None, :]) + 1e-12 * np.eye(matrices.shape[1])
    return np.linalg.slogdet(scaled)[1] + np.sum(np.log(size), axis=1)


@dataclass(frozen=True)
class Nulls:
    """What the best candidate reaches when nothing is there: `best` (replicates,) of the log Bayes factor."""

    best: Float[np.ndarray, " r"]
    phi: Float[np.ndarray, "c p"]

    def p_value(self, log_bayes: float) -> float:
        """Share of noise-only replicates in which some candidate does at least as well."""
        return float((1 + np.sum(self.best >= log_bayes)) / (1 + len(self.best)))


def noise_only(state: State, fit: Fit, seed: int, replicates: int = REPLICATES) -> Nulls:
    """Simulate the fitted noise on the present model and elect in every replicate.

    The autoregression is corrected for its small-sample bias first (Kilian 1998), which otherwise makes slow noise
    look faster than it is and false alarms frequent.
    """
    rng = np.random.default_rng(seed)
    columns = state.columns()
    products = state.products()
    blocks = [b[1] for b in state.blocks if b[0] not in state.active]
    mean = np.where(np.isin(np.arange(len(state.mean)), columns), 0.0, state.mean)  # the truth is the present model
    phi = stationary(fit.phi)
    drawn = products.replicates(simulated(state, phi, fit.sigma, CORRECTION, rng))
    again = np.mean([lagged.fit(columns, mean, state.precision).phi for lagged in drawn], axis=0)
    phi = stationary(2.0 * phi - again)
    best = []
    for lagged in products.replicates(simulated(state, phi, fit.sigma, replicates, rng)):
        null = lagged.fit(columns, mean, state.precision)
        order = np.argsort(-_scores(lagged, null, blocks, mean, state.precision))[:RECHECKED]
        leaders = [blocks[i] for i in order]
        best.append(_elect(lagged, columns, leaders, mean, state.precision, null.phi, 3).log_bayes.max())
    return Nulls(np.array(best), phi)


def simulated(
    state: State, phi: np.ndarray, sigma: np.ndarray, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "r m c"]:
    """`count` noise records, divided by the swell, each stretch begun anew after a run-in of 40 s."""
    m, outputs = state.residual.shape
    out = np.zeros((count, m, outputs))
    for stretch in (s for stretches in state.folds for s in stretches):
        length = stretch.stop - stretch.start
        white = rng.standard_normal((count, length + 200, outputs)) * sigma
        for c in range(outputs):
            noise = lfilter([1.0], np.concatenate([[1.0], -phi[c]]), white[:, :, c], axis=1)
            out[:, stretch, c] = noise[:, 200:]
    return out


def _scores(
    lagged: Lagged, null: Fit, blocks: Sequence[np.ndarray], mean: np.ndarray, precision: np.ndarray
) -> Float[np.ndarray, " j"]:
    """Log Bayes factor of every block under the null's noise, by projecting out the null's columns once."""
    psi = np.concatenate([np.ones((len(null.phi), 1)), -null.phi], axis=1)
    white = np.einsum("ca,cb,cabkl->ckl", psi, psi, lagged.gram.sum(axis=0), optimize=True)
    normal = np.einsum("c,ckl->kl", null.sigma**-2, white)
    own = normal[1:, 1:] + np.diag(precision)
    right = normal[1:, 0] + precision * mean
    base = null.columns
    across = own[base] .T @ inverse(own[np.ix_(base, base)])
    left = own - across @ own[base]
    rest = right - across @ right[base]
    found = []
    for block in blocks:
        M, b = left[np.ix_(block, block)], rest[block]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(M), 1e-300))
        M, b = M * np.outer(scale, scale) + 1e-9 * np.eye(len(block)), b * scale
        occam = np.sum(np.log(precision[block])) - np.linalg.slogdet(M)[1] + 2.0 * np.sum(np.log(scale))
        prior = np.sum(precision[block] * mean[block] ** 2)
        found.append(0.5 * (b @ np.linalg.solve(M, b) - prior + occam))
    return np.array(found)
