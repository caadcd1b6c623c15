"""Errors of the card's masses, of the thrust, and of the air."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from bayes_aero.arrays import xp
from bayes_aero.effect import Disturbance, Effect, Example, Increments, Kind, Signals, Stage, Values, effect, parameter
from bayes_aero.parameter import Prior
from bayes_aero.physics.aircraft import Aircraft, Axis
from bayes_aero.physics.filters import lagged

ETKIN_REID = "Etkin and Reid, Dynamics of Flight, 3rd ed. 1996, ch. 13; of first order, where Dryden has second"
RELATIVE_ERROR = "definition of a relative error"
PLACES = ("reference_point", "accelerometer", "engine")
THRUSTS = ("thrust", "thrust_left", "thrust_right")  # the last two where they are recorded

# fmt: off

# Mass, inertia, centre of gravity.
MASS_SCALE = effect("mass_scale", "The aircraft is heavier or lighter than the card says.",
    "True mass = (1 + mass_scale) of the card's; the inertias stay.",
    lambda v, _s, a, _: {"mass": v["mass_scale"] * a.mass},
    parameter("mass_scale", "1", "relative departure of the mass from the card", 0.075, (0.01, 0.15), (-0.5, 1.0)),
    example=Example({"mass_scale": 0.04}, {}, {"mass": 600.0}, "4 % of 15000 kg, by hand"), source=RELATIVE_ERROR,
    kind=Kind.MASS, stage=Stage.AIRCRAFT)


def inertia_scale(name: str, inertia: str, what: str, example: tuple[float, float, str], **fields: Any) -> Effect:
    """A relative error of a moment of inertia. `example`: the error, what it adds to the card's, kg m^2, and why."""
    error, more, by_hand = example
    return effect(
        name, f"The {what} inertia is larger or smaller than the card says.",
        f"True {inertia} = (1 + {name}) of the card's.", lambda v, _s, a, _: {inertia: v[name] * getattr(a, inertia)},
        parameter(name, "1", f"relative departure of {inertia} from the card", 0.15, (0.03, 0.3), (-0.5, 1.0)),
        example=Example({name: error}, {}, {inertia: more}, by_hand),
        source=RELATIVE_ERROR, kind=Kind.MASS, stage=Stage.AIRCRAFT, **fields)
INERTIA_SCALE = inertia_scale("inertia_scale", "Iy", "pitch", (-0.05, -10000.0, "-5 % of 200000 kg m^2, by hand"))
ROLL_INERTIA_SCALE = inertia_scale("roll_inertia_scale", "Ix", "roll",
    (-0.05, -5000.0, "-5 % of 100000 kg m^2, by hand"), axis=Axis.LATERAL)
YAW_INERTIA_SCALE = inertia_scale("yaw_inertia_scale", "Iz", "yaw", (-0.05, -15000.0, "-5 % of 300000 kg m^2, by hand"),
    axis=Axis.LATERAL)
INERTIA_PRODUCT = effect("inertia_product",
    "The principal axes of inertia are inclined otherwise than the card says, and so couple roll and yaw.",
    "True Ixz = the card's + inertia_product Iz.", lambda v, _s, a, _: {"Ixz": v["inertia_product"] * a.Iz},
    parameter("inertia_product", "1", "departure of Ixz from the card, share of Iz", 0.03, (0.005, 0.1), (-0.3, 0.3)),
    example=Example({"inertia_product": 0.02}, {}, {"Ixz": 6000.0}, "2 % of 300000 kg m^2, by hand"),
    source=RELATIVE_ERROR, kind=Kind.MASS, stage=Stage.AIRCRAFT, axis=Axis.LATERAL)
