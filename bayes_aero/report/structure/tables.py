"""Weights of rivals and sampled sets of terms as tables of numbers."""

from __future__ import annotations

from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.report.tables.table import Change, Column, Estimate, Table, columns_of
from bayes_aero.report.text.phrases import from_to, several

SHOWN = 4  # terms of a set that a page lists


def weights_table(d: Diagnosis) -> Table:
    """A row for each model that hold-out data hardly separate, that which was selected first."""
    rows = [(one, model) for one in d.stacking for model in one.models]
    column = columns_of([model for _, model in rows])
    return Table(
        [
            Column([one.stage for one, _ in rows], "stage", terminal="stage"),
            column(lambda m: " ".join(m.effects), "effects"),
            column(lambda m: "" if m.instead is None else m.instead[0], "cause"),
            column(lambda m: "" if m.instead is None else m.instead[1], "rival"),
            column(
                lambda m: "as selected" if m.instead is None else f"{m.instead[1]} in place of {m.instead[0]}",
                page="model",
                terminal="model",
                words=True,
            ),
            column(lambda m: m.weight, "weight", "weight", "weight", ".2f"),
            column(lambda m: Change(*m.band), ("weight_low", "weight_high")),
            column(lambda m: from_to(m.band[0], m.band[1], 0.1), page="90 %", terminal="90 %"),
            column(lambda m: None if m.instead is None else Estimate(*m.elpd), ("elpd", "elpd_se")),
            column(lambda m: _gain(m.elpd) if m.instead else "", page="hold-out gain", terminal="hold-out gain"),
            Column([one.blocks for one, _ in rows], "blocks"),
        ],
        "Weights of rivals: stacking of hold-out predictions",
        "The weights are those of the mixture of all models that predicts hold-out data best; mean and 90 % over "
        "resampled blocks of some 15 s. Hold-out gain: log density beyond the model as selected, autocorrelation "
        "included.",
        "Weights of rivals",
        "Mixture that predicts hold-out data best; mean and 90 % over resampled blocks.",
    )


def _gain(elpd: tuple[float, float]) -> str:
    return f"{elpd[0]:+z.1f} ± {elpd[1]:.1f}"


def sampled_table(d: Diagnosis) -> Table:
    """A row for each set of collinear terms in a sampled posterior over sets of terms."""
    rows = [(sampled, one) for sampled in d.sampled for one in sampled.sets]
    whole, column = columns_of([s for s, _ in rows]), columns_of([one for _, one in rows])
    return Table(
        [
            whole(lambda s: s.coefficient, "coefficient", "coefficient"),
            column(lambda one: one.terms[0][0].name, "term", "term", words=True),
            column(lambda one: one.terms[0][1], "probability", "probability", form=".2f"),
            column(lambda one: one.probability, "set_probability", "of the set", form=".2f"),
            column(lambda one: "; ".join(t.name for t, _ in one.terms[1:]), "collinear_with"),
            column(lambda one: several(t.name for t, _ in one.terms[1 : SHOWN + 1]), page="collinear with", words=True),
            column(lambda one: one.known, "selected"),
            column(lambda one: "yes" if one.known else "", page="selected"),
            whole(lambda s: s.count, "terms"),
            *(whole(lambda s, key=key: getattr(s, key), key) for key in ("rhat", "ess", "divergent", "reliable")),
        ],
        "Sampled sets of terms",
        "Inclusion probability of the leading term and of the set of terms that follow it (correlation of 0.9 or more, "
        "the model's parameters projected out), by a spike-and-slab posterior over all sets of the library under the "
        "autocorrelation of the residuals. Selected: forward selection has a term of the set, or one that is as "
        "good.",
    )
