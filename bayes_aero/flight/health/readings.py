"""Other ways to read a channel - sign, unit, gravity, kind of airspeed - that the kinematics are tried with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from bayes_aero.flight.card import Card
from bayes_aero.flight.health.finding import channels_of, declared, other_units
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import GRAVITY

_ANGLE, _RATE, _FORCE = ("deg", "rad"), ("deg/s", "rad/s"), ("m/s^2", "g", "ft/s^2")
UNITS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("phi", "theta", "psi", "alpha", "beta"), _ANGLE), **dict.fromkeys(("p", "q", "r"), _RATE),
    **dict.fromkeys(("ax", "ay", "az"), _FORCE), "airspeed": ("m/s", "kt", "km/h", "ft/s", "mph"),
    "altitude": ("m", "ft"), "time": ("s", "ms", "us", "ns", "min"),
}  # fmt: skip
GROUPS = (("p", "q", "r"), ("ax", "ay", "az"), ("phi", "theta", "psi"), ("alpha", "beta"))
"""Channels of one instrument, which share their unit."""
SIGNS = ("p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "ax", "ay", "az", "altitude")
ONE_G = 0.5  # logarithm of the median load factor within which accelerations are in their unit: 0.6 to 1.65
DENSITY0 = 1.225  # kg/m3
AGREES = 0.0513  # logarithm of 5 %: two standard deviations of an airspeed, 2 %, and of its reference, 1.5 %; assumed
THIN = 0.93  # calibrated over true airspeed from which the two can be told apart


@dataclass(frozen=True)
class Reading:
    """Channels read in another way: the kind of fault, what it looks like, how to mend it."""

    channels: tuple[str, ...]
    fault: str
    looks: str
    mend: str
    applied: Callable[[View], dict[str, np.ndarray]]
    subject: str = ""  # who it is said of, if not of all the channels
    factor: float = 1.0  # of a unit or a kind of airspeed, by which the channels are multiplied

    @property
    def names(self) -> str:
        """Of whom it is said."""
        return self.subject or ", ".join(self.channels)


AXES = (("forward", "aft"), ("right", "left"), ("down", "up"))
INSTRUMENTS = {"accelerations": ("ax", "ay", "az"), "rates": ("p", "q", "r")}
ATTITUDE, FLOW = ("phi", "theta", "psi"), ("alpha", "beta")
ANGLES = tuple(
    frozenset((*attitude, *flow))
    for flow in ((), FLOW)
    for attitude in ((), ("theta",), ("theta", "psi"), ("psi",), ("phi", "psi"))
)
"""Angles that count the other way where the axes do: pitch attitude about an axis to the left, a heading about one that
points up, which a compass does not turn with."""
EVIDENT = 4  # channels that count the other way together, from which axes are likelier than as many wrong signs
ALL = 3  # such channels, where the sensors recorded no more: a longitudinal record's ax, az and q
Moves = Mapping[str, tuple[str, int]]
"""The channel and sign that each is to be read from, of those for which that is not itself."""


@dataclass(frozen=True)
class Frame:
    """Axes of a file: the program's axis i is `signs[i]` times the file's axis `order[i]`."""

    order: tuple[int, ...]
    signs: tuple[int, ...]

    @property
    def name(self) -> str:
        """Where the file's axes point: "x forward, y left, z up"."""
        points = {j: AXES[i][sign < 0] for i, (j, sign) in enumerate(zip(self.order, self.signs, strict=True))}
        return ", ".join(f"{axis} {points[j]}" for j, axis in enumerate("xyz"))

    def moves(self, names: tuple[str, ...], recorded: frozenset[str]) -> Moves:
        """How an instrument's channels are to be read."""
        pairs = zip(names, self.order, self.signs, strict=True)
        return {n: (names[j], sign) for n, j, sign in pairs if n in recorded and (names[j], sign) != (n, 1)}


FRAMES = tuple(
    Frame(order, signs)
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
    if np.linalg.det(np.eye(3)[list(order)]) * np.prod(signs) > 0.0
)
"""All right-handed axes."""


def orders(kind: str, recorded: frozenset[str]) -> Iterator[dict[str, str]]:
    """All ways to take the channels of an instrument for each other: where each is to be read."""
    names = INSTRUMENTS[kind]
    for order in permutations(names) if set(names) <= recorded else [names]:
        yield {name: source for name, source in zip(names, order, strict=True) if name in recorded}


