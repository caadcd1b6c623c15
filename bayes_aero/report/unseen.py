"""How well both models of a diagnosis describe each manoeuvre, fitted to it and not."""

from __future__ import annotations

import pandas as pd

from bayes_aero.criticism.gain import LeftOut, measured_blocks
from bayes_aero.inference.scores import score
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.report.diagnosed import View


def scores_frame(view: View) -> pd.DataFrame:
    """A row for each model, fit, manoeuvre and coefficient: r, R2, RMSE [-] and Theil's coefficient of 5 Hz means.

    `fitted`: parameters from all manoeuvres. `unseen`: from the others; of a single one, each stretch from the others.
    """
    measured = measured_blocks(view.extended.state)
    rows = []
    for model, state in (("card", view.card.state), ("extended", view.extended.state)):
        left = LeftOut.refitted(state)
        for data, residual in (("fitted", state.residual), ("unseen", left.residual)):
            for k, manoeuvre in enumerate(view.names):
                here = (state.responses.manoeuvre == k) & left.inside
                for c, name in enumerate(NAMES):
                    z = measured[here, c]
                    found = score(z, z - residual[here, c])
                    rows.append(
                        {
                            "model": model,
                            "data": data,
                            "manoeuvre": manoeuvre,
                            "coefficient": name,
                            "r": found.r,
                            "r2": found.r2,
                            "rmse": found.rmse,
                            "theil": found.theil,
                        }
                    )
    return pd.DataFrame(rows)
