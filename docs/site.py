"""Build the documentation site from the pages of the repository: `python -m docs.site [--out site] [--serve]`.

Pages, figures, examples and scripts keep their places, so that links hold here as they do in the repository. Formulas
become MathML, which browsers draw without a script. Links that lead nowhere are errors.
"""

import argparse
import logging
import re
import shutil
import sys
import tempfile
from html import unescape
from pathlib import Path

import yaml
from latex2mathml.converter import convert
from mkdocs.commands.build import build
from mkdocs.commands.serve import serve
from mkdocs.config import load_config
from mkdocs.exceptions import Abort

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "LICENSE", "CITATION.cff", "pyproject.toml")
FOLDERS = ("docs", "examples", "missions/scripts", "benchmarks/results", "bridge/wire")
KINDS = {".md", ".png", ".gif", ".py", ".ipynb", ".json", ".xml", ".svg"}
FORMULA = re.compile(r'<(span|div) class="arithmatex">(?:\\\(|\\\[)(.*?)(?:\\\)|\\\])</\1>', re.DOTALL)
API = """# Python reference

    import cablequad as cq

Every name below is `cq.NAME`, imported when it is first used.

"""


def gathered(folder: Path) -> None:
    """What the site is made of, in `folder`."""
    for name in PAGES:
        shutil.copyfile(ROOT / name, folder / name)
    for name in FOLDERS:
        for path in sorted((ROOT / name).rglob("*")):
            if path.suffix in KINDS and "__pycache__" not in path.parts and path.name != "index-page.md":
                target = folder / path.relative_to(ROOT)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, target)
    (folder / "docs" / "api.md").write_text(api_page(), encoding="utf-8")


def api_page() -> str:
    """A page with every name that `import cablequad` offers, by the module that it is from."""
    from cablequad import _FROM

    entries = sorted((module, name) for name, module in _FROM.items())
    order = sorted(entries, key=lambda entry: (entry[0] != "missions.api", entry))
    return API + "".join(f"::: {module}.{name}\n    options:\n      heading: cq.{name}\n\n" for module, name in order)


def on_page_content(html: str, **_: object) -> str:
    """A page's HTML with its formulas as MathML; mkdocs calls it, of `hooks`, by this name."""

    def formula(match: re.Match[str]) -> str:
        block = "block" if match[1] == "div" else "inline"
        return convert(unescape(match[2]).strip(), display=block)

    return FORMULA.sub(formula, html)


def main() -> None:
    """Build it, or serve it on this machine."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "site")
    parser.add_argument("--serve", action="store_true", help="on 127.0.0.1:8000, until Ctrl-C")
    asked = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, format="docs.site: %(message)s")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "pages").mkdir()
        gathered(folder / "pages")
        settings = yaml.safe_load((ROOT / "docs" / "mkdocs.yml").read_text(encoding="utf-8"))
        handlers = next(p["mkdocstrings"] for p in settings["plugins"] if isinstance(p, dict))["handlers"]
        handlers["python"]["paths"] = [str(ROOT)]
        settings |= {"hooks": [__file__], "docs_dir": "pages", "site_dir": str(asked.out.resolve())}
        config = folder / "mkdocs.yml"
        config.write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
        try:
            if asked.serve:
                serve(str(config), dev_addr="127.0.0.1:8000")
                return
            build(load_config(str(config)))
        except Abort as error:
            sys.exit(f"docs.site: {error}")


if __name__ == "__main__":
    main()
