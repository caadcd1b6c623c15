"""Modes of motion of a fit to trajectories."""

from __future__ import annotations

import math

from bayes_aero.diagnosis.trajectories.motion.flown_modes import flown_modes, steady_of
from bayes_aero.diagnosis.trajectories.motion.results import Motion
from bayes_aero.diagnosis.trajectories.results import ProcessNoise, TrajectoryFit
from bayes_aero.dynamics.linear import LinearDynamics
from bayes_aero.dynamics.output_biases import unbiased
from bayes_aero.errors import InputError


def motion_of(flown: TrajectoryFit, beside: ProcessNoise | None = None) -> Motion | None:
    """Modes with standard errors, of the estimates with process noise where that fit is `preferred`.

    None without a model of the aircraft, and where the fit did not converge.
    """
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
