"""Plain classes that JAX must take apart. Whatever holds one of them in a compiled program imports this module."""

from __future__ import annotations

from dataclasses import fields

import jax

from bayes_aero.flight.aircraft import Aircraft

jax.tree_util.register_dataclass(Aircraft, data_fields=[f.name for f in fields(Aircraft)], meta_fields=[])
