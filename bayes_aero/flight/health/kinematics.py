"""Rigid-body kinematics between recorded channels, and the signs, axes, units and gravity that they refute."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import fminbound

from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import unit_choices
from bayes_aero.flight.health import Findings, HealthFinding, channels_of, declared, found, other_units
from bayes_aero.flight.record import FlightRecord
from bayes_aero.physics.aircraft import GRAVITY, Axis, standard_air
from bayes_aero.physics.kinematics import (
    PATH_NEEDS,
    STRAIGHT,
    down_of,
    euler_rates,
    motion_over_ground,
)

# --- What each channel's rate of change must be (`physics.kinematics`), without aerodynamics; the distance of the
# accelerometer from the centre of gravity is neglected, and the wind is steady.

View = Mapping[str, np.ndarray]
Misfits = dict[str, float]
LINEAR = ("p", "q", "r", "ax", "ay", "az", "x", "y", "z")
"""What the rates of change are linear in: rates, specific force, and the components of gravity along the body axes."""


class Relation(NamedTuple):
    """Channels that must be recorded, what of `LINEAR` the rate has, and the misfit, SI, that sound records stay below
    after a constant and a drift are taken out, in pieces of `piece` s where errors of the rate add up too fast."""

    needs: tuple[str, ...]
    parts: tuple[str, ...]
    allowed: float
    piece: float = np.inf


_AIR = ("airspeed", "alpha", "theta", "ax", "az")
_TURNS, _SLIPS = ("p", "q", "r", "ax", "az", "x", "z"), ("p", "r", "ax", "ay", "az", "x", "y", "z")
RELATIONS: dict[str, Relation] = {
    "theta": Relation(("theta", "q"), ("q", "r"), np.deg2rad(1.0)),
    "phi": Relation(("phi", "p", "q", "theta"), ("p", "q", "r"), np.deg2rad(2.0)),
    "psi": Relation(("psi", "q", "r", "theta"), ("q", "r"), np.deg2rad(3.0)),
    "altitude": Relation(("altitude", "airspeed", "theta", "alpha"), ("x", "y", "z"), 6.0),
    "airspeed": Relation(_AIR, LINEAR[3:], 2.0),
    "alpha": Relation((*_AIR, "q"), _TURNS, np.deg2rad(1.0), 10.0),
    "beta": Relation(("beta", "r", "ay", "phi", *_AIR), _SLIPS, np.deg2rad(1.5), 10.0),
}
MEANS = {  # m/s2: biases of .5 deg/s at 100 m/s and .6 m/s2; of .3 deg/s and .4 m/s2, or 2.5 deg of the bank angle
    "level": Relation((*_AIR, "q"), _TURNS, 1.5),
    "side": Relation(("ay", "r", "phi", *_AIR), _SLIPS, 0.9),
}
"""The mean normal and lateral acceleration, which the rate of alpha and of beta times the airspeed must make."""
SHORTEST = 25  # samples of a piece
TURN, FOLLOWS = np.deg2rad(3.0), 0.2
"""rad that the rates must turn the aircraft by, and the share of it within which a heading stands still."""
SIDESLIP = 0.1  # rad that sideslip may have changed by where it was not recorded
SCALE = 0.3  # error of scale that a sensor in the right unit may have; our choice


def view_of(record: FlightRecord, card: Card) -> dict[str, np.ndarray]:
    """Channels, constants and time of a record, with zeros for what symmetric flight lacks."""
    return dict.fromkeys(STRAIGHT, np.zeros(record.n)) | channels_of(record, card) | {"time": record.time}


def rates_of(view: View, only: str | None = None) -> dict[str, np.ndarray]:
    """Rate of change of each channel, (n,), NaN where something is missing; `only` the part due to one of `LINEAR`."""
    n = len(view["time"])
    v = {name: view.get(name, np.full(n, np.nan)) for name in PATH_NEEDS}
    inputs = v | dict(zip("xyz", down_of(v["phi"], v["theta"]), strict=True))
    part = {name: inputs[name] if only in (None, name) else np.zeros(n) for name in LINEAR}
    p, q, r, *forces = part.values()
    force, down = (forces[0], forces[1], forces[2]), (forces[3], forces[4], forces[5])
    with np.errstate(all="ignore"):
        angles = zip(("phi", "theta", "psi"), euler_rates((p, q, r), v["phi"], v["theta"]), strict=True)
        v |= part
        return motion_over_ground(v, force, down) | dict(angles)


def dead_heading(view: View) -> bool:
    """Whether the heading stands still while the rates turn the aircraft; `time`, phi, theta, q, r and psi are read."""
    turn = integrated(rates_of(view)["psi"], view["time"])
    return bool(np.ptp(turn) > TURN and np.ptp(view["psi"]) < FOLLOWS * np.ptp(turn))


def misfits(view: View, recorded: frozenset[str], names: frozenset[str] | None = None) -> Misfits:
    """How far each relation (or those of `names`) that has its channels is from what is allowed: 1 is the limit."""
    off = {name: terms.sum(0) for name, terms in terms_of(view, recorded, names, (None,)).items()}
    sizes = {name: float(np.sqrt(np.mean(np.minimum(np.abs(x), 1e9) ** 2))) for name, x in off.items()}
    return {name: sizes[name] if np.isfinite(x).all() else np.inf for name, x in off.items()}


def terms_of(
    view: View,
    recorded: frozenset[str],
    names: frozenset[str] | None = None,
    parts: Sequence[str | None] = LINEAR,
) -> dict[str, np.ndarray]:
    """Terms (k, n) whose sum a relation leaves, over what is allowed: the channel, and what each of `parts` makes."""
    by_part, time, terms = {part: rates_of(view, part) for part in parts}, view["time"], {}
    with np.errstate(all="ignore"):
        for name, relation in (RELATIONS | MEANS).items():
            if not set(relation.needs) <= recorded or (names is not None and name not in names):
                continue
            rates = [rates for part, rates in by_part.items() if part is None or part in relation.parts]
            if name in MEANS:
                terms[name] = _mean_terms(name, view, recorded, rates)
                continue
            pieces = min(max(round((time[-1] - time[0]) / relation.piece), 1), len(time) // SHORTEST)
            each = [view[name], *(-integrated(rate[name], time) for rate in rates)]
            left = (np.concatenate([*map(without_drift, np.array_split(x, pieces))]) for x in each)
            terms[name] = np.stack([*left]) / relation.allowed
    return terms


def _mean_terms(name: str, view: View, recorded: frozenset[str], rates: Sequence[View]) -> np.ndarray:
    """Mean accelerations (k, 1) that each part makes, and what the flow turns by, over what is allowed."""
    V, time, channel = view["airspeed"], view["time"], "alpha" if name == "level" else "beta"
    terms = [np.mean(V * rate[channel]) for rate in rates]
    if channel in recorded:
        x = view[channel]
        terms.append(-np.mean(V) * float(np.median(x[-9:]) - np.median(x[:9])) / float(time[-1] - time[0]))
    elif np.mean(V) * SIDESLIP >= MEANS["side"].allowed / 3.0 * float(time[-1] - time[0]):
        return np.zeros((1, 1))
    return np.array(terms)[:, None] / MEANS[name].allowed


def side_bias(view: View, recorded: frozenset[str]) -> float:
    """Mean lateral acceleration beyond what bank, turn and sideslip make, m/s2; zero where sideslip leaves it open."""
    return MEANS["side"].allowed * float(_mean_terms("side", view, recorded, [rates_of(view)]).sum())


def integrated(rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    """The integral of a (n,) rate over time, by the trapezium rule, zero at first."""
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (rate[:-1] + rate[1:]))])


def without_drift(x: np.ndarray) -> np.ndarray:
    """Less its best straight line: an unknown initial value, and a bias of the rate or steady vertical wind."""
    t = np.linspace(-1.0, 1.0, len(x))
    return x - x.mean() - t * float(t @ x) / float(t @ t)


# --- Other ways to read a channel - sign, unit, gravity, kind of airspeed - that the kinematics are tried with.

INSTRUMENTS = {"accelerations": ("ax", "ay", "az"), "rates": ("p", "q", "r")}
ATTITUDE, FLOW = ("phi", "theta", "psi"), ("alpha", "beta")
GROUPS = (INSTRUMENTS["rates"], INSTRUMENTS["accelerations"], ATTITUDE, FLOW)
"""Channels of one instrument, which share their unit."""
SINGLE = (*ATTITUDE, *FLOW, "p", "q", "r", "ax", "ay", "az", "airspeed", "altitude", "time")
SIGNS = ("p", "q", "r", *ATTITUDE, *FLOW, "ax", "ay", "az", "altitude")
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
FRAMES = tuple(
    (order, signs)
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
    if np.linalg.det(np.eye(3)[list(order)]) * np.prod(signs) > 0.0
)
"""All right-handed axes of a file: the program's axis i is `signs[i]` times the file's axis `order[i]`."""


def orders(kind: str, recorded: frozenset[str]) -> Iterator[dict[str, str]]:
    """All ways to take the channels of an instrument for each other: where each is to be read."""
    names = INSTRUMENTS[kind]
    for order in permutations(names) if set(names) <= recorded else [names]:
        yield {name: source for name, source in zip(names, order, strict=True) if name in recorded}


def axes_of(moves: Moves, recorded: frozenset[str]) -> tuple[str, int]:
    """The axes that explain most of the moves, in words, and how many channels they do not explain."""
    kinds = tuple(kind for kind, names in INSTRUMENTS.items() if recorded & {*names})
    angles = {n for n in moves if n in (*ATTITUDE, *FLOW)}
    more = min(len(angles ^ (turned & recorded)) for turned in ANGLES)
    best = ("", len(moves) + 1)
    for of in dict.fromkeys([kinds, *((kind,) for kind in kinds)]):
        for order, signs in FRAMES:
            sources = {}
            for kind in of:
                names = INSTRUMENTS[kind]
                sources |= {n: (names[j], sign) for n, j, sign in zip(names, order, signs, strict=True)}
            by_frame = {n: x for n, x in sources.items() if n in recorded and x != (n, 1)}
            have = (n for kind in kinds for n in INSTRUMENTS[kind] if n in recorded)
            rest = more + sum(by_frame.get(n) != moves.get(n) for n in have)
            if by_frame and rest < best[1]:
                points = {j: AXES[i][sign < 0] for i, (j, sign) in enumerate(zip(order, signs, strict=True))}
                named = ", ".join(f"{axis} {points[j]}" for j, axis in enumerate("xyz"))
                best = (f"the axes of the {of[0] if len(of) == 1 else 'sensors'} are {named}", rest)
    return best


def moved(card: Card, recorded: frozenset[str], moves: Moves) -> Reading:
    """Channels taken for each other, or counting the other way; axes where they say what as many signs could not."""
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
    if evident:
        turned = turned and f"{turned} {count}"
        fault, looks = "axes", f"({'; '.join(x for x in (turned, exchanged and f'{exchanged} of the card') if x)})"
    else:
        fault, looks = ("exchanged", "are exchanged") if exchanged else ("sign", count)
        looks += f" (as where {axes})" if axes else ""
        looks += f" ({exchanged} of the card{f'; {turned} {count}' if turned else ''})" if exchanged else ""
    return Reading(
        tuple(moves), fault, looks, f"{place}write {write} on the card",
        lambda view: {name: sign * view[source] for name, (source, sign) in moves.items()},
        axes if evident else ", ".join(moves),
    )  # fmt: skip


def readings(view: View, card: Card, recorded: frozenset[str]) -> Iterator[Reading]:
    """All other ways to read what was recorded."""
    for name in SIGNS:
        if name in recorded:
            sign = -declared(card, name).sign
            yield scaled((name,), -1.0, "sign", "counts the other way", f"write sign = {sign} at {name} on the card")
    for group in [(name,) for name in SINGLE] + [tuple(n for n in group if n in recorded) for group in GROUPS]:
        if group and set(group) <= recorded:
            yield from _units(group, card, view)
    if "theta" in recorded:
        yield from _gravity(card, recorded)
    ratio = thinness(view, recorded)
    if "airspeed" in recorded and ratio is not None and float(np.median(ratio)) < THIN:
        times = float(1.0 / np.median(ratio))
        looks = f"is calibrated (or indicated) airspeed: true airspeed is {times:.3g} times as large at this density"
        mend = "divide it by the square root of density over 1.225 kg/m^3 in the file, or map the true airspeed"
        yield Reading(
            ("airspeed",), "airspeed_kind", looks, mend, lambda v: {"airspeed": v["airspeed"] / ratio}, factor=times
        )


def scaled(names: tuple[str, ...], factor: float, fault: str, looks: str, mend: str) -> Reading:
    """Channels multiplied by a factor."""
    return Reading(names, fault, looks, mend, lambda view: {name: factor * view[name] for name in names})


def _units(group: tuple[str, ...], card: Card, view: View) -> Iterator[Reading]:
    of = {name: declared(card, name).unit for name in group}
    if len(set(of.values())) > 1:
        return
    if "az" in group and abs(np.log(max(float(np.median(np.abs(view["az"]))), 1e-9) / GRAVITY)) < ONE_G:
        return  # the unit explains the load factor of flight, and no other one does
    are, them = ("is", "it") if len(group) == 1 else ("are", "them")
    for unit, factor in other_units(card, group[0], unit_choices(group[0])):
        if abs(np.log(factor)) >= 0.1:
            looks = f"{are} in {unit} and not in {of[group[0]]}, as the card says"
            mend = f'set unit = "{unit}" for {them} on the card'
            yield replace(scaled(group, factor, "unit", looks, mend), factor=factor)


def _gravity(card: Card, recorded: frozenset[str]) -> Iterator[Reading]:
    """Accelerations that inertial units give out: without gravity, one, some or all; the load factor less one."""
    have = tuple(n for n in ("ax", "ay", "az") if n in recorded)
    back = {"ax": "ax + g sin(theta)", "ay": "ay - g cos(theta) sin(phi)", "az": "az - g cos(theta) cos(phi)"}

    def put_back(names: tuple[str, ...], factor: float) -> Callable[[View], dict[str, np.ndarray]]:
        def applied(v: View) -> dict[str, np.ndarray]:
            down = dict(zip(back, down_of(v["phi"], v["theta"]), strict=True))
            return {n: factor * v[n] - GRAVITY * down[n] for n in names}

        return applied

    for names in dict.fromkeys([*((n,) for n in have), have]):
        for factor, unit in ((1.0, ""), (GRAVITY, ", and in multiples of g")):
            has = "has" if len(names) == 1 else "have"
            looks = f"{has} no part of gravity (acceleration, not specific force{unit})"
            mend = f"write {', '.join(back[n] for n in names)} into the file"
            yield Reading(names, "gravity", looks, mend, put_back(names, factor))
    for names in dict.fromkeys([("az",), have]) if "az" in have else ():
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
    return np.sqrt(standard_air(view["altitude"])[0] / DENSITY0) if "altitude" in recorded else None


# --- What the record is to be read as: the readings that mend what is refuted, and spoil nothing else.

OFF = 0.10  # departure that no weather and no sensor makes, as a logarithm
MENDED = 0.4  # of its misfit a relation may keep under the reading that is said to be right
WORSE = 1.3  # times its misfit another relation may have there, if it is above the limit then
TIED = 0.15  # of the best gain: readings that nearly gain as much cannot be told from the best
MOST = 4  # faults of one record
BESIDE = np.linspace(-0.18, 0.18, 19)  # logarithms beside a unit's factor, among which the record's own is sought
FEW, SLOW = 500, 0.1  # samples and s between them that tell one sign from another
ALIKE = 2.0  # logarithms of misfits within which ways to read the record may be as good as the best
FAULT, FRAME = 0.25, 2  # of these logarithms that a fault costs, and faults that axes cost
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


def refuted(record: FlightRecord, card: Card) -> tuple[list[HealthFinding], FlightRecord]:
    """A finding for each channel or frame that must be read in another way; and the record as it is to be read."""
    if record.n < 50:
        return [], record
    raw = view_of(record, card)
    view = dict(raw)  # without isolated spikes, dropouts and the jumps of an angle, which other checks report
    for name in set(raw) - {"time"}:
        steps = np.diff(raw[name], prepend=raw[name][0])
        turned = raw[name][0] + np.cumsum(np.where(np.abs(steps) > JUMP, 0.0, steps))
        view[name] = median_filter(turned if name in ("psi", "phi") else raw[name], 5, mode="nearest")
    recorded = frozenset(record.channels) | {"time"} | frozenset(card.constants)
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
    """Readings one after the other, the best first, while any mends what is refuted; none unless all are mended."""
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
    """Logarithm of the factor of the airspeed that fits best, and its standard error, by pieces of the record."""
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
        faults = min(len(m), FRAME + axes_of(m, have)[1])  # axes are as many as two, beside single channels
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
    """Whether the factor of a unit agrees with that which fits best: smaller numbers fit better than wrong ones."""
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
    """The mean lateral acceleration that no other reading explains, unless the card states it or bank is in doubt."""
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
        scale, unit = MEANS[relation].allowed, "m/s^2 in the mean"
    else:
        unit = {"altitude": "m", "airspeed": "m/s"}.get(relation, "deg")
        scale = RELATIONS[relation].allowed * (np.degrees(1.0) if unit == "deg" else 1.0)
    sentence = (
        f"{best.names} {best.looks}{other}: the {NOUNS[relation]} differs by {scale * before[relation]:.3g} {unit} "
        f"from what the other channels imply, and by {scale * after[relation]:.2g} once that is corrected; {mend}"
    )
    return found(record, best.channels[0], best.fault, sentence, at=(0, record.n - 1))
