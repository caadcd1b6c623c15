"""Cards and records for `bayes-aero fly`, and what it must have written."""

from __future__ import annotations

import json
from importlib import resources

import jsonschema
import numpy as np
from linear_cards import card_of, record_of

from bayes_aero.flight.reading.read_record import write_record

NOISE = {"alpha": 0.002, "q": 0.003, "az": 0.15, "p": 0.004, "r": 0.003, "p_dot": 0.03}
SCHEMA = json.loads(resources.files("bayes_aero.jobs.io.schemas").joinpath("trajectories.schema.json").read_text())


def written(folder, text, channels, name="flight", seed=1):
    """Card and record as files; the true channels are those of the matrix exponential, with white noise."""
    card, record = folder / "card.toml", folder / f"{name}.csv"
    card.write_text(text)
    noisy = record_of(channels, noise=NOISE, rng=np.random.default_rng(seed), name=name)
    write_record(noisy, record, [c for c in card_of(text).channels if noisy.has(c.name) or c.name == "time"])
    return card, record


def told(done):
    """The JSON on standard output, which must follow the schema."""
    found = json.loads(done.out)
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.validate(found, SCHEMA)
    return found


def page_of(folder):
    """The report page; every part of it must have been made."""
    page = (folder / "report.html").read_text()
    assert "was not made" not in page
    return page
