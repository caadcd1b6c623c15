"""Cramer-Rao bounds corrected for residuals that are coloured and whose size changes along the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.signal import lfilter
from scipy.stats import norm, t

from bayes_aero.inference.variance.autoregression import ORDER, autoregression

BLOCK = 0.2  # s; smoothed residuals vary no faster
MIN_INNOVATIONS = 10  # for each coefficient of an autoregression; with fewer, blocks count as independent
MIN_RESIDUAL_SHARE = 0.05  # least share 1 - h of an innovation that the fit leaves, with the leverage h of its block


@dataclass(frozen=True)
class _Stretch:
    """Block means of one stretch without gaps, and the number of samples of each block."""

    residual: Float[np.ndarray, "b c"]
    slope: Float[np.ndarray, "b c k"]
    samples: Float[np.ndarray, " b"]


def robust_covariance(
    D: Float[np.ndarray, "k k"],
    S: Float[np.ndarray, "n c k"],
    R: Float[np.ndarray, " c"],
    residual: Float[np.ndarray, "n c"],
    manoeuvre: Int[np.ndarray, " n"],
    start: Bool[np.ndarray, " n"],
    dt: float,
) -> tuple[Float[np.ndarray, "k k"], int]:
    """Covariance D M D of the estimate, with M that of the score sum S' R^-1 r, and the number of blocks.

    Residuals are averaged over blocks of `BLOCK` seconds and whitened by an autoregression for each coefficient (the
    sensitivities by its transpose, so that the score is unchanged). M is then formed twice: from the innovations'
    covariance, as in the corrected bound of Morelli and Klein, and from each block's own innovations, which also holds
    where the residual grows with the sensitivity, as it does where noise of the flow angle is in a regressor (HC3: each
    is divided by the share 1 - h that the fit leaves of it). The larger variance is taken. It is scaled by Student's t
    with the number of blocks less the number of parameters as degrees of freedom.

    Args:
        D: inverse information (sum S' R^-1 S)^-1.
        S: sensitivities of the modelled coefficients.
        R: variances of the residuals.
        residual: measured minus modelled.
        manoeuvre: of each sample.
        start: true where a stretch without gaps begins.
        dt: sampling interval, s.

    Source: Morelli and Klein, J. Aircraft 34 (1997) 211; prewhitening: Andrews and Monahan, Econometrica 60 (1992) 953;
    HC3 and the larger of both: MacKinnon and White, J. Econometrics 29 (1985) 305; Angrist and Pischke, *Mostly
    Harmless Econometrics*, 2009, ch. 8.
    """
    begins = np.flatnonzero(np.asarray(start) | np.append(True, np.diff(manoeuvre) != 0))
    stretches = [
        _blocks(S[one], residual[one], max(1, round(BLOCK / dt)))
        for one in (slice(a, b) for a, b in zip(begins, np.append(begins[1:], len(start)), strict=True))
    ]
    phi = _autoregressions(stretches, S.shape[1])
    whitened = [_whitened(one, phi, R) for one in stretches]
    blocks = sum(len(one.samples) for one in stretches)
    left = max(blocks - max(int(np.count_nonzero(np.any(S[:, c] != 0.0, axis=0))) for c in range(S.shape[1])), 1)
    together = np.concatenate([e for e, _ in whitened])
    spread = together.T @ together / left
    stationary, own = np.zeros_like(D), np.zeros_like(D)
    for (innovation, shaped), one in zip(whitened, stretches, strict=True):
        stationary += np.einsum("bck,cd,bdl->kl", shaped, spread, shaped, optimize=True)
        share = np.einsum("bck,kl,bcl->bc", one.slope, D, one.slope, optimize=True) * one.samples[:, None] / R
        scores = np.einsum("bck,bc->bk", shaped, innovation / np.maximum(1.0 - share, MIN_RESIDUAL_SHARE))
        own += scores.T @ scores
    stationary, own = (D @ middle @ D for middle in (stationary, own))
    sd = np.sqrt(np.maximum(np.diag(stationary), np.diag(own)))
    narrow = np.sqrt(np.maximum(np.diag(own), np.finfo(float).tiny))
    widen = sd / narrow * t.ppf(0.975, left) / norm.ppf(0.975)
    return own * np.outer(widen, widen), blocks


def _blocks(S: Float[np.ndarray, "n c k"], residual: Float[np.ndarray, "n c"], size: int) -> _Stretch:
    edges = np.arange(0, len(residual), size)
    samples = np.diff(np.append(edges, len(residual))).astype(float)
    residual, S = np.add.reduceat(residual, edges, axis=0), np.add.reduceat(S, edges, axis=0)
    return _Stretch(residual / samples[:, None], S / samples[:, None, None], samples)


def _autoregressions(stretches: Sequence[_Stretch], outputs: int) -> Float[np.ndarray, "c p"]:
    """An autoregression for each output; zeros where the stretches are too short."""
    long = [one.residual for one in stretches if len(one.residual) > 2 * ORDER]
    if sum(len(x) - ORDER for x in long) < MIN_INNOVATIONS * ORDER:
        return np.zeros((outputs, ORDER))
    return np.stack([autoregression([x[None, :, c] for x in long])[0][0] for c in range(outputs)])


def _whitened(
    one: _Stretch, phi: Float[np.ndarray, "c p"], R: Float[np.ndarray, " c"]
) -> tuple[Float[np.ndarray, "b c"], Float[np.ndarray, "b c k"]]:
    """Innovations e = A r, and A^-T of the weighed sensitivities: their product is the score."""
    weighed = one.slope * one.samples[:, None, None] / R[:, None]
    innovation, shaped = np.empty_like(one.residual), np.empty_like(weighed)
    for c, own in enumerate(phi):
        polynomial = np.append(1.0, -own)
        innovation[:, c] = lfilter(polynomial, [1.0], one.residual[:, c])
        shaped[:, c] = np.asarray(lfilter([1.0], polynomial, weighed[::-1, c], axis=0))[::-1]
    return innovation, shaped
