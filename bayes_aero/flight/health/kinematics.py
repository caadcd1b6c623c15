"""Other ways to read a channel - sign, unit, gravity, kind of airspeed - that the kinematics are tried with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import fminbound

from bayes_aero.flight.card import Card
from bayes_aero.flight.health import Findings, HealthFinding, channels_of, declared, found, other_units
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import GRAVITY, Axis, standard_air

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
            by_frame = {n: move for kind in of for n, move in frame.moves(INSTRUMENTS[kind], recorded).items()}
            rest = more + sum(by_frame.get(n) != moves.get(n) for kind in kinds for n in have[kind])
            if by_frame and rest < best[1]:
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
        return np.sqrt(standard_air(view["altitude"])[0] / DENSITY0)
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
    channels = channels_of(record, card)
    filled = {name: np.zeros(record.n) for name in ZERO_IF_MISSING if name not in channels}
    return {**filled, **channels, "time": record.time}


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
    terms_by_relation = {}
    with np.errstate(all="ignore"):
        for name, needs in {**{name: r.needs for name, r in RELATIONS.items()}, **_MEAN_NEEDS}.items():
            if set(needs) <= recorded and (names is None or name in names):
                mean = name in _MEAN_NEEDS
                terms = _mean_terms(name, view, recorded) if mean else RELATIONS[name].changes(view)
                terms_by_relation[name] = np.stack(terms)
    return terms_by_relation


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


# --- Signs, units, gravity and kinds of airspeed that the other channels refute, by kinematics at any bank angle.

OFF = 0.10  # departure that no weather and no sensor makes, as a logarithm
MENDED = 0.4  # of its misfit a relation may keep under the reading that is said to be right
WORSE = 1.3  # times its misfit another relation may have there, if it is above the limit then
TIED = 0.15  # of the best gain: readings that nearly gain as much cannot be told from the best
MOST = 4  # faults of one record
BESIDE = np.linspace(-0.18, 0.18, 19)  # logarithms beside a unit's factor, among which the record's own is sought
FEW, SLOW = 500, 0.1  # samples and s between them that tell one sign from another
ALIKE = 2.0  # logarithms of misfits within which ways to read the record may be as good as the best
FAULT, AXES = 0.25, 2  # of these logarithms that a fault costs, and faults that axes cost
TOLD = 0.2  # by which the best must be ahead of the next
SPEED = frozenset({"airspeed", "altitude", "alpha", "beta"})  # relations that ask for a factor of the airspeed
SPEED_ERROR = 0.02  # standard deviation of the scale of an airspeed in the right unit; assumed
PIECE, FEWEST = 5.0, 4  # s, and number, of the pieces that tell its standard error
WIDEST, STEP, SURE = 1.6, 0.02, 3.0  # logarithms of its range and of a difference; standard errors that it must be off
EXPLAINED = 2.0  # times what noise and errors of scale make, up to which a relation holds
JUMP = 0.5  # rad from one sample to the next that is no turn
NOUNS = {
    "theta": "pitch attitude", "phi": "bank angle", "psi": "heading", "altitude": "altitude",
    "airspeed": "airspeed", "alpha": "angle of attack", "beta": "sideslip", "level": "normal acceleration",
}  # fmt: skip
Misfits = dict[str, float]


def refuted(record: FlightRecord, card: Card) -> tuple[list[HealthFinding], FlightRecord]:
    """What must be read in another way for the record to be one flight: a finding for each such channel or frame, one
    for each mean acceleration that stays unexplained; and the record as it is to be read."""
    raw = view_of(record, card)
    view = dict(raw)  # without isolated spikes, dropouts and the jumps of an angle, which other checks report
    for name in set(raw) - {"time"}:
        steps = np.diff(raw[name], prepend=raw[name][0])
        turned = raw[name][0] + np.cumsum(np.where(np.abs(steps) > JUMP, 0.0, steps))
        view[name] = median_filter(turned if name in ("psi", "phi") else raw[name], 5, mode="nearest")
    recorded = frozenset(record.channels) | {"time"} | frozenset(card.constants)
    if record.n < 50:
        return [], record
    before = misfits(view, recorded)
    said, left = _chain(record, card, view, recorded, before)
    if len(said) > 1 or (max(left.values(), default=0.0) > 1.0):
        whole = _whole(record, card, view, recorded, before)
        signs = {r.channels[0] for r, _ in said if r.fault == "sign"}
        if whole is not None and (
            max(left.values()) > 1.0 or whole[0][1].fault == "axes" or signs == set(whole[0][0].channels)
        ):
            said = [whole[0]]
            left = whole[1]
    for reading, _ in said:
        raw = {**raw, **reading.applied(raw)}
        view = {**view, **reading.applied(view)}
    read = replace(record, channels={name: raw[name] for name in record.channels}) if said else record
    return [*(finding for _, finding in said), *_bias(record, card, view, recorded, left)], read


def _chain(
    record: FlightRecord, card: Card, view: View, recorded: frozenset[str], before: Misfits
) -> tuple[list[tuple[Reading, HealthFinding]], Misfits]:
    """Readings one after the other, the best first, while any mends what is refuted; and what they leave. What they
    mend must be within the limit in the end: otherwise they explain nothing."""
    said: list[tuple[Reading, list[str], HealthFinding]] = []
    for _ in range(MOST):
        if not any(value > 1.0 for value in before.values()):
            break
        tried = [(r, _after(view, r, recorded)) for r in readings(view, card, recorded)]
        gains = []
        for reading, after in tried:
            gain = _gain(before, after)
            right = gain <= 0.0 or _own_factor(view, recorded, reading, before, after)
            gains.append((gain if right else 0.0, reading, after))
        if not any(gain > 0.0 and "airspeed" in reading.channels for gain, reading, _ in gains):
            other = [(r, _after(view, r, recorded)) for r in _factors(view, recorded)]
            gains += [(_gain(before, after), reading, after) for reading, after in other]
        gain, best, after = max(gains, key=lambda one: (one[0], -len(one[1].channels)))
        if gain <= 0.0:
            break
        tied = [
            reading
            for other, reading, _ in gains
            if reading is not best and (other > (1.0 - TIED) * gain or (other > 0.0 and _rivals(reading, best)))
        ]
        said.append((best, _mended(before, after), _finding(record, best, _distinct(best, tied), before, after)))
        view, before = {**view, **best.applied(view)}, after
    if all(any(before[name] <= 1.0 for name in mended) for _, mended, _ in said):
        return [(reading, finding) for reading, _, finding in said], before
    return [], before


def _after(view: View, reading: Reading, recorded: frozenset[str]) -> Misfits:
    return misfits({**view, **reading.applied(view)}, recorded)


def _factors(view: View, recorded: frozenset[str]) -> list[Reading]:
    """The airspeed over the factor that fits best; or the altitude, where the altitude alone contradicts it."""
    names = frozenset(misfits(view, recorded, SPEED))
    speed = _speed_factor(view, recorded, names)
    if speed is None or abs(speed[0]) < max(OFF, SURE * speed[1]):
        return []
    factors = []
    for name, k in (("airspeed", speed[0]), ("altitude", -speed[0]))[: 2 if names == {"altitude"} else 1]:
        size, error = np.exp(k), np.exp(k) * speed[1]
        looks = f"is {size:.4g} +- {error:.1g} times what the other channels make of it (no unit explains it)"
        factors.append(scaled((name,), 1.0 / size, "factor", looks, f"correct {name} in the file"))
    return factors


def _speed_factor(view: View, recorded: frozenset[str], names: frozenset[str]) -> tuple[float, float] | None:
    """Logarithm of the factor of the airspeed that fits these relations best, and its standard error. The error is that
    of the scatter between pieces of the record, which are taken as independent. None where the record is too short for
    them."""
    pieces = np.array_split(np.arange(len(view["time"])), max(FEWEST, round(np.ptp(view["time"]) / PIECE)))
    if not names or "airspeed" not in recorded or len(pieces[-1]) < SHORTEST:
        return None
    parts = [{name: x[piece] for name, x in view.items()} for piece in pieces]

    def left(k: float) -> np.ndarray:
        read = ({**part, "airspeed": np.exp(-k) * part["airspeed"]} for part in parts)
        return np.array([sum(min(x, 1e6) ** 2 for x in misfits(v, recorded, names).values()) for v in read])

    k = float(np.asarray(fminbound(lambda k: float(np.sum(left(k))), -WIDEST, WIDEST)).flat[0])
    below, at, above = left(k - STEP), left(k), left(k + STEP)
    curve = float(np.sum(above - 2.0 * at + below)) / STEP**2
    error = np.sqrt(len(parts) / (len(parts) - 1) * np.sum(((above - below) / (2.0 * STEP)) ** 2))
    return k, float(error) / max(curve, 1e-12)


def _whole(
    record: FlightRecord, card: Card, view: View, recorded: frozenset[str], before: Misfits
) -> tuple[tuple[Reading, HealthFinding], Misfits] | None:
    """The signs and axes of all channels at once that alone explain the record, but for errors of scale."""
    have = frozenset(record.channels)
    step = max(1, min(len(view["time"]) // FEW, int(SLOW / np.median(np.diff(view["time"])))))
    few = {name: x[::step] for name, x in view.items()}
    names = [n for n in (*ATTITUDE, *FLOW, *INSTRUMENTS["rates"], *INSTRUMENTS["accelerations"]) if n in have]
    signs = np.array(list(product((1, -1), repeat=len(names))))
    turned = [terms_of({**few, name: -few[name]}, recorded) for name in names]
    odd = {  # of each relation, which terms (k, channels) count the other way with a channel
        relation: np.stack([np.sum(x * other[relation], axis=1) < 0.0 for other in turned], axis=1)
        for relation, x in terms_of(few, recorded).items()
    }
    whole: list[tuple[float, float, Moves]] = []
    for order in ({**a, **b} for a in orders("rates", have) for b in orders("accelerations", have)):
        other = {**few, **{name: few[source] for name, source in order.items()}}
        strains = _strains(terms_of(other, recorded), odd, signs)
        score, worst = np.log1p(strains**2).sum(0), strains.max(0)
        for k in np.flatnonzero(score < min([score.min(), *(s for s, _, _ in whole)]) + ALIKE):
            pairs = {n: (order.get(n, n), int(sign)) for n, sign in zip(names, signs[k], strict=True)}
            whole.append((score[k], worst[k], {n: move for n, move in pairs.items() if move != (n, 1)}))
    least = min(score for score, _, _ in whole)
    alike = []
    for score, worst, m in whole:
        faults = min(len(m), AXES + axes_of(m, have)[1])  # axes are as many as two, beside single channels
        alike += [(score + FAULT * faults, worst, m)] if score < least + ALIKE else []
    total = min(one[0] for one in alike)
    (worst, moves), *tied = sorted(
        ((worst, m) for score, worst, m in alike if score < total + TOLD), key=lambda one: len(one[1])
    )
    reading, *others = (moved(card, have, m) for _, m in ((worst, moves), *tied))
    if not moves or worst > EXPLAINED or (others and any(r.fault == "axes" for r in (reading, *others))):
        return None
    after = misfits({**view, **reading.applied(view)}, recorded)
    if not _mended(before, after):
        return None
    return (reading, _finding(record, reading, others[:2], before, after)), after


def _strains(terms: dict[str, np.ndarray], odd: dict[str, np.ndarray], signs: np.ndarray) -> np.ndarray:
    """Misfit of each relation under each set of signs (sets, channels), over what noise and errors of scale make."""
    strains = []
    for name, x in terms.items():
        of_terms = np.where(odd[name][None], signs[:, None, :], 1).prod(2)
        gram = x @ x.T / x.shape[1] if np.isfinite(x).all() else np.full((len(x), len(x)), 1e12)
        off = np.maximum(np.einsum("sk,kl,sl->s", of_terms, gram, of_terms), 0.0)
        strains.append(np.sqrt(off / (1.0 + SCALE**2 * np.trace(gram))))
    return np.stack(strains)


def _own_factor(view: View, recorded: frozenset[str], reading: Reading, before: Misfits, after: Misfits) -> bool:
    """Whether the factor of a unit agrees with the one that the record itself asks for, which fits best. A smaller
    number fits better than a wrong one whatever its unit is."""
    if reading.factor == 1.0:
        return True
    names = frozenset(n for n in _mended(before, after) if after[n] != before[n])
    speed = _speed_factor(view, recorded, names & SPEED) if reading.channels == ("airspeed",) else None
    if speed is not None:
        return bool(abs(speed[0] + np.log(reading.factor)) < 2.0 * np.hypot(SPEED_ERROR, speed[1]))
    unit = reading.applied(view)
    left = []
    for k in BESIDE:
        off = misfits({**view, **{n: np.exp(k) * x for n, x in unit.items()}}, recorded, names)
        left.append(sum(np.log(max(min(value, 1e6), 1e-6)) for value in off.values()))
    return bool(abs(BESIDE[np.argmin(left)]) < AGREES)


def _mended(before: Misfits, after: Misfits) -> list[str]:
    """Relations that a reading mends; a mean of the lateral acceleration is a bias before it is anything else."""
    return [n for n, a in before.items() if n != "side" and a > 1.0 and after[n] < MENDED * a]


def _bias(record: FlightRecord, card: Card, view: View, recorded: frozenset[str], left: Misfits) -> Findings:
    """The mean lateral acceleration that no other reading of a channel explains, unless the card states it. Bank and
    turn, on which it rests, must not be in doubt. A factor of the airspeed may be a rival."""
    if left.get("side", 0.0) <= 1.0 or max(left.get(name, 0.0) for name in ("phi", "psi")) > 1.0:
        return
    terms = terms_of(view, recorded, frozenset({"side"}))["side"]
    if "accel_y_bias" in card.effects or abs(terms.sum()) < np.sqrt(1.0 + SCALE**2 * np.sum(terms**2)):
        return  # stated there, or no more than errors of scale make in turns
    off = side_bias(view, recorded)
    tilt = np.degrees(np.arcsin(min(abs(off) / GRAVITY, 1.0)))
    mean = float(np.mean(view["ay"]))
    sentence = (
        f"ay is off by {off:+.2g} m/s^2 ({off / GRAVITY:+.2g} g) in the mean: bank, turn and airspeed make "
        f"{mean - off:+.2g} m/s^2, and {mean:+.2g} were recorded. It is a bias of the accelerometer, or its "
        f"tilt of {tilt:.2g} deg about the x axis (or as much bias of the bank angle)"
    )
    # The factor of the airspeed that explains it, too, if no other relation refutes that: what turns grows with the
    # airspeed, what forces make does not.
    turn = side_bias({**view, "airspeed": 2.0 * view["airspeed"]}, recorded) - off
    k = float(turn / (turn - off)) if turn != off else 0.0
    rival = "airspeed" in recorded and np.exp(-WIDEST) < k < np.exp(WIDEST)
    if rival:
        after = misfits({**view, "airspeed": view["airspeed"] / k}, recorded)
        rival = not any(after[n] > max(1.0, WORSE * a) for n, a in left.items())
    mend = (
        f"; or airspeed is {k:.3g} times what bank and turn make of it: this record cannot tell the two apart. Compare "
        "the airspeed with another source"
        if rival
        else "; take it out in the file, or add the effect accel_y_bias with its value under fixed on the card"
    )
    grave = Axis.LATERAL in card.axes
    yield found(record, "ay", "mean" if rival else "bias", sentence + mend, at=(0, record.n - 1), grave=grave)


def _gain(before: Misfits, after: Misfits) -> float:
    """Logarithm of the misfit that is mended, over all relations; zero where none is, or another is spoiled."""
    mended = _mended(before, after)
    spoiled = [n for n, a in before.items() if after[n] > 1.0 and after[n] > WORSE * a]
    if not mended or spoiled:
        return 0.0
    return sum(np.log(max(min(a, 1e6), 0.3) / max(after[n], 0.3)) for n, a in before.items() if np.isfinite(after[n]))


def _distinct(best: Reading, tied: list[Reading]) -> list[Reading]:
    """Of the readings that are as good, those of other channels; and all units that agree."""
    seen, kept = {best.channels}, []
    for reading in tied:
        if _rivals(reading, best):
            kept.append(reading)
        elif not set(reading.channels) & set(best.channels) and reading.channels not in seen:
            seen.add(reading.channels)
            kept.append(reading)
    return kept[:2]


def _rivals(one: Reading, other: Reading) -> bool:
    """Whether they are two units (or kinds of airspeed) of the same channels."""
    return one.channels == other.channels and 1.0 not in (one.factor, other.factor)


def _finding(
    record: FlightRecord, best: Reading, tied: list[Reading], before: Misfits, after: Misfits
) -> HealthFinding:
    relation = max(_mended(before, after), key=lambda n: min(before[n], 1e6) / max(after[n], 0.05))
    other = "".join(f", or {r.names} {r.looks}" for r in tied)
    mend = ", or ".join([best.mend, *(r.mend for r in tied if _rivals(r, best))])
    if relation in MEANS:
        scale, unit = MEANS[relation], "m/s^2 in the mean"
    else:
        unit = {"altitude": "m", "airspeed": "m/s"}.get(relation, "deg")
        scale = RELATIONS[relation].allowed * (np.degrees(1.0) if unit == "deg" else 1.0)
    sentence = (
        f"{best.names} {best.looks}{other}: the {NOUNS[relation]} differs by {scale * before[relation]:.3g} {unit} "
        f"from what the other channels imply, and by {scale * after[relation]:.2g} once that is corrected; {mend}"
    )
    return found(record, best.channels[0], best.fault, sentence, at=(0, record.n - 1))