CG_SHIFT = effect("cg_shift", "The centre of gravity lies further forward or aft than the card says.",
    "Positions are measured from the CG: with it dx further forward, all else lies dx further aft.",
    lambda v, *_: dict.fromkeys(PLACES, (-v["cg_shift"], 0.0, 0.0)) | {"tail_arm": v["cg_shift"]},
    parameter("cg_shift", "m", "CG forward of the card's position", 0.25, (0.03, 0.5), (-2.0, 2.0)),
    example=Example({"cg_shift": 0.1}, {},
        {"reference_point": (-0.1, 0.0, 0.0), "accelerometer": (-0.1, 0.0, 0.0), "engine": (-0.1, 0.0, 0.0),
            "tail_arm": 0.1}, "geometry, by hand"), source="geometry", kind=Kind.MASS, stage=Stage.AIRCRAFT)
LATERAL_CG_SHIFT = effect("lateral_cg_shift",
    "The centre of gravity lies further right or left than the card says, by an asymmetry of fuel for instance.",
    "Positions are measured from the CG: with it dy further right, all else lies dy further left.",
    lambda v, *_: dict.fromkeys(PLACES, (0.0, -v["lateral_cg_shift"], 0.0)),
    parameter("lateral_cg_shift", "m", "CG right of the card's position", 0.1, (0.02, 0.5), (-2.0, 2.0)),
    example=Example({"lateral_cg_shift": 0.1}, {},
        {"reference_point": (0.0, -0.1, 0.0), "accelerometer": (0.0, -0.1, 0.0), "engine": (0.0, -0.1, 0.0)},
        "geometry, by hand"), source="geometry", kind=Kind.MASS, stage=Stage.AIRCRAFT, axis=Axis.LATERAL)

# Thrust.
THRUST_SCALE = effect("thrust_scale", "The engines deliver more or less thrust than the record says.",
    "True thrust = (1 + thrust_scale) computed thrust, of the left and the right engine too where recorded.",
    lambda v, s, *_: {name: v["thrust_scale"] * s[name] for name in THRUSTS if name in s},
    parameter("thrust_scale", "1", "relative error of the computed thrust", 0.15, (0.02, 0.3), (-0.95, 9.0)),
    example=Example({"thrust_scale": -0.1}, {"thrust": 12000.0}, {"thrust": -1200.0}, "-10 % of 12000 N, by hand"),
    source=RELATIVE_ERROR, kind=Kind.PROPULSION, stage=Stage.CHANNEL)


def _thrust_lag(v: Values, s: Signals, *_: Any) -> Increments:
    recorded = {name: s[name] for name in THRUSTS if name in s}
    tau = v["thrust_lag"] + xp.zeros_like(s["thrust"])
    return {name: lagged(T, tau, s["dt"], s["start"]) - T for name, T in recorded.items()}


THRUST_LAG = effect("thrust_lag", "The thrust follows what the record says with a lag.",
    "thrust_lag dT/dt + T = computed thrust, in equilibrium at the start of each manoeuvre; so of either engine.",
    _thrust_lag,
    parameter("thrust_lag", "s", "time constant of the thrust", Prior("halfnormal", 0.0, 2.5), (0.3, 5.0), (0.0, 20.0),
        start=1.0),
    example=Example({"thrust_lag": 1.0},
        {"thrust": (0.0, 1000.0, 2000.0), "dt": (1.0, 1.0, 1.0), "start": (1.0, 0.0, 0.0)},
        {"thrust": (0.0, 1000.0 * (math.exp(-1.0) - 1.0), 1000.0 * (math.exp(-2.0) - 1.0))},
        "a first-order lag of 1 s behind a ramp of 1000 N/s: -1000 (1 - exp(-t)), closed form"),
    source="first-order lag; our choice of form", kind=Kind.PROPULSION, stage=Stage.CHANNEL,
    scan={"thrust_lag": (0.5, 1.0, 2.0, 4.0)})


def pressure_area(s: Signals, a: Aircraft) -> Any:
    """Dynamic pressure times wing area, N."""
    return 0.5 * s["density"] * xp.square(s["airspeed"]) * a.wing_area


