"""The report of the catalogue of effects: all of them in a table, then each with its formula, priors and source."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from bayes_aero.report.figures.prior import needed
from bayes_aero.report.html.page import (
    Block,
    Facts,
    Fold,
    HtmlTable,
    Page,
    Picture,
    Section,
    filled,
    provenance_blocks,
    section,
)
from bayes_aero.report.text.check import facts, shown, worked
from bayes_aero.report.text.phrases import bracket, plain_unit, several

Described = Mapping[str, Any]


def effects_page(
    found: Sequence[Described],
    source: Mapping[str, Any],
    aircraft: str | None = None,
    pictures: Sequence[Picture] = (),
) -> Page:
    """The page; `found` are effects as the catalogue describes them, `aircraft` the title of the card, if any."""
    if len(found) == 1:
        title, verdict = f"Effect: {found[0]['name']}", found[0]["claim"]
        parts: tuple[Section, ...] = (section("effect", "Description", lambda: _explained(found[0])),)
    else:
        title, verdict = "Catalogue of effects", _counted(found, aircraft)
        kinds = dict.fromkeys(sorted(effect["kind"] for effect in found))
        parts = tuple(_kind(kind, [e for e in found if e["kind"] == kind]) for kind in kinds)
    return Page(
        title=title,
        subtitle="Effects of the aircraft, its sensors and the air for a model"
        + (f"; card: {aircraft}" if aircraft else ""),
        verdict=verdict,
        lead=tuple(pictures),
        sections=filled(*parts, section("provenance", "Provenance", lambda: provenance_blocks(source))),
    )


def picture_words(found: Sequence[Described]) -> tuple[str, str]:
    """Caption and alternative text of the picture of channels."""
    listed = several(f"{channel} by {kinds.total()}" for channel, kinds in needed(found).items())
    return (
        "Effects that need each recorded channel. All need time and the channels that form CL, CD and Cm.",
        f"Bars: effects that need each channel, by kind of effect. Needed are {listed}.",
    )


def _counted(found: Sequence[Described], aircraft: str | None) -> str:
    kinds = Counter(effect["kind"] for effect in found)
    text = f"{len(found)} effects: {several(f'{n} of {kind}' for kind, n in sorted(kinds.items()))}"
    proposed = sum(effect["proposed_by_diagnose"] for effect in found)
    text += f"; diagnose screens {proposed} of them"
    if aircraft:
        text += f"; {sum(bool(effect['model']) for effect in found)} are in the card's model"
    return text + "."


def _kind(kind: str, found: Sequence[Described]) -> Section:
    rows = tuple((e["name"], e["claim"], _parameters(e), ", ".join(e["needs"]), _remark(e)) for e in found)
    head = ("effect", "claim", "parameters", "channels", "remark")
    table = HtmlTable(f"Effects of {kind}", head, rows, words=(1, 2, 3, 4)).lean()
    return section(kind, kind.capitalize(), lambda: (table, *(Fold(e["name"], _explained(e)) for e in found)))


def _parameters(effect: Described) -> str:
    return ", ".join(f"{p['name']} {bracket(plain_unit(p['unit']))}" for p in effect["parameters"])


def _remark(effect: Described) -> str:
    sentences = ["in the card's model"] if effect["model"] else []
    return ", ".join([*sentences, *([] if effect["proposed_by_diagnose"] else ["never proposed by diagnose"])])


def _explained(effect: Described) -> tuple[Block, ...]:
    about = (("claim", effect["claim"]), *facts(effect), ("example", worked(effect)), ("source", effect["source"]))
    head = ("parameter", "what it is", "absent at", "bounds", "prior", "least worth\nmodelling", "largest\nplausible")
    rows = tuple(
        (
            f"{p['name']} {bracket(plain_unit(p['unit']))}",
            p["description"],
            shown(p["neutral"]),
            f"{shown(p['bounds'][0])} to {shown(p['bounds'][1])}",
            f"{p['prior']['text']} ({p['prior']['source']})",
            *("–" if p[size] is None else shown(p[size]) for size in ("least_worth_modelling", "largest_plausible")),
        )
        for p in effect["parameters"]
    )
    table = HtmlTable("Parameters, SI and radians", head, rows, words=(1, 4))
    return (Facts(about), *((table,) if rows else ()))
