"""A wing that stalls first, hidden in stalls in bank of a simulator that shares no code: found, alone, and its size."""

from __future__ import annotations

import pytest
import wing_first

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import Verdict
from bayes_aero.jobs.steps.post_diagnosis import proposed_points

RECORDS = ("rudder", "stall_in_bank")


@pytest.mark.verify
def test_a_wing_that_stalls_first_is_found_alone_and_sized():
    """No aileron offset, centre of gravity aside, uneven engines or vane: those are candidates of the same record."""
    plane, records, size = wing_first.flown(0)
    chosen = [record for record in records if record.name in RECORDS]
    found = diagnose(chosen, wing_first.card_of(plane), gains_wanted=False, process_noise=False)
    said = wing_first.told(found, 0.0)
    assert list(said["causes"]) == ["wing_asymmetry"]
    assert said["ambiguous"] == {"wing_asymmetry": []}
    assert said["unexplained"] == []
    ((mean, sd),) = said["causes"]["wing_asymmetry"].values()
    assert abs(mean - size) < 1.96 * sd
    assert sd < 0.01 * abs(size)
    rivals = {*wing_first.CAUSES, *wing_first.NAMED.values()} - {"wing_asymmetry", *wing_first.NAMED}
    assert rivals <= {e.name for e in found.aerodynamics.state.full.candidates}


@pytest.mark.verify
def test_uneven_engines_are_told_from_their_rivals_by_the_manoeuvres_that_are_proposed():
    """The rudder that holds them is at rest while ailerons move: its derivative, free on the card, takes them up."""
    plane, records, size = wing_first.flown(3)
    first, then = ([r for r in records if r.name in names] for names in (("aileron",), ("aileron", "stall_in_bank")))
    found = diagnose(first, wing_first.card_of(plane), gains_wanted=False, process_noise=False)
    assert found.verdict is Verdict.UNDECIDED
    assert found.causes == ()
    (taken_up,) = found.absorbed
    assert taken_up.parameter == "Cndr"
    absorbed = taken_up.sizes["thrust_asymmetry"]
    assert abs(absorbed.mean - size) < absorbed.sd
    proposed = proposed_points(found)
    (question,) = proposed["questions"]
    assert {"rudder_yaw", "thrust_asymmetry", "yaw_offset"} <= set(question["effects"])
    assert proposed["points"][-1]["standard_errors"][0] >= question["enough"]
    found = diagnose(then, wing_first.card_of(plane), gains_wanted=False, process_noise=False)
    assert found.verdict is Verdict.EXPLAINED
    assert found.absorbed == ()
    said = wing_first.told(found, 0.0)
    assert list(said["causes"]) == ["thrust_asymmetry"]
    assert said["ambiguous"] == {"thrust_asymmetry": []}
    ((mean, sd),) = said["causes"]["thrust_asymmetry"].values()
    assert abs(mean - size) < 1.96 * sd
    assert sd < 0.1 * abs(size)


def test_the_table_counts_what_was_named(capsys):
    def row(hidden, causes, ambiguous=(), unexplained=(), size=1.0):
        told = {name: {"x": [mean, 0.1]} for name, mean in causes.items()}
        among = {name: list(ambiguous) for name in causes}
        return {
            "seed": 0, "hidden": hidden, "size": size, "causes": told, "ambiguous": among,
            "unexplained": list(unexplained), "manoeuvres": [],
        }  # fmt: skip

    wing_first.report(
        [
            row("wing_asymmetry", {"wing_asymmetry": 1.1}),
            row("wing_asymmetry", {"roll_offset": 1.0, "wing_asymmetry": 1.3}),
            row("wing_asymmetry", {"roll_offset": 1.0}, ["wing_asymmetry"]),
            row("aileron_offset", {"roll_offset": 0.9}, ["lateral_cg_shift"]),
            row(None, {}),
            row(None, {}, unexplained=[["Cl", "p"]]),
        ]
    )
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["wing_asymmetry", "3", "1", "1", "1", "1", "of", "2"]
    assert lines[2].split() == ["aileron_offset", "1", "1", "0", "1", "1", "of", "1"]
    assert lines[6] == "nothing hidden: silent 1 of 2"
