"""A job that runs beside others."""

from __future__ import annotations

from threading import Event, get_ident

import pytest

from bayes_aero.jobs.steps.background import in_background

LONG = 20.0  # s: a test that waits so long has failed


def test_both_run_at_once():
    """Each waits for the other: one after the other they would never end."""
    here, there = Event(), Event()

    def job(_):
        there.set()
        assert here.wait(LONG)
        return get_ident()

    with in_background(job) as running:
        assert there.wait(LONG)
        here.set()
        assert running.result() != get_ident()


def test_it_is_shown_where_it_is_only_while_it_is_waited_for():
    shown, told = [], Event()

    def job(tell):
        tell("beside", 0.1)
        told.set()
        while not shown:
            tell("waited for", 0.9)

    with in_background(job, lambda *row: shown.append(row)) as running:
        assert told.wait(LONG)
        assert shown == []
        running.result()
    assert shown == [("waited for", 0.9)]


def test_a_block_that_fails_ends_it():
    ends, begun = [], Event()

    def job(tell):
        begun.set()
        try:
            while True:
                tell("on", 0.5)
        finally:
            ends.append("stopped")

    def interrupted():
        with in_background(job):
            assert begun.wait(LONG)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert ends == ["stopped"]


def test_its_failure_is_that_of_who_waits():
    def job(_):
        raise ValueError("no such luck")

    with pytest.raises(ValueError, match="no such luck"), in_background(job) as running:
        running.result()
