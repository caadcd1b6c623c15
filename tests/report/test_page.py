"""The report page: everything escaped, whole or not at all, true to its numbers, thinned without losing a peak."""

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise

import numpy as np
import pytest
from calling import holds
from PIL import Image

from bayes_aero.diagnosis.result import INNOVATIONS, TRAJECTORIES, DiagnosisView
from bayes_aero.flight.health import HealthFinding
from bayes_aero.inference.results import PosteriorStatus
from bayes_aero.jobs.results import Outcome
from bayes_aero.jobs.store import provenance
from bayes_aero.report.figures.every_figure import FIGURES
from bayes_aero.report.page import (
    Fold,
    Gallery,
    HtmlTable,
    Picture,
    Plot,
    Report,
    Text,
    page_table,
    put_page,
    render,
    section,
)
from bayes_aero.report.pages.diagnosis import diagnosis_page
from bayes_aero.report.pages.identification import headline, identification_page, parameter_table
from bayes_aero.report.pages.parts import PageContext, stall_table
from bayes_aero.report.plots import Line, Panel, extremes, linked
from bayes_aero.report.style import NotDrawn

HOSTILE = """<script>alert(1)</script>"'&$$x$$</title>"""


class Outline(HTMLParser):
    """Headings, images, scripts and all text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.headings: list[int] = []
        self.alternatives: list[str] = []
        self.scripts = 0
        self.text = ""
        self.scopeless = 0
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))
        self.alternatives += [given.get("alt") or ""] if tag == "img" else []
        self.alternatives += [given.get("aria-label") or ""] if given.get("role") == "img" else []
        self.scripts += tag == "script"
        self.scopeless += tag == "th" and "scope" not in given

    def handle_data(self, data):
        self.text += data


def page_of(*blocks, **words) -> Report:
    whole = {"title": "t", "subtitle": "s", "verdict": "v", "lead": ()} | words
    return Report(**whole, sections=(section("a", "A", lambda: blocks),))


@pytest.fixture(scope="module")
def html(full):
    source = provenance(full.card, full.records, 0, {"noise": "ar1"})
    return render(identification_page(replace(full, notes=("Figure pair was not drawn: it rained",)), source, {}))


def test_whatever_comes_from_a_run_is_escaped():
    table = HtmlTable(HOSTILE, (HOSTILE, "b"), ((HOSTILE, HOSTILE),), ((HOSTILE, 2),), note=HOSTILE)
    picture = Picture("data:,", HOSTILE, 3, 2, 2)
    panel = Panel("CL", "1", (Line("measured", "#000000", np.arange(3.0)),))
    item = {**linked(np.arange(3.0), [panel], "time"), "more": HOSTILE}
    plot = Plot(item, ((HOSTILE, "#000000", "solid"),), HOSTILE, HOSTILE, HOSTILE)
    page = page_of(
        Text(HOSTILE), table, picture, plot, Fold(HOSTILE, (Text(HOSTILE),)), title=HOSTILE, subtitle=HOSTILE,
        verdict=HOSTILE,
    )  # fmt: skip
    html = render(page)
    assert "<script>alert" not in html
    outline = Outline(html)
    assert outline.scripts == 3  # the library, the data, the page's own
    assert outline.text.count(HOSTILE) >= 12  # and is shown as it is
    data = re.search(r'<script type="application/json" id="plots">(.*?)</script>', html, re.S)
    assert data is not None
    assert json.loads(data[1])[0]["more"] == HOSTILE


def test_a_page_is_sound_asks_nothing_of_a_network_and_tells_the_numbers(html, full):
    own = re.sub(r"<script>.*?</script>", "", html, flags=re.S)  # the library is watched in a browser
    assert re.findall(r"""(?:src|href)\s*=\s*["']data:""", own)
    assert not re.search(r"""(?:src|href)\s*=\s*["'](?!data:|#)""", own)
    assert "@import" not in own
    assert "default-src 'none'" in html
    outline = Outline(html)
    assert outline.headings.count(1) == 1
    assert all(b - a <= 1 for a, b in zip([0, *outline.headings], outline.headings, strict=False))
    assert outline.scopeless == 0
    assert outline.alternatives
    assert all(len(text) > 20 for text in outline.alternatives)
    text = Outline(html).text
    holds(text, "emcee", "NUTS", "Cramér–Rao", "Figure pair was not drawn: it rained")
    assert full.records[0].sha256 in text
    holds(text, *full.mle.names)


