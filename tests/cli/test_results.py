"""The command line end to end on short records, and its words for bad input."""

import json
import re
from functools import reduce
from unittest.mock import patch

import jsonschema
import pytest
from calling import called, holds, page_of, recorded, refused, succeeded, validated
from markupsafe import escape

from bayes_aero.jobs import identify as identification
from bayes_aero.jobs.io.documents import document_schema

SETTINGS = ("--noise", "white", "--no-gp", "--no-figures", "--next-flight")
GONE = object()


@pytest.fixture(scope="module")
def flown(tmp_path_factory, clean_records, card):
    """The stalls of both simulated manoeuvres as CSV files, and the results of one run on them."""
    folder = tmp_path_factory.mktemp("flown")
    paths = []
    for record in (whole.window(25.0, 65.0) for whole in clean_records):
        paths.append(folder / f"{record.name}.csv")
        recorded(record, paths[-1], card)
    done = succeeded(called(folder, "identify", *paths, "--out", "first", *SETTINGS))
    return folder, paths, done


def test_results_follow_the_schema_and_are_printed(flown):
    folder, _, _ = flown
    results = validated(folder / "first" / "results.json", "results")
    assert results["mle"]["status"] == "converged"
    assert set(results["posterior"]["emcee"]) >= {"alpha_star", "sigma_CL"}
    assert len(results["provenance"]["inputs"]) == 2
    assert results["next_flight"]["manoeuvres"] == list(results["mle"]["alone"])
    for name in ("parameters.csv", "posterior_nuts.nc", "next_flight.csv", "next_flight.nc"):
        assert (folder / "first" / name).is_file()
    holds(flown[2].out, "alpha_star", "first")


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("schema", "bayes_aero/results/0"), ("records", []), ("verdict", GONE), ("provenance seed", GONE),
        ("mle status", "perfect"), ("mle det_R", "small"), ("mle fit CL", GONE), ("mle fit lift", {}),
        ("stall at_edge", 1.5), ("stall CL_max ci95", [1.0]), ("health", None), ("next_flight more", 1),
        ("posterior emcee alpha_star rhat", GONE), ("consistency outcome", "maybe"), ("card name", 3),
    ],
)  # fmt: skip
def test_what_is_not_as_the_classes_say_is_refused(flown, place, value):
    results = json.loads((flown[0] / "first" / "results.json").read_text())
    *way, key = place.split()
    part = reduce(lambda whole, name: whole[name], way, results)
    part.pop(key, None) if value is GONE else part.update({key: value})
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(results, document_schema("results"))


def test_the_page_and_the_file_tell_the_same_stall(flown):
    folder, _, _ = flown
    results = json.loads((folder / "first" / "results.json").read_text())
    assert results["notes"] == []
    stall = results["stall"]
    assert stall["CL_max"]["ci95"][0] < stall["CL_max"]["median"] < stall["CL_max"]["ci95"][1]
    page = page_of(folder / "first")
    told = [float(x) for x in re.findall(r"(\d\.\d{3,}) \(", page)]  # with as many digits as the interval needs
    assert any(x == pytest.approx(stall["CL_max"]["median"], abs=5e-4) for x in told)
    assert not list((folder / "first").glob("*.part"))


def test_same_seed_same_numbers(flown):
    folder, paths, _ = flown
    with patch.object(identification, "put_page", lambda *_: ()):  # of which results.json has nothing
        again = called(folder, "identify", *paths, "--out", "again", *SETTINGS)
    assert again.code == 0, again.err
    first, second = (json.loads((folder / out / "results.json").read_text()) for out in ("first", "again"))
    first.pop("provenance")
    second.pop("provenance")
    assert first == second


def test_one_manoeuvre_has_no_next_flight(flown):
    folder, paths, _ = flown
    done = called(folder, "identify", paths[0], "--out", "one", "--next-flight")
    refused(done, "2 to 24 manoeuvres, and there is 1", gone=[folder / "one"])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["identify", "nowhere.csv"], "nowhere.csv"), (["identify", "empty.csv"], "empty.csv"),
        (["identify", "--model", "atas"], "attas"), (["identify", "--model", "bad.toml"], "efects"),
        (["diagnose", "nowhere.csv"], "nowhere.csv"), (["diagnose", "empty.csv"], "empty.csv"),
        (["diagnose", "--model", "atas"], "attas"), (["diagnose", "--max-effects", "0"], "max-effects"),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence(tmp_path, program, arguments, told):
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "bad.toml").write_text('[aircraft]\n[channels]\n[model]\nefects = ["attached_lift"]\n')
    done = program(*arguments)
    assert done.code == 2
    assert told in done.err
    assert "Traceback" not in done.err
    assert not any((tmp_path / name).exists() for name in ("results", "diagnosis"))


def test_diagnose_writes_and_tells_what_it_found(tmp_path, told_diagnosis):
    found = validated(tmp_path / "diagnosis" / "diagnosis.json", "diagnosis")
    assert found["provenance"]["settings"] == {"max_effects": 2}
    for cause in found["causes"]:
        assert cause["name"] in told_diagnosis.out
    assert (tmp_path / "diagnosis" / "screen.csv").is_file()
    assert not (tmp_path / "diagnosis" / "figures").exists()
    page = page_of(tmp_path / "diagnosis")
    assert all(str(escape(cause["claim"])) in page for cause in found["causes"])
