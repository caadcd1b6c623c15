"""What depends on a record's name is not compiled: a study of many records compiles once for each length."""

import jax
import pytest

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.flight.record import FlightRecord


def renamed(record, name):
    channels = {key: record.channels[key] for key in record.channels}
    return FlightRecord.from_arrays(name, record.time, channels, record.source)


@pytest.fixture
def traced():
    """Names of the functions that are traced from here on."""
    seen = []

    def listen(event, _, **told):
        if event == "/jax/core/compile/jaxpr_trace_duration":
            seen.append(told.get("fun_name", "?"))

    jax.monitoring.register_event_duration_secs_listener(listen)
    return seen


def test_records_of_other_names_run_the_compiled_programs(traced, diagnosed, card):
    """After one diagnosis, the same flight under another name compiles nothing.

    The fixture's diagnosis does not count: tests between it and this one may have made the process forget its programs.
    """
    (record,) = diagnosed.records
    settings = DiagnosisSettings(max_effects=2)
    diagnose([record], card, settings=settings)
    traced.clear()
    again = diagnose([renamed(record, "the same flight")], card, settings=settings)
    assert [c.name for c in again.causes] == [c.name for c in diagnosed.view.diagnosis.causes]
    assert not set(traced) & {"_linearise", "_residuals"}, traced
    jax.jit(lambda x: x + 1.0)(1.0)
    assert "<lambda>" in traced, "tracing was not listened to"
