"""Errors of the record: air data, rates and specific forces, attitudes, deflections of the surfaces."""

from __future__ import annotations

from functools import partial
from typing import Any

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Increments, Kind, Signals, Stage, Values, effect, parameter
from bayes_aero.parameter import Role
from bayes_aero.physics.aircraft import Axis
from bayes_aero.physics.filters import advance, differentiate_joined

DELAY = "definition of a delay; cubic convolution between samples, Keys 1981"
POINT_ACCELERATION = "acceleration of a point of a rigid body; Klein and Morelli 2006, ch. 10"
POINT_VELOCITY = "velocity of a point of a rigid body; Klein and Morelli 2006, ch. 10"
SENSOR_ERRORS = "sensor error model, Klein and Morelli 2006, ch. 10"

RISING = ((0.10, 0.12, 0.15, 0.19), (0.02, 0.03, 0.04, 0.0))
MOVED = ((0.03, 0.0, -0.01, -0.06), (-0.03, -0.01, -0.05, 0.0))
"""Worked examples of a delay: the channel, and each next sample less this one; nothing is known beyond the last."""

sensor_error = partial(effect, kind=Kind.MEASUREMENT, stage=Stage.CHANNEL)

# fmt: off


def bias(
    name: str, channel: str, what: str, unit: str, *, sd: float, sizes: tuple[float, float],
    example: tuple[float, float, float, str],
) -> Effect:
    """A constant error of a channel. `sd`: of its prior. `example`: error, recorded value, what corrects it, why."""
    error, recorded, correction, by_hand = example
    return sensor_error(
        name, f"The recorded {what} is off by a constant.", f"Recorded = true + {name}.",
        lambda v, s, *_: {channel: -v[name] + xp.zeros_like(s[channel])},
        parameter(name, unit, f"constant error of the recorded {what}", sd, sizes),
        example=Example({name: error}, {channel: recorded}, {channel: correction}, f"{by_hand}, by hand"),
        source=SENSOR_ERRORS)


def scale(
    name: str, channel: str, what: str, *, sd: float, sizes: tuple[float, float],
    example: tuple[float, float, float, str], axis: Axis | None = None,
) -> Effect:
    """A proportional error of a channel. `sd`: of its prior. `example`: as of `bias`."""
    error, recorded, correction, by_hand = example
    return sensor_error(
        name, f"The recorded {what} is too large or too small in proportion.", f"Recorded = (1 + {name}) true.",
        lambda v, s, *_: {channel: s[channel] / (1.0 + v[name]) - s[channel]},
        parameter(name, "1", f"relative error of the recorded {what}", sd, sizes, (-0.5, 1.0)),
        example=Example({name: error}, {channel: recorded}, {channel: correction}, f"{by_hand}, by hand"),
        source=SENSOR_ERRORS, axis=axis)


def delay(
    name: str, channel: str, what: str, example: tuple[tuple[float, ...], tuple[float, ...]], **fields: Any
) -> Effect:
    """A delay of a channel. `example`: four samples 0.04 s apart, and what corrects a delay of one sample."""
    recorded, correction = example
    marks = {"dt": (0.04,) * 4, "first": (0,) * 4, "last": (3,) * 4}

    def increments(v: Values, s: Signals, *_: Any) -> Increments:
        x = s[channel]
        return {channel: advance(x, xp.asarray(v[name]), s["dt"], s["first"], s["last"]) - x}

    return sensor_error(
        name, f"The {what} is recorded late (or early, where negative).", f"Recorded(t) = true(t - {name}).",
        increments,
        parameter(name, "s", f"delay of the recorded {what}; positive is late", 0.25, (0.02, 0.5), (-2.0, 2.0),
            role=Role.DELAY),
        example=Example({name: 0.04}, {channel: recorded, **marks}, {channel: correction},
            "one sample late: the next sample less this one, by hand; nothing is known beyond the last"),
        source=DELAY, **fields)


# Air data.
ALPHA_BIAS = bias("alpha_bias", "alpha", "angle of attack", "rad", sd=0.017, sizes=(0.002, 0.035),
    example=(0.01, 0.21, -0.01, "recorded 0.21, true 0.20"))
ALPHA_SCALE = scale("alpha_scale", "alpha", "angle of attack", sd=0.1, sizes=(0.01, 0.2),
    example=(0.1, 0.22, -0.02, "recorded 0.22 = 1.1 x 0.20"))
ALPHA_DELAY = delay("alpha_delay", "alpha", "angle of attack", RISING)


