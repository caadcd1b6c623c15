"""The effects that a user can name: built-in ones and those of a card, as plain data and as a folder with a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from bayes_aero.effect import Effect
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.jobs.provenance import picked, provenance, write_json
from bayes_aero.model.model import own_effects

WORDS = 3  # effects that an unknown name is taken to mean


def known_effects(card: Card | None = None) -> dict[str, Effect]:
    """The catalogue, and the effects of the card's own files, in alphabetical order."""
    own = own_effects(card.effect_files) if card is not None else {}
    return dict(sorted((CATALOGUE | own).items()))


def effect_named(name: str, among: Mapping[str, Effect]) -> Effect:
    """One effect; an unknown name is told with those that look like it."""
    if name in among:
        return among[name]
    close = get_close_matches(name, among, n=WORDS, cutoff=0.5)
    close = close or [other for other in among if name.casefold() in other][:WORDS]
    hint = f"did you mean {' or '.join(close)}?" if close else "bayes-aero effects lists them all"
    raise InputError(f"there is no effect {name!r}; {hint}")


def effect_facts(effect: Effect, card: Card | None = None) -> dict[str, Any]:
    """An effect as plain data; `model` says whether the card's model has it, null without a card."""
    parameters = []
    for p in effect.parameters:
        least, most = effect.sizes.get(p.name, (None, None))
        a, b = f"{p.prior.location:g}", f"{p.prior.scale:g}"
        words = {
            "normal": f"normal, mean {a}, deviation {b}",
            "lognormal": f"lognormal, median {a}, deviation of the logarithm {b}",
            "halfnormal": f"half-normal above {a}, scale {b}",
            "uniform": f"uniform, {a} to {p.prior.location + p.prior.scale:g}",
        }
        prior = picked(p.prior, "family", "location", "scale", "source") | {"text": words[p.prior.family]}
        about = picked(p, "name", "unit", "description", "neutral", "start", "bounds")
        parameters.append(about | {"prior": prior, "least_worth_modelling": least, "largest_plausible": most})
    return {
        "name": effect.name,
        "kind": effect.kind.value,
        "stage": effect.stage.name.lower(),
        "claim": effect.claim,
        "formula": effect.formula,
        "parameters": parameters,
        "needs": list(effect.channels),
        "rests_on": list(effect.uses),
        "axes": [axis.value for axis in effect.axes],
        "proposed_by_diagnose": effect.candidate and (card is None or effect.acts_on(card.axes)),
        "example": picked(effect.example, "parameters", "signals", "known", "increments", "source")
        | {"known": effect.example.known or {}},
        "source": effect.source,
        "model": None if card is None else effect.name in card.effects,
    }


def write_effects_page(
    found: Sequence[Mapping[str, Any]], schema: str, card: Card | None, out: Path
) -> tuple[str, ...]:
    """Write effects.json, report.html and its picture into `out`; a sentence on what of the page cannot be made."""
    from bayes_aero.jobs.io.result_file import writable  # what draws is heavy, and a study reads this module
    from bayes_aero.report.figures.prior import channels_needed
    from bayes_aero.report.html.page import Gallery, Report, put_page
    from bayes_aero.report.pages.check import effects_page, picture_words
    from bayes_aero.report.style import save

    writable(out)
    write_json({"schema": schema, "effects": list(found)}, out / "effects.json")

    def page() -> Report:
        pictures = ()
        if len(found) > 1:  # one effect by itself has none
            (out / "figures").mkdir(exist_ok=True)
            drawn = save(channels_needed(found), out / "figures" / "channels.png")
            pictures = Gallery({"channels": drawn}, {"channels": picture_words(found)})("channels")
        return effects_page(found, provenance(card, [], None, {}), None if card is None else card.title, pictures)

    return put_page(page, out)
