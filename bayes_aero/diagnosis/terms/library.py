"""Terms that nobody listed: products, breaks, bumps, what acts in separated flow alone, memory.

A term is a product of factors. A factor is a nondimensional quantity of the flight, a function of the angle of attack,
the separated share 1 - X, or a quantity as it was some chords ago.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_aero.flight.health.finding import noise_of
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.physics.kinematics import reduced, reduced_lateral

Signals = Mapping[str, Any]
ORDER = 3  # most factors of a product
BREAKS = tuple(k / 20.0 for k in range(1, 20))  # quantiles of alpha or beta at which its effect may break
BUMPS = tuple(k / 10.0 for k in range(1, 10))  # and at which it may have a bump
WIDTHS = (0.07, 0.12, 0.2)  # of a bump, shares of the range
CLEAR = 3.0  # standard deviations of its noise; nearer to zero, noise decides the sign and makes a dead band
LAGS = (5.0, 15.0, 40.0)  # chords travelled, time constants of memory


@dataclass(frozen=True)
class TermFactor:
    """A quantity x of which terms are products."""

    name: str
    code: str | None  # expression of signals `s`, aircraft `a`, `known` in an effect file; None where it has a state
    channels: tuple[str, ...]
    evaluate: Callable[[Signals, Aircraft], Float[np.ndarray, " n"]]
    lateral: bool = False  # it changes sign with the wings
    cost: int = 1  # counts as so many factors where two terms are equally good
    unit: str = "1"


@dataclass(frozen=True)
class ProductTerm:
    """A product of factors, those of several powers repeated."""

    factors: tuple[TermFactor, ...]

    @property
    def name(self) -> str:
        """The product as it is reported: `alpha^2 elevator`."""
        names = list(dict.fromkeys(f.name for f in self.factors))
        powers = [sum(f.name == name for f in self.factors) for name in names]
        return " ".join(name if k == 1 else f"{name}^{k}" for name, k in zip(names, powers, strict=True))

    @property
    def unit(self) -> str:
        """Unit of the number that the product is multiplied by, as every coefficient has none."""
        power = sum(f.unit == "rad" for f in self.factors)
        return "1" if power == 0 else "1/rad" if power == 1 else f"1/rad^{power}"

    @property
    def cost(self) -> int:
        """How long it is: of equally good terms the shortest is reported."""
        return sum(f.cost for f in self.factors)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that it reads."""
        return tuple(dict.fromkeys(c for f in self.factors for c in f.channels))

    @property
    def code(self) -> str | None:
        """The expression in an effect file; None where a factor has a state."""
        codes = [f.code for f in self.factors]
        return None if None in codes else " * ".join(codes)  # pyright: ignore[reportArgumentType, reportCallIssue]

    def evaluate(self, signals: Signals, aircraft: Aircraft) -> Float[np.ndarray, " n"]:
        """The product, one value a sample."""
        return np.prod([f.evaluate(signals, aircraft) for f in self.factors], axis=0)


def _channel(name: str, *, lateral: bool = False) -> TermFactor:
    unit = "1" if name == "mach" else "rad"
    return TermFactor(name, f's["{name}"]', (name,), lambda s, _: np.asarray(s[name]), lateral, unit=unit)


def _rate(name: str, channel: str, *, lateral: bool = False) -> TermFactor:
    by = reduced_lateral if lateral else reduced
    code = f'{by.__name__}(s["{channel}"], s["airspeed"], a)'
    return TermFactor(
        name, code, (channel, "airspeed"), lambda s, a: np.asarray(by(s[channel], s["airspeed"], a)), lateral
    )


THRUST = TermFactor(
    "CT",
    's["thrust"] / (0.5 * s["density"] * s["airspeed"] ** 2 * a.wing_area)',
    ("thrust", "density", "airspeed"),
    lambda s, a: np.asarray(s["thrust"] / (0.5 * s["density"] * s["airspeed"] ** 2 * a.wing_area)),
)
SEPARATED = TermFactor("(1 - X)", '(1.0 - known["X"])', (), lambda s, _: 1.0 - np.asarray(s["X"]))
QUANTITIES = (
    _channel("alpha"), _rate("qhat", "q"), _channel("elevator"), _channel("stabilizer"), _channel("flap"),
    _channel("spoiler"), _channel("dlc"), _channel("canard"), _channel("mach"), THRUST,
    _channel("beta", lateral=True), _rate("phat", "p", lateral=True), _rate("rhat", "r", lateral=True),
    _channel("aileron", lateral=True), _channel("rudder", lateral=True),
)  # fmt: skip
MEMORY = ("alpha", "beta", "elevator", "aileron", "rudder")
"""Quantities of which the past may matter. Not a rate: with its past it is its own derivative, which is the moment."""
CURVED = ("alpha", "beta")  # quantities whose own effect may break; that of alpha may have a bump


