"""A user's own effects: Python files that a card names."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from types import ModuleType

from bayes_aero.effect import Effect
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError

MAX_BYTES = 1 << 20


def own_effects(files: Sequence[Path]) -> dict[str, Effect]:
    """Every `Effect` at the top level of `files`, by name.

    The files are Python code and are run. A card given by its path is trusted; a study needs --trust-effects. Each
    content is run once, so that an effect is always the same object and its compiled programs are used again.
    """
    found: dict[str, Effect] = {}
    for path in files:
        try:
            text = _text(path)
        except (OSError, ValueError) as error:
            raise InputError(f"effect file {path} cannot be read ({error}); mend the path on the card") from None
        for effect in _run(path, text):
            if effect.name in CATALOGUE or effect.name in found:
                raise InputError(f"effect file {path}: the name {effect.name} is taken; give the effect another one")
            others = (*CATALOGUE.values(), *found.values())
            taken = {p.name for e in others for p in e.parameters} & {p.name for p in effect.parameters}
            if taken:
                raise InputError(
                    f"effect file {path}: the parameter {', '.join(sorted(taken))} of {effect.name} belongs to another "
                    "effect; give it another name"
                )
            found[effect.name] = effect
    return found


def _text(path: Path) -> str:
    if not path.is_file():
        raise FileNotFoundError("there is no such file")
    with path.open("rb") as handle:
        raw = handle.read(MAX_BYTES + 1)
    if len(raw) > MAX_BYTES:
        raise ValueError(f"it has more than {MAX_BYTES} bytes")
    return raw.decode("utf-8")


@lru_cache(maxsize=32)
def _run(path: Path, text: str) -> tuple[Effect, ...]:
    module = ModuleType(f"own_effects_{path.stem}_{abs(hash((path, text))):x}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses look their module up there
    try:
        exec(compile(text, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:  # whatever a user's code may raise
        del sys.modules[module.__name__]
        raise InputError(f"effect file {path} does not run: {type(error).__name__}: {error}") from None
    defined = (value for value in vars(module).values() if isinstance(value, Effect))
    effects = tuple(e for e in defined if e is not CATALOGUE.get(e.name))  # built-in ones may be imported
    if not effects:
        raise InputError(f"effect file {path} defines no Effect at its top level; see bayes_aero/effects for examples")
    return tuple(dict.fromkeys(effects))
