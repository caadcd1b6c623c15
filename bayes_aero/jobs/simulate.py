"""The job of `bayes-aero simulate`: a record on disk, with its truth beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import WRITERS, write_record
from bayes_aero.jobs.catalogue import effect_named
from bayes_aero.jobs.provenance import picked, provenance, sha256_of, write_json
from bayes_aero.parameter import Parameter
from bayes_aero.report.html.page import put_page
from bayes_aero.report.pages.check import simulated_page
from bayes_aero.simulate.demo import TRUTH, Request
from bayes_aero.simulate.injection import Synthetic, synthetic
from bayes_aero.units import quantity_to_si

SCHEMA = "bayes_aero/truth/1"


def simulate_file(
    request: Request, card: Card, known: Mapping[str, Effect], out: Path, *, page: bool = False
) -> tuple[Synthetic, dict[str, Any], tuple[str, ...]]:
    """Simulate into `out`, in the format of its suffix, and `out`.truth.json; what is written can be read again.

    With `page` there is `out`.report.html, too; the last item states what of it could not be made.
    """
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
        "schema": SCHEMA,
        "file": {"name": out.name, "sha256": sha256_of(out)},
        "seed": request.seed,
        "effects": request.effects,
        **picked(found, "parameters", "disturbance", "sensor_noise", "notes"),
        "provenance": source,
    }
    write_json(truth, out.with_name(out.name + ".truth.json"))
    failures: tuple[str, ...] = ()
    if page:
        flown = [p for e in known.values() for p in e.parameters if p.name in found.parameters]
        failures = put_page(lambda: simulated_page(record, card, truth, flown), out.parent, out.name + ".report.html")
    return found, truth, failures


# --- Effects as they are asked for on the command line and in studies: "NAME=VALUE" or "NAME.PARAMETER=VALUE".


def parsed_effects(given: Sequence[str], known: Mapping[str, Effect]) -> dict[str, dict[str, float]]:
    """True values by effect and parameter, in SI; a value may carry a unit, "pitch_rate_bias=0.2 deg/s"."""
    found: dict[str, dict[str, float]] = {}
    for text in given:
        left, equals, right = text.partition("=")
        name, _, wanted = left.strip().partition(".")
        if not equals or not right.strip():
            raise InputError(f"--effect {text!r} has no value; write NAME=VALUE, e.g. pitch_rate_bias=0.01")
        parameter = _parameter_of(effect_named(name, known), wanted, text)
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
        missing = [p.name for p in known[name].parameters if p.name not in values and p.name not in TRUTH]
        if missing:
            raise InputError(
                f"effect {name} has also the parameter {missing[0]}; add --effect {name}.{missing[0]}=VALUE"
            )
    return found


def _parameter_of(effect: Effect, wanted: str, text: str) -> Parameter:
    """The parameter that an effect has by this name, or its only one."""
    own = {p.name: p for p in effect.parameters}
    if not own:
        raise InputError(f"--effect {text!r}: {effect.name} has no parameter, so there is nothing to set")
    if wanted:
        if wanted not in own:
            raise InputError(f"--effect {text!r}: {effect.name} has no parameter {wanted}, but {', '.join(own)}")
        return own[wanted]
    if len(own) > 1:
        names = " and ".join(f"{effect.name}.{p}=VALUE" for p in own)
        raise InputError(f"--effect {text!r}: {effect.name} has {len(own)} parameters; write {names}")
    return next(iter(own.values()))
