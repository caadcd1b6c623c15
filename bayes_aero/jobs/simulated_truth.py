"""A simulated record on disk, with its truth beside it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.reading.read_record import read_record, write_record
from bayes_aero.flight.writers import WRITERS
from bayes_aero.jobs.provenance.provenance import provenance, write_json
from bayes_aero.report.html.page import put_page
from bayes_aero.report.pages.simulated_record import simulated_page
from bayes_aero.simulate.request import Request
from bayes_aero.simulate.synthetic_record import Synthetic, synthetic

SCHEMA = "bayes_aero/truth/1"


def simulate_file(
    request: Request, card: Card, known: Mapping[str, Effect], out: Path, *, page: bool = False
) -> tuple[Synthetic, dict[str, Any], tuple[str, ...]]:
    """Simulate into `out`, in the format of its suffix, and `out`.truth.json; what is written can be read again.

    With `page` there is `out`.report.html, too; what of it cannot be made is told in the last item.
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
        "file": {"name": out.name, "sha256": hashlib.sha256(out.read_bytes()).hexdigest()},
        "seed": request.seed,
        "effects": {name: dict(values) for name, values in request.effects.items()},
        "parameters": dict(found.parameters),
        "disturbance": dict(found.disturbance),
        "sensor_noise": dict(found.sensor_noise),
        "notes": list(found.notes),
        "provenance": source,
    }
    write_json(truth, out.with_name(out.name + ".truth.json"))
    failures: tuple[str, ...] = ()
    if page:
        flown = [p for e in known.values() for p in e.parameters if p.name in found.parameters]
        failures = put_page(lambda: simulated_page(record, card, truth, flown), out.parent, out.name + ".report.html")
    return found, truth, failures
