"""Drag that changes with airspeed."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.rates import speed_ratio


def increments(v, s, a, known):
    """CD += CDV V/V0; V0 is the card's reference_speed, or 100 m/s where the card names none.

    A stand-in, at one altitude, for Mach number, thrust and elasticity alike, so diagnosis never proposes it.
    """
    return {"CD": v["CDV"] * speed_ratio(s["airspeed"], a)}


EFFECT = Effect(
    name="speed_drag",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="The drag coefficient changes with airspeed.",
    parameters=(Parameter("CDV", "1", 0.0, 0.0, "drag per V/V0", Prior("normal", 0.0, 0.2)),),
    channels=("airspeed",),
    increments=increments,
    example=Example({"CDV": 0.05}, {"airspeed": 80.0}, {"CD": 0.04}, "0.05 x 80/100, by hand, V0 100 m/s"),
    source="Jategaonkar 2015, longitudinal model of the HFB 320",
    sizes={"CDV": (0.005, 0.5)},
    candidate=False,
)
