"""Roll damping in separated flow."""

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Length, Parameter, Prior
from bayes_aero.physics.rates import reduced_lateral


def increments(v, s, a, known):
    """Cl += ClpX (1 - X) p b/2V; length and speed as `reduced_lateral` has them."""
    return {"Cl": reduced_lateral(v["ClpX"] * (1.0 - known["X"]) * s["p"], s["airspeed"], a)}


EFFECT = Effect(
    name="separated_roll_damping",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Roll damping fades as the flow separates; beyond the stall the wing may autorotate.",
    parameters=(
        Parameter(
            "ClpX",
            "1",
            0.0,
            0.0,
            "change of roll damping in fully separated flow, per p b/2V",
            Prior("normal", 0.0, 0.8, "our choice of width"),
            lengths=(Length.LATERAL_MOMENT, Length.LATERAL_RATE),
        ),
    ),
    channels=("p", "airspeed"),
    increments=increments,
    example=Example(
        {"ClpX": 0.4},
        {"p": 0.3, "airspeed": 60.0},
        {"Cl": 0.01},
        "0.4 x (1 - 1/2) x 0.3 x 10/60, by hand, half span 10 m",
        known={"X": 0.5},
    ),
    source="derivative linear in the separated share 1 - X; our choice of form",
    sizes={"ClpX": (0.05, 2.0)},
)
