"""The next flight in a table, sentences, JSON and a figure: numbers worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import bayes_aero as ba
from bayes_aero.inference.posterior.pooled.next_flight_result import NextFlight
from bayes_aero.inference.posterior.posterior import Marginal, PosteriorStatus
from bayes_aero.jobs.io.identification_json import results
from bayes_aero.report.figures.comparison import next_flight
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.pooled.next_flight import next_flight_sentences, next_flight_table
from bayes_aero.report.style import NotDrawn


def marginal(mean, sd):
    return Marginal(mean, sd, (mean - 2.0 * sd, mean + 2.0 * sd), 900.0, 800.0, 1.001)


@pytest.fixture
def pooled(full):
    """Two manoeuvres; the second says nothing of Cmde. The joint fit has corrected standard errors of 0.01 or more."""
    names = full.mle.names
    both = ("flight1", "flight2")
    own = {"flight1": dict.fromkeys(names, (1.0, 0.1)), "flight2": {n: (1.2, 0.2) for n in names if n != "Cmde"}}
    found = NextFlight(
        parameters=full.mle.parameters,
        manoeuvres=both,
        alone=own,
        pooled={m: dict.fromkeys(names, marginal(1.1, 0.05)) for m in both},
        aircraft=dict.fromkeys(names, marginal(1.15, 0.1)),
        scatter=dict.fromkeys(names, marginal(0.3, 0.1)),
        following=dict.fromkeys(names, marginal(1.15, 0.4)),
        narrowed={n: 0.9 if n in ("CLa", "Cmde") else 0.3 for n in names},
        undetermined={"Cmde": ("flight2",)},
        left_out={"flight3": "stopped"},
        tree=xr.DataTree(),
        status=PosteriorStatus.CONVERGED,
        seconds=1.0,
    )
    found.tree.attrs["likelihood"] = "normal approximation"
    return replace(full, next_flight=found)


def test_a_file_has_all_and_a_page_what_it_has_room_for(pooled):
    table = next_flight_table(pooled)
    row = table.frame().loc["Cmde"]
    assert row["flight1_alone"] == 1.0
    assert np.isnan(row["flight2_alone"])
    assert (row["flight2_pooled"], row["flight2_pooled_sd"]) == (1.1, 0.05)
    assert (row["next_flight_ci95_low"], row["next_flight_ci95_high"]) == pytest.approx((0.35, 1.95))
    assert (row["scatter"], row["scatter_over_prior"]) == (0.3, 0.9)
    assert row["joint"] == pooled.mle.estimate[pooled.mle.names.index("Cmde")]
    page = page_table(table)
    (cells,) = [r for r in page.rows if r[0].startswith("Cmde")]
    assert cells[2:] == (
        "1.00 ± 0.10",
        "1.100 ± 0.050",
        "–",
        "1.100 ± 0.050",
        "1.15 ± 0.10",
        "0.1 to 0.5",
        "0.35 to 1.95",
        "0.90",
    )


def test_it_is_said_how_little_two_manoeuvres_show(pooled):
    """0.45 and 32: square roots of one over chi-square of one degree of freedom at 97.5 and 2.5 %."""
    said = " ".join(next_flight_sentences(pooled))
    assert "normal approximation" in said
    assert "from 0.45 to 32 times the standard deviation" in said
    assert "The scatter of CLa and Cmde is mostly its prior" in said
    assert "flight2 does not determine Cmde; its scatter is the prior's." in said
    assert "flight3 is left out of the next flight: stopped." in said
    assert "NUTS" not in said


def test_a_sampler_that_has_not_converged_is_said(pooled):
    failed = replace(pooled, next_flight=replace(pooled.next_flight, status=PosteriorStatus.DIVERGENT))
    assert PosteriorStatus.DIVERGENT.value in next_flight_sentences(failed)[-1]


def test_the_figure_has_a_line_for_each_fit(pooled, full):
    figure = next_flight(pooled)
    labels = [tick.get_text() for tick in figure.axes[0].get_yticklabels()]
    assert labels[0] == "joint fit"
    assert labels[1:] == [
        "flight1 alone",
        "flight1 pooled",
        "flight2 alone",
        "flight2 pooled",
        "aircraft",
        "next flight",
    ]
    with pytest.raises(NotDrawn):
        next_flight(full)


def test_json_and_python_have_the_same_numbers(pooled, full):
    found = results(pooled, [], {})["next_flight"]
    assert found["likelihood"] == "normal approximation"
    one = found["parameters"]["Cmde"]
    assert one["undetermined"] == ["flight2"]
    assert set(one["alone"]) == {"flight1"}
    row = ba.Fit(pooled).next_flight().loc["Cmde"]
    assert list(one["next_flight"]["ci95"]) == [row["next_flight_ci95_low"], row["next_flight_ci95_high"]]
    with pytest.raises(ba.InputError, match="not pooled yet"):
        ba.Fit(full).next_flight()
