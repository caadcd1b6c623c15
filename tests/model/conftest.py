"""A record that has every channel, for what asks which effects a record can show."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.observations import join


@pytest.fixture(scope="session")
def everything(card):
    """Flights in which no channel is at rest or mere noise."""
    rng, time = np.random.default_rng(0), np.arange(200) * 0.04
    names = [name for name in STANDARD_CHANNELS if name != "time"]
    waves = {name: np.sin(rng.uniform(1.0, 4.0) * time + rng.uniform(0.0, 6.0)) for name in names}
    around = {"airspeed": 80.0, "density": 1.0, "thrust": 9e3, "az": -9.8, "mach": 0.3, "altitude": 5e3}
    channels = {name: around[name] + 0.02 * x if name in around else 0.14 * x for name, x in waves.items()}
    return join([FlightRecord.from_arrays("run", time, channels)], replace(card, sums={}, constants={}))
