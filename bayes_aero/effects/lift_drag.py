"""Effects on lift and drag."""

from __future__ import annotations

import math

from bayes_aero.arrays import xp
from bayes_aero.effect import Example, Stage, effect, parameter
from bayes_aero.effects.derivatives import ATTAS, EVEN_TERM, HFB_320, MACH_TERM, STALL_MODEL, derivative
from bayes_aero.parameter import Length, Limits, Prior, Sign

# Entries are packed; one argument a line would make the module twice as long:
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

PITCH_RATE_LIFT = derivative(
    "pitch_rate_lift", "Pitch rate makes lift, mostly at the tail.", "CL_attached", "q",
    parameter("CLq", "1", "lift due to pitch rate, per q c/V", Prior("normal", 0.0, 10.0), (2.0, 10.0),
        lengths=(Length.RATE,)),
    (4.0, 0.05, 75.0, 0.008), remark=" (not q c/2V)",
)

ALPHA_DOT_LIFT = derivative(
    "alpha_dot_lift",
    "A changing angle of attack makes lift: downwash needs time to reach the tail.", "CL_attached", "alpha_dot",
    parameter("CLadot", "1", "lift due to alpha-dot, per alpha_dot c/V", Prior("normal", 0.0, 10.0), (2.0, 10.0),
        lengths=(Length.RATE,)),
    (2.0, 0.04, 80.0, 0.003),
)

ELEVATOR_LIFT = derivative(
    "elevator_lift",
    "The elevator makes more or less lift than its moment and the tail arm say.", "CL_attached", "elevator",
    parameter("CLde_extra", "1/rad", "elevator lift beyond -Cmde c/l_tail", Prior("normal", 0.0, 0.5), (0.1, 1.0)),
    (0.3, -0.1, -0.03),
)

STABILIZER_LIFT = derivative(
    "stabilizer_lift",
    "The stabilizer makes more or less lift than its moment and the tail arm say.", "CL_attached", "stabilizer",
    parameter("CLih_extra", "1/rad", "stabilizer lift beyond -Cmih c/l_tail", Prior("normal", 0.0, 1.0), (0.1, 3.0)),
    (0.5, -0.04, -0.02),
    remark=". The trim follows the airspeed, so in one manoeuvre it says much the same as alpha does: diagnosis never "
    "proposes it",
    candidate=False,
)

CANARD_LIFT = derivative(
    "canard_lift", "The canard changes the lift.", "CL_attached", "canard",
    parameter("CLdc", "1/rad", "lift per canard deflection", Prior("normal", 0.0, 0.5), (0.1, 2.0)),
    (0.4, 0.1, 0.04),
)

FLAP_LIFT = derivative(
    "flap_lift", "The landing flaps change the lift.", "CL_attached", "flap",
    parameter("CLdf", "1/rad", "lift per flap deflection", Prior("normal", 0.0, 1.5), (0.05, 3.0)),
    (0.9, 0.2, 0.18), remark=": lift of the attached flow, so that induced drag goes with it",
)

DLC_LIFT = derivative(
    "dlc_lift", "The direct-lift flaps change the lift.", "CL_attached", "dlc",
    parameter("CLdlc", "1/rad", "lift per mean deflection of the direct-lift flaps", Prior("normal", 0.0, 1.5),
        (0.1, 3.0)),
    (1.2, -0.05, -0.15, -0.12),
)

SPOILER_LIFT = derivative(
    "spoiler_lift", "The spoilers change the lift.", "CL", "spoilers",
    parameter("CLds", "1/rad", "lift per mean deflection of the spoilers", Prior("normal", 0.0, 1.0), (0.05, 2.0)),
    (-0.8, 0.1, 0.2, -0.12), stage=Stage.TOTAL,
)

