"""qualification.json."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.jobs.io.consistency_json import consistency_results
from bayes_aero.jobs.io.health_json import health_results
from bayes_aero.qualification.result import FAILS_TO, PASSES_FROM, Further, Qualification, Test

SCHEMA = "bayes_aero/qualification/2"
RESULTS = "qualification.json"


def qualification_results(
    found: Qualification, card: Card, source: dict[str, Any], failures: Sequence[str] = ()
) -> dict[str, Any]:
    """Plain numbers and text, SI and radians (schemas/qualification.schema.json)."""
    return {
        "schema": SCHEMA,
        "card": {"name": card.name, "title": card.title},
        "verdict": found.whole.value,
        "thresholds": {"passes_from": PASSES_FROM, "fails_to": FAILS_TO},
        "draws": found.draws,
        "tolerances": {
            name: {
                "value": value,
                "unit": STANDARD_CHANNELS[name].unit,
                "source": text,
                "verdict": found.verdict(name).value,
            }
            for name, (value, text) in found.tolerances.items()
        },
        "tests": [_test(one) for one in found.tests],
        "flown_region": {"channels": list(found.channels), "not_recorded": list(found.unjudged)},
        "outside": [asdict(one) for one in found.outside],
        "further": None if found.further is None else _further(found.further),
        "origins": dict(found.origins),
        "health": health_results(found.health),
        "consistency": {} if found.consistency is None else consistency_results(found.consistency),
        "notes": list(found.notes),
        "failures": list(failures),
        "provenance": source,
    }


def _further(found: Further) -> dict[str, Any]:
    points = [asdict(p) for p in found.points]
    return {
        "tests": [asdict(t) | {"kind": t.kind.value} for t in found.tests],
        "points": [{**p, "probabilities": p.pop("expected"), "nats_per_second": p.pop("rate")} for p in points],
        "refused": dict(found.refused),
        "why_not": found.why_not,
    }


def _test(one: Test) -> dict[str, Any]:
    beside = one.recorded
    return {
        "kind": one.kind.value,
        "manoeuvre": one.manoeuvre,
        "output": one.output,
        "tolerance": one.tolerance,
        "probability": one.chance.value,
        "standard_error": one.chance.error,
        "counted": {name: asdict(chance) for name, chance in one.chances.items()},
        "verdict": one.chance.verdict.value,
        "within": one.within,
        "record": None if beside is None else asdict(beside) | {"passed": beside.passed},
    }