THRUST_MOMENT = effect("thrust_moment",
    "Thrust pitches the aircraft more or less than the position of the engines says.",
    "Cm += T thrust_arm/(qbar S c): a line further down pitches up.",
    lambda v, s, a, _: {"Cm": v["thrust_arm"] * s["thrust"] / (pressure_area(s, a) * a.chord)},
    parameter("thrust_arm", "m", "how much lower the thrust line lies than on the card", 0.5, (0.05, 2.0)),
    example=Example({"thrust_arm": 0.3}, {"thrust": 9000.0, "density": 1.0, "airspeed": 60.0}, {"Cm": 1.0 / 120.0},
        "9000 x 0.3/(1800 x 60 x 3), by hand, 60 m^2 and chord 3 m"),
    source="a force at an arm makes a moment, by mechanics", kind=Kind.PROPULSION, stage=Stage.TOTAL, together=True)
THRUST_LIFT = effect("thrust_lift", "Thrust makes lift beyond what the inclination of the engines says.",
    "CL += thrust_lift T/(qbar S).", lambda v, s, a, _: {"CL": v["thrust_lift"] * s["thrust"] / pressure_area(s, a)},
    parameter("thrust_lift", "1", "lift per thrust (an inclination in rad)", 0.5, (0.1, 1.0)),
    example=Example({"thrust_lift": 0.2}, {"thrust": 10800.0, "density": 1.0, "airspeed": 60.0}, {"CL": 0.02},
        "0.2 x 10800/(1800 x 60), by hand, 60 m^2"),
    source="an inclined thrust has a lift component, by mechanics; interference lumped with it is our choice",
    kind=Kind.PROPULSION, stage=Stage.TOTAL, together=True)


def _thrust_asymmetry(v: Values, s: Signals, *_: Any) -> Increments:
    more = v["thrust_asymmetry"] * 0.5 * (s["thrust_left"] + s["thrust_right"])
    return {"thrust_left": more, "thrust_right": -more}


THRUST_ASYMMETRY = effect("thrust_asymmetry",
    "The left engine delivers more thrust than recorded and the right one less (or reversed, where negative).",
    "True left and right thrust = recorded + and - thrust_asymmetry times their mean: the total stays.",
    _thrust_asymmetry,
    parameter("thrust_asymmetry", "1", "share by which the left engine delivers more", 0.1, (0.01, 0.5), (-1.0, 1.0)),
    example=Example({"thrust_asymmetry": 0.05}, {"thrust_left": 5000.0, "thrust_right": 7000.0},
        {"thrust_left": 300.0, "thrust_right": -300.0}, "5 % of 6000 N, by hand"), source=RELATIVE_ERROR,
    kind=Kind.PROPULSION, stage=Stage.CHANNEL, axis=Axis.LATERAL)

# The air.
DENSITY_SCALE = effect("density_scale", "The air is denser or thinner than the record says.",
    "Recorded = (1 + density_scale) true.",
    lambda v, s, *_: {"density": s["density"] / (1.0 + v["density_scale"]) - s["density"]},
    parameter("density_scale", "1", "relative error of the recorded air density", 0.05, (0.01, 0.1), (-0.5, 1.0)),
    example=Example({"density_scale": 0.04}, {"density": 0.78}, {"density": -0.03},
        "recorded 0.78 = 1.04 x 0.75, by hand"), source=RELATIVE_ERROR, kind=Kind.ENVIRONMENT, stage=Stage.CHANNEL)
VERTICAL_WIND = effect("vertical_wind", "A steady updraft or downdraft carries the aircraft.",
    "altitude += -vertical_wind t: the altitude that the flight through the air alone would have given.",
    lambda v, s, *_: {"altitude": -v["vertical_wind"] * s["elapsed"]},
    parameter("vertical_wind", "m/s", "constant updraft", 2.5, (0.2, 5.0)),
    example=Example({"vertical_wind": 1.5}, {"altitude": 5000.0, "elapsed": 40.0}, {"altitude": -60.0},
        "1.5 m/s for 40 s, by hand"), source="kinematics: the air moves with the wind", kind=Kind.ENVIRONMENT,
    stage=Stage.CHANNEL)

# Gusts and buffet: random processes that the filter follows.


