"""What the browser asks, checked."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from bayes_aero.errors import InputError
from bayes_aero.jobs.handover.export import FORMS

MOST_CHARACTERS = 100_000


@dataclass(frozen=True)
class Asked:
    """The state of the page's controls; values are in the units of the sliders, `window` in s."""

    id: int = 0
    manoeuvre: int = 0
    window: tuple[float, float] | None = None
    values: Mapping[str, float] = field(default_factory=dict)
    off: tuple[str, ...] = ()
    added: tuple[str, ...] = ()
    fan: bool = False
    export: str = ""


def read_asked(text: str) -> Asked:
    """The state from the browser's JSON.

    Raises:
        InputError: it is not what the page sends.
    """
    try:
        if len(text) > MOST_CHARACTERS:
            raise ValueError("it is too long")
        told = json.loads(text)
        form = str(told["export"] or "")
        if form and form not in FORMS:
            raise ValueError(f"there is no form {form!r}")
        window = told["window"]
        return Asked(
            int(told["id"]),
            max(0, int(told["manoeuvre"])),
            None if window is None else (_number(window[0]), _number(window[1])),
            {str(name): _number(x) for name, x in told["values"].items()},
            tuple(map(str, told["off"])),
            tuple(dict.fromkeys(map(str, told["added"]))),
            bool(told["fan"]),
            form,
        )
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as reason:
        raise InputError(f"the page sent what it never sends ({reason}); load it again") from None


def _number(x: Any) -> float:
    found = float(x)
    if not math.isfinite(found):
        raise ValueError(f"{x} is no finite number")
    return found
