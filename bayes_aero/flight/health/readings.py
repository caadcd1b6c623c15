"""Other ways to read a channel - sign, unit, gravity, kind of airspeed - that the kinematics are tried with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health.across.kinematics import View
from bayes_aero.flight.health.finding import declared
from bayes_aero.flight.tolerances import GRAVITY
from bayes_aero.units import same_unit, to_si

_ANGLE, _RATE, _FORCE = ("deg", "rad"), ("deg/s", "rad/s"), ("m/s^2", "g", "ft/s^2")
UNITS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("phi", "theta", "psi", "alpha", "beta"), _ANGLE),
    **dict.fromkeys(("p", "q", "r"), _RATE),
    **dict.fromkeys(("ax", "ay", "az"), _FORCE),
    "airspeed": ("m/s", "kt", "km/h", "ft/s", "mph"),
    "altitude": ("m", "ft"),
    "time": ("s", "ms", "us", "ns", "min"),
}
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
    """The axes of both instruments or one that explain most of the moves, and how many channels remain.

    Returns:
        Words, and the number of channels that are to be read otherwise than the axes say.
    """
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
    """The record with channels taken for each other, or counting the other way.

    Axes are named where they say what as many wrong signs could not, or only with more of them.
    """
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
    yield from _gravity(card, recorded)
    yield from _kinds(view, recorded)


def scaled(names: tuple[str, ...], factor: float, fault: str, looks: str, mend: str) -> Reading:
    """Channels multiplied by a factor."""
    return Reading(names, fault, looks, mend, lambda view: {name: factor * view[name] for name in names})


def _units(group: tuple[str, ...], card: Card, view: View) -> Iterator[Reading]:
    of = {name: declared(card, name).unit for name in group}
    if len(set(of.values())) > 1:
        return
    if "az" in group and abs(np.log(max(float(np.median(np.abs(view["az"]))), 1e-9) / GRAVITY)) < ONE_G:
        return  # the unit explains the load factor of flight, and no other one does
    for unit in UNITS[group[0]]:
        factors = [_factor(name, unit, of[name]) for name in group]
        if not all(factors) or abs(np.log(factors[0])) < 0.1:  # type: ignore[arg-type]
            continue
        are = "is" if len(group) == 1 else "are"
        looks = f"{are} in {unit} and not in {of[group[0]]}, as the card says"
        mend = f'set unit = "{unit}" for {"it" if len(group) == 1 else "them"} on the card'
        yield replace(scaled(group, factors[0], "unit", looks, mend), factor=factors[0])  # type: ignore[arg-type]


def _factor(name: str, unit: str, declared_unit: str) -> float | None:
    """What the numbers inside must be multiplied by if the file is in `unit`; None where that is no news."""
    if same_unit(unit, declared_unit) is not False:
        return None
    standard = STANDARD_CHANNELS[name].unit
    return float(to_si(1.0, unit, name, standard) / to_si(1.0, declared_unit, name, standard))


def _gravity(card: Card, recorded: frozenset[str]) -> Iterator[Reading]:
    """Accelerations that inertial units give out: without gravity, one, some or all; the load factor less one."""
    if "theta" not in recorded:
        return
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
            looks = (
                f"{'has' if len(names) == 1 else 'have'} no part of gravity (acceleration, not specific force{unit})"
            )
            mend = f"write {', '.join(back[n][0] for n in names)} into the file"
            yield Reading(names, "gravity", looks, mend, put_back(names, factor))
    if "az" in have:
        for names in dict.fromkeys([("az",), have]):
            for sign, factor in product((1.0, -1.0), (1.0, GRAVITY)):
                yield _less_one(names, sign, factor, card)


def _less_one(names: tuple[str, ...], sign: float, factor: float, card: Card) -> Reading:
    """az as a load factor from which the one of level flight was taken; the others in g with it, or not."""
    others = tuple(n for n in names if n != "az")

    def applied(v: View) -> dict[str, np.ndarray]:
        rest = {n: factor * v[n] for n in others}
        return {**rest, "az": sign * factor * v["az"] - GRAVITY}

    unit = "in multiples of g" if factor != 1.0 else f"in {declared(card, 'az').unit}"
    turned = "positive upward" if sign < 0.0 else "positive downward"
    also = f" ({' and '.join(others)} in multiples of g, too)" if factor != 1.0 and others else ""
    looks = (
        f"is about zero in level flight, where gravity makes it -1 g: a load factor minus one, {turned}, {unit}{also}"
    )
    mend = 'add the one back in the file, and set unit = "g" and the sign on the card'
    return Reading(("az", *others), "gravity", looks, mend, applied, "az")


def _kinds(view: View, recorded: frozenset[str]) -> Iterator[Reading]:
    """Calibrated airspeed where true airspeed is meant."""
    ratio = thinness(view, recorded)
    if "airspeed" in recorded and ratio is not None and float(np.median(ratio)) < THIN:
        looks = (
            f"is calibrated (or indicated) airspeed: true airspeed is {1.0 / np.median(ratio):.3g} times as large at "
            "this density"
        )
        mend = "divide it by the square root of density over 1.225 kg/m^3 in the file, or map the true airspeed"
        yield Reading(
            ("airspeed",), "airspeed_kind", looks, mend, lambda v: {"airspeed": v["airspeed"] / ratio},
            factor=float(1.0 / np.median(ratio)),
        )  # fmt: skip


def thinness(view: View, recorded: frozenset[str]) -> np.ndarray | None:
    """Equivalent over true airspeed, (n,), from density, else from a standard atmosphere at the altitude."""
    if "density" in recorded and np.median(view["density"]) > 0.0:
        return np.sqrt(np.maximum(view["density"], 1e-3) / DENSITY0)
    if "altitude" in recorded:
        return np.maximum(1.0 - 2.25577e-5 * np.clip(view["altitude"], -1000.0, 11000.0), 0.1) ** 2.12794
    return None
