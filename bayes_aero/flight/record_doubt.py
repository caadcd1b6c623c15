"""Units and signs that cannot be right though every number is plausible: knots called metres a second, for one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bayes_aero.flight.channel import Channel
from bayes_aero.flight.record import FlightRecord
from bayes_aero.units import same_unit, to_si

NEEDED = ("airspeed", "altitude", "theta", "alpha")
UNITS = {"airspeed": ("m/s", "kt", "ft/s", "km/h", "mph"), "altitude": ("m", "ft")}
LEAST = 15.0  # m that the altitude must depart from a straight line: less tells nothing of its unit
ALIKE = 0.97  # correlation from which the two ways to have the altitude are the same but for a factor
APART = 1.15  # factor that no wind, vane or pressure error makes
SWUNG = np.deg2rad(1.0)  # rad that the pitch attitude must depart from a straight line
FAR = 3.0  # factor of a pitch rate that no scale error makes
GRAVITY = float(to_si(1.0, "g", "az"))  # m/s2
LIFTED, HEAVY = 0.3, 3.0  # g that the median of az lies between, whatever is flown
NEAR = 0.08  # of a factor, to that of two units


def record_doubts(records: Sequence[FlightRecord], channels: Sequence[Channel]) -> tuple[str, ...]:
    """A sentence for each unit or sign of each record that the record's other channels refute."""
    declared = {c.name: c for c in channels}
    said = []
    for record in records:
        found = (_upside_down(record, declared), _pitching(record, declared), _climbing(record, declared))
        said += [f"{record.name}: {doubt}" for doubt in found if doubt]
    return tuple(said)


def _upside_down(record: FlightRecord, declared: Mapping[str, Channel]) -> str:
    """An az that has not about -g where an aeroplane flies, for z points down and the accelerometer feels the lift."""
    if not record.has("az"):
        return ""
    middle = float(np.median(record["az"])) / GRAVITY
    if middle > LIFTED:
        mend = f"write sign = {-declared['az'].sign} at az on the card"
        return f"az is {middle:+.2g} g in the median, and level flight has -1 g; {mend}"
    if not -HEAVY < middle < -LIFTED:
        return f"az is {middle:+.2g} g in the median, and level flight has -1 g; correct its unit on the card"
    return ""


def _pitching(record: FlightRecord, declared: Mapping[str, Channel]) -> str:
    """A pitch rate whose integral is not the pitch attitude: dtheta/dt = q cos(phi) - r sin(phi)."""
    if not (record.has("q") and record.has("theta")):
        return ""
    phi, r = (np.asarray(record[n]) if record.has(n) else np.zeros(record.n) for n in ("phi", "r"))
    k = _factor(record, "theta", np.asarray(record["q"]) * np.cos(phi) - r * np.sin(phi), SWUNG)
    if k is None or 1.0 / FAR < k < FAR:
        return ""
    if k < 0.0:
        return "pitch attitude falls where the pitch rate is positive; turn the sign of the one that counts nose down"
    return (
        f"pitch attitude changes {k:.3g} times as much as the pitch rate says ({declared['q'].unit} on the card); "
        "correct its unit on the card"
    )


def _climbing(record: FlightRecord, declared: Mapping[str, Channel]) -> str:
    k = climb_factor(record)
    if k is None or max(k, 1.0 / k) < APART:
        return ""
    known = [c for name in UNITS for c in _exchanged(name, declared[name].unit, k)]
    why = f"as if {' or '.join(known)}" if known else "some unit of them is not what the card says"
    return (
        f"the altitude changes {k:.3g} times as much as airspeed, pitch and angle of attack say, {why}; "
        "correct the unit on the card"
    )


def climb_factor(record: FlightRecord) -> float | None:
    """Recorded change of altitude over that from airspeed and angles; None where the record does not tell.

    Along the flight path dh/dt = V sin(theta - alpha), the wings near level.
    """
    if not all(record.has(name) for name in NEEDED):
        return None
    level = np.abs(np.asarray(record["phi"])) < 0.35 if record.has("phi") else np.ones(record.n, bool)
    if level.mean() < 0.9:
        return None
    V, theta, alpha = (np.asarray(record[name]) for name in ("airspeed", "theta", "alpha"))
    k = _factor(record, "altitude", V * np.sin(theta - alpha), LEAST)
    return k if k is not None and k > 0.0 else None


def _factor(record: FlightRecord, name: str, rate: np.ndarray, least: float) -> float | None:
    """Recorded change of a channel over the integral of its (n,) `rate`; None where it moves less than `least`.

    Compared beside a constant and a drift (steady wind, a bias of an angle), so that nothing is differentiated.
    """
    given = np.concatenate([[0.0], np.cumsum(0.5 * record.dt * (rate[:-1] + rate[1:]))])
    line = np.stack([np.ones(record.n), record.time - record.time[0]], axis=1)
    measured, given = (x - line @ np.linalg.lstsq(line, x, rcond=None)[0] for x in (np.asarray(record[name]), given))
    if np.ptp(measured) < least or np.ptp(given) == 0.0 or abs(np.corrcoef(measured, given)[0, 1]) < ALIKE:
        return None
    return float(measured @ given / (given @ given))


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
