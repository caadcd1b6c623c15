"""What a qualification says, and what the rule says: what of its text was read, and what was not."""

from __future__ import annotations

from bayes_aero.qualification.result import Kind, Qualification, Verdict
from bayes_aero.report.qualification.tables import band, chance_text, excess, weakest
from bayes_aero.report.text.phrases import several

WHOLE = {
    Verdict.PASSES: "The model qualifies: it passes every tolerance.",
    Verdict.UNDECIDED: "It is not decided whether the model qualifies.",
    Verdict.FAILS: "The model does not qualify.",
}
DEFINITION = (
    "A test is passed if the flight stays inside the tolerance about the simulation from start to end. The simulation "
    "has the estimated parameters, the recorded inputs and the measured initial state. The flight has parameters drawn "
    "from their distribution, errors of the model's structure with the size and autocorrelation that flights showed, "
    "noise of the sensors, and gusts where they are counted. When a fitted manoeuvre is flown again, a part of its own "
    "error repeats. Errors of the initial state are among the errors that flights showed."
)
READ = (
    "14 CFR Part 60 (edition of 2019, volume 2, page 182), Attachment 7: “For stall recovery training tasks, "
    "satisfactory aerodynamic model fidelity must be shown through at least 10 degrees beyond the stall identification "
    "angle of attack.”",
    "The same, page 178, FSTD Directive No. 2, names the test of a full stall: “Table A2A, Objective Testing "
    "Requirements, Test 2.c.8.a (Stall Characteristics)”.",
    "Table A2A, 2.c.10 (edition of 2014, page 57), short period: “±1.5° pitch angle or ±2°/sec pitch rate, ±0.10g "
    "acceleration”.",
    "Appendix B, 2.c.8 (edition of 2014, page 161), stall warning: “±3 kts. airspeed, ±2° bank for speeds greater than "
    "actuation of stall warning device or initial buffet”.",
)
UNREAD = (
    "Table A2A, 2.c.8.a, was not read: the 2 deg of angle of attack and pitch angle, and the 3 kt for a simulator (not "
    "a training device) were not checked against the text. Neither was when in the manoeuvre they hold.",
    "Of Attachment 7 the beginning was read (pages 181 and 182), not the rest.",
    "The rule compares given tests, partly snapshots. That a tolerance holds for a whole time history is the choice "
    "of this program, and a probability is nothing that the rule asks for.",
)


def verdict_sentence(found: Qualification) -> str:
    """The model's verdict, and the tolerances that decide it."""
    by = {v: [n for n in found.tolerances if found.verdict(n) is v] for v in Verdict}
    marks = {Verdict.PASSES: "Passes", Verdict.UNDECIDED: "Undecided", Verdict.FAILS: "Fails"}
    listed = [
        f"{marks[v]}: {several(band(n, found.tolerances[n][0]) for n in names)}" for v, names in by.items() if names
    ]
    return f"{WHOLE[found.whole]} {'. '.join(listed)}."


def sentences(found: Qualification) -> tuple[str, ...]:
    """Weakest tests, agreement of the probabilities with the records, and extrapolation."""
    said = []
    for kind, words in ((Kind.AGAIN, "fitted manoeuvre flown again"), (Kind.TEST, "manoeuvre that was not fitted")):
        tests = [t for t in found.tests if t.kind is kind]
        if not tests:
            continue
        expected, passed = (
            sum(t.chance.value for t in tests),
            sum(t.recorded is not None and t.recorded.passed for t in tests),
        )
        said.append(
            f"{len(tests)} tests of a {words}: {expected:.1f} are expected to pass, {passed} of the records do."
        )
    following = [t for t in found.tests if t.kind is Kind.NEXT]
    if following:
        least = min(following, key=lambda t: t.chance.value)
        said.append(
            f"On the next flight {band(least.output, least.tolerance)} is the weakest, in {least.manoeuvre}: "
            f"probability {chance_text(weakest([least]))}."
        )
    for one in found.outside:
        said.append(
            f"Extrapolation: {one.manoeuvre}, as {one.motion}, is outside the flown region in {one.share:.0%} of the "
            f"samples, farthest by {one.distance:.2f} of half the flown ranges at {one.time:.1f} s ({excess(one)})."
        )
    if not found.outside:
        said.append(f"No manoeuvre leaves the flown region of {several(found.channels)}.")
    if found.unjudged:
        said.append(f"Not recorded, so not part of the flown region: {several(found.unjudged)}.")
    return tuple(said)
