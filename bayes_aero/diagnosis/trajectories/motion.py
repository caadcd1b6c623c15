"""Modes of motion of a fitted model with standard errors.

Errors are of first order: central differences of the eigenvalues, each about its own trim, over a tenth of the standard
error of every parameter, with the covariance that allows for coloured residuals, or that of the fit with process noise.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.candidate_set import manoeuvres
from bayes_aero.diagnosis.trajectories.results import HALF, FlownMode, Motion, ProcessNoise, TrajectoryFit
from bayes_aero.dynamics.flight import unbiased
from bayes_aero.dynamics.linear import LinearDynamics, Steady, modes
from bayes_aero.errors import InputError
from bayes_aero.inference.output_error_result import OutputErrorResult
from bayes_aero.model.joined_channels import Flights
from bayes_aero.physics.aircraft import altitude_of_density

STEP = 0.1  # standard errors
KNOWN = 2.0  # standard errors from which a real part differs from zero; our choice
BEGIN = 1.0  # s at a manoeuvre's beginning, before it is disturbed


def steady_of(flights: Flights) -> Steady:
    """The steady flight from which the manoeuvres begin: medians over them of the first second."""

    def begin(name: str, otherwise: float) -> float:
        if name not in flights.channels:
            return otherwise
        x, parts = np.asarray(flights.channels[name], float), []
        for part in manoeuvres(flights.manoeuvre):
            time = flights.time[part]
            parts.append(np.median(x[part][time <= time[0] + BEGIN]))
        return float(np.median(parts))

    density = begin("density", math.nan)
    altitude = altitude_of_density(density) if density > 0.0 else begin("altitude", 0.0)
    return Steady(begin("airspeed", 1.0), altitude, begin("alpha", 0.0))


def flown_modes(fit: OutputErrorResult, steady: Steady, filtered: ProcessNoise | None = None) -> tuple[FlownMode, ...]:
    """The modes of a model whose fit converged, about `steady` flight; with the estimates of `filtered` in place of
    those of `fit`. Raises `InputError` where there is no such flight, or the model has no motion of its own."""
    dynamics, aircraft = unbiased(fit.flown.dynamics), fit.flown.flights.aircraft
    count = len(dynamics.free)
    theta, covariance = np.asarray(fit.estimate[:count]), np.asarray(fit.corrected)[:count, :count]
    if filtered is not None:
        order = [list(filtered.estimates).index(name) for name in dynamics.names]
        theta = np.array([filtered.estimates[name][0] for name in dynamics.names])
        covariance = (
            np.zeros((count, count)) if filtered.covariance is None else filtered.covariance[np.ix_(order, order)]
        )
    found = modes(dynamics, dynamics.values(theta), aircraft, steady)
    slopes = np.zeros((len(found), 2, count))
    scale = np.sqrt(np.diag(covariance))
    open_ones = () if filtered is not None else fit.undetermined
    unknown = [k for k, p in enumerate(fit.parameters[:count]) if p.name in open_ones]
    scale[unknown] = np.maximum(np.abs(theta[unknown]), 1e-2)  # only whether it matters
    for k in np.flatnonzero(scale):
        step = np.zeros(count)
        step[k] = STEP * scale[k]
        try:
            ends = [modes(dynamics, dynamics.values(theta + sign * step), aircraft, steady) for sign in (1.0, -1.0)]
        except InputError:
            slopes[:, :, k] = math.nan
            continue
        near = [
            [min((m.eigenvalue for m in end), key=lambda x: abs(x - one.eigenvalue)) for end in ends] for one in found
        ]
        change = np.array([plus - minus for plus, minus in near]) / (2.0 * step[k])
        slopes[:, :, k] = np.stack([change.real, change.imag], axis=1)
    moved = np.any(np.abs(slopes[:, :, unknown]) > 1e-9, axis=(1, 2))
    return tuple(
        flown_mode(one.name, one.eigenvalue, np.full((2, 2), np.inf) if lost else J @ covariance @ J.T)
        for one, J, lost in zip(found, slopes, moved, strict=True)
    )


def flown_mode(name: str, eigenvalue: complex, covariance: Float[np.ndarray, "2 2"]) -> FlownMode:
    """A mode of this eigenvalue (1/s) whose real and imaginary part have this covariance (2, 2)."""

    def root(variance: float) -> float:
        """A standard error; infinite where nothing is known."""
        return math.sqrt(max(variance, 0.0)) if math.isfinite(variance) else math.inf

    sd_real, sd_imaginary = (root(float(x)) for x in np.diag(covariance))
    s, w = eigenvalue.real, eigenvalue.imag

    def told(value: float, slope: tuple[float, float]) -> tuple[float, float]:
        along = np.array(slope)
        kept = along != 0.0  # infinite errors of what it does not depend on
        part = covariance[np.ix_(kept, kept)]
        return value, root(float(along[kept] @ part @ along[kept])) if np.all(np.isfinite(part)) else math.inf

    quantities = {}
    if w > 0.0:
        size = abs(eigenvalue)
        quantities["period"] = told(2.0 * math.pi / w, (0.0, -2.0 * math.pi / w**2))
        quantities["damping_ratio"] = told(-s / size, (-(w**2) / size**3, s * w / size**3))
    if abs(s) > KNOWN * sd_real and s != 0.0:
        if w == 0.0 and s < 0.0:
            quantities["time_constant"] = told(-1.0 / s, (1.0 / s**2, 0.0))
        side = "half" if s < 0.0 else "double"
        quantities[f"time_to_{side}"] = told(HALF / abs(s), (-math.copysign(HALF, s) / s**2, 0.0))
    return FlownMode(name, eigenvalue, (sd_real, sd_imaginary), quantities)


# --- Modes of motion of a fit to trajectories.


def motion_of(flown: TrajectoryFit, beside: ProcessNoise | None = None) -> Motion | None:
    """Modes with standard errors, of the estimates with process noise where that fit is `preferred`; None without a
    model of the aircraft, and where the fit did not converge."""
    if flown.of_path or not flown.converged:
        return None
    steady = steady_of(flown.fit.flown.flights)
    found, why_not = (), ""
    filtered = beside if beside is not None and beside.preferred else None
    try:
        found = flown_modes(flown.fit, steady, filtered)
    except InputError as reason:
        why_not = str(reason)
    linear = isinstance(unbiased(flown.fit.flown.dynamics), LinearDynamics)
    about = (math.nan, math.nan) if linear else (steady.airspeed, steady.altitude)
    return Motion(*about, found, why_not, filtered is not None)
