"""The page of a starter card, beside it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from bayes_aero.jobs.card.card_template import Starter
from bayes_aero.jobs.provenance.provenance import provenance
from bayes_aero.report.html.page import put_page
from bayes_aero.report.pages.card import Rest, StarterView, Taken, card_page


def put_starter_page(starter: Starter, record: Path, card: Path) -> tuple[Path, tuple[str, ...]]:
    """Write CARD.report.html; its path, and a sentence on what of it cannot be made."""
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
    path = card.with_name(card.name + ".report.html")
    return path, put_page(lambda: card_page(view, source), path.parent, path.name)
