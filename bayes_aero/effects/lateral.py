"""Effects on side force, rolling moment and yawing moment."""

from __future__ import annotations

import math

from bayes_aero.effect import derivative
from bayes_aero.parameter import Limits, Prior, Sign

CONSTANT_TERM = "constant term of a Taylor series; textbook form"
ODD_TERM = "lowest odd term beyond the linear one, by symmetry; our choice of form"


def nelson(values: str) -> str:
    """Source of a prior."""
    return f"jet transports of Nelson 1998, app. B, have some {values}; the width is our choice"


# fmt: off

# Side force.
SIDE_FORCE_OFFSET = derivative("side_force_offset", "The aircraft has a side force in straight symmetric flight.", "CY",
    "1", ("CY0", "side force of symmetric flight", 0.02, (0.004, 0.05)), (0.01, 0.1, 0.01), place=51,
    source=CONSTANT_TERM)
SIDESLIP_SIDE_FORCE = derivative("sideslip_side_force", "Sideslip to the right pushes the aircraft to the left.", "CY",
    "beta", ("CYbe", "side force per sideslip", Prior("normal", -0.8, 1.0, nelson("-0.7 to -1.0")), (0.06, 2.0)),
    (-0.8, 0.05, -0.04), sign=Sign(-1, "beta", "sideslip to the right would pull the aircraft further to the right"),
    place=52)
ROLL_RATE_SIDE_FORCE = derivative("roll_rate_side_force", "Roll rate makes side force, at the fin above all.", "CY",
    "p", ("CYp", "side force per p b/2V", 0.6, (0.15, 1.5)), (0.2, 0.3, 60.0, 0.01), place=53)
YAW_RATE_SIDE_FORCE = derivative("yaw_rate_side_force", "Yaw rate makes side force, at the fin above all.", "CY", "r",
    ("CYr", "side force per r b/2V", 1.0, (0.4, 2.0)), (0.6, 0.1, 60.0, 0.01), place=54)
AILERON_SIDE_FORCE = derivative("aileron_side_force", "The ailerons make side force.", "CY", "aileron",
    ("CYda", "side force per aileron deflection, half of right less left", 0.15, (0.04, 0.4)), (0.05, -0.1, -0.005),
    place=55)
RUDDER_SIDE_FORCE = derivative("rudder_side_force",
    "The rudder makes side force (trailing edge left is positive, so CYdr > 0).", "CY", "rudder",
    ("CYdr", "side force per rudder deflection", Prior("normal", 0.2, 0.3, nelson("0.18")), (0.06, 0.8)),
    (0.2, 0.1, 0.02),
    sign=Sign(1, "rudder", "a positive deflection (trailing edge left) would push the fin to the left"), place=56)

# Rolling moment.
ROLL_OFFSET = derivative("roll_offset",
    "The aircraft has a rolling moment in straight symmetric flight; ailerons with a wrong zero show one, too.", "Cl",
    "1", ("Cl0", "rolling moment of symmetric flight", 0.003, (0.0005, 0.01)), (0.001, 0.1, 0.001), place=61,
    source=CONSTANT_TERM)
SIDESLIP_ROLL = derivative("sideslip_roll", "Sideslip to the right rolls the aircraft to the left (dihedral effect).",
    "Cl", "beta",
    ("Clbe", "dihedral effect, rolling moment per sideslip", Prior("normal", -0.1, 0.2, nelson("-0.1 to -0.2")),
        (0.007, 0.5)), (-0.1, 0.05, -0.005),
    sign=Sign(-1, "beta", "sideslip to the right would roll the aircraft to the right"), place=62)
ROLL_DAMPING = derivative("roll_damping", "Roll rate is damped by a rolling moment.", "Cl", "p",
    ("Clp", "roll damping, per p b/2V", Prior("normal", -0.4, 0.4, nelson("-0.4 to -0.5")), (0.025, 1.5)),
    (-0.4, 0.3, 60.0, -0.02), limits=Limits(-math.inf, 0.0, "roll rate would not be damped in attached flow"), place=63)
YAW_RATE_ROLL = derivative("yaw_rate_roll", "Yaw rate rolls the aircraft, for the outer wing is faster.", "Cl", "r",
    ("Clr", "rolling moment per r b/2V", Prior("normal", 0.1, 0.3, nelson("0.1")), (0.05, 1.0)),
    (0.12, 0.1, 60.0, 0.002), place=64)
AILERON_ROLL = derivative("aileron_roll", "The ailerons roll the aircraft (right one down is positive, so Clda < 0).",
    "Cl", "aileron",
    ("Clda", "aileron effectiveness, per half of right less left", Prior("normal", -0.1, 0.2), (0.005, 0.6)),
    (-0.12, 0.1, -0.012),
    sign=Sign(-1, "aileron", "a positive deflection (right aileron down) would roll the aircraft to the right"),
    place=65)
