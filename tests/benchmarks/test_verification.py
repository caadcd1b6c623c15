"""Claims and the verification that counts them, studies that go on where they stopped, qualification as stated."""

import csv
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import verify
from qualification import CUBIC, DT, NOISE, OUTPUTS, TRUTH, N, aircraft, flight
from scipy.stats import binomtest
from studies import resumed
from verify import CLAIMS, LEVEL, ROUND, Claim, Side, begin, count, enter, flights, fly, line_of, mark

from bayes_aero.errors import InputError

README = Path(__file__).parents[2] / "benchmarks" / "README.md"
COUNTS = [(0, 1), (1, 1), (0, 16), (3, 16), (5, 16), (16, 16), (7, 40), (191, 200), (200, 200)]
CLAIM = Claim("named", "", Side.AT_LEAST, 0.95)


@pytest.mark.parametrize(("hits", "of"), COUNTS)
@pytest.mark.parametrize(("side", "alternative"), [
    (Side.AT_MOST, "greater"), (Side.AT_LEAST, "less"), (Side.EQUAL, "two-sided"),
])  # fmt: skip
def test_limits_are_those_of_clopper_and_pearson(hits, of, side, alternative):
    exact = binomtest(hits, of, alternative=alternative).proportion_ci(LEVEL, method="exact")
    assert replace(CLAIM, side=side).limits(hits, of) == pytest.approx((exact.low, exact.high), abs=1e-12)


@pytest.mark.parametrize(("side", "alternative"), [(Side.AT_MOST, "greater"), (Side.AT_LEAST, "less")])
@pytest.mark.parametrize("rate", [0.05, 0.5, 0.95])
def test_a_claim_is_refuted_exactly_where_the_binomial_test_rejects_its_rate(side, alternative, rate):
    claim, verdicts = Claim("", "", side, rate), set()
    for of in (1, 4, 16, 60, 200):
        for hits in range(of + 1):
            rejected = binomtest(hits, of, rate, alternative=alternative).pvalue < 1.0 - LEVEL
            assert claim.holds(hits, of) is not rejected, (hits, of)
            verdicts.add(rejected)
    assert verdicts == {True, False}


def test_an_equality_is_refuted_on_both_sides():
    """Each tail has half of the level: binomial tails of 0.005 around 190 of 200."""
    claim = replace(CLAIM, side=Side.EQUAL)
    for hits in range(201):
        below, above = (binomtest(hits, 200, 0.95, alternative=tail).pvalue for tail in ("less", "greater"))
        assert claim.holds(hits, 200) == (min(below, above) >= 0.005), hits
    assert not claim.holds(200, 200)
    assert not claim.holds(180, 200)


def test_no_trials_refute_nothing_and_the_documentation_lists_every_claim_with_its_rate():
    assert all(claim.limits(0, 0) == (0.0, 1.0) and claim.holds(0, 0) for claim in CLAIMS)
    assert len({claim.key for claim in CLAIMS}) == len(CLAIMS)
    text = README.read_text(encoding="utf-8")
    table = {row[0]: row[-1].rstrip(" |") for row in (line.split(" | ") for line in text.splitlines()) if len(row) == 3}
    for claim in CLAIMS:
        assert table[f"| `{claim.key}`"] == f"{claim.side} {claim.rate:g}"


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


def test_an_interrupted_run_goes_on_with_its_seeds_and_no_flight_is_begun_after_the_time(tmp_path, pool):
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
    run, folder = begin(tmp_path, "abc", rounds=2, posterior=False)
    assert fly(run, folder, silent, pool, workers=2, seconds=0.0) == []


def test_other_code_other_rounds_and_a_finished_run_get_seeds_of_their_own(tmp_path):
    run, folder = begin(tmp_path, "abc", rounds=2, posterior=False)
    settings = (("def", 2, False), ("abc", 3, False), ("abc", 2, True))
    others = [begin(tmp_path, *other)[0] for other in settings]
    mark(run, folder, finished=True)
    others.append(begin(tmp_path, "abc", rounds=2, posterior=False)[0])
    assert len({run.first, *(other.first for other in others)}) == 5


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


def test_rows_that_are_there_are_not_run_again(tmp_path, capsys):
    run = []

    def case(seed):
        if seed == 3:
            raise InputError("it leaves the envelope")
        if seed == 4 and 4 not in run:
            run.append(4)
            raise KeyboardInterrupt
        run.append(seed)
        return {"seed": seed}

    path, cases = tmp_path / "study" / "rows.jsonl", {seed: partial(case, seed) for seed in (1, 2, 3, 4)}
    with pytest.raises(KeyboardInterrupt):
        resumed(path, cases)
    assert run == [1, 2, 4]
    rows = resumed(path, cases)
    assert [row["seed"] for row in rows] == [1, 2, 4]
    assert run == [1, 2, 4, 4]  # the first two once
    assert "3: it leaves the envelope" in capsys.readouterr().err
    assert len(path.read_text().splitlines()) == 3


SEEDS = (0, 1)


def test_the_true_aircraft_obeys_its_equations():
    """Accelerations from noisy rates: with the cubic moment the residual of q-dot is noise and turbulence."""
    rng = np.random.default_rng(0)
    de = 0.04 * np.sin(2.0 * np.pi * DT * np.arange(N) / 3.0)
    record = flight(TRUTH, de, rng, "one")
    alpha, q = record["alpha"], record["q"]
    q_dot = np.gradient(q, DT)
    full = TRUTH["Malpha"] * alpha + CUBIC * alpha**3 + TRUTH["Mq"] * q + TRUTH["Mde"] * de
    noise = NOISE["q"] / DT / np.sqrt(2.0)
    assert np.std(q_dot - full) < 2.0 * noise
    assert np.std(q_dot - full + CUBIC * alpha**3) > np.std(q_dot - full)
    assert np.allclose(record["az"].mean(), 90.0 * np.mean(TRUTH["Zalpha"] * alpha + TRUTH["Zde"] * de), atol=0.05)


def test_stated_probabilities_order_what_happens():
    """Of the tests of two aircraft those that are stated to pass do, and those that are stated to fail do not."""
    rows = [row for seed in SEEDS for row in aircraft(seed, 3)]
    assert len(rows) == len(SEEDS) * 3 * 3 * len(OUTPUTS)
    stated, passed = (np.array([row[i] for row in rows]) for i in (1, 2))
    assert passed[stated > 0.99].mean() > 0.9
    assert passed[stated < 0.01].mean() < 0.1
    assert np.corrcoef(stated, passed)[0, 1] > 0.8
