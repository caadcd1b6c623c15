"""Effects on lift and drag."""

from __future__ import annotations

import math

from bayes_aero.arrays import xp
from bayes_aero.effect import Example, Stage, effect, parameter
from bayes_aero.effects.sources import ATTAS, DERIVATIVE, EVEN_TERM, HFB_320, MACH_TERM, STALL_MODEL
from bayes_aero.parameter import Length, Limits, Prior, Sign
from bayes_aero.physics.rates import reduced, speed_ratio

# Rows of a table, packed, for with one argument a line it would be twice as long:
# effect(name, claim, formula, increments, *parameters, ...); parameter(name, unit, description, prior, sizes, bounds).
# fmt: off

# Lift of the attached flow, and what the controls add to it.

ATTACHED_LIFT = effect(
    "attached_lift", "Lift grows linearly with the angle of attack while the flow is attached.",
    "CL_attached = CL0 + CLa alpha.",
    lambda v, s, *_: {"CL_attached": v["CL0"] + v["CLa"] * s["alpha"]},
    parameter("CL0", "1", "lift at zero angle of attack", Prior("normal", 0.2, 0.5), (0.01, 1.0), start=0.2, place=21),
    parameter(
        "CLa", "1/rad", "attached lift-curve slope",
        Prior("normal", 4.5, 2.0, "2 pi AR/(AR + 2) for AR of 5 to 10; width our choice"), (0.1, 8.0), start=4.5,
        sign=Sign(1, "az or alpha", "lift would decrease with the angle of attack"), place=22,
        limits=Limits(
            -math.inf, 4.0 * math.pi, "it is more than twice the value of a thin aerofoil of infinite span, 2 pi",
        ),
    ),
    example=Example({"CL0": 0.2, "CLa": 4.0}, {"alpha": 0.1}, {"CL_attached": 0.6}, "0.2 + 4.0 x 0.1, by hand"),
    source=STALL_MODEL,
)

PITCH_RATE_LIFT = effect(
    "pitch_rate_lift", "Pitch rate makes lift, mostly at the tail.",
    "CL_attached += CLq q c/V (not q c/2V); length and speed as `reduced` has them.",
    lambda v, s, a, _: {"CL_attached": reduced(v["CLq"] * s["q"], s["airspeed"], a)},
    parameter(
        "CLq", "1", "lift due to pitch rate, per q c/V", Prior("normal", 0.0, 10.0), (2.0, 10.0),
        lengths=(Length.RATE,),
    ),
    example=Example(
        {"CLq": 4.0}, {"q": 0.05, "airspeed": 75.0}, {"CL_attached": 0.008}, "4 x 0.05 x 3/75, by hand, chord 3 m",
    ),
    source=DERIVATIVE,
)

ALPHA_DOT_LIFT = effect(
    "alpha_dot_lift", "A changing angle of attack makes lift: downwash needs time to reach the tail.",
    "CL_attached += CLadot alpha_dot c/V; length and speed as `reduced` has them.",
    lambda v, s, a, _: {"CL_attached": reduced(v["CLadot"] * s["alpha_dot"], s["airspeed"], a)},
    parameter(
        "CLadot", "1", "lift due to alpha-dot, per alpha_dot c/V", Prior("normal", 0.0, 10.0), (2.0, 10.0),
        lengths=(Length.RATE,),
    ),
    example=Example(
        {"CLadot": 2.0}, {"alpha_dot": 0.04, "airspeed": 80.0}, {"CL_attached": 0.003},
        "2 x 0.04 x 3/80, by hand, chord 3 m",
    ),
    source=DERIVATIVE,
)

ELEVATOR_LIFT = effect(
    "elevator_lift", "The elevator makes more or less lift than its moment and the tail arm say.",
    "CL_attached += CLde_extra de.",
    lambda v, s, *_: {"CL_attached": v["CLde_extra"] * s["elevator"]},
    parameter("CLde_extra", "1/rad", "elevator lift beyond -Cmde c/l_tail", Prior("normal", 0.0, 0.5), (0.1, 1.0)),
    example=Example({"CLde_extra": 0.3}, {"elevator": -0.1}, {"CL_attached": -0.03}, "0.3 x -0.1, by hand"),
    source=DERIVATIVE,
)

STABILIZER_LIFT = effect(
    "stabilizer_lift", "The stabilizer makes more or less lift than its moment and the tail arm say.",
    "CL_attached += CLih_extra ih. The trim follows the airspeed, so in one manoeuvre it says much the same as "
    "alpha does: diagnosis never proposes it.",
    lambda v, s, *_: {"CL_attached": v["CLih_extra"] * s["stabilizer"]},
    parameter("CLih_extra", "1/rad", "stabilizer lift beyond -Cmih c/l_tail", Prior("normal", 0.0, 1.0), (0.1, 3.0)),
    example=Example({"CLih_extra": 0.5}, {"stabilizer": -0.04}, {"CL_attached": -0.02}, "0.5 x -0.04, by hand"),
    source=DERIVATIVE, candidate=False,
)

