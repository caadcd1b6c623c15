"""What is left of a stage that has not moved yet: what it took the last time, and nothing that was not seen."""

from __future__ import annotations

import json

import pytest
from rich.progress import Progress

from bayes_aero.cli.durations import FILE, MOST, TYPICAL, Durations, TimeLeft


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_a_stage_is_expected_to_take_what_it_took(tmp_path, clock):
    first = Durations(tmp_path, clock)
    first.stage("compiling")
    assert first.left() is None
    clock.now += 25.0
    first.stage("emcee")
    clock.now += 4.0
    first.stage("emcee: 500 steps")  # the same stage goes on
    clock.now += 6.0
    first.stage("report")
    clock.now += 0.5
    first.keep()
    assert json.loads((tmp_path / FILE).read_text()) == {
        "compiling": 25.0,
        "emcee": 10.0,
    }  # a short one is not worth it

    again = Durations(tmp_path, clock)
    again.stage("compiling")
    assert again.left() == 25.0
    clock.now += 20.0
    assert again.left() == 5.0
    clock.now += 20.0
    assert again.left() == 0.0
    again.stage("something new")
    assert again.left() is None
    again.stage("mle")  # of a first run: what is typical, until one's own is known
    assert again.left() == TYPICAL["mle"]


def test_what_was_broken_off_is_not_remembered(tmp_path, clock):
    broken = Durations(tmp_path, clock)
    broken.stage("compiling")
    clock.now += 25.0
    assert not (tmp_path / FILE).exists()
    assert Durations(tmp_path, clock).left() is None


@pytest.mark.parametrize("text", ["", "[1, 2]", '{"compiling": "long"}', "\x00"])
def test_a_file_of_others_costs_nothing(tmp_path, clock, text):
    (tmp_path / FILE).write_text(text)
    durations = Durations(tmp_path, clock)
    durations.stage("compiling")
    assert durations.left() is None
    clock.now += 3.0
    durations.keep()
    assert json.loads((tmp_path / FILE).read_text()) == {"compiling": 3.0}


def test_only_the_latest_stages_are_remembered(tmp_path, clock):
    durations = Durations(tmp_path, clock)
    for number in range(2 * MOST):
        durations.stage(f"unit {number}")
        clock.now += 3.0
    durations.keep()
    assert [*json.loads((tmp_path / FILE).read_text())] == [f"unit {n}" for n in range(MOST, 2 * MOST)]


def test_a_folder_that_cannot_be_made_costs_nothing(tmp_path, clock):
    (tmp_path / "file").write_text("")
    Durations(tmp_path / "file" / "below", clock).keep()


def test_the_column_prefers_the_stages_own_speed(tmp_path, clock):
    (tmp_path / FILE).write_text('{"compiling": 61.2}')
    durations = Durations(tmp_path, clock)
    column = TimeLeft(durations)
    progress = Progress(get_time=clock)
    progress.add_task("compiling", total=1.0)
    (task,) = progress.tasks
    assert str(column.render(task)) == "-:--:--"
    durations.stage("compiling")
    assert str(column.render(task)) == "0:01:02"
    for share in (0.1, 0.2):
        clock.now += 1.0
        progress.update(task.id, completed=share)
        durations.stage("compiling")
    assert str(column.render(task)) == "0:00:08"  # a tenth a second
    clock.now += 3.0
    assert str(column.render(task)) == "0:00:05"
    clock.now += 15.0  # its speed was no speed: it takes as long as the last time
    assert str(column.render(task)) == "0:00:42"
    clock.now += 80.0  # and longer than that: a fifth took 100 s
    assert str(column.render(task)) == "0:06:40"
    progress.update(task.id, completed=1.0)
    assert str(column.render(task)) == "0:00:00"
