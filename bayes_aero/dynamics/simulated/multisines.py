"""Orthogonal multisines on several controls at once, with a small peak for their power.

Source: Morelli, "Multiple input design for real-time parameter estimation in the frequency domain", IFAC SYSID 2003;
first phases: Schroeder, IEEE Trans. Inf. Theory 16 (1970) 85; their improvement: Van der Ouderaa, Schoukens and
Renneboog, IEEE Trans. Instrum. Meas. 37 (1988) 145.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from bayes_aero.errors import InputError

CLIP, ROUNDS = 0.9, 300  # of the peak that a round leaves, and rounds of clipping
GRID = 16  # points for each period of the highest frequency on which the peak is sought


def multisines(
    time: Float[np.ndarray, " n"], period: float, band: tuple[float, float], controls: int
) -> Float[np.ndarray, "c n"]:
    """Multisines with a peak of 1, zero where `time` is, that share no frequency; periodic in `period`.

    The multiples of 1/`period` in `band` are dealt to the controls in turn, so that each covers the band. Over a whole
    period the inputs are uncorrelated, and so are their derivatives and integrals.

    Args:
        time: s; every signal is zero at time 0.
        period: s.
        band: lowest and highest frequency, Hz.
        controls: number of signals.

    Raises:
        InputError: the band has fewer than two frequencies for each control.
    """
    k = np.arange(np.ceil(band[0] * period - 1e-9), np.floor(band[1] * period + 1e-9) + 1)
    if len(k) < 2 * controls or k[0] < 1:
        raise InputError(
            f"the band {band[0]:g} to {band[1]:g} Hz has {len(k)} multiples of 1/{period:g} s, and {controls} "
            f"multisines need {2 * controls} above zero; widen the band or lengthen the period"
        )
    signals = []
    for own in (k[number::controls] for number in range(controls)):
        phase, at = _phases(own), 2.0 * np.pi * time[:, None] / period
        fine = np.linspace(0.0, 2.0 * np.pi, GRID * int(own[-1]) * 4)
        whole = np.sum(np.cos(fine[:, None] * own + phase), axis=1)
        crossing = int(np.argmax(np.diff(np.sign(whole)) != 0.0))
        zero: Any = brentq(_value, *fine[crossing : crossing + 2], args=(own, phase))
        signals.append(np.sum(np.cos((at + zero) * own + phase), axis=1) / np.max(np.abs(whole)))
    return np.stack(signals)


def _value(angle: float, k: Float[np.ndarray, " m"], phase: Float[np.ndarray, " m"]) -> float:
    return float(np.sum(np.cos(angle * k + phase)))


def peak_factor(signal: Float[np.ndarray, " n"]) -> float:
    """Relative peak factor: half the range over that of a sine of the same root mean square; 1 for a sine."""
    return float(np.ptp(signal) / (2.0 * np.sqrt(2.0) * np.sqrt(np.mean(np.square(signal)))))


def _phases(k: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Phases with a small peak: Schroeder's, then the phases of the clipped signal, again and again."""
    order = np.arange(len(k))
    phase = -np.pi * order * (order + 1) / len(k)
    angle = np.linspace(0.0, 2.0 * np.pi, GRID * int(k[-1]), endpoint=False)
    basis = np.exp(1j * np.outer(k, angle))
    best, least = phase, np.inf
    for _ in range(ROUNDS):
        signal = np.real(np.exp(1j * phase) @ basis)
        peak = np.max(np.abs(signal))
        if peak < least:
            best, least = phase, peak
        phase = np.angle(basis.conj() @ np.clip(signal, -CLIP * peak, CLIP * peak))
    return best
