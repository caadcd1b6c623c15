"""The card's model and the extended one of a diagnosis: fitted, evaluated at every sample, and their stalls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from bayes_aero.diagnosis.accuracy import LeftOut, measured_blocks, normal_draws, scores_of, truncated
from bayes_aero.diagnosis.candidate_set import by_manoeuvre
from bayes_aero.diagnosis.design import flights_of, narrowed
from bayes_aero.diagnosis.result import (
    COEFFICIENTS,
    FLIGHT_PATH,
    LEVELS,
    Cause,
    CausesInBand,
    Compared,
    Diagnosis,
    DiagnosisView,
    Fitted,
    HoldoutScores,
    JointCovariance,
    ParameterMove,
    RankedCandidate,
    Ranking,
    ResidualProfile,
    SizeInBand,
    View,
    theil_parts,
)
from bayes_aero.diagnosis.screening import lag1_within, uncertainty
from bayes_aero.diagnosis.selection import Extension, explained
from bayes_aero.diagnosis.selection_state import RegressionFit, SelectionState, moved, refitted
from bayes_aero.inference.covariance import standard_error_of_sum
from bayes_aero.inference.frequency import MIN_SHARE, cramer_rao, fit_in_band, without_noise_bias_in_band
from bayes_aero.inference.mle import stall_of
from bayes_aero.inference.results import FrequencyFit, score
from bayes_aero.model.model import Model
from bayes_aero.model.records import Flights
from bayes_aero.physics.aircraft import LATERAL, NAMES
from bayes_aero.residuals.equation_error import Band, FrequencyError, sampling_times

DRAWS = 400  # of a model's parameters, for the intervals of its stall
NOT_SIGNALS = ("X", "measured", "modelled", "residual", *NAMES, *LATERAL)
RESPONSES = ("ax", "ay", "az", "p_dot", "q_dot", "r_dot")  # what the forces make, not what makes them


def view_of(diagnosis: Diagnosis) -> DiagnosisView:
    """What is shown of a diagnosis, whichever way the model met the record."""
    if diagnosis.by_coefficients:
        return coefficient_view(diagnosis)
    units = {p.name: p.unit for p in diagnosis.aerodynamics.state.full.model.free}
    moves = {  # of the card's parameters before, the standard errors are not known
        name: ParameterMove(a, b, float("nan"), sd, units[name]) for name, (a, b, sd) in diagnosis.base_moves.items()
    }
    deviations = {name: move.sd_after for name, move in moves.items()}
    return DiagnosisView(
        diagnosis=diagnosis,
        rankings=rankings_of(diagnosis),
        moves=moves,
        covariance=joint_covariance(diagnosis.aerodynamics, deviations, diagnosis.causes),
    )


def coefficient_view(diagnosis: Diagnosis) -> View:
    """Refit the card's model without any correction of the sensors, and evaluate both models at the recorded rate."""
    last, sensors = diagnosis.aerodynamics, diagnosis.sensors
    before, after = (last.base, last.base_fit), (last.state, last.fit)
    if sensors is not None and sensors.state.active:
        before = refitted(moved(last.base, last.base.full.at_neutral(last.base.theta, sensors.state.active)))
    if set(diagnosis.kept) != set(last.state.active):  # the part of the extension that hold-out data confirm
        after = refitted(truncated(last.state, diagnosis.kept))
    flights = diagnosis.aerodynamics.state.responses.flights
    begin = np.cumsum([0, *flights.lengths[:-1]])
    signals = before[0].responses.predict(before[0].theta)
    channels = {**before[0].responses.flights.channels, **signals}  # one abscissa for both models
    card, extended = (_fitted(*model, signals["measured"], channels) for model in (before, after))
    return View(
        diagnosis=diagnosis,
        card=card,
        extended=extended,
        measured=signals["measured"],
        manoeuvre=flights.manoeuvre,
        time=flights.time - flights.time[begin][flights.manoeuvre],
        names=flights.names,
        channels=channels,
        parameters=card.state.full.model.parameters,
        rankings=rankings_of(diagnosis),
        moves=_moves(card, extended),
        covariance=joint_covariance(extended, {}, diagnosis.causes),
    )


def with_stalls(view: View) -> View:
    """The same with the stall of the card's model, and of the extended one where there is one."""
    models, stalls = {"card": view.card, "extended": view.extended} if view.changed else {"card": view.card}, {}
    for name, fitted in models.items():  # parameters are drawn from the normal distribution of their estimates
        model, flights = fitted.state.full.model, fitted.state.responses.flights
        draws = normal_draws(fitted.state.theta, *covariance_of(fitted), model.free, 0, DRAWS)
        signals = {channel: x for channel, x in fitted.signals.items() if channel not in NOT_SIGNALS}
        stalls[name] = stall_of(model, draws, signals, flights.aircraft)
    return replace(view, stalls=stalls)


