"""Scores of both models of a diagnosis on each manoeuvre, in the fit and on hold-out data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayes_aero.diagnosis.selection.cross_validation import Compared, LeftOut, compared, measured_blocks
from bayes_aero.inference.scores import Scores, score
from bayes_aero.physics.coefficients import NAMES
from bayes_aero.report.diagnosis_view import View


@dataclass(frozen=True)
class HoldoutScores:
    """Both models of a view on hold-out data."""

    view: View

    @cached_property
    def left(self) -> Mapping[str, LeftOut]:
        """By model; each is fitted again without each fold."""
        models = {"card": self.view.card, "extended": self.view.extended}
        return {name: LeftOut.refitted(fitted.state) for name, fitted in models.items()}

    @cached_property
    def measured(self) -> Float[np.ndarray, "m c"]:
        """Coefficients as the card reconstructs them, by block."""
        return measured_blocks(self.view.extended.state)

    def scores(self, residual: Float[np.ndarray, "m c"], manoeuvre: int) -> dict[str, Scores]:
        """Scores of each coefficient on one manoeuvre, by these residuals of all blocks."""
        here = (self.view.extended.state.responses.manoeuvre == manoeuvre) & self.left["extended"].inside
        z, e = self.measured[here], residual[here]
        return {name: score(z[:, c], z[:, c] - e[:, c]) for c, name in enumerate(NAMES)}

    @cached_property
    def gains(self) -> Mapping[tuple[str, str], Compared]:
        """Gain of the extended model over the card's, by manoeuvre and coefficient."""
        left, state = self.left, self.view.extended.state
        return {
            (manoeuvre, name): found
            for k, manoeuvre in enumerate(self.view.names)
            for name, found in compared(left["card"], left["extended"], state, self.measured, k).items()
        }

    def worse(self) -> list[tuple[str, str]]:
        """Manoeuvres and coefficients for which the extended model loses log density significantly (one-sided, 5 %)."""
        hold_out = self.view.extended.state.settings.hold_out
        return [pair for pair, gain in self.gains.items() if gain.elpd < -hold_out * gain.elpd_sd]


def scores_frame(view: View) -> pd.DataFrame:
    """A row for each model, fit, manoeuvre and coefficient: r, R2, RMSE [-] and Theil's coefficient of 5 Hz means.

    `fitted`: parameters from all manoeuvres. `unseen`: from the others; of a single one, each block from the others.
    Rows of the extended model on hold-out data have its gain over the card's: log density `elpd_gain` [nats] and
    `r2_gain`, each with its standard error (see `criticism.gain.Compared`).
    """
    unseen, rows = HoldoutScores(view), []
    for model, left in unseen.left.items():
        fitted = {"card": view.card, "extended": view.extended}[model].state.residual
        for data, residual in (("fitted", fitted), ("unseen", left.residual)):
            for k, manoeuvre in enumerate(view.names):
                for name, found in unseen.scores(residual, k).items():
                    row = {"model": model, "data": data, "manoeuvre": manoeuvre, "coefficient": name}
                    row |= {"r": found.r, "r2": found.r2, "rmse": found.rmse, "theil": found.theil}
                    if (model, data) == ("extended", "unseen"):
                        row |= _columns(unseen.gains[manoeuvre, name])
                    rows.append(row)
    return pd.DataFrame(rows)


def _columns(gain: Compared) -> dict[str, float]:
    names = {"elpd_gain": gain.elpd, "elpd_gain_sd": gain.elpd_sd}
    return names | {"r2_gain": gain.r2, "r2_gain_sd": gain.r2_sd}
