"""Flow separation and what depends on it: X is the separation point, 1 in attached and 0 in separated flow."""

from __future__ import annotations

import math

from bayes_aero.arrays import xp
from bayes_aero.effect import (
    STALL_MODEL,
    Example,
    Increments,
    Known,
    Signals,
    Stage,
    Values,
    derivative,
    effect,
    parameter,
)
from bayes_aero.parameter import Length, Prior, Role
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.physics.filters import kept_lift, kirchhoff_factor, lagged, moments_of_difference, separation_point

ATTACHED = 10.0  # rad; so far above any angle of attack that X is 1 to the last bit

# fmt: off

# Where the flow separates.

# alpha* goes from 10 rad, its neutral value, to 0.5 or 0.1 rad: the sizes are how far.
FLOW_SEPARATION = effect("flow_separation",
    "The flow separates from the trailing edge as the angle of attack approaches the break point.",
    "X = (1 - tanh(a1 (incidence - alpha*)))/2.",
    lambda v, _s, _, known: {"X": separation_point(v["a1"], known["incidence"], v["alpha_star"]) - 1.0},
    parameter("a1", "1/rad", "abruptness of the stall",
        Prior("lognormal", 20.0, 0.7, "a factor of four either way with 95 %; our choice"), (2.0, 80.0), (1.0, 200.0),
        neutral=20.0, role=Role.ABRUPTNESS, place=41),
    parameter("alpha_star", "rad", "angle of attack at which X = 1/2",
        Prior("normal", 0.3, 0.1, "stall of a transport between 10 and 25 deg; our choice"),
        (ATTACHED - 0.5, ATTACHED - 0.1), (0.0, 1.0), neutral=ATTACHED, role=Role.BREAK_ANGLE, place=42),
    example=Example({"a1": 20.0, "alpha_star": 0.3}, {"alpha": 0.32}, {"X": (1.0 - math.tanh(0.4)) / 2.0 - 1.0},
        "the definition of X, by hand"), source="Goman and Khrabrov 1994; Fischenberg and Jategaonkar 1999",
    stage=Stage.SEPARATION, scan={"alpha_star": (0.2, 0.25, 0.3, 0.35)})
SEPARATION_LAG = effect("separation_lag", "The separation point needs time to follow the angle of attack.",
    "tau1 c/V dX/dt + X = X_static, from rest at the start of each manoeuvre.",
    lambda v, s, a, known: {
        "X": lagged(known["X"], v["tau1"] * a.chord / s["airspeed"], s["dt"], s["start"]) - known["X"]},
    parameter("tau1", "c/V", "lag of the separation point, chords travelled",
        Prior("halfnormal", 0.0, 15.0, "up to some thirty chords; our choice"), (2.0, 50.0), (0.0, 200.0), start=5.0,
        role=Role.LAG, place=43),
    example=Example({"tau1": 0.0}, {"airspeed": 60.0, "dt": 0.04, "start": 1.0}, {"X": 0.0}, "no lag",
        known={"X": 0.7}), source="Goman and Khrabrov 1994", stage=Stage.LAG, scan={"tau1": (5.0, 15.0, 30.0)})
REATTACHMENT_HYSTERESIS = effect("reattachment_hysteresis",
    "The flow reattaches later than it separated: the stall has hysteresis while the angle of attack falls.",
    "incidence += -tau2 c/V alpha_dot where alpha_dot <= 0, nothing where alpha rises (one-sided, as published).",
    lambda v, s, a, _: {"incidence": -v["tau2"] * a.chord / s["airspeed"] * xp.minimum(s["alpha_dot"], 0.0)},
    parameter("tau2", "c/V", "quasi-steady hysteresis time, chords travelled",
        Prior("normal", 15.0, 15.0, "minus 15 to 45 chords with 95 %; our choice"), (2.0, 50.0), (-50.0, 200.0),
        place=44),
    example=Example({"tau2": 20.0}, {"alpha_dot": -0.05, "airspeed": 60.0}, {"incidence": 0.05}, "by hand, chord 3 m"),
    source="Fischenberg and Jategaonkar 1999; one-sided in the program published with the ATTAS data",
    stage=Stage.INCIDENCE)

