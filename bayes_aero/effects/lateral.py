"""Effects on side force, rolling moment and yawing moment."""

from __future__ import annotations

import math

from bayes_aero.effect import parameter
from bayes_aero.effects.derivatives import OUR_WIDTH, derivative
from bayes_aero.parameter import Length, Limits, Prior, Sign

CONSTANT_TERM = "constant term of a Taylor series; textbook form"
ODD_TERM = "lowest odd term beyond the linear one, by symmetry; our choice of form"

MOMENT = (Length.LATERAL_MOMENT,)
RATE = (Length.LATERAL_RATE,)
MOMENT_AND_RATE = (*MOMENT, *RATE)


def nelson(values: str) -> str:
    """Source of a prior."""
    return f"jet transports of Nelson 1998, app. B, have some {values}; the width is our choice"


# Entries are packed; one argument a line would make the module twice as long:
# effect(name, claim, formula, increments, *parameters, ...); parameter(name, unit, description, prior, sizes, bounds).
# fmt: off

# Side force.

SIDE_FORCE_OFFSET = derivative(
    "side_force_offset", "The aircraft has a side force in straight symmetric flight.", "CY", "1",
    parameter("CY0", "1", "side force of symmetric flight", Prior("normal", 0.0, 0.02, OUR_WIDTH), (0.004, 0.05),
        place=51),
    (0.01, 0.1, 0.01), source=CONSTANT_TERM,
)

SIDESLIP_SIDE_FORCE = derivative(
    "sideslip_side_force", "Sideslip to the right pushes the aircraft to the left.", "CY", "beta",
    parameter("CYbe", "1/rad", "side force per sideslip", Prior("normal", -0.8, 1.0, nelson("-0.7 to -1.0")),
        (0.06, 2.0), start=-0.8,
        sign=Sign(-1, "beta", "sideslip to the right would pull the aircraft further to the right"), place=52),
    (-0.8, 0.05, -0.04),
)

ROLL_RATE_SIDE_FORCE = derivative(
    "roll_rate_side_force", "Roll rate makes side force, at the fin above all.", "CY", "p",
    parameter("CYp", "1", "side force per p b/2V", Prior("normal", 0.0, 0.6, OUR_WIDTH), (0.15, 1.5), lengths=RATE,
        place=53),
    (0.2, 0.3, 60.0, 0.01),
)

YAW_RATE_SIDE_FORCE = derivative(
    "yaw_rate_side_force", "Yaw rate makes side force, at the fin above all.", "CY", "r",
    parameter("CYr", "1", "side force per r b/2V", Prior("normal", 0.0, 1.0, OUR_WIDTH), (0.4, 2.0), lengths=RATE,
        place=54),
    (0.6, 0.1, 60.0, 0.01),
)

AILERON_SIDE_FORCE = derivative(
    "aileron_side_force", "The ailerons make side force.", "CY", "aileron",
    parameter("CYda", "1/rad", "side force per aileron deflection, half of right less left",
        Prior("normal", 0.0, 0.15, OUR_WIDTH), (0.04, 0.4), place=55),
    (0.05, -0.1, -0.005),
)

RUDDER_SIDE_FORCE = derivative(
    "rudder_side_force", "The rudder makes side force (trailing edge left is positive, so CYdr > 0).", "CY", "rudder",
    parameter("CYdr", "1/rad", "side force per rudder deflection", Prior("normal", 0.2, 0.3, nelson("0.18")),
        (0.06, 0.8), start=0.2,
        sign=Sign(1, "rudder", "a positive deflection (trailing edge left) would push the fin to the left"), place=56),
    (0.2, 0.1, 0.02),
)

# Rolling moment.

ROLL_OFFSET = derivative(
    "roll_offset",
    "The aircraft has a rolling moment in straight symmetric flight; ailerons with a wrong zero show one, too.",
    "Cl", "1",
    parameter("Cl0", "1", "rolling moment of symmetric flight", Prior("normal", 0.0, 0.003, OUR_WIDTH), (0.0005, 0.01),
        lengths=MOMENT, place=61),
    (0.001, 0.1, 0.001), source=CONSTANT_TERM,
)

