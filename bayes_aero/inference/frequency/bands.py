"""Records fitted in a band: coefficients beside their fit in the time domain, and linear cards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_aero.dynamics.flight import Dynamics
from bayes_aero.dynamics.linear import LinearDynamics
from bayes_aero.dynamics.output_biases import unbiased
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.reading.common_rate import at_common_rate
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.frequency.fit import (
    OUTPUT_ERROR,
    beside_time_domain,
    fit_in_band,
    without_noise_bias_in_band,
)
from bayes_aero.inference.frequency.responses import frequency_responses
from bayes_aero.inference.frequency.result import FrequencyFit, FrequencyResponse
from bayes_aero.inference.likelihood.mle_result import MleResult
from bayes_aero.model.joined_channels import Flights, join
from bayes_aero.model.model import Model
from bayes_aero.physics.coefficient_names import required_of
from bayes_aero.residuals.frequency_error import (
    Band,
    FrequencyError,
    LinearFrequencyError,
)
from bayes_aero.residuals.frequency_output_error import LinearFrequencyOutputError


def coefficients_in_band(
    records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult, band: Band, *, seed: int = 0
) -> FrequencyFit:
    """Equation error of the coefficients in a band, beside their fit in the time domain.

    Args:
        records: one a manoeuvre, without spikes.
        card: of the records.
        model: the fitted model.
        mle: its fit in the time domain, from which this one starts.
        band: lowest and highest frequency, Hz.
        seed: of the noise that shows the bias by noise.

    Raises:
        InputError: the band is empty or holds no frequency of a record.
    """
    flights = join(at_common_rate(records), card, required_of(model.axes))
    responses = FrequencyError.in_band(flights, model, band)
    fit = without_noise_bias_in_band(
        fit_in_band(responses, model.free, mle.estimate, band), responses, model.free, seed=seed
    )
    return beside_time_domain(fit, mle)


def linear_in_band(
    flights: Flights, dynamics: Dynamics, band: Band
) -> tuple[tuple[FrequencyFit, FrequencyFit], tuple[FrequencyResponse, ...]]:
    """Equation error of a linear card in a band, output error from there, and responses.

    Raises:
        InputError: a state was not recorded, sampling times differ, or the band holds no frequency of a record.
    """
    dt = np.asarray(flights.channels["dt"], float)
    if np.ptp(dt) > 1e-6 * dt[0]:
        raise InputError("the manoeuvres have different sampling times; give --resample")
    bare = unbiased(dynamics)
    assert isinstance(bare, LinearDynamics)
    start = np.array([p.start for p in bare.free])
    first = fit_in_band(LinearFrequencyError.in_band(flights, bare, band), bare.free, start, band)
    found = dict(zip(first.names, first.estimate, strict=True))
    start = np.array([found.get(p.name, p.start) for p in bare.free])
    whole = LinearFrequencyOutputError.in_band(flights, bare, band)
    second = fit_in_band(whole, bare.free, start, band, OUTPUT_ERROR)
    responses = frequency_responses(flights, bare, second) if second.converged else ()
    return (first, second), responses
