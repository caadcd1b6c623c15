"""The air moves to the left and right across the flight path."""

from bayes_aero.effect import Disturbance, Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """beta += gust_v / airspeed; gust_v is the air's motion to the left across the path, m/s."""
    return {"beta": s["gust_v"] / s["airspeed"]}


def rate(v, s, a):
    """V / L, 1/s: the aircraft flies through air that is frozen."""
    return s["airspeed"] / v["lateral_gust_length"]


EFFECT = Effect(
    name="lateral_gust",
    kind=Kind.ENVIRONMENT,
    stage=Stage.INFLOW,
    claim="Lateral gusts disturb the flight.",
    parameters=(
        Parameter(
            "lateral_gust",
            "m/s",
            0.0,
            0.5,
            "standard deviation of the lateral gust",
            Prior("halfnormal", 0.0, 3.0, "MIL-F-8785C: 1.5 m/s is light, 3 m/s moderate turbulence"),
            (0.0, 20.0),
        ),
        Parameter(
            "lateral_gust_length",
            "m",
            300.0,
            300.0,
            "scale length of the lateral gust",
            Prior("lognormal", 300.0, 0.7, "MIL-F-8785C: the height near the ground, 533 m above 610 m; our choice"),
            (10.0, 5000.0),
        ),
    ),
    channels=("airspeed", "gust_v"),
    increments=increments,
    example=Example(
        {"lateral_gust": 1.0}, {"airspeed": 100.0, "gust_v": 2.0}, {"beta": 0.02}, "2 m/s at 100 m/s, by hand"
    ),
    source="Etkin and Reid, Dynamics of Flight, 3rd ed. 1996, ch. 13; of first order, where Dryden has second",
    sizes={"lateral_gust": (0.1, 10.0), "lateral_gust_length": (20.0, 1000.0)},
    candidate=False,
    disturbance=Disturbance("gust_v", "m/s", "lateral_gust", rate),
    axis=Axis.LATERAL,
)
