"""File formats: each opens a file's bytes, lists its columns and reads those that are wanted."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Mapping
from importlib import import_module

from bayes_aero.flight.readers.base import OpenedFile

Opens = Callable[[bytes], OpenedFile]


def _discover() -> dict[str, Opens]:
    """What every module below this package declares as `READS`; scripts for processes of their own are left alone."""
    readers: dict[str, Opens] = {}
    for module in pkgutil.walk_packages(__path__, f"{__name__}."):
        if not module.name.endswith("child"):
            readers |= getattr(import_module(module.name), "READS", {})
    return dict(sorted(readers.items()))


READERS: Mapping[str, Opens] = _discover()  # what opens a file, by its suffix
