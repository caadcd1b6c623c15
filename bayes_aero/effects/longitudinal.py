"""Effects on lift, drag and pitching moment."""

from __future__ import annotations

import math
from typing import Any

from bayes_aero.arrays import xp
from bayes_aero.effect import STALL_MODEL, Example, Increments, Stage, derivative, effect, parameter
from bayes_aero.parameter import Length, Limits, Prior, Sign
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.physics.kinematics import reduced

ATTAS = "the ATTAS stall model as published with the data of Jategaonkar 2015"
HFB_320 = "Jategaonkar 2015, longitudinal model of the HFB 320"
EVEN_TERM = "lowest even term of a Taylor series, by symmetry; our choice of form"
MACH_TERM = "first term of a Taylor series in Mach number; our choice of form"

# fmt: off

# Lift of the attached flow, and what the controls add to it.
ATTACHED_LIFT = effect("attached_lift", "Lift grows linearly with the angle of attack while the flow is attached.",
    "CL_attached = CL0 + CLa alpha.", lambda v, s, *_: {"CL_attached": v["CL0"] + v["CLa"] * s["alpha"]},
    parameter("CL0", "1", "lift at zero angle of attack", Prior("normal", 0.2, 0.5), (0.01, 1.0), place=21),
    parameter("CLa", "1/rad", "attached lift-curve slope",
        Prior("normal", 4.5, 2.0, "2 pi AR/(AR + 2) for AR of 5 to 10; width our choice"), (0.1, 8.0),
        sign=Sign(1, "az or alpha", "lift would decrease with the angle of attack"), place=22,
        limits=Limits(-math.inf, 4.0 * math.pi,
            "it is more than twice the value of a thin aerofoil of infinite span, 2 pi")),
    example=Example({"CL0": 0.2, "CLa": 4.0}, {"alpha": 0.1}, {"CL_attached": 0.6}, "0.2 + 4.0 x 0.1, by hand"),
    source=STALL_MODEL)
PITCH_RATE_LIFT = derivative("pitch_rate_lift", "Pitch rate makes lift, mostly at the tail.", "CL_attached", "q",
    ("CLq", "lift due to pitch rate, per q c/V", 10.0, (2.0, 10.0)), (4.0, 0.05, 75.0, 0.008), remark=" (not q c/2V)")
ALPHA_DOT_LIFT = derivative("alpha_dot_lift",
    "A changing angle of attack makes lift: downwash needs time to reach the tail.", "CL_attached", "alpha_dot",
    ("CLadot", "lift due to alpha-dot, per alpha_dot c/V", 10.0, (2.0, 10.0)), (2.0, 0.04, 80.0, 0.003))
ELEVATOR_LIFT = derivative("elevator_lift",
    "The elevator makes more or less lift than its moment and the tail arm say.", "CL_attached", "elevator",
    ("CLde_extra", "elevator lift beyond -Cmde c/l_tail", 0.5, (0.1, 1.0)), (0.3, -0.1, -0.03))
STABILIZER_LIFT = derivative("stabilizer_lift",
    "The stabilizer makes more or less lift than its moment and the tail arm say.", "CL_attached", "stabilizer",
    ("CLih_extra", "stabilizer lift beyond -Cmih c/l_tail", 1.0, (0.1, 3.0)), (0.5, -0.04, -0.02),
    remark=". The trim follows the airspeed, so in one manoeuvre it says much the same as alpha does: diagnosis never "
    "proposes it", candidate=False)
CANARD_LIFT = derivative("canard_lift", "The canard changes the lift.", "CL_attached", "canard",
    ("CLdc", "lift per canard deflection", 0.5, (0.1, 2.0)), (0.4, 0.1, 0.04))
FLAP_LIFT = derivative("flap_lift", "The landing flaps change the lift.", "CL_attached", "flap",
    ("CLdf", "lift per flap deflection", 1.5, (0.05, 3.0)), (0.9, 0.2, 0.18),
    remark=": lift of the attached flow, so that induced drag goes with it")
DLC_LIFT = derivative("dlc_lift", "The direct-lift flaps change the lift.", "CL_attached", "dlc",
    ("CLdlc", "lift per mean deflection of the direct-lift flaps", 1.5, (0.1, 3.0)), (1.2, -0.05, -0.15, -0.12))
SPOILER_LIFT = derivative("spoiler_lift", "The spoilers change the lift.", "CL", "spoilers",
    ("CLds", "lift per mean deflection of the spoilers", 1.0, (0.05, 2.0)), (-0.8, 0.1, 0.2, -0.12), stage=Stage.TOTAL)
