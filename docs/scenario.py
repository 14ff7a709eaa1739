"""Write docs/scenario.md, every key of a scenario file, from its tables: `python -m docs.scenario`."""

import ast
import inspect
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from missions.scenario import tables
from missions.scenario.tables import Scenario

HERE = Path(__file__).parent
HEAD = """# Scenario files

A scenario is a TOML file; `cablequad scenarios show NAME > mine.toml` is a starting point, and
`cablequad check mine.toml` says what is wrong in one. Units are in the names of keys. World frame NED (z down), body
frames FRD. A key that is not known is an error, so is a number that is not finite.

"""
UNITS = {
    "_kg_m2": "kg m²", "_m_s2": "m/s²", "_m_s3": "m/s³", "_rad_s": "rad/s", "_deg_s": "deg/s", "_kg_m3": "kg/m³",
    "_m_s": "m/s", "_m2": "m²", "_bytes_s": "B/s", "_gauss": "gauss", "_hPa": "hPa", "_deg": "deg", "_kg": "kg",
    "_hz": "Hz", "_ms": "ms", "_m": "m", "_s": "s", "_N": "N",
}  # fmt: skip


def page() -> str:
    """The whole page."""
    return "".join([HEAD, *_sections(Scenario, "")])


def _sections(model: type[BaseModel], path: str) -> list[str]:
    said = inspect.cleandoc(model.__doc__ or "").split(":", 1)
    title = "Top level" if not path else f"`{path}`"
    text = said[1].strip() if len(said) > 1 and path else ""
    meanings = _meanings(model)
    rows, below = [], []
    for key, field in model.model_fields.items():
        inner = _table(field.annotation)
        if inner is not None:
            model_below, many = inner
            name = f"{path.strip('[]')}.{key}".lstrip(".")
            heading = f"[[{name}]]" if many else f"[{name}]"
            below += _sections(model_below, heading)
        kind, default = _kind(field.annotation, list(field.metadata)), _default(field)
        if inner is not None:
            kind = f"[{'tables' if inner[1] else 'table'}](#{name.replace('.', '')})"
        rows.append(f"| `{key}` | {kind} | {_unit(key)} | {default} | {meanings.get(key, '').replace('|', '/')} |\n")
    head = f"## {title}\n\n{text}\n\n" if text else f"## {title}\n\n"
    table = "| key | value | unit | left out | |\n|---|---|---|---|---|\n"
    return [head, table, *rows, "\n", *below]


def _meanings(model: type[BaseModel]) -> dict[str, str]:
    """What the comment behind each key says."""
    lines = inspect.getsource(tables).splitlines()
    tree = ast.parse("\n".join(lines))
    found = next(node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == model.__name__)
    out = {}
    for node in found.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            line = lines[(node.end_lineno or 0) - 1][node.end_col_offset or 0 :]
            out[node.target.id] = line.replace("# fmt: skip", "").strip().removeprefix("#").strip()
    return out


def _table(kind: Any) -> tuple[type[BaseModel], bool] | None:
    """The table that a key holds, and whether it is a list of them."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return kind, False
    for inner in get_args(kind):
        if (found := _table(inner)) is not None:
            return found[0], found[1] or get_origin(kind) is list
    return None


def _kind(kind: Any, more: list[Any]) -> str:
    """What a value may be, in words."""
    origin, inside = get_origin(kind), get_args(kind)
    more = [m for entry in more for m in (entry.metadata if isinstance(entry, FieldInfo) else [entry])]
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(_kind(k, more) for k in inside if k is not type(None)))
    if _table(kind) is not None:
        return "table"
    if hasattr(kind, "__metadata__"):
        return _kind(inside[0], [*kind.__metadata__, *more])
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in inside)
    if origin is list:
        least = next((m.min_length for m in more if isinstance(m, MinLen)), 0)
        most = next((m.max_length for m in more if isinstance(m, MaxLen)), None)
        count = "" if not least and most is None else f"{least} " if least == most else f"{least} or more "
        return f"{count}x {_kind(inside[0], [])}" if count else f"list of {_kind(inside[0], [])}"
    if origin is dict:
        return f"table of {_kind(inside[1], [])}"
    name = {float: "number", int: "integer", str: "text", bool: "true or false"}[kind]
    signs = ((Gt, "gt", ">"), (Ge, "ge", "≥"), (Lt, "lt", "<"), (Le, "le", "≤"))
    said = [f"{sign} {getattr(m, at):.10g}" for m in more for of, at, sign in signs if isinstance(m, of)]
    return " ".join([name, *dict.fromkeys(said)])


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "needed"
    value = field.get_default(call_default_factory=True)
    if value is None or isinstance(value, BaseModel) or value in ({}, [], ""):
        return ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def _unit(key: str) -> str:
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")


if __name__ == "__main__":
    (HERE / "scenario.md").write_text(page(), encoding="utf-8")