SIDESLIP_ROLL = derivative(
    "sideslip_roll", "Sideslip to the right rolls the aircraft to the left (dihedral effect).", "Cl", "beta",
    parameter("Clbe", "1/rad", "dihedral effect, rolling moment per sideslip",
        Prior("normal", -0.1, 0.2, nelson("-0.1 to -0.2")), (0.007, 0.5), start=-0.1, lengths=MOMENT,
        sign=Sign(-1, "beta", "sideslip to the right would roll the aircraft to the right"), place=62),
    (-0.1, 0.05, -0.005),
)

ROLL_DAMPING = derivative(
    "roll_damping", "Roll rate is damped by a rolling moment.", "Cl", "p",
    parameter("Clp", "1", "roll damping, per p b/2V", Prior("normal", -0.4, 0.4, nelson("-0.4 to -0.5")), (0.025, 1.5),
        start=-0.4, lengths=MOMENT_AND_RATE,
        limits=Limits(-math.inf, 0.0, "roll rate would not be damped in attached flow"), place=63),
    (-0.4, 0.3, 60.0, -0.02),
)

YAW_RATE_ROLL = derivative(
    "yaw_rate_roll", "Yaw rate rolls the aircraft, for the outer wing is faster.", "Cl", "r",
    parameter("Clr", "1", "rolling moment per r b/2V", Prior("normal", 0.1, 0.3, nelson("0.1")), (0.05, 1.0), start=0.1,
        lengths=MOMENT_AND_RATE, place=64),
    (0.12, 0.1, 60.0, 0.002),
)

AILERON_ROLL = derivative(
    "aileron_roll", "The ailerons roll the aircraft (right one down is positive, so Clda < 0).", "Cl", "aileron",
    parameter("Clda", "1/rad", "aileron effectiveness, per half of right less left",
        Prior("normal", -0.1, 0.2, OUR_WIDTH), (0.005, 0.6), start=-0.1, lengths=MOMENT,
        sign=Sign(-1, "aileron", "a positive deflection (right aileron down) would roll the aircraft to the right"),
        place=65),
    (-0.12, 0.1, -0.012),
)

RUDDER_ROLL = derivative(
    "rudder_roll", "The rudder rolls the aircraft, for the fin lies above the roll axis.", "Cl", "rudder",
    parameter("Cldr", "1/rad", "rolling moment per rudder deflection", Prior("normal", 0.0, 0.05, OUR_WIDTH),
        (0.007, 0.15), lengths=MOMENT, place=66),
    (0.02, -0.1, -0.002),
)

SPOILER_ROLL = derivative(
    "spoiler_roll", "Spoilers of one side roll the aircraft to that side.", "Cl", "spoiler difference",
    parameter("Clds", "1/rad", "rolling moment per half of right less left spoiler",
        Prior("normal", 0.0, 0.1, OUR_WIDTH), (0.003, 0.3), lengths=MOMENT, place=67),
    (0.1, 0.0, 0.2, 0.01),
)

SIDESLIP_ALPHA_ROLL = derivative(
    "sideslip_alpha_roll",
    "The dihedral effect grows with the angle of attack, as that of a swept wing does with lift.", "Cl", "alpha beta",
    parameter("Clbea", "1/rad^2", "change of the dihedral effect per angle of attack",
        Prior("normal", 0.0, 1.0, OUR_WIDTH), (0.07, 3.0), lengths=MOMENT, place=68),
    (-0.5, 0.2, 0.05, -0.005),
    source="next term of a Taylor series; the dihedral effect of sweep is proportional to lift, as textbooks derive",
)

SIDESLIP_CUBED_ROLL = derivative(
    "sideslip_cubed_roll", "The dihedral effect is not linear in large sideslip.", "Cl", "beta^3",
    parameter("Clbe3", "1/rad^3", "rolling moment per sideslip cubed", Prior("normal", 0.0, 5.0, OUR_WIDTH),
        (0.2, 20.0), lengths=MOMENT, place=69),
    (2.0, 0.1, 0.002), source=ODD_TERM,
)

# Yawing moment.

YAW_OFFSET = derivative(
    "yaw_offset", "The aircraft has a yawing moment in straight symmetric flight.", "Cn", "1",
    parameter("Cn0", "1", "yawing moment of symmetric flight", Prior("normal", 0.0, 0.003, OUR_WIDTH), (0.0005, 0.01),
        lengths=MOMENT, place=71),
    (-0.001, 0.1, -0.001), source=CONSTANT_TERM,
)

