"""A delay of the recorded rudder deflection."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior, Role
from bayes_aero.physics.filters import advance


def increments(v, s, a, known):
    """Recorded(t) = true(t - rudder_delay)."""
    x = s["rudder"]
    return {"rudder": advance(x, xp.asarray(v["rudder_delay"]), s["dt"], s["first"], s["last"]) - x}


EFFECT = Effect(
    name="rudder_delay",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The rudder deflection is recorded late (or early, where negative).",
    parameters=(
        Parameter(
            "rudder_delay",
            "s",
            0.0,
            0.0,
            "delay of the recorded rudder deflection; positive is late",
            Prior("normal", 0.0, 0.25),
            (-2.0, 2.0),
            role=Role.DELAY,
        ),
    ),
    channels=("rudder",),
    increments=increments,
    example=Example(
        {"rudder_delay": 0.04},
        {"rudder": (0.03, 0.0, -0.01, -0.06), "dt": (0.04,) * 4, "first": (0,) * 4, "last": (3,) * 4},
        {"rudder": (-0.03, -0.01, -0.05, 0.0)},
        "one sample late: the next sample less this one, by hand; nothing is known beyond the last",
    ),
    source="definition of a delay; cubic convolution between samples, Keys 1981",
    sizes={"rudder_delay": (0.02, 0.5)},
    axis=Axis.LATERAL,
)
