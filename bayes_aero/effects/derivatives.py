"""Rows of aerodynamic derivatives that are linear in what they multiply, and sources that several effects have."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Signals, Stage, effect
from bayes_aero.parameter import Parameter
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.physics.kinematics import reduced, reduced_lateral, speed_ratio

DERIVATIVE = "a linear aerodynamic derivative; textbook form"
EVEN_TERM = "lowest even term of a Taylor series, by symmetry; our choice of form"
MACH_TERM = "first term of a Taylor series in Mach number; our choice of form"
RELATIVE_ERROR = "definition of a relative error"
STALL_MODEL = "Jategaonkar 2015, ch. 12, Kirchhoff stall model"
HFB_320 = "Jategaonkar 2015, longitudinal model of the HFB 320"
ATTAS = "the ATTAS stall model as published with the data of Jategaonkar 2015"
SEPARATED_SHARE = "derivative linear in the separated share 1 - X; our choice of form"
OUR_WIDTH = "our choice of width"  # of a prior


class Regressor(NamedTuple):
    """What a derivative multiplies: how formulas write it, its signals, the product with a coefficient, how the worked
    example writes the numbers (the last signal of a rate is the airspeed), and what the formula says of it."""

    symbol: str
    signals: tuple[str, ...]
    times: Callable[[Any, Signals, Aircraft], Any]
    by_hand: str = "{0:g} x {1:g}, by hand"
    remark: str = ""


def _deflection(symbol: str, channel: str) -> Regressor:
    return Regressor(symbol, (channel,), lambda c, s, _: c * s[channel])


def _rate(channel: str) -> Regressor:
    return Regressor(
        f"{channel} c/V", (channel, "airspeed"), lambda c, s, a: reduced(c * s[channel], s["airspeed"], a),
        "{0:g} x {1:g} x 3/{2:g}, by hand, chord 3 m", "; length and speed as `reduced` has them",
    )  # fmt: skip


def _lateral_rate(channel: str) -> Regressor:
    return Regressor(
        f"{channel} b/2V", (channel, "airspeed"), lambda c, s, a: reduced_lateral(c * s[channel], s["airspeed"], a),
        "{0:g} x {1:g} x 10/{2:g}, by hand, half span 10 m", "; length and speed as `reduced_lateral` has them",
    )  # fmt: skip


def _mean(surface: str) -> Regressor:
    left, right = f"{surface}_left", f"{surface}_right"
    return Regressor(
        "(left + right)/2", (left, right), lambda c, s, _: c * 0.5 * (s[left] + s[right]),
        "{0:g} x ({1:g} + {2:g})/2, by hand",
    )  # fmt: skip


SYMBOLS = {
    "alpha": "alpha", "beta": "beta", "mach": "Mach", "elevator": "de", "stabilizer": "ih", "canard": "canard",
    "flap": "flap", "aileron": "da", "rudder": "dr",
}  # fmt: skip
REGRESSORS = {
    "1": Regressor("", ("alpha",), lambda c, s, _: c + xp.zeros_like(s["alpha"]), "by definition"),
    **{channel: _deflection(symbol, channel) for channel, symbol in SYMBOLS.items()},
    **{channel: _rate(channel) for channel in ("q", "alpha_dot")},
    **{channel: _lateral_rate(channel) for channel in ("p", "r")},
    "dlc": _mean("dlc"),
    "spoilers": _mean("spoiler"),
    "spoiler difference": Regressor(
        "(right - left)/2", ("spoiler_left", "spoiler_right"),
        lambda c, s, _: c * 0.5 * (s["spoiler_right"] - s["spoiler_left"]), "{0:g} x ({2:g} - {1:g})/2, by hand",
    ),
    "alpha beta": Regressor(
        "alpha beta", ("alpha", "beta"), lambda c, s, _: c * s["alpha"] * s["beta"], "{0:g} x {1:g} x {2:g}, by hand",
    ),
    "beta^2": Regressor(
        "beta^2", ("beta",), lambda c, s, _: c * s["beta"] * s["beta"], "{0:g} x ({1:g})^2, by hand",
        ": even in beta, for the aircraft is symmetric",
    ),
    "beta^3": Regressor(
        "beta^3", ("beta",), lambda c, s, _: c * s["beta"] * s["beta"] * s["beta"], "{0:g} x ({1:g})^3, by hand",
        ": odd in beta, for the aircraft is symmetric",
    ),
    "speed": Regressor(
        "V/V0", ("airspeed",), lambda c, s, a: c * speed_ratio(s["airspeed"], a),
        "{0:g} x {1:g}/100, by hand, V0 100 m/s",
        "; V0 is the card's reference_speed, or 100 m/s where the card names none. A stand-in, at one altitude, for "
        "Mach number, thrust and elasticity alike, so diagnosis never proposes it",
    ),
}  # fmt: skip


def derivative(
    name: str,
    claim: str,
    output: str,
    by: str,
    own: tuple[Parameter, tuple[float, float]],
    example: tuple[float, ...],
    *,
    remark: str = "",
    source: str = DERIVATIVE,
    stage: Stage = Stage.ATTACHED,
    candidate: bool = True,
    separated: str = "",
) -> Effect:
    """`output` += parameter (`own`) x regressor (`by`), or x (1 - X) where `separated`: X of the example, as it is
    written. `example`: value of the parameter, of each signal and of the output. `remark`: more of the formula."""
    coefficient, r = own[0].name, REGRESSORS[by]
    value, *signals, result = example
    by_hand, symbol, known = r.by_hand.format(*example), r.symbol, None
    if separated:
        above, _, below = separated.partition("/")
        known = {"X": float(above) / float(below or 1)}
        share = f" x (1 - {separated})"
        by_hand = f"{value:g}{share}, by hand" if by == "1" else by_hand.replace(" x ", f"{share} x ", 1)
        symbol, stage = f"(1 - X) {symbol}", Stage.TOTAL
        source = SEPARATED_SHARE if source == DERIVATIVE else source
    given = dict(zip(r.signals, signals, strict=True))
    return effect(
        name,
        claim,
        f"{output} += {coefficient} {symbol}".rstrip() + f"{remark}{r.remark}.",
        lambda v, s, a, flow: {
            output: r.times(v[coefficient] * (1.0 - flow["X"]) if separated else v[coefficient], s, a)
        },
        own,
        example=Example({coefficient: value}, given, {output: result}, by_hand, known),
        source=source,
        stage=stage,
        together=len(r.signals) > 1 and by in ("dlc", "spoilers", "spoiler difference"),
        candidate=candidate,
    )
