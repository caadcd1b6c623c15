"""A fit of two short flights with known errors, and a study with known scatter, for the pages and words of reports."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
from linear_cards import SHORT_PERIOD, SHORT_PERIOD_TRUTH, card_of, record_of, short_period_flight

from bayes_aero.diagnosis.result import FITTED, START, Error, SimulatedManoeuvre, TrajectoryFit, theil_parts
from bayes_aero.jobs.fly import fly
from bayes_aero.jobs.results import Flight
from bayes_aero.report.pages.study import StudyContext

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
            paths.append(
                SimulatedManoeuvre(name, model, model, True, {"alpha": error}, time, {"alpha": z}, {"alpha": y})
            )
    return replace(flown, paths=tuple(paths), outputs=("alpha",))


N = 7
COLUMNS = ["unit", "cause", "parameter", "method", "value", "sd", "unit_of_value", "low95", "high95"]


def study_context(folder, n=N, failed=(), seed=5):
    """n units of identify: CLa scatters three times as far as it claims, alpha_star as far as it claims."""
    rng = np.random.default_rng(seed)
    names, bad = [f"flight{k}-<b>" for k in range(1, n + 1)], [k in failed for k in range(n)]
    units = pd.DataFrame({
        "unit": names, "state": ["failed" if x else "done" for x in bad], "seconds": np.where(bad, np.nan, 2.0),
        "verdict": ["" if x else "converged" for x in bad],
        "doubts": ["the sensors disagree" if k == 1 else "" for k in range(n)],
        "error": ["no samples" if x else "" for x in bad],
    })  # fmt: skip
    rows = []
    for name, x in zip(names, bad, strict=True):
        for parameter, true, sd, spread in (("CLa", 3.0, 0.1, 3.0), ("alpha_star", 0.3, 0.01, 1.0)):
            value = true + sd * spread * rng.standard_normal()
            row = (name, "", parameter, "mle_corrected", value, sd, "1/rad", value - 1.96 * sd, value + 1.96 * sd)
            rows += [] if x else [row]
    results = pd.DataFrame(rows, columns=COLUMNS)
    return StudyContext("fleet", "identify", units, results, folder, {"Study": "study.toml"})
