"""The air moves back and forth along the flight path."""

from bayes_aero.effect import Disturbance, Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """airspeed += gust_u, the air's motion against the flight, m/s."""
    return {"airspeed": s["gust_u"]}


def rate(v, s, a):
    """V / L, 1/s: the aircraft flies through air that is frozen."""
    return s["airspeed"] / v["longitudinal_gust_length"]


EFFECT = Effect(
    name="longitudinal_gust",
    kind=Kind.ENVIRONMENT,
    stage=Stage.INFLOW,
    claim="Longitudinal gusts disturb the flight.",
    parameters=(
        Parameter(
            "longitudinal_gust",
            "m/s",
            0.0,
            0.5,
            "standard deviation of the longitudinal gust",
            Prior("halfnormal", 0.0, 3.0, "MIL-F-8785C: 1.5 m/s is light, 3 m/s moderate turbulence"),
            (0.0, 20.0),
        ),
        Parameter(
            "longitudinal_gust_length",
            "m",
            300.0,
            300.0,
            "scale length of the longitudinal gust",
            Prior("lognormal", 300.0, 0.7, "MIL-F-8785C: the height near the ground, 533 m above 610 m; our choice"),
            (10.0, 5000.0),
        ),
    ),
    channels=("airspeed", "gust_u"),
    increments=increments,
    example=Example({"longitudinal_gust": 1.0}, {"airspeed": 100.0, "gust_u": 2.0}, {"airspeed": 2.0}, "by hand"),
    source="MIL-F-8785C: Dryden's longitudinal gust",
    sizes={"longitudinal_gust": (0.1, 10.0), "longitudinal_gust_length": (20.0, 1000.0)},
    candidate=False,
    disturbance=Disturbance("gust_u", "m/s", "longitudinal_gust", rate),
)
