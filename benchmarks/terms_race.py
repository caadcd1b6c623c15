"""Which term is missing: this program beside lasso, STLSQ (pysindy) and FROLS (sysidentpy) on the same splits.

    pip install -e '.[peers]'
    python benchmarks/terms_race.py 20 [--first 300] [--out race]

Flights of `unlisted_terms.py` with a product hidden, and as many with nothing hidden. After the selection from the
catalogue every program gets the same residual of the same coefficient and the same library, the free parameters of the
model projected out of both, and the same two folds: one manoeuvre predicts the other. The peers choose their penalty,
threshold or number of terms by the mean square error of the folds. One line of OUT/race.jsonl each.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from jaxtyping import Float
from studies import parser_of, resumed, seeds_of
from unlisted_terms import in_stalls

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.screening.partialled_regression import PartialledRegression
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.structure.components import with_components
from bayes_aero.diagnosis.structure.unexplained import taken_out
from bayes_aero.diagnosis.terms.columns import Column, columns_of
from bayes_aero.flight.card.card import read_card

Folds = Sequence[tuple[np.ndarray, np.ndarray]]
Peer = Callable[[Float[np.ndarray, "m j"], Float[np.ndarray, " m"], Folds], list[int]]


def chosen_by_folds(
    settings: Sequence[float], fitted: Callable[[np.ndarray, np.ndarray, float], np.ndarray], X, y, folds: Folds
) -> list[int]:
    """Columns that a method uses at the setting whose coefficients predict the other fold best."""

    def error(setting: float) -> float:
        return sum(float(np.sum((y[test] - X[test] @ fitted(X[fit], y[fit], setting)) ** 2)) for fit, test in folds)

    best = min(settings, key=error)
    if error(best) >= sum(float(np.sum(y[test] ** 2)) for _, test in folds):
        return []
    weights = fitted(X, y, best)
    return [int(j) for j in np.argsort(-np.abs(weights)) if weights[j] != 0.0]


def lasso(X, y, folds: Folds) -> list[int]:
    from sklearn.linear_model import Lasso

    def fitted(X, y, alpha):
        penalty = alpha * float(np.abs(X.T @ y).max()) / len(y)  # the largest leaves nothing
        return Lasso(alpha=penalty, fit_intercept=False, max_iter=5000).fit(X, y).coef_

    return chosen_by_folds(np.geomspace(0.01, 0.9, 12), fitted, X, y, folds)


def stlsq(X, y, folds: Folds) -> list[int]:
    from pysindy.optimizers import STLSQ

    def fitted(X, y, threshold):
        return STLSQ(threshold=threshold * float(np.std(y)), alpha=1e-3).fit(X, y[:, None]).coef_[0]

    return chosen_by_folds(np.geomspace(0.02, 2.0, 10), fitted, X, y, folds)


def frols(X, y, folds: Folds) -> list[int]:
    """Its own ranking by error reduction ratios, the number of terms by the folds."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS

    def order(X, y) -> list[int]:
        """Columns, the first selected first; the one constant regressor of the basis is none of them."""
        model = FROLS(
            order_selection=False, n_terms=4, xlag=[[1]] * X.shape[1], ylag=1, model_type="NFIR",
            basis_function=Polynomial(degree=1),
        )  # fmt: skip
        lead = np.vstack([X[1:], X[-1:]])  # it regresses on the sample before
        model.fit(X=lead, y=np.append(y[1:], y[-1:])[:, None])
        return [int(code[0]) // 1000 - 2 for code in model.final_model if code[0] >= 2000]

    def fitted(X, y, count):
        weights, own = np.zeros(X.shape[1]), order(X, y)[: int(count)]
        weights[own] = np.linalg.lstsq(X[:, own], y, rcond=None)[0]
        return weights

    return chosen_by_folds((1, 2, 3, 4), fitted, X, y, folds)


PEERS: dict[str, Peer] = {"lasso": lasso, "STLSQ": stlsq, "FROLS": frols}


def problem(state: SelectionState, columns: Sequence[Column]) -> tuple[np.ndarray, np.ndarray, Folds]:
    """Library (m, j) and residual (m,) of one coefficient, the model's free parameters projected out of both."""
    trial = with_components(state, [c.component for c in columns], (), state.folds)
    fit = trial.fit()
    projected = PartialledRegression(trial, fit, trial.component_columns)
    at = state.outputs.index(columns[0].component.label.split(" over ")[0])
    X, y = projected.P[:, at, [p[0] for p in projected.place]], trial.left(fit)[:, at]
    scale = np.std(X, axis=0) + 1e-12
    one, two = (np.arange(len(y))[fold] for fold in state.folds)
    inside = np.concatenate([one, two])
    first, second = np.arange(len(one)), len(one) + np.arange(len(two))
    return (X / scale)[inside], y[inside], [(first, second), (second, first)]


def case(seed: int, silent: bool) -> dict:
    """Fly, diagnose, and let every program choose."""
    (coefficient, name, _), noise, records = in_stalls(seed, silent, products=True)
    found = diagnose(records, read_card("attas"), seed=seed, gains_wanted=False)
    own = [t for t in found.terms if silent or t.coefficient == coefficient]
    told = [[t.term.name, *(o.name for o, _ in t.others)] for t in own]
    state = taken_out(found.aerodynamics.state, found.aerodynamics.state.active if own else ())
    columns = columns_of(state, coefficient)
    X, y, folds = problem(state, columns)
    chosen, seconds = {"this program": [names[0] for names in told]}, {}
    for peer, choose in PEERS.items():
        began = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            chosen[peer] = [columns[j].term.name for j in choose(X, y, folds)]
        seconds[peer] = time.perf_counter() - began
    return {
        "seed": seed, "hidden": None if silent else name, "coefficient": coefficient, "noise": noise,
        "chosen": chosen, "as_good": told, "seconds": seconds,
    }  # fmt: skip


def report(rows: list[dict]) -> None:
    """A row of a table for each program."""
    some, silent = [r for r in rows if r["hidden"]], [r for r in rows if not r["hidden"]]
    print("| program | hidden term first | among those chosen | terms chosen, median | nothing hidden: terms chosen |")
    print("|---|---|---|---|---|")
    for name in ("this program", *PEERS):
        first = sum(r["chosen"][name][:1] == [r["hidden"]] for r in some)
        among = sum(r["hidden"] in r["chosen"][name] for r in some)
        count = np.median([len(r["chosen"][name]) for r in some])
        false = sum(bool(r["chosen"][name]) for r in silent)
        print(f"| {name} | {first} of {len(some)} | {among} | {count:g} | in {false} of {len(silent)} |")


if __name__ == "__main__":
    given = parser_of(__doc__, "race", first=300).parse_args()
    cases = {(seed, silent): partial(case, seed, silent) for seed in seeds_of(given) for silent in (False, True)}
    report(resumed(given.out / "race.jsonl", cases, lambda row: (row["seed"], row["hidden"] is None)))
