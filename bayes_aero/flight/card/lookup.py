"""Tables on the card: a channel that a file lacks, such as thrust, read off over channels that it has, such as N1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_aero.errors import InputError
from bayes_aero.flight.card.toml_tables import known_keys, like
from bayes_aero.flight.channel import STANDARD_CHANNELS, Channel
from bayes_aero.units import from_si, instant, si_unit, to_si

MOST_AXES, MOST_VALUES = 3, 10_000
SLACK = 1e-9  # of the axis, for the rounding of a conversion
_EXAMPLE = 'e.g. from = { n1_left = { unit = "%", points = [30, 60, 100] } }'


@dataclass(frozen=True)
class TableAxis:
    """A channel that a table is entered with: its unit on the card, its points in SI, increasing."""

    channel: str
    unit: str
    si: str
    points: tuple[float, ...]

    def shown(self, *values: float) -> str:
        """Values in the unit of the card: "30 to 100 %"."""
        filed = (float(from_si(value, self.unit, self.channel, self.si)) for value in values)
        return f"{' to '.join(f'{x:.6g}' for x in filed)} {self.unit}".removesuffix(" 1")

    @property
    def range(self) -> str:
        """From where to where the table goes."""
        return self.shown(self.points[0], self.points[-1])


@dataclass(frozen=True)
class LookupTable:
    """A table: `values` in `si`, one dimension for each axis; linear between the points, refused beyond them."""

    channel: str
    si: str
    axes: tuple[TableAxis, ...]
    values: tuple[Any, ...]

    @property
    def said(self) -> str:
        """What it is entered with and how far it goes."""
        return ", ".join(f"{axis.channel} ({axis.range})" for axis in self.axes)

    def of(self, channels: Mapping[str, np.ndarray], record: str, time: np.ndarray) -> Float[np.ndarray, " n"] | None:
        """The channel, (n,) in SI; None where the record lacks what the table is entered with."""
        if any(axis.channel not in channels for axis in self.axes):
            return None
        entries = []
        for axis in self.axes:
            x, low, high = channels[axis.channel], axis.points[0], axis.points[-1]
            slack = SLACK * (high - low)
            outside = ~((x >= low - slack) & (x <= high + slack))
            if outside.any():
                i = int(np.argmax(outside))
                raise InputError(
                    f"record {record}: {axis.channel} is {axis.shown(x[i])} at sample {i} (counted from 0; t = "
                    f"{instant(time[i])} s), outside the card's table of {self.channel}, which goes from {axis.range}, "
                    f"{int(outside.sum())} of {len(x)} samples in all; extend [tables.{self.channel}], or cut the "
                    "record"
                )
            entries.append(np.clip(x, low, high))
        from scipy.interpolate import RegularGridInterpolator  # half a second, which most cards do not need

        table = RegularGridInterpolator([axis.points for axis in self.axes], np.array(self.values), method="linear")
        return table(np.stack(entries, axis=-1))


def parse_tables(
    tables: Mapping[str, Any], channels: tuple[Channel, ...], formed: Mapping[str, Any], where: str
) -> dict[str, LookupTable]:
    """[tables.NAME]; `formed` are channels that the card states otherwise, by [constants] or [derived]."""
    mapped = {channel.name: channel for channel in channels}
    found = {}
    for name, given in tables.items():
        here = f"card {where}: [tables.{name}]"
        if not isinstance(given, dict):
            raise InputError(f"{here} must be a table with unit, from and values")
        known_keys(given, ("unit", "from", "values"), where, f"key of [tables.{name}]")
        for key in ("unit", "from", "values"):
            if key not in given:
                raise InputError(f"{here} has no {key}; add it, {_EXAMPLE}")
        if name in formed or (name in mapped and mapped[name].required):
            raise InputError(f"{here}: the card states {name} elsewhere, too; keep one of them")
        if not (isinstance(given["from"], dict) and 1 <= len(given["from"]) <= MOST_AXES):
            raise InputError(f"{here} from must name one to {MOST_AXES} channels, {_EXAMPLE}")
        axes = tuple(
            _parse_axis(key, entry, mapped, formed, where, f"{here} from {key}") for key, entry in given["from"].items()
        )
        values = _numbers(given["values"], f"{here} values")
        shape = tuple(len(axis.points) for axis in axes)
        if values.shape != shape:
            wanted = " lists of ".join(str(n) for n in shape)
            per = "; ".join(f"{len(axis.points)} points of {axis.channel}" for axis in axes)
            raise InputError(f"{here} values must be {wanted} numbers ({per}), the first channel outermost")
        unit, standard = str(given["unit"]), STANDARD_CHANNELS.get(name)
        si = standard.unit if standard else si_unit(unit, here)
        found[name] = LookupTable(name, si, axes, _nested(to_si(values, unit, name, si)))
    return found


def _parse_axis(
    name: str, given: Any, mapped: Mapping[str, Channel], formed: Mapping[str, Any], where: str, here: str
) -> TableAxis:
    if isinstance(given, dict):
        known_keys(given, ("unit", "points"), where, f"key of from {name}")
    if not isinstance(given, dict) or "unit" not in given or "points" not in given:
        raise InputError(f"{here} must have unit and points, {_EXAMPLE}")
    if name not in mapped and name not in formed:
        raise InputError(f"{here}: [channels] does not map it{like(name, {*mapped, *formed})}")
    unit = str(given["unit"])
    si = mapped[name].si if name in mapped else STANDARD_CHANNELS[name].unit
    points = to_si(_numbers(given["points"], f"{here}: points"), unit, name, si)
    if points.ndim != 1 or len(points) < 2 or not (np.diff(points) > 0.0).all():
        raise InputError(f"{here}: points must be two numbers or more, and increase")
    return TableAxis(name, unit, si, tuple(float(x) for x in points))


def _numbers(given: Any, what: str) -> np.ndarray:
    """A list, or lists of lists, of finite numbers."""
    try:
        values = np.array(given, dtype=object)
        if values.size > MOST_VALUES or any(isinstance(x, bool) or not isinstance(x, int | float) for x in values.flat):
            raise ValueError
        numbers = values.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"{what} must be a list of plain numbers (rows of one length), {MOST_VALUES} at most"
        ) from None
    if not np.isfinite(numbers).all():
        raise InputError(f"{what} must be finite numbers")
    return numbers


def _nested(values: np.ndarray) -> tuple[Any, ...]:
    return tuple(_nested(row) if row.ndim else float(row) for row in values)
