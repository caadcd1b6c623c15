"""An elevator that raises the nose when it goes down."""

from __future__ import annotations

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.finding import HealthFinding, declared, found
from bayes_aero.flight.record import FlightRecord

SMOOTH = 0.3  # s of the mean that keeps noise out of the pitch acceleration
MOVED = np.deg2rad(0.1)  # rad that elevator must move, standard deviation of its fast part
SURE = 5.0  # standard errors, of the wrong sign
RESPONSE = 0.3  # 1/s2 a rad: no elevator that flies an aircraft does less
SLOW = 3.0  # s: trim and speed change more slowly and are taken out


def elevator_response(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding if the pitch acceleration answers a positive deflection (trailing edge down) nose up."""
    if not all(record.has(n) for n in ("elevator", "alpha", "q")) or record.n * record.dt < 4.0 * SLOW:
        return []
    signals = [_banded(record[n], record.dt) for n in ("elevator", "alpha", "q")]
    if signals[0].std() < MOVED:
        return []
    slope = np.gradient(signals[2], record.dt)
    rows = np.stack([*signals, np.ones(record.n)], axis=1)
    # Samples of smoothed signals repeat each other: one in a smoothing length counts.
    fit, *_ = np.linalg.lstsq(rows, slope, rcond=None)
    left = slope - rows @ fit
    independent = max(record.n * record.dt / (3.0 * SMOOTH) - 4.0, 1.0)
    error = np.sqrt(np.mean(left**2) * np.linalg.pinv(rows.T @ rows)[0, 0] * record.n / independent)
    response = float(fit[0])
    if response < max(SURE * error, RESPONSE):
        return []
    sign = -declared(card, "elevator").sign
    sentence = (
        f"elevator: the nose rises with it ({response:+.2g} 1/s^2 a rad); trailing edge down counts as positive and "
        f"must lower it, so if the file counts trailing edge up write sign = {sign} at elevator on the card"
    )
    return [found(record, "elevator", "sign", sentence, at=(0, record.n - 1))]


def _banded(x: np.ndarray, dt: float) -> np.ndarray:
    """Smoothed, and without what is slower than a few seconds."""
    return _mean(x, SMOOTH / dt) - _mean(x, SLOW / dt)


def _mean(x: np.ndarray, samples: float) -> np.ndarray:
    half = min(max(1, round(samples / 2.0)), (len(x) - 1) // 2)
    return np.convolve(np.pad(x, half, mode="edge"), np.full(2 * half + 1, 1.0 / (2 * half + 1)), mode="valid")
