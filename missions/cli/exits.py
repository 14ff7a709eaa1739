"""How commands end: exit codes, and the one line that says why."""

import sys
from pathlib import Path
from typing import NoReturn

import typer

FAILED, USAGE, UNTESTED, INTERRUPTED = 1, 2, 3, 130


def usage(text: str) -> NoReturn:
    """End as a command that was called wrongly."""
    print(f"cablequad: {text}", file=sys.stderr)
    raise typer.Exit(USAGE)


def make_folder(folder: Path, option: str) -> None:
    """Make the folder that an option names, where there is none; where none can be made, end as a wrong call."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        usage(f"{option} {folder}: no folder can be made there ({error.strerror}); give another one")


def there(log: Path) -> None:
    """End as a command that was called wrongly where there is no such file."""
    if not log.is_file():
        what = "is a folder" if log.is_dir() else "no such file"
        usage(f"log {log}: {what}; give the path of an .mcap file")


def fail(text: str) -> NoReturn:
    """End as a command that could not do what was asked."""
    print(f"cablequad: {text}", file=sys.stderr)
    raise typer.Exit(FAILED)


def untested(text: str) -> NoReturn:
    """End as a command that the computer could not carry out."""
    print(f"cablequad: {text}", file=sys.stderr)
    raise typer.Exit(UNTESTED)