def _beyond(quantity: TermFactor, at: float) -> str:
    return f"{quantity.name} {'-' if at >= 0.0 else '+'} {abs(at):g}"


def _break(quantity: TermFactor, at: float) -> TermFactor:
    """What the quantity is beyond a value, on either side if `lateral`: its slope is another one there."""
    own, lateral = quantity.code, quantity.lateral
    code = f"xp.maximum({f'xp.abs({own})' if lateral else own} - {at!r}, 0.0)"
    name = f"max({_beyond(quantity, at)}, 0)"
    if lateral:
        name, code = f"sign({quantity.name}) max(|{quantity.name}| - {at:g}, 0)", f"xp.sign({own}) * {code}"

    def evaluate(s: Signals, a: Aircraft) -> Float[np.ndarray, " n"]:
        x = quantity.evaluate(s, a)
        return np.sign(x) * np.maximum(np.abs(x) - at, 0.0) if lateral else np.maximum(x - at, 0.0)

    return TermFactor(name, code, quantity.channels, evaluate, lateral, 2, quantity.unit)


def _bump(quantity: TermFactor, at: float, width: float) -> TermFactor:
    code = f"xp.exp(-0.5 * (({quantity.code} - {at!r}) / {width!r}) ** 2)"
    name = f"exp(-(({_beyond(quantity, at)})/{width:g})^2/2)"
    return TermFactor(
        name, code, quantity.channels,
        lambda s, a: np.exp(-0.5 * ((quantity.evaluate(s, a) - at) / width) ** 2), quantity.lateral, 3,
    )  # fmt: skip


def _lagged(quantity: TermFactor, chords: float) -> TermFactor:
    """The quantity as a first-order lag of so many chords passes it, at the median airspeed."""

    def evaluate(s: Signals, a: Aircraft) -> Float[np.ndarray, " n"]:
        from scipy.signal import lfilter  # slow to load, and `check` needs none

        x, first = quantity.evaluate(s, a), np.unique(np.asarray(s["first"]))
        dt, speed = float(np.median(np.asarray(s["dt"]))), float(np.median(np.asarray(s["airspeed"])))
        keep = np.exp(-dt * speed / (chords * a.chord))
        parts = np.split(x, first[1:].astype(int))
        return np.concatenate([lfilter([1.0 - keep], [1.0, -keep], p, zi=[keep * p[0]])[0] for p in parts])

    return TermFactor(
        f"lag({quantity.name}, {chords:g} c/V)", None, quantity.channels, evaluate, quantity.lateral, 2, quantity.unit
    )


def library(
    signals: Signals, aircraft: Aircraft, able: Callable[[str], bool], *, lateral: bool, separated: bool
) -> tuple[ProductTerm, ...]:
    """Terms of a coefficient that these flights can tell, which change sign with the wings as it does (`lateral`).

    `signals` are those of all flights end to end, `X` and the marks of manoeuvres among them, each (n,); `able` says
    whether a channel was recorded and moves, `separated` whether the flow separates.
    """
    quantities = [q for q in QUANTITIES if all(map(able, q.channels))]
    factors = [*quantities, *([SEPARATED] if separated else [])]
    found = [ProductTerm(t) for k in range(1, ORDER + 1) for t in combinations_with_replacement(factors, k)]
    terms = [t for t in found if t.factors.count(SEPARATED) <= 1]
    for q in quantities:
        x = q.evaluate(signals, aircraft)
        if q.name in CURVED:
            least = CLEAR * noise_of(*np.split(x, np.unique(np.asarray(signals["first"]))[1:].astype(int)))
            places = [at for at in _places(np.abs(x), BREAKS) if at > least] if q.lateral else _places(x, BREAKS)
            terms += [ProductTerm((_break(q, at),)) for at in places]
        if q.name in CURVED and not q.lateral:
            reach = float(np.ptp(np.quantile(x, (0.02, 0.98))))
            widths = [float(np.round(share * reach, 4)) for share in WIDTHS]
            terms += [ProductTerm((_bump(q, at, w),)) for at in _places(x, BUMPS) for w in widths if w > 0.0]
        if q.name in MEMORY:
            terms += [ProductTerm((_lagged(q, chords),)) for chords in LAGS]
    return tuple(t for t in terms if (sum(f.lateral for f in t.factors) % 2 == 1) == lateral)


def _places(x: Float[np.ndarray, " n"], shares: Sequence[float]) -> list[float]:
    """Quantiles of x, rounded to what is worth reporting."""
    return list(dict.fromkeys(float(np.round(q, 3)) for q in np.quantile(x, shares)))
