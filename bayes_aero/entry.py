"""The entry point: what Ctrl-C does before a command has begun, and where a library drops it."""

import _thread
import gc
import os
import signal
import sys
import threading
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130  # as in bayes_aero.cli.terminal, which is not imported yet
SELDOM = (50_000, 20, 100)  # of garbage collection: tracing makes millions of objects that are in no cycle
TOLD = "interrupted; nothing had been written yet, give the same command again\n"


def main() -> None:
    """Entry point. An import that Ctrl-C breaks off fails in a way of each library; it is reported in one way."""
    pressed: list[int] = []

    def leave(*_: object) -> NoReturn:
        os.write(2, TOLD.encode())
        os._exit(INTERRUPTED)  # an exception in the midst of a library's first import may crash it

    def note(number: int, _: FrameType | None) -> NoReturn:
        pressed.append(number)
        raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGINT), sys.unraisablehook
    heeded = before[0] is not signal.SIG_IGN  # a shell has a program in the background ignore Ctrl-C
    sys.unraisablehook = _heed
    gc.set_threshold(*SELDOM)
    try:
        signal.signal(signal.SIGINT, leave if heeded else signal.SIG_IGN)
        from bayes_aero.cli import main as program

        signal.signal(signal.SIGINT, note if heeded else signal.SIG_IGN)
        program()
    except (KeyboardInterrupt, ImportError):
        if not pressed:
            raise
        sys.stderr.write("interrupted; stages that had finished are kept, give the same command again\n")
        sys.exit(INTERRUPTED)
    finally:
        signal.signal(signal.SIGINT, before[0])
        sys.unraisablehook = before[1]


def _heed(dropped: "sys.UnraisableHookArgs") -> None:
    """A Ctrl-C that fell into a callback of a library (JAX has one on garbage collection) is raised again, outside."""
    if isinstance(dropped.exc_value, KeyboardInterrupt):
        again = threading.Timer(0.05, _thread.interrupt_main)
        again.daemon = True
        again.start()
    else:
        sys.__unraisablehook__(dropped)
