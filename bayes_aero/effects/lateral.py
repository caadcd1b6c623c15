"""Effects on side force, rolling moment and yawing moment."""

from __future__ import annotations

import math

from bayes_aero.arrays import xp
from bayes_aero.effect import Example, effect, parameter
from bayes_aero.effects.sources import DERIVATIVE, OUR_WIDTH
from bayes_aero.parameter import Length, Limits, Prior, Sign
from bayes_aero.physics.rates import reduced_lateral

CONSTANT_TERM = "constant term of a Taylor series; textbook form"
ODD_TERM = "lowest odd term beyond the linear one, by symmetry; our choice of form"

MOMENT = (Length.LATERAL_MOMENT,)
RATE = (Length.LATERAL_RATE,)
MOMENT_AND_RATE = (*MOMENT, *RATE)


def nelson(values: str) -> str:
    """Source of a prior."""
    return f"jet transports of Nelson 1998, app. B, have some {values}; the width is our choice"


# Rows of a table, packed, for with one argument a line it would be twice as long:
# effect(name, claim, formula, increments, *parameters, ...); parameter(name, unit, description, prior, sizes, bounds).
# fmt: off

# Side force.

SIDE_FORCE_OFFSET = effect(
    "side_force_offset", "The aircraft has a side force in straight symmetric flight.",
    "CY += CY0.",
    lambda v, s, *_: {"CY": v["CY0"] + xp.zeros_like(s["alpha"])},
    parameter(
        "CY0", "1", "side force of symmetric flight", Prior("normal", 0.0, 0.02, OUR_WIDTH), (0.004, 0.05), place=51,
    ),
    example=Example({"CY0": 0.01}, {"alpha": 0.1}, {"CY": 0.01}, "by definition"),
    source=CONSTANT_TERM,
)

SIDESLIP_SIDE_FORCE = effect(
    "sideslip_side_force", "Sideslip to the right pushes the aircraft to the left.",
    "CY += CYbe beta.",
    lambda v, s, *_: {"CY": v["CYbe"] * s["beta"]},
    parameter(
        "CYbe", "1/rad", "side force per sideslip", Prior("normal", -0.8, 1.0, nelson("-0.7 to -1.0")), (0.06, 2.0),
        start=-0.8, sign=Sign(-1, "beta", "sideslip to the right would pull the aircraft further to the right"),
        place=52,
    ),
    example=Example({"CYbe": -0.8}, {"beta": 0.05}, {"CY": -0.04}, "-0.8 x 0.05, by hand"),
    source=DERIVATIVE,
)

ROLL_RATE_SIDE_FORCE = effect(
    "roll_rate_side_force", "Roll rate makes side force, at the fin above all.",
    "CY += CYp p b/2V; length and speed as `reduced_lateral` has them.",
    lambda v, s, a, _: {"CY": reduced_lateral(v["CYp"] * s["p"], s["airspeed"], a)},
    parameter(
        "CYp", "1", "side force per p b/2V", Prior("normal", 0.0, 0.6, OUR_WIDTH), (0.15, 1.5), lengths=RATE, place=53,
    ),
    example=Example(
        {"CYp": 0.2}, {"p": 0.3, "airspeed": 60.0}, {"CY": 0.01}, "0.2 x 0.3 x 10/60, by hand, half span 10 m",
    ),
    source=DERIVATIVE,
)

YAW_RATE_SIDE_FORCE = effect(
    "yaw_rate_side_force", "Yaw rate makes side force, at the fin above all.",
    "CY += CYr r b/2V; length and speed as `reduced_lateral` has them.",
    lambda v, s, a, _: {"CY": reduced_lateral(v["CYr"] * s["r"], s["airspeed"], a)},
    parameter(
        "CYr", "1", "side force per r b/2V", Prior("normal", 0.0, 1.0, OUR_WIDTH), (0.4, 2.0), lengths=RATE, place=54,
    ),
    example=Example(
        {"CYr": 0.6}, {"r": 0.1, "airspeed": 60.0}, {"CY": 0.01}, "0.6 x 0.1 x 10/60, by hand, half span 10 m",
    ),
    source=DERIVATIVE,
)

