"""How many examples a fuzz test takes: FUZZ=50 in the environment takes fifty times as many, other ones each time."""

import os
from datetime import timedelta

from hypothesis import HealthCheck, Phase, settings

FACTOR = float(os.environ.get("FUZZ", "1"))


def examples(count: float, seconds: float | None = 5.0) -> settings:
    """`count` examples, none longer than `seconds`; always the same ones unless FUZZ is set."""
    return settings(
        max_examples=max(8, int(FACTOR * count)),
        deadline=None if seconds is None else timedelta(seconds=seconds),
        derandomize=FACTOR == 1.0,
        database=None,
        phases=[Phase.explicit, Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),  # pyright: ignore[reportArgumentType]
    )
