"""Lift due to sideslip."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CL += CLb2 beta^2: even in beta, for the aircraft is symmetric."""
    return {"CL": v["CLb2"] * s["beta"] * s["beta"]}


EFFECT = Effect(
    name="sideslip_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Sideslip changes the lift.",
    parameters=(Parameter("CLb2", "1/rad^2", 0.0, 0.0, "lift per sideslip squared", Prior("normal", 0.0, 10.0)),),
    channels=("beta",),
    increments=increments,
    example=Example({"CLb2": -3.0}, {"beta": -0.1}, {"CL": -0.03}, "-3 x (-0.1)^2, by hand"),
    source="lowest even term of a Taylor series, by symmetry; our choice of form",
    sizes={"CLb2": (2.0, 20.0)},
)
