"""Code is run only if the user has named the card, or said so; and nothing is written outside the folder named."""

import shutil
from pathlib import Path

import pytest
from calling import holds, refused

from bayes_aero.flight.card.card import read_card, shipped_cards
from bayes_aero.jobs.provenance import write_json
from bayes_aero.study import case as units

EFFECT = (Path(__file__).parents[1] / "model" / "test_cards.py").read_text(encoding="utf-8").split("'''")[1]


@pytest.fixture
def trap(tmp_path, flights):
    """A folder with records and, beside them, a card whose effect file leaves a mark when it is run."""
    shutil.copy(flights.sound, tmp_path / "flight.csv")
    mark = tmp_path / "ran"
    (tmp_path / "trap.py").write_text(f"open({str(mark)!r}, 'w').close()\n{EFFECT}")
    text = shipped_cards()["attas"].read_text().replace("[model]\n", '[model]\neffect_files = ["trap.py"]\n')
    for name in ("attas", "attas.toml", "card.toml", "flight.toml", "flight.csv.toml", "mine.toml"):
        (tmp_path / name).write_text(text)
    (tmp_path / "study.toml").write_text('records = ["flight.csv"]\ncards = ["mine.toml"]\noptions.gp = false\n')
    return mark


@pytest.fixture
def quick(monkeypatch):
    """A unit's work that only looks at its card."""

    def perform(unit, out, *_):
        write_json({"effects": len(units.card_of(unit).effects)}, out / "results.json")

    monkeypatch.setattr(units, "run_task", perform)


def test_a_card_that_lies_about_is_not_taken(program, trap):
    assert program("check", "flight.csv", "--no-sensors").code == 0  # the default is `attas`
    assert program("check", "flight.csv", "--no-sensors", "--model", "attas").code == 0
    assert program("effects", "--model", "attas").code == 0
    assert read_card("attas").effect_files == ()
    assert not trap.exists()
    assert program("effects", "--model", "./attas").code == 0  # now the user has named it
    assert trap.exists()


@pytest.mark.usefixtures("quick")
def test_a_study_runs_no_code_unless_it_is_told_to(program, trap):
    for more in ([], ["--dry-run"]):
        refused(program("run", "study.toml", *more), "trap.py", "--trust-effects", gone=["study_results"])
    assert not trap.exists()
    assert program("run", "study.toml", "--trust-effects").code == 0
    assert trap.exists()


@pytest.mark.usefixtures("quick")
def test_a_study_found_in_a_results_folder_runs_none_either_and_a_shipped_name_is_the_shipped_card(program, trap):
    Path("results").mkdir()
    for name in ("mine.toml", "trap.py", "flight.csv", "study.toml"):
        shutil.copy(name, "results")
    assert program("run", "results/study.toml", "--out", "results").code == 2
    Path("study.toml").write_text('records = ["flight.csv"]\ncards = ["attas"]\n')
    assert program("run", "study.toml").code == 0
    assert not trap.exists()


@pytest.mark.usefixtures("quick", "trap")
@pytest.mark.parametrize("link", ["study_results/units", "study_results/units/x", "study_results/environment"])
def test_links_in_the_folder_lead_nowhere(program, link):
    Path("study.toml").write_text('records = ["flight.csv"]\n')
    outside = Path("outside")
    outside.mkdir()
    Path(link).parent.mkdir(parents=True)
    Path(link).symlink_to(outside.resolve(), target_is_directory=True)
    done = program("run", "study.toml")
    assert done.code == 2
    assert "leads out of" in done.err
    assert list(outside.iterdir()) == []


@pytest.mark.usefixtures("trap")
@pytest.mark.parametrize("link", ["figures", "report.html", "results.json.part"])
@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_links_in_the_folder_of_a_job_lead_nowhere(program, command, link):
    Path("victim").write_text("untouched")
    Path("out").mkdir()
    (Path("out") / link).symlink_to(Path("victim").resolve())
    refused(program(command, "flight.csv", "--out", "out"), "leads out of")
    assert Path("victim").read_text() == "untouched"


@pytest.mark.usefixtures("quick", "trap")
def test_the_folder_itself_may_be_a_link(program):
    Path("study.toml").write_text('records = ["flight.csv"]\n')
    Path("big_disk").mkdir()
    Path("out").symlink_to("big_disk", target_is_directory=True)
    assert program("run", "study.toml", "--out", "out").code == 0
    assert (Path("big_disk") / "units.csv").is_file()


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "{long}.toml"], ["run", "study.toml", "--out", "{long}"], ["check", "{long}.csv"],
        ["check", "flight.csv", "--model", "{long}"], ["identify", "flight.csv", "--out", "{long}"],
        ["diagnose", "flight.csv", "--out", "{long}"], ["simulate", "--out", "{long}.csv"],
        ["simulate", "--out", "x.csv", "--duration", "1e15"], ["simulate", "--out", "x.csv", "--dt", "1e-12"],
        ["simulate", "--out", "x.csv", "--duration", "nan"], ["simulate", "--out", "x.csv", "--seed", "4294967296"],
        ["card", "flight.csv", "--out", "{long}"], ["check", "flight.csv", "--resample", "1e-12"],
        ["identify", "flight.csv", "--resample", "nan"],
    ],
)  # fmt: skip
@pytest.mark.usefixtures("trap")
def test_absurd_arguments_are_one_sentence(program, arguments):
    done = program(*(a.format(long="x" * 300) for a in arguments))
    assert done.code in (1, 2)
    assert "Traceback" not in done.err + done.out
    assert done.err or "✗" in done.out


def test_markup_in_headings_reaches_no_terminal(program, trap):
    content = Path("flight.csv").read_text().split("\n", 1)
    rows = "\n".join(f"{line},1,2" for line in content[1].split())
    Path("[red].csv").write_text(content[0] + ",[/bold],[link=file:///etc]x[/]\n" + rows)
    done = program("check", "[red].csv", "--no-sensors")
    holds(done.out, "[red].csv", "'[/bold]'")
    assert not trap.exists()