def _fitted(
    state: SelectionState, fit: RegressionFit, measured: Float[np.ndarray, "n c"], channels: Mapping[str, Any]
) -> Fitted:
    """A model evaluated; by coefficient, the mean residual over each recorded channel that makes forces."""
    signals = state.responses.predict(state.theta)
    residual = signals["residual"][:, : len(state.outputs)]
    block, recorded = state.responses.block, (*state.responses.flights.recorded, "alpha_dot", "elapsed", "X")
    names = [name for name in recorded if name in channels and name not in RESPONSES]
    blocks = {name: np.asarray(block(jnp.asarray(channels[name]))) for name in names}
    each = [np.asarray(block(jnp.asarray(x))) for x in residual.T]
    over = tuple(tuple(profiles(x, blocks, state.variance_inflation)) for x in each)
    return Fitted(residual, signals, _composition(state, fit, measured, residual), over, state, fit)


BINS = 12
LEAST = 1e-3  # of the residual's size, that a deviation counts as at least: a simulation at rest has none


def profiles(
    residual: Float[np.ndarray, " n"], channels: Mapping[str, np.ndarray], variance_inflation: float
) -> list[ResidualProfile]:
    """How the residual depends on each channel, the clearest first."""
    profiles_by_channel, bins = [], max(1, min(BINS, len(residual) // 2))  # of two blocks: they have a deviation
    for name, x in channels.items():
        if np.ptp(x) <= 1e-9 * max(1.0, float(np.abs(x).max())):
            continue
        parts = np.array_split(np.argsort(x, kind="stable"), bins)
        mean = np.array([residual[p].mean() for p in parts])
        sd = np.array([residual[p].std() * np.sqrt(variance_inflation / len(p)) for p in parts])
        profiles_by_channel.append(ResidualProfile(name, np.array([x[p].mean() for p in parts]), mean, sd))
    least = max(LEAST * float(np.sqrt(np.mean(residual**2))), 1e-300)
    return sorted(profiles_by_channel, key=lambda p: -float(np.sum((p.mean / np.maximum(p.deviation, least)) ** 2)))


def _moves(before: Fitted, after: Fitted) -> dict[str, ParameterMove]:

    def deviations(fitted: Fitted) -> dict[str, float]:
        columns, covariance = covariance_of(fitted)
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return {fitted.state.full.model.names[c]: float(x) for c, x in zip(columns, sd, strict=True)}

    full, sd, sd_after = after.state.full, deviations(before), deviations(after)
    names = [p for e in full.base for p in full.parameters_of(e) if p in sd and p in sd_after]
    moves = {}
    for name, i in zip(names, map(int, full.columns(names)), strict=True):
        values = float(before.state.theta[i]), float(after.state.theta[i])
        moves[name] = ParameterMove(*values, sd[name], sd_after[name], full.model.free[i].unit)
    return moves


def _composition(
    state: SelectionState, fit: RegressionFit, measured: Float[np.ndarray, "n c"], residual: Float[np.ndarray, "n c"]
) -> dict[str, dict[str, Any]]:
    """Each coefficient's residuals: scores, Theil's parts, lag 1, and calibration of the fitted noise."""
    standard = state.left(fit) / np.sqrt(fit.variance)
    inside = np.concatenate([standard[fold] for fold in state.folds])
    manoeuvre, composition = state.responses.flights.manoeuvre, {}
    for c, name in enumerate(state.outputs):
        z, e = measured[:, c], residual[:, c]
        scores, parts = score(z, z - e), theil_parts(z, z - e)
        bands = {f"{p:g}": np.abs(inside[:, c]) <= stats.norm.ppf(0.5 + p / 2) for p in LEVELS}
        theil = {f"theil_{part}": getattr(parts, part) for part in ("bias", "variance", "covariance")}
        composition[name] = {
            "r": scores.r,
            "rmse": scores.rmse,
            "r2": scores.r2,
            "theil": parts.theil,
            **theil,
            "lag1": lag1_within(e, manoeuvre),
            "calibration": {level: float(np.mean(within)) for level, within in bands.items()},
        }
    return composition


# --- The covariance of a fitted model's estimates, with what a diagnosis adds to it for its causes.


def covariance_of(model: Fitted | Extension) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """Which parameters were fitted, and the covariance of their estimates that coloured residuals leave."""
    parameters = np.flatnonzero(model.fit.columns < len(model.state.theta))
    return model.fit.columns[parameters], uncertainty(model.state, model.fit)[np.ix_(parameters, parameters)]


def joint_covariance(
    model: Fitted | Extension, deviations: Mapping[str, float], causes: Sequence[Cause]
) -> JointCovariance:
    """Of the extended model's parameters, as standard errors are reported: `deviations`, and those of `causes`."""
    # A parameter may be reported with a larger error than coloured residuals leave: noise of the recorded regressors
    # and the scatter between stretches count, too. What is beyond is independent of the other parameters.
    columns, covariance = covariance_of(model)
    names = tuple(model.state.full.model.names[c] for c in columns)
    reported = dict(deviations) | {name: size.sd for cause in causes for name, size in cause.parameters.items()}
    variance = np.diag(covariance)
    beyond = [max(reported.get(name, 0.0) ** 2 - own, 0.0) for name, own in zip(names, variance, strict=True)]
    return JointCovariance(names, 0.5 * (covariance + covariance.T) + np.diag(beyond))  # symmetric but for rounding


# --- Both models of a diagnosis on each manoeuvre, in the fit and on hold-out data.


def holdout_scores(view: View) -> HoldoutScores:
    """Fit both models again without each fold, and score each manoeuvre by these fits and by those to all data."""
    models = {"card": view.card, "extended": view.extended}
    left = {name: LeftOut.refitted(fitted.state) for name, fitted in models.items()}
    state = view.extended.state
    measured, scores, gains = measured_blocks(state), {}, {}
    for k, manoeuvre in enumerate(view.names):
        here = (state.responses.manoeuvre == k) & left["extended"].inside
        for model, fitted in models.items():
            for split, residual in (("fitted", fitted.state.residual), ("hold_out", left[model].residual)):
                scores[model, split, k] = scores_of(state.outputs, measured[here], residual[here])
        differences = compared(left["card"], left["extended"], state, measured, k)
        gains |= {(manoeuvre, name): gain for name, gain in differences.items()}
    return HoldoutScores(view.names, scores, gains, state.settings.hold_out)


def with_holdout_scores(view: View) -> View:
    """The same with both models on each manoeuvre, where there are several and something was added."""
    if len(view.names) == 1 or not view.extended.state.active:
        return view
    return replace(view, holdout=holdout_scores(view))


def compared(
    before: LeftOut, after: LeftOut, state: SelectionState, measured: Float[np.ndarray, "m c"], manoeuvre: int
) -> dict[str, Compared]:
    """`after` against `before` on one manoeuvre, by coefficient; its blocks' order and colour are kept."""
    here = (state.responses.manoeuvre == manoeuvre) & before.inside
    density = (after.densities() - before.densities())[here[before.inside]] / state.variance_inflation
    total = np.sum((measured[here] - measured[here].mean(axis=0)) ** 2, axis=0)
    squares = (before.residual[here] ** 2 - after.residual[here] ** 2) / total

    def summed(x: np.ndarray) -> tuple[float, float]:
        return float(x.sum()), standard_error_of_sum(x, [len(x)])

    return {n: Compared(*summed(density[:, c]), *summed(squares[:, c])) for c, n in enumerate(state.outputs)}


# --- The candidates of every stage in the order of their scores, as tables and figures show them.


def rankings_of(diagnosis: Diagnosis) -> tuple[Ranking, ...]:
    rankings, stages = [], {FLIGHT_PATH: diagnosis.sensors, diagnosis.compared: diagnosis.aerodynamics}
    for stage, extension in ((stage, x) for stage, x in stages.items() if x is not None and x.steps):
        screening, base, ranked = extension.steps[0].screening, extension.base, {}
        effects = {e.name: e for e in base.full.model.effects}
        for s in (s for s in screening.candidate_scores if s.effect not in ranked):
            effect, at = effects[s.effect], base.theta[base.full.own_columns(s.effect)]
            steps = zip(effect.parameters, at, s.step, s.sd, strict=False)
            sizes = {p.name: (float(x + d), sd) for p, x, d, sd in steps}
            p_value, share = screening.p_value(s.score), explained(base, s)
            ranked[s.effect] = RankedCandidate(s.effect, effect.kind.value, s.score, p_value, share, sizes)
        level = extension.state.settings.false_alarm_rate
        leaders = tuple(sorted(ranked.values(), key=lambda s: -s.score))
        rankings.append(Ranking(stage, leaders, screening.threshold(level), level))
    return tuple(rankings)


# --- Sizes of the causes in a band of frequencies, beside those of the coefficients: bias and drift drop out there.
# The extended model is fitted again to the finite Fourier transforms of the coefficients, with the errors of sensors at
# their values. An effect that only a drift or a slow model error has made is smaller in the band, or gone.

PERIODS = 2.0  # of the lowest frequency in the shortest manoeuvre
POWER, BEYOND = 0.95, 2.0  # share of the rates' power below a frequency, and how far beyond it the band reaches
HIGHEST, SMOOTHED = 0.5, 0.1  # Hz to which it reaches at least; share of the sampling rate that the filters pass


def causes_in_band(diagnosis: Diagnosis) -> CausesInBand | None:
    """Fit the causes of a diagnosis in a band; None where there are none."""
    wanted = {p: c for c in diagnosis.causes if c.stage == COEFFICIENTS for p in c.parameters}
    if not (diagnosis.by_coefficients and wanted):
        return None
    state = diagnosis.aerodynamics.state
    wanted = {p: c for p, c in wanted.items() if c.name in state.active}
    model, start = with_sensor_errors_held(state)
    flights = flights_of(state)
    band = band_of(flights)
    responses = FrequencyError.in_band(flights, model, band)
    fit = without_noise_bias_in_band(fit_in_band(responses, model.free, start, band), responses, model.free)
    if not fit.converged:
        return CausesInBand(band, (), tuple(wanted), converged=False)
    shared = _shared(fit, state, model.names)
    sizes = []
    for name, cause in wanted.items():
        if name in fit.names:
            k, size = fit.names.index(name), cause.parameters[name]
            x, sd = float(fit.estimate[k]), float(fit.crb_corrected[k])
            # Of an estimate and one that rests on a part of its data, as `beside_time_domain` has it.
            least = max(abs(sd**2 - size.sd**2), MIN_SHARE * sd**2)
            apart = abs(x - size.mean) / float(np.sqrt(max(size.sd**2 + sd**2 - 2.0 * shared[k], least)))
            sizes.append(SizeInBand(cause.name, name, size.unit, (x, sd), (size.mean, size.sd), apart))
    return CausesInBand(band, tuple(sizes), tuple(n for n in wanted if n not in fit.names), converged=True)


def with_sensor_errors_held(state: SelectionState) -> tuple[Model, Float[np.ndarray, " k"]]:
    """The model of the coefficients, and the values of its free parameters (k,). Sensor errors keep their values."""
    values = dict(zip(state.full.model.names, map(float, state.theta), strict=True))
    free = {p for name in (*state.full.base, *state.active) for p in state.full.parameters_of(name)}
    away = {name for name, by in zip(values, state.departure, strict=True) if by != 0.0}
    model = narrowed(state, [e.name for e in state.full.model.effects if any(p.name in away for p in e.parameters)])
    held = {p.name: values[p.name] for p in model.free if p.name not in free}
    model = replace(model, fixed=(*model.fixed, *held.items()))
    return model, np.array([values[name] for name in model.names])


def _shared(fit: FrequencyFit, state: SelectionState, names: Sequence[str]) -> np.ndarray:
    """Covariance of each estimate with that of the whole record, in which the parameters `names` are free; (k,)."""
    # The share of the band in the information, times the variance in the band.
    outputs = [state.outputs.index(name) for name in fit.inner]
    residual, S = state.residual[:, outputs], state.S[:, outputs][:, :, state.full.columns(names)]
    R = np.mean(np.square(residual), axis=0)
    _, D = cramer_rao(S, R)
    blocks = sum(state.responses.flights.lengths) / len(residual)
    place = [names.index(name) for name in fit.names]
    inner = sum(of / r for of, r in zip(fit.inner.values(), R, strict=True)) / blocks
    return np.nan_to_num(np.diag(D[np.ix_(place, place)] @ inner @ fit.corrected))


def band_of(flights: Flights) -> Band:
    """The band that the manoeuvres excite, Hz, as far as the smoothing filters pass."""
    times, reach = sampling_times(flights), 0.0
    low = PERIODS / min(n * dt for n, dt in zip(flights.lengths, times, strict=True))
    for name in (name for name in ("p", "q", "r") if name in flights.recorded):
        for x, dt in zip(by_manoeuvre(np.asarray(flights.channels[name]), flights), times, strict=True):
            power = np.abs(np.fft.rfft(x - x.mean())) ** 2
            if power.sum() > 0.0:
                share = np.cumsum(power) / power.sum()
                reach = max(reach, float(np.fft.rfftfreq(len(x), dt)[np.searchsorted(share, POWER)]))
    passed = SMOOTHED / max(times)
    return low, float(min(max(BEYOND * reach, HIGHEST, 4.0 * low), max(passed, 4.0 * low)))
