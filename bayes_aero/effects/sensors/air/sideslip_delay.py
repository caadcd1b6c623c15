"""A delay of the recorded sideslip."""

from bayes_aero.arrays import xp
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.axes import Axis
from bayes_aero.parameter import Parameter, Prior, Role
from bayes_aero.physics.filters import advance


def increments(v, s, a, known):
    """Recorded(t) = true(t - sideslip_delay)."""
    x = s["beta"]
    return {"beta": advance(x, xp.asarray(v["sideslip_delay"]), s["dt"], s["first"], s["last"]) - x}


EFFECT = Effect(
    name="sideslip_delay",
    kind=Kind.MEASUREMENT,
    stage=Stage.CHANNEL,
    claim="The sideslip is recorded late (or early, where negative).",
    parameters=(
        Parameter(
            "sideslip_delay",
            "s",
            0.0,
            0.0,
            "delay of the recorded sideslip; positive is late",
            Prior("normal", 0.0, 0.25),
            (-2.0, 2.0),
            role=Role.DELAY,
        ),
    ),
    channels=("beta",),
    increments=increments,
    example=Example(
        {"sideslip_delay": 0.04},
        {"beta": (0.10, 0.12, 0.15, 0.19), "dt": (0.04,) * 4, "first": (0,) * 4, "last": (3,) * 4},
        {"beta": (0.02, 0.03, 0.04, 0.0)},
        "one sample late: the next sample less this one, by hand; nothing is known beyond the last",
    ),
    source="definition of a delay; cubic convolution between samples, Keys 1981",
    sizes={"sideslip_delay": (0.02, 0.5)},
    axis=Axis.LATERAL,
)
