"""Effects by name: listed, written as a file by a diagnosis, and hidden in a simulated record."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_aero.atomic_write import write_whole
from bayes_aero.effect import Effect
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.jobs.store import picked, provenance, sha256_of, write_json
from bayes_aero.model.model import effect_named, own_effects
from bayes_aero.units import quantity_to_si

if TYPE_CHECKING:  # what computes and draws is heavy, and a study reads this module
    from bayes_aero.diagnosis.result import FoundTerm
    from bayes_aero.simulate.demo import Request
    from bayes_aero.simulate.injection import Synthetic


def known_effects(card: Card | None = None) -> dict[str, Effect]:
    """The catalogue, and the effects of the card's own files, in alphabetical order."""
    own = own_effects(card.effect_files) if card is not None else {}
    return dict(sorted((CATALOGUE | own).items()))


def effect_facts(effect: Effect, card: Card | None = None) -> dict[str, Any]:
    """An effect as plain data; `model` says whether the card's model has it, null without a card."""
    parameters = []
    for p in effect.parameters:
        least, most = effect.sizes.get(p.name, (None, None))
        a, b = f"{p.prior.location:g}", f"{p.prior.scale:g}"
        words = {
            "normal": f"normal, mean {a}, deviation {b}",
            "lognormal": f"lognormal, median {a}, deviation of the logarithm {b}",
            "halfnormal": f"half-normal above {a}, scale {b}",
            "uniform": f"uniform, {a} to {p.prior.location + p.prior.scale:g}",
        }
        prior = picked(p.prior, "family", "location", "scale", "source") | {"text": words[p.prior.family]}
        about = picked(p, "name", "unit", "description", "neutral", "start", "bounds")
        parameters.append(about | {"prior": prior, "least_worth_modelling": least, "largest_plausible": most})
    return {
        "name": effect.name,
        "kind": effect.kind.value,
        "stage": effect.stage.name.lower(),
        "claim": effect.claim,
        "formula": effect.formula,
        "parameters": parameters,
        "needs": list(effect.channels),
        "rests_on": list(effect.uses),
        "axes": [axis.value for axis in effect.axes],
        "proposed_by_diagnose": effect.candidate and (card is None or effect.acts_on(card.axes)),
        "example": picked(effect.example, "parameters", "signals", "known", "increments", "source")
        | {"known": effect.example.known or {}},
        "source": effect.source,
        "model": None if card is None else effect.name in card.effects,
    }


# --- An effect file of the terms that a diagnosis found, for a card to name.

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
    told = re.sub(r"[^\w.@:+ -]", "_", " and ".join(records))  # a name becomes part of a program
    code = " ".join(one.term.code or "" for one in terms)
    parts = [HEAD.format(records=told, imports="".join(line for used, line in IMPORTED.items() if used in code))]
    for one in terms:
        plain = one.term.name.lower().replace("(1 - x)", "separated").replace("^", "").replace("+", "plus")
        name, (size, sd) = f"{one.coefficient}_{re.sub(r'[^a-z0-9]+', '_', plain).strip('_')}", one.size
        largest = LARGEST * max(abs(size), one.least)
        names = {"name": name.lower(), "constant": name.upper(), "parameter": name, "coefficient": one.coefficient}
        about = {"term": one.term.name, "unit": one.term.unit, "code": one.term.code, "channels": one.term.channels}
        sizes = {"size": size, "sd": sd, "least": float(f"{one.least:.3g}"), "largest": float(f"{largest:.3g}")}
        parts.append(TERM.format(**names, **about, **sizes, records=told))
    return "".join(parts)


# --- The job of `bayes-aero simulate`: a record on disk, with its truth beside it.

TRUTH_SCHEMA = "bayes_aero/truth/1"


def simulate_file(
    request: Request, card: Card, known: Mapping[str, Effect], out: Path
) -> tuple[Synthetic, dict[str, Any]]:
    """Simulate into `out`, in the format of its suffix, and `out`.truth.json; what is written can be read again."""
    from bayes_aero.flight.reading import read_record
    from bayes_aero.flight.record import WRITERS, write_record
    from bayes_aero.simulate.injection import synthetic

    if out.suffix.lower() not in WRITERS:
        raise InputError(f"{out}: records are written as {', '.join(WRITERS)}; choose one of these suffixes")
    if not out.parent.is_dir():
        raise InputError(f"{out}: there is no folder {out.parent}; make it, or name another file with --out")
    found = synthetic(request, card, known, out.stem)
    record = found.record
    write_record(record, out, [c for c in card.channels if record.has(c.name)])
    try:
        read_record(out, card.channels)
    except InputError:
        out.unlink(missing_ok=True)
        raise
    asked = asdict(request) | {"duration": request.seconds}
    source = provenance(card, [record], request.seed, {k: v for k, v in asked.items() if k not in ("effects", "seed")})
    del source["inputs"]
    truth = {
        "schema": TRUTH_SCHEMA,
        "file": {"name": out.name, "sha256": sha256_of(out)},
        "seed": request.seed,
        "effects": request.effects,
        **picked(found, "parameters", "disturbance", "sensor_noise", "notes"),
        "provenance": source,
    }
    write_json(truth, out.with_name(out.name + ".truth.json"))
    return found, truth


# --- Effects as they are asked for on the command line and in studies: "NAME=VALUE" or "NAME.PARAMETER=VALUE".


def parsed_effects(given: Sequence[str], known: Mapping[str, Effect]) -> dict[str, dict[str, float]]:
    """True values by effect and parameter, in SI; a value may carry a unit, "pitch_rate_bias=0.2 deg/s"."""
    from bayes_aero.simulate.demo import TRUTH

    found: dict[str, dict[str, float]] = {}
    for text in given:
        left, equals, right = text.partition("=")
        name, _, wanted = left.strip().partition(".")
        if not equals or not right.strip():
            raise InputError(f"--effect {text!r} has no value; write NAME=VALUE, e.g. pitch_rate_bias=0.01")
        parameters = {p.name: p for p in effect_named(name, known).parameters}
        if not parameters:
            raise InputError(f"--effect {text!r}: {name} has no parameter, so there is nothing to set")
        if wanted not in parameters and (wanted or len(parameters) > 1):
            names = " and ".join(f"{name}.{p}=VALUE" for p in parameters)
            has = f"has no parameter {wanted}" if wanted else f"has {len(parameters)} parameters"
            raise InputError(f"--effect {text!r}: {name} {has}; write {names}")
        parameter = parameters[wanted] if wanted else next(iter(parameters.values()))
        values = found.setdefault(name, {})
        if parameter.name in values:
            raise InputError(f"--effect gives {parameter.name} twice; keep one of the two")
        try:
            value = float(right)
        except ValueError:
            value = quantity_to_si(right.strip(), parameter.unit, f"--effect {text!r}: {parameter.name}")
        lower, upper = parameter.bounds
        if not (math.isfinite(value) and lower <= value <= upper):
            raise InputError(f"--effect {text!r}: {parameter.name} must lie between {lower:g} and {upper:g}")
        values[parameter.name] = value
    for name, values in found.items():
        if missing := [p.name for p in known[name].parameters if p.name not in values and p.name not in TRUTH]:
            lacks = missing[0]
            raise InputError(f"effect {name} has also the parameter {lacks}; add --effect {name}.{lacks}=VALUE")
    return found
