"""Tables of numbers: the same columns on a terminal, on a page, in a file and in JSON; numbers worked out by hand."""

import io
import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calling import holds
from rich.console import Console

import bayes_aero as ba
from bayes_aero.diagnosis.result import Compared, GustHistory, HoldoutScores, ProcessNoise
from bayes_aero.diagnosis.selection_state import DEFAULT
from bayes_aero.inference.results import Marginal, MleStatus, NextFlight, PosteriorStatus, Scores
from bayes_aero.jobs.results import results
from bayes_aero.jobs.store import as_json
from bayes_aero.model.observations import Colour
from bayes_aero.report.pages.diagnosis import holdout_table
from bayes_aero.report.pages.estimates import next_flight_sentences, scatter
from bayes_aero.report.pages.identification import next_flight_table, parameter_table, validation_table
from bayes_aero.report.pages.trajectories import gust_table
from bayes_aero.report.phrases import plus_minus, size_text
from bayes_aero.report.table import BeforeAfter, Column, Estimate, Table, cell_text, columns_of, write_csv
from bayes_aero.units import number


def printed(table: Table, width: int = 80, **options) -> str:
    text = io.StringIO()
    Console(file=text, width=width, **options).print(table.text().terminal())
    return text.getvalue()


def test_people_a_file_and_json_have_what_is_for_them(tmp_path):
    """Two parameters, one without an estimate; people see the parts of the change."""
    ends, changes = ("estimate", "sd", "low"), [BeforeAfter(0.25, 0.5), BeforeAfter(None, 1.0 / 3.0)]
    two_rows = Table(
        [
            Column(["a", "b"], "name", "parameter"),
            Column([Estimate(-0.39102, 0.0159, -0.42, -0.36), None], ends, "fit"),
            Column(changes, "", ("before", "after"), form=".0%", group="share"),
            Column([2, 3], "count"),
            Column(["only here", ""], page="remark", words=True),
        ],
        "A title", "A note",
    )  # fmt: skip
    shown = two_rows.text()
    assert shown.head == ("parameter", "fit", "before", "after", "remark")
    assert shown.groups == (("", 2), ("share", 2), ("", 1))
    assert shown.rows == (("a", "-0.391 ± 0.016", "25%", "50%", "only here"), ("b", "–", "–", "33%", "–"))
    assert (shown.caption, shown.note, shown.words) == ("A title", "A note", (4,))
    above, heads, _, *lines = [line.split() for line in printed(two_rows).splitlines()]
    assert (above, heads) == (["share"] * 2, ["parameter", "fit", "before", "after", "remark"])
    assert lines == [["a", "-0.391", "±", "0.016", "25%", "50%", "only", "here"], ["b", "–", "–", "33%", "–"]]
    assert two_rows.records()[0] == {"name": "a", "estimate": -0.39102, "sd": 0.0159, "low": -0.42, "count": 2}
    assert two_rows.records()[1]["sd"] is None
    back = pd.read_csv(write_csv(two_rows, tmp_path / "t.csv"), index_col="name")
    assert list(back.columns) == ["estimate", "sd", "low", "count"]
    assert back["estimate"].fillna(0.0).tolist() == [-0.39102, 0.0]
    assert list(back["count"]) == [2, 3]


def test_several_values_share_a_cell_and_rows_stand_below_a_name():
    of = columns_of([("x", [1.0, 2.0]), ("y", [3.0])])
    both = Table([of(lambda r: r[0], "name", "name"), of(lambda r: r[1], "size", "size", form=".1f")])
    assert both.frame().reset_index().to_numpy().tolist() == [["x", 1.0], ["x", 2.0], ["y", 3.0]]
    assert [row[1] for row in both.text().rows] == ["1.0; 2.0", "3.0"]
    assert [line.split() for line in printed(both).splitlines()[-2:]] == [["x", "1.0;", "2.0"], ["y", "3.0"]]
    rows = [Column([1.0, 2.0, 3.0], page="x", form=".0f"), Column([4.0, 5.0, 6.0], page="y", form=".0f")]
    below = Table(rows, below=["one", "one", "two"]).text().rows
    assert below == (("one", ""), ("1", "4"), ("2", "5"), ("two", ""), ("3", "6"))
    assert Table(rows, below=["one"] * 3).text().rows == (("1", "4"), ("2", "5"), ("3", "6"))