def axes_of(moves: Moves, recorded: frozenset[str]) -> tuple[str, int]:
    """The axes of both instruments or one that explain most of the moves, in words, and how many channels are to be
    read otherwise than these axes say."""
    have = {kind: tuple(n for n in names if n in recorded) for kind, names in INSTRUMENTS.items()}
    kinds = tuple(kind for kind, names in have.items() if names)
    angles = {n for n in moves if n in (*ATTITUDE, *FLOW)}
    more = min(len(angles ^ (turned & recorded)) for turned in ANGLES)
    best = ("", len(moves) + 1)
    for of in dict.fromkeys([kinds, *((kind,) for kind in kinds)]):
        for frame in FRAMES:
            own = {n: move for kind in of for n, move in frame.moves(INSTRUMENTS[kind], recorded).items()}
            rest = more + sum(own.get(n) != moves.get(n) for kind in kinds for n in have[kind])
            if own and rest < best[1]:
                best = (f"the axes of the {' '.join(of) if len(of) == 1 else 'sensors'} are {frame.name}", rest)
    return best


def moved(card: Card, recorded: frozenset[str], moves: Moves) -> Reading:
    """The record with channels taken for each other, or counting the other way. Axes are named where they say what as
    many wrong signs could not, or only with more of them."""
    turned = ", ".join(name for name, (source, _) in moves.items() if source == name)
    exchanged = ", ".join(f"{name} is {source}" for name, (source, _) in moves.items() if source != name)
    axes, rest = axes_of(moves, recorded)
    axes = "" if rest else axes
    sensors = len(recorded & {n for names in INSTRUMENTS.values() for n in names})
    evident = bool(axes) and (bool(exchanged) or len(moves) >= (ALL if sensors <= ALL else EVIDENT))
    signs: dict[int, list[str]] = {}
    for name, (source, sign) in moves.items():
        signs.setdefault(sign * declared(card, source).sign, []).append(name)
    write = " and ".join(f"sign = {sign} at {', '.join(names)}" for sign, names in signs.items())
    place = "give each the label, column and unit of the other, and " if exchanged else ""
    count = f"count{'s' if len(moves) == 1 else ''} the other way"
    fault = "axes" if evident else "exchanged" if exchanged else "sign"
    if evident:
        turned = turned and f"{turned} {count}"
        subject, looks = axes, f"({'; '.join(x for x in (turned, exchanged and f'{exchanged} of the card') if x)})"
    else:
        subject = ", ".join(moves)
        looks = "are exchanged" if exchanged else count
        looks += f" (as where {axes})" if axes else ""
        looks += f" ({exchanged} of the card{f'; {turned} {count}' if turned else ''})" if exchanged else ""
    return Reading(
        tuple(moves), fault, looks, f"{place}write {write} on the card",
        lambda view: {name: sign * view[source] for name, (source, sign) in moves.items()}, subject,
    )  # fmt: skip


def readings(view: View, card: Card, recorded: frozenset[str]) -> Iterator[Reading]:
    """All other ways to read what was recorded."""
    for name in SIGNS:
        if name in recorded:
            sign = -declared(card, name).sign
            yield scaled((name,), -1.0, "sign", "counts the other way", f"write sign = {sign} at {name} on the card")
    for group in [(name,) for name in UNITS] + [tuple(n for n in group if n in recorded) for group in GROUPS]:
        if group and set(group) <= recorded:
            yield from _units(group, card, view)
    if "theta" in recorded:
        yield from _gravity(card, recorded)
    ratio = thinness(view, recorded)
    if "airspeed" in recorded and ratio is not None and float(np.median(ratio)) < THIN:
        times = float(1.0 / np.median(ratio))
        looks = f"is calibrated (or indicated) airspeed: true airspeed is {times:.3g} times as large at this density"
        mend = "divide it by the square root of density over 1.225 kg/m^3 in the file, or map the true airspeed"
        calibrated = Reading(("airspeed",), "airspeed_kind", looks, mend, lambda v: {"airspeed": v["airspeed"] / ratio})
        yield replace(calibrated, factor=times)


def scaled(names: tuple[str, ...], factor: float, fault: str, looks: str, mend: str) -> Reading:
    """Channels multiplied by a factor."""
    return Reading(names, fault, looks, mend, lambda view: {name: factor * view[name] for name in names})


