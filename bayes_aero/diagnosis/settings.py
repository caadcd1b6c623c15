"""Every threshold of a diagnosis, each with its reason. What is called our choice has no other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist

ENOUGH = 3.0  # deviations by which effects must differ for a manoeuvre to separate them


@dataclass(frozen=True)
class DiagnosisSettings:
    """Thresholds of screening, selection, hold-out tests and the search for structure without a name.

    Numerical constants (ridges, steps of iterations) are not among them. Defaults were chosen on simulated flights;
    rates of false alarms and of detection that follow from them are in `benchmarks/README.md`.
    """

    max_effects: int = 8  # effects that each stage may add

    # Screening: every candidate's score against noise-only replicates.
    replicates: int = 200  # noise-only replicates behind every p-value: it is 0.005 at the least
    correction_replicates: int = 40  # replicates that measure the bias of the estimated autocorrelation
    least_score: float = 2.5  # a candidate below it is not beyond chance among dozens

    # Forward selection.
    false_alarm_rate: float = 0.01  # family-wise, of each selection: a diagnosis holds several selections
    refit_false_alarm_rate: float = 0.02  # of leaders that are fitted first and judged by the block jackknife
    block_false_alarm_rate: float = 0.05  # of flight-path errors among blocks, of a lag, of offsets between manoeuvres
    candidates_tried: int = 8  # leaders considered in one selection
    candidates_refitted: int = 3  # leaders that are fitted and judged by the block jackknife
    least_share: float = 0.04  # of a coefficient's remaining variance: imperfect regressors imitate less
    least_share_correlated: float = 0.3  # of its gain that an effect must keep when noise of coefficients may correlate
    exchange_margin: float = 0.02  # of a candidate's gain by which another must exceed it to take its place
    decisive: float = 3.0  # nats by which one of two extensions must be the better

    # Rivals and credibility of a cause.
    ambiguous: float = 3.0  # nats within which another effect explains the residuals as well
    least_rival_score: float = 2.0  # score that an effect needs on its own to be a rival
    most_names: int = 5  # of an ambiguity set: beyond it the record does not attribute what it shows
    least_excitation: float = 0.1  # least over largest spread of an effect's sensitivities among manoeuvres; our choice
    correlated: float = 0.9  # correlation of two estimates beyond which one follows the other
    near_one: float = 0.15  # within which the factor of a sum or difference of two parameters is reported as one

    # Hold-out tests.
    hold_out: float = 1.645  # standard errors by which the hold-out log score must fall: one-sided, 5 %
    hold_out_first_order: float = 5.0  # the same to first order, from which nothing is fitted again to see it
    hold_out_steps: int = 4  # Gauss-Newton steps of each fit to the other parts
    parts: int = 6  # of a single manoeuvre, each predicted from the others
    gap: float = 2.0  # s left out between neighbouring parts of one manoeuvre
    shortest_part: float = 3.0  # times the gap
    unidentified: float = 10.0  # times the joint standard error from which a manoeuvre does not identify a cause

    # Block jackknife.
    block: float = 15.0  # s; our choice: gusts hang together over some 5 s, and a minute must have several blocks
    fewest_blocks: int = 6  # of a short record

    # Structure without a name.
    knots: int = 6  # of the smooth function of a channel
    manoeuvre_parts: int = 4  # of each manoeuvre: a sinusoid must predict the parts that it was not fitted to
    unnamed_replicates: int = 100  # noise-only replicates
    unnamed_false_alarm_rate: float = 0.015  # of each family: functions of a channel, periods, terms
    unnamed_tried: int = 5  # leaders whose hold-out gain is measured
    unnamed_most: int = 3  # functions taken one after another
    terms_most: int = 6  # of one coefficient; our choice
    unnamed_share: float = 0.1  # of the remaining variance: less is not worth a verdict
    periodic_share: float = 0.25  # the same of a sinusoid: noise alone draws a fifth of the variance into one
    single_share: float = 0.3  # the same on a single manoeuvre: its parts share their slow noise and confirm little
    stand_in: float = 1.2  # times what a named cause gains that a function must reach to take its place

    # Parameters that change during the records.
    change_false_alarm_rate: float = 0.005  # with the families of functions below the 5 % of a whole diagnosis
    change_share: float = 0.25  # of the remaining variance: noise alone draws as much into it as into a sinusoid
    change_least: float = 6.0  # s at either end of a manoeuvre in which no change is sought; our choice
    change_begins: int = 1000  # moments tried
    change_parts: int = 8  # of each manoeuvre: a change must predict the parts that it was not fitted to
    change_interval: float = 1.92  # nats within which other moments explain as much: 95 % of one parameter

    # Sensor errors that the flight path cannot separate.
    imitated: float = 0.95  # share of what an error does from which others do it as well; our choice
    imitators: int = 3  # errors that imitate one together
    open_share: float = 0.5  # of what an output leaves that an unconfirmed error must explain to be reported

    def degrades(self, gain: float, se: float, among: int = 1) -> bool:
        """Whether a gain in hold-out log density (nats, with its standard error) is a loss beyond the margin within
        which two models are as good, and beyond noise; of `among` such gains one is so by chance in 5 %."""
        chance = NormalDist().cdf(-self.hold_out) / among
        return bool(gain < -max(self.ambiguous, -NormalDist().inv_cdf(chance) * se))

    def degraded(self, gains: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """Of the gains of several outputs, those that are losses."""
        return {name: gain for name, gain in gains.items() if self.degrades(*gain, among=len(gains))}


DEFAULT = DiagnosisSettings()
