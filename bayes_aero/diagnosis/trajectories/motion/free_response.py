"""Free responses in a record: stretches with still controls, and the damped oscillation in them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

MOVED, PAUSE = math.radians(0.4), 0.5  # rad of travel within s from which a control moves; our choice
AWAY = math.radians(0.5)  # rad from its median that a still control may be; our choice
SHORTEST = 3.0  # s of a stretch
FOLLOWED = 0.8  # share of the movement beyond a straight line that the oscillation explains; our choice
CYCLES = 1.0  # within the stretch at least, for a period to be measured
SLOWEST, FINEST = 1.0, 8.0  # cycles in the stretch, samples a cycle: the periods that are tried
TRIED, DAMPED = 60, (-0.4, -0.15, -0.03, 0.05)  # periods, and real part over imaginary part


@dataclass(frozen=True)
class Swing:
    """A damped oscillation: its eigenvalue in 1/s with the covariance (2, 2) of real and imaginary part.

    `size` is the amplitude of the first channel at the beginning of the stretch, in the channel's unit; `lag` by how
    much each further channel reaches its peaks after the first one, s, within half a period.
    """

    eigenvalue: complex
    covariance: Float[np.ndarray, "2 2"]
    cycles: float
    size: float
    lag: Mapping[str, float]

    def follows(self, time: Float[np.ndarray, " n"], x: Float[np.ndarray, " n"]) -> float:
        """Amplitude with which another channel swings along over that of the first channel."""
        B = _basis(time - time[0], self.eigenvalue.real, self.eigenvalue.imag)
        return float(np.hypot(*np.linalg.lstsq(B, x, rcond=None)[0][:2])) / self.size


def still_stretches(
    time: Float[np.ndarray, " n"], controls: Mapping[str, Float[np.ndarray, " n"]], shortest: float = SHORTEST
) -> list[slice]:
    """Stretches of at least `shortest` s in which no control (rad) moves, the longest first."""
    still = np.ones(len(time), bool)
    later = max(1, round(PAUSE / float(np.median(np.diff(time)))))
    for u in controls.values():
        moves = np.abs(u[later:] - u[:-later]) > MOVED
        for shift in (0, later):
            still[shift : shift + len(moves)] &= ~moves
    for run in _runs(still):
        still[run] &= np.all([np.abs(u[run] - np.median(u[run])) <= AWAY for u in controls.values()], axis=0)
    long = [run for run in _runs(still) if time[run.stop - 1] - time[run.start] >= shortest]
    return sorted(long, key=lambda run: run.start - run.stop)


def _runs(marked: Bool[np.ndarray, " n"]) -> list[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(int)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def swing(time: Float[np.ndarray, " n"], channels: Mapping[str, Float[np.ndarray, " n"]]) -> Swing | None:
    """The damped oscillation that all channels share, each about its own straight line; None where there is none.

    Amplitudes and straight lines are at their best for every eigenvalue (variable projection). Its errors allow for
    the autocorrelation of neighbouring residuals.

    Args:
        time: in s.
        channels: those that swing, SI; the first one is that from which lags are counted.
    """
    t, y = time - time[0], np.stack([x / max(float(np.std(x)), 1e-12) for x in channels.values()], axis=1)
    line = np.stack([np.ones_like(t), t], axis=1)
    around = y - line @ np.linalg.lstsq(line, y, rcond=None)[0]
    span, step = float(t[-1]), float(np.median(np.diff(t)))
    slowest, fastest = (2.0 * math.pi * x for x in (SLOWEST / span, 1.0 / (FINEST * step)))
    if fastest <= slowest:
        return None

    def missed(at: np.ndarray) -> np.ndarray:
        B = _basis(t, *at)
        return (y - B @ np.linalg.lstsq(B, y, rcond=None)[0]).ravel()

    tried = [(share * w, w) for w in np.geomspace(slowest, fastest, TRIED) for share in DAMPED]
    first = min(tried, key=lambda at: float(np.sum(missed(np.array(at)) ** 2)))
    found = least_squares(missed, first, x_scale=np.abs(first))
    real, imaginary = float(found.x[0]), abs(float(found.x[1]))
    cycles = imaginary * span / (2.0 * math.pi)
    if np.sum(found.fun**2) >= (1.0 - FOLLOWED) * np.sum(around**2) or cycles < CYCLES or abs(real) > imaginary:
        return None
    amplitude = np.linalg.lstsq(_basis(t, real, imaginary), y, rcond=None)[0]
    phase = np.angle(amplitude[0] - 1j * amplitude[1])  # of cos(w t + phase)
    behind = (phase[0] - phase + math.pi) % (2.0 * math.pi) - math.pi
    lag = dict(zip(list(channels)[1:], map(float, behind[1:] / imaginary), strict=True))
    size = float(np.hypot(*amplitude[:2, 0]) * np.std(next(iter(channels.values()))))
    return Swing(complex(real, imaginary), _covariance(found.jac, found.fun.reshape(y.shape)), cycles, size, lag)


def _basis(t: Float[np.ndarray, " n"], real: float, imaginary: float) -> Float[np.ndarray, "n 4"]:
    envelope = np.exp(np.clip(real * t, -50.0, 50.0))
    return np.stack([envelope * np.cos(imaginary * t), envelope * np.sin(imaginary * t), np.ones_like(t), t], axis=1)


def _covariance(slope: np.ndarray, residual: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "2 2"]:
    """Of the eigenvalue, with the residuals' variance grown by their first-order autocorrelation."""
    n, c = residual.shape
    total = float(np.sum(residual**2))
    neighbours = float(np.sum(residual[1:] * residual[:-1])) / total if total > 0.0 else 0.0
    grown = (1.0 + max(neighbours, 0.0)) / max(1.0 - max(neighbours, 0.0), 1.0 / n)
    return np.linalg.pinv(slope.T @ slope) * total / max(n * c - 4 * c - 2, 1) * grown
