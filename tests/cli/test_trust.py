"""Code is run only if the user has named the card, or said so; nothing is written outside the folder named.

And bad input of any command is one sentence.
"""

import shutil
from pathlib import Path

import pytest
from calling import answer, holds, refused

from bayes_aero.flight.card import read_card, shipped_cards
from bayes_aero.jobs.store import write_json
from bayes_aero.study import run as units

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


@pytest.mark.usefixtures("trap")
def test_effects_of_a_card_are_listed_with_it_alone(program):
    (found,) = answer(program("effects", "bank_pitching", "--model", "mine.toml", "--json"))["effects"]
    assert (found["claim"], found["model"]) == ("Bank pitches the aircraft.", False)
    refused(program("effects", "bank_pitching"), "bank_pitching")


@pytest.mark.usefixtures("quick")
def test_a_study_runs_no_code_unless_it_is_told_to(program, trap):
    for more in ([], ["--dry-run"]):
        refused(program("run", "study.toml", *more), "trap.py", "--trust-effects", gone=["study_results"])
    Path("shipped.toml").write_text('records = ["flight.csv"]\ncards = ["attas"]\n')
    assert program("run", "shipped.toml", "--out", "shipped").code == 0  # not the card of this name that lies here
    assert not trap.exists()
    assert program("run", "study.toml", "--trust-effects").code == 0
    assert trap.exists()


LINKS = [("run study.toml", f"study_results/{link}") for link in ("units", "units/x", "environment")]
LINKS += [
    (f"{command} flight.csv --out out", f"out/{link}")
    for command in ("identify", "diagnose")
    for link in ("figures", "report.html", "results.json.part")
]


@pytest.mark.usefixtures("quick", "trap")
@pytest.mark.parametrize(("asked", "link"), LINKS)
def test_links_in_the_folder_of_results_lead_nowhere(program, asked, link):
    Path("study.toml").write_text('records = ["flight.csv"]\n')
    victim = Path("outside/victim").resolve()
    victim.parent.mkdir()
    victim.write_text("untouched")
    Path(link).parent.mkdir(parents=True)
    Path(link).symlink_to(victim.parent if asked.startswith("run") else victim)
    done = program(*asked.split())
    assert done.code == 2
    assert "leads out of" in done.err
    assert [(path.name, path.read_text()) for path in victim.parent.iterdir()] == [("victim", "untouched")]


@pytest.mark.usefixtures("quick", "trap")
def test_the_folder_itself_may_be_a_link(program):
    Path("study.toml").write_text('records = ["flight.csv"]\n')
    Path("big_disk").mkdir()
    Path("out").symlink_to("big_disk", target_is_directory=True)
    assert program("run", "study.toml", "--out", "out").code == 0
    assert (Path("big_disk") / "units.csv").is_file()


LONG, SIMULATE = "x" * 300, "simulate --out f.csv"
BAD = {  # of every command: what it is asked, and a word of the sentence
    "identify nowhere.csv": "nowhere.csv", "identify empty.csv": "empty.csv", "identify --model atas": "attas",
    "identify --model bad.toml": "efects", "identify flight.csv --resample nan": "resample",
    f"identify flight.csv --out {LONG}": "too long", "diagnose nowhere.csv": "nowhere.csv",
    "diagnose empty.csv": "empty.csv", "diagnose --model atas": "attas",
    f"diagnose flight.csv --out {LONG}": "too long", "check empty.csv": "empty.csv",
    f"check flight.csv --model {LONG}": "no card", "effects pitch_rat_bias": "pitch_rate_bias",
    f"card flight.csv --out {LONG}": "too long", f"run {LONG}.toml": "check the path",
    f"run study.toml --out {LONG}": "too long", f"check {LONG}.csv": "check its name",
    f"{SIMULATE} --effect pitch_rat_bias=1": "pitch_rate_bias", f"{SIMULATE} --effect pitch_rate_bias": "NAME=VALUE",
    f"{SIMULATE} --effect flow_separation=3": "flow_separation.alpha_star=VALUE",
    f"{SIMULATE} --effect thrust_lag=-1": "between 0 and 20", f"{SIMULATE} --effect thrust_lag=1kg": "kg",
    f"{SIMULATE} --effect kirchhoff_lift=1": "no parameter", f"{SIMULATE} --dt 5": "0.1 s",
    f"{SIMULATE} --dt 1e-12": "0.1 s", f"{SIMULATE} --duration 1000": "random_stall",
    f"{SIMULATE} --duration 1e15": "random_stall", f"{SIMULATE} --duration nan": "random_stall",
    f"{SIMULATE} --model nowhere.toml": "nowhere.toml", "simulate --out nowhere/a.csv": "there is no folder nowhere",
    f"simulate --out {LONG}.csv": "too long", f"{SIMULATE} --manoeuvre aileron_doublet": "lateral axis",
    "fly flight.csv --frequency 0.1 1.5": "identify --frequency", "run study.toml --memory 4GiB": "--workers",
    "identify flight.csv --next-flight": "2 to 24 manoeuvres, and there is 1",
    "run study.toml --workers 2 --scheduler tcp://127.0.0.1:9": "exclude each other",
    "run study.toml --workers 2 --memory lots": "'lots' is no size",
    "run study.toml --workers 2 --memory 100MB": "too little",
    "run study.toml --workers 2 --dry-run": "leave --workers",
    "run study.toml --dry-run --scheduler tcp://127.0.0.1:9": "leave --workers and --scheduler out",
}  # fmt: skip


@pytest.mark.usefixtures("trap")
@pytest.mark.parametrize("asked", BAD, ids=lambda asked: asked[:60])
def test_bad_input_is_one_sentence_and_nothing_is_written(program, tmp_path, asked):
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "study.toml").write_text('records = ["flight.csv"]\n')
    (tmp_path / "bad.toml").write_text('[aircraft]\n[channels]\n[model]\nefects = ["attached_lift"]\n')
    before = set(tmp_path.iterdir())
    refused(program(*asked.split()), BAD[asked])
    assert set(tmp_path.iterdir()) == before


@pytest.mark.usefixtures("trap")
@pytest.mark.parametrize(("asked", "word"), [
    ("check flight.csv --resample 1e-12", "✗"),
    ("diagnose --max-effects 0", "--max-effects"), (f"{SIMULATE} --seed 4294967296", "--seed"),
])  # fmt: skip
def test_records_that_cannot_be_read_and_numbers_out_of_range_are_told(program, asked, word):
    done = program(*asked.split())
    assert done.code in (1, 2)
    assert word in done.out + done.err
    assert "Traceback" not in done.out + done.err


def test_markup_in_headings_reaches_no_terminal(program, trap):
    content = Path("flight.csv").read_text().split("\n", 1)
    rows = "\n".join(f"{line},1,2" for line in content[1].split())
    Path("[red].csv").write_text(content[0] + ",[/bold],[link=file:///etc]x[/]\n" + rows)
    done = program("check", "[red].csv", "--no-sensors")
    holds(done.out, "[red].csv", "'[/bold]'")
    assert not trap.exists()
