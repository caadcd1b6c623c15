"""A linear system fitted to two short flights, and fits with made-up paths whose errors are known beforehand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight

from bayes_aero.diagnosis.selection.residuals import theil_parts
from bayes_aero.diagnosis.trajectories.results import FITTED, START, Error, Path, TrajectoryFit
from bayes_aero.jobs.fly import fly
from bayes_aero.jobs.io.fly_json import Flight

NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15}
CARD = card_of(SHORT_PERIOD.replace("[linear]", "[parameters]\nMde = { bounds = [-40.0, 0.0] }\n\n[linear]", 1))


def records(names: Sequence[str] = ("one", "two")):
    """Two flights of 8 s from different states, with white noise."""
    return [
        record_of(
            short_period_flight(SHORT_PERIOD_TRUTH, n=200, x0=(0.04, 0.03 * i)),
            noise=NOISE,
            rng=np.random.default_rng(i),
            name=name,
        )
        for i, name in enumerate(names)
    ]


@cache
def flight() -> Flight:
    """The fit of the default records."""
    return fly(records(), CARD)


def with_offsets(flown: TrajectoryFit, samples: Mapping[str, int], off: Mapping[str, float]) -> TrajectoryFit:
    """Paths of alpha alone: the fit simulates what was measured and `off` rad by manoeuvre, the start twice that."""
    paths, band = [], float(np.deg2rad(2.0))
    for name, n in samples.items():
        time, z = 0.04 * np.arange(n), 0.1 + 0.05 * np.sin(np.arange(n))
        for model, times in ((START, 2.0), (FITTED, 1.0)):
            y, size = z + times * off[name], times * abs(off[name])
            error = Error(size, size, theil_parts(z, y), band, float(size <= band * (1.0 + 1e-9)), None)
            paths.append(Path(name, model, model, True, {"alpha": error}, time, {"alpha": z}, {"alpha": y}))
    return replace(flown, paths=tuple(paths), outputs=("alpha",))
