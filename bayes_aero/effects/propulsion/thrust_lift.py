"""Lift that goes with thrust: inclination of the jet, or its interference with the flow."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """CL += thrust_lift T/(qbar S)."""
    qbar = 0.5 * s["density"] * xp.square(s["airspeed"])
    return {"CL": v["thrust_lift"] * s["thrust"] / (qbar * a.wing_area)}


EFFECT = Effect(
    name="thrust_lift",
    kind=Kind.PROPULSION,
    stage=Stage.TOTAL,
    claim="Thrust makes lift beyond what the inclination of the engines says.",
    parameters=(
        Parameter("thrust_lift", "1", 0.0, 0.0, "lift per thrust (an inclination in rad)", Prior("normal", 0.0, 0.5)),
    ),
    channels=("thrust", "density", "airspeed"),
    increments=increments,
    example=Example(
        {"thrust_lift": 0.2},
        {"thrust": 10800.0, "density": 1.0, "airspeed": 60.0},
        {"CL": 0.02},
        "0.2 x 10800/(1800 x 60), by hand, 60 m^2",
    ),
    source="an inclined thrust has a lift component, by mechanics; interference lumped with it is our choice",
    sizes={"thrust_lift": (0.1, 1.0)},
    together=True,
)
