"""One simulated flight of `verify.py`, flown and judged: which claims it tries, and whether it bears each one out."""

from __future__ import annotations

import traceback
from typing import Any

import hidden_effects
import identify_coverage
import numpy as np
import other_aircraft
from claims import ROUND
from detection_tables import size

from bayes_aero.errors import InputError

APART = 1_000_000  # between the seeds of two kinds

Trials = dict[str, bool]


def case(kind: str, seed: int, posterior: bool) -> dict[str, Any]:
    """Trials (claim: hit or not) of one flight, and all that was found in it.

    `refused`: the aircraft cannot be flown so, which is no trial. `crashed`: anything else that went wrong.
    """
    row: dict[str, Any] = {"kind": kind, "seed": seed, "trials": {}}
    try:
        found, trials = _of(kind, seed + APART * list(ROUND).index(kind), posterior)
    except InputError as error:
        return row | {"refused": str(error)}
    except Exception as error:
        return row | {"crashed": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}
    return row | {"trials": trials, "found": found}


def _of(kind: str, seed: int, posterior: bool) -> tuple[dict[str, Any], Trials]:
    if kind == "identify":
        return _identified(seed, posterior)
    if kind in ("other", "other_silence"):
        found = other_aircraft.case(seed, 0.0, bool(seed % 2), 2, kind == "other_silence")
        if found["hidden"] is None:
            return found, {"other_false_alarms": found["verdict"] != "no_effect" or bool(found["causes"])}
        named, held = other_aircraft.named_first(found), other_aircraft.inside(found)
        return found, {"other_named": named} | ({} if held is None else {"other_size_held": bool(held)})
    found = hidden_effects.case(kind, seed, hidden_effects.PAIR, False)
    if kind == "silence":
        return found, {"false_alarms": hidden_effects.alarmed(found)}
    if kind == "unknown":
        return found, {"unexplained": bool(found["unexplained"])}
    if size(found) < hidden_effects.CLEAR:  # the record could not show it
        return found, {}
    held = hidden_effects.inside(found)
    return found, {"named": hidden_effects.named_first(found)} | ({} if held is None else {"size_held": held})


def _identified(seed: int, posterior: bool) -> tuple[dict[str, Any], Trials]:
    """Errors of one fit's parameters go together, so one parameter, drawn at random, makes the trial."""
    found = identify_coverage.case(seed, sample=posterior)
    names = found["names"]
    k = int(np.random.default_rng([seed, 98]).integers(len(names)))
    truth = identify_coverage.TRUTH[names[k]]
    keys = dict(zip(identify_coverage.METHODS, ("bound_held", "posterior_held"), strict=True))
    held = {keys[method]: bool(ends[k][0] <= truth <= ends[k][1]) for method, ends in found["ends"].items()}
    return found | {"parameter": names[k]}, held
