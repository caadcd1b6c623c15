"""What tables and figures show of a diagnosis: the card's model and the extended one, side by side at every sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.screening.autocorrelation import autocorrelation_of
from bayes_aero.diagnosis.screening.regression import Fit
from bayes_aero.diagnosis.screening.screening import uncertainty
from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved, refitted
from bayes_aero.diagnosis.selection.cross_validation import truncated
from bayes_aero.diagnosis.selection.residuals import details, theil_parts
from bayes_aero.diagnosis.trajectories.trajectories import Trajectories
from bayes_aero.inference.scores import Scores, score
from bayes_aero.inference.stall import Stall, stall_of
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.report.tables.rankings import Ranking, rankings_of

LEVELS = (0.5, 0.9, 0.95)
DRAWS = 400  # of a model's parameters, for the intervals of its stall
NOT_SIGNALS = ("X", "measured", "modelled", "residual", *NAMES)


@dataclass(frozen=True)
class Fitted:
    """One model fitted to all manoeuvres: residuals at the recorded rate (n, 3), and the regression behind it."""

    state: SelectionState
    fit: Fit
    residual: Float[np.ndarray, "n 3"]
    signals: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class ParameterMove:
    """A parameter of the card before and after the causes are added; standard errors count the autocorrelation."""

    before: float
    after: float
    sd_before: float
    sd_after: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class DiagnosisView:
    """A diagnosis with what is derived from it, by coefficients (see `View`) or by trajectories alone."""

    diagnosis: Diagnosis
    rankings: tuple[Ranking, ...]
    moves: Mapping[str, ParameterMove]
    trajectories: Trajectories | None = None


@dataclass(frozen=True, kw_only=True)
class View(DiagnosisView):
    """A diagnosis by coefficients; `measured` (n, 3) are those that the card reconstructs."""

    card: Fitted
    extended: Fitted
    measured: Float[np.ndarray, "n 3"]
    manoeuvre: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]  # from the start of each manoeuvre, s
    names: tuple[str, ...]
    stalls: Mapping[str, Stall] = field(default_factory=dict)  # by model: card, and extended where it differs

    @property
    def changed(self) -> bool:
        """Whether anything was added to the card's model."""
        sensors = self.diagnosis.sensors
        return bool(self.extended.state.active or (sensors is not None and sensors.state.active))

    @property
    def seconds(self) -> float:
        """Sampling time, s."""
        return float(np.median(np.diff(self.time[self.manoeuvre == 0])))


def view_of(diagnosis: Diagnosis) -> DiagnosisView:
    """What is shown of a diagnosis, whichever way the model met the record."""
    return coefficient_view(diagnosis) if diagnosis.by_coefficients else _trajectory_view(diagnosis)


def _trajectory_view(diagnosis: Diagnosis) -> DiagnosisView:
    """Of the card's parameters before, the standard errors are not known."""
    units = {p.name: p.unit for p in diagnosis.aerodynamics.state.full.model.free}
    moves = {
        name: ParameterMove(a, b, float("nan"), sd, units[name]) for name, (a, b, sd) in diagnosis.base_moves.items()
    }
    return DiagnosisView(diagnosis=diagnosis, rankings=tuple(rankings_of(diagnosis)), moves=moves)


def coefficient_view(diagnosis: Diagnosis) -> View:
    """Refit the card's model without any correction of the sensors, and evaluate both models at the recorded rate."""
    last = diagnosis.aerodynamics
    card, after = _fitted(*_card(diagnosis)), _fitted(*_extended(diagnosis))
    flights = last.state.responses.flights
    begin = np.cumsum([0, *flights.lengths[:-1]])
    return View(
        diagnosis=diagnosis,
        card=card,
        extended=after,
        measured=np.asarray(card.signals["measured"]),
        manoeuvre=flights.manoeuvre,
        time=flights.time - flights.time[begin][flights.manoeuvre],
        names=flights.names,
        rankings=tuple(rankings_of(diagnosis)),
        moves=_moves(card, after),
    )


def with_stalls(view: View) -> View:
    """The same with the stall of the card's model, and of the extended one where there is one."""
    models = {"card": view.card, "extended": view.extended} if view.changed else {"card": view.card}
    return replace(view, stalls={name: _stall(fitted) for name, fitted in models.items()})


def _card(diagnosis: Diagnosis) -> tuple[SelectionState, Fit]:
    base, sensors = diagnosis.aerodynamics.base, diagnosis.sensors
    if sensors is None or not sensors.state.active:
        return base, diagnosis.aerodynamics.base_fit
    theta = base.theta.copy()
    for effect in sensors.state.active:
        for name in base.full.parameters_of(effect):
            theta[base.full.columns([name])[0]] = base.full.neutral[name]
    return refitted(moved(base, theta))


