"""Tables: the columns and, worked out by hand, the numbers."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from bayes_aero.diagnosis.settings import DEFAULT
from bayes_aero.diagnosis.view.results import Compared, HoldoutScores
from bayes_aero.effects import CATALOGUE
from bayes_aero.inference.likelihood.mle_result import MleStatus
from bayes_aero.inference.scores import Scores
from bayes_aero.model.noise import Colour
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.tables.comparison import ordered, scatter
from bayes_aero.report.tables.models import holdout_table
from bayes_aero.report.tables.run_tables import parameter_table, validation_table
from bayes_aero.report.tables.table import write_csv
from bayes_aero.report.text.phrases import concise


def test_parameters_come_in_the_canonical_order_and_others_behind():
    known = [p for effect in CATALOGUE.values() for p in effect.parameters]
    assert ordered(["zeta", "Cma", "CD0", "tau1", "e"], known) == ["CD0", "e", "Cma", "tau1", "zeta"]
    canonical = "CD0 e CDX CL0 CLa CLaM Cm0 Cma Cmq Cmde CmX a1 alpha_star tau1 tau2"
    assert " ".join(ordered([p.name for p in known], known)[:15]) == canonical


def test_a_parameter_of_the_users_effect_comes_where_it_says():
    own = Parameter("k", "1", 0.0, 0.0, "drag of the pod", Prior("normal", 0.0, 1.0), place=13)
    known = [*CATALOGUE["induced_drag"].parameters, *CATALOGUE["attached_lift"].parameters, own]
    assert ordered(["sigma", "CLa", "k", "e"], known) == ["e", "k", "CLa", "sigma"]


@pytest.mark.parametrize("loses", [-1.5, -2.0])
def test_manoeuvres_are_compared_one_by_one_and_a_loss_beyond_chance_is_said(loses):
    gains = {(m, c): Compared(2.0, 1.0, 0.1, 0.05) for m in ("a", "b") for c in ("CL", "CD", "Cm")}
    gains["b", "CD"] = Compared(loses, 1.0, -0.012, 0.015)
    one = {c: Scores(0.9, 0.1, 0.1, 0.8) for c in ("CL", "CD", "Cm")}
    scores = {(model, "hold_out", k): one for model in ("card", "extended") for k in range(2)}
    table = page_table(holdout_table(HoldoutScores(("a", "b"), scores, gains, DEFAULT.hold_out)))
    assert [row[:2] for row in table.rows] == [(m, c) for m in ("a", "b") for c in ("CL", "CD", "Cm")]
    assert table.rows[4][2:] == ("0.800", "0.800", "-0.012 ± 0.015", f"{loses:+.1f} ± 1.0")
    assert ("significantly (one-sided, 5 %) for CD of b." in table.note) == (loses < -1.645)


def test_parameter_table(full):
    table = parameter_table(full).frame()
    assert list(table.index) == ["CD0", "CL0", "CLa", "Cm0", "Cma", "Cmde"]
    row = table.loc["Cma"]
    assert row["unit"] == "1/rad"
    expected = {
        "estimate": -0.5,
        "crb": 0.01,
        "crb_corrected": 0.04,
        "white_mean": -0.5,
        "white_sd": 0.01,
        "emcee_mean": -0.2,  # 30 bounds of 0.01 above
        "emcee_sd": 0.02,
        "emcee_ci95_low": -0.2 - 1.96 * 0.02,
        "emcee_ci95_high": -0.2 + 1.96 * 0.02,
        "nuts_mean": -0.2,
        "nuts_sd": 0.02,
        "flight1_estimate": -0.5,
        "flight2_crb": 0.01,
        "between_manoeuvres_sd": 0.0,
    }
    for column, value in expected.items():
        assert row[column] == pytest.approx(value, abs=1e-12), column


def test_scatter_between_manoeuvres_by_hand(full):
    row = parameter_table(full).frame().loc["Cmde"]
    assert row["flight1_estimate"] == pytest.approx(-0.8)
    assert row["flight2_estimate"] == pytest.approx(-1.4)  # 60 bounds of 0.01 below
    assert row["between_manoeuvres_sd"] == pytest.approx(0.6 / np.sqrt(2.0))
    assert row["largest_difference_in_crb"] == pytest.approx(60.0 / np.sqrt(2.0))


def test_a_stage_that_has_not_run_has_no_columns(make):
    table = parameter_table(make(manoeuvres=1, engines=(), gp=False)).frame()
    assert list(table.columns) == ["unit", "estimate", "crb", "crb_corrected"]
    assert len(parameter_table(make(engines=("emcee",), gp=False)).frame().filter(like="nuts").columns) == 0


def test_where_white_noise_is_chosen_its_posterior_fills_both_places(make):
    row = parameter_table(make(noise=Colour.WHITE, engines=("emcee", "nuts"), width=1.1)).frame().loc["CL0"]
    assert row["white_sd"] == row["emcee_sd"] == pytest.approx(0.011)


def test_validation_table(full, make):
    table = validation_table(full).frame()
    folds = {"random": {"all"}, "block": {"all"}, "manoeuvre": {"1", "2", "all"}}
    for split, names in folds.items():
        assert set(table.loc[split].index.get_level_values("fold")) == names
    row = table.loc[("random", "all", "CD")]
    v = full.gp.splits["random"][0]["CD"]
    assert row["points"] == len(v.test)
    assert row["gpr_rmse"] == pytest.approx(np.sqrt(np.mean((v.measured - v.gp) ** 2)))
    assert row["mle_r"] == pytest.approx(np.corrcoef(v.measured, v.mle)[0, 1])
    assert tuple(row[["gpr_coverage50", "gpr_coverage90", "gpr_coverage95", "gpr_k_hat"]]) == (0.52, 0.88, 0.94, 0.4)
    both = table.loc[("manoeuvre", "all", "CL")]
    parts = [fold["CL"] for fold in full.gp.splits["manoeuvre"]]
    errors = np.concatenate([p.measured - p.gp for p in parts])
    assert both["points"] == full.observations.n
    assert both["gpr_rmse"] == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert validation_table(make(gp=False)).frame().empty


def test_csv_comes_back_and_is_written_whole_or_not_at_all(full, tmp_path, monkeypatch):
    path = write_csv(parameter_table(full), tmp_path / "parameters.csv")
    back = pd.read_csv(path, index_col="parameter")
    pd.testing.assert_frame_equal(back, parameter_table(full).frame(), check_dtype=False, rtol=1e-15)
    before = path.read_bytes()

    def fails(*_, **__):
        raise OSError("disk full")

    monkeypatch.setattr(pd.DataFrame, "to_csv", fails)
    with pytest.raises(OSError, match="disk full"):
        write_csv(parameter_table(full), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("count", [1, 2, 5])
def test_the_terminal_table_fits_80_columns(count, make):
    text = io.StringIO()
    Console(file=text, width=80).print(parameter_table(make(manoeuvres=count, corrected=4.0)).terminal())
    lines = text.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    row = next(line for line in lines if line.startswith("Cma"))
    assert "-0.500(10)" in row
    assert "0.04" in row
    assert ("flight2" in text.getvalue()) == (count == 2)


def test_a_simulated_run_shows_what_was_flown(make):
    run = replace(make(corrected=4.0), truth={"Cma": -0.512})
    text = io.StringIO()
    Console(file=text, width=80).print(parameter_table(run).terminal())
    row = next(line for line in text.getvalue().splitlines() if line.startswith("Cma"))
    assert "-0.512 -0.500(10)" in row
    assert max(map(len, text.getvalue().splitlines())) <= 80
    table = parameter_table(run).frame()
    assert table.loc["Cma", "flown"] == -0.512
    assert np.isnan(table.loc["CLa", "flown"])
    assert "flown" not in parameter_table(make()).frame()


def test_a_manoeuvre_that_identifies_nothing_alone_shows_no_numbers(make):
    run = make()
    run.alone["flight2"] = replace(run.alone["flight2"], status=MleStatus.STALL_NOT_IDENTIFIED)
    text = io.StringIO()
    Console(file=text, width=80).print(parameter_table(run).terminal())
    assert text.getvalue().count("-0.500(10)") == 3  # maximum likelihood, emcee, flight1
    assert scatter(run, "Cma") is None
    assert np.isnan(parameter_table(run).frame().loc["Cma", "between_manoeuvres_sd"])


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [(-0.39102, 0.0159, "-0.391(16)"), (23.716, 1.5, "23.7(15)"), (120.4, 35.0, "120(35)"), (1.5, np.nan, "1.5")],
)
def test_concise_numbers(value, sd, text):
    assert concise(value, sd) == text
