"""Where the criticism stands: parameters, which effects are in, and the problem linearised there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_aero.criticism.candidates import Field, prior_of
from bayes_aero.criticism.lagged import ORDER, Fit, Lagged, Products
from bayes_aero.criticism.responses import Responses
from bayes_aero.physics.coefficients import NAMES

PATH_OFFSET = "offset"  # a constant per manoeuvre and flight-path output: where the integral began
REFITS = 8
ENOUGH = 0.02  # nats
FOLDS = 6  # of a single manoeuvre
GUARD = 2.0  # s left out between neighbouring folds of one manoeuvre


@dataclass(frozen=True)
class Scan:
    """One value at which a candidate without a slope at neutral is tried."""

    effect: str
    parameter: str
    value: float


@dataclass(frozen=True)
class State:
    """Parameters `theta` (all of the field's), residuals and sensitivities there; `swell` is the noise's growth.

    Columns beyond the parameters: the flight-path offsets, active always; a column for every scanned value of a
    candidate that has no slope at neutral; and a last one of zeros, which fills up blocks of unequal width.
    """

    field: Field
    responses: Responses
    theta: Float[np.ndarray, " k"]
    residual: Float[np.ndarray, "m c"]
    S: Float[np.ndarray, "m c K"]
    swell: Float[np.ndarray, "m c"]
    folds: tuple[tuple[slice, ...], ...]
    lagged: Lagged
    mean: Float[np.ndarray, " K"]
    precision: Float[np.ndarray, " K"]
    active: tuple[str, ...]  # names of the effects that are in, beyond the card's
    scans: tuple[Scan, ...]

    @property
    def offsets(self) -> Int[np.ndarray, " o"]:
        """Columns of the flight-path offsets."""
        return np.arange(len(self.theta), self.S.shape[2] - len(self.scans) - 1)

    @property
    def blocks(self) -> list[tuple[str, Int[np.ndarray, " w"], float | None]]:
        """Every way in which a candidate may enter: its name, its columns, and the scanned value if there is one."""
        found: list[tuple[str, np.ndarray, float | None]] = []
        scanned = {scan.effect for scan in self.scans}
        begin = self.S.shape[2] - len(self.scans) - 1
        for number, scan in enumerate(self.scans):
            found.append((scan.effect, np.array([begin + number]), scan.value))
        for effect in self.field.candidates:
            if effect.name not in scanned:
                found.append((effect.name, self.field.columns(self.field.parameters_of(effect.name)), None))
        return found

    def columns(self, effects: Sequence[str] | None = None) -> Int[np.ndarray, " a"]:
        """Columns of the card's effects, of `effects` (default: those that are in), and the offsets."""
        names = (*self.field.base, *(self.active if effects is None else effects))
        own = [p for name in names for p in self.field.parameters_of(name) if p in self.field.model.names]
        return np.concatenate([self.field.columns(own), self.offsets])

    def products(self) -> Products:
        """What replicates of the noise need."""
        return Products(self.lagged, self.S / self.swell[:, :, None], self.folds)

    def fit(self, effects: Sequence[str] | None = None, folds: Sequence[int] | None = None) -> Fit:
        """Regression with `effects` on all folds or the chosen ones."""
        lagged = self.lagged if folds is None else self.lagged.over(folds)
        return lagged.fit(self.columns(effects), self.mean, self.precision)


def folds_of(manoeuvre: Int[np.ndarray, " m"], seconds: float) -> tuple[tuple[slice, ...], ...]:
    """Manoeuvres as folds, or contiguous parts of a single one with a gap of `GUARD` s between them."""
    if manoeuvre[-1] > 0:
        edges = [np.flatnonzero(manoeuvre == k) for k in range(manoeuvre[-1] + 1)]
        return tuple((slice(int(e[0]), int(e[-1]) + 1),) for e in edges)
    cuts = np.linspace(0, len(manoeuvre), FOLDS + 1).astype(int)
    gap = max(1, round(GUARD / seconds / 2))
    return tuple(
        (slice(a + (gap if a else 0), b - (gap if b < len(manoeuvre) else 0)),)
        for a, b in zip(cuts[:-1], cuts[1:], strict=True)
    )


def _offsets(responses: Responses) -> Float[np.ndarray, "m c o"]:
    manoeuvre, outputs = responses.manoeuvre, len(responses.outputs)
    count, path = int(manoeuvre[-1]) + 1, outputs - len(NAMES)
    S = np.zeros((len(manoeuvre), outputs, count * path))
    for k in range(count):
        for c in range(path):
            S[manoeuvre == k, len(NAMES) + c, k * path + c] = 1.0
    return S


def linearised(
    field: Field,
    responses: Responses,
    theta: Float[np.ndarray, " k"],
    active: tuple[str, ...],
    swell: Float[np.ndarray, "m c"] | None = None,
    scan: bool = True,
) -> State:
    """The state at `theta`: residuals, sensitivities to every parameter, and their inner products.

    `scan` tries the scanned values of candidates that are not active; a refit has no use for them.
    """
    residual, S = responses.linearise(theta)
    scans, extra = [], [_offsets(responses)]
    for effect in field.candidates if scan else ():
        if effect.name in active:
            continue
        for name, values in effect.scan.items():
            at = int(field.columns([name])[0])
            for value in values:
                there = theta.copy()
                there[at] = value
                other = np.asarray(responses.evaluate(there)[0])
                extra.append(((residual - other) / (value - theta[at]))[:, :, None])
                scans.append(Scan(effect.name, name, value))
    S = np.concatenate([S, *extra, np.zeros((*residual.shape, 1))], axis=2)
    S = np.where(np.isfinite(S), S, 0.0)
    swell = np.ones_like(residual) if swell is None else swell
    dt = float(np.median(np.asarray(responses.flights.channels["dt"])))
    folds = folds_of(responses.manoeuvre, dt * len(responses.flights.time) / len(residual))
    mean, precision = prior_of(field.model.free, theta)
    offsets = extra[0].shape[2]
    of_scans = [int(field.columns([s.parameter])[0]) for s in scans]
    mean = np.concatenate([mean, np.zeros(offsets), mean[of_scans], [0.0]])
    precision = np.concatenate([precision, np.full(offsets, 1e-12), precision[of_scans], [1.0]])
    lagged = Lagged.of(residual / swell, S / swell[:, :, None], folds)
    return State(
        field, responses, theta, residual, S, swell, folds, lagged, mean, precision, active, tuple(scans)
    )


def moved(
    state: State, theta: Float[np.ndarray, " k"], active: tuple[str, ...] | None = None, scan: bool = False
) -> State:
    """The state at other parameters, with the same noise growth."""
    chosen = state.active if active is None else active
    return linearised(state.field, state.responses, theta, chosen, state.swell, scan)


def refitted(state: State) -> tuple[State, Fit]:
    """Gauss-Newton on all active parameters under coloured noise, each step kept inside the bounds.

    A step that does not raise the penalised likelihood is halved; it ends when a step would gain less than `ENOUGH`.
    """
    bounds = np.array([p.bounds for p in state.field.model.free])
    at = state.columns()[: -len(state.offsets)] if len(state.offsets) else state.columns()
    theta, here = state.theta, _local(state, state.theta, at)
    for _ in range(REFITS):
        fit, value = here
        best = None
        for share in (1.0, 0.5, 0.2):
            trial = theta.copy()
            trial[at] = np.clip(theta[at] + share * fit.step[: len(at)], bounds[at, 0] + 1e-9, bounds[at, 1] - 1e-9)
            best = _local(state, trial, at)
            if best[1] > value:
                break
        if best is None or not best[1] > value:
            break
        theta, gained, here = trial, best[1] - value, best
        if gained < ENOUGH:
            break
    state = moved(state, theta, scan=True)
    return state, state.fit()


def _local(state: State, theta: np.ndarray, at: np.ndarray) -> tuple[Fit, float]:
    """Regression on the active columns at `theta`, and the penalised log-likelihood there with the noise it finds."""
    residual, S = state.responses.linearise(theta, at)
    S = np.concatenate([np.where(np.isfinite(S), S, 0.0), state.S[:, :, state.offsets]], axis=2)
    if not np.all(np.isfinite(residual)):
        raise FloatingPointError("the residuals are not finite at a trial point")
    lagged = Lagged.of(residual / state.swell, S / state.swell[:, :, None], state.folds)
    mean, precision = prior_of([state.field.model.free[i] for i in at], theta[at])
    free = np.arange(S.shape[2])
    offsets = len(free) - len(at)
    mean, precision = np.append(mean, np.zeros(offsets)), np.append(precision, np.full(offsets, 1e-12))
    fit = lagged.fit(free, mean, precision)
    only = lagged.fit(free[len(at) :], mean, precision)  # parameters as they are, only offsets and noise adapt
    return fit, only.log_likelihood - 0.5 * float(np.sum(precision[: len(at)] * mean[: len(at)] ** 2))


def swelling(state: State, fit: Fit) -> Float[np.ndarray, "m c"]:
    """Growth of each coefficient's noise with separation, 1 + b (1 - X), b >= 0, from the innovations' size.

    Least squares of |innovation| on 1 - X; flight-path outputs do not swell.
    """
    _, known = state.responses.evaluate(state.theta)
    apart = 1.0 - np.asarray(state.responses.block(known["X"]))
    residual = state.residual - state.S[:, :, fit.columns] @ fit.step
    swell = np.ones_like(residual)
    for c in range(len(NAMES)):
        size, x = [], []
        for (stretch,) in state.folds:
            r = residual[stretch, c]
            lags = np.stack([r[ORDER - i : len(r) - i] for i in range(ORDER + 1)])
            size.append(np.abs(lags[0] - fit.phi[c] @ lags[1:]))
            x.append(apart[stretch][ORDER:])
        level = np.polyfit(np.concatenate(x), np.minimum(np.concatenate(size), 10 * np.median(np.concatenate(size))), 1)
        if np.ptp(apart) > 0.05 and level[1] > 0.0:
            swell[:, c] = 1.0 + max(0.0, level[0] / level[1]) * apart
    return swell
