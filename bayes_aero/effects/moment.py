"""Effects on the pitching moment."""

from __future__ import annotations

import math
from typing import Any

from bayes_aero.arrays import xp
from bayes_aero.effect import Example, Increments, Stage, effect, parameter
from bayes_aero.effects.derivatives import ATTAS, EVEN_TERM, HFB_320, MACH_TERM, STALL_MODEL, derivative
from bayes_aero.parameter import Length, Limits, Prior, Sign
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.physics.kinematics import reduced

# Entries are packed; one argument a line would make the module twice as long:
# effect(name, claim, formula, increments, *parameters, ...); parameter(name, unit, description, prior, sizes, bounds).
# fmt: off

# Static stability and damping.

PITCHING_MOMENT = effect(
    "pitching_moment", "The aircraft has a static pitching moment that changes linearly with the angle of attack.",
    "Cm += Cm0 + Cma alpha.",
    lambda v, s, *_: {"Cm": v["Cm0"] + v["Cma"] * s["alpha"]},
    parameter("Cm0", "1", "pitching moment at zero angle of attack", Prior("normal", 0.0, 0.2), (0.002, 0.3),
        start=0.05, place=31),
    parameter("Cma", "1/rad", "static stability", Prior("normal", -0.5, 1.0), (0.02, 3.0), start=-0.5, place=32),
    example=Example({"Cm0": 0.05, "Cma": -0.5}, {"alpha": 0.2}, {"Cm": -0.05}, "0.05 - 0.5 x 0.2, by hand"),
    source=STALL_MODEL,
)

ALPHA_SQUARED_MOMENT = effect(
    "alpha_squared_moment", "The pitching moment is curved over the angle of attack.",
    "Cm += Cma2 alpha^2.",
    lambda v, s, *_: {"Cm": v["Cma2"] * s["alpha"] * s["alpha"]},
    parameter("Cma2", "1/rad^2", "pitching moment per squared angle of attack", Prior("normal", 0.0, 5.0), (0.3, 10.0)),
    example=Example({"Cma2": -1.5}, {"alpha": 0.2}, {"Cm": -0.06}, "-1.5 x 0.2^2, by hand"),
    source="second term of a Taylor series; our choice of form", stage=Stage.TOTAL,
)

PITCH_DAMPING = effect(
    "pitch_damping", "Pitch rate is damped by a pitching moment.",
    "Cm += Cmq q c/V (not q c/2V, so Cmq is half of what many texts print); length and speed as `reduced` has them.",
    lambda v, s, a, _: {"Cm": reduced(v["Cmq"] * s["q"], s["airspeed"], a)},
    parameter("Cmq", "1", "pitch damping, per q c/V", Prior("normal", -8.0, 10.0), (1.0, 30.0), start=-8.0,
        lengths=(Length.RATE,), limits=Limits(-math.inf, 0.0, "pitch rate would not be damped"), place=33),
    example=Example({"Cmq": -6.0}, {"q": 0.1, "airspeed": 60.0}, {"Cm": -0.03}, "by hand, chord 3 m"),
    source=f"{ATTAS} (qhat = q c/V)",
)

ALPHA_DOT_MOMENT = derivative(
    "alpha_dot_moment",
    "A changing angle of attack pitches the aircraft: downwash needs time to reach the tail.", "Cm", "alpha_dot",
    parameter("Cmadot", "1", "pitching moment due to alpha-dot, per alpha_dot c/V", Prior("normal", 0.0, 10.0),
        (1.0, 20.0), lengths=(Length.RATE,)),
    (-4.0, 0.05, 60.0, -0.01), stage=Stage.TOTAL,
)

# Controls.


def with_tail_lift(derivative: Any, deflection: Any, a: Aircraft) -> Increments:
    """Pitching moment of a surface at the tail, and the lift of the force that makes it at the tail arm."""
    lift = -derivative * a.chord / a.tail_arm
    return {"Cm": derivative * deflection, "CL_attached": lift * deflection}


ELEVATOR_MOMENT = effect(
    "elevator_moment", "The elevator pitches the aircraft (trailing edge down is positive, so Cmde < 0).",
    "Cm += Cmde de; CL_attached += CLde de with CLde = -Cmde c/l_tail (force at the tail arm makes the moment).",
    lambda v, s, a, _: with_tail_lift(v["Cmde"], s["elevator"], a),
    parameter("Cmde", "1/rad", "elevator effectiveness", Prior("normal", -0.8, 1.0), (0.03, 3.0), start=-0.8,
        sign=Sign(-1, "elevator", "a positive deflection (trailing edge down) would pitch the nose up"), place=34),
    example=Example({"Cmde": -0.5}, {"elevator": 0.1}, {"Cm": -0.05, "CL_attached": 0.05 * 3.0 / 15.0},
        "by hand, chord 3 m and tail arm 15 m"),
    source=ATTAS,
)

