"""Milliseconds a step of the page of `bayes-aero open`: a slider moves, the manoeuvre is flown again and drawn.

    OPENBLAS_NUM_THREADS=1 python benchmarks/open_step.py RESULT [--steps 60]

RESULT is the folder of identify, fly or diagnose. For each manoeuvre: best, median and 95th percentile of the compiled
flight, of the whole answer of the server (flight, errors, points of all panels), and, where Chromium and Playwright
are installed, from the key press until the browser has drawn (headless, 1920 x 1080, no graphics card).
"""

from __future__ import annotations

import argparse
import asyncio
import shutil
import threading
import time
from collections.abc import Callable
from queue import Queue
from typing import Any

import numpy as np
from bokeh.document import Document

from bayes_aero.explore.opened import Choice, Simulator, open_result
from bayes_aero.explore.page import Asked, ExplorePage, PageServer, page_of

SIZE = {"width": 1920, "height": 1080}
READY = "Number(document.documentElement.dataset.answered) === explore.state.id"


def seconds_of(call: Callable[[int], Any], steps: int) -> list[float]:
    """Of each call but the first."""
    found = []
    for k in range(steps + 1):
        begin = time.perf_counter()
        call(k)
        found.append(time.perf_counter() - begin)
    return found[1:]


def flights(simulator: Simulator, manoeuvre: int, name: str, steps: int) -> list[list[float]]:
    """Seconds of each compiled flight, and of each answer of the server, without a browser."""
    page, value = ExplorePage(simulator, Document()), simulator.opened.identified.values[name]

    def moved(k: int) -> dict[str, float]:
        return {name: value * (1.0 + 1e-4 * k)}

    calls = (
        lambda k: simulator.fly(manoeuvre, Choice(moved(k))),
        lambda k: page.answer(Asked(k, manoeuvre, values=moved(k))),
    )
    return [seconds_of(call, steps) for call in calls]


def drawn(simulator: Simulator, name: str, steps: int) -> list[list[float]]:
    """Seconds from key press to drawing, by manoeuvre; nothing without a browser."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return []
    if chromium is None:
        return []
    ready: Queue[PageServer] = Queue()

    def run() -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        server = PageServer(page_of(simulator))
        ready.put(server)
        server.serve()

    thread = threading.Thread(target=run)
    thread.start()
    server, found = ready.get(), []
    with sync_playwright() as driver:
        page = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"]).new_page(viewport=SIZE)
        page.goto(server.url)
        page.wait_for_function("document.documentElement.dataset.answered === '0'")
        for manoeuvre in range(len(simulator.manoeuvres)):
            page.locator("#manoeuvre").select_option(str(manoeuvre))
            page.wait_for_timeout(3000)
            page.locator(f"#range-{name}").focus()
            times = []
            for k in range(steps + 1):
                page.keyboard.press("ArrowLeft" if k % 2 else "ArrowRight")
                page.wait_for_function(READY)
                times.append(1e-3 * float(page.evaluate("document.documentElement.dataset.milliseconds")))
            found.append(times[1:])
    server.loop.add_callback(server.loop.stop)
    thread.join()
    return found


def words(seconds: list[float]) -> str:
    """Best, median and 95th percentile."""
    return "/".join(f"{1e3 * x:.0f}" for x in np.percentile(seconds, [0.0, 50.0, 95.0])).rjust(13)


def main() -> None:
    """Print a row for each manoeuvre."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result")
    parser.add_argument("--steps", type=int, default=60)
    given = parser.parse_args()
    simulator = Simulator(open_result(given.result))
    name = simulator.opened.identified.names[1]
    seen = drawn(simulator, name, given.steps)
    print(f"{simulator.opened.title}, {name} moved, ms: best/median/95th percentile")
    print(f"{'manoeuvre':20} {'samples':>7} {'flight':>13} {'answer':>13} {'drawn':>13}")
    for k, manoeuvre in enumerate(simulator.manoeuvres):
        columns = list(map(words, flights(simulator, k, name, given.steps)))
        columns.append(words(seen[k]) if seen else "-")
        print(f"{manoeuvre:20} {len(simulator.time(k)):7d} {' '.join(columns)}")


if __name__ == "__main__":
    main()
