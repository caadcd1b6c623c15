"""The card's model and the extended one of a diagnosis: fitted, evaluated at every sample, and their stalls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.screening.parameter_fit import refitted
from bayes_aero.diagnosis.screening.regression import Fit
from bayes_aero.diagnosis.screening.selection_state import SelectionState, moved
from bayes_aero.diagnosis.selection.cross_validation import truncated
from bayes_aero.diagnosis.selection.residuals import Profile, details, profiles, theil_parts
from bayes_aero.diagnosis.view.covariance import covariance_of, joint_covariance
from bayes_aero.diagnosis.view.rankings import rankings_of
from bayes_aero.diagnosis.view.results import LEVELS, DiagnosisView, Fitted, ParameterMove, View
from bayes_aero.inference.identification import Stall
from bayes_aero.inference.scores import score
from bayes_aero.inference.stall import stall_of
from bayes_aero.physics.coefficient_names import LATERAL, NAMES

DRAWS = 400  # of a model's parameters, for the intervals of its stall
NOT_SIGNALS = ("X", "measured", "modelled", "residual", *NAMES, *LATERAL)
RESPONSES = ("ax", "ay", "az", "p_dot", "q_dot", "r_dot")  # what the forces make, not what makes them


def view_of(diagnosis: Diagnosis) -> DiagnosisView:
    """What is shown of a diagnosis, whichever way the model met the record."""
    return coefficient_view(diagnosis) if diagnosis.by_coefficients else _trajectory_view(diagnosis)


def _trajectory_view(diagnosis: Diagnosis) -> DiagnosisView:
    """Of the card's parameters before, the standard errors are not known."""
    units = {p.name: p.unit for p in diagnosis.aerodynamics.state.full.model.free}
    moves = {
        name: ParameterMove(a, b, float("nan"), sd, units[name]) for name, (a, b, sd) in diagnosis.base_moves.items()
    }
    last = diagnosis.aerodynamics
    deviations = {name: move.sd_after for name, move in moves.items()}
    return DiagnosisView(
        diagnosis=diagnosis,
        rankings=tuple(rankings_of(diagnosis)),
        moves=moves,
        covariance=joint_covariance(last.state, last.fit, deviations, diagnosis.causes),
    )


def coefficient_view(diagnosis: Diagnosis) -> View:
    """Refit the card's model without any correction of the sensors, and evaluate both models at the recorded rate."""
    before, after = _card(diagnosis), _extended(diagnosis)
    flights = diagnosis.aerodynamics.state.responses.flights
    begin = np.cumsum([0, *flights.lengths[:-1]])
    signals = details(before[0])
    channels = {**before[0].responses.flights.channels, **signals}  # one abscissa for both models
    card, extended = (_fitted(*model, np.asarray(signals["measured"]), channels) for model in (before, after))
    return View(
        diagnosis=diagnosis,
        card=card,
        extended=extended,
        measured=np.asarray(signals["measured"]),
        manoeuvre=flights.manoeuvre,
        time=flights.time - flights.time[begin][flights.manoeuvre],
        names=flights.names,
        channels=channels,
        parameters=card.state.full.model.parameters,
        rankings=tuple(rankings_of(diagnosis)),
        moves=_moves(card, extended),
        covariance=joint_covariance(extended.state, extended.fit, {}, diagnosis.causes),
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


def _fitted(state: SelectionState, fit: Fit, measured: Float[np.ndarray, "n c"], channels: Mapping[str, Any]) -> Fitted:
    signals = details(state)
    residual = signals["residual"][:, : len(state.outputs)]
    return Fitted(
        residual,
        signals,
        _composition(state, fit, measured, residual),
        _profiles(state, residual, channels),
        state,
        fit,
    )


def _profiles(
    state: SelectionState, residual: Float[np.ndarray, "n c"], channels: Mapping[str, Any]
) -> tuple[tuple[Profile, ...], ...]:
    """By coefficient, the mean residual over each recorded channel that makes forces, and over what follows from it."""
    block, recorded = state.responses.block, (*state.responses.flights.recorded, "alpha_dot", "elapsed", "X")
    names = [name for name in recorded if name in channels and name not in RESPONSES]
    blocks = {name: np.asarray(block(jnp.asarray(channels[name]))) for name in names}
    return tuple(
        tuple(profiles(np.asarray(block(jnp.asarray(residual[:, c]))), blocks, state.variance_inflation))
        for c in range(residual.shape[1])
    )


def _deviations(fitted: Fitted) -> dict[str, float]:
    columns, covariance = covariance_of(fitted.state, fitted.fit)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    free = fitted.state.full.model.names
    return {free[c]: float(x) for c, x in zip(columns, sd, strict=True)}


def _stall(fitted: Fitted) -> Stall:
    """The stall of a fitted model; its parameters are drawn from the normal distribution of their estimates."""
    state = fitted.state
    columns, covariance = covariance_of(fitted.state, fitted.fit)
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


def _composition(
    state: SelectionState, fit: Fit, measured: Float[np.ndarray, "n c"], residual: Float[np.ndarray, "n c"]
) -> dict[str, dict[str, Any]]:
    """Each coefficient's residuals, manoeuvres fitted jointly: scores, Theil's parts, autocorrelation, calibration.

    Scores, Theil's parts and lag 1 are at the recorded rate. `calibration` is the share of residuals (5 Hz means)
    within the central normal bands of the fitted noise, growth with separation included.
    """
    standard = state.left(fit) / np.sqrt(fit.variance)
    inside = np.concatenate([standard[fold] for fold in state.folds])
    manoeuvre, found = state.responses.flights.manoeuvre, {}
    for c, name in enumerate(state.outputs):
        z, e = measured[:, c], residual[:, c]
        scores, parts = score(z, z - e), theil_parts(z, z - e)
        found[name] = {
            "r": scores.r,
            "rmse": scores.rmse,
            "r2": scores.r2,
            "theil": parts.theil,
            "theil_bias": parts.bias,
            "theil_variance": parts.variance,
            "theil_covariance": parts.covariance,
            "lag1": _lag1(e, manoeuvre),
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
