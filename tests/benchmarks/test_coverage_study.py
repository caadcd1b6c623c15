"""Coverage under coloured noise: the coloured posterior covers, bounds and posterior for white noise do not."""

import pytest
from interval_coverage import coverage_study

from bayes_aero.simulate.demo import TRUTH

NOISE = {"sigma_CL": 0.02, "sigma_CD": 0.005, "sigma_Cm": 0.004, "rho_CL": 0.95, "rho_CD": 0.95, "rho_Cm": 0.95}


@pytest.mark.verify
def test_coverage_under_coloured_noise(thinned, model):
    """rho = 0.95: the AR(1) posterior covers, Cramer-Rao bounds and the white posterior do not.

    Sixty replicates of each of eight cells of colour and rate: benchmarks/interval_coverage.py.
    """
    found = coverage_study(model, thinned, TRUTH, NOISE, replicates=20, seed=17, white=4, max_steps=600)
    share = found.table().loc["all"]
    assert 0.91 <= share["AR(1) posterior"] <= 0.98
    assert share["CRB"] < 0.6
    assert share["white posterior"] < 0.6
    assert share["corrected CRB"] > 0.8