MACH_LIFT = effect("mach_lift", "The lift-curve slope changes with Mach number.", "CL_attached += CLaM Mach alpha.",
    lambda v, s, *_: {"CL_attached": v["CLaM"] * s["mach"] * s["alpha"]},
    parameter("CLaM", "1/rad", "lift-curve slope per Mach number", 15.0, (0.5, 20.0), place=23),
    example=Example({"CLaM": 9.0}, {"alpha": 0.1, "mach": 0.3}, {"CL_attached": 0.27}, "9 x 0.3 x 0.1, by hand"),
    source=ATTAS)
SPEED_LIFT = derivative("speed_lift", "The lift coefficient changes with airspeed.", "CL_attached", "speed",
    ("CLV", "lift per V/V0", 1.0, (0.05, 2.0)), (0.5, 80.0, 0.4), source=HFB_320, candidate=False)
SIDESLIP_LIFT = derivative("sideslip_lift", "Sideslip changes the lift.", "CL", "beta^2",
    ("CLb2", "lift per sideslip squared", 10.0, (2.0, 20.0)), (-3.0, -0.1, -0.03), source=EVEN_TERM, stage=Stage.TOTAL)

# Drag: the polar, then the controls, speed and sideslip.
PROFILE_DRAG = derivative("profile_drag", "The aircraft has drag at zero lift.", "CD", "1",
    ("CD0", "zero-lift drag", Prior("normal", 0.04, 0.05), (0.001, 0.2)), (0.04, 0.1, 0.04),
    limits=Limits(0.0, math.inf, "drag without lift cannot be negative"), place=11, source=STALL_MODEL)

# Sizes are those of 1/e, which is 0 where e is neutral; CD is linear in it.
INDUCED_DRAG = effect("induced_drag", "Drag grows with the square of the lift.",
    "CD += CL_attached^2/(e pi AR): the published model squares the attached lift, not the Kirchhoff lift.",
    lambda v, _s, a, known: {"CD": xp.square(known["CL_attached"]) / (v["e"] * xp.pi * a.aspect_ratio)},
    parameter("e", "1", "Oswald efficiency factor",
        Prior("lognormal", 0.8, 0.5, "around 0.8 for a transport; our choice"), (0.02, 3.0), (0.05, 10.0),
        neutral=math.inf, limits=Limits(0.0, 1.5, "no wing has so little induced drag"), place=12),
    example=Example({"e": 0.8}, {"alpha": 0.1}, {"CD": 1.0 / (0.8 * math.pi * 7.0)}, "by hand, aspect ratio 7",
        known={"CL_attached": 1.0}), source=STALL_MODEL, stage=Stage.TOTAL, scan={"e": (0.8, )})
DRAG_OFFSET = effect("drag_offset", "Drag is least at a lift other than zero: the wing is cambered.",
    "CD += (CLmin^2 - 2 CL_attached CLmin)/(e pi AR), so that the polar becomes (CL_attached - CLmin)^2/(e pi AR).",
    lambda v, _s, a, known: {
        "CD": v["CLmin"] * (v["CLmin"] - 2.0 * known["CL_attached"]) / (v["e"] * xp.pi * a.aspect_ratio)},
    parameter("CLmin", "1", "lift at least drag", 0.25, (0.02, 0.5)),
    example=Example({"CLmin": 0.2, "e": 0.8}, {"alpha": 0.1}, {"CD": -0.36 / (0.8 * math.pi * 7.0)},
        "0.2^2 - 2 x 1 x 0.2 = -0.36, by hand, aspect ratio 7", known={"CL_attached": 1.0}),
    source="quadratic polar of a cambered wing; textbook form", stage=Stage.TOTAL)
ALPHA_DRAG = derivative("alpha_drag", "Drag grows linearly with the angle of attack.", "CD", "alpha",
    ("CDa", "drag per angle of attack", 1.0, (0.0125, 1.0)), (0.3, 0.1, 0.03),
    remark=": the tangent of the drag polar at a trim point. Where induced drag is in the model it says the same once "
    "more, so diagnosis never proposes it", source=HFB_320, candidate=False)
ELEVATOR_DRAG = derivative("elevator_drag", "Elevator deflection changes the drag.", "CD", "elevator",
    ("CDde", "drag per elevator deflection", 0.15, (0.02, 0.3)), (0.05, -0.12, -0.006),
    remark=", signed: the trimmed tail carries load, so the slope at de = 0 is not zero", stage=Stage.TOTAL)
STABILIZER_DRAG = derivative("stabilizer_drag", "The trim of the stabilizer changes the drag.", "CD", "stabilizer",
    ("CDih", "drag per stabilizer deflection", 0.25, (0.02, 0.5)), (0.1, -0.05, -0.005),
    remark=", signed: the trimmed tail carries load. The trim follows the airspeed, so in one manoeuvre it says much "
    "the same as alpha does: diagnosis never proposes it", stage=Stage.TOTAL, candidate=False)
