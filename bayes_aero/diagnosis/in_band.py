"""Sizes of the causes in a band of frequencies, beside those of the coefficients: bias and drift drop out there.

The extended model is fitted again to the finite Fourier transforms of the coefficients, with the errors of sensors at
their values. An effect that only a drift or a slow model error has made is smaller in the band, or gone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import by_manoeuvre
from bayes_aero.diagnosis.design import flights_of, narrowed
from bayes_aero.diagnosis.result import COEFFICIENTS, CausesInBand, Diagnosis, SizeInBand
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.inference.frequency import MIN_SHARE, cramer_rao, fit_in_band, without_noise_bias_in_band
from bayes_aero.inference.results import FrequencyFit
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model
from bayes_aero.residuals.frequency_error import Band, FrequencyError, sampling_times

PERIODS = 2.0  # of the lowest frequency in the shortest manoeuvre
POWER, BEYOND = 0.95, 2.0  # share of the rates' power below a frequency, and how far beyond it the band reaches
HIGHEST, SMOOTHED = 0.5, 0.1  # Hz to which it reaches at least; share of the sampling rate that the filters pass


def causes_in_band(diagnosis: Diagnosis, *, seed: int = 0) -> CausesInBand | None:
    """Fit the causes of a diagnosis in a band; None where there are none. `seed`: of noise that shows its own bias."""
    wanted = {p: c for c in diagnosis.causes if c.stage == COEFFICIENTS for p in c.parameters}
    if not (diagnosis.by_coefficients and wanted):
        return None
    state = diagnosis.aerodynamics.state
    wanted = {p: c for p, c in wanted.items() if c.name in state.active}
    model, start = with_sensor_errors_held(state)
    flights = flights_of(state)
    band = band_of(flights)
    responses = FrequencyError.in_band(flights, model, band)
    fit = without_noise_bias_in_band(fit_in_band(responses, model.free, start, band), responses, model.free, seed=seed)
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
    """The band that the manoeuvres excite, Hz: from two periods a record to twice the frequency below which nearly all
    power of the angular rates is, as far as the smoothing filters pass."""
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
