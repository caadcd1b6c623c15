"""Benchmarks: ranks and coverage, rivals, claims that are counted, studies that go on, stated probabilities."""

import csv
import importlib
import os
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import studies
from calibration import DRAWS, band_of, calibration_table, covariance, rank, stall_replicate
from interval_coverage import METHODS, coverage_study
from qualification import OUTPUTS, aircraft
from scipy.stats import binomtest, multivariate_normal
from seed_rivals import INNER, problems
from verify import CLAIMS, LEVEL, ROUND, Claim, Run, Side, count, enter, fly, line_of

from bayes_aero.errors import InputError
from bayes_aero.inference.gp_kernel import Priors, ReducedData, density_at, exact_point, noise_to_signal
from bayes_aero.simulate.demo import TRUTH

PEERS = Path(__file__).parents[2] / "benchmarks" / "peers"


def test_ranks_have_the_closed_form_of_quantiles_and_uniform_ones_stay_in_their_band():
    draws = np.arange(1000.0)[:, None] / 1000.0
    draws = np.random.default_rng(0).permutation(draws)
    assert rank(np.array([-1.0]), draws)[0] == 0
    assert rank(np.array([2.0]), draws)[0] == DRAWS
    assert abs(rank(np.array([0.25]), draws)[0] - 0.25 * DRAWS) < 3.0 * np.sqrt(0.25 * 0.75 * DRAWS)
    # 95 % simultaneous: of 200 sets, 190 are expected inside, with a deviation of 3.1.
    rng = np.random.default_rng(3)
    inside = sum(band_of(rng.integers(0, DRAWS + 1, 100))[0] for _ in range(200))
    assert 178 <= inside <= 199


def test_ranks_of_a_posterior_too_narrow_or_shifted_leave_the_band():
    rng = np.random.default_rng(4)
    truth, n = rng.standard_normal(300), 300
    data = truth + rng.standard_normal(n)
    mean, sd = data / 2.0, np.sqrt(0.5)  # of the posterior, in closed form

    for shift, width, right in ((0.0, 1.0, True), (0.0, 0.6, False), (0.4, 1.0, False)):
        draws = mean + shift + width * sd * rng.standard_normal((DRAWS, n))
        assert band_of(rank(truth, draws))[0] is right


@pytest.mark.verify
def test_both_engines_rank_a_truth_alike(thinned, model):
    """Same truth and data: two ranks among 99 draws differ by a deviation of at most 7; five are allowed."""
    few = thinned.thinned(4)
    ours, theirs = (stall_replicate(model, few, engine, 2) for engine in ("emcee", "NUTS"))
    assert len(ours["ranks"]) == 20
    for name, k in ours["ranks"].items():
        assert 0 <= k <= DRAWS
        assert abs(k - theirs["ranks"][name]) < 35, name


def test_a_sample_function_has_the_covariance_that_the_engine_assumes():
    """Against the engine's own kernel matrix through its log likelihood."""
    rng = np.random.default_rng(2)
    x, theta, y = rng.standard_normal((12, 2)), rng.normal(-0.5, 0.3, 7), rng.standard_normal(12)
    exact = multivariate_normal(np.zeros(12), covariance(theta, x)).logpdf(y)
    data = ReducedData.of(x, y)
    value = density_at(theta, exact_point(noise_to_signal(theta), data), data.n, Priors())
    assert value - Priors().slopes(theta)[0] == pytest.approx(exact, abs=1e-8)


def test_the_table_counts_coverage_in_closed_form():
    row = calibration_table([{"ranks": {"a": k}} for k in range(DRAWS + 1)]).loc["a"]
    assert [row[name] for name in ("mean rank", "in 50 %", "in 90 %")] == pytest.approx([0.5, 0.5, 0.9])
    assert bool(row["inside band"])


