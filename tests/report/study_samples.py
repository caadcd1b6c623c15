"""A study of identifications with known scatter, as its tables."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayes_aero.report.pages.study import StudyContext

N = 7
COLUMNS = ["unit", "cause", "parameter", "method", "value", "sd", "unit_of_value", "low95", "high95"]


def told(folder, n=N, failed=(), seed=5):
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