AILERON_SIDE_FORCE = effect(
    "aileron_side_force", "The ailerons make side force.",
    "CY += CYda da.",
    lambda v, s, *_: {"CY": v["CYda"] * s["aileron"]},
    parameter(
        "CYda", "1/rad", "side force per aileron deflection, half of right less left",
        Prior("normal", 0.0, 0.15, OUR_WIDTH), (0.04, 0.4), place=55,
    ),
    example=Example({"CYda": 0.05}, {"aileron": -0.1}, {"CY": -0.005}, "0.05 x -0.1, by hand"),
    source=DERIVATIVE,
)

RUDDER_SIDE_FORCE = effect(
    "rudder_side_force", "The rudder makes side force (trailing edge left is positive, so CYdr > 0).",
    "CY += CYdr dr.",
    lambda v, s, *_: {"CY": v["CYdr"] * s["rudder"]},
    parameter(
        "CYdr", "1/rad", "side force per rudder deflection", Prior("normal", 0.2, 0.3, nelson("0.18")), (0.06, 0.8),
        start=0.2, sign=Sign(1, "rudder", "a positive deflection (trailing edge left) would push the fin to the left"),
        place=56,
    ),
    example=Example({"CYdr": 0.2}, {"rudder": 0.1}, {"CY": 0.02}, "0.2 x 0.1, by hand"),
    source=DERIVATIVE,
)

# Rolling moment.

ROLL_OFFSET = effect(
    "roll_offset",
    "The aircraft has a rolling moment in straight symmetric flight; ailerons with a wrong zero show one, too.",
    "Cl += Cl0.",
    lambda v, s, *_: {"Cl": v["Cl0"] + xp.zeros_like(s["alpha"])},
    parameter(
        "Cl0", "1", "rolling moment of symmetric flight", Prior("normal", 0.0, 0.003, OUR_WIDTH), (0.0005, 0.01),
        lengths=MOMENT, place=61,
    ),
    example=Example({"Cl0": 0.001}, {"alpha": 0.1}, {"Cl": 0.001}, "by definition"),
    source=CONSTANT_TERM,
)

SIDESLIP_ROLL = effect(
    "sideslip_roll", "Sideslip to the right rolls the aircraft to the left (dihedral effect).",
    "Cl += Clbe beta.",
    lambda v, s, *_: {"Cl": v["Clbe"] * s["beta"]},
    parameter(
        "Clbe", "1/rad", "dihedral effect, rolling moment per sideslip",
        Prior("normal", -0.1, 0.2, nelson("-0.1 to -0.2")), (0.007, 0.5), start=-0.1, lengths=MOMENT,
        sign=Sign(-1, "beta", "sideslip to the right would roll the aircraft to the right"), place=62,
    ),
    example=Example({"Clbe": -0.1}, {"beta": 0.05}, {"Cl": -0.005}, "-0.1 x 0.05, by hand"),
    source=DERIVATIVE,
)

ROLL_DAMPING = effect(
    "roll_damping", "Roll rate is damped by a rolling moment.",
    "Cl += Clp p b/2V; length and speed as `reduced_lateral` has them.",
    lambda v, s, a, _: {"Cl": reduced_lateral(v["Clp"] * s["p"], s["airspeed"], a)},
    parameter(
        "Clp", "1", "roll damping, per p b/2V", Prior("normal", -0.4, 0.4, nelson("-0.4 to -0.5")), (0.025, 1.5),
        start=-0.4, lengths=MOMENT_AND_RATE,
        limits=Limits(-math.inf, 0.0, "roll rate would not be damped in attached flow"), place=63,
    ),
    example=Example(
        {"Clp": -0.4}, {"p": 0.3, "airspeed": 60.0}, {"Cl": -0.02}, "-0.4 x 0.3 x 10/60, by hand, half span 10 m",
    ),
    source=DERIVATIVE,
)

