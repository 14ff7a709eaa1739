"""The command, as `cablequad` or as `python -m cablequad`."""

import os
import sys
from pathlib import Path

from cablequad._threads import one_thread


def installed_first() -> None:
    """The current folder, and what PYTHONPATH adds to `sys.path`, come after what is installed.

    A folder `missions` or `logs` of the user's is not taken for ours, here and in every process that is started.
    """
    ours = Path(__file__).resolve().parents[1]
    entries = [Path.cwd(), *map(Path, filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep)))]
    added = {entry.resolve() for entry in entries} - {ours}
    theirs = [entry for entry in sys.path if Path(entry).resolve() in added]
    rest = [entry for entry in sys.path if Path(entry).resolve() not in {ours, *added}]
    sys.path[:] = [*rest, str(ours), *theirs]


def main() -> None:
    """Entry point."""
    installed_first()
    one_thread()
    from missions.cli.main import main as command

    command()


if __name__ == "__main__":
    main()
