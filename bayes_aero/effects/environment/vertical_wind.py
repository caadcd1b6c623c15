"""A constant updraft that carries the aircraft."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """altitude += -vertical_wind t: the altitude that the flight through the air alone would have given."""
    return {"altitude": -v["vertical_wind"] * s["elapsed"]}


EFFECT = Effect(
    name="vertical_wind",
    kind=Kind.ENVIRONMENT,
    stage=Stage.CHANNEL,
    claim="A steady updraft or downdraft carries the aircraft.",
    parameters=(Parameter("vertical_wind", "m/s", 0.0, 0.0, "constant updraft", Prior("normal", 0.0, 2.5)),),
    channels=("altitude",),
    increments=increments,
    example=Example(
        {"vertical_wind": 1.5}, {"altitude": 5000.0, "elapsed": 40.0}, {"altitude": -60.0}, "1.5 m/s for 40 s, by hand"
    ),
    source="kinematics: the air moves with the wind",
    sizes={"vertical_wind": (0.2, 5.0)},
)