# tau2_both is not negative: lift would rise with alpha-dot without end, and no motion solves the equations.
SEPARATION_HYSTERESIS = effect("separation_hysteresis",
    "The flow both separates and reattaches later than in steady flow: the stall has hysteresis both ways.",
    "incidence += -tau2_both c/V alpha_dot, whether alpha rises or falls.",
    lambda v, s, a, _: {"incidence": -v["tau2_both"] * a.chord / s["airspeed"] * s["alpha_dot"]},
    parameter("tau2_both", "c/V", "hysteresis time for both signs of alpha-dot, chords travelled", 25.0, (2.0, 50.0),
        (0.0, 200.0)),
    example=Example({"tau2_both": 20.0}, {"alpha_dot": 0.05, "airspeed": 60.0}, {"incidence": -0.05},
        "20 x 3/60 x 0.05, by hand, chord 3 m"),
    source="Goman and Khrabrov 1994: X depends on alpha - tau2 alpha_dot for both signs", stage=Stage.INCIDENCE)

# Lift, drag and pitching moment of separated flow.
KIRCHHOFF_LIFT = effect("kirchhoff_lift", "Separated flow loses lift as Kirchhoff's flow past a plate does.",
    "CL += CLa alpha (((1 + sqrt X)/2)^2 - 1), the mean of two wings, on the Mach-independent slope as published.",
    lambda v, s, _, known: {"CL": v["CLa"] * s["alpha"] * (kept_lift(known["X"], known["X_difference"]) - 1.0)},
    example=Example({"CLa": 4.0}, {"alpha": 0.2}, {"CL": 4.0 * 0.2 * (0.5625 - 1.0)}, "X = 1/4, by hand",
        known={"X": 0.25}), source="Kirchhoff's theory of free streamlines; Fischenberg and Jategaonkar 1999",
    stage=Stage.TOTAL)
SEPARATED_DRAG = derivative("separated_drag", "Separated flow adds drag.", "CD", "1",
    ("CDX", "drag of fully separated flow", Prior("normal", 0.1, 0.2), (0.003, 0.4)), (0.08, 0.2, 0.06), start=0.05,
    place=13, separated="1/4", source=STALL_MODEL)


def _separated_induced_drag(v: Values, s: Signals, a: Aircraft, known: Known) -> Increments:
    attached = known["CL_attached"]
    lost = v["CLa"] * s["alpha"] * (1.0 - kept_lift(known["X"], known["X_difference"]))
    return {"CD": v["induced_share"] * lost * (lost - 2.0 * attached) / (v["e"] * xp.pi * a.aspect_ratio)}


SEPARATED_INDUCED_DRAG = effect("separated_induced_drag",
    "Induced drag falls with the lift when the flow separates; the published model keeps that of attached flow.",
    "CD += share (CL^2 - CL_attached^2)/(e pi AR), where CL is the attached lift less what Kirchhoff's flow loses.",
    _separated_induced_drag,
    parameter("induced_share", "1",
        "share of the induced drag that is lost with the lift; 1: the drag is that of the lift that is left", 1.0,
        (0.1, 1.0), (-1.0, 2.0)),
    example=Example({"induced_share": 1.0, "CLa": 4.0, "e": 0.8}, {"alpha": 0.2},
        {"CD": (0.65**2 - 1.0) / (0.8 * math.pi * 7.0)},
        "X = 1/4 leaves 1 - 0.8 x 0.4375 = 0.65 of a lift of 1, by hand, aspect ratio 7",
        known={"CL_attached": 1.0, "X": 0.25}),
    source="induced drag of the actual lift, CL^2/(e pi AR): the textbook polar, beyond the stall too",
    stage=Stage.TOTAL)
SEPARATED_MOMENT = derivative("separated_moment", "Separated flow pitches the aircraft.", "Cm", "1",
    ("CmX", "pitching moment of fully separated flow", Prior("normal", -0.1, 0.3), (0.005, 0.5)), (-0.12, 0.2, -0.09),
    place=35, separated="1/4", source=STALL_MODEL)

