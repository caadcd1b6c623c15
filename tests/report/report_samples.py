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


def study_told(folder, n=N, failed=(), seed=5):
    """n units of identify: CLa scatters three times as far as it claims, alpha_star as far as it claims."""
    rng = np.random.default_rng(seed)
    names = [f"flight{k}-<b>" for k in range(1, n + 1)]
    units = pd.DataFrame(
        {
            "unit": names,
            "state": ["failed" if k in failed else "done" for k in range(n)],
            "seconds": [float("nan") if k in failed else 2.0 for k in range(n)],
            "verdict": ["" if k in failed else "converged" for k in range(n)],
            "doubts": ["the sensors disagree" if k == 1 else "" for k in range(n)],
            "error": ["no samples" if k in failed else "" for k in range(n)],
        }
    )
    rows = []
    for name, state in zip(names, units["state"], strict=True):
        for parameter, value, sd, spread in (("CLa", 3.0, 0.1, 3.0), ("alpha_star", 0.3, 0.01, 1.0)):
            x = value + sd * spread * rng.standard_normal()
            row = {"unit": name, "cause": "", "parameter": parameter, "method": "mle_corrected", "value": x, "sd": sd}
            row |= {"unit_of_value": "1/rad", "low95": x - 1.96 * sd, "high95": x + 1.96 * sd}
            rows += [row] if state == "done" else []
    return StudyContext(
        "fleet", "identify", units, pd.DataFrame(rows, columns=COLUMNS), folder, {"Study": "study.toml"}
    )
