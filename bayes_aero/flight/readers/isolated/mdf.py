"""ASAM MDF version 4, read by asammdf: a column is a signal of a channel group."""

from __future__ import annotations

from bayes_aero.errors import InputError
from bayes_aero.flight.readers.isolated.extras import require
from bayes_aero.flight.readers.isolated.process import parsed_apart
from bayes_aero.flight.readers.rates import SeveralRates, several_rates

__all__ = ["open_mdf"]


def open_mdf(data: bytes) -> SeveralRates:
    """An MDF file. A signal goes by "group/name" and, where no other group has one of its name, by its name alone.

    Source: ASAM MDF 4.1, section 4: one channel group has one master channel.
    """
    require(".mf4", "asammdf")
    if data[:8] not in (b"MDF     ", b"UnFinMF "):
        raise InputError("it is not an MDF file (its first bytes differ); is it misnamed?")
    if not data[8:16].startswith(b"4."):
        said = data[8:16].decode("latin-1").strip("\0 ")
        raise InputError(f"it is an MDF file of version {said!r}; convert it to version 4, and save it as .mf4")
    groups, remarks = parsed_apart(data, "mdf_child.py", "MDF file")
    return several_rates("signal", groups, remarks, 1e-9)


READS = {".mf4": open_mdf}
