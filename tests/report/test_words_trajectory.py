"""Sentences on simulations, against errors made by hand."""

from dataclasses import replace

from bayes_aero.report.words_trajectory import simulation_gain


def test_the_gain_is_that_of_unseen_flights(simulated):
    """Both halves are 1 deg off with the card's model and 0.1 deg with the extended one."""
    assert "α from 1.0 to 0.10 deg" in simulation_gain(simulated)


def test_without_unseen_flights_or_without_a_gain_nothing_is_said(simulated):
    fitted = tuple(p for p in simulated.paths if p.split == "fitted")
    same = tuple(replace(p, errors=simulated.paths[0].errors) for p in simulated.paths)
    for paths in (fitted, same):
        shown = object.__new__(type(simulated))
        for name in ("outputs", "card", "extended", "held"):
            object.__setattr__(shown, name, getattr(simulated, name))
        object.__setattr__(shown, "paths", paths)
        assert simulation_gain(shown) == ""
