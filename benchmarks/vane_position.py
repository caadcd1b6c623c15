"""Do the flow-angle sensors stand ahead of the CG, or are they late? Kinematics alone, each manoeuvre held out in turn.

    python benchmarks/vane_position.py --model attas RECORD [RECORD ...]

The flight path's residuals (airspeed, alpha, theta, altitude less the integrals of rates and specific forces) wander
with the wind, so that plain least squares weighs a swing of ten seconds like one of one. Here residuals and
sensitivities are first filtered by the residuals' own autoregression: generalised least squares. Sensor errors that the
flight path names otherwise are free beside position and lag. chi2 is of the filtered residuals; half a difference of
chi2, once it is divided by chi2/n of the best, is a log likelihood ratio.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter
from studies import plain_parser, records_of

from bayes_aero.diagnosis.consistency import screen_sensor_errors
from bayes_aero.diagnosis.screening import Autocorrelation, autocorrelation_of
from bayes_aero.diagnosis.selection import removed
from bayes_aero.diagnosis.selection_state import SelectionState, refitted
from bayes_aero.inference.covariance import ORDER

RIVALS = ("vane_position", "alpha_delay")
TRIED = {"neither": (), "position": RIVALS[:1], "lag": RIVALS[1:], "both": RIVALS}
ROUNDS = 3  # between colour and estimate


def main() -> None:
    _, card, records = records_of(plain_parser(__doc__))
    state = without_rivals(screen_sensor_errors(records, card).state)
    colour = colour_with_both(state)
    folds = range(len(state.folds))
    for name, effects in TRIED.items():
        estimate, sd, chi2, n = generalised(state, state.residual, columns(state, effects), folds, colour)
        sizes = ", ".join(f"{e} {x:.4f} ± {s:.4f}" for e, x, s in zip(effects, estimate, sd, strict=True))
        print(f"{name}: chi2 {chi2:.0f} of {n}; {sizes}")
    for left in folds if len(folds) > 1 else ():
        others = [fold for fold in folds if fold != left]
        told = []
        for name, effects in TRIED.items():
            own = columns(state, effects)
            estimate = generalised(state, state.residual, own, others, colour)[0]
            moved = state.residual - state.S[:, :, own] @ estimate
            chi2 = generalised(state, moved, columns(state, ()), [left], colour)[2]
            told.append(f"{name} {chi2:.0f} ({', '.join(f'{x:.3f}' for x in estimate)})")
        print(f"fold {left} with the value of the others: {'; '.join(told)}")


def without_rivals(state: SelectionState) -> SelectionState:
    """The flight path's errors without position and lag."""
    for name in RIVALS:
        if name in state.active:
            state = refitted(removed(state, name))
    return state


def columns(state: SelectionState, effects: Sequence[str]) -> np.ndarray:
    return state.full.columns([p for e in effects for p in state.full.parameters_of(e)])


def colour_with_both(state: SelectionState) -> Autocorrelation:
    """The colour that is left with position and lag in."""
    own, folds = columns(state, RIVALS), range(len(state.folds))
    fit = state.fit()
    colour = autocorrelation_of(state.residual - state.S[:, :, fit.columns] @ fit.step, state.folds)
    for _ in range(ROUNDS):
        rows, right, scale = filtered(state, state.residual, own, folds, colour)
        step = np.linalg.lstsq(rows, right, rcond=1e-9)[0] / scale
        everything = np.append(state.columns(), own).astype(int)
        colour = autocorrelation_of(state.residual - state.S[:, :, everything] @ step, state.folds)
    return colour


def filtered(
    state: SelectionState, residual: np.ndarray, own: np.ndarray, folds: Sequence[int], colour: Autocorrelation
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sensitivities of the active columns and of `own`, each over its scale; residuals; the scales."""
    everything = np.append(state.columns(), own).astype(int)
    rows, right = [], []
    for fold in (state.folds[k] for k in folds):
        for c, (phi, sigma) in enumerate(zip(colour.phi, colour.sigma, strict=True)):
            shape = np.append(1.0, -phi)
            rows.append(lfilter(shape, [1.0], state.S[fold][:, c][:, everything], axis=0)[ORDER:] / sigma)
            right.append(lfilter(shape, [1.0], residual[fold, c])[ORDER:] / sigma)
    X = np.concatenate(rows)
    scale = np.sqrt(np.sum(X**2, axis=0))
    scale[scale == 0.0] = 1.0  # where a manoeuvre that is not used began
    return X / scale, np.concatenate(right), scale


def generalised(
    state: SelectionState, residual: np.ndarray, own: np.ndarray, folds: Sequence[int], colour: Autocorrelation
) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Estimates of the columns `own` with their deviations, chi2 of what is left, and the number of values."""
    X, y, scale = filtered(state, residual, own, folds, colour)
    U, s, V = np.linalg.svd(X, full_matrices=False)
    kept = s > 1e-9 * s[0]
    step = (V[kept].T / s[kept]) @ (U[:, kept].T @ y)
    covariance = (V[kept].T / s[kept] ** 2) @ V[kept]
    chi2 = float(np.sum((y - X @ step) ** 2))
    sd = np.sqrt(np.diag(covariance) * chi2 / len(y)) / scale
    at = slice(len(step) - len(own), None)
    return (step / scale)[at], sd[at], chi2, len(y)


if __name__ == "__main__":
    main()
