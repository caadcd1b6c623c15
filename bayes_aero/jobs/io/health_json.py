"""The health of the records as plain data, the same in every JSON file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bayes_aero.flight.health import HealthFinding


def health_results(findings: Sequence[HealthFinding]) -> list[dict[str, Any]]:
    """Record, channel, fault, begin, end (s), sentence, grave of each finding."""
    return [asdict(finding) for finding in findings]
