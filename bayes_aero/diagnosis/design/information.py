"""What a record says of parameters: the information matrix, and what coloured noise makes of it.

The outputs' noise is that which the present model leaves. What belongs to one record alone (offsets of the flight
path, functions without a name) is projected out, so that the matrices of several records add up. Source: Klein and
Morelli, *Aircraft System Identification*, 2006, ch. 9 (design of inputs from the information matrix); for coloured
noise ch. 6, as in `inference.variance`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.autocorrelation import Autocorrelation, autocorrelation_of
from bayes_aero.diagnosis.screening.regression import inverse
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.effect import Effect

Pair = tuple[str, str]
Signals = Mapping[str, Mapping[str, float]]
"""For each effect of a set: the size of each of its columns, by label."""


@dataclass(frozen=True)
class Noise:
    """Residuals of the present model: variance and colour by output, growth of each with 1 - X."""

    outputs: tuple[str, ...]
    variance: Float[np.ndarray, " c"]
    colour: Autocorrelation
    growth: Float[np.ndarray, " c"]

    def of(self, outputs: Sequence[str]) -> Noise:
        """Of those outputs alone that are among `outputs`."""
        at = [c for c, name in enumerate(self.outputs) if name in outputs]
        colour = Autocorrelation(self.colour.phi[at], self.colour.sigma[at])
        return Noise(tuple(self.outputs[c] for c in at), self.variance[at], colour, self.growth[at])


def noise_of(state: SelectionState) -> Noise:
    """Residuals of the coefficients and, where it was recorded, of the flight path at the present parameters."""
    residual, known = state.responses.evaluate(jnp.asarray(state.theta))
    residual, manoeuvre = np.array(residual), state.responses.manoeuvre
    apart = 1.0 - np.asarray(state.responses.block(known["X"]))
    growth = np.zeros(residual.shape[1])
    for c, name in enumerate(state.responses.outputs):
        if name in state.outputs and np.any(apart > 0.0):
            own = state.noise_growth[:, state.outputs.index(name)]
            growth[c] = max(0.0, float((own - 1.0) @ apart / (apart @ apart)))
        if name not in state.full.model.coefficients:
            for k in range(int(manoeuvre[-1]) + 1):
                residual[manoeuvre == k, c] -= residual[manoeuvre == k, c].mean()
    residual /= 1.0 + growth * apart[:, None]
    colour = autocorrelation_of(residual, whole_manoeuvres(manoeuvre))
    return Noise(state.responses.outputs, np.mean(residual**2, axis=0), colour, growth)


def whole_manoeuvres(manoeuvre: Int[np.ndarray, " m"]) -> list[slice]:
    """The blocks of each manoeuvre."""
    parts = [np.flatnonzero(manoeuvre == k) for k in np.unique(manoeuvre)]
    return [slice(int(e[0]), int(e[-1]) + 1) for e in parts]


@dataclass(frozen=True)
class Information:
    """Of one record or several: the information matrix of white noise of the same variance, and the variance of its
    score under the noise's colour; (k, k), by the labels of their columns. `prior` (k,) is the priors' precision."""

    labels: tuple[str, ...]
    matrix: Float[np.ndarray, "k k"]
    score_variance: Float[np.ndarray, "k k"]
    prior: Float[np.ndarray, " k"]

    def __add__(self, other: Information) -> Information:
        """Of both records; a column that one of them lacks carries no information there."""
        labels = tuple(dict.fromkeys((*self.labels, *other.labels)))
        k = len(labels)
        matrix, score, prior = np.zeros((k, k)), np.zeros((k, k)), np.zeros(k)
        for one in (other, self):
            at = [labels.index(label) for label in one.labels]
            matrix[np.ix_(at, at)] += one.matrix
            score[np.ix_(at, at)] += one.score_variance
            prior[at] = one.prior
        return Information(labels, matrix, score, prior)

    def without(self, labels: Sequence[str]) -> Information:
        """With these columns held at their values."""
        at = [k for k, label in enumerate(self.labels) if label not in labels]
        rows = np.ix_(at, at)
        kept = tuple(self.labels[k] for k in at)
        return Information(kept, self.matrix[rows], self.score_variance[rows], self.prior[at])

    def after(self, columns: Sequence[int], signal: Float[np.ndarray, " k"]) -> tuple[float, float]:
        """What `columns`, held by their priors, cannot imitate of a signal: its information, and the score's variance
        along it."""
        at = np.asarray(columns, int)
        normal = self.matrix[np.ix_(at, at)] + np.diag(self.prior[at])
        left = signal.copy()
        left[at] -= inverse(normal) @ (self.matrix[at] @ signal)
        return float(signal @ self.matrix @ left), float(left @ self.score_variance @ left)

    def deviations(self, signals: Signals) -> dict[Pair, float]:
        """For each ordered pair of effects: by how many standard deviations the first, at its size, differs from its
        best imitation by the other and by all that no signal names."""
        place = {label: k for k, label in enumerate(self.labels)}
        members = {place[label] for own in signals.values() for label in own}
        base = [k for k in range(len(self.labels)) if k not in members]
        found = {}
        for one, other in permutations(signals, 2):
            columns = base + [place[label] for label in signals[other]]
            ratios = []
            for label, size in signals[one].items():
                signal = np.zeros(len(self.labels))
                signal[place[label]] = size
                information, spread = self.after(columns, signal)
                ratios.append(information / np.sqrt(spread) if spread > 0.0 else 0.0)
            found[one, other] = min(ratios)
        return found


def information_of(
    state: SelectionState, noise: Noise, chosen: Sequence[Effect], blocks: int | None = None
) -> Information:
    """Of the record on which `state` is linearised: on the parameters in it, and on the `chosen` effects.

    `blocks`: of the first ones alone.
    """
    own = {label: column for e in chosen for label, column in columns_of(state, e).items()}
    base = list(map(int, state.columns([n for n in state.active if n not in {e.name for e in chosen}])))
    parameters = {state.full.model.names[k]: k for k in base if k < len(state.theta)}
    labels = tuple(dict.fromkeys((*sorted(parameters), *own)))
    columns = [(parameters | own)[label] for label in labels]
    alone = [k for k in base if k >= len(state.theta)]
    whole, weight = state.scaled[:blocks], 1.0 / noise.variance
    S = own_columns = whole[:, :, columns]
    if alone:
        N = whole[:, :, alone]
        normal = np.einsum("mci,c,mcj->ij", N, weight, N, optimize=True) + np.diag(state.precision[alone])
        S = S - N @ (inverse(normal) @ np.einsum("mci,c,mcj->ij", N, weight, S, optimize=True))
    matrix = np.einsum("mci,c,mcj->ij", S, weight, own_columns, optimize=True)
    score = noise.colour.meat(S, noise.variance, whole_manoeuvres(state.responses.manoeuvre[:blocks]))
    return Information(labels, 0.5 * (matrix + matrix.T), score, state.precision[columns])


def columns_of(state: SelectionState, effect: Effect) -> dict[str, int]:
    """Columns of an effect by label; of one without slope at neutral, that of its least scanned value."""
    begin = len(state.theta) + len(state.offsets)
    scans = [(abs(s.value), begin + k, s) for k, s in enumerate(state.scans) if s.effect == effect.name]
    if scans:
        _, column, scan = min(scans, key=lambda row: row[0])
        return {scan.parameter: column}
    names = [name for name in state.full.parameters_of(effect.name) if name in state.full.model.names]
    return dict(zip(names, map(int, state.full.columns(names)), strict=True))


def signals_of(state: SelectionState, chosen: Sequence[Effect], sizes: Mapping[str, float]) -> dict[str, dict]:
    """The size of each column of `chosen`: that of its parameter in `sizes`, or the least scanned value's distance."""
    scanned = {s.effect for s in state.scans}
    found = {}
    for effect in chosen:
        labels = columns_of(state, effect)
        if effect.name in scanned:
            least = min((s for s in state.scans if s.effect == effect.name), key=lambda s: abs(s.value))
            found[effect.name] = {
                least.parameter: float(least.value - state.theta[state.full.columns([least.parameter])[0]])
            }
        else:
            found[effect.name] = {label: sizes[label] for label in labels}
    return found