def turned(angle: Any, across: Any) -> Any:
    """By how much a velocity across the flow, as a share of the airspeed, turns it from its angle."""
    return xp.arctan2(across * xp.cos(angle), 1.0 + across * xp.sin(angle))


def _vane_position(v: Values, s: Signals, *_: Any) -> Increments:
    x, V = v["vane_position"], s["airspeed"]
    beta = s.get("beta", xp.zeros_like(V))
    up = x * s["q"] / (V * xp.cos(beta))
    sideslip = {"beta": turned(beta, -x * s["r"] / V)} if "beta" in s and "r" in s else {}
    return {"alpha": turned(s["alpha"], up)} | sideslip


VANE_POSITION = sensor_error("vane_position",
    "The flow angles were recorded ahead of the centre of gravity (or behind it, where negative), on a nose boom "
    "for instance, and still contain what pitch and yaw rate do there.",
    "The flow at the vane is (u, v + x r, w - x q); the angles by which that at the CG is turned from it. To "
    "first order alpha rises by x q/V, beta falls by x r/V. The airspeed is not corrected: its sensor may stand "
    "anywhere, and x q sin(alpha) is small.", _vane_position,
    parameter("vane_position", "m", "distance of the flow-angle sensors ahead of the centre of gravity", 10.0,
        (3.0, 20.0), (-40.0, 40.0)),
    example=Example({"vane_position": 8.0}, {"alpha": 0.0, "beta": 0.0, "q": 0.1, "r": 0.05, "airspeed": 80.0},
        {"alpha": 0.009999666686665, "beta": -0.004999958333958},
        "arctan(8 x 0.1/80) and -arctan(8 x 0.05/80), by hand"), channels=("alpha", "q", "airspeed"),
    source=POINT_VELOCITY)


def in_proportion(s: Signals, share: Any) -> Increments:
    """The airspeed times a share, and the Mach number that follows it."""
    mach = {"mach": s["mach"] * share * s.get("mach_follows", 1.0)} if "mach" in s else {}
    return {"airspeed": s["airspeed"] * share} | mach


AIRSPEED_BIAS = sensor_error("airspeed_bias", "The recorded airspeed is off by a constant.",
    "Recorded = true + airspeed_bias; a Mach number that follows the airspeed is off in proportion.",
    lambda v, s, *_: in_proportion(s, -v["airspeed_bias"] / s["airspeed"]),
    parameter("airspeed_bias", "m/s", "constant error of the recorded airspeed", 4.0, (0.5, 8.0), (-30.0, 30.0)),
    example=Example({"airspeed_bias": 2.0}, {"airspeed": 80.0, "mach": 0.24}, {"airspeed": -2.0, "mach": -0.006},
        "recorded 80, true 78; 0.24 x 2/80; by hand"), channels=("airspeed",), source=SENSOR_ERRORS)
AIRSPEED_SCALE = sensor_error("airspeed_scale", "The recorded airspeed is too large or too small in proportion.",
    "Recorded = (1 + airspeed_scale) true; a Mach number that follows the airspeed likewise.",
    lambda v, s, *_: in_proportion(s, 1.0 / (1.0 + v["airspeed_scale"]) - 1.0),
    parameter("airspeed_scale", "1", "relative error of the recorded airspeed", 0.05, (0.005, 0.1), (-0.5, 1.0)),
    example=Example({"airspeed_scale": 0.05}, {"airspeed": 84.0, "mach": 0.252}, {"airspeed": -4.0, "mach": -0.012},
        "recorded 84 = 1.05 x 80; 0.252 = 1.05 x 0.24; by hand"), channels=("airspeed",), source=SENSOR_ERRORS)

SLOWEST = 1.0  # m/s: no pitot tube measures less
MOST = 0.99  # share of the recorded impact pressure that the error may be


def _pitot_pressure_bias(v: Values, s: Signals, *_: Any) -> Increments:
    impact = 0.5 * s["density"] * xp.maximum(s["airspeed"], SLOWEST) ** 2
    share = xp.minimum(v["pitot_pressure_bias"] / impact, MOST)
    return in_proportion(s, -share / (1.0 + xp.sqrt(1.0 - share)))
