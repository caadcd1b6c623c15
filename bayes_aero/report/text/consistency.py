"""Agreement of the sensors, in sentences: printed first, and first on a page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_aero.flight.agreement import Agreement, Consistency, Departure, OpenError
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.report.text.phrases import for_people, several, size_text
from bayes_aero.units import instant

SHOWN = 4  # departures in the sentence
FOLLOWS = {
    "airspeed": "the accelerations along the flight path (ax, az, theta, alpha)",
    "alpha": "pitch rate (q), normal acceleration (az) and airspeed",
    "theta": "pitch rate (q)",
    "altitude": "airspeed, pitch attitude (theta) and angle of attack (alpha)",
    "beta": "lateral acceleration (ay), yaw rate (r) and bank angle (phi)",
    "phi": "roll rate (p) and yaw rate (r)",
}
"""Channels from which each channel of the flight path follows."""


def consistency_sentences(found: Consistency, *, corrects: bool) -> list[str]:
    """The answer, then its limits. `corrects`: whether the command corrects known sensor errors by itself."""
    if found.agreement is Agreement.NOT_CHECKED:
        return [f"Whether the sensors agree was not checked: {found.why_not}."]
    return [_answer(found, corrects=corrects), *_limits(found), *open_sentences(found)]


def _answer(found: Consistency, *, corrects: bool) -> str:
    if found.agreement is Agreement.AGREE:
        return "The sensors agree along the flight path within their noise."
    where = departures_sentence(found)
    errors = several(f"{name} ({sizes(error)}{_beside(found, name)})" for name, error in (found.errors or {}).items())
    if found.agreement is Agreement.EXPLAINED:
        mend = "it is corrected here" if corrects else "it is not corrected here; diagnose corrects it"
        return (
            f"The sensors disagree along the flight path, and a known error explains it ({mend}): {errors}. "
            f"As recorded, {where}."
        )
    beside = f", after correction for {errors}" if errors else ""
    unsought = f" Known errors could not be tested: {found.unsought}." if found.unsought else ""
    return (
        f"The sensors disagree along the flight path, and no known sensor error explains it: {where}{beside}. "
        f"Repair or recalibrate the channel, or cut the record there; the results depend on it.{unsought}"
    )


def _beside(found: Consistency, name: str) -> str:
    """What an error was estimated together with."""
    listed = joint_text((found.errors or {})[name].get("joint", {}))
    return f"; estimated together with {listed}: neither holds alone" if listed else ""


def joint_text(joint: Mapping[str, float]) -> str:
    """Other errors with the correlation of the estimates."""
    return several(f"{other} (correlation {correlation:+.2f})" for other, correlation in joint.items())


def departures_sentence(found: Consistency) -> str:
    """The departures with their sizes, the largest first."""
    listed = sorted(found.departures, key=lambda d: -d.rms / d.permitted)
    more = f"; and {len(listed) - SHOWN} more" if len(listed) > SHOWN else ""
    return "; ".join(map(_departure, listed[:SHOWN])) + more


def _departure(d: Departure) -> str:
    standard = STANDARD_CHANNELS[d.channel]
    unit, factor = for_people(standard.unit)
    return (
        f"{d.channel} ({standard.description}) of {d.record} does not follow {FOLLOWS[d.channel]} from "
        f"{instant(d.begin)} to {instant(d.end)} s, by {factor * d.rms:.2g} {unit} root mean square (noise permits "
        f"{factor * d.permitted:.2g} {unit})"
    )


def _limits(found: Consistency) -> list[str]:
    """Channels that could not be checked, and channels that were taken as zero."""
    sentences = []
    if found.unchecked:
        verb = "were" if len(found.unchecked) > 1 else "was"
        sentences.append(
            f"{several(found.unchecked)} {verb} not recorded and could not be checked along the flight path."
        )
    assumed = dict.fromkeys(name for check in found.recorded for name in check.assumed)
    if assumed:
        sentences.append(f"Not recorded, and taken as zero along the flight path: {several(assumed)}.")
    return sentences


def open_sentences(found: Consistency) -> list[str]:
    """Sensor errors that the flight path does not determine: fitted but not confirmed, then not testable."""
    sentences = []
    if asked := [e for e in found.open if e.asked]:
        listed = "; ".join(f"{_estimate(e)}{_imitated(e)}" for e in asked)
        sentences.append(
            "Errors that would explain much of the residual of the flight path, but that hold-out data do not "
            f"confirm, each as the only error; none is corrected: {listed}."
        )
    if either := [e for e in found.open if e.imitators and e.name in (found.errors or {})]:
        listed = "; ".join(
            f"{e.name} or {several(e.imitators)} (± {among_text(e)} of {e.name} if all are possible)" for e in either
        )
        sentences.append(f"Errors that were found, and others with the same effect along this flight path: {listed}.")
    if joint := [e for e in found.open if e.joint]:
        listed = "; ".join(f"{_estimate(e)}, together with {joint_text(e.joint)}" for e in joint)
        sentences.append(
            "Errors that were estimated together, one of them larger than sensors have, so that none of them is a "
            f"correction by itself: {listed}. Suspect another fault of these channels."
        )
    if alike := not_told_apart(found):
        errors = "errors of sensors or winds are" if len(alike) > 1 else "error of a sensor or wind is"
        sentences.append(
            f"{len(alike)} {errors} not testable along this flight path, because others have the same effect on "
            f"the record: "
            f"{several(e.name for e in alike)}."
        )
    return sentences


def not_told_apart(found: Consistency) -> list[OpenError]:
    """Errors that are not testable, for others have the same effect; those that were found say so themselves."""
    return [e for e in found.open if not e.asked and not e.joint and e.name not in (found.errors or {})]


def _estimate(error: OpenError) -> str:
    return f"{error.name} {size_text(error.mean, error.sd, error.unit)}"


def _imitated(error: OpenError) -> str:
    """The errors that have the same effect."""
    if not error.imitators:
        return ""
    return (
        f" (not distinguishable from {several(error.imitators)}: ± {among_text(error)} if "
        f"{'those are' if len(error.imitators) > 1 else 'that is'} possible)"
    )


def among_text(error: OpenError) -> str:
    """The standard error of an error with its imitators possible, as people read it."""
    unit, factor = for_people(error.unit)
    return f"{factor * error.among:.2g}{_behind(unit)}"


def _behind(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def sizes(error: Mapping[str, Any]) -> str:
    """A sensor error's parameters with their standard errors."""
    listed = error["parameters"].items()
    return ", ".join(f"{name} {size_text(size['mean'], size['sd'], size['unit'])}" for name, size in listed)
