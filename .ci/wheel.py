"""What a built wheel holds: `python .ci/wheel.py FILE.whl` fails where something is missing or too much."""

import re
import sys
import zipfile

NEEDED = (
    "bridge/wire/cablequad.xml", "logs/schema/cablequad.proto", "missions/scenarios/paper-case-1.toml",
    "missions/scripts/there_and_back.py", "cablequad/py.typed", "missions/py.typed", "cablequad/__main__.py",
)  # fmt: skip
OURS = ("cablequad", "sitl", "bridge", "logs", "missions")


def main() -> None:
    """Say what is wrong, if anything."""
    with zipfile.ZipFile(sys.argv[1]) as wheel:
        names = wheel.namelist()
        metadata = wheel.read(next(n for n in names if n.endswith("METADATA"))).decode()
    missing = [name for name in NEEDED if name not in names]
    foreign = sorted({n.split("/")[0] for n in names} - {*OURS, names[-1].split("/")[0]})
    wrong = [f"{name}: not in it" for name in missing] + [f"{name}: does not belong into it" for name in foreign]
    if re.search(r"\]\((?!https?:)", metadata):
        wrong.append("README: a relative link, which leads nowhere on an index page")
    if wrong:
        sys.exit(f"{sys.argv[1]}: " + "; ".join(wrong))
    print(f"{sys.argv[1]}: {len(names)} files")


main()
