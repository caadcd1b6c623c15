"""The report of the catalogue of effects: all of them in a table, then each with its formula, priors and source."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from bayes_aero.report.figures.prior import needed
from bayes_aero.report.html import page as html
from bayes_aero.report.html.page import Block, HtmlTable, section
from bayes_aero.report.text.check import facts, shown, worked
from bayes_aero.report.text.phrases import bracket, plain_unit, several

Described = Mapping[str, Any]


def effects_page(
    found: Sequence[Described],
    source: Mapping[str, Any],
    aircraft: str | None = None,
    pictures: Sequence[html.Picture] = (),
) -> html.Report:
    """The page; `found` are effects as the catalogue describes them, `aircraft` the title of the card, if any."""
    if len(found) == 1:
        title, verdict = f"Effect: {found[0]['name']}", found[0]["claim"]
        parts = [section("effect", "Description", lambda: _explained(found[0]))]
    else:
        kinds = Counter(effect["kind"] for effect in found)
        title = "Catalogue of effects"
        verdict = f"{len(found)} effects: {several(f'{n} of {kind}' for kind, n in sorted(kinds.items()))}"
        verdict += f"; diagnose screens {sum(effect['proposed_by_diagnose'] for effect in found)} of them"
        if aircraft:
            verdict += f"; {sum(bool(effect['model']) for effect in found)} are in the card's model"
        verdict += "."
        parts = [_kind(kind, [e for e in found if e["kind"] == kind]) for kind in sorted(kinds)]
    return html.Report(
        title=title,
        subtitle="Effects of the aircraft, its sensors and the air for a model"
        + (f"; card: {aircraft}" if aircraft else ""),
        verdict=verdict,
        lead=tuple(pictures),
        sections=html.filled(*parts, section("provenance", "Provenance", lambda: html.provenance_blocks(source))),
    )


def picture_words(found: Sequence[Described]) -> tuple[str, str]:
    """Caption and alternative text of the picture of channels."""
    listed = several(f"{channel} by {kinds.total()}" for channel, kinds in needed(found).items())
    return (
        "Effects that need each recorded channel. All need time and the channels that form CL, CD and Cm.",
        f"Bars: effects that need each channel, by kind of effect. Needed are {listed}.",
    )


def _kind(kind: str, found: Sequence[Described]) -> html.Section:
    rows = []
    for e in found:
        parameters = ", ".join(f"{p['name']} {bracket(plain_unit(p['unit']))}" for p in e["parameters"])
        remarks = ["in the card's model"] if e["model"] else []
        remarks += [] if e["proposed_by_diagnose"] else ["never proposed by diagnose"]
        rows.append((e["name"], e["claim"], parameters, ", ".join(e["needs"]), ", ".join(remarks)))
    head = ("effect", "claim", "parameters", "channels", "remark")
    table = HtmlTable(f"Effects of {kind}", head, tuple(rows), words=(1, 2, 3, 4)).lean()
    return section(kind, kind.capitalize(), lambda: (table, *(html.Fold(e["name"], _explained(e)) for e in found)))


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
    return (html.Facts(about), *((table,) if rows else ()))
