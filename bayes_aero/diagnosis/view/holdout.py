"""Both models of a diagnosis on each manoeuvre, in the fit and on hold-out data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.cross_validation import LeftOut, measured_blocks
from bayes_aero.diagnosis.view.results import Compared, HoldoutScores, View
from bayes_aero.inference.scores import Scores, score
from bayes_aero.inference.variance.coloured_bounds import standard_error_of_sum


def holdout_scores(view: View) -> HoldoutScores:
    """Fit both models again without each fold, and score each manoeuvre by these fits and by those to all data."""
    models = {"card": view.card, "extended": view.extended}
    left = {name: LeftOut.refitted(fitted.state) for name, fitted in models.items()}
    state = view.extended.state
    measured, scores, gains = measured_blocks(state), {}, {}
    for k, manoeuvre in enumerate(view.names):
        here = (state.responses.manoeuvre == k) & left["extended"].inside
        for model, fitted in models.items():
            scores[model, "fitted", k] = _scores(state.outputs, measured[here], fitted.state.residual[here])
            scores[model, "hold_out", k] = _scores(state.outputs, measured[here], left[model].residual[here])
        found = compared(left["card"], left["extended"], state, measured, k)
        gains |= {(manoeuvre, name): gain for name, gain in found.items()}
    return HoldoutScores(view.names, scores, gains, state.settings.hold_out)


def with_holdout_scores(view: View) -> View:
    """The same with both models on each manoeuvre, where there are several and something was added."""
    if len(view.names) == 1 or not view.extended.state.active:
        return view
    return replace(view, holdout=holdout_scores(view))


def compared(
    before: LeftOut, after: LeftOut, state: SelectionState, measured: Float[np.ndarray, "m c"], manoeuvre: int
) -> dict[str, Compared]:
    """`after` against `before` on one manoeuvre, by coefficient; its blocks' order and colour are kept."""
    here = (state.responses.manoeuvre == manoeuvre) & before.inside
    density = (after.densities() - before.densities())[here[before.inside]] / state.variance_inflation
    total = np.sum((measured[here] - measured[here].mean(axis=0)) ** 2, axis=0)
    squares = (before.residual[here] ** 2 - after.residual[here] ** 2) / total
    n = len(density)
    return {
        name: Compared(
            float(density[:, c].sum()),
            standard_error_of_sum(density[:, c], [n]),
            float(squares[:, c].sum()),
            standard_error_of_sum(squares[:, c], [n]),
        )
        for c, name in enumerate(state.outputs)
    }


def _scores(names: Sequence[str], z: Float[np.ndarray, "m c"], e: Float[np.ndarray, "m c"]) -> dict[str, Scores]:
    """Of measured coefficients with these residuals."""
    return {name: score(z[:, c], z[:, c] - e[:, c]) for c, name in enumerate(names)}
