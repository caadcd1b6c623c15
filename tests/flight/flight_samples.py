"""A small sound record, the card's channels for it, and what is said of a bad one."""

from pathlib import Path

import numpy as np
import pytest

from bayes_aero.errors import InputError, plain_line
from bayes_aero.flight.channel import Channel
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.flight.record import FlightRecord

CHANNELS = (
    Channel("time", "s", "T", 1),
    Channel("alpha", "deg", "ALCG", 2),
    Channel("q", "deg/s", "QRGY", 3),
    Channel("airspeed", "kt", "VTAS", 4),
    Channel("density", "kg/m^3", "RHO", 5),
    Channel("static_pressure", "hPa", "PSTAT", 6, required=False),
    Channel("strain", "mm", "GAUGE_7", 7, required=False),
)


def sound(n: int = 120, **changed: np.ndarray) -> FlightRecord:
    """A plausible slow oscillation at 25 Hz, in SI, with the given channels put in place of its own."""
    t = np.arange(n) * 0.04
    channels = {
        "time": t,
        "alpha": 0.1 + 0.05 * np.sin(t),
        "q": 0.05 * np.cos(t),
        "airspeed": 90.0 + np.sin(0.3 * t),
        "density": 0.7 + 0.001 * t,
        "static_pressure": 5.1e4 + 10.0 * t,
        "strain": 1e-3 * t,
    } | changed
    return FlightRecord.from_arrays("sound", channels.pop("time"), channels)


def told(path: Path, channels, *words: str, **options: object) -> str:
    """The message that reading `path` ends in; it must begin with the file and contain all the words."""
    with pytest.raises(InputError) as caught:
        read_record(path, channels, **options)
    message = str(caught.value)
    assert message.startswith(f"{plain_line(str(path))}: ")
    assert "\n" not in message
    for word in words:
        assert word in message, f"{word!r} is not in {message!r}"
    return message
