"""What is said and written of a parameter that changes during the records, according to a diagnosis."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources

import jsonschema
import pytest

from bayes_aero.diagnosis.result import ParameterChange, Verdict, verdict_of
from bayes_aero.jobs.io.diagnosis_json import change_results
from bayes_aero.report.tables.diagnosis_tables import changes_table
from bayes_aero.report.text.changes import change_sentences
from bayes_aero.report.text.diagnosis import diagnosis_sentences

CHANGE = ParameterChange(
    parameter="Cm0",
    unit="1",
    manoeuvre="run2",
    at=43.0,
    interval=(42.8, 43.4),
    lasts=True,
    before=(0.0591, 0.0011),
    after=(0.0651, 0.0012),
    size=(0.0060, 0.0005),
    share=0.62,
    p_value=0.005,
    gain=310.0,
)


def test_a_change_is_told_with_its_time_values_and_possible_reasons():
    assert change_sentences([CHANGE]) == [
        "Changed: Cm0 has another value at 43.0 s of run2 (95 %: 42.8 to 43.4 s): 0.0591 ± 0.0011 before, "
        "0.0651 ± 0.0012 after, a change of 0.00600 ± 0.00050 (62% of the remaining variance). Possible reasons are a "
        "stuck tab, another setting of trim or flaps, or a shift of the centre of gravity; the record does not "
        "determine which."
    ]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (replace(CHANGE, at=0.0), "another value from run2 on: "),
        (replace(CHANGE, at=0.0, lasts=False), "another value in run2: "),
        (replace(CHANGE, lasts=False), "0.0651 ± 0.0012 after, and the value before in later records, a change"),
        (
            replace(CHANGE, ambiguous_with=("Cma", "CmX")),
            "On this record Cma and CmX would explain the data about as well.",
        ),
    ],
)
def test_where_it_holds_and_what_explains_as_much_is_told(change, said):
    assert said in change_sentences([change])[0]


def test_a_parameter_without_usual_reasons_gets_none():
    (said,) = change_sentences([replace(CHANGE, parameter="tau2", unit="c/V")])
    assert "reasons" not in said


def test_a_change_is_no_cause_for_the_verdict():
    assert verdict_of([], [CHANGE]) is Verdict.UNEXPLAINED


def test_the_verdict_names_the_parameter_and_the_record(diagnosed):
    d = replace(diagnosed.view.diagnosis, verdict=Verdict.UNEXPLAINED, causes=(), unknown=(), changes=(CHANGE,))
    headline, *rest = diagnosis_sentences(d)
    assert headline.endswith("no effect of the catalogue explains it (Cm0 changes in run2).")
    assert change_sentences([CHANGE])[0] in rest
    (row,) = changes_table(d).frame().reset_index().to_dict("records")
    assert (row["parameter"], row["at_low"], row["at_high"]) == ("Cm0", 42.8, 43.4)
    assert (row["size"], row["size_sd"]) == (0.0060, 0.0005)


def test_what_is_written_follows_the_schema():
    schema = json.loads(resources.files("bayes_aero.jobs.io.schemas").joinpath("diagnosis.schema.json").read_text())
    one = schema["properties"]["changes"] | {"$defs": schema["$defs"]}
    written = change_results(CHANGE)
    jsonschema.validate([written], one)
    assert written["size"] == {"mean": 0.0060, "sd": 0.0005}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate([written | {"at": -1.0}], one)
