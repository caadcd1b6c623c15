"""One table of numbers: the same columns on a terminal, on a page, in a file and in JSON."""

from __future__ import annotations

import io
import math

import numpy as np
import pandas as pd
import pytest
from flown_samples import flight
from rich.console import Console

from bayes_aero.diagnosis.trajectories.results import GustHistory, ProcessNoise
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.tables.filtered import gust_table
from bayes_aero.report.tables.fly import error_table
from bayes_aero.report.tables.table import Change, Column, Estimate, Table, cell_text, columns_of, write_csv
from bayes_aero.report.text.phrases import number, plus_minus, size_text


def printed(table: Table, width: int = 80) -> str:
    text = io.StringIO()
    Console(file=text, width=width).print(table.terminal())
    return text.getvalue()


@pytest.fixture(scope="module")
def table() -> Table:
    """Two parameters, one without an estimate; a page has the parts of the change, a terminal both in one."""
    ends = ("estimate", "sd", "low")
    return Table(
        [
            Column(["a", "b"], "name", "parameter", ""),
            Column([Estimate(-0.39102, 0.0159, -0.42, -0.36), None], ends, "fit", "fit"),
            Column(
                [Change(0.25, 0.5), Change(None, 1.0 / 3.0)], "", ("before", "after"), "change", ".0%", group="share"
            ),
            Column([2, 3], "count"),
            Column(["only here", ""], page="remark", words=True),
        ],
        "A title",
        "A note",
        terminal_title="Another",
    )


def test_a_page_has_the_headings_that_are_for_it(table):
    shown = page_table(table)
    assert shown.head == ("parameter", "fit", "before", "after", "remark")
    assert shown.groups == (("", 2), ("share", 2), ("", 1))
    assert shown.rows == (("a", "-0.391 ± 0.016", "25%", "50%", "only here"), ("b", "–", "–", "33%", ""))
    assert (shown.caption, shown.note, shown.words) == ("A title", "A note", (4,))


def test_a_terminal_is_narrower(table):
    lines = printed(table).splitlines()
    assert lines[0].strip() == "Another"
    assert lines[1].split() == ["fit", "change"]
    assert [line.split() for line in lines[3:]] == [["a", "-0.391(16)", "25%", "→", "50%"], ["b", "–", "–", "→", "33%"]]


def test_a_file_and_json_have_every_digit(table, tmp_path):
    assert table.records()[0] == {"name": "a", "estimate": -0.39102, "sd": 0.0159, "low": -0.42, "count": 2}
    assert table.records()[1]["sd"] is None
    back = pd.read_csv(write_csv(table, tmp_path / "t.csv"), index_col="name")
    assert list(back.columns) == ["estimate", "sd", "low", "count"]
    assert back.loc["a", "estimate"] == -0.39102
    assert np.isnan(back.loc["b", "estimate"])
    assert list(back["count"]) == [2, 3]


def test_several_values_share_a_cell_and_have_a_row_each_in_a_file():
    of = columns_of([("x", [1.0, 2.0]), ("y", [3.0])])
    both = Table([of(lambda r: r[0], "name", "name", "name"), of(lambda r: r[1], "size", "size", "size", ".1f")])
    assert both.frame().reset_index().to_numpy().tolist() == [["x", 1.0], ["x", 2.0], ["y", 3.0]]
    assert [row[1] for row in page_table(both).rows] == ["1.0; 2.0", "3.0"]
    assert [line.split() for line in printed(both).splitlines()[-3:]] == [["x", "1.0"], ["2.0"], ["y", "3.0"]]


def test_rows_stand_below_a_name_only_where_there_are_several():
    rows = [Column([1.0, 2.0, 3.0], page="x", form=".0f"), Column([4.0, 5.0, 6.0], page="y", form=".0f")]
    below = page_table(Table(rows, below=["one", "one", "two"])).rows
    assert below == (("one", ""), ("1", "4"), ("2", "5"), ("two", ""), ("3", "6"))
    assert page_table(Table(rows, below=["one"] * 3)).rows == (("1", "4"), ("2", "5"), ("3", "6"))


@pytest.mark.parametrize("value", [None, math.nan, math.inf, Estimate(math.nan, 1.0)])
@pytest.mark.parametrize("form", ["", ".3f", 3, lambda x: f"{x:.3f}"])
def test_what_is_no_number_is_a_dash(value, form):
    assert cell_text(value, form) == "–"


