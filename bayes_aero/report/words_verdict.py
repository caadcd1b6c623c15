"""The headline of a diagnosis: it rests on causes that are confirmed, likely and of a size that aircraft have."""

from __future__ import annotations

from bayes_aero.criticism.finding import Cause, Diagnosis, Verdict
from bayes_aero.report.phrases import several, size_text

FEW = 3  # causes whose sizes stand in the verdict


def verdict_sentence(d: Diagnosis) -> str:
    """The causes that explain what the card's model gets wrong, those that are only named, and what is left."""
    sure = [c for c in d.causes if c.sure]
    plural = "causes explain" if len(sure) > 1 else "cause explains"
    subject = f"{len(sure)} {plural}"
    names = f": {several(_named(c, len(sure) <= FEW) for c in sure)}{_doubtful(d)}"
    unknown = several(sorted({f"{u.coefficient} over {u.channel}" for u in d.unknown}))
    left = f" ({unknown})" if unknown else ""
    return {
        Verdict.NO_EFFECT: "Nothing worth a name, that this record could show, is missing from the card's model"
        f"{_doubtful(d)}.",
        Verdict.EXPLAINED: f"{subject} what the card's model gets wrong{names}.",
        Verdict.PARTLY_EXPLAINED: f"{subject} a part of what the card's model gets wrong{names}; "
        f"unexplained structure remains{left}.",
        Verdict.UNEXPLAINED: f"The card's model is wrong and no reliable cause explains it{left}{_doubtful(d)}."
        if d.causes
        else f"The card's model is wrong and no effect of the catalogue explains it{left}.",
    }[d.verdict]


def _named(cause: Cause, sized: bool) -> str:
    """Its name, its size if that is asked for, and its equals."""
    sizes = ", ".join(size_text(x.mean, x.sd, x.unit) for x in cause.parameters.values()) if sized else ""
    rivals = f"or {' or '.join(cause.ambiguous_with)}" if cause.ambiguous_with else ""
    said = ", ".join(part for part in (sizes, rivals) if part)
    return f"{cause.name} ({said})" if said else cause.name


def _doubtful(d: Diagnosis) -> str:
    """Named causes on which the verdict does not rest, each with the first reason."""
    reasons: dict[str, list[str]] = {}
    for cause in d.causes:
        if not cause.sure:
            reasons.setdefault(_why_not(cause), []).append(_named(cause, sized=False))
    return "".join(f"; {why}: {several(names)}" for why, names in reasons.items())


def _why_not(cause: Cause) -> str:
    """Why the verdict does not rest on a cause."""
    if cause.bounded:
        return "at a parameter bound, so another cause is to be suspected"
    if cause.implausible:
        return "larger than on any aircraft, so another cause is to be suspected"
    if not cause.confirmed:
        return "named, but not confirmed on hold-out data"
    return "named, but no more probable than its rivals"