@pytest.mark.verify
def test_coverage_under_coloured_noise(thinned, model):
    """rho = 0.95: the AR(1) posterior covers, Cramer-Rao bounds and the white posterior do not.

    Sixty replicates of each of eight cells of colour and rate: benchmarks/interval_coverage.py.
    """
    noise = {"sigma_CL": 0.02, "sigma_CD": 0.005, "sigma_Cm": 0.004, "rho_CL": 0.95, "rho_CD": 0.95, "rho_Cm": 0.95}
    inside, _ = coverage_study(model, thinned, TRUTH, noise, replicates=20, seed=17, white=4, max_steps=600)
    share = dict(zip(METHODS, np.nanmean(inside, axis=(0, 2)), strict=True))
    assert 0.91 <= share["AR(1) posterior"] <= 0.98
    assert share["CRB"] < 0.6
    assert share["white posterior"] < 0.6
    assert share["corrected CRB"] > 0.8


@pytest.mark.verify
def test_scipy_and_the_package_reach_one_optimum_each_with_its_own_memory(tmp_path, model, thinned, monkeypatch):
    noise = np.random.default_rng(3).standard_normal(thinned.measured.shape) * [0.02, 0.004, 0.008]
    noisy = replace(thinned, measured=thinned.measured + noise)
    monkeypatch.syspath_prepend(PEERS)
    importlib.import_module("stall").lay_down(model, noisy, tmp_path, {"of": [], "sizes": [60], "quick": True})
    command = [sys.executable, str(PEERS), "--quick", "--blocks", "fits", "--folder", str(tmp_path)]
    settings = os.environ | {"PYTHONPATH": str(PEERS.parents[1])}
    ended = subprocess.run(command, env=settings, capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in ended.stdout.splitlines()]
    rows = {name: cells for name, *cells in lines}
    for name in ("bayes_aero", "scipy least_squares, trf", "scipy least_squares, lm"):
        assert float(rows[name][2]) < 1e-2, (name, rows[name])  # nats above the best
    assert float(rows["scipy least_squares, lm"][3]) < 0.6 * float(rows["bayes_aero"][3])  # it loads no JAX


@pytest.mark.parametrize("kind", list(INNER))
def test_the_inner_holdout_is_a_part_of_the_training_part(kind):
    m = 300
    flights = SimpleNamespace(
        inputs=np.zeros((m, 4)), states=np.zeros((m, 4)), measured=np.zeros((m, 3)),
        manoeuvre=np.repeat([0, 1], [180, 120]), state=SimpleNamespace(responses=SimpleNamespace(seconds=0.2)),
    )  # fmt: skip
    found = problems(flights, kind)
    held_out = sum((~p.train).astype(int) for p in found)
    assert held_out.max() == 1
    for p in found:
        assert not np.any(p.inner & ~p.train)
        assert 0.2 < p.inner.sum() / p.train.sum() < 0.4
        if kind == "manoeuvre":
            assert len(np.unique(p.manoeuvre[p.train])) == 1


@pytest.mark.parametrize(("side", "alternative"), [
    (Side.AT_MOST, "greater"), (Side.AT_LEAST, "less"), (Side.EQUAL, "two-sided"),
])  # fmt: skip
def test_limits_are_those_of_clopper_and_pearson(side, alternative):
    for hits, of in ((0, 1), (1, 1), (0, 16), (3, 16), (5, 16), (16, 16), (7, 40), (191, 200), (200, 200)):
        exact = binomtest(hits, of, alternative=alternative).proportion_ci(LEVEL, method="exact")
        assert Claim("named", "", side, 0.95).limits(hits, of) == pytest.approx((exact.low, exact.high), abs=1e-12)


@pytest.mark.parametrize(("side", "alternative"), [(Side.AT_MOST, "greater"), (Side.AT_LEAST, "less")])
@pytest.mark.parametrize("rate", [0.05, 0.95])
def test_a_claim_is_refuted_exactly_where_the_binomial_test_rejects_its_rate(side, alternative, rate):
    claim, verdicts = Claim("", "", side, rate), set()
    for of in (1, 16, 60, 200):
        for hits in range(of + 1):
            rejected = binomtest(hits, of, rate, alternative=alternative).pvalue < 1.0 - LEVEL
            assert claim.holds(hits, of) is not rejected, (hits, of)
            verdicts.add(rejected)
    assert verdicts == {True, False}