@pytest.mark.parametrize("value", [None, math.nan, math.inf, Estimate(math.nan, 1.0)])
@pytest.mark.parametrize("form", ["", ".3f", 3, lambda x: f"{x:.3f}"])
def test_what_is_no_number_is_a_dash(value, form):
    assert cell_text(value, form) == "–"


def test_a_narrow_terminal_folds_words_and_no_number():
    columns = [Column([12.25 + k], page=f"output {k}\n[m/s]", form=".3f") for k in range(6)]
    text = printed(Table([Column(["flight"], page="manoeuvre"), *columns, Column(["few words " * 9], page="remark")]))
    assert "…" not in text
    assert all(f"{12.25 + k:.3f}" in text for k in range(6))
    assert (text.count("few"), text.count("words")) == (9, 9)
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(
    ("value", "sd", "text", "unit", "sized"),
    [
        (-0.39102, 0.0159, "-0.391 ± 0.016", "rad", "-22.40 ± 0.91 deg"),
        (23.716, 1.5, "23.7 ± 1.5", "m/s", "23.7 ± 1.5 m/s"), (1.5, np.nan, "1.5", "s", "1.5 s"),
        (120.4, 35.0, "120 ± 35", "1", "120 ± 35"), (1.5, 0.0, "1.5", "1", "1.5"),
        (-0.03, 5.7, "0.0 ± 5.7", "1", "0.0 ± 5.7"), (12345.6, 0.0, "12346", "1", "12346"),
    ],
)  # fmt: skip
def test_numbers_with_standard_errors(value, sd, text, unit, sized):
    assert (plus_minus(value, sd), size_text(value, sd, unit)) == (text, sized)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (999.7, 3, "1000"), (999.4, 3, "999"), (99.97, 3, "100"), (-1234.6, 3, "-1235"), (0.00012346, 3, "0.000123"),
        (9.9996e-5, 3, "0.0001"), (2.5e-7, 2, "2.5e-07"), (4.2e7, 3, "4.20e+07"), (-0.0, 3, "0"),
    ],
)  # fmt: skip
def test_numbers_have_no_exponent_where_people_read_them(value, digits, text):
    assert number(value, digits) == text


@pytest.mark.parametrize(("form", "text"), [(".1f", "0.0"), ("+.1f", "+0.0"), (".0%", "0%"), (3, "-0.03")])
def test_what_is_rounded_to_zero_has_no_minus(form, text):
    assert cell_text(-0.0300 if form != ".0%" else -0.0003, form) == text


def test_gusts_of_all_manoeuvres_stand_in_one_file(tmp_path):
    times = {"one": np.array([0.0, 0.5]), "two": np.array([0.0, 0.25, 0.5])}
    histories = tuple(GustHistory(m, t, {"vertical_gust": (2.0 * t, 0.1 + t)}) for m, t in times.items())
    noise = ProcessNoise("converged", True, 1.0, {}, {}, {}, {}, histories=histories)
    back = pd.read_csv(write_csv(gust_table(noise), tmp_path / "gusts.csv"))
    assert list(back.columns) == ["manoeuvre", "time", "vertical_gust", "vertical_gust_sd"]
    assert list(back["manoeuvre"]) == ["one"] * 2 + ["two"] * 3
    assert back["vertical_gust"].tolist() == [0.0, 1.0, 0.0, 0.5, 1.0]
    assert back["vertical_gust_sd"].tolist() == [0.1, 0.6, 0.1, 0.35, 0.6]


@pytest.mark.parametrize("markup", [True, False])
def test_units_in_brackets_are_shown_whatever_a_console_takes_for_markup(markup):
    shown = printed(Table([Column([1.0], page="V [m/s]"), Column([2.0], page="α [deg]")]), markup=markup)
    holds(shown, "V [m/s]", "α [deg]")
    assert "\\" not in shown


