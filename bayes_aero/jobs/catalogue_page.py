"""The catalogue of effects as a folder, and the sizes that users state for effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.jobs.catalogue import effect_named
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.provenance import provenance, write_json
from bayes_aero.parameter import Parameter
from bayes_aero.report.figures.prior import channels_needed
from bayes_aero.report.html.page import Picture, Report, put_page
from bayes_aero.report.html.pictures import Gallery
from bayes_aero.report.pages.effects import effects_page, picture_words
from bayes_aero.report.style import save
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.units import quantity_to_si


def write_effects_page(
    found: Sequence[Mapping[str, Any]], schema: str, card: Card | None, out: Path
) -> tuple[str, ...]:
    """Write effects.json, report.html and its picture into `out`; a sentence on what of the page cannot be made."""
    writable(out)
    write_json({"schema": schema, "effects": list(found)}, out / "effects.json")
    title = None if card is None else card.title

    def page() -> Report:
        return effects_page(found, provenance(card, [], None, {}), title, _picture(found, out))

    return put_page(page, out)


def _picture(found: Sequence[Mapping[str, Any]], out: Path) -> tuple[Picture, ...]:
    """Of a catalogue; one effect by itself has none."""
    if len(found) == 1:
        return ()
    (out / "figures").mkdir(exist_ok=True)
    drawn = save(channels_needed(found), out / "figures" / "channels.png")
    return Gallery({"channels": drawn}, {"channels": picture_words(found)})("channels")


# --- Effects as they are asked for on the command line and in studies: "NAME=VALUE" or "NAME.PARAMETER=VALUE".


def parsed_effects(given: Sequence[str], known: Mapping[str, Effect]) -> dict[str, dict[str, float]]:
    """True values by effect and parameter, in SI; a value may carry a unit, "pitch_rate_bias=0.2 deg/s"."""
    found: dict[str, dict[str, float]] = {}
    for text in given:
        left, equals, right = text.partition("=")
        name, _, wanted = left.strip().partition(".")
        if not equals or not right.strip():
            raise InputError(f"--effect {text!r} has no value; write NAME=VALUE, e.g. pitch_rate_bias=0.01")
        effect = effect_named(name, known)
        parameter = _parameter(effect, wanted, text)
        values = found.setdefault(name, {})
        if parameter.name in values:
            raise InputError(f"--effect gives {parameter.name} twice; keep one of the two")
        values[parameter.name] = _value(parameter, right.strip(), text)
    for name, values in found.items():
        missing = [p.name for p in known[name].parameters if p.name not in values and p.name not in TRUTH]
        if missing:
            raise InputError(
                f"effect {name} has also the parameter {missing[0]}; add --effect {name}.{missing[0]}=VALUE"
            )
    return found


def _parameter(effect: Effect, wanted: str, text: str) -> Parameter:
    own = {p.name: p for p in effect.parameters}
    if not own:
        raise InputError(f"--effect {text!r}: {effect.name} has no parameter, so there is nothing to set")
    if wanted:
        if wanted not in own:
            raise InputError(f"--effect {text!r}: {effect.name} has no parameter {wanted}, but {', '.join(own)}")
        return own[wanted]
    if len(own) > 1:
        names = " and ".join(f"{effect.name}.{p}=VALUE" for p in own)
        raise InputError(f"--effect {text!r}: {effect.name} has {len(own)} parameters; write {names}")
    return next(iter(own.values()))


def _value(parameter: Parameter, right: str, text: str) -> float:
    try:
        value = float(right)
    except ValueError:
        value = quantity_to_si(right, parameter.unit, f"--effect {text!r}: {parameter.name}")
    lower, upper = parameter.bounds
    if not (math.isfinite(value) and lower <= value <= upper):
        raise InputError(f"--effect {text!r}: {parameter.name} must lie between {lower:g} and {upper:g}")
    return value
