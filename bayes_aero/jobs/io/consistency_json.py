"""`consistency` of the JSON files: whether the sensors agree, as plain numbers in SI."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bayes_aero.flight.health.finding import Consistency, PathCheck
from bayes_aero.jobs.provenance import named_pairs, picked


def consistency_results(found: Consistency | None) -> dict[str, Any]:
    """The outcome, where records depart from their flight path, what explains it, and what was left and permitted."""
    if found is None:
        return {}
    about = ("unit", "mean", "sd", "among", "asked", "imitators", "share", "joint")
    return {
        "outcome": found.agreement.value,
        "why_not": found.why_not or None,
        **picked(found, "unchecked", "departures"),
        "errors": found.errors or {},
        "unsought": found.unsought or None,
        "open": {error.name: picked(error, *about) for error in found.open},
        "recorded": _checks(found.recorded),
        "corrected": _checks(found.corrected),
    }


def _checks(checks: Sequence[PathCheck]) -> dict[str, Any]:
    return {
        check.record: {
            "rms": named_pairs(check.rms, "left", "permitted"),
            **picked(check, "turbulence", "gusts", "assumed_zero=assumed"),
        }
        for check in checks
    }