CANARD_LIFT = effect(
    "canard_lift", "The canard changes the lift.",
    "CL_attached += CLdc canard.",
    lambda v, s, *_: {"CL_attached": v["CLdc"] * s["canard"]},
    parameter("CLdc", "1/rad", "lift per canard deflection", Prior("normal", 0.0, 0.5), (0.1, 2.0)),
    example=Example({"CLdc": 0.4}, {"canard": 0.1}, {"CL_attached": 0.04}, "0.4 x 0.1, by hand"),
    source=DERIVATIVE,
)

FLAP_LIFT = effect(
    "flap_lift", "The landing flaps change the lift.",
    "CL_attached += CLdf flap: lift of the attached flow, so that induced drag goes with it.",
    lambda v, s, *_: {"CL_attached": v["CLdf"] * s["flap"]},
    parameter("CLdf", "1/rad", "lift per flap deflection", Prior("normal", 0.0, 1.5), (0.05, 3.0)),
    example=Example({"CLdf": 0.9}, {"flap": 0.2}, {"CL_attached": 0.18}, "0.9 x 0.2, by hand"),
    source=DERIVATIVE,
)

DLC_LIFT = effect(
    "dlc_lift", "The direct-lift flaps change the lift.",
    "CL_attached += CLdlc (left + right)/2.",
    lambda v, s, *_: {"CL_attached": v["CLdlc"] * 0.5 * (s["dlc_left"] + s["dlc_right"])},
    parameter(
        "CLdlc", "1/rad", "lift per mean deflection of the direct-lift flaps", Prior("normal", 0.0, 1.5), (0.1, 3.0),
    ),
    example=Example(
        {"CLdlc": 1.2}, {"dlc_left": -0.05, "dlc_right": -0.15}, {"CL_attached": -0.12},
        "1.2 x (-0.05 + -0.15)/2, by hand",
    ),
    source=DERIVATIVE, together=True,
)

SPOILER_LIFT = effect(
    "spoiler_lift", "The spoilers change the lift.",
    "CL += CLds (left + right)/2.",
    lambda v, s, *_: {"CL": v["CLds"] * 0.5 * (s["spoiler_left"] + s["spoiler_right"])},
    parameter("CLds", "1/rad", "lift per mean deflection of the spoilers", Prior("normal", 0.0, 1.0), (0.05, 2.0)),
    example=Example(
        {"CLds": -0.8}, {"spoiler_left": 0.1, "spoiler_right": 0.2}, {"CL": -0.12}, "-0.8 x (0.1 + 0.2)/2, by hand",
    ),
    source=DERIVATIVE, stage=Stage.TOTAL, together=True,
)

MACH_LIFT = effect(
    "mach_lift", "The lift-curve slope changes with Mach number.",
    "CL_attached += CLaM Mach alpha.",
    lambda v, s, *_: {"CL_attached": v["CLaM"] * s["mach"] * s["alpha"]},
    parameter("CLaM", "1/rad", "lift-curve slope per Mach number", Prior("normal", 0.0, 15.0), (0.5, 20.0), place=23),
    example=Example({"CLaM": 9.0}, {"alpha": 0.1, "mach": 0.3}, {"CL_attached": 0.27}, "9 x 0.3 x 0.1, by hand"),
    source=ATTAS,
)

SPEED_LIFT = effect(
    "speed_lift", "The lift coefficient changes with airspeed.",
    "CL_attached += CLV V/V0; V0 is the card's reference_speed, or 100 m/s where the card names none. A "
    "stand-in, at one altitude, for Mach number, thrust and elasticity alike, so diagnosis never proposes it.",
    lambda v, s, a, _: {"CL_attached": v["CLV"] * speed_ratio(s["airspeed"], a)},
    parameter("CLV", "1", "lift per V/V0", Prior("normal", 0.0, 1.0), (0.05, 2.0)),
    example=Example({"CLV": 0.5}, {"airspeed": 80.0}, {"CL_attached": 0.4}, "0.5 x 80/100, by hand, V0 100 m/s"),
    source=HFB_320, candidate=False,
)

