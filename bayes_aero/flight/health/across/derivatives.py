"""Recorded rates of change against the change of what they belong to: q-dot and the derivative of q."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.across.explained import off_by_factor
from bayes_aero.flight.health.finding import HealthFinding, declared, found
from bayes_aero.flight.health.signals import noise_of
from bayes_aero.flight.record import FlightRecord

PAIRS = {"p_dot": "p", "q_dot": "q", "r_dot": "r", "alpha_dot": "alpha", "beta_dot": "beta"}
SECONDS = 0.3  # of the mean that both are smoothed by
EXCITED = 5.0  # standard deviations of the noise, smoothed and differentiated, that the derivative must have
ALIKE = 0.8  # correlation from which the two are one motion
OFF = 1.5  # as a logarithm: a factor of 4.5, where degrees for radians are one of 57


def derivatives(record: FlightRecord, card: Card) -> list[HealthFinding]:
    """A finding for each recorded derivative in another unit, or of the other sign, than the derivative itself."""
    said = []
    for name, of in PAIRS.items():
        if record.has(name) and record.has(of) and np.isfinite(record[name]).all() and np.isfinite(record[of]).all():
            said += _against(record, card, name, of)
    return said


def _against(record: FlightRecord, card: Card, name: str, of: str) -> list[HealthFinding]:
    width = max(3, round(SECONDS / record.dt))
    x, slope = _smooth(record[name], width), _smooth(np.gradient(record[of], record.dt), width)
    if len(x) < 3 * width or not np.std(x) > 0.0:
        return []
    # The derivative of noise, over a mean of two times `width` samples.
    noise = noise_of(record[of]) / (record.dt * width**1.5)
    if np.std(slope) < EXCITED * noise or not np.std(slope) > 0.0:
        return []
    alike = float(np.corrcoef(x, slope)[0, 1])
    if abs(alike) < ALIKE:
        return []
    k, meant = float(np.std(x) / np.std(slope)), f"the derivative of {of}"
    flown = card.linear is not None and name in {*card.linear.states, *card.linear.outputs}
    if alike < 0.0:
        sign = -declared(card, name).sign
        sentence = (
            f"{name} counts the other way than {meant} does throughout (correlation {alike:.2g}); write sign = {sign} "
            f"at {name} on the card"
        )
        return [found(record, name, "sign", sentence, at=(0, record.n - 1), grave=flown)]
    return off_by_factor(record, card, k, {name: 1}, meant, off=OFF, near=0.7, grave=flown, explained=True)


def _smooth(x: np.ndarray, width: int) -> np.ndarray:
    """Twice the mean over `width` samples, without the ends."""
    return uniform_filter1d(uniform_filter1d(x, width), width)[width:-width]
