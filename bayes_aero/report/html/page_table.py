"""A table of numbers as a page shows it."""

from __future__ import annotations

from itertools import groupby

from bayes_aero.report.html import page
from bayes_aero.report.tables.table import Table, cell_text


def page_table(table: Table) -> page.Table:
    """The columns that have a heading on a page, every cell as text."""
    shown = [(head, c, values) for c in table.columns for head, values in c.under(c.page)]
    groups = tuple((group, len(list(some))) for group, some in groupby(c.group for _, c, _ in shown))
    rows = list(zip(*([cell_text(x, c.form) for x in values] for _, c, values in shown), strict=True))
    if len(set(table.below)) > 1:
        first = [k for k, name in enumerate(table.below) if k == 0 or name != table.below[k - 1]]
        for k in reversed(first):
            rows.insert(k, (table.below[k], *[""] * (len(shown) - 1)))
    return page.Table(
        table.title,
        tuple(head for head, *_ in shown),
        tuple(rows),
        groups if any(group for group, _ in groups) else (),
        tuple(k for k, (_, c, _) in enumerate(shown) if c.words),
        table.note,
    )
