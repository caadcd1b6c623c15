"""The headline of a diagnosis. It rests on causes that are confirmed, probable and of plausible size."""

from __future__ import annotations

import math

from bayes_aero.diagnosis.result import Cause, Diagnosis, Tested, Verdict
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.text.phrases import SYMBOLS, for_people, several, short, size_text

MAX_SIZED = 3  # causes whose sizes are in the verdict


def verdict_sentence(d: Diagnosis) -> str:
    """The causes that explain the model error, those that are only named, and the unexplained structure."""
    sure = [c for c in d.causes if c.sure]
    names = f": {several(_named(c, len(sure) <= MAX_SIZED) for c in sure)}{_doubtful(d)}"
    changes = [f"{one.parameter} changes {'at' if one.between else 'in'} {one.manoeuvre}" for one in d.changes]
    structure = {
        f"{u.coefficient} {'between' if u.offsets else 'over'} {u.channel}{'s' if u.offsets else ''}" for u in d.unknown
    }
    unknown = several([*sorted(structure), *dict.fromkeys(changes)])
    left = f" ({unknown})" if unknown else ""
    if d.tested is not None:
        return _flown_verdict(d, d.tested, len(sure), names, left)
    plural = "causes explain" if len(sure) > 1 else "cause explains"
    subject = f"{len(sure)} {plural}"
    return {
        Verdict.NO_EFFECT: f"No significant model error is detectable in these records{_doubtful(d)}.",
        Verdict.EXPLAINED: f"{subject} the error of the card's model{names}.",
        Verdict.PARTLY_EXPLAINED: f"{subject} part of the error of the card's model{names}; "
        f"unexplained structure remains{left}.",
        Verdict.UNEXPLAINED: f"The card's model is wrong and no reliable cause explains it{left}{_doubtful(d)}."
        if d.causes
        else f"The card's model is wrong and no effect of the catalogue explains it{left}.",
        Verdict.UNDECIDED: "These records cannot decide whether the card's model is wrong.",
    }[d.verdict]


def _flown_verdict(d: Diagnosis, tested: Tested, sure: int, names: str, left: str) -> str:
    """The same from trajectories alone: causes explain the error only if the residual is sensor noise."""
    sought = (
        f"structure outside the catalogue remains{left}"
        if d.unknown
        else "no term of the library describes structure outside the catalogue"
    )
    if tested.beyond:
        rest = f"Errors larger than the sensor noise remain ({_remaining(tested)}); {sought}."
    elif tested.outputs:
        rest = f"The remaining error of the simulation is within the sensor noise; {sought}."
    else:
        rest = f"The remaining error of the simulation was not computed; {sought}."
    if sure and d.verdict is Verdict.EXPLAINED:
        plural = "causes explain" if sure > 1 else "cause explains"
        return f"{sure} {plural} the error of the card's model in the trajectories{names}. {rest}"
    if sure:
        plural = "causes improve" if sure > 1 else "cause improves"
        return f"{sure} {plural} the fit to the trajectories{names}. {rest}"
    if d.verdict is Verdict.NO_EFFECT:
        first = "No significant model error is detectable in these trajectories"
    elif d.causes:
        first = "No reliable cause improves the fit to the trajectories"
    else:
        first = "No effect of the catalogue improves the fit to the trajectories significantly"
    if d.verdict is Verdict.UNDECIDED:
        rest += " Disturbed air or an error of the model causes them; trajectories alone cannot decide which."
    return f"{first}{_doubtful(d)}. {rest}"


def _remaining(tested: Tested) -> str:
    """Outputs whose error exceeds the noise, on hold-out flights where there are any."""
    unseen = all(math.isfinite(tested.outputs[name].unseen) for name in tested.beyond)
    where = "on hold-out flights, RMS" if unseen else "RMS"
    listed = [
        f"{SYMBOLS.get(name, name)} {_size(name, one.unseen if unseen else one.fitted)}"
        for name, one in tested.outputs.items()
        if one.beyond
    ]
    return f"{where}: {several(listed)}"


def tested_sentences(d: Diagnosis) -> list[str]:
    """The error of each output against the noise of its sensor, from trajectories alone."""
    if d.tested is None or not d.tested.outputs:
        return []
    listed = [
        f"{SYMBOLS.get(name, name)} {_size(name, one.fitted)} (noise {_size(name, one.noise)})"
        for name, one in d.tested.outputs.items()
    ]
    text = f"The RMS error of the extended model, fitted to all flights, is {several(listed)}."
    if d.tested.beyond:
        text += (
            f" More than half of the mean square error of {several(SYMBOLS.get(n, n) for n in d.tested.beyond)} is not "
            "noise. Possible causes are turbulence, a sensor error, or an effect that the model lacks."
        )
    return [text]


def _size(output: str, value: float) -> str:
    unit, factor = for_people(STANDARD_CHANNELS[output].unit)
    return f"{short(factor * value)} {unit}"


def _named(cause: Cause, sized: bool) -> str:
    """Its name, its size if requested, and its rivals."""
    sizes = ", ".join(size_text(x.mean, x.sd, x.unit) for x in cause.parameters.values()) if sized else ""
    rivals = f"or {' or '.join(cause.ambiguous_with)}" if cause.ambiguous_with else ""
    text = ", ".join(part for part in (sizes, rivals) if part)
    return f"{cause.name} ({text})" if text else cause.name


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
        return "at a parameter bound: suspect another cause"
    if cause.implausible:
        return "larger than on any aircraft: suspect another cause"
    if not cause.confirmed:
        return f"named, but not {'confirmed' if math.isfinite(cause.missed[0]) else 'tested'} on hold-out data"
    return "named, but no more probable than its rivals"
