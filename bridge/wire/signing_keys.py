"""Signing keys in files that only their owner can read."""

import os
import secrets
import stat
from pathlib import Path


class KeyFileError(Exception):
    """A key file that cannot be used; the message names it and says what to do."""


def read_key(path: Path) -> bytes:
    """The 32 bytes in `path`: as they are, or as 64 hexadecimal digits. Raises KeyFileError."""
    try:
        mode = path.stat().st_mode
        data = path.read_bytes()
    except OSError as error:
        raise KeyFileError(
            f"signing key {path}: {error.strerror}; make one with `cablequad signing-key {path}`"
        ) from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise KeyFileError(f"signing key {path}: others may read it (mode {mode & 0o777:o}); do `chmod 600 {path}`")
    if len(data) != 32:
        try:
            data = bytes.fromhex(data.decode("ascii").strip())
        except ValueError:
            data = b""
    if len(data) != 32:
        raise KeyFileError(f"signing key {path}: 32 bytes or 64 hexadecimal digits are needed")
    return data


def write_key(path: Path) -> None:
    """A new key in a new file of mode 600. Raises KeyFileError where the file exists or cannot be made."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise KeyFileError(f"signing key {path}: {error.strerror}; choose another name") from None
    with os.fdopen(descriptor, "w") as file:
        file.write(secrets.token_hex(32) + "\n")
