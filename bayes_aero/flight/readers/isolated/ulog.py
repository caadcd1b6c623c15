"""PX4 ULog, read by pyulog: a column is a field of a topic, as in "vehicle_attitude.q[0]"."""

from __future__ import annotations

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.isolated.extras import require
from bayes_aero.flight.readers.isolated.process import parsed_apart
from bayes_aero.flight.readers.rates import SeveralRates, several_rates

__all__ = ["open_ulog"]


def open_ulog(data: bytes) -> SeveralRates:
    """A ULog file. A second instance of a topic goes by its number: "sensor_accel.1.x".

    Source: PX4 ULog file format, version 1.
    """
    require(".ulg", "pyulog")
    if not data.startswith(b"ULog\x01\x12\x35"):
        raise InputError("it is not a PX4 ULog file (its first bytes differ); is it misnamed?")
    groups, remarks = parsed_apart(data, "ulog_child.py", "ULog file")
    return several_rates("field", groups, remarks, 1e-6)


READS = {".ulg": open_ulog}