YAW_RATE_ROLL = effect(
    "yaw_rate_roll", "Yaw rate rolls the aircraft, for the outer wing is faster.",
    "Cl += Clr r b/2V; length and speed as `reduced_lateral` has them.",
    lambda v, s, a, _: {"Cl": reduced_lateral(v["Clr"] * s["r"], s["airspeed"], a)},
    parameter(
        "Clr", "1", "rolling moment per r b/2V", Prior("normal", 0.1, 0.3, nelson("0.1")), (0.05, 1.0), start=0.1,
        lengths=MOMENT_AND_RATE, place=64,
    ),
    example=Example(
        {"Clr": 0.12}, {"r": 0.1, "airspeed": 60.0}, {"Cl": 0.002}, "0.12 x 0.1 x 10/60, by hand, half span 10 m",
    ),
    source=DERIVATIVE,
)

AILERON_ROLL = effect(
    "aileron_roll", "The ailerons roll the aircraft (right one down is positive, so Clda < 0).",
    "Cl += Clda da.",
    lambda v, s, *_: {"Cl": v["Clda"] * s["aileron"]},
    parameter(
        "Clda", "1/rad", "aileron effectiveness, per half of right less left", Prior("normal", -0.1, 0.2, OUR_WIDTH),
        (0.005, 0.6), start=-0.1, lengths=MOMENT,
        sign=Sign(-1, "aileron", "a positive deflection (right aileron down) would roll the aircraft to the right"),
        place=65,
    ),
    example=Example({"Clda": -0.12}, {"aileron": 0.1}, {"Cl": -0.012}, "-0.12 x 0.1, by hand"),
    source=DERIVATIVE,
)

RUDDER_ROLL = effect(
    "rudder_roll", "The rudder rolls the aircraft, for the fin lies above the roll axis.",
    "Cl += Cldr dr.",
    lambda v, s, *_: {"Cl": v["Cldr"] * s["rudder"]},
    parameter(
        "Cldr", "1/rad", "rolling moment per rudder deflection", Prior("normal", 0.0, 0.05, OUR_WIDTH), (0.007, 0.15),
        lengths=MOMENT, place=66,
    ),
    example=Example({"Cldr": 0.02}, {"rudder": -0.1}, {"Cl": -0.002}, "0.02 x -0.1, by hand"),
    source=DERIVATIVE,
)

SPOILER_ROLL = effect(
    "spoiler_roll", "Spoilers of one side roll the aircraft to that side.",
    "Cl += Clds (right - left)/2.",
    lambda v, s, *_: {"Cl": v["Clds"] * 0.5 * (s["spoiler_right"] - s["spoiler_left"])},
    parameter(
        "Clds", "1/rad", "rolling moment per half of right less left spoiler", Prior("normal", 0.0, 0.1, OUR_WIDTH),
        (0.003, 0.3), lengths=MOMENT, place=67,
    ),
    example=Example(
        {"Clds": 0.1}, {"spoiler_left": 0.0, "spoiler_right": 0.2}, {"Cl": 0.01}, "0.1 x (0.2 - 0)/2, by hand",
    ),
    source=DERIVATIVE, together=True,
)

SIDESLIP_ALPHA_ROLL = effect(
    "sideslip_alpha_roll",
    "The dihedral effect grows with the angle of attack, as that of a swept wing does with lift.",
    "Cl += Clbea alpha beta.",
    lambda v, s, *_: {"Cl": v["Clbea"] * s["alpha"] * s["beta"]},
    parameter(
        "Clbea", "1/rad^2", "change of the dihedral effect per angle of attack", Prior("normal", 0.0, 1.0, OUR_WIDTH),
        (0.07, 3.0), lengths=MOMENT, place=68,
    ),
    example=Example({"Clbea": -0.5}, {"alpha": 0.2, "beta": 0.05}, {"Cl": -0.005}, "-0.5 x 0.2 x 0.05, by hand"),
    source="next term of a Taylor series; the dihedral effect of sweep is proportional to lift, as textbooks derive",
)