def _units(group: tuple[str, ...], card: Card, view: View) -> Iterator[Reading]:
    of = {name: declared(card, name).unit for name in group}
    if len(set(of.values())) > 1:
        return
    if "az" in group and abs(np.log(max(float(np.median(np.abs(view["az"]))), 1e-9) / GRAVITY)) < ONE_G:
        return  # the unit explains the load factor of flight, and no other one does
    for unit, factor in other_units(card, group[0], UNITS[group[0]]):
        if abs(np.log(factor)) < 0.1:
            continue
        are = "is" if len(group) == 1 else "are"
        looks = f"{are} in {unit} and not in {of[group[0]]}, as the card says"
        mend = f'set unit = "{unit}" for {"it" if len(group) == 1 else "them"} on the card'
        yield replace(scaled(group, factor, "unit", looks, mend), factor=factor)


def _gravity(card: Card, recorded: frozenset[str]) -> Iterator[Reading]:
    """Accelerations that inertial units give out: without gravity, one, some or all; the load factor less one."""
    have = tuple(n for n in ("ax", "ay", "az") if n in recorded)
    back = {
        "ax": ("ax + g sin(theta)", lambda v: GRAVITY * np.sin(v["theta"])),
        "ay": ("ay - g cos(theta) sin(phi)", lambda v: -GRAVITY * np.cos(v["theta"]) * np.sin(v["phi"])),
        "az": ("az - g cos(theta) cos(phi)", lambda v: -GRAVITY * np.cos(v["theta"]) * np.cos(v["phi"])),
    }

    def put_back(names: tuple[str, ...], factor: float) -> Callable[[View], dict[str, np.ndarray]]:
        return lambda v: {n: factor * v[n] + back[n][1](v) for n in names}

    for names in dict.fromkeys([*((n,) for n in have), have]):
        for factor, unit in ((1.0, ""), (GRAVITY, ", and in multiples of g")):
            has = "has" if len(names) == 1 else "have"
            looks = f"{has} no part of gravity (acceleration, not specific force{unit})"
            mend = f"write {', '.join(back[n][0] for n in names)} into the file"
            yield Reading(names, "gravity", looks, mend, put_back(names, factor))
    if "az" in have:
        for names in dict.fromkeys([("az",), have]):
            for sign, factor in product((1.0, -1.0), (1.0, GRAVITY)):
                yield _less_one(names, sign, factor, card)


def _less_one(names: tuple[str, ...], sign: float, factor: float, card: Card) -> Reading:
    """az as a load factor from which the one of level flight was taken; the others in g with it, or not."""
    others = tuple(n for n in names if n != "az")
    unit = "in multiples of g" if factor != 1.0 else f"in {declared(card, 'az').unit}"
    turned = "positive upward" if sign < 0.0 else "positive downward"
    also = f" ({' and '.join(others)} in multiples of g, too)" if factor != 1.0 and others else ""
    looks = (
        f"is about zero in level flight, where gravity makes it -1 g: a load factor minus one, {turned}, {unit}{also}"
    )
    mend = 'add the one back in the file, and set unit = "g" and the sign on the card'
    return Reading(
        ("az", *others), "gravity", looks, mend,
        lambda v: {n: factor * v[n] for n in others} | {"az": sign * factor * v["az"] - GRAVITY}, "az",
    )  # fmt: skip


def thinness(view: View, recorded: frozenset[str]) -> np.ndarray | None:
    """Equivalent over true airspeed, (n,), from density, else from a standard atmosphere at the altitude."""
    if "density" in recorded and np.median(view["density"]) > 0.0:
        return np.sqrt(np.maximum(view["density"], 1e-3) / DENSITY0)
    if "altitude" in recorded:
        return np.maximum(1.0 - 2.25577e-5 * np.clip(view["altitude"], -1000.0, 11000.0), 0.1) ** 2.12794
    return None


