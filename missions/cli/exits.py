"""How commands end: exit codes, and the one line that says why."""

import sys
from typing import NoReturn

import typer

FAILED, USAGE, UNTESTED, INTERRUPTED = 1, 2, 3, 130


def usage(text: str) -> NoReturn:
    """End as a command that was called wrongly."""
    print(f"cablequad: {text}", file=sys.stderr)
    raise typer.Exit(USAGE)


def fail(text: str) -> NoReturn:
    """End as a command that could not do what was asked."""
    print(f"cablequad: {text}", file=sys.stderr)
    raise typer.Exit(FAILED)


def untested(text: str) -> NoReturn:
    """End as a command that the computer could not carry out."""
    print(f"cablequad: {text}", file=sys.stderr)
    raise typer.Exit(UNTESTED)
