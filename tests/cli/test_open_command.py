"""`bayes-aero open`: a page that is there until Ctrl-C, and its words for bad input."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import urllib.request

import pytest
from calling import called

from bayes_aero.flight.reading.read_record import write_record


@pytest.fixture(scope="module")
def folder(tmp_path_factory, clean_records, card):
    """A simulated stall as a CSV file, and the result of identify on it."""
    there = tmp_path_factory.mktemp("opened")
    record = clean_records[0].window(25.0, 65.0)
    write_record(record, there / "stall.csv", [c for c in card.channels if record.has(c.name) or c.name == "time"])
    done = called(there, "identify", "stall.csv", "--out", "results", "--no-sample", "--no-gp", "--no-figures")
    assert done.code == 0, done.err
    return there


def refused(done, words):
    assert done.code == 2
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
    assert words in done.err, done.err
    assert not done.out


def test_help_names_the_options(program):
    text = program("open", "--help").out
    for word in ("DIR", "--records", "--model", "--port", "--no-browser", "127.0.0.1", "Ctrl-C"):
        assert word in text


@pytest.fixture
def interrupts():
    """Ctrl-C reaches programs that a test starts: it is ignored where the tests run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
def test_it_serves_until_ctrl_c_and_ends_with_zero(folder):
    command = [sys.executable, "-m", "bayes_aero", "open", "results", "--no-browser"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        try:
            line = running.stdout.readline()
            assert line.startswith("identify: results is open at http://127.0.0.1:"), (line, running.stderr.read())
            url = line.split(" at ")[1].split(" ")[0]
            with urllib.request.urlopen(url, timeout=120) as page:
                assert b"attached_lift" not in page.read()[:200]
            running.send_signal(signal.SIGINT)
            out, err = running.communicate(timeout=60)
        finally:
            running.kill()
    assert (running.returncode, out, err) == (0, "", "")


def test_what_is_no_result_is_one_sentence(program, folder, tmp_path):
    (tmp_path / "empty").mkdir()
    refused(program("open", "empty"), "is not the result of one run of identify, fly or diagnose")
    refused(program("open", "nosuch"), "there is no result 'nosuch'")
    refused(program("open", "attas"), "attas is a card; give the folder of a result")
    told = json.loads((folder / "results" / "results.json").read_text())
    told["mle"]["status"] = "not_converged"
    (tmp_path / "results.json").write_text(json.dumps(told))
    refused(program("open", "results.json"), "has not converged")


def test_records_that_moved_are_one_sentence(program, folder, tmp_path):
    (tmp_path / "deep" / "results").mkdir(parents=True)
    result = tmp_path / "deep" / "results" / "results.json"
    result.write_bytes((folder / "results" / "results.json").read_bytes())
    refused(program("open", "deep/results"), "give its folder with --records")
    refused(program("open", "deep/results", "--records", tmp_path), f"is not in {tmp_path}")