MACH_LIFT = effect(
    "mach_lift", "The lift-curve slope changes with Mach number.",
    "CL_attached += CLaM Mach alpha.",
    lambda v, s, *_: {"CL_attached": v["CLaM"] * s["mach"] * s["alpha"]},
    parameter("CLaM", "1/rad", "lift-curve slope per Mach number", Prior("normal", 0.0, 15.0), (0.5, 20.0), place=23),
    example=Example({"CLaM": 9.0}, {"alpha": 0.1, "mach": 0.3}, {"CL_attached": 0.27}, "9 x 0.3 x 0.1, by hand"),
    source=ATTAS,
)

SPEED_LIFT = derivative(
    "speed_lift", "The lift coefficient changes with airspeed.", "CL_attached", "speed",
    parameter("CLV", "1", "lift per V/V0", Prior("normal", 0.0, 1.0), (0.05, 2.0)),
    (0.5, 80.0, 0.4), source=HFB_320, candidate=False,
)

SIDESLIP_LIFT = derivative(
    "sideslip_lift", "Sideslip changes the lift.", "CL", "beta^2",
    parameter("CLb2", "1/rad^2", "lift per sideslip squared", Prior("normal", 0.0, 10.0), (2.0, 20.0)),
    (-3.0, -0.1, -0.03), source=EVEN_TERM, stage=Stage.TOTAL,
)

# Drag: the polar, then the controls, speed and sideslip.

PROFILE_DRAG = effect(
    "profile_drag", "The aircraft has drag at zero lift.",
    "CD += CD0.",
    lambda v, s, *_: {"CD": v["CD0"] + 0.0 * s["alpha"]},
    parameter("CD0", "1", "zero-lift drag", Prior("normal", 0.04, 0.05), (0.001, 0.2), start=0.04,
        limits=Limits(0.0, math.inf, "drag without lift cannot be negative"), place=11),
    example=Example({"CD0": 0.04}, {"alpha": 0.1}, {"CD": 0.04}, "by hand"),
    source=STALL_MODEL,
)

# Sizes are those of 1/e, which is 0 where e is neutral; CD is linear in it.
INDUCED_DRAG = effect(
    "induced_drag", "Drag grows with the square of the lift.",
    "CD += CL_attached^2/(e pi AR): the published model squares the attached lift, not the Kirchhoff lift.",
    lambda v, _s, a, known: {"CD": xp.square(known["CL_attached"]) / (v["e"] * xp.pi * a.aspect_ratio)},
    parameter("e", "1", "Oswald efficiency factor",
        Prior("lognormal", 0.8, 0.5, "around 0.8 for a transport; our choice"), (0.02, 3.0), (0.05, 10.0),
        neutral=math.inf, start=0.8, limits=Limits(0.0, 1.5, "no wing has so little induced drag"), place=12),
    example=Example({"e": 0.8}, {"alpha": 0.1}, {"CD": 1.0 / (0.8 * math.pi * 7.0)}, "by hand, aspect ratio 7",
        known={"CL_attached": 1.0}),
    source=STALL_MODEL, stage=Stage.TOTAL, scan={"e": (0.8,)},
)

DRAG_OFFSET = effect(
    "drag_offset", "Drag is least at a lift other than zero: the wing is cambered.",
    "CD += (CLmin^2 - 2 CL_attached CLmin)/(e pi AR), so that the polar becomes (CL_attached - CLmin)^2/(e pi AR).",
    lambda v, _s, a, known: {
        "CD": v["CLmin"] * (v["CLmin"] - 2.0 * known["CL_attached"]) / (v["e"] * xp.pi * a.aspect_ratio)
    },
    parameter("CLmin", "1", "lift at least drag", Prior("normal", 0.0, 0.25), (0.02, 0.5)),
    example=Example({"CLmin": 0.2, "e": 0.8}, {"alpha": 0.1}, {"CD": -0.36 / (0.8 * math.pi * 7.0)},
        "0.2^2 - 2 x 1 x 0.2 = -0.36, by hand, aspect ratio 7", known={"CL_attached": 1.0}),
    source="quadratic polar of a cambered wing; textbook form", stage=Stage.TOTAL,
)