STABILIZER_TRIM = effect(
    "stabilizer_trim", "The stabilizer was trimmed during the manoeuvre and pitches the aircraft.",
    "Cm += Cmih ih; CL_attached += CLih ih with CLih = -Cmih c/l_tail, as for the elevator.",
    lambda v, s, a, _: with_tail_lift(v["Cmih"], s["stabilizer"], a),
    parameter("Cmih", "1/rad", "stabilizer effectiveness", Prior("normal", 0.0, 2.5), (0.1, 5.0)),
    example=Example({"Cmih": -2.0}, {"stabilizer": -0.03}, {"Cm": 0.06, "CL_attached": -0.012},
        "-2 x -0.03, and -0.06 x 3/15; by hand, chord 3 m and tail arm 15 m"),
    source="a force at the tail arm makes the moment, by geometry",
)

CANARD_MOMENT = derivative(
    "canard_moment", "The canard pitches the aircraft (trailing edge down is positive, so Cmdc > 0).", "Cm", "canard",
    parameter("Cmdc", "1/rad", "canard effectiveness", Prior("normal", 0.0, 1.0), (0.03, 3.0)),
    (0.6, 0.1, 0.06), remark=": ahead of the centre of gravity, trailing edge down pitches up",
)

FLAP_MOMENT = derivative(
    "flap_moment", "The landing flaps pitch the aircraft.", "Cm", "flap",
    parameter("Cmdf", "1/rad", "pitching moment per flap deflection", Prior("normal", 0.0, 0.5), (0.02, 1.0)),
    (-0.2, 0.3, -0.06), stage=Stage.TOTAL,
)

DLC_MOMENT = derivative(
    "dlc_moment", "The direct-lift flaps pitch the aircraft.", "Cm", "dlc",
    parameter("Cmdlc", "1/rad", "pitching moment per mean deflection of the direct-lift flaps",
        Prior("normal", 0.0, 0.5), (0.02, 1.0)),
    (-0.2, 0.1, 0.2, -0.03), stage=Stage.TOTAL,
)

SPOILER_MOMENT = derivative(
    "spoiler_moment", "The spoilers pitch the aircraft.", "Cm", "spoilers",
    parameter("Cmds", "1/rad", "pitching moment per mean deflection of the spoilers", Prior("normal", 0.0, 0.5),
        (0.02, 1.0)),
    (0.3, 0.0, 0.2, 0.03), stage=Stage.TOTAL,
)

RUDDER_MOMENT = effect(
    "rudder_moment", "Rudder deflection pitches the aircraft.",
    "Cm += Cmdr |dr|: even in dr, for the aircraft is symmetric.",
    lambda v, s, *_: {"Cm": v["Cmdr"] * xp.abs(s["rudder"])},
    parameter("Cmdr", "1/rad", "pitching moment per rudder deflection", Prior("normal", 0.0, 0.25), (0.04, 0.5)),
    example=Example({"Cmdr": 0.1}, {"rudder": -0.04}, {"Cm": 0.004}, "0.1 x 0.04, by hand"),
    source="even in the deflection by symmetry; our choice of form", stage=Stage.TOTAL,
)

# Speed and sideslip.

MACH_MOMENT = derivative(
    "mach_moment", "The pitching moment changes with Mach number.", "Cm", "mach",
    parameter("CmM", "1", "pitching moment per Mach number", Prior("normal", 0.0, 0.25), (0.02, 0.5)),
    (0.2, 0.25, 0.05), source=MACH_TERM, stage=Stage.TOTAL,
)

SPEED_MOMENT = derivative(
    "speed_moment", "The pitching moment coefficient changes with airspeed.", "Cm", "speed",
    parameter("CmV", "1", "pitching moment per V/V0", Prior("normal", 0.0, 0.3), (0.01, 0.5)),
    (-0.1, 80.0, -0.08), source=HFB_320, stage=Stage.TOTAL, candidate=False,
)

SIDESLIP_MOMENT = derivative(
    "sideslip_moment", "Sideslip pitches the aircraft.", "Cm", "beta^2",
    parameter("Cmb2", "1/rad^2", "pitching moment per sideslip squared", Prior("normal", 0.0, 5.0), (0.4, 10.0)),
    (-2.0, 0.1, -0.02), source=EVEN_TERM, stage=Stage.TOTAL,
)
