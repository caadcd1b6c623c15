"""The verification's own books: fresh seeds, an interruption, the verdict and the ledger; flights are made up here."""

import csv
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import pytest
import verify
from verify import ROUND, begin, count, enter, flights, fly, line_of, mark


def silent(kind, seed, posterior):
    """A flight that bears out the one claim that it tries."""
    trials = {"silence": {"false_alarms": False}, "one": {"named": True, "size_held": True}}
    return {"kind": kind, "seed": seed, "trials": trials.get(kind, {}), "sampled": posterior}


@pytest.fixture
def pool():
    with ThreadPoolExecutor(2) as opened:
        yield opened


def test_a_run_flies_every_kind_and_is_entered(tmp_path, pool):
    run, folder = begin(tmp_path, "abc", rounds=3, posterior=False)
    rows = fly(run, folder, silent, pool, workers=2, seconds=60.0)
    assert Counter(row["kind"] for row in rows) == {kind: 3 * each for kind, each in ROUND.items()}
    for kind, each in ROUND.items():
        seeds = sorted(row["seed"] for row in rows if row["kind"] == kind)
        assert seeds == list(range(run.first, run.first + 3 * each))
    line = line_of(run, rows)
    assert line["verdict"] == "not refuted"
    assert (line["false_alarms"], line["named"], line["bound_held"]) == ("0/9", "9/9", "0/0")
    assert line["seeds"] == f"{run.first} to {run.first + 11}"
    for _ in range(2):
        enter(line, tmp_path / "ledger.csv")
    with (tmp_path / "ledger.csv").open() as file:
        kept = list(csv.DictReader(file))
    assert kept == [line, line]


def test_an_interrupted_run_goes_on_with_its_seeds_and_flies_nothing_twice(tmp_path, pool):
    run, folder = begin(tmp_path, "abc", rounds=2, posterior=True)
    asked = []

    def until_the_fourth(kind, seed, posterior):
        asked.append((kind, seed))
        if len(asked) == 4:
            raise KeyboardInterrupt
        return silent(kind, seed, posterior)

    with pytest.raises(KeyboardInterrupt):
        fly(run, folder, until_the_fourth, pool, workers=1, seconds=60.0)
    with (folder / "flights.jsonl").open("a") as file:
        file.write('{"kind": "silence", "se')  # cut off
    assert len(flights(folder)) == 3
    assert begin(tmp_path, "abc", rounds=2, posterior=True) == (run, folder)
    again = []

    def counted(kind, seed, posterior):
        again.append((kind, seed))
        return silent(kind, seed, posterior)

    rows = fly(run, folder, counted, pool, workers=2, seconds=60.0)
    assert not set(again) & set(asked[:3])
    assert len({(row["kind"], row["seed"]) for row in rows}) == len(rows) == 2 * sum(ROUND.values())
    assert all(row["sampled"] for row in rows)
    assert flights(folder) == rows


def test_other_code_other_rounds_and_a_finished_run_get_seeds_of_their_own(tmp_path):
    run, folder = begin(tmp_path, "abc", rounds=2, posterior=False)
    settings = (("def", 2, False), ("abc", 3, False), ("abc", 2, True))
    others = [begin(tmp_path, *other)[0] for other in settings]
    mark(run, folder, finished=True)
    others.append(begin(tmp_path, "abc", rounds=2, posterior=False)[0])
    assert len({run.first, *(other.first for other in others)}) == 5


def test_no_flight_is_begun_after_the_time(tmp_path, pool):
    run, folder = begin(tmp_path, "abc", rounds=2, posterior=False)
    assert fly(run, folder, silent, pool, workers=2, seconds=0.0) == []


def test_a_false_claim_and_a_crash_are_in_the_verdict(tmp_path):
    """6 alarms of 20 have a chance of 0.03 % at a rate of 5 %."""
    run, _ = begin(tmp_path, "abc", rounds=20, posterior=False)
    rows = [{"kind": "silence", "seed": k, "trials": {"false_alarms": k < 6}} for k in range(20)]
    rows.append({"kind": "one", "seed": 3, "trials": {}, "refused": "too large"})
    assert count(rows)["false_alarms"] == (6, 20)
    line = line_of(run, rows)
    assert (line["verdict"], line["refused"], line["flights"]) == ("refuted: false_alarms", "1", "21")
    rows.append({"kind": "one", "seed": 4, "trials": {}, "crashed": "ValueError"})
    assert line_of(run, rows)["verdict"] == "refuted: false_alarms, 1 crashed"


def test_a_changed_file_is_told_beside_the_commit_but_not_the_ledger(tmp_path):
    def git(*words):
        verify.subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a@b.c", *words], cwd=tmp_path, check=True)

    assert verify.commit_of(tmp_path) == "unknown"
    git("init", "-q")
    (tmp_path / "benchmarks").mkdir()
    for name in ("code.py", "benchmarks/ledger.csv"):
        (tmp_path / name).write_text("1\n")
    git("add", ".")
    git("commit", "-qm", "begin")
    plain = verify.commit_of(tmp_path)
    assert len(plain) == 10
    (tmp_path / "benchmarks" / "ledger.csv").write_text("2\n")
    assert verify.commit_of(tmp_path) == plain
    (tmp_path / "code.py").write_text("2\n")
    assert verify.commit_of(tmp_path) == f"{plain}+changes"
