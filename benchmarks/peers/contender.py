"""One contender in its process: first and warm seconds and peak memory, then what its result is worth."""

from __future__ import annotations

import argparse
import importlib
import pickle
import resource
import statistics
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from reference import Reference, WhitePosterior

    from bayes_aero.model.model import Model
    from bayes_aero.model.observations import Observations


PROBLEM, OURS = "problem.pickle", "observations.pickle"


@dataclass(frozen=True)
class Problem:
    """What all contenders are given, in plain NumPy; arrays follow the model's 14 parameters, `u` the density's 17."""

    folder: Path  # where it lies, with our own observations
    reference: Reference
    posterior: WhitePosterior
    start: np.ndarray
    R: np.ndarray  # residual covariance of the optimum, (3,), which peers get as weights
    u: np.ndarray  # posterior mode
    factor: np.ndarray  # lower Cholesky factor of the inverse curvature there
    names: tuple[str, ...]
    processes: dict[int, tuple[np.ndarray, np.ndarray]]  # scaled inputs (n, 4) and output (n,), by n


def stall(problem: Problem) -> tuple[Model, Observations]:
    """The package's own model and observations; only this loads JAX."""
    from bayes_aero.flight.card import read_card
    from bayes_aero.model.model import Model

    return Model.from_card(read_card("attas")), pickle.loads((problem.folder / OURS).read_bytes())


def run_one(block: str, name: str, size: str, options: argparse.Namespace) -> dict[str, Any]:
    """Numbers of one contender of one block, or of the preparation."""
    if block == "prepare" and name:
        from jet import prepare_jet

        prepare_jet(options.folder)
        return {}
    if block == "prepare":
        from problem import prepare

        prepare(options)
        return {}
    module = importlib.import_module(block)
    problem = pickle.loads((options.folder / PROBLEM).read_bytes())  # the benchmark's own file
    try:
        run = module.CONTENDERS[name](problem, int(size), options)
    except ModuleNotFoundError as missing:
        return {"failed": f"{missing.name} is not installed"}
    timed = []
    while len(timed) <= options.repeats and (len(timed) < 2 or sum(s for s, _ in timed) < options.seconds):
        if len(timed) == 1 and timed[0][0] > options.seconds:
            break  # so slow that its first run has to do
        began = time.perf_counter()
        result = run(len(timed))
        timed.append((time.perf_counter() - began, result))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # before anything else is loaded
    warm = timed[1:] or timed
    numbers = {"first": timed[0][0], "warm": statistics.median(s for s, _ in warm), "runs": len(timed) - 1}
    return numbers | {"memory": peak} | module.judge(problem, int(size), warm)
