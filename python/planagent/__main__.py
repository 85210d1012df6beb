"""The program `planagent`: `planagent` or `python -m planagent`."""

from __future__ import annotations

import signal
import sys

from . import _core

__all__ = ["main"]


def main() -> int:
    """Runs the program with the arguments of the process; gives its exit code."""
    # It handles Ctrl-C by itself, as the program does.
    for name in ("SIGINT", "SIGPIPE"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL if name == "SIGINT" else signal.SIG_IGN)
    launcher = [sys.executable, "-m", "planagent"]
    return _core.command(["planagent", *sys.argv[1:]], launcher)


if __name__ == "__main__":
    sys.exit(main())