@pytest.mark.parametrize("loses", [-1.5, -2.0])
def test_manoeuvres_are_compared_one_by_one_and_a_loss_beyond_chance_is_said(loses):
    gains = {(m, c): Compared(2.0, 1.0, 0.1, 0.05) for m in ("a", "b") for c in ("CL", "CD", "Cm")}
    gains["b", "CD"] = Compared(loses, 1.0, -0.012, 0.015)
    same = {c: Scores(0.9, 0.1, 0.1, 0.8) for c in ("CL", "CD", "Cm")}
    scores = {(model, "hold_out", k): same for model in ("card", "extended") for k in range(2)}
    table = holdout_table(HoldoutScores(("a", "b"), scores, gains, DEFAULT.hold_out)).text()
    assert [row[:2] for row in table.rows] == [(m, c) for m in ("a", "b") for c in ("CL", "CD", "Cm")]
    assert table.rows[4][2:] == ("0.800", "0.800", "-0.012 ± 0.015", f"{loses:+.1f} ± 1.0")
    assert ("significantly (one-sided, 5 %) for CD of b." in table.note) == (loses < -1.645)


def test_the_parameter_table_and_the_scatter_between_manoeuvres_by_hand(full, tmp_path):
    table = parameter_table(full).frame()
    assert list(table.index) == ["CD0", "CL0", "CLa", "Cm0", "Cma", "Cmde"]
    row = table.loc["Cma"]
    assert row["unit"] == "1/rad"
    expected = {  # posteriors are 30 bounds of 0.01 above
        "estimate": -0.5, "crb": 0.01, "crb_corrected": 0.04, "white_mean": -0.5, "white_sd": 0.01, "emcee_mean": -0.2,
        "emcee_sd": 0.02, "emcee_ci95_low": -0.2 - 1.96 * 0.02, "emcee_ci95_high": -0.2 + 1.96 * 0.02,
        "nuts_mean": -0.2, "nuts_sd": 0.02, "flight1_estimate": -0.5, "flight2_crb": 0.01, "between_manoeuvres_sd": 0.0,
    }  # fmt: skip
    for column, value in expected.items():
        assert row[column] == pytest.approx(value, abs=1e-12), column
    columns = ["flight1_estimate", "flight2_estimate", "between_manoeuvres_sd", "largest_difference_in_crb"]
    expected = [-0.8, -1.4, 0.6 / np.sqrt(2.0), 60.0 / np.sqrt(2.0)]  # 60 bounds of 0.01 below
    assert table.loc["Cmde", columns].tolist() == pytest.approx(expected)
    back = pd.read_csv(write_csv(parameter_table(full), tmp_path / "parameters.csv"), index_col="parameter")
    pd.testing.assert_frame_equal(back, parameter_table(full).frame(), check_dtype=False, rtol=1e-15)


def test_a_stage_that_has_not_run_has_no_columns_and_chosen_white_noise_fills_both_places(make):
    table = parameter_table(make(manoeuvres=1, engines=(), gp=False)).frame()
    assert list(table.columns) == ["unit", "estimate", "crb", "crb_corrected"]
    assert len(parameter_table(make(engines=("emcee",), gp=False)).frame().filter(like="nuts").columns) == 0
    row = parameter_table(make(noise=Colour.WHITE, engines=("emcee", "nuts"), width=1.1)).frame().loc["CL0"]
    assert row["white_sd"] == row["emcee_sd"] == pytest.approx(0.011)


def test_validation_table(full, make):
    table = validation_table(full).frame()
    folds = {"random": {"all"}, "block": {"all"}, "manoeuvre": {"1", "2", "all"}}
    for split, names in folds.items():
        assert set(table.loc[split].index.get_level_values("fold")) == names
    row = table.loc[("random", "all", "CD")]
    v = full.gp.splits["random"][0]["CD"]
    assert row["mle_r"] == pytest.approx(np.corrcoef(v.measured, v.mle)[0, 1])
    assert tuple(row[["gpr_coverage50", "gpr_coverage90", "gpr_coverage95", "gpr_k_hat"]]) == (0.52, 0.88, 0.94, 0.4)
    both = table.loc[("manoeuvre", "all", "CL")]
    parts = [fold["CL"] for fold in full.gp.splits["manoeuvre"]]
    errors = np.concatenate([p.measured - p.gp for p in parts])
    assert both["points"] == full.observations.n
    assert both["gpr_rmse"] == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert validation_table(make(gp=False)).frame().empty


def test_a_simulated_run_shows_what_was_flown(make):
    run = replace(make(corrected=4.0), truth={"Cma": -0.512})
    (row,) = [row for row in parameter_table(run).text().rows if row[0].startswith("Cma")]
    assert row[1:4] == ("-0.512", "-0.500 ± 0.010", "-0.500 ± 0.040")
    table = parameter_table(run).frame()
    assert table.loc["Cma", "flown"] == -0.512
    assert np.isnan(table.loc["CLa", "flown"])
    assert "flown" not in parameter_table(make()).frame()


