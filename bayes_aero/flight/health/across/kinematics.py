"""Rigid-body kinematics between recorded channels: what each one's rate of change must be, without aerodynamics.

Body axes, specific force at the accelerometer (its distance from the centre of gravity is neglected), the wind steady:

    theta' = q cos phi - r sin phi            phi' = p + tan theta (q sin phi + r cos phi)
    psi'   = (q sin phi + r cos phi)/cos theta
    h'     = V (cos a cos b sin theta - sin b sin phi cos theta - sin a cos b cos phi cos theta)
    V'     = gx cos a cos b + gy sin b + gz sin a cos b
    alpha' = q - tan b (p cos a + r sin a) + (gz cos a - gx sin a)/(V cos b)
    beta'  = p sin a - r cos a + (gy cos b - (gx cos a + gz sin a) sin b)/V

with gx = ax - g sin theta, gy = ay + g cos theta sin phi, gz = az + g cos theta cos phi. Source: B. L. Stevens, F. L.
Lewis, E. N. Johnson, *Aircraft Control and Simulation*, 3rd ed., Wiley 2016, chapters 1 and 2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.signals import channels_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.flight.tolerances import GRAVITY

View = Mapping[str, np.ndarray]
ZERO_IF_MISSING = ("phi", "beta", "p", "r", "ay")  # of symmetric flight


@dataclass(frozen=True)
class Relation:
    """How one channel must change. `rate` reads `needs`, which must be recorded, and `ZERO_IF_MISSING`. `allowed`
    is the misfit, SI, that sound records stay below after a constant and a drift are taken out; in pieces of `piece` s
    where errors of the rate add up too fast for the whole record."""

    channel: str
    needs: tuple[str, ...]
    rate: Callable[[View], np.ndarray]
    allowed: float
    piece: float | None = None


def view_of(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    """Channels, constants and time of a record, with zeros for what symmetric flight lacks."""
    known = channels_of(record, card)
    filled = {name: np.zeros(record.n) for name in ZERO_IF_MISSING if name not in known}
    return {**filled, **known, "time": record.time}


def accelerations(v: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Specific force and gravity together along the body axes, m/s2, each (n,)."""
    cos = np.cos(v["theta"])
    return (
        v["ax"] - GRAVITY * np.sin(v["theta"]),
        v["ay"] + GRAVITY * cos * np.sin(v["phi"]),
        v["az"] + GRAVITY * cos * np.cos(v["phi"]),
    )


def _theta(v: View) -> np.ndarray:
    return v["q"] * np.cos(v["phi"]) - v["r"] * np.sin(v["phi"])


def _turning(v: View) -> np.ndarray:
    return v["q"] * np.sin(v["phi"]) + v["r"] * np.cos(v["phi"])


def _phi(v: View) -> np.ndarray:
    return v["p"] + np.tan(v["theta"]) * _turning(v)


def _psi(v: View) -> np.ndarray:
    return _turning(v) / np.cos(v["theta"])


def dead_heading(v: View) -> bool:
    """Whether the heading stands still while the rates turn the aircraft; `time`, phi, theta, q, r and psi are read."""
    turn = integrated(_psi(v), v["time"])
    return bool(np.ptp(turn) > TURN and np.ptp(v["psi"]) < FOLLOWS * np.ptp(turn))


def _altitude(v: View) -> np.ndarray:
    a, b, theta, phi = v["alpha"], v["beta"], v["theta"], v["phi"]
    ahead = np.cos(a) * np.cos(b) * np.sin(theta)
    return v["airspeed"] * (ahead - (np.sin(b) * np.sin(phi) + np.sin(a) * np.cos(b) * np.cos(phi)) * np.cos(theta))


def _airspeed(v: View) -> np.ndarray:
    gx, gy, gz = accelerations(v)
    a, b = v["alpha"], v["beta"]
    return gx * np.cos(a) * np.cos(b) + gy * np.sin(b) + gz * np.sin(a) * np.cos(b)


def _alpha(v: View) -> np.ndarray:
    gx, _, gz = accelerations(v)
    a, b = v["alpha"], v["beta"]
    across = (gz * np.cos(a) - gx * np.sin(a)) / (v["airspeed"] * np.cos(b))
    return v["q"] - np.tan(b) * (v["p"] * np.cos(a) + v["r"] * np.sin(a)) + across


def _beta(v: View) -> np.ndarray:
    gx, gy, gz = accelerations(v)
    a, b = v["alpha"], v["beta"]
    across = gy * np.cos(b) - (gx * np.cos(a) + gz * np.sin(a)) * np.sin(b)
    return v["p"] * np.sin(a) - v["r"] * np.cos(a) + across / v["airspeed"]


