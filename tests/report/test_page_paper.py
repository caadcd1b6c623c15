"""What paper makes of a page: how broad a table is, how high a panel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_aero.report.html.page import Table
from bayes_aero.report.html.plots import Line, Panel, linked


def test_a_table_is_as_broad_as_its_longest_lines():
    row = ("name", "1.234\n1.2 to 1.3", "a text that is longer than the column in which it is folded")
    table = Table("t", ("a", "b", "c"), (row, row), words=(2,))
    assert table.across == 4 + 10 + 25 + 3 * 2
    assert not table.broad
    assert not table.slim  # beside another one its text would be folded
    short = replace(table, words=(), rows=(row[:2],) * 20, head=("a", "b"))
    assert short.slim
    assert not replace(short, rows=short.rows * 2).slim  # two lines a row: more than a sheet has
    assert replace(short, rows=(row[:2] * 10,), head=("a", "b") * 10).broad
    assert not Table("t", ("a",), ()).broad


def test_panels_are_lower_on_paper_but_not_than_their_labels():
    def on_paper(labels):
        lines = (Line("a", "#000000", np.arange(9.0)),)
        item = linked(np.arange(9.0), [Panel(label, lines) for label in labels], "x")
        figures = [one for one in _nested(item) if one.get("name") == "Figure"]
        return [(f["attributes"]["height"], f["attributes"]["tags"][0]) for f in figures]

    assert on_paper(["q [deg/s]"]) == [(194, 194)]
    many = on_paper(["q [deg/s]"] * 8)
    assert all(low < high for high, low in many)
    assert sum(low for _, low in many) <= 690
    named = on_paper(["q [deg/s]"] * 7 + ["a_very_long_name"])
    assert named[-1][1] - 44 >= 7.5 * len("a_very_long_name")


def _nested(part):
    """Every dictionary in a JSON document."""
    if isinstance(part, dict):
        yield part
    for inner in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        yield from _nested(inner)
