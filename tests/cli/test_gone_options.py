"""Options that are gone end with one sentence that says what to use instead."""

from __future__ import annotations

import pytest

from bayes_aero.cli import gone_options

SPELLED = [(command, given, instead) for command, option, instead in gone_options.GONE for given in option.split("/")]


@pytest.mark.parametrize(("command", "option", "instead"), SPELLED)
@pytest.mark.parametrize("value", ["", "=x"])
def test_an_option_that_is_gone_says_what_to_use(program, command, option, instead, value):
    done = program(command, "no_such_file", option + value)
    assert (done.code, done.out) == (2, "")
    assert done.err == f"error: {option} of {command} is gone: {instead}\n"


@pytest.mark.parametrize(("command", "option"), [row[:2] for row in SPELLED])
def test_no_command_has_an_option_that_is_gone(program, command, option):
    assert option not in program(command, "--help").out.split()


def test_other_commands_and_names_of_files_are_left_alone(program, monkeypatch):
    monkeypatch.setattr(gone_options, "GONE", (("check", "--old/--no-old", "leave it out"),))
    assert "--no-old of check is gone: leave it out" in program("check", "a.csv", "--no-old").err
    assert "gone" not in program("path", "a.csv", "--no-old").err
    assert "gone" not in program("check", "--", "--no-old").err