CANARD_DRAG = derivative("canard_drag", "Canard deflection changes the drag.", "CD", "canard",
    ("CDdc", "drag per canard deflection", 0.15, (0.02, 0.3)), (0.05, 0.2, 0.01),
    remark=", signed: the trimmed canard carries load, so the slope at zero deflection is not zero", stage=Stage.TOTAL)

# Beyond the induced drag of the lift of the flaps.
FLAP_DRAG = derivative("flap_drag", "The landing flaps change the drag.", "CD", "flap",
    ("CDdf", "drag per flap deflection", 0.25, (0.01, 0.5)), (0.15, 0.2, 0.03), stage=Stage.TOTAL)
SPOILER_DRAG = derivative("spoiler_drag", "The spoilers change the drag.", "CD", "spoilers",
    ("CDds", "drag per mean deflection of the spoilers", 0.25, (0.01, 0.5)), (0.2, 0.1, 0.3, 0.04), stage=Stage.TOTAL)
MACH_DRAG = derivative("mach_drag", "The drag changes with Mach number.", "CD", "mach",
    ("CDM", "drag per Mach number", 0.15, (0.01, 0.3)), (0.1, 0.3, 0.03), source=MACH_TERM, stage=Stage.TOTAL)
SPEED_DRAG = derivative("speed_drag", "The drag coefficient changes with airspeed.", "CD", "speed",
    ("CDV", "drag per V/V0", 0.2, (0.005, 0.5)), (0.05, 80.0, 0.04), source=HFB_320, stage=Stage.TOTAL, candidate=False)
SIDESLIP_DRAG = derivative("sideslip_drag", "Sideslip adds drag.", "CD", "beta^2",
    ("CDb2", "drag per sideslip squared", 2.5, (0.2, 5.0)), (0.8, 0.05, 0.002), source=EVEN_TERM, stage=Stage.TOTAL)

# Pitching moment: static stability and damping.
PITCHING_MOMENT = effect("pitching_moment",
    "The aircraft has a static pitching moment that changes linearly with the angle of attack.",
    "Cm += Cm0 + Cma alpha.", lambda v, s, *_: {"Cm": v["Cm0"] + v["Cma"] * s["alpha"]},
    parameter("Cm0", "1", "pitching moment at zero angle of attack", 0.2, (0.002, 0.3), start=0.05, place=31),
    parameter("Cma", "1/rad", "static stability", Prior("normal", -0.5, 1.0), (0.02, 3.0), place=32),
    example=Example({"Cm0": 0.05, "Cma": -0.5}, {"alpha": 0.2}, {"Cm": -0.05}, "0.05 - 0.5 x 0.2, by hand"),
    source=STALL_MODEL)
ALPHA_SQUARED_MOMENT = effect("alpha_squared_moment", "The pitching moment is curved over the angle of attack.",
    "Cm += Cma2 alpha^2.", lambda v, s, *_: {"Cm": v["Cma2"] * s["alpha"] * s["alpha"]},
    parameter("Cma2", "1/rad^2", "pitching moment per squared angle of attack", 5.0, (0.3, 10.0)),
    example=Example({"Cma2": -1.5}, {"alpha": 0.2}, {"Cm": -0.06}, "-1.5 x 0.2^2, by hand"),
    source="second term of a Taylor series; our choice of form", stage=Stage.TOTAL)
PITCH_DAMPING = effect("pitch_damping", "Pitch rate is damped by a pitching moment.",
    "Cm += Cmq q c/V (not q c/2V, so Cmq is half of what many texts print); length and speed as `reduced` has them.",
    lambda v, s, a, _: {"Cm": reduced(v["Cmq"] * s["q"], s["airspeed"], a)},
    parameter("Cmq", "1", "pitch damping, per q c/V", Prior("normal", -8.0, 10.0), (1.0, 30.0), lengths=(Length.RATE, ),
        limits=Limits(-math.inf, 0.0, "pitch rate would not be damped"), place=33),
    example=Example({"Cmq": -6.0}, {"q": 0.1, "airspeed": 60.0}, {"Cm": -0.03}, "by hand, chord 3 m"),
    source=f"{ATTAS} (qhat = q c/V)")
ALPHA_DOT_MOMENT = derivative("alpha_dot_moment",
    "A changing angle of attack pitches the aircraft: downwash needs time to reach the tail.", "Cm", "alpha_dot",
    ("Cmadot", "pitching moment due to alpha-dot, per alpha_dot c/V", 10.0, (1.0, 20.0)), (-4.0, 0.05, 60.0, -0.01),
    stage=Stage.TOTAL)

# Pitching moment of the controls.


def with_tail_lift(derivative: Any, deflection: Any, a: Aircraft) -> Increments:
    """Pitching moment of a surface at the tail, and the lift of the force that makes it at the tail arm."""
    lift = -derivative * a.chord / a.tail_arm
    return {"Cm": derivative * deflection, "CL_attached": lift * deflection}


