"""Sentences on manoeuvres fitted alone that differ by more than their intervals."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from bayes_aero.inference.identification import Identification
from bayes_aero.report.tables.comparison import (
    alone,
    apart,
    chosen_posteriors,
    methods,
    noise_label,
    ordered,
    usable,
)
from bayes_aero.report.text.phrases import decimals, several


def left_out(identification: Identification) -> list[str]:
    """Manoeuvres whose own fit cannot be compared, with the reason."""
    return [
        f"{name} alone: {fit.status.value}; it is left out of the comparison between manoeuvres."
        for name, fit in identification.alone.items()
        if not usable(fit)
    ]


def between_manoeuvres(identification: Identification, limit: float) -> list[str]:
    """Sentences on differences beyond `limit` standard errors; none if the intervals explain them."""
    names = ordered(identification.mle.names, identification.mle.parameters)
    compared = [n for n in names if len(alone(identification, n)) > 1]
    beyond = {
        label: {n: z for n in compared if (z := _largest(identification, n, kind)[0]) > limit}
        for kind, label in _kinds(identification).items()
    }
    if not any(beyond.values()):
        return []
    counts = [f"{label}: {_listed(found, len(compared))}" for label, found in beyond.items()]
    sentences = [
        f"Fitted alone, manoeuvres differ by more than {limit:.0f} standard errors of the difference, by "
        + "; by ".join(counts)
        + "."
    ]
    wider = [set(found) for label, found in beyond.items() if label != "the Cramér-Rao bound"]
    unexplained = [n for n in compared if wider and any(n in found for found in wider)]
    always = [n for n in compared if wider and all(n in found for found in wider)]
    if unexplained:
        shown = always or unexplained
        sentences.append(
            f"No noise model alone explains this: {'; '.join(_numbers(identification, n) for n in shown)}. "
            "The model lacks an effect, the conditions of the manoeuvres differ in a way that it does not contain, or "
            "filters act differently on the measured and the modelled side. The intervals of the joint fit assume one "
            "value for all manoeuvres and cover none of these."
        )
    return sentences


def _kinds(identification: Identification) -> dict[str, str]:
    """Kinds of interval by key, as they are named in a sentence."""
    kinds = {"crb": "the Cramér-Rao bound", "crb_corrected": "the corrected bound"}
    for engine in list(chosen_posteriors(identification))[:1]:
        kinds[engine] = f"the {noise_label(identification.noise)} posterior's width"
    return kinds


def _largest(identification: Identification, name: str, kind: str) -> tuple[float, str, str]:
    """Largest difference of two manoeuvres in standard errors of the difference, and which two.

    A posterior's deviation for a manoeuvre alone is its Cramer-Rao one times the joint ratio of posterior to bound:
    the manoeuvres were not sampled one by one.
    """
    single = alone(identification, name)
    by_key = {m.key: m.estimates for m in methods(identification)}
    estimate = by_key[kind].get(name)
    widen = estimate.sd / by_key["crb"][name].sd if estimate else np.nan
    sd = {m: corrected if kind == "crb_corrected" else widen * crb for m, (_, crb, corrected) in single.items()}
    return max((apart(single[a][0], single[b][0], sd[a], sd[b]), a, b) for a, b in combinations(single, 2))


def _listed(found: dict[str, float], total: int) -> str:
    if not found:
        return "none"
    if len(found) > 6:
        worst = max(found, key=lambda n: found[n])
        return f"{len(found)} of {total} parameters (up to {found[worst]:.0f}, {worst})"
    return several(f"{name} ({z:.1f})" for name, z in found.items())


def _numbers(identification: Identification, name: str) -> str:
    _, a, b = _largest(identification, name, "crb")
    single = alone(identification, name)
    texts = [f"{single[m][0]:.{decimals(single[m][1])}f} from {m}" for m in (a, b)]
    bound = max(single[a][1], single[b][1])
    return f"{name} is {texts[0]} and {texts[1]}, with Cramér-Rao standard errors up to {bound:.2g}"
