"""What is said of parameters that drift: changed or not, when, by how much; and where nothing can be said."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bayes_aero.diagnosis.trajectories.drift import Drift, DriftChange, Drifted
from bayes_aero.report.text.drift import drift_sentences

MOVED = DriftChange((-0.0121, 0.0018), (-0.0125, 0.0017), 58.0, (33.0, 35.1, 55.1))
BACK = DriftChange((0.0002, 0.002), (0.011, 0.0015), 31.0, (1.0, 2.0, 3.0))
STILL = DriftChange((0.0, 0.0), (0.0, 0.0), 0.0, (0.0, 0.0, 0.0))


def drift(p, *changes, ratio=30.0, together=1e-6, **more):
    """One parameter with these changes, in manoeuvres one, two, ..."""
    named = dict(zip(("one", "two"), changes, strict=False))
    found = Drift(True, ratio, together, {"Cm0": Drifted("1", (0.001, 0.3), ratio, p, named)}, {}, {"alpha": 0.02}, ())
    return replace(found, parameters=found.parameters | more)


def test_a_change_is_told_with_its_size_and_times():
    said = drift_sentences(drift(1e-6, MOVED))
    assert said[0] == (
        "Cm0 changed during the record (p = 1e-06) by -0.0121 ± 0.0018 from start to end, half of it by 35.1 s "
        "(a tenth by 33.0 s, nine tenths by 55.1 s)."
    )
    assert "white innovations" in said[1]
    assert "Holm" not in said[1]


def test_a_parameter_that_came_back_is_told_where_it_was_farthest():
    (said, _) = drift_sentences(drift(1e-20, BACK))
    assert said == "Cm0 changed during the record (p < 1e-12) by 0.0110 ± 0.0015 at 31.0 s, and back."


def test_of_several_manoeuvres_those_are_named_in_which_it_changed():
    (said, _) = drift_sentences(drift(0.001, MOVED, STILL))
    assert said.startswith("Cm0 changed during the records (p = 0.001): in one by -0.0121 ± 0.0018 from start to end")
    assert "two" not in said


@pytest.mark.parametrize(("p", "changed"), [(0.049, ("Cm0",)), (0.05, ())])
def test_the_level_is_five_per_cent(p, changed):
    found = drift(p, MOVED)
    assert found.changed == changed
    assert drift_sentences(found)[0].startswith("Cm0 changed" if changed else "No change of Cm0 during the record")


def test_where_either_may_have_changed_it_is_one_of_them():
    other = Drifted("1/rad", (0.1, 0.5), 2.0, 0.2, {"one": MOVED})
    said = drift_sentences(drift(0.2, MOVED, Cma=other))
    assert said[:2] == [
        f"No change of {name} during the record is distinguishable from noise (p = 0.2)." for name in ("Cm0", "Cma")
    ]
    assert said[2].startswith("One of Cm0 and Cma changed (p = 1e-06 for all together)")
    assert "2 parameters together (Holm)" in said[3]


def test_coloured_innovations_leave_nothing_to_be_said():
    found = replace(drift(1e-20, MOVED), autocorrelation={"alpha": 0.86, "q": 0.1})
    assert found.changed == ()
    (said,) = drift_sentences(found)
    assert said.startswith("Whether Cm0 changed cannot be said")
    assert "alpha (0.86)" in said
    assert "-0.0121" not in said


def test_a_fit_that_did_not_converge_says_so():
    (said,) = drift_sentences(replace(drift(1e-20, MOVED), usable=False))
    assert "did not converge" in said