SIDESLIP_YAW = derivative(
    "sideslip_yaw", "Sideslip turns the nose into the wind (directional stability).", "Cn", "beta",
    parameter("Cnbe", "1/rad", "directional stability, yawing moment per sideslip",
        Prior("normal", 0.14, 0.2, nelson("0.14 to 0.15")), (0.007, 0.5), start=0.14, lengths=MOMENT,
        sign=Sign(1, "beta", "sideslip would turn the nose away from the wind"), place=72),
    (0.14, 0.05, 0.007),
)

ROLL_RATE_YAW = derivative(
    "roll_rate_yaw", "Roll rate yaws the aircraft, for it tilts the lift of either wing.", "Cn", "p",
    parameter("Cnp", "1", "yawing moment per p b/2V", Prior("normal", -0.1, 0.2, nelson("-0.1 to -0.2")), (0.025, 0.6),
        start=-0.1, lengths=MOMENT_AND_RATE, place=73),
    (-0.12, 0.3, 60.0, -0.006),
)

YAW_DAMPING = derivative(
    "yaw_damping", "Yaw rate is damped by a yawing moment.", "Cn", "r",
    parameter("Cnr", "1", "yaw damping, per r b/2V", Prior("normal", -0.2, 0.3, nelson("-0.16 to -0.3")), (0.05, 1.2),
        start=-0.2, lengths=MOMENT_AND_RATE, limits=Limits(-math.inf, 0.0, "yaw rate would not be damped"), place=74),
    (-0.24, 0.1, 60.0, -0.004),
)

AILERON_YAW = derivative(
    "aileron_yaw", "The ailerons yaw the aircraft (where Cnda > 0, away from the turn: adverse yaw).", "Cn", "aileron",
    parameter("Cnda", "1/rad", "yawing moment per aileron deflection, half of right less left",
        Prior("normal", 0.0, 0.05, OUR_WIDTH), (0.005, 0.15), lengths=MOMENT, place=75),
    (0.01, 0.1, 0.001),
)

RUDDER_YAW = derivative(
    "rudder_yaw", "The rudder yaws the aircraft (trailing edge left is positive, so Cndr < 0).", "Cn", "rudder",
    parameter("Cndr", "1/rad", "rudder effectiveness", Prior("normal", -0.1, 0.15, nelson("-0.06 to -0.11")),
        (0.007, 0.4), start=-0.1, lengths=MOMENT,
        sign=Sign(-1, "rudder", "a positive deflection (trailing edge left) would turn the nose to the right"),
        place=76),
    (-0.1, 0.1, -0.01),
)

SPOILER_YAW = derivative(
    "spoiler_yaw", "Spoilers of one side yaw the aircraft to that side.", "Cn", "spoiler difference",
    parameter("Cnds", "1/rad", "yawing moment per half of right less left spoiler",
        Prior("normal", 0.0, 0.05, OUR_WIDTH), (0.003, 0.15), lengths=MOMENT, place=77),
    (0.02, 0.1, 0.0, -0.001),
)

SIDESLIP_ALPHA_YAW = derivative(
    "sideslip_alpha_yaw",
    "Directional stability fades with the angle of attack, as the wake of wing and body reaches the fin.",
    "Cn", "alpha beta",
    parameter("Cnbea", "1/rad^2", "change of directional stability per angle of attack",
        Prior("normal", 0.0, 1.0, OUR_WIDTH), (0.07, 3.0), lengths=MOMENT, place=78),
    (-0.4, 0.25, 0.05, -0.005), source="next term of a Taylor series; our choice of form",
)

SIDESLIP_CUBED_YAW = derivative(
    "sideslip_cubed_yaw", "Directional stability is not linear in large sideslip.", "Cn", "beta^3",
    parameter("Cnbe3", "1/rad^3", "yawing moment per sideslip cubed", Prior("normal", 0.0, 5.0, OUR_WIDTH), (0.2, 20.0),
        lengths=MOMENT, place=79),
    (-2.0, 0.1, -0.002), source=ODD_TERM,
)
