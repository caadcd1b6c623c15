"""Bias of the estimates by noise of the recorded signals, and estimates without it.

The model's inputs are recorded with noise. Least squares on noisy regressors is not consistent, and its residuals do
not show it: near the stall the noise of the vane biases tau2 and Cmq towards zero by half a standard error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.signals import noise_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import descend
from bayes_aero.inference.likelihood.mle_result import MleResult, MleStatus
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, observe

PAIRS = 5  # of records with the same noise added and subtracted, so that the linear part cancels


def without_noise_bias(
    mle: MleResult, records: Sequence[FlightRecord], card: Card, model: Model, *, seed: int = 0
) -> MleResult:
    """The estimate without the bias by recording noise; the corrected covariance includes the squared bias.

    White noise with the standard deviation of each channel's noise is added to the records, and the coefficients are
    formed and fitted again. The bias is proportional to the variance of the noise, so the estimate changes by about the
    bias that the recorded noise has caused. This holds to first order; the covariance therefore includes the squared
    bias. A fit that has not converged, with or without the added noise, is returned unchanged.

    Args:
        mle: the fit to the coefficients of `records`, formed as `matched`.
        records: the fitted records.
        card: of the records.
        model: the fitted model.
        seed: of the added noise.

    Source: simulation extrapolation (SIMEX), Cook and Stefanski, J. Am. Stat. Assoc. 89 (1994) 1314.
    """
    if mle.status is not MleStatus.CONVERGED:
        return mle
    moves, rng = [], np.random.default_rng(seed)
    for _ in range(PAIRS):
        noise = [_noise(record, rng) for record in records]
        for sign in (1.0, -1.0):
            noisier = [_added(record, one, sign) for record, one in zip(records, noise, strict=True)]
            found = descend(model, observe(noisier, card, model, Forming.MATCHED), mle.estimate)
            if not found.converged or found.active.any():
                return mle
            moves.append(found.theta - mle.estimate)
    bias = np.mean(moves, axis=0)
    bounds = np.array([p.bounds for p in model.free]).T
    estimate = np.clip(mle.estimate - bias, *bounds)
    return replace(mle, estimate=estimate, bias=bias, corrected=mle.corrected + np.outer(bias, bias))


def _noise(record: FlightRecord, rng: np.random.Generator) -> dict[str, Float[np.ndarray, " n"]]:
    """White noise with the standard deviation of each channel's noise."""
    sizes = {name: noise_of(x) for name, x in record.channels.items()}
    return {name: sd * rng.standard_normal(record.n) for name, sd in sizes.items() if sd > 0.0}


def _added(record: FlightRecord, noise: dict[str, Float[np.ndarray, " n"]], sign: float) -> FlightRecord:
    channels = {name: x + sign * noise[name] if name in noise else x for name, x in record.channels.items()}
    return replace(record, channels=channels)
