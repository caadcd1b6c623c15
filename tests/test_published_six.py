"""Six coefficients of ATTAS as published (TC23, TC24 of Jategaonkar 2015), from the shipped card full_six.

The published regressors keep the bias of the gyros, which here is taken out of all that follows: offsets differ by
derivative times bias, and are compared with this put back.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_aero.diagnosis import candidate_set
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.dynamics.output_channels import OF_AXIS
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.health import channel_health
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, observe
from bayes_aero.model.recorded_axes import on_recorded_axes

BOOK = Path(__file__).resolve().parents[2] / "shared" / "book"
FILES = ("fAttasElv1.mat", "fAttasAil1.mat", "fAttasRud1.mat")
OURS = {"CDal": "CDa", "CLal": "CLa", "Cmal": "Cma"}
RATES = {"Cm0": {"Cmq": "pitch_rate_bias"}}
RATES |= {f"{c}0": {f"{c}p": "roll_rate_bias", f"{c}r": "yaw_rate_bias"} for c in ("Cl", "Cn")}


@pytest.fixture(scope="module")
def card():
    return read_card("full_six")


@pytest.fixture(scope="module")
def records(card):
    if not BOOK.is_dir():
        pytest.skip(f"the flights of the book are not in {BOOK}")
    return [read_record(BOOK / name, card.channels) for name in FILES]


def published(case: str) -> dict:
    return json.loads((BOOK / "references.json").read_text(encoding="utf-8"))["cases"][case]["methods"][
        "oem_gauss_newton"
    ]


@pytest.mark.parametrize(
    ("case", "drag"), [("TC23", ("profile_drag", "alpha_drag")), ("TC24", ("profile_drag", "induced_drag"))]
)
def test_published_estimates_come_back(card, records, case, drag):
    """Estimates within a tenth of the published deviations, deviations within 3 %, det R within 1 %."""
    effects = [e for e in card.effects if e not in ("profile_drag", "alpha_drag")]
    own = replace(card, effects=(*drag, *effects))
    model = Model.from_card(own)
    found, reference = fit_mle(model, observe(records, own, model, Forming.PUBLISHED), extra_starts=0), published(case)
    estimate = dict(zip(found.names, found.estimate, strict=True))
    sd = dict(zip(found.names, found.crb, strict=True))
    assert set(estimate) == {OURS.get(name, name) for name in reference["parameters"]}
    V = np.mean(np.concatenate([record["airspeed"] for record in records]))
    lengths = {"Cm": card.aircraft.chord, "Cl": 10.75, "Cn": 10.75}
    for name, row in reference["parameters"].items():
        ours = OURS.get(name, name)
        back = sum(
            estimate[derivative] * card.fixed[bias] * lengths[name[:2]] / V
            for derivative, bias in RATES.get(name, {}).items()
        )
        assert estimate[ours] - back == pytest.approx(row["estimate"], abs=0.1 * row["std"]), name
        assert sd[ours] == pytest.approx(row["std"], rel=0.03), name
    assert found.det_R == pytest.approx(reference["det_R"], rel=0.01)


def test_each_manoeuvre_is_fitted_alone_in_six_coefficients(card, records):
    model = Model.from_card(card)
    observations = observe(records, card, model, Forming.PUBLISHED)
    alone = fit_mle(model, observations.only(1), extra_starts=0)
    assert tuple(alone.fit) == observations.thinned().coefficients == ("CL", "CD", "Cm", "CY", "Cl", "Cn")
    estimate = dict(zip(alone.names, alone.estimate, strict=True))
    assert estimate["Clda"] == pytest.approx(published("TC23")["parameters"]["Clda"]["estimate"], rel=0.03)


def test_the_lateral_axis_alone_gives_the_published_derivatives(records):
    """Within two standard errors that count the colour; the model has three derivatives more."""
    lateral = read_card("basic_lateral")
    model = Model.from_card(lateral)
    found = fit_mle(model, observe(records[1:], lateral, model), extra_starts=0)
    assert tuple(found.fit) == ("CY", "Cl", "Cn")
    estimate, error = (dict(zip(found.names, x, strict=True)) for x in (found.estimate, found.crb_corrected))
    for name in ("CYbe", "Clp", "Clr", "Clda", "Cnbe", "Cnr", "Cndr"):
        value = published("TC23")["parameters"][name]["estimate"]
        assert estimate[name] == pytest.approx(value, abs=2.0 * error[name]), name


def test_a_missing_channel_leaves_its_axis_out_and_says_so(card, records, monkeypatch):
    channels = {name: x for name, x in records[1].channels.items() if name != "ay"}
    fewer = [records[0], replace(records[1], channels=channels), records[2]]
    own, said = on_recorded_axes(card, fewer)
    assert own.axes == ("longitudinal",)
    assert said == (
        "The lateral axis (CY, Cl, Cn) is left out: record fAttasAil1 has no channel ay; map it on the card to include "
        "it.",
    )
    assert Model.from_card(own).coefficients == ("CL", "CD", "Cm")
    monkeypatch.setattr(candidate_set, "CATALOGUE", {})  # what a diagnosis finds is not asked here
    assert diagnose(fewer[:2], card, gains_wanted=False, process_noise=False).notes[0] == said[0]


def test_a_flight_needs_no_accelerometer_of_an_axis_but_its_motion(card, records):
    def without(name):
        channels = {key: x for key, x in records[1].channels.items() if key != name}
        return replace(records[1], channels=channels)

    plain = replace(card, effects=tuple(e for e in card.effects if e != "accel_y_bias"))
    assert on_recorded_axes(plain, [without("ay")], OF_AXIS) == (plain, ())
    own, (said,) = on_recorded_axes(plain, [without("beta")], OF_AXIS)
    assert own.axes == ("longitudinal",)
    assert "has no channel beta" in said


def test_swapped_ailerons_are_told_by_the_roll_that_they_make(card, records):
    right, left = (records[1][name] for name in ("aileron_right", "aileron_left"))
    swapped = replace(records[1], channels={**records[1].channels, "aileron_right": left, "aileron_left": right})
    assert not [f for f in channel_health(records, card) if f.fault == "sign"]
    (finding,) = [f for f in channel_health([swapped], card) if f.fault == "sign"]
    assert finding.channel == "aileron"
    assert "rolls to the right" in finding.sentence
    assert "aileron_right and aileron_left are swapped" in finding.sentence
    rudder = replace(records[2], channels={**records[2].channels, "rudder": -records[2]["rudder"]})
    (finding,) = [f for f in channel_health([rudder], card) if f.fault == "sign"]
    assert finding.channel == "rudder"