SIDESLIP_CUBED_ROLL = effect(
    "sideslip_cubed_roll", "The dihedral effect is not linear in large sideslip.",
    "Cl += Clbe3 beta^3: odd in beta, for the aircraft is symmetric.",
    lambda v, s, *_: {"Cl": v["Clbe3"] * s["beta"] * s["beta"] * s["beta"]},
    parameter(
        "Clbe3", "1/rad^3", "rolling moment per sideslip cubed", Prior("normal", 0.0, 5.0, OUR_WIDTH), (0.2, 20.0),
        lengths=MOMENT, place=69,
    ),
    example=Example({"Clbe3": 2.0}, {"beta": 0.1}, {"Cl": 0.002}, "2 x (0.1)^3, by hand"),
    source=ODD_TERM,
)

# Yawing moment.

YAW_OFFSET = effect(
    "yaw_offset", "The aircraft has a yawing moment in straight symmetric flight.",
    "Cn += Cn0.",
    lambda v, s, *_: {"Cn": v["Cn0"] + xp.zeros_like(s["alpha"])},
    parameter(
        "Cn0", "1", "yawing moment of symmetric flight", Prior("normal", 0.0, 0.003, OUR_WIDTH), (0.0005, 0.01),
        lengths=MOMENT, place=71,
    ),
    example=Example({"Cn0": -0.001}, {"alpha": 0.1}, {"Cn": -0.001}, "by definition"),
    source=CONSTANT_TERM,
)

SIDESLIP_YAW = effect(
    "sideslip_yaw", "Sideslip turns the nose into the wind (directional stability).",
    "Cn += Cnbe beta.",
    lambda v, s, *_: {"Cn": v["Cnbe"] * s["beta"]},
    parameter(
        "Cnbe", "1/rad", "directional stability, yawing moment per sideslip",
        Prior("normal", 0.14, 0.2, nelson("0.14 to 0.15")), (0.007, 0.5), start=0.14, lengths=MOMENT,
        sign=Sign(1, "beta", "sideslip would turn the nose away from the wind"), place=72,
    ),
    example=Example({"Cnbe": 0.14}, {"beta": 0.05}, {"Cn": 0.007}, "0.14 x 0.05, by hand"),
    source=DERIVATIVE,
)

ROLL_RATE_YAW = effect(
    "roll_rate_yaw", "Roll rate yaws the aircraft, for it tilts the lift of either wing.",
    "Cn += Cnp p b/2V; length and speed as `reduced_lateral` has them.",
    lambda v, s, a, _: {"Cn": reduced_lateral(v["Cnp"] * s["p"], s["airspeed"], a)},
    parameter(
        "Cnp", "1", "yawing moment per p b/2V", Prior("normal", -0.1, 0.2, nelson("-0.1 to -0.2")), (0.025, 0.6),
        start=-0.1, lengths=MOMENT_AND_RATE, place=73,
    ),
    example=Example(
        {"Cnp": -0.12}, {"p": 0.3, "airspeed": 60.0}, {"Cn": -0.006}, "-0.12 x 0.3 x 10/60, by hand, half span 10 m",
    ),
    source=DERIVATIVE,
)

YAW_DAMPING = effect(
    "yaw_damping", "Yaw rate is damped by a yawing moment.",
    "Cn += Cnr r b/2V; length and speed as `reduced_lateral` has them.",
    lambda v, s, a, _: {"Cn": reduced_lateral(v["Cnr"] * s["r"], s["airspeed"], a)},
    parameter(
        "Cnr", "1", "yaw damping, per r b/2V", Prior("normal", -0.2, 0.3, nelson("-0.16 to -0.3")), (0.05, 1.2),
        start=-0.2, lengths=MOMENT_AND_RATE, limits=Limits(-math.inf, 0.0, "yaw rate would not be damped"), place=74,
    ),
    example=Example(
        {"Cnr": -0.24}, {"r": 0.1, "airspeed": 60.0}, {"Cn": -0.004}, "-0.24 x 0.1 x 10/60, by hand, half span 10 m",
    ),
    source=DERIVATIVE,
)

