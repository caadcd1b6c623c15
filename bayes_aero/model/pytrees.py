"""Registration of plain classes as JAX pytrees; imported by every module that has them in compiled programs."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import fields
from typing import Any

import jax

from bayes_aero.model.joined_records import Flights
from bayes_aero.physics.aircraft import Aircraft


def _register(kind: type, static: Collection[str] = ()) -> None:
    names = [field.name for field in fields(kind) if field.name not in static]

    def parts(whole: Any) -> tuple[list[tuple[Any, Any]], tuple[Any, ...]]:
        leaves = [(jax.tree_util.GetAttrKey(name), getattr(whole, name)) for name in names]
        return leaves, tuple(getattr(whole, name) for name in static)

    def whole(known: tuple[Any, ...], leaves: Any) -> Any:
        """Without the constructor's checks, because JAX replaces numbers by tracers."""
        made = object.__new__(kind)
        for name, part in zip((*names, *static), (*leaves, *known), strict=True):
            object.__setattr__(made, name, part)
        return made

    jax.tree_util.register_pytree_with_keys(kind, parts, whole)


_register(Aircraft)
_register(Flights, ("lengths", "names", "held"))
