"""Lift that changes with airspeed."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.rates import speed_ratio


def increments(v, s, a, known):
    """CL_attached += CLV V/V0; V0 is the card's reference_speed, or 100 m/s where the card names none.

    A stand-in, at one altitude, for Mach number, thrust and elasticity alike, so diagnosis never proposes it.
    """
    return {"CL_attached": v["CLV"] * speed_ratio(s["airspeed"], a)}


EFFECT = Effect(
    name="speed_lift",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The lift coefficient changes with airspeed.",
    parameters=(Parameter("CLV", "1", 0.0, 0.0, "lift per V/V0", Prior("normal", 0.0, 1.0)),),
    channels=("airspeed",),
    increments=increments,
    example=Example({"CLV": 0.5}, {"airspeed": 80.0}, {"CL_attached": 0.4}, "0.5 x 80/100, by hand, V0 100 m/s"),
    source="Jategaonkar 2015, longitudinal model of the HFB 320",
    sizes={"CLV": (0.05, 2.0)},
    candidate=False,
)
