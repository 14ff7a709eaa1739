"""The columns of a log in their shapes and with their units, by what the schema says of each field."""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from logs.reading.extras import extra
from logs.reading.reader import Run
from logs.schema.topics import TOPICS

if TYPE_CHECKING:
    import pandas as pd

MESSAGES: dict[str, str] = {topic: kind.DESCRIPTOR.name for topic, kind in TOPICS.items()}
_MESSAGE = re.compile(r"^message (\w+) \{(.*?)^\}", re.MULTILINE | re.DOTALL)
_FIELD = re.compile(r"^ *(?:repeated )?\w+ (\w+) = \d+; *// *(.*)$", re.MULTILINE)
_SHAPE = re.compile(r"^\(([\w, ]+)\) *(.*)$")


class Field(NamedTuple):
    """What the schema says of a field."""

    shape: tuple[str, ...]  # of one message: numbers, n vehicles, L links, d ticks of delay
    says: str  # its unit, frame and meaning


@cache
def fields() -> dict[str, dict[str, Field]]:
    """Every message of the schema: its fields."""
    text = resources.files("logs.schema").joinpath("cablequad.proto").read_text(encoding="utf-8")
    return {name: dict(_fields(body)) for name, body in _MESSAGE.findall(text)}


def _fields(body: str) -> Iterator[tuple[str, Field]]:
    for name, comment in _FIELD.findall(body):
        shaped = _SHAPE.match(comment)
        shape = tuple(part.strip() for part in shaped[1].split(",")) if shaped else ()
        yield name, Field(shape, shaped[2] if shaped else comment)


class Arrays(Mapping[str, np.ndarray]):
    """Arrays by name, each with an instant a row."""

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        self._arrays = dict(arrays)

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def to_pandas(self) -> "pd.DataFrame":
        """A table with an instant a row and `t` for its index; an array's numbers are columns name_0, name_1_2, ...

        Indexes start at 0. Raises ImportError where pandas is not installed.
        """
        with extra():
            import pandas as pd
        return pd.DataFrame(dict(self._flat()), index=pd.Index(self["t"], name="t"))

    def _flat(self) -> Iterator[tuple[str, np.ndarray]]:
        for name, values in self._arrays.items():
            if name != "t":
                for at in np.ndindex(values.shape[1:]):
                    yield "_".join((name, *map(str, at))), values[(slice(None), *at)]


class Topic(Arrays):
    """The messages of one topic as arrays by field, each (t, ...) in the field's shape; `says` has their units."""

    def __init__(self, name: str, columns: Mapping[str, np.ndarray], sizes: Mapping[str, int], release_ns: int) -> None:
        """`sizes` of n and L; `t` is the time since the release, s."""
        self.name = name
        known = fields().get(MESSAGES.get(name, ""), {})
        self.says = {field: known[field].says for field in columns if field in known}
        self.says["t"] = "s since the release"
        shaped = {f: _shaped(a, known[f].shape if f in known else (), sizes) for f, a in columns.items()}
        super().__init__({"t": (columns["sim_time_ns"] - release_ns) * 1e-9, **shaped})

    def __repr__(self) -> str:
        rows = len(next(iter(self._arrays.values()))) if self._arrays else 0
        inside = ", ".join(f"{name} {tuple(a.shape[1:])}" for name, a in self._arrays.items())
        return f"Topic({self.name}, {rows} messages: {inside})"


def topics(run: Run) -> dict[str, Topic]:
    """The topics of a log that are tables of numbers."""
    plant, control = run.columns.get("/plant/state", {}), run.columns.get("/control/state", {})
    n = _width(plant.get("quad_position"), 3) or _width(control.get("Psi"), 1)
    L = _width(plant.get("link_direction", control.get("link_direction")), 3 * n) if n else 0
    return {name: Topic(name, columns, {"n": n, "L": L}, run.release_ns) for name, columns in run.columns.items()}


def _width(column: Any, each: int) -> int:
    return 0 if column is None or column.ndim < 2 else int(column.shape[1]) // each


def _shaped(column: np.ndarray, shape: tuple[str, ...], sizes: Mapping[str, int]) -> np.ndarray:
    """`column` (t, k) as (t, *shape); what does not fit stays as it is."""
    if len(shape) < 2 or column.ndim != 2:
        return column
    whole = [int(part) if part.isdigit() else sizes.get(part, -1) for part in shape]  # -1: whatever is left
    known = int(np.prod([size for size in whole if size > 0]))
    if 0 in whole or column.shape[1] % known or (-1 not in whole and column.shape[1] != known):
        return column
    return column.reshape(len(column), *whole)
