"""The catalogue of effects as a folder: a page for people, a document for machines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_aero.flight.card.card import Card
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.provenance.provenance import provenance, write_json
from bayes_aero.report.figures.effects import channels_needed
from bayes_aero.report.html.page import Page, Picture, put_page
from bayes_aero.report.html.pictures import Gallery
from bayes_aero.report.pages.effects import effects_page, picture_words
from bayes_aero.report.style import save


def write_effects(found: Sequence[Mapping[str, Any]], schema: str, card: Card | None, out: Path) -> tuple[str, ...]:
    """Write effects.json, report.html and its picture into `out`; a sentence on what of the page cannot be made."""
    writable(out)
    write_json({"schema": schema, "effects": list(found)}, out / "effects.json")
    title = None if card is None else card.title

    def page() -> Page:
        return effects_page(found, provenance(card, [], None, {}), title, _picture(found, out))

    return put_page(page, out)


def _picture(found: Sequence[Mapping[str, Any]], out: Path) -> tuple[Picture, ...]:
    """Of a catalogue; one effect by itself has none."""
    if len(found) == 1:
        return ()
    (out / "figures").mkdir(exist_ok=True)
    drawn = save(channels_needed(found), out / "figures" / "channels.png")
    return Gallery({"channels": drawn}, {"channels": picture_words(found)})("channels")
