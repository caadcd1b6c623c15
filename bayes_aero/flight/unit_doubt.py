"""Units that cannot be right though every number is plausible: knots that a card calls metres a second, for one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_aero.flight.channel import Channel
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import same_unit, to_si

NEEDED = ("airspeed", "altitude", "theta", "alpha")
UNITS = {"airspeed": ("m/s", "kt", "ft/s", "km/h", "mph"), "altitude": ("m", "ft")}
LEAST = 15.0  # m that the altitude must depart from a straight line: less tells nothing of its unit
ALIKE = 0.97  # correlation from which the two ways to have the altitude are the same but for a factor
APART = 1.15  # factor that no wind, vane or pressure error makes
NEAR = 0.08  # of a factor, to that of two units


def unit_doubts(records: Sequence[FlightRecord], channels: Sequence[Channel]) -> tuple[str, ...]:
    """A sentence for each record whose altitude changes by a wrong factor of what speed and flight path angle give.

    Along the flight path dh/dt = V sin(theta - alpha), the wings near level. Integrated and compared beside a constant
    and a drift (steady wind, a bias of an angle), so that nothing is differentiated.
    """
    declared = {c.name: c.unit for c in channels}
    said = []
    for record in records:
        k = climb_factor(record)
        if k is not None and max(k, 1.0 / k) > APART:
            known = [c for name in UNITS for c in _exchanged(name, declared[name], k)]
            why = f"as if {' or '.join(known)}" if known else "some unit of them is not what the card says"
            said.append(
                f"{record.name}: the altitude changes {k:.3g} times as much as airspeed, pitch and angle of attack "
                f"say, {why}; correct the unit on the card"
            )
    return tuple(said)


def climb_factor(record: FlightRecord) -> float | None:
    """Recorded change of altitude over that from airspeed and angles; None where the record does not tell."""
    if not all(record.has(name) for name in NEEDED):
        return None
    V, h, theta, alpha = (np.asarray(record[name]) for name in NEEDED)
    level = np.abs(np.asarray(record["phi"])) < 0.35 if record.has("phi") else np.ones(record.n, bool)
    if level.mean() < 0.9:
        return None
    climbed = np.concatenate([[0.0], np.cumsum(0.5 * record.dt * np.add(*_ends(V * np.sin(theta - alpha))))])
    line = np.stack([np.ones(record.n), record.time - record.time[0]], axis=1)
    measured, given = (x - line @ np.linalg.lstsq(line, x, rcond=None)[0] for x in (h, climbed))
    if min(np.ptp(measured), np.ptp(given)) < LEAST or np.corrcoef(measured, given)[0, 1] < ALIKE:
        return None
    return float(measured @ given / (given @ given))


def _ends(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return x[:-1], x[1:]


def _exchanged(name: str, declared: str, k: float) -> list[str]:
    """Units of a channel that would explain the factor."""
    found = []
    for unit in UNITS[name]:
        if same_unit(unit, declared):
            continue
        ratio = float(to_si(1.0, unit, name) / to_si(1.0, declared, name))
        factor = ratio if name == "airspeed" else 1.0 / ratio  # of the recorded climb over that of the speed
        if abs(np.log(k / factor)) < NEAR:
            found.append(f"{name}, {declared} on the card, were in {unit}")
    return found
