"""TOML files that people write, cards and studies: read with bounds on what a hostile one can ask for."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from bayes_aero.errors import InputError

MOST_BYTES = 1 << 18  # a card has some 5 kB, a study that lists 3000 records 200
MOST_DEPTH, MOST_NAME, LARGEST = 12, 200, 2**63
# tomllib's time grows with the square of the parts of a dotted key. A part is matched from its beginning only.
_DOTTED = re.compile(r"""(?:(?<![\w-])[\w-]+|"[^"\n]{0,200}"|'[^'\n]{0,200}')[ \t]*\.[ \t]*""")
MOST_DOTS = 12


def read_table(path: Path, what: str) -> tuple[bytes, dict[str, Any]]:
    """The file's bytes and its table; `what` ("card", "study") begins the sentence where it cannot be had."""
    where = f"{what} {path}"
    try:
        if not path.is_file():
            raise InputError(f"{where}: it is no file; check the path")
        with path.open("rb") as handle:
            raw = handle.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{where}: cannot be read ({reason}); check the path and its permissions") from None
    return raw, parse_table(raw, where, what)


def parse_table(raw: bytes, where: str, what: str = "card") -> dict[str, Any]:
    """The table that a file's bytes are; `where` begins the sentence if they are none."""
    if len(raw) > MOST_BYTES:
        raise InputError(f"{where}: it has more than {MOST_BYTES} bytes; is it a {what} at all?")
    try:
        text = raw.decode("utf-8")
        for number, line in enumerate(text.split("\n"), 1):
            run, end = 0, -1
            for part in _DOTTED.finditer(line) if line.count(".") > MOST_DOTS else ():
                run = run + 1 if part.start() == end else 1
                end = part.end()
                if run > MOST_DOTS:
                    raise ValueError(f"a name of more than {MOST_DOTS} parts, line {number}")
        table = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{where}: not valid TOML (nested too deeply); mend it") from None
    except ValueError as error:  # TOMLDecodeError, UnicodeDecodeError, and Python's bound on the digits of a number
        raise InputError(f"{where}: not valid TOML ({error}); mend that line") from None
    # Numbers, names and nesting that no card needs, and that would trip whatever looks at them later.
    left: list[tuple[Any, int]] = [(table, 0)]
    while left:
        value, depth = left.pop()
        if depth > MOST_DEPTH:
            raise InputError(f"{where}: it is nested deeper than {MOST_DEPTH}; mend it")
        if isinstance(value, dict):
            for key in value:
                if len(key) > MOST_NAME or not key.isprintable():
                    raise InputError(f"{where}: {key[:40]!r} is no name for an entry; mend it")
            left += [(inner, depth + 1) for inner in value.values()]
        elif isinstance(value, list):
            left += [(inner, depth + 1) for inner in value]
        elif isinstance(value, int) and not -LARGEST <= value < LARGEST:
            raise InputError(f"{where}: a whole number has more than 18 digits; correct it")
    return table


def is_file(path: Path) -> bool:
    """Whether it is a file; a name that no file can have (too long, with NUL) is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


# --- Checks that every section of a card needs; each failure is one sentence that names the card.


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


UNFILLED = "TODO"  # stands on a starter card where the user has something to fill in


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


def strings(value: Any, sentence: str, *, empty: bool = False) -> tuple[str, ...]:
    """A list of names, not `empty` unless it may be; else `sentence` is raised."""
    if not (isinstance(value, list) and (value or empty) and all(isinstance(name, str) for name in value)):
        raise InputError(sentence)
    return tuple(value)


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