# Derivatives that change as the flow separates.
SEPARATED_ALPHA_MOMENT = derivative("separated_alpha_moment", "Static stability changes as the flow separates.", "Cm",
    "alpha", ("CmaX", "change of static stability in fully separated flow", 1.0, (0.02, 2.0)), (-0.6, 0.25, -0.09),
    separated="0.4")
SEPARATED_DAMPING = derivative("separated_damping", "Pitch damping changes as the flow separates.", "Cm", "q",
    ("CmqX", "change of pitch damping in fully separated flow, per q c/V", 20.0, (2.0, 40.0)), (8.0, 0.1, 60.0, 0.01),
    separated="3/4")
SEPARATED_ELEVATOR = derivative("separated_elevator",
    "The elevator loses or gains effectiveness in the wake of separated flow.", "Cm", "elevator",
    ("CmdeX", "change of elevator effectiveness in fully separated flow", 1.0, (0.07, 2.0)), (0.4, -0.1, -0.03),
    separated="1/4")
SEPARATED_AILERON = derivative("separated_aileron", "The ailerons lose effectiveness as the flow separates.", "Cl",
    "aileron", ("CldaX", "change of aileron effectiveness in fully separated flow", 0.3, (0.01, 0.6)),
    (0.08, -0.1, -0.006), separated="1/4")
SEPARATED_ROLL_DAMPING = derivative("separated_roll_damping",
    "Roll damping fades as the flow separates; beyond the stall the wing may autorotate.", "Cl", "p",
    ("ClpX", "change of roll damping in fully separated flow, per p b/2V", 0.8, (0.05, 2.0)), (0.4, 0.3, 60.0, 0.01),
    separated="1/2")

# A left and a right wing that stall at different angles: see `Model.flow`.
WING_ASYMMETRY = derivative("wing_asymmetry",
    "One wing stalls at a smaller angle of attack than the other (the right one first where positive).",
    "incidence_difference", "1",
    ("wing_asymmetry", "angle by which the right wing stalls before the left",
        Prior("normal", 0.0, 0.0175, "one degree; our choice of width"), (0.003, 0.06)), (0.01, 0.2, 0.01), unit="rad",
    bounds=(-0.2, 0.2), source="a difference of twist, or of the stall angles of the two wings, by definition",
    stage=Stage.INCIDENCE)
ROLL_RATE_INCIDENCE = effect("roll_rate_incidence", "In roll the wing that goes down stalls first.",
    "incidence_difference += 2 roll_station p b/2V: at the share roll_station of the half span.",
    lambda v, s, a, _: {"incidence_difference": 2.0 * v["roll_station"] * s["p"] * a.half_span / s["airspeed"]},
    parameter("roll_station", "1", "station whose roll velocity counts, share of the half span",
        Prior("normal", 0.5, 0.3, "a station on the wing; our choice"), (0.1, 1.5), (-2.0, 2.0)),
    example=Example({"roll_station": 0.6}, {"p": 0.1, "airspeed": 60.0}, {"incidence_difference": 0.02},
        "2 x 0.6 x 0.1 x 10/60, by hand, half span 10 m"), source="velocity of a point of a rigid body",
    stage=Stage.INCIDENCE)
AILERON_INCIDENCE = derivative("aileron_incidence", "The wing whose aileron goes down stalls first.",
    "incidence_difference", "aileron",
    ("aileron_incidence", "difference of incidence, right less left wing, per aileron deflection", 0.5, (0.04, 2.0)),
    (0.4, -0.05, -0.02), unit="1",
    source="a flap that goes down lowers the stall angle of its section; our choice of form", stage=Stage.INCIDENCE)
