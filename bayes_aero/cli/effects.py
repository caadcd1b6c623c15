"""bayes-aero effects: the catalogue, and one effect explained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from bayes_aero.cli.terminal import JsonOption, exit_if_failed, print_failures, print_json, teller

SCHEMA = "bayes_aero/effects/1"


def effects(
    name: Annotated[
        str | None,
        typer.Argument(
            help="One effect to explain; none: all as a table.",
            # The names are loaded only where one is completed.
            autocompletion=lambda incomplete: [
                n for n in import_module("bayes_aero.effects").CATALOGUE if n.startswith(incomplete)
            ],
        ),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="A card, for its own effect files and what its model has.", metavar="CARD")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for report.html and effects.json; none: nothing is written.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """List the catalogue of effects, or explain one: claim, formula, parameters, priors, worked example, source.

    Example: bayes-aero effects pitch_rate_bias
    """
    from bayes_aero.flight.card.card import read_card
    from bayes_aero.jobs.catalogue import effect_facts, effect_named, known_effects

    card = None if model is None else read_card(model)
    known = known_effects(card)
    chosen = known.values() if name is None else [effect_named(name, known)]
    found = [effect_facts(effect, card) for effect in chosen]
    failures: tuple[str, ...] = ()
    if out is not None:
        from bayes_aero.jobs.catalogue import write_effects_page

        failures = write_effects_page(found, SCHEMA, card, out)
    if json:
        print_json({"schema": SCHEMA, "effects": found})
    elif name is None:
        print_table(found)
    else:
        print_effect(found[0])
    if out is not None and not json:
        print_failures(teller(), failures)
        teller().print(f"The report is in {out / 'report.html'}", soft_wrap=True)
    exit_if_failed(failures)


def print_table(found: Sequence[Mapping[str, Any]]) -> None:
    """By kind; two lines an effect or more, so that 80 columns hold a row."""
    console = teller(highlight=True)
    table = Table(box=SIMPLE_HEAD, pad_edge=False, show_edge=False, padding=(0, 1, 0, 0))
    table.add_column("effect\n  parameters, unit", no_wrap=True)
    table.add_column("claim\nwhat it needs")
    for kind in sorted({effect["kind"] for effect in found}):
        table.add_section()
        table.add_row(Text(kind.upper(), "bold"), "")
        for effect in found:
            if effect["kind"] != kind:
                continue
            name = effect["name"] + (" *" if effect["model"] else "")
            parameters = [
                f"  {p['name']}" + ("" if p["unit"] == "1" else f", {p['unit']}") for p in effect["parameters"]
            ]
            needs = f"needs {', '.join(effect['needs'])}" if effect["needs"] else "needs nothing"
            table.add_row(
                Text.assemble(name, *(part for p in parameters for part in ("\n", (p, "dim")))),
                Text.assemble(effect["claim"], "\n", (needs, "dim")),
            )
    console.print(table)
    stars = "*: in the card's model. " if any(effect["model"] for effect in found) else ""
    console.print(f"{len(found)} effects. {stars}bayes-aero effects NAME explains one.", highlight=False)


def print_effect(effect: Mapping[str, Any]) -> None:
    """Claim, formula, parameters with their priors, worked example, source."""
    from bayes_aero.report.text.check import facts, parameter_facts, unit_behind, worked

    console = teller(highlight=True)

    def line(title: str, text: str) -> None:
        console.print(f"{title:<12} ", end="", style="bold")
        console.print(text, highlight=False, soft_wrap=True)

    console.print(f"{effect['name']}: {effect['claim']}", style="bold", highlight=False)
    for title, text in facts(effect):
        line(title, text)
    for p in effect["parameters"]:
        unit = unit_behind(p)
        console.print()
        line(p["name"], f"{p['description']}{unit and ',' + unit}")
        for title, text in parameter_facts(p):
            line(f"  {title}", text)
    console.print()
    line("example", worked(effect))
    line("source", effect["source"])
