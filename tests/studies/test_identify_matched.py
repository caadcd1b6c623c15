"""Both sides treated alike: the truth of simulated stalls comes back at any sampling rate."""

import numpy as np
import pytest

from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.jobs.identify import identify
from bayes_aero.jobs.options import IdentifyOptions
from bayes_aero.model.observations import Forming, observe
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.request import Request
from bayes_aero.simulate.synthetic_record import synthetic
from bayes_aero.study.study import read_study


@pytest.fixture(scope="module")
def stalls(card):
    """The same two stalls' recipes at 25 and 100 Hz."""
    return {
        dt: [
            synthetic(Request({}, noise="white", seed=seed, dt=dt), card, CATALOGUE, f"s{seed}_{dt}").record
            for seed in (810, 811)
        ]
        for dt in (0.04, 0.01)
    }


@pytest.mark.parametrize("rates", [(0.04, 0.04), (0.01, 0.01), (0.04, 0.01)])
def test_the_truth_comes_back_whatever_the_rates(stalls, card, model, rates):
    records = [stalls[dt][i] for i, dt in enumerate(rates)]
    truth = np.array([TRUTH[name] for name in model.names])
    fits = {f: fit_mle(model, observe(records, card, model, f), extra_starts=0) for f in Forming}
    away = {f: np.abs(fit.estimate - truth) / fit.crb_corrected for f, fit in fits.items()}
    tau2 = model.names.index("tau2")
    assert abs(fits[Forming.MATCHED].estimate[tau2] - 20.0) < 0.4
    assert abs(fits[Forming.PUBLISHED].estimate[tau2] - 20.0) > 0.6
    assert np.sqrt(np.mean(away[Forming.MATCHED] ** 2)) < 2.0
    assert np.sqrt(np.mean(away[Forming.PUBLISHED] ** 2)) > 2.0


def test_identify_tells_the_common_rate(stalls, card):
    found = identify([stalls[0.04][0], stalls[0.01][1]], card, IdentifyOptions(sample=False, gp=False))
    assert any("25 Hz" in note and "100 Hz" in note for note in found.notes)
    assert found.observations.dt == pytest.approx(0.04)


def test_a_study_may_ask_for_published_coefficients(tmp_path):
    (tmp_path / "r.csv").write_text("time\n")
    text = 'records = ["r.csv"]\n[options]\ncoefficients = "{}"\n'
    (tmp_path / "s.toml").write_text(text.format("published"))
    assert read_study(tmp_path / "s.toml").units[0].options["coefficients"] == "published"
    (tmp_path / "s.toml").write_text(text.format("raw"))
    with pytest.raises(InputError, match="matched, published"):
        read_study(tmp_path / "s.toml")
