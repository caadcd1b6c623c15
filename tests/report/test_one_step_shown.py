"""What is said and drawn of one-step predictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from bayes_aero.diagnosis.trajectories.results import ProcessNoise
from bayes_aero.inference.scores import Calibration, OneStep, Predicted, Share
from bayes_aero.report.figures.pit import one_step_quantiles
from bayes_aero.report.html.page_table import page_table
from bayes_aero.report.style import NotDrawn
from bayes_aero.report.tables.filtered import one_step_table
from bayes_aero.report.text.process_noise import prediction_sentences

SHARES = (
    Share(0.5, 0.48, 0.04, 0.6),
    Share(0.9, 0.91, 0.02, 0.5),
    Share(0.95, 0.93, 0.02, 0.3),
    Share(0.99, 0.985, 0.004, 0.2),
)
LINE = np.array([[-1.0, -1.1, -1.4, -0.7], [0.0, 0.1, -0.2, 0.2], [1.0, 2.0, 0.7, 1.4]])


def predictions(**calibration: Calibration) -> OneStep:
    """Of alpha (0.2 deg) and q, each with these shares."""
    one = Predicted(500, np.deg2rad(0.2), (1.02, 0.03), SHARES, Calibration.CALIBRATED, LINE)
    outputs = {n: replace(one, calibration=calibration.get(n, one.calibration)) for n in ("alpha", "q")}
    together = calibration.get("together", one.calibration)
    return OneStep(outputs, replace(one, count=1000, rms=None, calibration=together))


def of(found: OneStep | None) -> ProcessNoise:
    return ProcessNoise("converged", True, 1.0, {}, {}, {}, {}, one_step=found)


def test_shares_are_told_with_their_errors():
    first, _ = prediction_sentences(predictions())
    assert first == (
        "One-step predictions: share of the samples inside their 95 % intervals: α 93 % (± 2) and q 93 % (± 2)."
    )
    few = predictions()
    sharp = replace(SHARES[2], share=0.9512, sd=0.0031)
    found = replace(few, outputs={"q": replace(few.outputs["q"], shares=(*SHARES[:2], sharp, SHARES[3]))})
    assert prediction_sentences(found)[0] == (
        "One-step predictions: share of the samples inside their 95 % intervals: q 95.1 % (± 0.3)."
    )


@pytest.mark.parametrize(
    ("calibration", "status", "said"),
    [
        ({}, "calibrated", "They are calibrated: no share departs"),
        ({"q": Calibration.UNDECIDED}, "undecided", "Whether they are calibrated is not decided"),
        (
            {"q": Calibration.TOO_NARROW, "together": Calibration.TOO_NARROW},
            "not_calibrated",
            "They are not calibrated: intervals of q and all outputs together are too narrow.",
        ),
        (
            {"alpha": Calibration.NOT_NORMAL, "q": Calibration.COLOURED},
            "not_calibrated",
            "They are not calibrated: innovations of α are not normally distributed; innovations of q are "
            "autocorrelated.",
        ),
        (
            {"alpha": Calibration.UNDECIDED, "q": Calibration.TOO_WIDE},
            "not_calibrated",
            "They are not calibrated: intervals of q are too wide.",
        ),
    ],
)
def test_there_is_one_status(calibration, status, said):
    found = predictions(**calibration)
    assert found.status == status
    assert prediction_sentences(found)[1].startswith(said)


def test_the_table_has_units_and_per_cent():
    table = one_step_table(predictions(q=Calibration.TOO_WIDE), {"alpha": "rad", "q": "rad/s"})
    head, *_ = rows = page_table(table).rows
    assert head == ("α [deg]", "0.20", "1.020(30)", "48(4)", "91(2)", "93(2)", "98.5(4)", "calibrated")
    assert [row[0] for row in rows] == ["α [deg]", "q [deg/s]", "all together"]
    assert rows[1][-1] == "too wide"
    assert rows[2][1] == "–"
    console = Console(width=80)
    with console.capture() as captured:
        console.print(table.terminal())
    assert "…" not in captured.get()


def test_every_output_has_a_panel_with_its_status():
    figure = one_step_quantiles(of(predictions(alpha=Calibration.TOO_NARROW)))
    assert [ax.get_title() for ax in figure.axes] == ["α: too narrow", "q: calibrated", "all together: calibrated"]
    for ax in figure.axes:
        line = next(line for line in ax.lines if line.get_label() == "innovations")
        np.testing.assert_array_equal(line.get_xydata(), LINE[:, :2])
    alone = predictions()
    single = one_step_quantiles(of(replace(alone, outputs={"q": alone.outputs["q"]})))
    assert [ax.get_title() for ax in single.axes] == ["q: calibrated"]


def test_without_a_fit_nothing_is_drawn():
    with pytest.raises(NotDrawn, match="did not converge"):
        one_step_quantiles(of(None))