def test_a_manoeuvre_that_identifies_nothing_alone_does_not_count_in_the_scatter(make):
    run = make()
    run.alone["flight2"] = replace(run.alone["flight2"], status=MleStatus.STALL_NOT_IDENTIFIED)
    assert scatter(run, "Cma") is None
    assert np.isnan(parameter_table(run).frame().loc["Cma", "between_manoeuvres_sd"])


def marginal(mean, sd):
    return Marginal(mean, sd, (mean - 2.0 * sd, mean + 2.0 * sd), 900.0, 800.0, 1.001)


@pytest.fixture
def pooled(full):
    """Two manoeuvres; the second says nothing of Cmde. The joint fit has corrected standard errors of 0.01 or more."""
    names = full.mle.names
    both = ("flight1", "flight2")
    alone = {"flight1": dict.fromkeys(names, (1.0, 0.1)), "flight2": {n: (1.2, 0.2) for n in names if n != "Cmde"}}
    each = {"aircraft": (1.15, 0.1), "scatter": (0.3, 0.1), "following": (1.15, 0.4)}
    pooled = NextFlight(
        parameters=full.mle.parameters, manoeuvres=both, alone=alone,
        pooled={m: dict.fromkeys(names, marginal(1.1, 0.05)) for m in both},
        **{what: dict.fromkeys(names, marginal(*size)) for what, size in each.items()},
        narrowed={n: 0.9 if n in ("CLa", "Cmde") else 0.3 for n in names}, undetermined={"Cmde": ("flight2",)},
        left_out={"flight3": "stopped"}, tree=xr.DataTree(), status=PosteriorStatus.CONVERGED, seconds=1.0,
    )  # fmt: skip
    pooled.tree.attrs["likelihood"] = "normal approximation"
    return replace(full, next_flight=pooled)


def test_a_file_has_all_and_a_page_what_it_has_room_for(pooled):
    table = next_flight_table(pooled)
    row = table.frame().loc["Cmde"]
    assert row["flight1_alone"] == 1.0
    assert np.isnan(row["flight2_alone"])
    assert (row["flight2_pooled"], row["flight2_pooled_sd"]) == (1.1, 0.05)
    assert (row["next_flight_ci95_low"], row["next_flight_ci95_high"]) == pytest.approx((0.35, 1.95))
    assert (row["scatter"], row["scatter_over_prior"]) == (0.3, 0.9)
    assert row["joint"] == pooled.mle.estimate[pooled.mle.names.index("Cmde")]
    page = table.text()
    (cells,) = [r for r in page.rows if r[0].startswith("Cmde")]
    pooled_again = "1.100 ± 0.050"
    assert cells[2:5] == ("1.00 ± 0.10", pooled_again, "–")
    assert cells[5:] == (pooled_again, "1.15 ± 0.10", "0.1 to 0.5", "0.35 to 1.95", "0.90")


def test_it_is_said_how_little_two_manoeuvres_show_and_what_has_not_converged(pooled):
    """0.45 and 32: square roots of one over chi-square of one degree of freedom at 97.5 and 2.5 %."""
    text = " ".join(next_flight_sentences(pooled))
    holds(text, "0.45 to 32", "CLa and Cmde", "flight2 does not determine Cmde", "flight3", "stopped")
    assert "NUTS" not in text
    failed = replace(pooled, next_flight=replace(pooled.next_flight, status=PosteriorStatus.DIVERGENT))
    assert PosteriorStatus.DIVERGENT.value in next_flight_sentences(failed)[-1]


def test_json_and_python_have_the_same_numbers(pooled, full):
    document = json.loads(as_json(results(pooled, [], {})))["next_flight"]
    assert document["likelihood"] == "normal approximation"
    written = document["parameters"]["Cmde"]
    assert (written["undetermined"], set(written["alone"])) == (["flight2"], {"flight1"})
    row = ba.Fit(pooled).next_flight().loc["Cmde"]
    assert written["next_flight"]["ci95"] == [row["next_flight_ci95_low"], row["next_flight_ci95_high"]]
    with pytest.raises(ba.InputError, match="not pooled yet"):
        ba.Fit(full).next_flight()