def _extended(diagnosis: Diagnosis) -> tuple[SelectionState, Fit]:
    """The part of the extension that hold-out data confirm."""
    last = diagnosis.aerodynamics
    if set(diagnosis.kept) == set(last.state.active):
        return last.state, last.fit
    return refitted(truncated(last.state, diagnosis.kept))


def _fitted(state: SelectionState, fit: Fit) -> Fitted:
    found = details(state)
    return Fitted(state, fit, found["residual"][:, : len(NAMES)], found)


def _covariance(fitted: Fitted) -> tuple[np.ndarray, np.ndarray]:
    """Which parameters were fitted, and the covariance of their estimates that coloured residuals leave."""
    state, fit = fitted.state, fitted.fit
    own = np.flatnonzero(fit.columns < len(state.theta))
    covariance = uncertainty(state, fit, autocorrelation_of(state.left(fit), state.folds))
    return fit.columns[own], covariance[np.ix_(own, own)]


def _deviations(fitted: Fitted) -> dict[str, float]:
    columns, covariance = _covariance(fitted)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    free = fitted.state.full.model.names
    return {free[c]: float(x) for c, x in zip(columns, sd, strict=True)}


def _stall(fitted: Fitted) -> Stall:
    """The stall of a fitted model; its parameters are drawn from the normal distribution of their estimates."""
    state = fitted.state
    columns, covariance = _covariance(fitted)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    white = np.random.default_rng(0).standard_normal((DRAWS, len(columns)))
    draws = np.tile(state.theta, (DRAWS, 1))
    draws[:, columns] += (white * np.sqrt(np.maximum(values, 0.0))) @ vectors.T * scale
    lower, upper = (np.array([p.bounds[i] for p in state.full.model.free], float) for i in (0, 1))
    lower, upper = np.minimum(lower, state.theta), np.maximum(upper, state.theta)
    model, flights = state.full.model, state.responses.flights
    signals = {name: fitted.signals[name] for name in fitted.signals if name not in NOT_SIGNALS}
    return stall_of(model, np.clip(draws, lower, upper), signals, flights.aircraft)


def _moves(before: Fitted, after: Fitted) -> dict[str, ParameterMove]:
    """Parameters of the card's own effects."""
    full = after.state.full
    sds = _deviations(before), _deviations(after)
    found = {}
    for effect in full.base:
        for name in full.parameters_of(effect):
            if name in sds[0] and name in sds[1]:
                i = full.columns([name])[0]
                values = float(before.state.theta[i]), float(after.state.theta[i])
                found[name] = ParameterMove(*values, sds[0][name], sds[1][name], full.model.free[i].unit)
    return found


def composition(view: View, fitted: Fitted) -> dict[str, dict[str, Any]]:
    """Each coefficient's residuals, manoeuvres fitted jointly: scores, Theil's parts, autocorrelation, calibration.

    Scores, Theil's parts and lag 1 are at the recorded rate. `calibration` is the share of residuals (5 Hz means)
    within the central normal bands of the fitted noise, growth with separation included.
    """
    standard = fitted.state.left(fitted.fit) / np.sqrt(fitted.fit.variance)
    inside = np.concatenate([standard[fold] for fold in fitted.state.folds])
    found = {}
    for c, name in enumerate(NAMES):
        z, e = view.measured[:, c], fitted.residual[:, c]
        scores, parts = score(z, z - e), theil_parts(z, z - e)
        found[name] = {
            "r": scores.r,
            "rmse": scores.rmse,
            "r2": scores.r2,
            "theil": parts.theil,
            "theil_bias": parts.bias,
            "theil_variance": parts.variance,
            "theil_covariance": parts.covariance,
            "lag1": _lag1(e, view.manoeuvre),
            "calibration": {
                f"{level:g}": float(np.mean(np.abs(inside[:, c]) <= stats.norm.ppf(0.5 + level / 2)))
                for level in LEVELS
            },
        }
    return found


def _lag1(residual: Float[np.ndarray, " n"], manoeuvre: Int[np.ndarray, " n"]) -> float:
    """Correlation of neighbouring samples, within manoeuvres."""
    parts = [residual[manoeuvre == k] - residual[manoeuvre == k].mean() for k in range(int(manoeuvre[-1]) + 1)]
    return float(sum(np.sum(p[1:] * p[:-1]) for p in parts) / sum(np.sum(p**2) for p in parts))


def unseen_scores(d: Diagnosis) -> tuple[Mapping[str, Scores], Mapping[str, Scores]] | None:
    """Scores of each coefficient on hold-out data: the card's model, and with all causes that are confirmed."""
    measured = [c.gain for c in d.causes if c.gain.before]
    if not measured:
        return None
    confirmed = [c.gain for c in d.causes if c.gain.before and c.confirmed]
    return measured[0].before, confirmed[-1].after if confirmed else measured[0].before