PITOT_PRESSURE_BIAS = sensor_error("pitot_pressure_bias",
    "The pressure of the pitot or the static line is off by a constant, so the airspeed is off by the more the "
    "slower the flight.",
    "rho/2 recorded^2 = rho/2 true^2 + pitot_pressure_bias; a Mach number that follows the airspeed likewise.",
    _pitot_pressure_bias,
    parameter("pitot_pressure_bias", "Pa", "constant error of the impact pressure (total less static)", 250.0,
        (30.0, 1000.0), (-3000.0, 3000.0)),
    example=Example({"pitot_pressure_bias": 59.625}, {"airspeed": 80.0, "density": 0.75, "mach": 0.24},
        {"airspeed": -1.0, "mach": -0.003},
        "recorded 0.75/2 x 80^2 = 2400 Pa, true 0.75/2 x 79^2 = 2340.375 Pa; 0.24/80; by hand"),
    channels=("airspeed", "density"),
    source="incompressible impact pressure; errors of pitot-static systems, Gracey, NASA RP-1046, 1980")


def _pitot_position(v: Values, s: Signals, *_: Any) -> Increments:
    x, V, alpha = v["pitot_position"], s["airspeed"], s["alpha"]
    beta = s.get("beta", xp.zeros_like(V))
    r = s.get("r", xp.zeros_like(V))
    right, down = -x * r, x * s["q"]
    # Difference of the squares, so that nothing is lost to rounding.
    more = 2.0 * V * (xp.sin(beta) * right + xp.cos(beta) * xp.sin(alpha) * down) + right**2 + down**2
    return {"airspeed": more / (xp.sqrt(V**2 + more) + V)}


PITOT_POSITION = sensor_error("pitot_position",
    "The airspeed was recorded ahead of the centre of gravity (or behind it, where negative), and still contains "
    "what pitch and yaw rate do there.",
    "The flow at the tube is (u, v + x r, w - x q): its speed is recorded, and that at the CG is true. Exact "
    "where the flow angles are recorded at the tube, too; of angles at the CG to first order in x q/V.",
    _pitot_position,
    parameter("pitot_position", "m", "distance of the pitot tube ahead of the centre of gravity", 10.0, (3.0, 20.0),
        (-40.0, 40.0)),
    example=Example({"pitot_position": 8.0}, {"alpha": 0.0, "beta": 0.0, "q": 0.1, "r": 0.05, "airspeed": 80.0},
        {"airspeed": 0.004999843759765}, "sqrt(80^2 + (8 x 0.05)^2 + (8 x 0.1)^2) - 80, by hand"),
    channels=("airspeed", "alpha", "q"), source=POINT_VELOCITY, candidate=False)
ALTITUDE_SCALE = scale("altitude_scale", "altitude", "altitude", sd=0.05, sizes=(0.005, 0.1),
    example=(0.02, 5100.0, -100.0, "recorded 5100 = 1.02 x 5000"))
SIDESLIP_BIAS = bias("sideslip_bias", "beta", "sideslip", "rad", sd=0.0175, sizes=(0.002, 0.035),
    example=(0.01, 0.03, -0.01, "recorded 0.03, true 0.02"))
SIDESLIP_SCALE = scale("sideslip_scale", "beta", "sideslip", sd=0.1, sizes=(0.02, 0.2),
    example=(0.1, 0.22, -0.02, "recorded 0.22 = 1.1 x 0.2"))
SIDESLIP_DELAY = delay("sideslip_delay", "beta", "sideslip", RISING, axis=Axis.LATERAL)


def sideslip_vane(
    name: str, rate: str, what: str, place: tuple[str, str, str, str], sd: float, sizes: tuple[float, float],
    example: tuple[float, float, str],
) -> Effect:
    """A place of the sideslip sensor, where a rate turns the flow. `place`: in words, where positive, where negative,
    its symbol, and what the parameter is. `example`: place, m, rate, rad/s, and why."""
    (there, behind, x, described), (distance, turning, by_hand) = place, example
    return sensor_error(
        name, f"The sideslip was recorded {there} the centre of gravity (or {behind} it, where negative), and still "
        f"contains what {what} rate does there.",
        f"The vane reads beta + {x[0]} {rate}/V{x[1:]}; what {what} rate does there is taken out.",
        lambda v, s, *_: {"beta": turned(s["beta"], -v[name] * s[rate] / s["airspeed"])},
        parameter(name, "m", described, sd, sizes, (-2.0 * sizes[1], 2.0 * sizes[1])),
        example=Example({name: distance}, {"beta": 0.0, rate: turning, "airspeed": 80.0}, {"beta": -0.004999958333958},
            by_hand),
        source=POINT_VELOCITY, axis=Axis.LATERAL)
SIDESLIP_VANE_POSITION = sideslip_vane("sideslip_vane_position", "r", "yaw",
    ("ahead of", "behind", "x", "distance of the sideslip sensor ahead of the CG, beyond vane_position"), 10.0,
    (1.0, 20.0), (8.0, 0.05, "-arctan(8 x 0.05/80), by hand"))
