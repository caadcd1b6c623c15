"""The page of a starter card, beside it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from bayes_aero.report.page import write_page
from bayes_aero.report.page_card import Rest, StarterView, Taken, card_page
from bayes_aero.studies.provenance import provenance
from bayes_aero.studies.starter import Starter


def write_starter_page(starter: Starter, record: Path, card: Path) -> Path:
    """Write CARD.report.html."""
    taken = [
        Taken(name, g.column.place, g.unit, g.sign, g.evidence, g.values, starter.doubt(name))
        for name, g in starter.found.items()
    ]
    time = starter.found["time"].si if "time" in starter.found else None
    unknown = [Rest(c.place, c.unit, c.values) for c in starter.unknown]
    view = StarterView(record.name, card.name, time, taken, unknown, starter.todo, starter.blind)
    source = provenance(None, [], None, {})
    source["inputs"] = [
        {"name": record.stem, "source": record.name, "sha256": hashlib.sha256(record.read_bytes()).hexdigest()}
    ]
    return write_page(card_page(view, source), card.with_name(card.name + ".report.html"))
