"""The trimming stabilizer: pitching moment, and the tail lift that goes with it by geometry."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += Cmih ih; CL_attached += CLih ih with CLih = -Cmih c/l_tail, as for the elevator."""
    CLih = -v["Cmih"] * a.chord / a.tail_arm
    return {"Cm": v["Cmih"] * s["stabilizer"], "CL_attached": CLih * s["stabilizer"]}


EFFECT = Effect(
    name="stabilizer_trim",
    kind=Kind.AERODYNAMICS,
    stage=Stage.ATTACHED,
    claim="The stabilizer was trimmed during the manoeuvre and pitches the aircraft.",
    parameters=(Parameter("Cmih", "1/rad", 0.0, 0.0, "stabilizer effectiveness", Prior("normal", 0.0, 2.5)),),
    channels=("stabilizer",),
    increments=increments,
    example=Example(
        {"Cmih": -2.0},
        {"stabilizer": -0.03},
        {"Cm": 0.06, "CL_attached": -0.012},
        "-2 x -0.03, and -0.06 x 3/15; by hand, chord 3 m and tail arm 15 m",
    ),
    source="a force at the tail arm makes the moment, by geometry",
    sizes={"Cmih": (0.1, 5.0)},
)