_AIR = ("airspeed", "alpha", "theta", "ax", "az")
RELATIONS: dict[str, Relation] = {
    r.channel: r
    for r in (
        Relation("theta", ("theta", "q"), _theta, np.deg2rad(1.0)),
        Relation("phi", ("phi", "p", "q", "theta"), _phi, np.deg2rad(2.0)),
        Relation("psi", ("psi", "q", "r", "theta"), _psi, np.deg2rad(3.0)),
        Relation("altitude", ("altitude", "airspeed", "theta", "alpha"), _altitude, 6.0),
        Relation("airspeed", _AIR, _airspeed, 2.0),
        Relation("alpha", (*_AIR, "q"), _alpha, np.deg2rad(1.0), 10.0),
        Relation("beta", ("beta", "r", "ay", "phi", *_AIR), _beta, np.deg2rad(1.5), 10.0),
    )
}
SHORTEST = 25  # samples of a piece
TURN, FOLLOWS = np.deg2rad(3.0), 0.2
"""rad that the rates must turn the aircraft by, and the share of it within which a heading stands still."""
LEVEL = 1.5
"""m/s2 that the mean normal acceleration may be off: a bias of .5 deg/s at 100 m/s and one of .6 m/s2."""
SIDE = 0.9
"""The same of the mean lateral acceleration: .3 deg/s at 100 m/s and .4 m/s2, or 2.5 deg of the bank angle."""
SIDESLIP = 0.1  # rad that sideslip may have changed by where it was not recorded
_SIDE_NEEDS = ("ay", "r", "phi", *RELATIONS["airspeed"].needs)


def misfits(view: View, recorded: frozenset[str], names: frozenset[str] | None = None) -> dict[str, float]:
    """How far each relation (or those of `names`) is from what is allowed: 1 is the limit. Relations that lack a
    channel are left out."""
    measures: dict[str, tuple[tuple[str, ...], Callable[[View], float]]] = {
        name: (r.needs, partial(_misfit, relation=r)) for name, r in RELATIONS.items()
    }
    measures["level"] = (RELATIONS["alpha"].needs, _level)
    measures["side"] = (_SIDE_NEEDS, lambda v: abs(side_bias(v, recorded)) / SIDE)
    found = {}
    with np.errstate(all="ignore"):
        for name, (needs, measure) in measures.items():
            if set(needs) <= recorded and (names is None or name in names):
                value = measure(view)
                found[name] = value if np.isfinite(value) else np.inf
    return found


def _misfit(view: View, relation: Relation) -> float:
    time, measured = view["time"], view[relation.channel]
    off = measured - integrated(relation.rate(view), time)
    pieces = 1 if relation.piece is None else round((time[-1] - time[0]) / relation.piece)
    pieces = min(max(pieces, 1), len(off) // SHORTEST)
    left = np.concatenate([_without_drift(part) for part in np.array_split(off, pieces)])
    return float(np.sqrt(np.mean(np.minimum(np.abs(left), 1e9) ** 2))) / relation.allowed


def _level(view: View) -> float:
    """Mean normal acceleration that rate, angle and accelerometer disagree by, over what is allowed."""
    return abs(float(np.mean(view["airspeed"] * (_alpha(view) - _turned(view, "alpha"))))) / LEVEL


def _turned(view: View, name: str) -> float:
    """Mean rate of change of a channel."""
    x, time = view[name], view["time"]
    return float(np.median(x[-9:]) - np.median(x[:9])) / float(time[-1] - time[0])


def side_bias(view: View, recorded: frozenset[str]) -> float:
    """Mean lateral acceleration beyond what bank, turn and sideslip make, m/s2; zero where sideslip leaves it open."""
    V, elapsed = view["airspeed"], float(view["time"][-1] - view["time"][0])
    if "beta" in recorded:
        return float(np.mean(V * (_beta(view) - _turned(view, "beta"))))
    return float(np.mean(V * _beta(view))) if np.mean(V) * SIDESLIP < SIDE / 3.0 * elapsed else 0.0


def integrated(rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    """The integral of a (n,) rate over time, by the trapezium rule, zero at first."""
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (rate[:-1] + rate[1:]))])


def _without_drift(x: np.ndarray) -> np.ndarray:
    """Less its best straight line: an unknown initial value, and a bias of the rate or steady vertical wind."""
    t = np.linspace(-1.0, 1.0, len(x))
    return x - x.mean() - t * float(t @ x) / float(t @ t)
