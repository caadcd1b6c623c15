"""The entry point: what Ctrl-C does before a command has begun."""

import os
import signal
import sys
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130  # as in bayes_aero.cli.terminal, which is not imported yet
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

    before = signal.getsignal(signal.SIGINT)
    heeded = before is not signal.SIG_IGN  # a shell has a program in the background ignore Ctrl-C
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
        signal.signal(signal.SIGINT, before)
