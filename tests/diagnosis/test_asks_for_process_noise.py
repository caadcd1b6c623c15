"""Process noise is estimated where a record is in gusts, unless the user decides."""

from __future__ import annotations

import pytest
from gusty_flight import gusty_flight

from bayes_aero.diagnosis import diagnose as diagnosis
from bayes_aero.flight.card.card import read_card
from bayes_aero.jobs import fly as job

OUTPUTS = "airspeed,alpha,theta,q,ax,az"
CALM, GUSTY = {"w": 0.0, "u": 0.0}, {"w": 1.0, "u": 1.0}
DECISIONS = [(GUSTY, None, True), (CALM, None, False), (GUSTY, False, False), (CALM, True, True)]


@pytest.fixture(scope="module")
def card():
    return read_card("hfb320")


class SearchedError(Exception):
    """Ends the diagnosis where its search begins."""


@pytest.mark.parametrize(("gust", "given", "expected"), DECISIONS)
def test_a_diagnosis_compares_with_innovations_in_gusts(card, monkeypatch, gust, given, expected):
    def begun(name):
        def search(*_, **__):
            raise SearchedError(name)

        return search

    for name in ("search_innovations", "search_coefficients", "search_trajectories"):
        monkeypatch.setattr(diagnosis, name, begun(name))
    with pytest.raises(SearchedError) as found:
        diagnosis.diagnose([gusty_flight(4, gust=gust, seconds=20.0)], card, process_noise=given)
    assert (str(found.value) == "search_innovations") is expected


@pytest.mark.parametrize(("gust", "given", "expected"), DECISIONS)
def test_a_fit_to_trajectories_has_process_noise_in_gusts(card, monkeypatch, gust, given, expected):
    filtered = []

    def instead(_, options, *__):
        filtered.append(options.filtered)
        return (None, None), ()

    monkeypatch.setattr(job, "process_noise", instead)
    found = job.fly([gusty_flight(4, gust=gust, seconds=20.0)], card, process_noise=given, outputs=OUTPUTS)
    assert filtered == [expected]
    asked = expected and given is None
    assert found.sentences[0].startswith("The flight path alone, without aerodynamics, shows gusts") is asked