SIDESLIP_VANE_HEIGHT = sideslip_vane("sideslip_vane_height", "p", "roll",
    ("above", "below", "h at the height h = -z", "height of the sideslip sensor above the CG"), 2.0, (0.5, 10.0),
    (2.0, 0.2, "-arctan(2 x 0.2/80), by hand"))

# Rates.
PITCH_RATE_BIAS = bias("pitch_rate_bias", "q", "pitch rate", "rad/s", sd=0.01, sizes=(0.0005, 0.02),
    example=(0.004, 0.054, -0.004, "recorded 0.054, true 0.050"))
PITCH_RATE_SCALE = scale("pitch_rate_scale", "q", "pitch rate", sd=0.075, sizes=(0.01, 0.15),
    example=(0.05, 0.042, -0.002, "recorded 0.042 = 1.05 x 0.040"))
ROLL_RATE_BIAS = bias("roll_rate_bias", "p", "roll rate", "rad/s", sd=0.01, sizes=(0.0005, 0.02),
    example=(0.004, 0.054, -0.004, "recorded 0.054, true 0.05"))
ROLL_RATE_SCALE = scale("roll_rate_scale", "p", "roll rate", sd=0.075, sizes=(0.01, 0.15),
    example=(0.05, 0.042, -0.002, "recorded 0.042 = 1.05 x 0.04"))
YAW_RATE_BIAS = bias("yaw_rate_bias", "r", "yaw rate", "rad/s", sd=0.01, sizes=(0.0005, 0.02),
    example=(0.004, 0.054, -0.004, "recorded 0.054, true 0.05"))
YAW_RATE_SCALE = scale("yaw_rate_scale", "r", "yaw rate", sd=0.075, sizes=(0.01, 0.15),
    example=(0.05, 0.042, -0.002, "recorded 0.042 = 1.05 x 0.04"))

# Specific forces.
ACCEL_X_BIAS = bias("accel_x_bias", "ax", "longitudinal specific force", "m/s^2", sd=0.25, sizes=(0.01, 0.5),
    example=(0.05, 1.25, -0.05, "recorded 1.25, true 1.20"))
ACCEL_Y_BIAS = bias("accel_y_bias", "ay", "lateral specific force", "m/s^2", sd=0.25, sizes=(0.02, 0.5),
    example=(0.1, 0.4, -0.1, "recorded 0.4, true 0.3"))
ACCEL_Z_BIAS = bias("accel_z_bias", "az", "normal specific force", "m/s^2", sd=0.5, sizes=(0.08, 1.0),
    example=(-0.2, -9.9, 0.2, "recorded -9.9, true -9.7"))
ACCEL_Y_SCALE = scale("accel_y_scale", "ay", "lateral specific force", sd=0.1, sizes=(0.02, 0.3),
    example=(0.25, 0.5, -0.1, "recorded 0.5 = 1.25 x 0.4"))

# All three accelerometers; `accel_y_position` and `accel_y_height` move the lateral one by itself.
ACCELEROMETER_POSITION = effect("accelerometer_position",
    "The accelerometers are ahead of where the card says (or behind it, where negative).",
    "Where they are, by which the record is brought to the centre of gravity.",
    lambda v, _s, *_: {"accelerometer": (v["accelerometer_position"], 0.0, 0.0)},
    parameter("accelerometer_position", "m", "distance of the accelerometers ahead of the place on the card", 2.0,
        (0.3, 5.0), (-20.0, 20.0)),
    example=Example({"accelerometer_position": 0.5}, {}, {"accelerometer": (0.5, 0.0, 0.0)},
        "x is forward; geometry, by hand"), source=POINT_ACCELERATION, kind=Kind.MEASUREMENT, stage=Stage.AIRCRAFT,
    axis=Axis.LATERAL)
ACCELEROMETER_HEIGHT = effect("accelerometer_height",
    "The accelerometers are higher than the card says (or lower, where negative).",
    "Where they are, by which the record is brought to the centre of gravity; z is down.",
    lambda v, _s, *_: {"accelerometer": (0.0, 0.0, -v["accelerometer_height"])},
    parameter("accelerometer_height", "m", "height of the accelerometers above the place on the card", 1.0, (0.2, 3.0),
        (-20.0, 20.0)),
    example=Example({"accelerometer_height": 0.5}, {}, {"accelerometer": (0.0, 0.0, -0.5)},
        "z is down; geometry, by hand"), source=POINT_ACCELERATION, kind=Kind.MEASUREMENT, stage=Stage.AIRCRAFT,
    axis=Axis.LATERAL)


