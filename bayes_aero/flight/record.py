"""A flight record: one manoeuvre, named channels of equal length, in SI."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.atmosphere import GRAVITY
from bayes_aero.units import instant


def _frozen(values: Any, label: str, n: int | None = None) -> np.ndarray:
    """A private, read-only float64 vector; `n` is the length it must have."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as reason:
        raise InputError(f"{label} is not numeric ({reason}); give a vector of numbers") from reason
    if array.ndim != 1:
        raise InputError(f"{label} has shape {array.shape}; give a vector, one value a sample")
    if n is not None and array.size != n:
        raise InputError(f"{label} has {array.size} samples where time has {n}; all channels need the same length")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class FlightRecord:
    """One manoeuvre. Immutable: the arrays are read-only copies.

    Attributes:
        name: short name, the stem of the file.
        time: (n,) time in s, as in the file.
        channels: channel name -> (n,) values in SI and radians; time is not among them.
        source: where the record came from, for provenance.
        sha256: SHA-256 of the file's bytes; of the arrays' bytes for a record made in memory.
        dropped: channel -> reason why it was omitted when the file was read.
        remarks: how the file was read if there are several ways, one sentence each.
        read: how the file is read to this record: its path, `part` (as behind FILE@), `resample` (s), `windows` cut out
            after that (s), and whether gaps `split` it. Empty for a record made in memory.
    """

    name: str
    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    source: str
    sha256: str
    dropped: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    read: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        time = _frozen(self.time, f"record {self.name}: channel time")
        frozen = {
            key: _frozen(values, f"record {self.name}: channel {key}", time.size)
            for key, values in self.channels.items()
            if key != "time"
        }
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "channels", MappingProxyType(frozen))

    @classmethod
    def from_arrays(
        cls, name: str, time: Any, channels: Mapping[str, Any], source: str = "arrays in memory"
    ) -> FlightRecord:
        """A record of arrays.

        Args:
            name: short name.
            time: (n,) in s.
            channels: channel name -> (n,) values in SI and radians; not checked for plausibility
                (`checks.check_record` does this).
            source: origin of the record.

        Raises:
            InputError: an array is not numeric or has another length.
        """
        record = cls(name, time, channels, source, "")
        return replace(record, sha256=record.content)

    @cached_property
    def content(self) -> str:
        """SHA-256 of the samples: the same for the same channels, whatever file they come from."""
        digest = hashlib.sha256(self.time.tobytes())
        for key in sorted(self.channels):
            digest.update(key.encode() + b"\0" + self.channels[key].tobytes())
        return digest.hexdigest()

    @property
    def n(self) -> int:
        """Number of samples."""
        return int(self.time.size)

    def __len__(self) -> int:
        return self.n

    @cached_property
    def dt(self) -> float:
        """Sampling interval in s: the mean step (checks ensure that all steps agree)."""
        if self.n < 2:
            raise InputError(f"record {self.name} has {self.n} samples; two are needed for a sampling interval")
        return float((self.time[-1] - self.time[0]) / (self.n - 1))

    @property
    def names(self) -> tuple[str, ...]:
        """All channels, time first."""
        return ("time", *self.channels)

    def has(self, name: str) -> bool:
        """Whether the channel is in the record."""
        return name == "time" or name in self.channels

    def __getitem__(self, channel: str) -> np.ndarray:
        if channel == "time":
            return self.time
        if channel in self.channels:
            return self.channels[channel]
        close = get_close_matches(channel, self.channels, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        mapped = ", ".join(self.names)
        raise InputError(
            f"record {self.name} has no channel {channel}{hint}; the card maps these: {mapped}; add it to [channels]"
        )

    def window(self, t0: float, t1: float) -> FlightRecord:
        """The samples with t0 <= time <= t1 (s), as a new record with the same source.

        Raises:
            InputError: there is no sample in this interval.
        """
        slack = 1e-6 * self.dt  # 0.04 * 25 is not 1 in binary
        keep = (self.time >= t0 - slack) & (self.time <= t1 + slack)
        if not keep.any():
            raise InputError(
                f"record {self.name} has no sample between {instant(t0)} and {instant(t1)} s; "
                f"it runs from {instant(self.time[0])} to {instant(self.time[-1])} s"
            )
        return FlightRecord(
            name=f"{self.name}_{instant(t0)}-{instant(t1)}s",
            time=self.time[keep],
            channels={key: values[keep] for key, values in self.channels.items()},
            source=f"{self.source}, {instant(t0)} s to {instant(t1)} s",
            sha256=self.sha256,
            dropped=self.dropped,
            remarks=self.remarks,
            read={**self.read, "windows": [*self.read["windows"], [float(t0), float(t1)]]} if self.read else {},
        )

    def __reduce__(self) -> tuple[Any, ...]:
        # A mapping proxy cannot be pickled, and records are sent to worker processes.
        told = self.source, self.sha256, dict(self.dropped), self.remarks, dict(self.read)
        return FlightRecord, (self.name, self.time, dict(self.channels), *told)


# --- How far a simulation may be from flight: bands by output, each with its source. A card may replace them.

KNOT = 0.514444
_STALL = "14 CFR Part 60 Appendix A, Table A2A, 2.c.8"
_SHORT = "14 CFR Part 60 Appendix A, Table A2A, 2.c.10"
_LATERAL = "14 CFR Part 60 Appendix A, Table A2A, 2.d"
_READ = "read in the edition of 2014, volume 2, page 57"
_UNCHECKED = "not checked against the text"


@dataclass(frozen=True)
class Tolerance:
    """Half the width of a band in SI, and where it comes from."""

    value: float
    source: str


TOLERANCES = {
    "airspeed": Tolerance(3.0 * KNOT, f"{_STALL}, +-3 kt; read in the 2014 edition's 2.c.8 of Appendix B"),
    "alpha": Tolerance(math.radians(2.0), f"{_STALL}, +-2 deg; {_UNCHECKED}"),
    "theta": Tolerance(math.radians(2.0), f"{_STALL}, +-2 deg; {_UNCHECKED}"),
    "q": Tolerance(math.radians(2.0), f"{_SHORT}, +-2 deg/s; {_READ}"),
    "az": Tolerance(0.1 * GRAVITY, f"{_SHORT}, +-0.10 g; {_READ}"),
    "p": Tolerance(math.radians(2.0), f"{_LATERAL}.2 (roll response), +-2 deg/s; {_READ}"),
    "r": Tolerance(math.radians(2.0), f"{_LATERAL}.6 (rudder response), +-2 deg/s; {_READ[:-2]}58"),
    "phi": Tolerance(math.radians(2.0), f"{_LATERAL}.4 (spiral stability), +-2 deg; {_READ[:-2]}58"),
    "beta": Tolerance(math.radians(1.0), f"{_LATERAL}.8 (steady sideslip), +-1 deg; {_READ[:-2]}59"),
}
"""Of the objective tests of a flight simulator's qualification; used as bands on the whole time history."""
