"""Checks that every section of a card needs; each failure is one sentence that names the card."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any

from bayes_aero.errors import InputError


def section(table: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    """A section of the card, empty where it is absent."""
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise InputError(f"card {where}: {key} must be a section, [{key}]")
    return value


def known_keys(table: Mapping[str, Any], known: tuple[str, ...], where: str, what: str) -> None:
    """Refuse a key that is not `known`; `what` says what kind of key it is."""
    for key in table:
        if key not in known:
            close = get_close_matches(key, known, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(known)}"
            raise InputError(f"card {where}: unknown {what} {key[:60]!r}; {hint}")


def like(name: str, known: Iterable[str]) -> str:
    """A hint at the nearest of `known` names; empty if none is near."""
    close = get_close_matches(name, list(known), n=1)
    return f"; is {close[0]!r} there meant?" if close else ""


UNFILLED = "TODO"
"""Stands on a starter card where the user has something to fill in."""


def refuse_unfilled(table: Mapping[str, Any], where: str) -> None:
    """Name every entry of a starter card that is still to be filled in."""
    left = []
    for name, entries in table.items():
        for key, value in entries.items() if isinstance(entries, dict) else ():
            parts = value.items() if isinstance(value, dict) else [("", value)]
            for part, given in parts:
                if UNFILLED in (str(x)[: len(UNFILLED)] for x in (given if isinstance(given, list) else [given])):
                    left.append(f"[{name}] {key} {part}".strip())
    if left:
        first, *others = left
        also = f", and so {'are' if len(others) > 1 else 'is'} {', '.join(others)}" if others else ""
        raise InputError(
            f"card {where}: {first} is still {UNFILLED}{also}; fill in what is missing, the comment beside it says "
            "what it is"
        )


def number(value: Any, where: str) -> float:
    """A plain number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"card {where}: {str(value)[:60]!r} is not a number")
    return float(value)


def numbers(table: Any, where: str) -> dict[str, float]:
    """A table of plain numbers."""
    if not isinstance(table, dict):
        raise InputError(f"card {where} must be a table of numbers")
    return {key: number(value, f"{where} {key}") for key, value in table.items()}
