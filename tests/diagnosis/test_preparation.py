"""What smoothing one side only does to estimates: against the truth of an aircraft of another simulator."""

import numpy as np
import pytest
from stranger_records import flown

from bayes_aero.diagnosis.consistency.filter_mismatch import filter_mismatch_notes
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.jobs.identify import identify
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, observe
from bayes_aero.report.text.identification import verdict

MOMENT = ("Cmde", "Cma", "CmX")


@pytest.fixture(scope="module")
def stranger(tmp_path_factory):
    """Truth, records, card, model and maximum likelihood of an aircraft whose doublets are fast."""
    folder = tmp_path_factory.mktemp("stranger")
    truth, _, files = flown(folder, np.random.default_rng([7, 31]), None)
    card = read_card(str(folder / "card.toml"))
    records, model = [read_record(path, card.channels) for path in files], Model.from_card(card)
    return truth, records, card, model, fit_mle(model, observe(records, card, model, Forming.PUBLISHED))


def test_filtered_alike_the_moment_is_that_of_the_truth(stranger):
    truth, records, card, model, mle = stranger
    alike = fit_mle(model, observe(records, card, model)).estimate
    for name in MOMENT:
        i, true = mle.names.index(name), getattr(truth, name)
        assert abs(alike[i] - true) < 0.5 * abs(mle.estimate[i] - true), name
        assert alike[i] == pytest.approx(true, rel=0.01), name


def test_the_note_names_what_moves(stranger):
    _, *given = stranger
    (note,) = filter_mismatch_notes(*given)
    assert "Cmde would be" in note
    assert "CD0" not in note


def test_no_word_where_slow_stalls_were_flown(attas_paths, card, model):
    records = [read_record(path, card.channels) for path in attas_paths]
    published = fit_mle(model, observe(records, card, model, Forming.PUBLISHED))
    assert filter_mismatch_notes(records, card, model, published) == ()


def test_identify_says_it_first(stranger):
    _, records, card, *_ = stranger
    first, *_ = verdict(identify(records, card, IdentifyOptions(coefficients="published", sample=False, gp=False)))
    assert "Cmde would be" in first
    assert not any(
        "would be" in said for said in verdict(identify(records, card, IdentifyOptions(sample=False, gp=False)))
    )
