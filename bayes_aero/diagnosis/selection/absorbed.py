"""Constants that a control at rest takes up.

A rudder that is held aside makes a yawing moment that stays, as uneven engines do. Where it does not move, its
derivative is known from that constant alone. It takes up what else is constant, and the selection finds nothing. The
record then does not decide between an unusual derivative and the other cause.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.screening.regression import inverse
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.effect import Effect

CONTROLS = (
    "elevator", "stabilizer", "canard", "flap", "spoiler", "dlc", "aileron", "rudder", "spoiler_left", "spoiler_right",
)  # fmt: skip
AT_REST = 0.1  # of a sensitivity's root mean square, its deviation within the manoeuvres; our choice


@dataclass(frozen=True)
class Absorbed:
    """A `parameter` of the card's `effect` that acts through a `control` at rest, and what it may have taken up.

    `estimate` and `usual` are its value in the fit and that of its prior, each with its deviation. `sizes`: by effect,
    how large each would be, were it the whole cause and the parameter as usual, with a deviation that knows the prior's
    width.
    """

    effect: str
    parameter: str
    unit: str
    control: str
    estimate: tuple[float, float]
    usual: tuple[float, float]
    sizes: dict[str, Size]

    @property
    def members(self) -> frozenset[str]:
        """The effects among which the record does not decide, the card's own included."""
        return frozenset((self.effect, *self.sizes))


def absorbed(found: Extension) -> tuple[Absorbed, ...]:
    """Parameters of the card that may have taken up an effect that is large enough for a name.

    Such an effect is beyond `least_score` deviations at the least size worth modelling if the parameter is held, and
    below if it is free within its prior; and it would be of a size that aircraft have, and worth a name, were the
    parameter as usual.
    """
    state, fit, told = found.state, found.fit, []
    if state.outputs != state.responses.model.coefficients:
        return ()
    for effect in (e for e in state.full.model.effects if e.name in state.full.base):
        controls = [c for c in effect.channels if c in CONTROLS]
        for parameter in effect.parameters if len(controls) == 1 else ():
            if parameter.name not in state.full.model.names:
                continue
            column = int(state.full.columns([parameter.name])[0])
            if column not in fit.columns or not _at_rest(state, column):
                continue
            if sizes := _taken_up(found, column):
                prior = state.full.priors.get(parameter.name, parameter.prior)
                size = found.sizes[parameter.name]
                estimate = float(state.theta[column]), size.sd
                name, unit = parameter.name, parameter.unit
                told.append(Absorbed(effect.name, name, unit, controls[0], estimate, prior.normal, sizes))
    return tuple(told)


def _at_rest(state: SelectionState, column: int) -> bool:
    """Whether what a parameter acts through stays where it is in all manoeuvres together, and not at zero."""
    S = state.S[state.inside][:, :, column]
    square = float(np.sum(S**2))
    return square > 0.0 and float(np.sum((S - S.mean(axis=0)) ** 2)) < AT_REST**2 * square


def _taken_up(found: Extension, column: int) -> dict[str, Size]:
    """Sizes of the candidates that the parameter of a column hides, by name."""
    state, fit = found.state, found.fit
    fewer, hidden = fit.columns[fit.columns != column], {}

    def deviations(at: int, size: float, columns: Int[np.ndarray, " k"]) -> float:
        information = _information(state, columns, size * state.scaled[:, :, at], fit.variance)
        return float(np.sqrt(max(information, 0.0) / state.variance_inflation))

    for effect in _simple(state):
        (at,) = state.full.own_columns(effect.name)
        least, largest = effect.sizes[effect.parameters[0].name]
        if not deviations(at, least, fit.columns) < state.settings.least_score <= deviations(at, least, fewer):
            continue
        mean, sd = _size(found, column, int(at), fewer)
        if least <= abs(mean) <= largest:
            hidden[effect.name] = Size(mean, sd, effect.parameters[0].unit)
    return hidden


def _simple(state: SelectionState) -> list[Effect]:
    """Candidates of one parameter that has a slope at neutral, and of which it is known what is worth a name."""
    scanned = {scan.effect for scan in state.scans}
    return [
        e
        for e in state.full.candidates
        if e.name not in (*state.active, *scanned) and len(e.parameters) == 1 and e.parameters[0].name in e.sizes
    ]


def _information(
    state: SelectionState,
    columns: Int[np.ndarray, " k"],
    signal: Float[np.ndarray, "m c"],
    variance: Float[np.ndarray, " c"],
) -> float:
    """Information in a signal, `columns` free within their priors."""
    A, weight, signal = state.scaled[state.inside][:, :, columns], 1.0 / variance, signal[state.inside]
    normal = np.einsum("mci,c,mcj->ij", A, weight, A, optimize=True) + np.diag(state.precision[columns])
    right = np.einsum("mci,c,mc->i", A, weight, signal, optimize=True)
    return float(np.einsum("mc,c,mc->", signal, weight, signal) - right @ inverse(normal) @ right)


def _size(found: Extension, column: int, at: int, fewer: Int[np.ndarray, " k"]) -> tuple[float, float]:
    """Size of a candidate and its deviation, the parameter of `column` held where its prior has it."""
    state, columns = found.state, np.append(fewer, at)
    away = float(state.mean[column])
    products = state.products.shifted(np.array([column]), np.array([away]))
    fit = products.fit(columns, state.mean, state.precision, held=found.fit.variance)
    here = state.products.fit(columns, state.mean, state.precision, held=found.fit.variance)
    slope = (fit.step[-1] - here.step[-1]) / away if away else 0.0
    variance = inverse(fit.normal)[-1, -1] + slope**2 / state.precision[column]
    return float(fit.step[-1]), float(np.sqrt(state.variance_inflation * variance))
