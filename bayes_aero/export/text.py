"""Sentences that every exported form has: origin, conventions, validity, what is left out."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import metadata

from bayes_aero.effect import Stage
from bayes_aero.errors import plain_line
from bayes_aero.export.identified import LEAST, Identified
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.physics.coefficient_names import LATERAL

CONVENTIONS = (
    "SI units and radians. Body axes x forward, y right, z down. CL and CD are lift and drag along the stability axes: "
    "CX = CL sin(alpha) - CD cos(alpha), CZ = -CL cos(alpha) - CD sin(alpha). CY is the side force along body y.",
    "Force = 0.5 density airspeed^2 wing_area coefficient. Moments are about the aerodynamic reference point.",
    "Surfaces: trailing edge down is positive, a rudder's to the left. aileron is half of right less left.",
)


def version() -> str:
    """The program and its version."""
    try:
        return f"bayes_aero {metadata.version('bayes-aero')}"
    except metadata.PackageNotFoundError:
        return "bayes_aero"


def lengths(found: Identified) -> tuple[str, ...]:
    """Reference lengths and speeds of rates and moments, with their values."""
    a = found.actual_aircraft
    rate, lateral = a.rate_length or a.chord, a.lateral_rate_length or a.half_span
    speed = "V" if a.reference_speed is None else f"{a.reference_speed:.6g} m/s"
    texts = [
        f"wing area {a.wing_area:.6g} m^2; Cm refers to the chord, {a.chord:.6g} m; q enters as q l/{speed} with "
        f"l = {rate:.6g} m (many texts: q c/2V)"
    ]
    if set(found.exported.coefficients) & set(LATERAL):
        texts.append(
            f"Cl and Cn refer to {a.moment_length:.6g} m; p and r enter as p l/{speed} with l = {lateral:.6g} m "
            f"(half the span is {a.half_span:.6g} m)"
        )
    x, y, z = a.reference_point
    texts.append(f"aerodynamic reference point {x:.6g}, {y:.6g}, {z:.6g} m from the centre of gravity, body axes")
    return tuple(f"{text[0].upper()}{text[1:]}." for text in texts)


def validity(found: Identified) -> tuple[str, ...]:
    """The flown range of every channel that the model reads."""
    flown = [n for n in found.signals if n in found.flown]
    if not flown:
        return ("The flown region is not stated: the values are a card's, or of an earlier version's result.",)
    parts = (f"{n} {found.flown[n][0]:.4g} to {found.flown[n][1]:.4g} {unit(n)}".rstrip(" 1") for n in flown)
    return (f"Flown region; outside it the model extrapolates: {', '.join(parts)}.",)


def states(found: Identified) -> tuple[str, ...]:
    """What is said of the separation point and of alpha-dot."""
    said = []
    if found.lagged:
        said.append(
            f"State {', '.join(found.points)}: the separation point (1 attached, 0 separated) follows its static "
            "value, lag dX/dt = X_static - X; it starts at the static value."
        )
    elif found.separates:
        said.append(f"{', '.join(found.points)}: the separation point (1 attached, 0 separated), without lag.")
    before = (Stage.INCIDENCE, Stage.SEPARATION)
    reading = [e for e in found.exported.acting if "alpha_dot" in e.channels]
    if any(e.stage not in before or not found.lagged for e in reading):
        said.append(
            "The coefficients depend on alpha_dot at the same instant, and alpha_dot on them: a simulator solves the "
            "equation, or takes alpha_dot through a lag of a few steps."
        )
    return tuple(said)


def at_rest(found: Identified) -> tuple[str, ...]:
    """Where the model stops following the signals that it divides by."""
    floors = [
        f"{name} below {LEAST[name]:g} {unit(name)}" for name in found.program.inputs_of("signal") if name in LEAST
    ]
    if not floors:
        return ()
    return (f"Coefficients are finite at rest: {' and '.join(floors)} counts as that value.",)


def about(found: Identified) -> tuple[str, ...]:
    """All of them, a sentence or two each."""
    drawn = found.draws
    uncertain = (
        () if drawn is None else (f"{len(drawn.values)} draws of {len(drawn.names)} parameters: {drawn.origin}.",)
    )
    sentences = (
        f"{found.title}. Exported by {version()}.",
        *found.sources,
        *CONVENTIONS,
        *lengths(found),
        *states(found),
        *validity(found),
        *at_rest(found),
        *uncertain,
        *found.left_out,
    )
    return tuple(map(plain_line, sentences))


def unit(channel: str) -> str:
    """The SI unit of a channel; empty where the program does not know it."""
    return STANDARD_CHANNELS[channel].unit if channel in STANDARD_CHANNELS else ""


def meaning(channel: str) -> str:
    """What a channel is."""
    return STANDARD_CHANNELS[channel].description if channel in STANDARD_CHANNELS else "input of an effect"


def wrapped(sentences: Sequence[str], width: int) -> str:
    """Paragraphs of lines that are no longer than `width`."""
    import textwrap

    return "\n".join(textwrap.fill(s, width) for s in sentences)