def test_the_identified_model_is_flown_on_the_page(full, simulated):
    off = [path for path in simulated.paths if (path.model, path.split) == ("card", "fitted")]
    page = identification_page(full, {}, {}, off)
    (part,) = [s for s in page.sections if s.key == "simulated"]
    (table,) = [b for b in part.blocks if isinstance(b, HtmlTable)]
    assert table.rows[0][0] == "a, first half"
    row = dict(zip(table.head, next(row for row in table.rows if row[0] == "α [deg]"), strict=True))
    assert row["simulation"] == "100%"  # alpha is off by a degree, inside two hundredths of a radian
    assert len([b for b in part.blocks if isinstance(b, Plot)]) == len(off) == 2
    assert not any(s.key == "simulated" for s in identification_page(full, {}, {}).sections)


def test_parameters_are_those_of_every_method(full):
    table = page_table(parameter_table(full))
    row = next(cells for cells in table.rows if cells[0].startswith("Cmde "))
    assert row[0] == "Cmde [1/rad]"
    assert row[1:3] == ("-0.800 ± 0.010", "-0.800 ± 0.040")  # the bound and four times it
    told = [cell.split("\n") for cell in row[3:-2]]
    order = sorted(full.posteriors, key=lambda key: key != "white")  # white noise stands first
    for key, (mean, interval) in zip(order, told, strict=True):
        m = full.posteriors[key].marginals["Cmde"]
        assert [float(x) for x in mean.split(" ± ")] == pytest.approx([m.mean, m.sd], abs=5e-4)
        assert [float(x) for x in interval.split(" to ")] == pytest.approx(m.ci95, abs=5e-4)
    assert row[-1] == "42.4"  # 60 bounds apart, each off by one: 60/sqrt 2
    assert sum(span for _, span in table.groups) == len(table.head) == len(row)


def test_what_a_record_or_sampler_does_not_show_is_said(full):
    (table, warning) = stall_table({"emcee": full.stall}, "")
    assert full.stall.at_edge == 1.0  # lift without separation only rises
    assert table.rows[0][1].startswith("at least")
    assert table.rows[0][2] == "not shown by this record"
    assert "100%" in warning.text
    assert "CLmax" not in headline(full)
    bad = replace(full.posteriors["nuts"], status=PosteriorStatus.DIVERGENT)
    page = identification_page(replace(full, posteriors={**full.posteriors, "nuts": bad}), {}, {})
    assert page.lead[0].tone == "warning"
    assert "divergent" in page.lead[0].text


def test_a_part_that_fails_does_not_cost_the_page(tmp_path):
    def fails():
        raise ValueError("no such luck")

    page = Report("t", "s", "v", (), (section("a", "Lift", fails), section("b", "Drag", lambda: (Text("fine"),))))
    text = Outline(render(page)).text
    holds(text, "'Lift'", "ValueError: no such luck", "fine")
    (told,) = put_page(lambda: page, tmp_path)
    assert "'Lift'" in told
    (tmp_path / "other").mkdir()
    (told,) = put_page(fails, tmp_path / "other")
    holds(told, "report.html", "ValueError: no such luck")
    assert "in fails" in (tmp_path / "other" / "error.txt").read_text()


def test_thinning_keeps_every_peak():
    rng = np.random.default_rng(1)
    columns = [np.cumsum(rng.standard_normal(20_000)), rng.standard_normal(20_000)]
    columns[1][12_345] = 40.0
    keep = extremes(columns, 1000)
    assert len(keep) <= 2 * 1000 + 2
    assert keep[0] == 0
    assert keep[-1] == 19_999
    assert 12_345 in keep
    edges = np.linspace(0, 20_000, 501).astype(int)
    for values in columns:
        for a, b in pairwise(edges):
            shown = values[keep[(keep >= a) & (keep < b)]]
            assert shown.min() == values[a:b].min()
            assert shown.max() == values[a:b].max()
    assert np.array_equal(extremes(columns, 30_000), np.arange(20_000))
    columns[0][:] = np.nan  # a channel that dropped out
    assert len(extremes(columns, 1000)) <= 2 * 1000 + 2


def test_a_picture_is_the_file_as_it_was_drawn(tmp_path):
    wide = Image.new("RGB", (3000, 600), "white")
    wide.paste((0, 114, 178), (0, 0, 1500, 600))
    wide.save(tmp_path / "wide.png")
    gallery = Gallery({"wide": tmp_path / "wide.png"}, {"wide": "caption"})
    (picture,) = gallery("wide", "absent")
    assert picture.caption == "caption"
    assert (picture.width, picture.height) == (3000, 600)
    assert picture.natural == 1920  # 3000 pixels at 150 to the inch, 96 on a screen
    head, content = picture.source.split(",")
    assert head == "data:image/png;base64"
    assert base64.b64decode(content) == (tmp_path / "wide.png").read_bytes()


