"""What sampled sets of terms say, beside what was named."""

from __future__ import annotations

from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.terms.result import LIKELY, SampledSet, SampledTerms
from bayes_aero.report.text.phrases import several


def sampled_sentences(d: Diagnosis) -> list[str]:
    """Whether the sampled posterior over sets of terms agrees with the forward selection, by coefficient."""
    found = []
    for one in d.sampled:
        text = f"Sampled: the posterior over sets of terms of {one.coefficient} "
        if not one.reliable:
            found.append(f"{text}may not be used: {one.status}.")
            continue
        sets = [f"{_leading(s)} {s.probability:.2f}" for s in one.sets]
        text += f"has {several(sets)}. " if sets else "has no term with a probability of a tenth. "
        found.append(text + _agreement(one))
    return found


def _leading(one: SampledSet) -> str:
    return one.terms[0][0].name + (" or a term like it" if len(one.terms) > 1 else "")


def _agreement(one: SampledTerms) -> str:
    if one.agrees:
        other = [name for name, (own, _) in one.found.items() if own < LIKELY]
        form = (
            f"; but {several(other)} itself has less than one half, and a term as good takes its place" if other else ""
        )
        return f"It agrees with forward selection{form}." if one.found else "Forward selection has no form either."
    told = []
    if one.missing:
        told.append(f"{several(one.missing)} of forward selection has less than one half")
    if one.more:
        told.append(f"forward selection lacks {several(s.terms[0][0].name for s in one.more)}")
    return f"They disagree: {' and '.join(told)}; read the form with care."