SIDESLIP_INCIDENCE = derivative("sideslip_incidence",
    "In sideslip the windward wing stalls before the other (after it, where negative).", "incidence_difference", "beta",
    ("sideslip_incidence", "difference of incidence, right less left wing, per sideslip",
        Prior("normal", 0.0, 0.5, "twice the dihedral angle, and sweep; our choice of width"), (0.05, 2.0)),
    (0.2, 0.05, 0.01), unit="1",
    source="a wing with dihedral meets sideslip at an incidence, by geometry; sweep lumped with it is our choice",
    stage=Stage.INCIDENCE)


def _wing_lift_difference(v: Values, s: Signals, a: Aircraft, known: Known) -> Increments:
    half = known["X_difference"] / 2.0
    difference = kirchhoff_factor(known["X"] + half) - kirchhoff_factor(known["X"] - half)
    return moments_of_difference(v["CLa"] * s["alpha"] * difference, xp.zeros_like(half), s["alpha"], a)
WING_LIFT_DIFFERENCE = effect("wing_lift_difference", "The wing with more separated flow drops.",
    "Cl, Cn of CLa alpha ((1 + sqrt X)/2)^2, right less left, half of it on either wing: `moments_of_difference`.",
    _wing_lift_difference,
    example=Example({"CLa": 4.0}, {"alpha": 0.2},
        {"Cl": 0.35 / (3.0 * math.pi) * math.cos(0.2), "Cn": 0.35 / (3.0 * math.pi) * math.sin(0.2)},
        "X = 1/4 right, 1 left: right 9/16 of the lift, so 0.8 x -7/16 at 4/(3 pi) of half a span, by hand",
        known={"X": 0.625, "X_difference": -0.75}),
    source="lift of `kirchhoff_lift`, on either wing at the centroid of an elliptic distribution, by mechanics",
    stage=Stage.TOTAL)
WING_DRAG_DIFFERENCE = effect("wing_drag_difference", "The wing with more separated flow is dragged back.",
    "Cl, Cn of CDX (X left less right), half of it on either wing (see `moments_of_difference`).",
    lambda v, s, a, known: moments_of_difference(
        xp.zeros_like(s["alpha"]), -v["CDX"] * known["X_difference"], s["alpha"], a),
    example=Example({"CDX": 0.12}, {"alpha": 0.2},
        {"Cl": -0.03 / (3.0 * math.pi) * math.sin(0.2), "Cn": 0.03 / (3.0 * math.pi) * math.cos(0.2)},
        "0.12 x 1/4 more drag on the right wing, at 4/(3 pi) of half a span, by hand",
        known={"X": 0.5, "X_difference": -0.25}),
    source="drag of `separated_drag`, on either wing at the centroid of an elliptic distribution, by mechanics",
    stage=Stage.TOTAL)
SEPARATED_ROLL = effect("separated_roll",
    "The difference of separation between the wings rolls the aircraft otherwise than the lift lost says.",
    "Cl += ClX (X right less left).", lambda v, _s, _, known: {"Cl": v["ClX"] * known["X_difference"]},
    parameter("ClX", "1", "rolling moment of a right wing attached and a left one separated", 0.1, (0.005, 0.5),
        start=-0.05, lengths=(Length.LATERAL_MOMENT, )),
    example=Example({"ClX": -0.08}, {"alpha": 0.2}, {"Cl": -0.02}, "-0.08 x 1/4, by hand",
        known={"X": 0.5, "X_difference": 0.25}),
    source="proportional to the difference of the separation points; our choice of form", stage=Stage.TOTAL)
SEPARATED_YAW = effect("separated_yaw",
    "The difference of separation between the wings yaws the aircraft otherwise than their lift and drag say.",
    "Cn += CnX (X right less left).", lambda v, _s, _, known: {"Cn": v["CnX"] * known["X_difference"]},
    parameter("CnX", "1", "yawing moment of a right wing attached and a left one separated", 0.05, (0.005, 0.3),
        start=-0.02, lengths=(Length.LATERAL_MOMENT, )),
    example=Example({"CnX": -0.04}, {"alpha": 0.2}, {"Cn": 0.01}, "-0.04 x -1/4, by hand",
        known={"X": 0.5, "X_difference": -0.25}),
    source="proportional to the difference of the separation points; our choice of form", stage=Stage.TOTAL)