# --- Rigid-body kinematics between recorded channels: what each one's rate of change must be, without aerodynamics.
# Body axes, specific force at the accelerometer (its distance from the centre of gravity is neglected), the wind
# steady:
# theta' = q cos phi - r sin phi phi' = p + tan theta (q sin phi + r cos phi) psi' = (q sin phi + r cos phi)/cos
# theta h' = V (cos a cos b sin theta - sin b sin phi cos theta - sin a cos b cos phi cos theta) V' = gx cos a cos b
# + gy sin b + gz sin a cos b alpha' = q - tan b (p cos a + r sin a) + (gz cos a - gx sin a)/(V cos b) beta' = p sin
# a - r cos a + (gy cos b - (gx cos a + gz sin a) sin b)/V
# with gx = ax - g sin theta, gy = ay + g cos theta sin phi, gz = az + g cos theta cos phi. Source: B. L. Stevens, F.
# L. Lewis, E. N. Johnson, *Aircraft Control and Simulation*, 3rd ed., Wiley 2016, chapters 1 and 2.

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
        return np.sum(self.terms(view), axis=0)

    def changes(self, view: View) -> list[np.ndarray]:
        """The channel and the integral of each term of its rate, less, over what is allowed, without drift."""
        time = view["time"]
        each = [view[self.channel], *(-integrated(term, time) for term in self.terms(view))]
        pieces = 1 if self.piece is None else round((time[-1] - time[0]) / self.piece)
        pieces = min(max(pieces, 1), len(time) // SHORTEST)
        parts = ([without_drift(part) for part in np.array_split(x, pieces)] for x in each)
        return [np.concatenate(part) / self.allowed for part in parts]


def view_of(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    """Channels, constants and time of a record, with zeros for what symmetric flight lacks."""
    known = channels_of(record, card)
    filled = {name: np.zeros(record.n) for name in ZERO_IF_MISSING if name not in known}
    return {**filled, **known, "time": record.time}


def _turning(v: View) -> tuple[np.ndarray, ...]:
    return v["q"] * np.sin(v["phi"]), v["r"] * np.cos(v["phi"])


def dead_heading(v: View) -> bool:
    """Whether the heading stands still while the rates turn the aircraft; `time`, phi, theta, q, r and psi are read."""
    turn = integrated(RELATIONS["psi"].rate(v), v["time"])
    return bool(np.ptp(turn) > TURN and np.ptp(v["psi"]) < FOLLOWS * np.ptp(turn))


def climb(v: View) -> tuple[np.ndarray, ...]:
    a, b, theta, phi, V = v["alpha"], v["beta"], v["theta"], v["phi"], v["airspeed"]
    return (
        V * np.cos(a) * np.cos(b) * np.sin(theta),
        -V * np.sin(b) * np.sin(phi) * np.cos(theta),
        -V * np.sin(a) * np.cos(b) * np.cos(phi) * np.cos(theta),
    )


def _along(v: View, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, ...]:
    """Specific force and gravity, m/s2, along a direction with these components on the body axes."""
    sin, cos = np.sin(v["theta"]), np.cos(v["theta"])
    down = (-GRAVITY * sin, GRAVITY * cos * np.sin(v["phi"]), GRAVITY * cos * np.cos(v["phi"]))
    forces = zip((v["ax"], v["ay"], v["az"]), down, (x, y, z), strict=True)
    return tuple(part * c for force, gravity, c in forces for part in (force, gravity))


def acceleration(v: View) -> tuple[np.ndarray, ...]:
    a, b = v["alpha"], v["beta"]
    return _along(v, np.cos(a) * np.cos(b), np.sin(b), np.sin(a) * np.cos(b))


def alpha_rate(v: View) -> tuple[np.ndarray, ...]:
    a, b = v["alpha"], v["beta"]
    V = v["airspeed"] * np.cos(b)
    turned = (v["q"], -np.tan(b) * v["p"] * np.cos(a), -np.tan(b) * v["r"] * np.sin(a))
    return *turned, *_along(v, -np.sin(a) / V, 0.0 * a, np.cos(a) / V)


def beta_rate(v: View) -> tuple[np.ndarray, ...]:
    a, b, V = v["alpha"], v["beta"], v["airspeed"]
    across = _along(v, -np.cos(a) * np.sin(b) / V, np.cos(b) / V, -np.sin(a) * np.sin(b) / V)
    return v["p"] * np.sin(a), -v["r"] * np.cos(a), *across


_AIR = ("airspeed", "alpha", "theta", "ax", "az")
RELATIONS: dict[str, Relation] = {
    r.channel: r
    for r in (
        Relation(
            "theta", ("theta", "q"), lambda v: (v["q"] * np.cos(v["phi"]), -v["r"] * np.sin(v["phi"])), np.deg2rad(1.0)
        ),
        Relation(
            "phi", ("phi", "p", "q", "theta"), lambda v: (v["p"], *(np.tan(v["theta"]) * x for x in _turning(v))),
            np.deg2rad(2.0),
        ),
        Relation(
            "psi", ("psi", "q", "r", "theta"), lambda v: tuple(x / np.cos(v["theta"]) for x in _turning(v)),
            np.deg2rad(3.0),
        ),
        Relation("altitude", ("altitude", "airspeed", "theta", "alpha"), climb, 6.0),
        Relation("airspeed", _AIR, acceleration, 2.0),
        Relation("alpha", (*_AIR, "q"), alpha_rate, np.deg2rad(1.0), 10.0),
        Relation("beta", ("beta", "r", "ay", "phi", *_AIR), beta_rate, np.deg2rad(1.5), 10.0),
    )
}  # fmt: skip
SHORTEST = 25  # samples of a piece
TURN, FOLLOWS = np.deg2rad(3.0), 0.2
"""rad that the rates must turn the aircraft by, and the share of it within which a heading stands still."""
LEVEL = 1.5  # m/s2 that the mean normal acceleration may be off: a bias of .5 deg/s at 100 m/s and one of .6 m/s2
SIDE = 0.9  # the same of the mean lateral acceleration: .3 deg/s at 100 m/s and .4 m/s2, or 2.5 deg of the bank angle
SIDESLIP = 0.1  # rad that sideslip may have changed by where it was not recorded
MEANS = {"level": LEVEL, "side": SIDE}
_MEAN_NEEDS = {"level": RELATIONS["alpha"].needs, "side": ("ay", "r", "phi", *RELATIONS["airspeed"].needs)}
SCALE = 0.3  # error of scale that a sensor in the right unit may have; our choice


def misfits(view: View, recorded: frozenset[str], names: frozenset[str] | None = None) -> dict[str, float]:
    """How far each relation (or those of `names`) is from what is allowed: 1 is the limit. Relations that lack a
    channel are left out."""
    off = {name: terms.sum(0) for name, terms in terms_of(view, recorded, names).items()}
    sizes = {name: float(np.sqrt(np.mean(np.minimum(np.abs(x), 1e9) ** 2))) for name, x in off.items()}
    return {name: sizes[name] if np.isfinite(x).all() else np.inf for name, x in off.items()}


def terms_of(view: View, recorded: frozenset[str], names: frozenset[str] | None = None) -> dict[str, np.ndarray]:
    """What the terms (k, n) of each relation leave when they are added, over what is allowed."""
    found = {}
    with np.errstate(all="ignore"):
        for name, needs in {**{name: r.needs for name, r in RELATIONS.items()}, **_MEAN_NEEDS}.items():
            if set(needs) <= recorded and (names is None or name in names):
                mean = name in _MEAN_NEEDS
                terms = _mean_terms(name, view, recorded) if mean else RELATIONS[name].changes(view)
                found[name] = np.stack(terms)
    return found


def _mean_terms(name: str, view: View, recorded: frozenset[str]) -> list[np.ndarray]:
    """Mean accelerations that rates, angles and accelerometers make, and what they turn by, over what is allowed."""
    V, channel = view["airspeed"], "alpha" if name == "level" else "beta"
    terms = [np.mean(V * term) for term in RELATIONS[channel].terms(view)]
    if channel in recorded:
        x, time = view[channel], view["time"]
        turned = float(np.median(x[-9:]) - np.median(x[:9])) / float(time[-1] - time[0])
        terms.append(-np.mean(V) * turned)
    elif np.mean(V) * SIDESLIP >= SIDE / 3.0 * float(view["time"][-1] - view["time"][0]):
        return [np.zeros(1)]
    return [np.atleast_1d(term) / MEANS[name] for term in terms]


def side_bias(view: View, recorded: frozenset[str]) -> float:
    """Mean lateral acceleration beyond what bank, turn and sideslip make, m/s2; zero where sideslip leaves it open."""
    return SIDE * float(np.sum(_mean_terms("side", view, recorded), axis=0)[0])


def integrated(rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    """The integral of a (n,) rate over time, by the trapezium rule, zero at first."""
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (rate[:-1] + rate[1:]))])


def without_drift(x: np.ndarray) -> np.ndarray:
    """Less its best straight line: an unknown initial value, and a bias of the rate or steady vertical wind."""
    t = np.linspace(-1.0, 1.0, len(x))
    return x - x.mean() - t * float(t @ x) / float(t @ t)
