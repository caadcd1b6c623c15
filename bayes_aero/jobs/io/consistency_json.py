"""`consistency` of the JSON files: whether the sensors agree, as plain numbers in SI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bayes_aero.flight.agreement import Consistency, OpenError, PathCheck
from bayes_aero.flight.health import HealthFinding


def consistency_results(found: Consistency) -> dict[str, Any]:
    """The outcome, where records depart from their flight path, what explains it, and what was left and permitted."""
    return {
        "outcome": found.agreement.value,
        "why_not": found.why_not or None,
        "unchecked": list(found.unchecked),
        "departures": [asdict(d) for d in found.departures],
        "errors": {name: dict(error) for name, error in (found.errors or {}).items()},
        "unsought": found.unsought or None,
        "open": {error.name: _open(error) for error in found.open},
        "recorded": _checks(found.recorded),
        "corrected": _checks(found.corrected),
    }


def _open(error: OpenError) -> dict[str, Any]:
    plain = asdict(error) | {"imitators": list(error.imitators), "joint": dict(error.joint)}
    del plain["name"]
    return plain


def _checks(checks: Sequence[PathCheck]) -> dict[str, Any]:
    return {
        check.record: {
            "rms": {name: {"left": left, "permitted": limit} for name, (left, limit) in check.rms.items()},
            "turbulence": check.turbulence,
            "gusts": check.gusts,
            "assumed_zero": list(check.assumed),
        }
        for check in checks
    }


# --- The health of the records as plain data, the same in every JSON file.


def health_results(findings: Sequence[HealthFinding]) -> list[dict[str, Any]]:
    """Record, channel, fault, begin, end (s), sentence, grave of each finding."""
    return [asdict(finding) for finding in findings]
