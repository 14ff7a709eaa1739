"""Write the dialect module of `cablequad.xml`: `python -m bridge.wire.generate [OUT]`."""

import sys
import tempfile
from pathlib import Path

from pymavlink.generator import mavgen

HERE = Path(__file__).parent
MODULE = HERE / "cable_dialect.py"


def generate() -> str:
    """The module's source, as pymavlink's generator writes it."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "cable_dialect.py"
        options = mavgen.Opts(str(out), wire_protocol="2.0", language="Python3", validate=False, strict_units=False)
        mavgen.mavgen(options, [str(HERE / "cablequad.xml")])
        lines = out.read_text().splitlines()
    return "\n".join(line.rstrip() for line in lines).rstrip() + "\n"


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else MODULE
    target.write_text(generate())