def slope(s: Signals, name: str) -> Any:
    """Time derivative of a channel."""
    return differentiate_joined(s[name], s["dt"], s["first"], s["last"])
ACCEL_Y_POSITION = sensor_error("accel_y_position",
    "The lateral specific force was recorded ahead of where the card says (or behind it, where negative), and "
    "still contains what yaw acceleration does there.", "Recorded = true + x (r_dot + p q).",
    lambda v, s, *_: {"ay": -v["accel_y_position"] * (slope(s, "r") + s["p"] * s["q"])},
    parameter("accel_y_position", "m", "distance of the lateral accelerometer ahead of the place on the card", 2.0,
        (0.3, 5.0), (-20.0, 20.0)),
    example=Example({"accel_y_position": 2.0},
        {"p": (0.2, ) * 5, "r": (0.0, 0.03, 0.06, 0.09, 0.12), "q": (0.1, ) * 5, "dt": (0.1, ) * 5, "first": (0, ) * 5,
            "last": (4, ) * 5}, {"ay": (-0.64, ) * 5}, "-2 (0.3 + 0.2 x 0.1), by hand; r rises by 0.03 in 0.1 s"),
    channels=("ay", "p", "q", "r"), source=POINT_ACCELERATION, axis=Axis.LATERAL)
ACCEL_Y_HEIGHT = sensor_error("accel_y_height",
    "The lateral specific force was recorded higher than the card says (or lower, where negative), and still "
    "contains what roll acceleration does there.", "Recorded = true + h (p_dot - q r) at the height h = -z.",
    lambda v, s, *_: {"ay": -v["accel_y_height"] * (slope(s, "p") - s["q"] * s["r"])},
    parameter("accel_y_height", "m", "height of the lateral accelerometer above the place on the card", 1.0, (0.2, 3.0),
        (-20.0, 20.0)),
    example=Example({"accel_y_height": 0.5},
        {"r": (0.2, ) * 5, "p": (0.0, 0.03, 0.06, 0.09, 0.12), "q": (0.1, ) * 5, "dt": (0.1, ) * 5, "first": (0, ) * 5,
            "last": (4, ) * 5}, {"ay": (-0.14, ) * 5}, "-0.5 (0.3 - 0.1 x 0.2), by hand; p rises by 0.03 in 0.1 s"),
    channels=("ay", "p", "q", "r"), source=POINT_ACCELERATION, axis=Axis.LATERAL)

# Attitudes.
PITCH_ATTITUDE_BIAS = bias("pitch_attitude_bias", "theta", "pitch attitude", "rad", sd=0.025, sizes=(0.002, 0.05),
    example=(0.02, 0.1, -0.02, "recorded 0.10, true 0.08"))
BANK_ANGLE_BIAS = bias("bank_angle_bias", "phi", "bank angle", "rad", sd=0.025, sizes=(0.002, 0.05),
    example=(0.02, 0.5, -0.02, "recorded 0.5, true 0.48"))
BANK_ANGLE_SCALE = scale("bank_angle_scale", "phi", "bank angle", sd=0.05, sizes=(0.01, 0.15),
    example=(0.25, 0.5, -0.1, "recorded 0.5 = 1.25 x 0.4"))
HEADING_DELAY = delay("heading_delay", "psi", "heading", RISING, candidate=False)

# Deflections of the control surfaces.
ELEVATOR_SCALE = scale("elevator_scale", "elevator", "elevator deflection", sd=0.15, sizes=(0.02, 0.3),
    example=(-0.2, -0.08, -0.02, "recorded -0.08 = 0.8 x -0.10"))
ELEVATOR_DELAY = delay("elevator_delay", "elevator", "elevator deflection", MOVED)
AILERON_SCALE = scale("aileron_scale", "aileron", "aileron deflection", sd=0.15, sizes=(0.02, 0.3),
    example=(-0.2, -0.08, -0.02, "recorded -0.08 = 0.8 x -0.10"), axis=Axis.LATERAL)
AILERON_DELAY = delay("aileron_delay", "aileron", "aileron deflection", MOVED, axis=Axis.LATERAL)
RUDDER_SCALE = scale("rudder_scale", "rudder", "rudder deflection", sd=0.15, sizes=(0.02, 0.3),
    example=(-0.2, -0.08, -0.02, "recorded -0.08 = 0.8 x -0.10"), axis=Axis.LATERAL)
RUDDER_DELAY = delay("rudder_delay", "rudder", "rudder deflection", MOVED, axis=Axis.LATERAL)