def test_no_trials_refute_nothing_and_the_documentation_lists_every_claim_with_its_rate():
    assert all(claim.limits(0, 0) == (0.0, 1.0) and claim.holds(0, 0) for claim in CLAIMS)
    assert len({claim.key for claim in CLAIMS}) == len(CLAIMS)
    text = (PEERS.parent / "README.md").read_text(encoding="utf-8")
    table = {row[0]: row[-1].rstrip(" |") for row in (line.split(" | ") for line in text.splitlines()) if len(row) == 3}
    for claim in CLAIMS:
        assert table[f"| `{claim.key}`"] == f"{claim.side} {claim.rate:g}"


def silent(kind, seed, posterior):
    """A flight that bears out the one claim that it tries."""
    trials = {"silence": {"false_alarms": False}, "one": {"named": True, "size_held": True}}
    return {"kind": kind, "seed": seed, "trials": trials.get(kind, {}), "sampled": posterior}


def test_a_run_flies_every_kind_and_is_entered(tmp_path):
    run, rows = Run("abc", 3, False, 77), []
    with ThreadPoolExecutor(2) as pool:
        assert fly(run, tmp_path, silent, pool, 2, 0.0, []) == []  # no flight is begun after the time
        fly(run, tmp_path, silent, pool, 2, 60.0, rows)
    assert len((tmp_path / "flights.jsonl").read_text().splitlines()) == len(rows)
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


def test_a_false_claim_and_a_crash_are_in_the_verdict():
    """6 alarms of 20 have a chance of 0.03 % at a rate of 5 %."""
    run = Run("abc", 20, False, 0)
    rows = [{"kind": "silence", "seed": k, "trials": {"false_alarms": k < 6}} for k in range(20)]
    rows.append({"kind": "one", "seed": 3, "trials": {}, "refused": "too large"})
    assert count(rows)["false_alarms"] == (6, 20)
    line = line_of(run, rows)
    assert (line["verdict"], line["refused"], line["flights"]) == ("refuted: false_alarms", "1", "21")
    rows.append({"kind": "one", "seed": 4, "trials": {}, "crashed": "ValueError"})
    assert line_of(run, rows)["verdict"] == "refuted: false_alarms, 1 crashed"


def test_what_was_hidden_is_counted_by_its_name_its_size_and_its_rivals(capsys):
    def row(causes, rivals=(), verdict="explained"):
        found = {name: {"x": [mean, 0.1]} for name, mean in causes.items()}
        hidden = {"wing_asymmetry": {"x": 1.0}}
        return {"hidden": hidden, "causes": found, "ambiguous": dict.fromkeys(causes, rivals), "verdict": verdict}

    right, second = row({"wing_asymmetry": 1.1}), row({"roll_offset": 1.0, "wing_asymmetry": 1.3})
    rival, none = row({"roll_offset": 1.0}, ["wing_asymmetry"]), row({}, verdict="no_effect")
    rows = (right, second, rival, none)
    assert [studies.alone(r) for r in rows] == [True, False, False, False]
    assert [studies.named_first(r) for r in rows] == [True, False, False, False]
    assert [studies.named(r, "wing_asymmetry") for r in rows] == [True, True, True, False]
    assert [studies.held(r) for r in rows] == [True, False, None, None]
    assert [studies.quiet(r) for r in rows] == [False, False, False, True]
    studies.print_sizes(rows)
    assert capsys.readouterr().out == "its 95 % interval holds the size 1 of 2\n"


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
        studies.resumed(path, cases, one_length=True)
    assert run == [1, 2, 4]
    rows = studies.resumed(path, cases, one_length=True)
    assert [row["seed"] for row in rows] == [1, 2, 4]
    assert run == [1, 2, 4, 4]  # the first two once
    assert "3: it leaves the envelope" in capsys.readouterr().err
    assert len(path.read_text().splitlines()) == 3


def test_stated_probabilities_order_what_happens():
    """Of the tests of two aircraft those that are stated to pass do, and those that are stated to fail do not."""
    rows = [row for seed in (0, 1) for row in aircraft(seed, 3)]
    assert len(rows) == 2 * 3 * 3 * len(OUTPUTS)
    stated, passed = (np.array([row[i] for row in rows]) for i in (1, 2))
    assert passed[stated > 0.99].mean() > 0.9
    assert passed[stated < 0.01].mean() < 0.1
    assert np.corrcoef(stated, passed)[0, 1] > 0.8
