"""The command, as `cablequad` or as `python -m cablequad`."""

import os
import sys
from pathlib import Path


def installed_first() -> None:
    """What PYTHONPATH adds to `sys.path` comes after what is installed, here and in every process that is started.

    A folder `missions` or `logs` of the user's, where PYTHONPATH is the current folder, is not taken for ours.
    """
    added = {str(Path(entry).resolve()) for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry}
    theirs = [entry for entry in sys.path if str(Path(entry).resolve()) in added]
    ours = str(Path(__file__).resolve().parents[1])
    rest = [entry for entry in sys.path if entry not in theirs]
    sys.path[:] = [*rest, *([] if ours in rest else [ours]), *theirs]


def main() -> None:
    """Entry point."""
    installed_first()
    from missions.cli.main import main as command

    command()


if __name__ == "__main__":
    main()
