"""Where the model is wrong: residuals of each coefficient by what was recorded, their colour, size and composition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.diagnosis.selection.noise import NoiseReport

BINS = 12
LEAST = 1e-3  # of the residual's size, that a deviation counts as at least: a simulation at rest has none


@dataclass(frozen=True)
class TheilParts:
    """Theil's inequality coefficient and the shares of bias, variance and covariance in the mean square error.

    Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 11; the shares add up to one.
    """

    theil: float
    bias: float
    variance: float
    covariance: float


def theil_parts(measured: Float[np.ndarray, " n"], modelled: Float[np.ndarray, " n"]) -> TheilParts:
    """U = rms(z - y)/(rms z + rms y); shares (mean z - mean y)^2, (sd z - sd y)^2, 2(1 - r) sd z sd y of the MSE."""
    z, y = np.asarray(measured), np.asarray(modelled)
    mse = float(np.mean((z - y) ** 2))
    if mse == 0.0:
        return TheilParts(0.0, 0.0, 0.0, 0.0)
    sz, sy = z.std(), y.std()
    covariance = float(np.mean((z - z.mean()) * (y - y.mean())))
    theil = np.sqrt(mse) / (np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(y**2)))
    parts = ((z.mean() - y.mean()) ** 2, (sz - sy) ** 2, 2.0 * (sz * sy - covariance))
    return TheilParts(float(theil), *(float(part / mse) for part in parts))


@dataclass(frozen=True)
class Profile:
    """Mean residual of a coefficient in bins of equal count of a channel, and the deviation of each mean."""

    channel: str
    centre: Float[np.ndarray, " b"]
    mean: Float[np.ndarray, " b"]
    deviation: Float[np.ndarray, " b"]


def details(state: SelectionState) -> Mapping[str, np.ndarray]:
    """Signals, X, measured, modelled and residual coefficients at the recorded rate."""
    return {key: np.asarray(value) for key, value in state.responses.evaluate(state.theta)[1].items()}


def profiles(
    residual: Float[np.ndarray, " n"], channels: Mapping[str, np.ndarray], variance_inflation: float
) -> list[Profile]:
    """How the residual depends on each channel, the clearest first."""
    found, bins = [], max(1, min(BINS, len(residual) // 2))  # of two blocks at least, that they have a deviation
    for name, x in channels.items():
        if np.ptp(x) <= 1e-9 * max(1.0, float(np.abs(x).max())):
            continue
        parts = np.array_split(np.argsort(x, kind="stable"), bins)
        mean = np.array([residual[p].mean() for p in parts])
        sd = np.array([residual[p].std() * np.sqrt(variance_inflation / len(p)) for p in parts])
        found.append(Profile(name, np.array([x[p].mean() for p in parts]), mean, sd))
    least = max(LEAST * float(np.sqrt(np.mean(residual**2))), 1e-300)
    return sorted(found, key=lambda p: -float(np.sum((p.mean / np.maximum(p.deviation, least)) ** 2)))


def noise_report(extension: Extension, outliers: Mapping[str, int]) -> NoiseReport:
    """Colour, size, growth and outliers of what the extended model leaves."""
    state = extension.state
    names = state.responses.model.coefficients
    full = details(state)["residual"][:, : len(names)]
    blocks, manoeuvre = np.asarray(state.responses.block(full)), state.responses.manoeuvre
    lag1 = {}
    for c, name in enumerate(names):
        pieces = [r - r.mean() for r in (blocks[manoeuvre == k, c] for k in range(int(manoeuvre[-1]) + 1))]
        lag1[name] = float(sum(np.sum(r[1:] * r[:-1]) for r in pieces) / sum(np.sum(r**2) for r in pieces))
    deviation = {name: float(full[:, c].std()) for c, name in enumerate(names)}
    noise_growth = {name: float(state.noise_growth[:, c].max()) for c, name in enumerate(names)}
    return NoiseReport(lag1, deviation, noise_growth, dict(outliers))