ELEVATOR_MOMENT = effect("elevator_moment",
    "The elevator pitches the aircraft (trailing edge down is positive, so Cmde < 0).",
    "Cm += Cmde de; CL_attached += CLde de with CLde = -Cmde c/l_tail (force at the tail arm makes the moment).",
    lambda v, s, a, _: with_tail_lift(v["Cmde"], s["elevator"], a),
    parameter("Cmde", "1/rad", "elevator effectiveness", Prior("normal", -0.8, 1.0), (0.03, 3.0),
        sign=Sign(-1, "elevator", "a positive deflection (trailing edge down) would pitch the nose up"), place=34),
    example=Example({"Cmde": -0.5}, {"elevator": 0.1}, {"Cm": -0.05, "CL_attached": 0.05 * 3.0 / 15.0},
        "by hand, chord 3 m and tail arm 15 m"), source=ATTAS)
STABILIZER_TRIM = effect("stabilizer_trim", "The stabilizer was trimmed during the manoeuvre and pitches the aircraft.",
    "Cm += Cmih ih; CL_attached += CLih ih with CLih = -Cmih c/l_tail, as for the elevator.",
    lambda v, s, a, _: with_tail_lift(v["Cmih"], s["stabilizer"], a),
    parameter("Cmih", "1/rad", "stabilizer effectiveness", 2.5, (0.1, 5.0)),
    example=Example({"Cmih": -2.0}, {"stabilizer": -0.03}, {"Cm": 0.06, "CL_attached": -0.012},
        "-2 x -0.03, and -0.06 x 3/15; by hand, chord 3 m and tail arm 15 m"),
    source="a force at the tail arm makes the moment, by geometry")
CANARD_MOMENT = derivative("canard_moment",
    "The canard pitches the aircraft (trailing edge down is positive, so Cmdc > 0).", "Cm", "canard",
    ("Cmdc", "canard effectiveness", 1.0, (0.03, 3.0)), (0.6, 0.1, 0.06),
    remark=": ahead of the centre of gravity, trailing edge down pitches up")
FLAP_MOMENT = derivative("flap_moment", "The landing flaps pitch the aircraft.", "Cm", "flap",
    ("Cmdf", "pitching moment per flap deflection", 0.5, (0.02, 1.0)), (-0.2, 0.3, -0.06), stage=Stage.TOTAL)
DLC_MOMENT = derivative("dlc_moment", "The direct-lift flaps pitch the aircraft.", "Cm", "dlc",
    ("Cmdlc", "pitching moment per mean deflection of the direct-lift flaps", 0.5, (0.02, 1.0)),
    (-0.2, 0.1, 0.2, -0.03), stage=Stage.TOTAL)
SPOILER_MOMENT = derivative("spoiler_moment", "The spoilers pitch the aircraft.", "Cm", "spoilers",
    ("Cmds", "pitching moment per mean deflection of the spoilers", 0.5, (0.02, 1.0)), (0.3, 0.0, 0.2, 0.03),
    stage=Stage.TOTAL)
RUDDER_MOMENT = effect("rudder_moment", "Rudder deflection pitches the aircraft.",
    "Cm += Cmdr |dr|: even in dr, for the aircraft is symmetric.",
    lambda v, s, *_: {"Cm": v["Cmdr"] * xp.abs(s["rudder"])},
    parameter("Cmdr", "1/rad", "pitching moment per rudder deflection", 0.25, (0.04, 0.5)),
    example=Example({"Cmdr": 0.1}, {"rudder": -0.04}, {"Cm": 0.004}, "0.1 x 0.04, by hand"),
    source="even in the deflection by symmetry; our choice of form", stage=Stage.TOTAL)

# Pitching moment of speed and sideslip.
MACH_MOMENT = derivative("mach_moment", "The pitching moment changes with Mach number.", "Cm", "mach",
    ("CmM", "pitching moment per Mach number", 0.25, (0.02, 0.5)), (0.2, 0.25, 0.05), source=MACH_TERM,
    stage=Stage.TOTAL)
SPEED_MOMENT = derivative("speed_moment", "The pitching moment coefficient changes with airspeed.", "Cm", "speed",
    ("CmV", "pitching moment per V/V0", 0.3, (0.01, 0.5)), (-0.1, 80.0, -0.08), source=HFB_320, stage=Stage.TOTAL,
    candidate=False)
SIDESLIP_MOMENT = derivative("sideslip_moment", "Sideslip pitches the aircraft.", "Cm", "beta^2",
    ("Cmb2", "pitching moment per sideslip squared", 5.0, (0.4, 10.0)), (-2.0, 0.1, -0.02), source=EVEN_TERM,
    stage=Stage.TOTAL)