def test_a_diagnosis_tells_causes_gain_and_what_is_open(diagnosed, flown, card):
    d = flown.diagnosis
    ranges = {"alpha": [0.07, 0.21], "load_factor": [0.71, 1.52], "airspeed": [80.0, 110.0]}
    point = {"manoeuvre": "thrust_steps", "amplitude": 1.5, "airspeed": 95.4, "altitude": 5200.0, "seconds": 60.0}
    points = {
        "questions": [{"effects": ["a", "b"], "enough": 5.0, "present": 0.7}],
        "points": [{**point, "excursion": ranges, "standard_errors": [6.25], "nats_per_second": 0.3}],
        "stated": [],
    }
    source = provenance(card, diagnosed.records, 0, {})
    hidden = {"hidden": {"alpha_bias": {"alpha_bias": 0.01}}, "named": {"alpha_bias": "missed"}}
    about = Outcome(flown, **hidden, notes=("n",), test_points=points)
    told = PageContext(card, diagnosed.records, source, {}, about)
    page = diagnosis_page(flown, told)
    assert not [s.title for s in page.sections if any("was not made" in getattr(b, "text", "") for b in s.blocks)]
    text = Outline(render(page)).text
    for cause in d.causes:
        assert cause.claim in text
    holds(text, "a or b: expected to be decided, 6.2 standard errors", "thrust steps", "4 to 12", "0.71 to 1.52")
    holds(text, "Hidden effect: alpha_bias", "Trajectories, before and after", "time inside", "CLmax")
    table = next(b for b in page.sections[2].blocks if isinstance(b, HtmlTable))
    assert [row[0] for row in table.rows] == ["CL", "CD", "Cm"]
    assert "manoeuvre by manoeuvre" not in text  # there is one
    only = diagnosis_page(by_trajectories(flown), told)
    text = Outline(render(only)).text
    holds(text, "they need lift coefficients", "lacks channels")
    followed = by_trajectories(flown)
    followed = replace(followed, diagnosis=replace(followed.diagnosis, compared=INNOVATIONS, tested=None))
    told_so = Outline(render(diagnosis_page(followed, told))).text
    assert "from innovations: process noise and gusts are estimated" in told_so
    assert "lacks channels" not in told_so
    assert "Measured and simulated coefficients" not in text


def by_trajectories(view: DiagnosisView) -> DiagnosisView:
    """What is shown where no coefficients were formed."""
    diagnosis = replace(view.diagnosis, compared=TRAJECTORIES)
    return DiagnosisView(diagnosis=diagnosis, rankings=view.rankings, moves=view.moves, trajectories=view.trajectories)


def test_a_unit_that_cannot_be_is_the_first_word(diagnosed, flown, card):
    said = f"{len(diagnosed.records)} in knots"
    health = (HealthFinding(diagnosed.records[0].name, "airspeed", "unit", None, None, said, True),)
    source = provenance(card, diagnosed.records, 0, {})
    told = PageContext(card, diagnosed.records, source, {}, Outcome(flown, health=health))
    for page in (diagnosis_page(flown, told), diagnosis_page(by_trajectories(flown), told)):
        assert page.doubts[0] == Text(f"{len(diagnosed.records)} in knots.", "warning")
        html = render(page)
        assert html.index("in knots") < html.index('class="verdict"')


def test_a_long_record_with_a_hostile_name_makes_a_page_of_bearable_size(make, monkeypatch):
    """200,000 samples: what is drawn is thinned, which the page says; the name of a file is shown, never run."""
    monkeypatch.setitem(make.__globals__, "N", 200_000)
    run = make(manoeuvres=1, gp=False)
    records = tuple(replace(record, name=HOSTILE) for record in run.records)
    observations = replace(run.observations, names=(HOSTILE,))
    run = replace(run, card=replace(run.card, title=HOSTILE), records=records, observations=observations)
    page = render(identification_page(run, provenance(run.card, run.records, 0, {"noise": HOSTILE}), {}))
    assert len(page.encode()) < 10_000_000
    assert "thinned so that every peak stays" in page
    assert "<script>alert" not in page
    outline = Outline(page)
    assert outline.scripts == 3
    assert HOSTILE in outline.text


def test_figures_with_a_panel_for_each_manoeuvre_are_left_out_where_there_are_many(make, monkeypatch):
    monkeypatch.setattr("bayes_aero.report.style.MOST_MANOEUVRES", 1)
    with pytest.raises(NotDrawn, match="2 are more than 1"):
        FIGURES["fig1_time_history"](make(manoeuvres=2, gp=False))
