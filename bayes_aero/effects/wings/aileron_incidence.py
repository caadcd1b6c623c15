"""The aileron that goes down brings its wing nearer to the stall."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """incidence_difference += aileron_incidence da."""
    return {"incidence_difference": v["aileron_incidence"] * s["aileron"]}


EFFECT = Effect(
    name="aileron_incidence",
    kind=Kind.AERODYNAMICS,
    stage=Stage.INCIDENCE,
    claim="The wing whose aileron goes down stalls first.",
    parameters=(
        Parameter(
            "aileron_incidence",
            "1",
            0.0,
            0.0,
            "difference of incidence, right less left wing, per aileron deflection",
            Prior("normal", 0.0, 0.5, "our choice of width"),
        ),
    ),
    channels=("aileron",),
    increments=increments,
    example=Example(
        {"aileron_incidence": 0.4}, {"aileron": -0.05}, {"incidence_difference": -0.02}, "0.4 x -0.05, by hand"
    ),
    source="a flap that goes down lowers the stall angle of its section; our choice of form",
    sizes={"aileron_incidence": (0.04, 2.0)},
)