def gust(name: str, state: str, formula: str, increments: Callable[..., Increments], **fields: Any) -> Effect:
    """A gust of first order along one axis; the aircraft flies through air that is frozen. `state`: its speed, m/s."""
    words, length = name.replace("_", " "), f"{name}_length"
    strength = Prior("halfnormal", 0.0, 3.0, "MIL-F-8785C: 1.5 m/s is light, 3 m/s moderate turbulence")
    scale = "MIL-F-8785C: the height near the ground, 533 m above 610 m; our choice"
    return effect(
        name, f"{words.capitalize()}s disturb the flight.", formula, increments,
        parameter(name, "m/s", f"standard deviation of the {words}", strength, (0.1, 10.0), (0.0, 20.0), start=0.5),
        parameter(length, "m", f"scale length of the {words}", Prior("lognormal", 300.0, 0.7, scale), (20.0, 1000.0),
            (10.0, 5000.0), neutral=300.0),
        kind=Kind.ENVIRONMENT, stage=Stage.INFLOW, channels=("airspeed", state), candidate=False,
        disturbance=Disturbance(state, "m/s", name, lambda v, s, _: s["airspeed"] / v[length]), **fields)
VERTICAL_GUST = gust("vertical_gust", "gust_w",
    "alpha += gust_w / airspeed; gust_w is the air's motion along the upward normal of the path, m/s.",
    lambda _v, s, *_: {"alpha": s["gust_w"] / s["airspeed"]},
    example=Example({"vertical_gust": 1.0}, {"airspeed": 100.0, "gust_w": 2.0}, {"alpha": 0.02},
        "2 m/s at 100 m/s, by hand"), source=ETKIN_REID)
LATERAL_GUST = gust("lateral_gust", "gust_v",
    "beta += gust_v / airspeed; gust_v is the air's motion to the left across the path, m/s.",
    lambda _v, s, *_: {"beta": s["gust_v"] / s["airspeed"]},
    example=Example({"lateral_gust": 1.0}, {"airspeed": 100.0, "gust_v": 2.0}, {"beta": 0.02},
        "2 m/s at 100 m/s, by hand"), source=ETKIN_REID, axis=Axis.LATERAL)
LONGITUDINAL_GUST = gust("longitudinal_gust", "gust_u", "airspeed += gust_u, the air's motion against the flight, m/s.",
    lambda _v, s, *_: {"airspeed": s["gust_u"]},
    example=Example({"longitudinal_gust": 1.0}, {"airspeed": 100.0, "gust_u": 2.0}, {"airspeed": 2.0}, "by hand"),
    source="MIL-F-8785C: Dryden's longitudinal gust")

# Its rate is V/(length c): eddies pass the aircraft at its airspeed.
BUFFET = effect("buffet", "Buffet of separated flow shakes the lift.",
    "CL += buffet (1 - X); `buffet` is the fluctuation of the lift coefficient of wholly separated flow.",
    lambda _v, s, _, known: {"CL": s["buffet"] * (1.0 - known["X"])},
    parameter("buffet", "1", "standard deviation of the lift coefficient of fully separated flow",
        Prior("halfnormal", 0.0, 0.2, "heavy buffet shakes the normal force by a tenth of itself; our choice"),
        (0.005, 0.5), (0.0, 2.0), start=0.05),
    parameter("buffet_length", "c/V", "correlation of buffet, chords travelled",
        Prior("lognormal", 3.0, 0.7, "reduced frequencies f c/V of a few hundredths to a few tenths; our choice"),
        (0.5, 30.0), (0.3, 50.0), neutral=3.0),
    example=Example({"buffet": 0.1, "buffet_length": 3.0}, {"buffet": 0.08}, {"CL": 0.06}, "0.08 x (1 - 1/4), by hand",
        known={"X": 0.25}),
    source="Mabey 1973, J. Aircraft 10, 642 (buffet over the separated part of a wing); of first order, our choice",
    kind=Kind.ENVIRONMENT, stage=Stage.TOTAL, candidate=False,
    disturbance=Disturbance("buffet", "1", "buffet", lambda v, s, a: s["airspeed"] / (v["buffet_length"] * a.chord)))