ALPHA_DRAG = derivative(
    "alpha_drag", "Drag grows linearly with the angle of attack.", "CD", "alpha",
    parameter("CDa", "1/rad", "drag per angle of attack", Prior("normal", 0.0, 1.0), (0.0125, 1.0)),
    (0.3, 0.1, 0.03),
    remark=": the tangent of the drag polar at a trim point. Where induced drag is in the model it says the same once "
    "more, so diagnosis never proposes it",
    source=HFB_320, candidate=False,
)

ELEVATOR_DRAG = derivative(
    "elevator_drag", "Elevator deflection changes the drag.", "CD", "elevator",
    parameter("CDde", "1/rad", "drag per elevator deflection", Prior("normal", 0.0, 0.15), (0.02, 0.3)),
    (0.05, -0.12, -0.006), remark=", signed: the trimmed tail carries load, so the slope at de = 0 is not zero",
    stage=Stage.TOTAL,
)

STABILIZER_DRAG = derivative(
    "stabilizer_drag", "The trim of the stabilizer changes the drag.", "CD", "stabilizer",
    parameter("CDih", "1/rad", "drag per stabilizer deflection", Prior("normal", 0.0, 0.25), (0.02, 0.5)),
    (0.1, -0.05, -0.005),
    remark=", signed: the trimmed tail carries load. The trim follows the airspeed, so in one manoeuvre it says much "
    "the same as alpha does: diagnosis never proposes it",
    stage=Stage.TOTAL, candidate=False,
)

CANARD_DRAG = derivative(
    "canard_drag", "Canard deflection changes the drag.", "CD", "canard",
    parameter("CDdc", "1/rad", "drag per canard deflection", Prior("normal", 0.0, 0.15), (0.02, 0.3)),
    (0.05, 0.2, 0.01), remark=", signed: the trimmed canard carries load, so the slope at zero deflection is not zero",
    stage=Stage.TOTAL,
)

# Beyond the induced drag of the lift of the flaps.
FLAP_DRAG = derivative(
    "flap_drag", "The landing flaps change the drag.", "CD", "flap",
    parameter("CDdf", "1/rad", "drag per flap deflection", Prior("normal", 0.0, 0.25), (0.01, 0.5)),
    (0.15, 0.2, 0.03), stage=Stage.TOTAL,
)

SPOILER_DRAG = derivative(
    "spoiler_drag", "The spoilers change the drag.", "CD", "spoilers",
    parameter("CDds", "1/rad", "drag per mean deflection of the spoilers", Prior("normal", 0.0, 0.25), (0.01, 0.5)),
    (0.2, 0.1, 0.3, 0.04), stage=Stage.TOTAL,
)

MACH_DRAG = derivative(
    "mach_drag", "The drag changes with Mach number.", "CD", "mach",
    parameter("CDM", "1", "drag per Mach number", Prior("normal", 0.0, 0.15), (0.01, 0.3)),
    (0.1, 0.3, 0.03), source=MACH_TERM, stage=Stage.TOTAL,
)

SPEED_DRAG = derivative(
    "speed_drag", "The drag coefficient changes with airspeed.", "CD", "speed",
    parameter("CDV", "1", "drag per V/V0", Prior("normal", 0.0, 0.2), (0.005, 0.5)),
    (0.05, 80.0, 0.04), source=HFB_320, stage=Stage.TOTAL, candidate=False,
)

SIDESLIP_DRAG = derivative(
    "sideslip_drag", "Sideslip adds drag.", "CD", "beta^2",
    parameter("CDb2", "1/rad^2", "drag per sideslip squared", Prior("normal", 0.0, 2.5), (0.2, 5.0)),
    (0.8, 0.05, 0.002), source=EVEN_TERM, stage=Stage.TOTAL,
)
