"""The fits that `fly` begins with: coefficients, first values from them, and output error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.trajectories.results import TrajectoryFit
from bayes_aero.diagnosis.trajectories.trajectory_fit import fit_trajectories
from bayes_aero.dynamics.flight import Dynamics
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.channel_units import channel_units
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.inference.likelihood.noise_bias import without_noise_bias
from bayes_aero.jobs.options import FlyOptions
from bayes_aero.jobs.steps.spike_repair import repaired
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.progress import Progress


def coefficient_fit(
    records: Sequence[FlightRecord], card: Card, seed: int, progress: Progress | None
) -> MleResult | None:
    """The fit of the coefficients, as `identify` does it, where they can be formed."""
    if card.linear is not None:
        return None
    if progress:
        progress("coefficients", 0.0)
    model, (without_spikes, _) = Model.from_card(card), repaired(records)
    try:
        found = fit_mle(model, observe(without_spikes, card, model), seed=seed)
        return without_noise_bias(found, without_spikes, card, model, seed=seed)
    except InputError:
        return None


def starts_of(found: MleResult | None, dynamics: Dynamics) -> list[Float[np.ndarray, " k"]]:
    """What the fit of the coefficients has found: a trajectory has optima far from the flight."""
    if found is None:
        return []
    near = dict(zip(found.names, found.estimate, strict=True))
    lower, upper = (np.array([p.bounds[i] for p in dynamics.free], float) for i in (0, 1))
    start = np.array([near.get(p.name, p.start) for p in dynamics.free])
    return [np.clip(start, lower, upper)] if np.all(np.isfinite(start)) else []


def output_error_fit(
    flights: Flights,
    dynamics: Dynamics,
    card: Card,
    starts: Sequence[Float[np.ndarray, " k"]],
    options: FlyOptions,
    progress: Progress | None,
) -> TrajectoryFit:
    """The card's model fitted to the trajectories, as the options say."""
    return fit_trajectories(
        flights,
        dynamics,
        {name: STANDARD_CHANNELS[name].unit for name in STANDARD_CHANNELS} | channel_units(card),
        starts=starts,
        window=options.windows,
        tolerances={name: tolerance.value for name, tolerance in card.tolerances.items()},
        biases={} if options.flight_path else card.output_biases,
        setting=options.setting(card),
        progress=progress,
    )
