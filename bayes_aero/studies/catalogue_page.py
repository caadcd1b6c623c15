"""The catalogue of effects as a folder: a page for people, a document for machines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_aero.flight.card import Card
from bayes_aero.report.page import put_page
from bayes_aero.report.page_effects import effects_page
from bayes_aero.studies.folder import writable
from bayes_aero.studies.provenance import provenance, write_json


def write_effects(found: Sequence[Mapping[str, Any]], schema: str, card: Card | None, out: Path) -> str | None:
    """Write effects.json and report.html into `out`; why the page could not be made, if so."""
    writable(out)
    write_json({"schema": schema, "effects": list(found)}, out / "effects.json")
    title = None if card is None else card.title
    return put_page(lambda: effects_page(found, provenance(card, [], None, {}), title), out)
