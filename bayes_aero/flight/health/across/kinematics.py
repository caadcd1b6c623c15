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

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.signals import channels_of
from bayes_aero.flight.record import FlightRecord
from bayes_aero.flight.tolerances import GRAVITY

View = Mapping[str, np.ndarray]
ZERO_IF_MISSING = ("phi", "beta", "p", "r", "ay")  # of symmetric flight


@dataclass(frozen=True)
class Relation:
    """How one channel must change: by the sum of `terms`, which read `needs`, which must be recorded, and
    `ZERO_IF_MISSING`. `allowed` is the misfit, SI, that sound records stay below after a constant and a drift are taken
    out; in pieces of `piece` s where errors of the rate add up too fast for the whole record."""

    channel: str
    needs: tuple[str, ...]
    terms: Callable[[View], tuple[np.ndarray, ...]]
    allowed: float
    piece: float | None = None

    def rate(self, view: View) -> np.ndarray:
        """Rate of change of the channel, (n,)."""
        return _sum(self.terms(view))


def view_of(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    """Channels, constants and time of a record, with zeros for what symmetric flight lacks."""
    known = channels_of(record, card)
    filled = {name: np.zeros(record.n) for name in ZERO_IF_MISSING if name not in known}
    return {**filled, **known, "time": record.time}


def _sum(terms: tuple[np.ndarray, ...]) -> np.ndarray:
    return np.sum(terms, axis=0)


def _theta(v: View) -> tuple[np.ndarray, ...]:
    return v["q"] * np.cos(v["phi"]), -v["r"] * np.sin(v["phi"])


def _turning(v: View) -> tuple[np.ndarray, ...]:
    return v["q"] * np.sin(v["phi"]), v["r"] * np.cos(v["phi"])


def _phi(v: View) -> tuple[np.ndarray, ...]:
    return v["p"], *(np.tan(v["theta"]) * turning for turning in _turning(v))


def _psi(v: View) -> tuple[np.ndarray, ...]:
    return tuple(turning / np.cos(v["theta"]) for turning in _turning(v))


def dead_heading(v: View) -> bool:
    """Whether the heading stands still while the rates turn the aircraft; `time`, phi, theta, q, r and psi are read."""
    turn = integrated(_sum(_psi(v)), v["time"])
    return bool(np.ptp(turn) > TURN and np.ptp(v["psi"]) < FOLLOWS * np.ptp(turn))


def _altitude(v: View) -> tuple[np.ndarray, ...]:
    a, b, theta, phi, V = v["alpha"], v["beta"], v["theta"], v["phi"], v["airspeed"]
    return (
        V * np.cos(a) * np.cos(b) * np.sin(theta),
        -V * np.sin(b) * np.sin(phi) * np.cos(theta),
        -V * np.sin(a) * np.cos(b) * np.cos(phi) * np.cos(theta),
    )


def _forces(v: View) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Specific force and gravity along each body axis, m/s2, each (n,)."""
    cos = np.cos(v["theta"])
    return (
        (v["ax"], -GRAVITY * np.sin(v["theta"])),
        (v["ay"], GRAVITY * cos * np.sin(v["phi"])),
        (v["az"], GRAVITY * cos * np.cos(v["phi"])),
    )


def _along(v: View, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, ...]:
    """Specific force and gravity along a direction with these components on the body axes."""
    return tuple(part * c for force, c in zip(_forces(v), (x, y, z), strict=True) for part in force)


def _airspeed(v: View) -> tuple[np.ndarray, ...]:
    a, b = v["alpha"], v["beta"]
    return _along(v, np.cos(a) * np.cos(b), np.sin(b), np.sin(a) * np.cos(b))


def _alpha(v: View) -> tuple[np.ndarray, ...]:
    a, b = v["alpha"], v["beta"]
    V = v["airspeed"] * np.cos(b)
    turned = (v["q"], -np.tan(b) * v["p"] * np.cos(a), -np.tan(b) * v["r"] * np.sin(a))
    return *turned, *_along(v, -np.sin(a) / V, 0.0 * a, np.cos(a) / V)


def _beta(v: View) -> tuple[np.ndarray, ...]:
    a, b, V = v["alpha"], v["beta"], v["airspeed"]
    across = _along(v, -np.cos(a) * np.sin(b) / V, np.cos(b) / V, -np.sin(a) * np.sin(b) / V)
    return v["p"] * np.sin(a), -v["r"] * np.cos(a), *across


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
MEANS = {"level": LEVEL, "side": SIDE}
_MEAN_NEEDS = {"level": RELATIONS["alpha"].needs, "side": ("ay", "r", "phi", *RELATIONS["airspeed"].needs)}
SCALE = 0.3
"""Error of scale that a sensor in the right unit may have; our choice."""


def misfits(view: View, recorded: frozenset[str], names: frozenset[str] | None = None) -> dict[str, float]:
    """How far each relation (or those of `names`) is from what is allowed: 1 is the limit. Relations that lack a
    channel are left out."""
    off = {name: terms.sum(0) for name, terms in terms_of(view, recorded, names).items()}
    return {name: _size(x) if np.isfinite(x).all() else np.inf for name, x in off.items()}


def terms_of(view: View, recorded: frozenset[str], names: frozenset[str] | None = None) -> dict[str, np.ndarray]:
    """What the terms (k, n) of each relation leave when they are added, over what is allowed."""
    found = {}
    with np.errstate(all="ignore"):
        for name, needs in {**{name: r.needs for name, r in RELATIONS.items()}, **_MEAN_NEEDS}.items():
            if set(needs) <= recorded and (names is None or name in names):
                terms = _mean_terms(name, view, recorded) if name in _MEAN_NEEDS else _changes(view, RELATIONS[name])
                found[name] = np.stack(terms)
    return found


def _size(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.minimum(np.abs(x), 1e9) ** 2)))


def _changes(view: View, relation: Relation) -> list[np.ndarray]:
    """A channel and the integral of each term of its rate, less, over what is allowed, without drift."""
    time = view["time"]
    each = [view[relation.channel], *(-integrated(term, time) for term in relation.terms(view))]
    pieces = 1 if relation.piece is None else round((time[-1] - time[0]) / relation.piece)
    pieces = min(max(pieces, 1), len(time) // SHORTEST)
    return [
        np.concatenate([_without_drift(part) for part in np.array_split(x, pieces)]) / relation.allowed for x in each
    ]


def _mean_terms(name: str, view: View, recorded: frozenset[str]) -> list[np.ndarray]:
    """Mean accelerations that rates, angles and accelerometers make, and what they turn by, over what is allowed."""
    V, channel = view["airspeed"], "alpha" if name == "level" else "beta"
    terms = [np.mean(V * term) for term in RELATIONS[channel].terms(view)]
    if channel in recorded:
        terms.append(-np.mean(V) * _turned(view, channel))
    elif np.mean(V) * SIDESLIP >= SIDE / 3.0 * float(view["time"][-1] - view["time"][0]):
        return [np.zeros(1)]
    return [np.atleast_1d(term) / MEANS[name] for term in terms]


def _turned(view: View, name: str) -> float:
    """Mean rate of change of a channel."""
    x, time = view[name], view["time"]
    return float(np.median(x[-9:]) - np.median(x[:9])) / float(time[-1] - time[0])


def side_bias(view: View, recorded: frozenset[str]) -> float:
    """Mean lateral acceleration beyond what bank, turn and sideslip make, m/s2; zero where sideslip leaves it open."""
    return SIDE * float(np.sum(_mean_terms("side", view, recorded), axis=0)[0])


def integrated(rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    """The integral of a (n,) rate over time, by the trapezium rule, zero at first."""
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (rate[:-1] + rate[1:]))])


def _without_drift(x: np.ndarray) -> np.ndarray:
    """Less its best straight line: an unknown initial value, and a bias of the rate or steady vertical wind."""
    t = np.linspace(-1.0, 1.0, len(x))
    return x - x.mean() - t * float(t @ x) / float(t @ t)
