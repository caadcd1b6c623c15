"""Rigid-body kinematics between recorded channels, and the signs, axes, units and gravity that they refute."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import fminbound

from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import unit_choices
from bayes_aero.flight.health import HealthFinding, channels_of, declared, finding, other_units
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import GRAVITY, standard_air
from bayes_aero.physics.kinematics import PATH_NEEDS, STRAIGHT, down_of, euler_rates, motion_over_ground

# --- What each channel's rate of change must be (`physics.kinematics`), without aerodynamics; the distance of the
# accelerometer from the centre of gravity is neglected, and the wind is steady.

View = Mapping[str, np.ndarray]
"""Recorded channels, constants of the card and time of a record, (n,) each; what symmetric flight lacks is zero."""
Misfits = dict[str, float]
LINEAR = ("p", "q", "r", "ax", "ay", "az", "x", "y", "z")
"""What the rates of change are linear in: rates, specific force, and the components of gravity along the body axes."""


class Relation(NamedTuple):
    """Channels that must be recorded, what of `LINEAR` the rate has, and the misfit, SI, that sound records stay below
    after a constant and a drift are taken out, in pieces of `piece` s where errors of the rate add up too fast."""

    needs: tuple[str, ...]
    parts: tuple[str, ...]
    allowed: float
    noun: str
    piece: float = np.inf


_AIR = ("airspeed", "alpha", "theta", "ax", "az")
_TURNS, _SLIPS = ("p", "q", "r", "ax", "az", "x", "z"), ("p", "r", "ax", "ay", "az", "x", "y", "z")
RELATIONS: dict[str, Relation] = {
    "theta": Relation(("theta", "q"), ("q", "r"), np.deg2rad(1.0), "pitch attitude"),
    "phi": Relation(("phi", "p", "q", "theta"), ("p", "q", "r"), np.deg2rad(2.0), "bank angle"),
    "psi": Relation(("psi", "q", "r", "theta"), ("q", "r"), np.deg2rad(3.0), "heading"),
    "altitude": Relation(("altitude", "airspeed", "theta", "alpha"), ("x", "y", "z"), 6.0, "altitude"),
    "airspeed": Relation(_AIR, LINEAR[3:], 2.0, "airspeed"),
    "alpha": Relation((*_AIR, "q"), _TURNS, np.deg2rad(1.0), "angle of attack", 10.0),
    "beta": Relation(("beta", "r", "ay", "phi", *_AIR), _SLIPS, np.deg2rad(1.5), "sideslip", 10.0),
}
MEANS = {  # m/s2: biases of .5 deg/s at 100 m/s and .6 m/s2; of .3 deg/s and .4 m/s2, or 2.5 deg of the bank angle
    "level": Relation((*_AIR, "q"), _TURNS, 1.5, "normal acceleration"),
    "side": Relation(("ay", "r", "phi", *_AIR), _SLIPS, 0.9, "lateral acceleration"),
}
"""The mean normal and lateral acceleration, which the rate of alpha and of beta times the airspeed must make."""
SHORTEST = 25  # samples of a piece
SIDESLIP = 0.1  # rad that sideslip may have changed by where it was not recorded
SCALE = 0.3  # error of scale that a sensor in the right unit may have; our choice


def view_of(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    return channels_of(record, card) | {"time": record.time}


def rates_of(view: View, only: str | None = None) -> dict[str, np.ndarray]:
    """Rate of change of each channel, (n,), NaN where something is missing; `only` the part due to one of `LINEAR`."""
    n = len(view["time"])
    v = {name: view.get(name, np.full(n, 0.0 if name in STRAIGHT else np.nan)) for name in PATH_NEEDS}
    inputs = v | dict(zip("xyz", down_of(v["phi"], v["theta"]), strict=True))
    part = {name: inputs[name] if only in (None, name) else np.zeros(n) for name in LINEAR}
    p, q, r, *forces = part.values()
    force, down = (forces[0], forces[1], forces[2]), (forces[3], forces[4], forces[5])
    with np.errstate(all="ignore"):
        angles = zip(("phi", "theta", "psi"), euler_rates((p, q, r), v["phi"], v["theta"]), strict=True)
        v |= part
        return motion_over_ground(v, force, down) | dict(angles)


def dead_heading(view: View) -> bool:
    """Whether the heading stands still, within a fifth of what the rates turn the aircraft by, which are 3 deg or more;
    `time`, phi, theta, q, r and psi are read."""
    turn = integrated(rates_of(view)["psi"], view["time"])
    return bool(np.ptp(turn) > np.deg2rad(3.0) and np.ptp(view["psi"]) < 0.2 * np.ptp(turn))


def misfits(view: View, names: Iterable[str] | None = None) -> Misfits:
    """How far each relation (or those of `names`) that has its channels is from what is allowed: 1 is the limit."""
    off = {name: terms.sum(0) for name, terms in terms_of(view, names, (None,)).items()}
    sizes = {name: float(np.sqrt(np.mean(np.minimum(np.abs(x), 1e9) ** 2))) for name, x in off.items()}
    return {name: sizes[name] if np.isfinite(x).all() else np.inf for name, x in off.items()}


def terms_of(
    view: View, names: Iterable[str] | None = None, parts: Sequence[str | None] = LINEAR
) -> dict[str, np.ndarray]:
    """Terms (k, n) whose sum a relation leaves, over what is allowed: the channel, and what each of `parts` makes."""
    by_part, time, terms = {part: rates_of(view, part) for part in parts}, view["time"], {}
    with np.errstate(all="ignore"):
        for name, relation in (RELATIONS | MEANS).items():
            if not set(relation.needs) <= view.keys() or (names is not None and name not in names):
                continue
            rates = [rates for part, rates in by_part.items() if part is None or part in relation.parts]
            if name in MEANS:
                terms[name] = _mean_terms(name, view, rates)
                continue
            pieces = min(max(round((time[-1] - time[0]) / relation.piece), 1), len(time) // SHORTEST)
            each = [view[name], *(-integrated(rate[name], time) for rate in rates)]
            left = (np.concatenate([*map(without_drift, np.array_split(x, pieces))]) for x in each)
            terms[name] = np.stack([*left]) / relation.allowed
    return terms


def _mean_terms(name: str, view: View, rates: Sequence[View]) -> np.ndarray:
    """Mean accelerations (k, 1) that each part makes, and what the flow turns by, over what is allowed."""
    channel = "alpha" if name == "level" else "beta"
    V, lasts = view["airspeed"], float(view["time"][-1] - view["time"][0])
    terms = [np.mean(V * rate[channel]) for rate in rates]
    if channel in view:
        terms.append(-np.mean(V) * float(np.median(view[channel][-9:]) - np.median(view[channel][:9])) / lasts)
    elif np.mean(V) * SIDESLIP >= MEANS["side"].allowed / 3.0 * lasts:
        return np.zeros((1, 1))
    return np.array(terms)[:, None] / MEANS[name].allowed


def integrated(rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (rate[:-1] + rate[1:]))])


def without_drift(x: np.ndarray) -> np.ndarray:
    """Less its best straight line: an unknown initial value, and a bias of the rate or steady vertical wind."""
    t = np.linspace(-1.0, 1.0, len(x))
    return x - x.mean() - t * float(t @ x) / float(t @ t)


# --- Other ways to read a channel - sign, unit, gravity, kind of airspeed - that the kinematics are tried with.

INSTRUMENTS = {"accelerations": ("ax", "ay", "az"), "rates": ("p", "q", "r")}
ATTITUDE, FLOW = ("phi", "theta", "psi"), ("alpha", "beta")
TURNED = (*ATTITUDE, *FLOW, "p", "q", "r", "ax", "ay", "az")
GROUPS = (*((n,) for n in (*TURNED, "airspeed", "altitude", "time")), *INSTRUMENTS.values(), ATTITUDE, FLOW)
"""Channels whose unit may be wrong: each alone, or those of one instrument."""
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
    changed: Callable[[View], dict[str, np.ndarray]]
    subject: str = ""  # who it is said of, if not of all the channels
    factor: float = 1.0  # of a unit or a kind of airspeed, by which the channels are multiplied

    @property
    def names(self) -> str:
        return self.subject or ", ".join(self.channels)

    def rivals(self, other: Reading) -> bool:
        """Whether they are two units (or kinds of airspeed) of the same channels."""
        return self.channels == other.channels and 1.0 not in (self.factor, other.factor)

    def of(self, view: View) -> dict[str, np.ndarray]:
        return {**view, **self.changed(view)}


def readings(view: View, card: Card) -> Iterator[Reading]:
    for name in (*TURNED, "altitude"):
        if name in view:
            sign = -declared(card, name).sign
            yield scaled((name,), -1.0, "sign", "counts the other way", f"write sign = {sign} at {name} on the card")
    for group in GROUPS:
        if group := tuple(n for n in group if n in view):
            yield from _units(group, card, view)
    if "theta" in view:
        yield from _gravity(card, view)
    ratio = thinness(view)
    if "airspeed" in view and ratio is not None and float(np.median(ratio)) < THIN:
        times = float(1.0 / np.median(ratio))
        yield Reading(
            ("airspeed",), "airspeed_kind",
            f"is calibrated (or indicated) airspeed: true airspeed is {times:.3g} times as large at this density",
            "divide it by the square root of density over 1.225 kg/m^3 in the file, or map the true airspeed",
            lambda v: {"airspeed": v["airspeed"] / ratio}, factor=times,
        )  # fmt: skip


def scaled(names: tuple[str, ...], factor: float, fault: str, claim: str, mend: str) -> Reading:
    return Reading(names, fault, claim, mend, lambda view: {name: factor * view[name] for name in names})


def _units(group: tuple[str, ...], card: Card, view: View) -> Iterator[Reading]:
    stated, *others = dict.fromkeys(declared(card, name).unit for name in group)
    # The unit explains the load factor of flight, and no other one does.
    level = "az" in group and abs(np.log(max(float(np.median(np.abs(view["az"]))), 1e-9) / GRAVITY)) < ONE_G
    are, them = ("is", "it") if len(group) == 1 else ("are", "them")
    for unit, factor in other_units(card, group[0], unit_choices(group[0])) if not (others or level) else ():
        if abs(np.log(factor)) >= 0.1:
            claim = f"{are} in {unit} and not in {stated}, as the card says"
            mend = f'set unit = "{unit}" for {them} on the card'
            yield replace(scaled(group, factor, "unit", claim, mend), factor=factor)


def _gravity(card: Card, view: View) -> Iterator[Reading]:
    """Accelerations that inertial units give out: without gravity, one, some or all; the load factor less one, az in g
    and the others with it, or not."""
    have = tuple(n for n in INSTRUMENTS["accelerations"] if n in view)
    back = {"ax": "ax + g sin(theta)", "ay": "ay - g cos(theta) sin(phi)", "az": "az - g cos(theta) cos(phi)"}

    def put_back(names: tuple[str, ...], factor: float, v: View) -> dict[str, np.ndarray]:
        down = dict(zip(back, down_of(v.get("phi", np.zeros(len(v["theta"]))), v["theta"]), strict=True))
        return {n: factor * v[n] - GRAVITY * down[n] for n in names}

    def add_one(others: tuple[str, ...], sign: float, factor: float, v: View) -> dict[str, np.ndarray]:
        return {n: factor * v[n] for n in others} | {"az": sign * factor * v["az"] - GRAVITY}

    for names, factor in product(dict.fromkeys([*((n,) for n in have), have]), (1.0, GRAVITY)):
        unit = ", and in multiples of g" if factor != 1.0 else ""
        claim = f"{'has' if len(names) == 1 else 'have'} no part of gravity (acceleration, not specific force{unit})"
        mend = f"write {', '.join(back[n] for n in names)} into the file"
        yield Reading(names, "gravity", claim, mend, partial(put_back, names, factor))
    beside = dict.fromkeys([(), tuple(n for n in have if n != "az")]) if "az" in have else ()
    for others, sign, factor in product(beside, (1.0, -1.0), (1.0, GRAVITY)):
        unit = "in multiples of g" if factor != 1.0 else f"in {declared(card, 'az').unit}"
        also = f" ({' and '.join(others)} in multiples of g, too)" if factor != 1.0 and others else ""
        yield Reading(
            ("az", *others), "gravity",
            "is about zero in level flight, where gravity makes it -1 g: a load factor minus one, positive "
            f"{'upward' if sign < 0.0 else 'downward'}, {unit}{also}",
            'add the one back in the file, and set unit = "g" and the sign on the card',
            partial(add_one, others, sign, factor), "az",
        )  # fmt: skip


def thinness(view: View) -> np.ndarray | None:
    """Equivalent over true airspeed, (n,), from density, else from a standard atmosphere at the altitude."""
    if "density" in view and np.median(view["density"]) > 0.0:
        return np.sqrt(np.maximum(view["density"], 1e-3) / DENSITY0)
    return np.sqrt(standard_air(view["altitude"])[0] / DENSITY0) if "altitude" in view else None


# --- Whole axes that count another way than the program's.

AXES = (("forward", "aft"), ("right", "left"), ("down", "up"))
ANGLES = tuple(
    frozenset((*attitude, *flow))
    for flow in ((), FLOW)
    for attitude in ((), ("theta",), ("theta", "psi"), ("psi",), ("phi", "psi"))
)
"""Angles that count the other way where the axes do: pitch attitude about an axis to the left, a heading about one that
points up, which a compass does not turn with."""
Moves = Mapping[str, tuple[str, int]]
"""The channel and sign that each is to be read from, of those for which that is not itself."""
FRAMES = tuple(
    (order, signs)
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
    if np.linalg.det(np.eye(3)[list(order)]) * np.prod(signs) > 0.0
)
"""All right-handed axes of a file: the program's axis i is `signs[i]` times the file's axis `order[i]`."""


def axes_of(moves: Moves, view: View) -> tuple[str, int]:
    """The axes that explain most of the moves, in words, and how many channels they do not explain."""
    kinds = tuple(kind for kind, names in INSTRUMENTS.items() if view.keys() & {*names})
    angles = {n for n in moves if n in (*ATTITUDE, *FLOW)}
    more = min(len(angles ^ (turned & view.keys())) for turned in ANGLES)
    have = [n for kind in kinds for n in INSTRUMENTS[kind] if n in view]
    best = ("", len(moves) + 1)
    for of, (order, signs) in product(dict.fromkeys([kinds, *((kind,) for kind in kinds)]), FRAMES):
        by_frame = {
            n: (INSTRUMENTS[kind][j], sign)
            for kind in of for n, j, sign in zip(INSTRUMENTS[kind], order, signs, strict=True)
            if n in view and (INSTRUMENTS[kind][j], sign) != (n, 1)
        }  # fmt: skip
        rest = more + sum(by_frame.get(n) != moves.get(n) for n in have)
        if by_frame and rest < best[1]:
            points = {j: AXES[i][sign < 0] for i, (j, sign) in enumerate(zip(order, signs, strict=True))}
            named = ", ".join(f"{axis} {points[j]}" for j, axis in enumerate("xyz"))
            best = (f"the axes of the {of[0] if len(of) == 1 else 'sensors'} are {named}", rest)
    return best


def moved(card: Card, view: View, moves: Moves) -> Reading:
    """Channels taken for each other, or counting the other way; axes where they say what as many signs could not."""
    turned = ", ".join(name for name, (source, _) in moves.items() if source == name)
    exchanged = ", ".join(f"{name} is {source}" for name, (source, _) in moves.items() if source != name)
    axes, rest = axes_of(moves, view)
    axes = "" if rest else axes
    sensors = sum(n in view for names in INSTRUMENTS.values() for n in names)
    # Four channels together are likelier axes than as many wrong signs; three, where the sensors recorded no more.
    evident = bool(axes) and (bool(exchanged) or len(moves) >= (3 if sensors <= 3 else 4))
    signs: dict[int, list[str]] = {}
    for name, (source, sign) in moves.items():
        signs.setdefault(sign * declared(card, source).sign, []).append(name)
    write = " and ".join(f"sign = {sign} at {', '.join(names)}" for sign, names in signs.items())
    place = "give each the label, column and unit of the other, and " if exchanged else ""
    count = f"count{'s' if len(moves) == 1 else ''} the other way"
    also = "; ".join(x for x in (exchanged and f"{exchanged} of the card", turned and f"{turned} {count}") if x)
    fault, claim = ("exchanged", "are exchanged") if exchanged else ("sign", count)
    claim += (f" (as where {axes})" if axes else "") + (f" ({also})" if exchanged else "")
    if evident:
        fault, claim = "axes", f"({also})"
    return Reading(
        tuple(moves), fault, claim, f"{place}write {write} on the card",
        lambda view: {name: sign * view[source] for name, (source, sign) in moves.items()},
        axes if evident else "",
    )  # fmt: skip


# --- What the record is to be read as: the readings that mend what is refuted, and spoil nothing else.

MENDED = 0.4  # of its misfit a relation may keep under the reading that is said to be right
WORSE = 1.3  # times its misfit another relation may have there, if it is above the limit then
BESIDE = np.linspace(-0.18, 0.18, 19)  # logarithms beside a unit's factor, among which the record's own is sought
ALIKE = 2.0  # logarithms of misfits within which ways to read the record may be as good as the best
SPEED = frozenset({"airspeed", "altitude", "alpha", "beta"})  # relations that ask for a factor of the airspeed
WIDEST, STEP = 1.6, 0.02  # logarithms of its range and of a difference
Said = tuple[Reading, HealthFinding]


def refuted(record: FlightRecord, card: Card) -> tuple[list[HealthFinding], FlightRecord]:
    """A finding for each channel or frame that must be read in another way; and the record as it is to be read."""
    if record.n < 50:
        return [], record
    raw = view_of(record, card)
    view = dict(raw)  # without isolated spikes, dropouts and the jumps of an angle, which other checks report
    for name in set(raw) - {"time"}:
        steps = np.diff(raw[name], prepend=raw[name][0])
        turned = raw[name][0] + np.cumsum(np.where(np.abs(steps) > 0.5, 0.0, steps))
        view[name] = median_filter(turned if name in ("psi", "phi") else raw[name], 5, mode="nearest")
    before = misfits(view)
    faults, left = _chain(record, card, view, before)
    if (len(faults) > 1 or max(left.values(), default=0.0) > 1.0) and (whole := _whole(record, card, view, before)):
        signs = {reading.channels[0] for reading, _ in faults if reading.fault == "sign"}
        of_all = whole[0][0]
        if max(left.values()) > 1.0 or of_all.fault == "axes" or signs == set(of_all.channels):
            faults, left = [whole[0]], whole[1]
    for reading, _ in faults:
        raw, view = reading.of(raw), reading.of(view)
    read = replace(record, channels={name: raw[name] for name in record.channels}) if faults else record
    return [f for _, f in faults], read


def _chain(record: FlightRecord, card: Card, view: View, before: Misfits) -> tuple[list[Said], Misfits]:
    """Readings one after the other, the best first, while any mends what is refuted; none unless all are mended."""
    faults, mended, first = list[Said](), set[str](), before
    while len(faults) < 4 and any(value > 1.0 for value in before.values()):
        tried = [(reading, misfits(reading.of(view))) for reading in readings(view, card)]
        gains = [
            (_gain(before, after) if _own_factor(view, reading, before, after) else 0.0, reading, after)
            for reading, after in tried
        ]
        if not any(gain > 0.0 and "airspeed" in reading.channels for gain, reading, _ in gains):
            other = [(reading, misfits(reading.of(view))) for reading in _factors(view)]
            gains += [(_gain(before, after), reading, after) for reading, after in other]
        gain, best, after = max(gains, key=lambda tried: (tried[0], -len(tried[1].channels)))
        if gain <= 0.0:
            break
        alike, seen = [], {best.channels}
        for other, reading, _ in gains:
            if reading is best or not other > 0.0:
                continue
            apart = not set(reading.channels) & set(best.channels) and reading.channels not in seen
            if reading.rivals(best) or (apart and other > 0.85 * gain):
                seen.add(reading.channels)
                alike.append(reading)
        mended |= {*_mended(before, after)}
        faults.append((best, _finding(record, best, alike[:2], before, after)))
        view, before = best.of(view), after
    return (faults, before) if all(before[name] <= 1.0 for name in mended) else ([], first)


def _gain(before: Misfits, after: Misfits) -> float:
    """Logarithm of the misfit that is mended, over all relations; zero where none is, or another is spoiled."""
    if not _mended(before, after) or any(after[n] > max(1.0, WORSE * a) for n, a in before.items()):
        return 0.0
    return sum(np.log(max(min(a, 1e6), 0.3) / max(after[n], 0.3)) for n, a in before.items() if np.isfinite(after[n]))


def _mended(before: Misfits, after: Misfits) -> list[str]:
    """Relations that a reading mends; a mean of the lateral acceleration is a bias before it is anything else."""
    return [n for n, a in before.items() if n != "side" and a > 1.0 and after[n] < MENDED * a]


def _own_factor(view: View, reading: Reading, before: Misfits, after: Misfits) -> bool:
    """Whether the factor of a unit agrees with that which fits best: smaller numbers fit better than wrong ones."""
    if reading.factor == 1.0 or not _gain(before, after) > 0.0:
        return True
    names = [n for n in _mended(before, after) if after[n] != before[n]]
    speed = _speed_factor(view, SPEED & set(names)) if reading.channels == ("airspeed",) else None
    if speed is not None:  # 2 %: standard deviation of the scale of an airspeed in the right unit; assumed
        return bool(abs(speed[0] + np.log(reading.factor)) < 2.0 * np.hypot(0.02, speed[1]))
    unit, left = reading.changed(view), []
    for k in BESIDE:
        off = misfits({**view, **{n: np.exp(k) * x for n, x in unit.items()}}, names)
        left.append(sum(np.log(max(min(value, 1e6), 1e-6)) for value in off.values()))
    return bool(abs(BESIDE[np.argmin(left)]) < AGREES)


def _factors(view: View) -> list[Reading]:
    """The airspeed over the factor that fits best; or the altitude, where the altitude alone contradicts it."""
    names = misfits(view, SPEED).keys()
    speed = _speed_factor(view, names)
    if speed is None or abs(speed[0]) < max(0.10, 3.0 * speed[1]):
        return []
    factors = []
    for name, k in (("airspeed", speed[0]), ("altitude", -speed[0]))[: 2 if names == {"altitude"} else 1]:
        size, error = np.exp(k), np.exp(k) * speed[1]
        claim = f"is {size:.4g} +- {error:.1g} times what the other channels make of it (no unit explains it)"
        factors.append(scaled((name,), 1.0 / size, "factor", claim, f"correct {name} in the file"))
    return factors


def _speed_factor(view: View, names: Iterable[str]) -> tuple[float, float] | None:
    """Logarithm of the factor of the airspeed that fits best, and its standard error, by pieces of 5 s."""
    pieces = np.array_split(np.arange(len(view["time"])), max(4, round(np.ptp(view["time"]) / 5.0)))
    if not names or "airspeed" not in view or len(pieces[-1]) < SHORTEST:
        return None
    parts = [{name: x[piece] for name, x in view.items()} for piece in pieces]

    def left(k: float) -> np.ndarray:
        read = ({**part, "airspeed": np.exp(-k) * part["airspeed"]} for part in parts)
        return np.array([sum(min(x, 1e6) ** 2 for x in misfits(v, names).values()) for v in read])

    k = float(np.ravel(fminbound(lambda k: float(np.sum(left(k))), -WIDEST, WIDEST))[0])
    below, at, above = left(k - STEP), left(k), left(k + STEP)
    curve = float(np.sum(above - 2.0 * at + below)) / STEP**2
    error = np.sqrt(len(parts) / (len(parts) - 1) * np.sum(((above - below) / (2.0 * STEP)) ** 2))
    return k, float(error) / max(curve, 1e-12)


def _whole(record: FlightRecord, card: Card, view: View, before: Misfits) -> tuple[Said, Misfits] | None:
    """The signs and axes of all channels at once that alone explain the record, but for errors of scale."""
    # 500 samples, or those of 0.1 s, tell one sign from another.
    step = max(1, min(len(view["time"]) // 500, int(0.1 / np.median(np.diff(view["time"])))))
    few = {name: x[::step] for name, x in view.items()}
    sensors = {name: view[name] for name in record.channels if name in view}  # a constant of the card has no axes
    names = [n for n in TURNED if n in sensors]
    signs = np.array(list(product((1, -1), repeat=len(names))))
    turned = [terms_of({**few, name: -few[name]}) for name in names]
    odd = {  # of each relation, which terms (k, channels) count the other way with a channel
        relation: np.stack([np.sum(x * other[relation], axis=1) < 0.0 for other in turned], axis=1)
        for relation, x in terms_of(few).items()
    }
    # All ways to take the channels of an instrument for each other, and all signs.
    orders = [
        [dict(zip(kind, order, strict=True)) for order in (permutations(kind) if {*kind} <= sensors.keys() else [kind])]
        for kind in INSTRUMENTS.values()
    ]
    whole: list[tuple[float, float, Moves]] = []
    for accelerations, rates in product(*orders):
        order = {name: source for name, source in (accelerations | rates).items() if name in view}
        other = {**few, **{name: few[source] for name, source in order.items()}}
        strains = _strains(terms_of(other), odd, signs)
        score, worst = np.log1p(strains**2).sum(0), strains.max(0)
        for k in np.flatnonzero(score < min([score.min(), *(s for s, _, _ in whole)]) + ALIKE):
            pairs = {n: (order.get(n, n), int(sign)) for n, sign in zip(names, signs[k], strict=True)}
            whole.append((score[k], worst[k], {n: move for n, move in pairs.items() if move != (n, 1)}))
    least = min(score for score, _, _ in whole)
    # A fault costs a quarter of such a logarithm; axes are as many as two, beside single channels.
    alike, total = list[tuple[float, float, Moves]](), np.inf
    for score, worst, m in whole:
        if score < least + ALIKE and score + 0.25 * min(len(m), 2) < total + 0.2:  # else no axes make it the best
            alike.append((score + 0.25 * min(len(m), 2 + axes_of(m, sensors)[1]), worst, m))
            total = min(total, alike[-1][0])
    tied = sorted((it for it in alike if it[0] < total + 0.2), key=lambda it: len(it[2]))
    _, worst, moves = tied[0]
    reading, *others = (moved(card, sensors, m) for _, _, m in tied)
    # Beyond twice what noise and errors of scale make, a relation does not hold.
    if not moves or worst > 2.0 or (others and any(r.fault == "axes" for r in (reading, *others))):
        return None
    after = misfits(reading.of(view))
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


def _finding(
    record: FlightRecord, best: Reading, tied: list[Reading], before: Misfits, after: Misfits
) -> HealthFinding:
    name = max(_mended(before, after), key=lambda n: min(before[n], 1e6) / max(after[n], 0.05))
    relation = (RELATIONS | MEANS)[name]
    unit = "m/s^2 in the mean" if name in MEANS else {"altitude": "m", "airspeed": "m/s"}.get(name, "deg")
    scale = relation.allowed * (np.degrees(1.0) if unit == "deg" else 1.0)
    other = "".join(f", or {r.names} {r.looks}" for r in tied)
    why = (
        f": the {relation.noun} differs by {scale * before[name]:.3g} {unit} from what the other channels imply, and "
        f"by {scale * after[name]:.2g} once that is corrected"
    )
    mend = ", or ".join([best.mend, *(r.mend for r in tied if r.rivals(best))])
    return finding(record, best.channels[0], best.fault, (f"{best.names} {best.looks}{other}", why, mend))
