"""Sampled sets of terms as sentences, table and JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources

import jsonschema
import pytest

from bayes_aero.diagnosis.terms.library import QUANTITIES, Term
from bayes_aero.diagnosis.terms.result import SampledSet, SampledTerms
from bayes_aero.report.structure.tables import sampled_table
from bayes_aero.report.text.diagnosis import diagnosis_sentences
from bayes_aero.report.text.verdict import verdict_sentence

BY_NAME = {q.name: q for q in QUANTITIES}
BREAKING, OTHER = Term((BY_NAME["alpha"], BY_NAME["qhat"])), Term((BY_NAME["elevator"], BY_NAME["CT"]))
SAMPLED = SampledTerms(
    "Cm", (SampledSet(((BREAKING, 0.9), (OTHER, 0.05)), 0.95, True),), {BREAKING.name: (0.9, 0.95)},
    1.1, "converged", 1.002, 2500.0, 0.0, True,
)  # fmt: skip


@pytest.mark.parametrize(
    ("sampled", "words"),
    [
        (SAMPLED, "It agrees with forward selection."),
        (
            replace(SAMPLED, found={OTHER.name: (0.0, 0.02)}),
            f"{OTHER.name} of forward selection has less than one half",
        ),
        (
            replace(SAMPLED, sets=(replace(SAMPLED.sets[0], known=False),)),
            f"forward selection lacks {BREAKING.name}",
        ),
        (replace(SAMPLED, found={OTHER.name: (0.1, 0.9)}), f"but {OTHER.name} itself has less than one half"),
        (replace(SAMPLED, reliable=False, status="not converged"), "may not be used: not converged."),
        (replace(SAMPLED, sets=(), found={}), "Forward selection has no form either."),
    ],
)
def test_the_sampled_posterior_says_whether_it_agrees(diagnosed, sampled, words):
    d = replace(diagnosed.view.diagnosis, sampled=(sampled,))
    (told,) = [s for s in diagnosis_sentences(d) if s.startswith("Sampled: ")]
    assert words in told


def test_it_names_nothing(diagnosed):
    d = diagnosed.view.diagnosis
    assert verdict_sentence(replace(d, sampled=(SAMPLED,))) == verdict_sentence(d)


def test_the_table_follows_the_schema(diagnosed):
    schema = json.loads(resources.files("bayes_aero.jobs.io.schemas").joinpath("diagnosis.schema.json").read_text())
    table = sampled_table(replace(diagnosed.view.diagnosis, sampled=(SAMPLED,)))
    rows = table.records()
    jsonschema.validate(rows, schema["properties"]["sampled_terms"] | {"$defs": schema["$defs"]})
    assert len(table.frame()) == len(rows)
    assert rows[0]["set_probability"] == 0.95
