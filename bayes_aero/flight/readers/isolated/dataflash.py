"""ArduPilot DataFlash logs, read by pymavlink: a column is a field of a message, as in "ATT.Roll"."""

from __future__ import annotations

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.isolated.extras import require
from bayes_aero.flight.readers.isolated.process import parsed_apart
from bayes_aero.flight.readers.rates import SeveralRates, several_rates

__all__ = ["open_dataflash"]


def open_dataflash(data: bytes) -> SeveralRates:
    """A binary DataFlash log. Instances go by their number, "IMU[1].GyrX", and an only one also by "IMU.GyrX".

    Source: ArduPilot, AP_Logger: FMT, FMTU, UNIT and MULT messages describe all others.
    """
    require(".bin", "pymavlink")
    if b"\xa3\x95" not in data[:600]:
        raise InputError("it is not an ArduPilot DataFlash log (no message begins near its start); is it misnamed?")
    groups, remarks = parsed_apart(data, "dataflash_child.py", "DataFlash log")
    return several_rates("field", groups, remarks, 1e-6)


READS = {".bin": open_dataflash}
