"""Gaussian-process regression with the seed paper's kernel, its hyperparameters at their mode and sampled."""

from bayes_aero.inference.gp.fit import GPFit, Prediction, fit_gp
from bayes_aero.inference.gp.kernel import FLAT, HyperPrior, Priors
from bayes_aero.inference.gp.optimum import MapStatus
from bayes_aero.inference.gp.posterior import Budget, SampleStatus

__all__ = ["FLAT", "Budget", "GPFit", "HyperPrior", "MapStatus", "Prediction", "Priors", "SampleStatus", "fit_gp"]
