"""The facts of an effect of the catalogue, for the terminal and for the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def facts(effect: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Name and text of what holds for the effect as a whole; `effect` as the catalogue describes it."""
    channel = effect["stage"] == "channel"
    stage = "acts on the recorded channels" if channel else f"acts at the stage {effect['stage']}"
    sentences = [
        ("kind", f"{effect['kind']}; {stage}"),
        ("axes", " and ".join(effect["axes"])),
        ("formula", " ".join(effect["formula"].split()) or "not stated"),
        ("needs", ", ".join(effect["needs"]) or "nothing"),
    ]
    if effect["rests_on"]:
        sentences.append(("uses", ", ".join(effect["rests_on"]) + " of other effects in the model"))
    if effect["model"] is not None:
        sentences.append(("card", "in the card's model" if effect["model"] else "not in the card's model"))
    if not effect["proposed_by_diagnose"]:
        sentences.append(("diagnose", "never proposes it; a card may name it"))
    return sentences


def parameter_facts(p: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The same of one of its parameters, beside its description."""
    unit = unit_behind(p)
    sentences = [
        ("neutral", f"{shown(p['neutral'])}{unit}: there the effect is absent"),
        ("bounds", f"{shown(p['bounds'][0])} to {shown(p['bounds'][1])}"),
        ("prior", f"{p['prior']['text']} ({p['prior']['source']})"),
    ]
    if p["least_worth_modelling"] is not None:
        least, most = shown(p["least_worth_modelling"]), shown(p["largest_plausible"])
        sentences.append(("sizes", f"smallest worth modelling {least} from neutral, largest plausible {most}"))
    return sentences


def unit_behind(p: Mapping[str, Any]) -> str:
    """The unit as it stands behind a number: nothing for a pure number."""
    return "" if p["unit"] == "1" else f" {p['unit']}"


def worked(effect: Mapping[str, Any]) -> str:
    """The worked example in a sentence."""
    example = effect["example"]
    known = example["parameters"] | example["signals"] | example["known"]
    return f"{_pairs(known)} adds {_pairs(example['increments'])} ({example['source']})"


def _pairs(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {shown(value)}" for name, value in values.items())


def shown(value: Any) -> str:
    """A number, or numbers in brackets."""
    if isinstance(value, Sequence):
        return "(" + ", ".join(shown(x) for x in value) + ")"
    if math.isinf(value):
        return "-infinity" if value < 0.0 else "infinity"
    return f"{value:g}"