RUDDER_ROLL = derivative("rudder_roll", "The rudder rolls the aircraft, for the fin lies above the roll axis.", "Cl",
    "rudder", ("Cldr", "rolling moment per rudder deflection", 0.05, (0.007, 0.15)), (0.02, -0.1, -0.002), place=66)
SPOILER_ROLL = derivative("spoiler_roll", "Spoilers of one side roll the aircraft to that side.", "Cl",
    "spoiler difference", ("Clds", "rolling moment per half of right less left spoiler", 0.1, (0.003, 0.3)),
    (0.1, 0.0, 0.2, 0.01), place=67)
SIDESLIP_ALPHA_ROLL = derivative("sideslip_alpha_roll",
    "The dihedral effect grows with the angle of attack, as that of a swept wing does with lift.", "Cl", "alpha beta",
    ("Clbea", "change of the dihedral effect per angle of attack", 1.0, (0.07, 3.0)), (-0.5, 0.2, 0.05, -0.005),
    place=68,
    source="next term of a Taylor series; the dihedral effect of sweep is proportional to lift, as textbooks derive")
SIDESLIP_CUBED_ROLL = derivative("sideslip_cubed_roll", "The dihedral effect is not linear in large sideslip.", "Cl",
    "beta^3", ("Clbe3", "rolling moment per sideslip cubed", 5.0, (0.2, 20.0)), (2.0, 0.1, 0.002), place=69,
    source=ODD_TERM)

# Yawing moment.
YAW_OFFSET = derivative("yaw_offset", "The aircraft has a yawing moment in straight symmetric flight.", "Cn", "1",
    ("Cn0", "yawing moment of symmetric flight", 0.003, (0.0005, 0.01)), (-0.001, 0.1, -0.001), place=71,
    source=CONSTANT_TERM)
SIDESLIP_YAW = derivative("sideslip_yaw", "Sideslip turns the nose into the wind (directional stability).", "Cn",
    "beta",
    ("Cnbe", "directional stability, yawing moment per sideslip", Prior("normal", 0.14, 0.2, nelson("0.14 to 0.15")),
        (0.007, 0.5)), (0.14, 0.05, 0.007), sign=Sign(1, "beta", "sideslip would turn the nose away from the wind"),
    place=72)
ROLL_RATE_YAW = derivative("roll_rate_yaw", "Roll rate yaws the aircraft, for it tilts the lift of either wing.", "Cn",
    "p", ("Cnp", "yawing moment per p b/2V", Prior("normal", -0.1, 0.2, nelson("-0.1 to -0.2")), (0.025, 0.6)),
    (-0.12, 0.3, 60.0, -0.006), place=73)
YAW_DAMPING = derivative("yaw_damping", "Yaw rate is damped by a yawing moment.", "Cn", "r",
    ("Cnr", "yaw damping, per r b/2V", Prior("normal", -0.2, 0.3, nelson("-0.16 to -0.3")), (0.05, 1.2)),
    (-0.24, 0.1, 60.0, -0.004), limits=Limits(-math.inf, 0.0, "yaw rate would not be damped"), place=74)
AILERON_YAW = derivative("aileron_yaw",
    "The ailerons yaw the aircraft (where Cnda > 0, away from the turn: adverse yaw).", "Cn", "aileron",
    ("Cnda", "yawing moment per aileron deflection, half of right less left", 0.05, (0.005, 0.15)), (0.01, 0.1, 0.001),
    place=75)
RUDDER_YAW = derivative("rudder_yaw", "The rudder yaws the aircraft (trailing edge left is positive, so Cndr < 0).",
    "Cn", "rudder",
    ("Cndr", "rudder effectiveness", Prior("normal", -0.1, 0.15, nelson("-0.06 to -0.11")), (0.007, 0.4)),
    (-0.1, 0.1, -0.01),
    sign=Sign(-1, "rudder", "a positive deflection (trailing edge left) would turn the nose to the right"), place=76)
SPOILER_YAW = derivative("spoiler_yaw", "Spoilers of one side yaw the aircraft to that side.", "Cn",
    "spoiler difference", ("Cnds", "yawing moment per half of right less left spoiler", 0.05, (0.003, 0.15)),
    (0.02, 0.1, 0.0, -0.001), place=77)
SIDESLIP_ALPHA_YAW = derivative("sideslip_alpha_yaw",
    "Directional stability fades with the angle of attack, as the wake of wing and body reaches the fin.", "Cn",
    "alpha beta", ("Cnbea", "change of directional stability per angle of attack", 1.0, (0.07, 3.0)),
    (-0.4, 0.25, 0.05, -0.005), place=78, source="next term of a Taylor series; our choice of form")
SIDESLIP_CUBED_YAW = derivative("sideslip_cubed_yaw", "Directional stability is not linear in large sideslip.", "Cn",
    "beta^3", ("Cnbe3", "yawing moment per sideslip cubed", 5.0, (0.2, 20.0)), (-2.0, 0.1, -0.002), place=79,
    source=ODD_TERM)