SIDESLIP_LIFT = effect(
    "sideslip_lift", "Sideslip changes the lift.",
    "CL += CLb2 beta^2: even in beta, for the aircraft is symmetric.",
    lambda v, s, *_: {"CL": v["CLb2"] * s["beta"] * s["beta"]},
    parameter("CLb2", "1/rad^2", "lift per sideslip squared", Prior("normal", 0.0, 10.0), (2.0, 20.0)),
    example=Example({"CLb2": -3.0}, {"beta": -0.1}, {"CL": -0.03}, "-3 x (-0.1)^2, by hand"),
    source=EVEN_TERM, stage=Stage.TOTAL,
)

# Drag: the polar, then the controls, speed and sideslip.

PROFILE_DRAG = effect(
    "profile_drag", "The aircraft has drag at zero lift.",
    "CD += CD0.",
    lambda v, s, *_: {"CD": v["CD0"] + 0.0 * s["alpha"]},
    parameter(
        "CD0", "1", "zero-lift drag", Prior("normal", 0.04, 0.05), (0.001, 0.2), start=0.04,
        limits=Limits(0.0, math.inf, "drag without lift cannot be negative"), place=11,
    ),
    example=Example({"CD0": 0.04}, {"alpha": 0.1}, {"CD": 0.04}, "by hand"),
    source=STALL_MODEL,
)

# Sizes are those of 1/e, which is 0 where e is neutral; CD is linear in it.
INDUCED_DRAG = effect(
    "induced_drag", "Drag grows with the square of the lift.",
    "CD += CL_attached^2/(e pi AR): the published model squares the attached lift, not the Kirchhoff lift.",
    lambda v, _s, a, known: {"CD": xp.square(known["CL_attached"]) / (v["e"] * xp.pi * a.aspect_ratio)},
    parameter(
        "e", "1", "Oswald efficiency factor", Prior("lognormal", 0.8, 0.5, "around 0.8 for a transport; our choice"),
        (0.02, 3.0), (0.05, 10.0), neutral=math.inf, start=0.8,
        limits=Limits(0.0, 1.5, "no wing has so little induced drag"), place=12,
    ),
    example=Example(
        {"e": 0.8}, {"alpha": 0.1}, {"CD": 1.0 / (0.8 * math.pi * 7.0)}, "by hand, aspect ratio 7",
        known={"CL_attached": 1.0},
    ),
    source=STALL_MODEL, stage=Stage.TOTAL, scan={"e": (0.8,)},
)

DRAG_OFFSET = effect(
    "drag_offset", "Drag is least at a lift other than zero: the wing is cambered.",
    "CD += (CLmin^2 - 2 CL_attached CLmin)/(e pi AR), so that the polar becomes (CL_attached - CLmin)^2/(e pi AR).",
    lambda v, _s, a, known: {
        "CD": v["CLmin"] * (v["CLmin"] - 2.0 * known["CL_attached"]) / (v["e"] * xp.pi * a.aspect_ratio)
    },
    parameter("CLmin", "1", "lift at least drag", Prior("normal", 0.0, 0.25), (0.02, 0.5)),
    example=Example(
        {"CLmin": 0.2, "e": 0.8}, {"alpha": 0.1}, {"CD": -0.36 / (0.8 * math.pi * 7.0)},
        "0.2^2 - 2 x 1 x 0.2 = -0.36, by hand, aspect ratio 7", known={"CL_attached": 1.0},
    ),
    source="quadratic polar of a cambered wing; textbook form", stage=Stage.TOTAL,
)

ALPHA_DRAG = effect(
    "alpha_drag", "Drag grows linearly with the angle of attack.",
    "CD += CDa alpha: the tangent of the drag polar at a trim point. Where induced drag is in the model it says "
    "the same once more, so diagnosis never proposes it.",
    lambda v, s, *_: {"CD": v["CDa"] * s["alpha"]},
    parameter("CDa", "1/rad", "drag per angle of attack", Prior("normal", 0.0, 1.0), (0.0125, 1.0)),
    example=Example({"CDa": 0.3}, {"alpha": 0.1}, {"CD": 0.03}, "0.3 x 0.1, by hand"),
    source=HFB_320, candidate=False,
)

ELEVATOR_DRAG = effect(
    "elevator_drag", "Elevator deflection changes the drag.",
    "CD += CDde de, signed: the trimmed tail carries load, so the slope at de = 0 is not zero.",
    lambda v, s, *_: {"CD": v["CDde"] * s["elevator"]},
    parameter("CDde", "1/rad", "drag per elevator deflection", Prior("normal", 0.0, 0.15), (0.02, 0.3)),
    example=Example({"CDde": 0.05}, {"elevator": -0.12}, {"CD": -0.006}, "0.05 x -0.12, by hand"),
    source=DERIVATIVE, stage=Stage.TOTAL,
)