def test_a_narrow_terminal_folds_changes_and_loses_no_digit():
    head = [f"output {k} [m/s]" for k in range(6)]
    columns = [Column([Change(12.25 + k, 0.125)], "", None, name, ".3f") for k, name in enumerate(head)]
    text = printed(Table([Column(["flight"], "name", None, "manoeuvre"), *columns]))
    assert "…" not in text
    assert all(f"{12.25 + k:.3f}" in text for k in range(6))
    assert text.count("0.125") == 6
    assert max(map(len, text.splitlines())) <= 80


def test_words_keep_room_on_a_terminal_of_80_columns():
    """A long name, unit and range beside them do not press them to two letters a line."""
    shown = printed(
        Table([
            Column(["calibrated_airspeed", "density"], terminal="channel"),
            Column(["'Calibrated airspeed, boom, corrected [kt]'", "'rho'"], terminal="taken from", words=True),
            Column(["lbf/ft^2 → kg/m^3", "slug/ft^3 → kg/m^3"], terminal="unit → inside"),
            Column(["-0.0015791 to -0.0016104", "0.0015791 to 0.0016104"], terminal="range in the file"),
            Column(["sign reversed, does not move", ""], terminal="", words=True),
        ])
    )  # fmt: skip
    assert max(map(len, shown.splitlines())) <= 80
    for word in ("calibrated_airspeed", "corrected", "reversed,", "slug/ft^3", "-0.0016104"):
        assert word in shown


def test_a_terminal_shows_the_units_of_outputs():
    """Units in square brackets are no markup."""
    text = printed(error_table(flight().flown), 100)
    assert all(label in text for label in ("α [deg]", "q [deg/s]", "az [m/s²]"))


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (-0.39102, 0.0159, "-0.391 ± 0.016"),
        (23.716, 1.5, "23.7 ± 1.5"),
        (1.5, np.nan, "1.5"),
        (1.5, 0.0, "1.5"),
        (-0.03, 5.7, "0.0 ± 5.7"),
        (12345.6, 0.0, "12346"),
    ],
)
def test_numbers_with_standard_errors(value, sd, text):
    assert plus_minus(value, sd) == text
    assert size_text(value, sd, "1") == text


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (999.7, 3, "1000"),
        (999.4, 3, "999"),
        (99.97, 3, "100"),
        (-1234.6, 3, "-1235"),
        (0.00012346, 3, "0.000123"),
        (9.9996e-5, 3, "0.0001"),
        (2.5e-7, 2, "2.5e-07"),
        (4.2e7, 3, "4.20e+07"),
        (-0.0, 3, "0"),
    ],
)
def test_numbers_have_no_exponent_where_people_read_them(value, digits, text):
    assert number(value, digits) == text


@pytest.mark.parametrize(("form", "text"), [(".1f", "0.0"), ("+.1f", "+0.0"), (".0%", "0%"), (3, "-0.03")])
def test_what_is_rounded_to_zero_has_no_minus(form, text):
    assert cell_text(-0.0300 if form != ".0%" else -0.0003, form) == text


def test_gusts_of_all_manoeuvres_stand_in_one_file(tmp_path):
    times = {"one": np.array([0.0, 0.5]), "two": np.array([0.0, 0.25, 0.5])}
    met = [GustHistory(m, t, {"vertical_gust": (2.0 * t, 0.1 + t)}) for m, t in times.items()]
    found = ProcessNoise("converged", True, 1.0, {}, {}, {}, {}, histories=tuple(met))
    back = pd.read_csv(write_csv(gust_table(found), tmp_path / "gusts.csv"))
    assert list(back.columns) == ["manoeuvre", "time", "vertical_gust", "vertical_gust_sd"]
    assert list(back["manoeuvre"]) == ["one"] * 2 + ["two"] * 3
    assert back["vertical_gust"].tolist() == [0.0, 1.0, 0.0, 0.5, 1.0]
    assert back["vertical_gust_sd"].tolist() == [0.1, 0.6, 0.1, 0.35, 0.6]


@pytest.mark.parametrize("markup", [True, False])
def test_units_in_brackets_are_shown_whatever_a_console_takes_for_markup(markup):
    shown = io.StringIO()
    table = Table([Column([1.0], terminal="V [m/s]"), Column([2.0], terminal="α [deg]")], "errors [SI]")
    Console(file=shown, markup=markup, width=80).print(table.terminal())
    assert "V [m/s]" in shown.getvalue()
    assert "errors [SI]" in shown.getvalue()
    assert "\\" not in shown.getvalue()
