"""Registration of plain classes as JAX pytrees; imported by every module that has them in compiled programs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import jax

from bayes_aero.flight.aircraft import Aircraft

_NAMES = tuple(field.name for field in fields(Aircraft))


def _parts(aircraft: Aircraft) -> tuple[list[tuple[Any, Any]], None]:
    return [(jax.tree_util.GetAttrKey(name), getattr(aircraft, name)) for name in _NAMES], None


def _whole(_: None, parts: Iterable[Any]) -> Aircraft:
    """An aircraft without the constructor's checks, because JAX replaces numbers by tracers."""
    aircraft = object.__new__(Aircraft)
    for name, part in zip(_NAMES, parts, strict=True):
        object.__setattr__(aircraft, name, part)
    return aircraft


jax.tree_util.register_pytree_with_keys(Aircraft, _parts, _whole)
