"""Roll rate raises the incidence of the wing that goes down."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """incidence_difference += 2 roll_station p b/2V: at the share roll_station of the half span."""
    return {"incidence_difference": 2.0 * v["roll_station"] * s["p"] * a.half_span / s["airspeed"]}


EFFECT = Effect(
    name="roll_rate_incidence",
    kind=Kind.AERODYNAMICS,
    stage=Stage.INCIDENCE,
    claim="In roll the wing that goes down stalls first.",
    parameters=(
        Parameter(
            "roll_station",
            "1",
            0.0,
            0.5,
            "station whose roll velocity counts, share of the half span",
            Prior("normal", 0.5, 0.3, "a station on the wing; our choice"),
            (-2.0, 2.0),
        ),
    ),
    channels=("p", "airspeed"),
    increments=increments,
    example=Example(
        {"roll_station": 0.6},
        {"p": 0.1, "airspeed": 60.0},
        {"incidence_difference": 0.02},
        "2 x 0.6 x 0.1 x 10/60, by hand, half span 10 m",
    ),
    source="velocity of a point of a rigid body",
    sizes={"roll_station": (0.1, 1.5)},
)
