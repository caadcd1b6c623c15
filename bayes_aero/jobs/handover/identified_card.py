"""The card of a finished result: results name it by its hash, and do not repeat it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card, read_card, shipped_cards


def card_of(provenance: Mapping[str, Any], result: Path, given: str | None) -> Card:
    """The card with which a result was made, and its effect files as they were.

    Args:
        provenance: of the result.
        result: its file.
        given: a card named by the user; None: the shipped card of that name, the path that the result states, or a
            file of that name beside the result or in the working directory.

    Raises:
        InputError: it is not found, or it is not the one of the result.
    """
    name, sha256 = provenance["card"]["name"], provenance["card"]["sha256"]
    if given is not None:
        card = read_card(given)
        if card.sha256 != sha256:
            raise InputError(
                f"card {given} is not the one with which {result} was made (its content differs); give that card with "
                "--model, or run the command again"
            )
    else:
        path = next((p for p in _places(provenance, result) if p.is_file() and _hash(p) == sha256), None)
        if path is None:
            raise InputError(
                f"{result} was made with a card {name} that is not found here unchanged; give it with --model"
            )
        card = read_card(name if shipped_cards().get(name) == path else path)
    now = {path.name: _hash(path) for path in card.effect_files if path.is_file()}
    for file in provenance.get("effect_files", ()):
        if now.get(file["name"]) != file["sha256"]:
            raise InputError(f"effect file {file['name']} has changed since {result} was made; run the command again")
    return card


def _places(provenance: Mapping[str, Any], result: Path) -> Iterator[Path]:
    name = provenance["card"]["name"]
    if name in shipped_cards():
        yield shipped_cards()[name]
    if provenance["card"].get("path"):
        yield Path(provenance["card"]["path"])
    for folder in (result.parent, result.parent.parent, Path()):
        yield folder / f"{name}.toml"


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
