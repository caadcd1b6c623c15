"""The model as it stands on the page, handed to another simulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path

from bayes_aero.errors import InputError
from bayes_aero.explore.choice import Choice, with_added
from bayes_aero.explore.linear import LIMITS
from bayes_aero.explore.opened import Opened
from bayes_aero.export.identified import Identified
from bayes_aero.jobs.handover.export import write_export
from bayes_aero.jobs.handover.identified_linear import IdentifiedLinear

FOLDER = "exports"


def chosen_model(opened: Opened, choice: Choice, values: Mapping[str, float]) -> Identified:
    """The model with the added effects at `values` (SI) of what is flown; what is off is fixed at neutral.

    Raises:
        InputError: it is a linear system.
    """
    identified = opened.identified
    if isinstance(identified, IdentifiedLinear):
        raise InputError(LIMITS.removesuffix("."))
    model = with_added(identified.model, choice.added)
    off = {p.name: p.neutral for e in model.effects if e.name in choice.off for p in e.parameters}
    every = {p.name: identified.values.get(p.name, p.neutral) for p in model.parameters} | dict(values) | off
    every = {p.name: every[p.name] for p in model.parameters}
    fixed = {name: every[name] for name in (*dict(model.fixed), *off)}
    said = _changes(identified, choice, every, off)
    return replace(
        identified,
        model=replace(model, fixed=tuple(fixed.items())),
        values=every,
        sources=(*identified.sources, said) if said else identified.sources,
    )


def export_chosen(opened: Opened, choice: Choice, values: Mapping[str, float], form: str) -> tuple[Path, list[str]]:
    """Write the chosen model into a new folder below the result; what is there stays.

    Returns:
        The folder, and its files.

    Raises:
        InputError: the model has no counterpart in this form, or the folder cannot be written.
    """
    found = chosen_model(opened, choice, values)
    root = opened.folder / FOLDER
    names = (f"{found.name}_{form}{'' if k == 1 else f'_{k}'}" for k in count(1))
    target = next(root / name for name in names if not (root / name).exists() and not (root / name).is_symlink())
    facts = write_export(found, form, target)
    return target, facts["files"]


def _changes(identified: Identified, choice: Choice, now: Mapping[str, float], off: Mapping[str, float]) -> str:
    """What was changed by hand; nothing where nothing was."""
    moved = [
        f"{name} = {x:.10g} (was {identified.values[name]:.10g})"
        for name, x in now.items()
        if name not in off and name in identified.values and x != identified.values[name]
    ]
    new = [f"{name} = {x:.10g} (new)" for name, x in now.items() if name not in identified.values and name not in off]
    gone = [f"{name} off" for name in sorted(choice.off)]
    changed = ", ".join((*moved, *new, *gone))
    return f"Changed by hand with open, SI and radians: {changed}. These values are no estimates." if changed else ""
