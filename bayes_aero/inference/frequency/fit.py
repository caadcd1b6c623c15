"""Gauss-Newton on residuals in a band, with Cramer-Rao bounds from the residuals of its lines.

The cost is that of `inference.likelihood.mle`, det R with a diagonal R. The estimates are real, so the real and the
imaginary part of a line count as two residuals. Published bounds count the line as one and are larger by sqrt(2).

Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_aero.flight.health.signals import noise_of
from bayes_aero.inference.frequency.result import FrequencyFit
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.inference.likelihood.noise_bias import PAIRS
from bayes_aero.inference.variance.robust_bounds import BLOCK, robust_covariance
from bayes_aero.parameter import Parameter
from bayes_aero.residuals.frequency_error import InBand

EQUATION_ERROR, OUTPUT_ERROR = "equation error", "output error"
EXACT = 1e-100  # least variance of an output that its model reproduces: information is still a number
MAX_ITERATIONS = 50
REWEIGHTED = 5  # solutions with renewed variances at one point
TOLERANCE = 1e-4  # gain in log likelihood of one more step: 0.014 standard errors
UNSEEN = 1e-6  # information over that of the prior below which the band does not show a parameter
MIN_SHARE = 0.01  # of the variance in the band: least variance of a difference from the time domain
SINGULAR = 1e-11  # smallest eigenvalue of the information scaled to unit diagonal


class Step(NamedTuple):
    """A linear solution: the step of the parameters (k,) and of the offsets, what is left (m, c), its mean squares."""

    step: np.ndarray
    left: np.ndarray
    R: np.ndarray


def fit_in_band(
    responses: InBand,
    parameters: Sequence[Parameter],
    start: Float[np.ndarray, " k"],
    band: tuple[float, float],
    method: str = EQUATION_ERROR,
) -> FrequencyFit:
    """Estimate the free parameters from residuals in a band.

    Parameters that the band does not show, such as constants, keep their start.

    Args:
        responses: a residual model of `residuals.frequency_error`.
        parameters: the free parameters.
        start: their first values, (k,), SI; those of a fit in the time domain.
        band: lowest and highest frequency, Hz.
        method: its name.
    """
    theta, outputs = np.asarray(start, float).copy(), responses.outputs
    lower, upper = (np.array([p.bounds[i] for p in parameters]) for i in (0, 1))
    residual, S = responses.linearise(theta)
    free = _shown(S, residual, parameters)
    offsets, converged, at_bound = responses.offsets(theta, outputs), False, []
    found = solve(residual, np.concatenate([S[:, :, free], offsets], axis=2))
    for _ in range(MAX_ITERATIONS):
        step = found.step[: len(free)]
        outward = ((theta[free] <= lower[free]) & (step < 0.0)) | ((theta[free] >= upper[free]) & (step > 0.0))
        if outward.any():  # held there from now on
            at_bound += list(free[outward])
            free = free[~outward]
            found = solve(residual, np.concatenate([responses.linearise(theta, free)[1], offsets], axis=2))
            continue
        before = _cost(solve(residual, offsets).R, len(residual))
        if before - _cost(found.R, len(residual)) < TOLERANCE:
            converged = True
            break
        responses = responses.moved(found.step[len(free) :])
        for share in (1.0, 0.5, 0.25, 0.125, 0.03):
            trial = theta.copy()
            trial[free] = np.clip(theta[free] + share * step, lower[free], upper[free])
            changed, S_free = responses.linearise(trial, free)
            own = responses.offsets(trial, outputs)
            if _cost(solve(changed, own).R, len(changed)) < before:
                break
        else:
            converged = True  # rounding: no step lowers the cost
            break
        theta, residual, offsets = trial, changed, own
        found = solve(residual, np.concatenate([S_free, offsets], axis=2))
    fitted = _result(responses, parameters, theta, free, found, converged)
    held = tuple(parameters[i].name for i in at_bound)
    unseen = tuple(name for name in fitted.unseen if name not in held)
    return replace(fitted, band=(float(band[0]), float(band[1])), method=method, unseen=unseen, at_bound=held)


def _shown(S: np.ndarray, residual: np.ndarray, parameters: Sequence[Parameter]) -> np.ndarray:
    """Indices of the parameters that the band shows."""
    R = np.maximum(np.mean(np.square(residual), axis=0), EXACT)
    information = np.einsum("mck,mck,c->k", S, S, 1.0 / R)
    prior = np.array([p.prior.normal[1] for p in parameters])
    return np.flatnonzero(information * np.square(prior) > UNSEEN)


def _cost(R: np.ndarray, m: int) -> float:
    return 0.5 * m * float(np.sum(np.log(R)))


def solve(residual: Float[np.ndarray, "m c"], S: Float[np.ndarray, "m c k"]) -> Step:
    """Least squares for all columns, with the variances of the outputs that it leaves."""
    _, _, k = S.shape
    left, step = residual, np.zeros(k)
    for _ in range(REWEIGHTED):
        R = np.maximum(np.mean(np.square(left), axis=0), EXACT)
        weighted = (S / np.sqrt(R)[:, None]).reshape(residual.size, k)
        scale = np.sqrt(np.maximum(np.sum(np.square(weighted), axis=0), np.finfo(float).tiny))
        step = np.linalg.lstsq(weighted / scale, (residual / np.sqrt(R)).ravel(), rcond=1e-12)[0] / scale
        left = residual - S @ step
    R = np.maximum(np.mean(np.square(left), axis=0), EXACT)
    return Step(step, left, R)


def cramer_rao(
    S: Float[np.ndarray, "m c k"], R: Float[np.ndarray, " c"]
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, "k k"]]:
    """Variances over degrees of freedom, from mean squares R, and the inverse information; NaN where it is singular."""
    m = len(S)
    used = np.array([np.count_nonzero(np.any(S[:, c] != 0.0, axis=0)) for c in range(S.shape[1])])
    R = R * m / np.maximum(m - used, 1)
    A = np.einsum("mck,mcl,c->kl", S, S, 1.0 / R)
    scale = np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    scaled = A / np.outer(scale, scale)
    if not (len(A) and np.all(m > used) and np.linalg.eigvalsh(scaled)[0] > SINGULAR):
        return R, np.full_like(A, np.nan)
    return R, np.linalg.inv(scaled) / np.outer(scale, scale)


def _result(
    responses: InBand,
    parameters: Sequence[Parameter],
    theta: np.ndarray,
    free: np.ndarray,
    found: Step,
    converged: bool,
) -> FrequencyFit:
    """Bounds at the optimum, with variances over degrees of freedom."""
    S = np.concatenate([responses.linearise(theta, free)[1], responses.offsets(theta, responses.outputs)], axis=2)
    m, k = len(S), len(free)
    R, D = cramer_rao(S, found.R)
    corrected = D
    if regular := bool(np.all(np.isfinite(D))):
        # Each part of a line stands alone: the transform has whitened them, and only their sizes differ.
        corrected, _ = robust_covariance(D, S, R, found.left, responses.manoeuvre, np.ones(m, bool), BLOCK)
    names = [p.name for p in parameters]
    return FrequencyFit(
        method=EQUATION_ERROR,
        band=(0.0, 0.0),
        lines=m // 2,
        names=tuple(names[i] for i in free),
        units=tuple(parameters[i].unit for i in free),
        estimate=theta[free],
        covariance=D[:k, :k],
        corrected=corrected[:k, :k],
        inner={name: S[:, c, :k].T @ S[:, c, :k] for c, name in enumerate(responses.outputs)},
        R=dict(zip(responses.outputs, map(float, R), strict=True)),
        unseen=tuple(name for i, name in enumerate(names) if i not in free),
        converged=converged and regular,
    )


def without_noise_bias_in_band(
    fit: FrequencyFit, responses: InBand, parameters: Sequence[Parameter], *, seed: int = 0
) -> FrequencyFit:
    """The estimate without the bias by noise of the recorded regressors, as `likelihood.noise_bias` has it.

    Args:
        fit: equation error of `responses`.
        responses: its residual model.
        parameters: the free parameters of the model.
        seed: of the added noise.

    Source: simulation extrapolation (SIMEX), Cook and Stefanski, J. Am. Stat. Assoc. 89 (1994) 1314.
    """
    if not fit.converged:
        return fit
    flights, rng, moves = responses.flights, np.random.default_rng(seed), []
    values = dict(zip(fit.names, fit.estimate, strict=True))
    start = np.array([values.get(p.name, p.start) for p in parameters])
    for _ in range(PAIRS):
        noise = {}
        for name in flights.recorded:
            parts = np.split(np.asarray(flights.channels[name], float), np.cumsum(flights.lengths)[:-1])
            noise[name] = np.concatenate([noise_of(x) * rng.standard_normal(len(x)) for x in parts])
        for sign in (1.0, -1.0):
            noisier = {n: x + sign * noise[n] if n in noise else x for n, x in flights.channels.items()}
            moved = responses.with_channels(noisier)
            assert isinstance(moved, InBand)
            found = fit_in_band(moved, parameters, start, fit.band, fit.method)
            if not found.converged or found.names != fit.names:
                return fit
            moves.append(found.estimate - fit.estimate)
    bias = np.mean(moves, axis=0)
    return replace(fit, estimate=fit.estimate - bias, bias=bias, corrected=fit.corrected + np.outer(bias, bias))


def beside_time_domain(fit: FrequencyFit, mle: MleResult) -> FrequencyFit:
    """The fit with its differences from that of the same coefficients in the time domain, in standard errors.

    Both estimates share the noise of the band. The one in the time domain is M times the one in the band and a part
    from the other frequencies, which is independent of it; M is the share of the band in the information. So the
    covariance of the difference is V_t + V_f - M V_f - V_f M', with the corrected covariances of both.
    """
    place = [mle.names.index(name) for name in fit.names]
    V_t, V_f, D = mle.corrected[np.ix_(place, place)], fit.corrected, mle.covariance[np.ix_(place, place)]
    M = D @ sum(inner / mle.R[c] for c, inner in enumerate(fit.inner.values()))
    # M is that of white noise. The difference of the variances, which is exact where one of the estimates is efficient,
    # is the least that is believed.
    least = np.maximum(np.abs(np.diag(V_f - V_t)), MIN_SHARE * np.diag(V_f))
    sd = np.sqrt(np.maximum(np.diag(V_t + V_f - M @ V_f - V_f @ M.T), least))
    apart = np.abs(fit.estimate - mle.estimate[place]) / sd
    return replace(fit, apart=dict(zip(fit.names, map(float, apart), strict=True)))
