"""Packages that only some of what can be done needs, and the extra of cablequad that brings each."""

from collections.abc import Iterator
from contextlib import contextmanager

EXTRAS = {
    "matplotlib": "report", "pyarrow": "parquet", "pandas": "pandas", "rerun_notebook": "notebook",
    "anywidget": "notebook", "ipywidgets": "notebook", "IPython": "notebook",
}  # fmt: skip


def missing(error: ImportError) -> str | None:
    """What to install, where a module was looked for that an extra brings; None where it is another one."""
    package = (error.name or "").split(".")[0]
    if package not in EXTRAS:
        return None
    return f"{package} is not installed; it comes with: pip install 'cablequad[{EXTRAS[package]}]'"


@contextmanager
def extra() -> Iterator[None]:
    """Within it a package of an extra is imported. Raises ImportError that says how to install it."""
    try:
        yield
    except ImportError as error:
        if (said := missing(error)) is None:
            raise
        raise ImportError(said, name=error.name) from None