STABILIZER_DRAG = effect(
    "stabilizer_drag", "The trim of the stabilizer changes the drag.",
    "CD += CDih ih, signed: the trimmed tail carries load. The trim follows the airspeed, so in one manoeuvre it "
    "says much the same as alpha does: diagnosis never proposes it.",
    lambda v, s, *_: {"CD": v["CDih"] * s["stabilizer"]},
    parameter("CDih", "1/rad", "drag per stabilizer deflection", Prior("normal", 0.0, 0.25), (0.02, 0.5)),
    example=Example({"CDih": 0.1}, {"stabilizer": -0.05}, {"CD": -0.005}, "0.1 x -0.05, by hand"),
    source=DERIVATIVE, stage=Stage.TOTAL, candidate=False,
)

CANARD_DRAG = effect(
    "canard_drag", "Canard deflection changes the drag.",
    "CD += CDdc canard, signed: the trimmed canard carries load, so the slope at zero deflection is not zero.",
    lambda v, s, *_: {"CD": v["CDdc"] * s["canard"]},
    parameter("CDdc", "1/rad", "drag per canard deflection", Prior("normal", 0.0, 0.15), (0.02, 0.3)),
    example=Example({"CDdc": 0.05}, {"canard": 0.2}, {"CD": 0.01}, "0.05 x 0.2, by hand"),
    source=DERIVATIVE, stage=Stage.TOTAL,
)

# Beyond the induced drag of the lift of the flaps.
FLAP_DRAG = effect(
    "flap_drag", "The landing flaps change the drag.",
    "CD += CDdf flap.",
    lambda v, s, *_: {"CD": v["CDdf"] * s["flap"]},
    parameter("CDdf", "1/rad", "drag per flap deflection", Prior("normal", 0.0, 0.25), (0.01, 0.5)),
    example=Example({"CDdf": 0.15}, {"flap": 0.2}, {"CD": 0.03}, "0.15 x 0.2, by hand"),
    source=DERIVATIVE, stage=Stage.TOTAL,
)

SPOILER_DRAG = effect(
    "spoiler_drag", "The spoilers change the drag.",
    "CD += CDds (left + right)/2.",
    lambda v, s, *_: {"CD": v["CDds"] * 0.5 * (s["spoiler_left"] + s["spoiler_right"])},
    parameter("CDds", "1/rad", "drag per mean deflection of the spoilers", Prior("normal", 0.0, 0.25), (0.01, 0.5)),
    example=Example(
        {"CDds": 0.2}, {"spoiler_left": 0.1, "spoiler_right": 0.3}, {"CD": 0.04}, "0.2 x (0.1 + 0.3)/2, by hand",
    ),
    source=DERIVATIVE, stage=Stage.TOTAL, together=True,
)

MACH_DRAG = effect(
    "mach_drag", "The drag changes with Mach number.",
    "CD += CDM Mach.",
    lambda v, s, *_: {"CD": v["CDM"] * s["mach"]},
    parameter("CDM", "1", "drag per Mach number", Prior("normal", 0.0, 0.15), (0.01, 0.3)),
    example=Example({"CDM": 0.1}, {"mach": 0.3}, {"CD": 0.03}, "0.1 x 0.3, by hand"),
    source=MACH_TERM, stage=Stage.TOTAL,
)

SPEED_DRAG = effect(
    "speed_drag", "The drag coefficient changes with airspeed.",
    "CD += CDV V/V0; V0 is the card's reference_speed, or 100 m/s where the card names none. A stand-in, at one "
    "altitude, for Mach number, thrust and elasticity alike, so diagnosis never proposes it.",
    lambda v, s, a, _: {"CD": v["CDV"] * speed_ratio(s["airspeed"], a)},
    parameter("CDV", "1", "drag per V/V0", Prior("normal", 0.0, 0.2), (0.005, 0.5)),
    example=Example({"CDV": 0.05}, {"airspeed": 80.0}, {"CD": 0.04}, "0.05 x 80/100, by hand, V0 100 m/s"),
    source=HFB_320, stage=Stage.TOTAL, candidate=False,
)

SIDESLIP_DRAG = effect(
    "sideslip_drag", "Sideslip adds drag.",
    "CD += CDb2 beta^2: even in beta, for the aircraft is symmetric.",
    lambda v, s, *_: {"CD": v["CDb2"] * s["beta"] * s["beta"]},
    parameter("CDb2", "1/rad^2", "drag per sideslip squared", Prior("normal", 0.0, 2.5), (0.2, 5.0)),
    example=Example({"CDb2": 0.8}, {"beta": 0.05}, {"CD": 0.002}, "0.8 x (0.05)^2, by hand"),
    source=EVEN_TERM, stage=Stage.TOTAL,
)