AILERON_YAW = effect(
    "aileron_yaw", "The ailerons yaw the aircraft (where Cnda > 0, away from the turn: adverse yaw).",
    "Cn += Cnda da.",
    lambda v, s, *_: {"Cn": v["Cnda"] * s["aileron"]},
    parameter(
        "Cnda", "1/rad", "yawing moment per aileron deflection, half of right less left",
        Prior("normal", 0.0, 0.05, OUR_WIDTH), (0.005, 0.15), lengths=MOMENT, place=75,
    ),
    example=Example({"Cnda": 0.01}, {"aileron": 0.1}, {"Cn": 0.001}, "0.01 x 0.1, by hand"),
    source=DERIVATIVE,
)

RUDDER_YAW = effect(
    "rudder_yaw", "The rudder yaws the aircraft (trailing edge left is positive, so Cndr < 0).",
    "Cn += Cndr dr.",
    lambda v, s, *_: {"Cn": v["Cndr"] * s["rudder"]},
    parameter(
        "Cndr", "1/rad", "rudder effectiveness", Prior("normal", -0.1, 0.15, nelson("-0.06 to -0.11")), (0.007, 0.4),
        start=-0.1, lengths=MOMENT,
        sign=Sign(-1, "rudder", "a positive deflection (trailing edge left) would turn the nose to the right"),
        place=76,
    ),
    example=Example({"Cndr": -0.1}, {"rudder": 0.1}, {"Cn": -0.01}, "-0.1 x 0.1, by hand"),
    source=DERIVATIVE,
)

SPOILER_YAW = effect(
    "spoiler_yaw", "Spoilers of one side yaw the aircraft to that side.",
    "Cn += Cnds (right - left)/2.",
    lambda v, s, *_: {"Cn": v["Cnds"] * 0.5 * (s["spoiler_right"] - s["spoiler_left"])},
    parameter(
        "Cnds", "1/rad", "yawing moment per half of right less left spoiler", Prior("normal", 0.0, 0.05, OUR_WIDTH),
        (0.003, 0.15), lengths=MOMENT, place=77,
    ),
    example=Example(
        {"Cnds": 0.02}, {"spoiler_left": 0.1, "spoiler_right": 0.0}, {"Cn": -0.001}, "0.02 x (0 - 0.1)/2, by hand",
    ),
    source=DERIVATIVE, together=True,
)

SIDESLIP_ALPHA_YAW = effect(
    "sideslip_alpha_yaw",
    "Directional stability fades with the angle of attack, as the wake of wing and body reaches the fin.",
    "Cn += Cnbea alpha beta.",
    lambda v, s, *_: {"Cn": v["Cnbea"] * s["alpha"] * s["beta"]},
    parameter(
        "Cnbea", "1/rad^2", "change of directional stability per angle of attack", Prior("normal", 0.0, 1.0, OUR_WIDTH),
        (0.07, 3.0), lengths=MOMENT, place=78,
    ),
    example=Example({"Cnbea": -0.4}, {"alpha": 0.25, "beta": 0.05}, {"Cn": -0.005}, "-0.4 x 0.25 x 0.05, by hand"),
    source="next term of a Taylor series; our choice of form",
)

SIDESLIP_CUBED_YAW = effect(
    "sideslip_cubed_yaw", "Directional stability is not linear in large sideslip.",
    "Cn += Cnbe3 beta^3: odd in beta, for the aircraft is symmetric.",
    lambda v, s, *_: {"Cn": v["Cnbe3"] * s["beta"] * s["beta"] * s["beta"]},
    parameter(
        "Cnbe3", "1/rad^3", "yawing moment per sideslip cubed", Prior("normal", 0.0, 5.0, OUR_WIDTH), (0.2, 20.0),
        lengths=MOMENT, place=79,
    ),
    example=Example({"Cnbe3": -2.0}, {"beta": 0.1}, {"Cn": -0.002}, "-2 x (0.1)^3, by hand"),
    source=ODD_TERM,
)
