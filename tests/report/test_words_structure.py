"""Weights of rivals and sampled sets of terms as sentences, tables and JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources

import jsonschema
import numpy as np
import pytest

from bayes_aero.diagnosis.selection.stacking import StackedModel, Stacking
from bayes_aero.diagnosis.terms.library import QUANTITIES, Term
from bayes_aero.diagnosis.terms.result import SampledSet, SampledTerms
from bayes_aero.report.structure.tables import sampled_table, weights_table
from bayes_aero.report.text.diagnosis import diagnosis_sentences
from bayes_aero.report.text.verdict import verdict_sentence

BY_NAME = {q.name: q for q in QUANTITIES}
BREAKING, OTHER = Term((BY_NAME["alpha"], BY_NAME["qhat"])), Term((BY_NAME["elevator"], BY_NAME["CT"]))
SAMPLED = SampledTerms(
    "Cm", (SampledSet(((BREAKING, 0.9), (OTHER, 0.05)), 0.95, True),), {BREAKING.name: (0.9, 0.95)},
    1.1, "converged", 1.002, 2500.0, 0.0, True,
)  # fmt: skip


def with_rival(diagnosed, weight, own_stage=True):
    """The diagnosis with a rival of its last cause, and the weight that the model as selected has."""
    d = diagnosed.view.diagnosis
    cause = replace(d.causes[-1], ambiguous_with=("mass_scale",), confirmed=True, probability=0.7)
    models = (
        StackedModel((cause.name,), None, np.zeros(1), weight, (weight - 0.1, weight + 0.1), (0.0, 0.0)),
        StackedModel(
            ("mass_scale",), (cause.name, "mass_scale"), np.zeros(1), 1.0 - weight, (0.0, 0.9 - weight), (-1.5, 2.0)
        ),
    )
    return cause, replace(d, causes=(cause,), stacking=(Stacking(cause.stage, models, 12),) if own_stage else ())


def said(d, name):
    return next(s for s in diagnosis_sentences(d) if s.startswith(f"{name}: "))


def test_a_cause_is_chosen_only_by_its_weight(diagnosed):
    cause, d = with_rival(diagnosed, 0.85)
    assert f"{cause.name} is chosen." in said(d, cause.name)
    assert "mass_scale 0.15" in said(d, cause.name)
    assert "or mass_scale" not in verdict_sentence(d)
    assert any(
        f"To include {cause.name}" in s or s.startswith(f"{cause.name}: correct") for s in diagnosis_sentences(d)
    )


@pytest.mark.parametrize(("weight", "words"), [(0.55, "; none is chosen."), (0.1, "hold-out data prefer mass_scale")])
def test_without_the_weight_none_is_chosen(diagnosed, weight, words):
    cause, d = with_rival(diagnosed, weight)
    assert words in said(d, cause.name)
    assert "or mass_scale" in verdict_sentence(d)
    assert not any(f"To include {cause.name}" in s for s in diagnosis_sentences(d))


def test_rivals_that_were_not_weighed_are_reported_as_before(diagnosed):
    cause, d = with_rival(diagnosed, 0.9, own_stage=False)
    assert "Stacking" not in said(d, cause.name)
    assert "or mass_scale" in verdict_sentence(d)
    alone = replace(d, causes=(replace(cause, ambiguous_with=()),))
    assert d.chosen(alone.causes[0])


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


def test_tables_follow_the_schema(diagnosed):
    schema = json.loads(resources.files("bayes_aero.jobs.io.schemas").joinpath("diagnosis.schema.json").read_text())
    _, d = with_rival(diagnosed, 0.6)
    d = replace(d, sampled=(SAMPLED,))
    for key, table in (("stacking", weights_table(d)), ("sampled_terms", sampled_table(d))):
        rows = table.records()
        jsonschema.validate(rows, schema["properties"][key] | {"$defs": schema["$defs"]})
        assert len(table.frame()) == len(rows)
    assert [row["weight"] for row in weights_table(d).records()] == [0.6, 0.4]
    assert sampled_table(d).records()[0]["set_probability"] == 0.95
