"""A model flown through recorded inputs with parameters that come from elsewhere: nothing is fitted to the flight."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayes_aero.diagnosis.trajectories.results import Path
from bayes_aero.diagnosis.trajectories.time_histories import simulated
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model

GIVEN = "given"


def fly_given(
    flights: Flights, model: Model, values: Mapping[str, float], tolerances: Mapping[str, float]
) -> tuple[Path, ...]:
    """Every manoeuvre from its measured initial state, with `values` (SI) by parameter; others have their start."""
    dynamics = aircraft_dynamics(model, flights)
    theta = np.array([values.get(p.name, p.start) for p in dynamics.free])
    whole = segments(flights, dynamics, substeps=dynamics.substeps(theta, flights))
    still = np.zeros((len(whole.index), len(dynamics.states)))
    with np.errstate(over="ignore", invalid="ignore"):  # coefficients that fit may still fly anywhere
        return tuple(simulated(theta, whole, GIVEN, GIVEN, still, tolerances))
