"""Sampled sets of terms as a table of numbers."""

from __future__ import annotations

from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.report.tables.table import Table, columns_of
from bayes_aero.report.text.phrases import several

SHOWN = 4  # terms of a set that a page lists


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
