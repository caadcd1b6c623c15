"""An effect file of the terms that a diagnosis found, for a card to name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from bayes_aero.atomic_write import write_whole
from bayes_aero.diagnosis.result import FoundTerm
from bayes_aero.errors import InputError

HEAD = '''"""Terms that bayes-aero diagnose found in {records}."""

from bayes_aero import Effect, Parameter, Prior, Stage
{imports}from bayes_aero.effect import Example, Kind
'''
IMPORTED = {
    "xp.": "from bayes_aero.arrays import xp\n",
    "reduced(": "from bayes_aero.physics.kinematics import reduced\n",
    "reduced_lateral(": "from bayes_aero.physics.kinematics import reduced_lateral\n",
}
TERM = '''

def _{name}(v, s, a, known):
    """{coefficient} += {parameter} {term}."""
    return {{"{coefficient}": v["{parameter}"] * {code}}}


{constant} = Effect(
    name="{name}",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="{coefficient} has a term {term}.",
    parameters=(Parameter("{parameter}", "{unit}", 0.0, 0.0, "factor of {term}", Prior("normal", 0.0, {largest!r})),),
    channels={channels!r},
    increments=_{name},
    example=Example({{"{parameter}": 0.0}}, {{}}, {{"{coefficient}": 0.0}}, "neutral: it adds nothing"),
    source="found in {records}: {size:.4g} with a standard error of {sd:.2g}",
    sizes={{"{parameter}": ({least!r}, {largest!r})}},
)
'''
LARGEST = 5.0  # times what was found, the largest plausible factor; our choice


def refuse_existing(path: Path) -> None:
    """Raise `InputError` for a path that something is at, or that is no Python file."""
    if path.exists():
        raise InputError(f"{path} exists; give another name to --write-effect")
    if path.suffix != ".py":
        raise InputError(f"{path}: an effect file is Python; give --write-effect a name that ends in .py")


def write_effects(terms: Sequence[FoundTerm], records: Sequence[str], path: Path) -> str:
    """Write the terms of a diagnosis that an effect file can state, and say what was written in a sentence."""
    stated = [one for one in terms if one.term.code is not None]
    if not stated:
        return f"No term was found that an effect file can state, so {path} was not written."
    try:
        write_whole(effect_file(stated, records), path)
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}); give --write-effect another name") from None
    return f"{path} has {len(stated)} effect{'s' * (len(stated) > 1)}; name it under [model] effect_files of the card."


def effect_file(terms: Sequence[FoundTerm], records: Sequence[str]) -> str:
    """Its text."""
    told = re.sub(r"[^\w.@:+ -]", "_", " and ".join(records))  # a name becomes part of a program
    code = " ".join(one.term.code or "" for one in terms)
    parts = [HEAD.format(records=told, imports="".join(line for used, line in IMPORTED.items() if used in code))]
    for one in terms:
        plain = one.term.name.lower().replace("(1 - x)", "separated").replace("^", "").replace("+", "plus")
        slug = re.sub(r"[^a-z0-9]+", "_", plain).strip("_")
        parts.append(
            TERM.format(
                name=f"{one.coefficient.lower()}_{slug}",
                constant=f"{one.coefficient.upper()}_{slug.upper()}",
                coefficient=one.coefficient,
                parameter=f"{one.coefficient}_{slug}",
                term=one.term.name,
                unit=one.term.unit,
                code=one.term.code,
                channels=one.term.channels,
                records=told,
                size=one.size[0],
                sd=one.size[1],
                least=_digits(one.least),
                largest=_digits(LARGEST * max(abs(one.size[0]), one.least)),
            )
        )
    return "".join(parts)


def _digits(x: float) -> float:
    return float(f"{x:.3g}")
