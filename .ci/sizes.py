"""How large functions, classes and calls may be; what is larger stands here, with its reason."""

import ast
import sys
from pathlib import Path

LINES, PARAMETERS, ATTRIBUTES, POSITIONAL = 50, 8, 15, 6
PACKAGES = ("cablequad", "bridge", "sitl", "logs", "missions")
GENERATED = {"cable_dialect.py", "cablequad_pb2.py"}

EQUATION = "one set of equations in the order of the paper"
OPTIONS = "the options of a command, as typer wants them"
TABLE = "one row after the other, no logic"
COMPILED = "compiled code takes no values by keyword"

LARGE = {  # function or class: why
    "bridge/wire/batches.py:_framed": COMPILED,
    "cablequad/environment/untethered.py:fly_untethered": COMPILED,
    "cablequad/model/dynamics.py:_solve_payload": EQUATION,
    "cablequad/model/system.py:System.of": EQUATION,
    "logs/views/replay_layout.py:layout": TABLE,
    "logs/writing/layout.py:records": COMPILED,
    "missions/analysis/check.py:check": TABLE,
    "missions/analysis/check_page.py:show": TABLE,
    "missions/cli/before_flight.py:identify": OPTIONS,
    "missions/cli/main.py:fly": OPTIONS,
    "missions/cli/main.py:sitl": OPTIONS,
}
ROWS = {
    "State", "Tangent", "Scratch", "Workspace", "Places", "Formation", "Sample", "_Decision", "Memory", "Attitude",
    "Whole", "World", "Ground", "Surroundings", "Rotors", "SwingDamping", "Certificate", "Margins", "MotionHistory",
    "Run", "Report", "Snapshot", "Received", "PositionTarget", "AttitudeTarget", "Followed", "Weights", "Grades",
    "Failure", "Faults", "Flight", "GuardInputs", "FaultInputs", "MissionPlan", "Options", "LoopModel", "Plant",
    "Recorder", "Known", "snapshot", "FleetOptions", "Profile", "TickStatistics",
}  # records, whose fields stand in the order of their definition  # fmt: skip
LAYOUTS = {
    "packed", "pack", "odometry", "attitude", "layout.records", "_envelope", "Grid", "add_row", "records",
}  # bytes and rows in their order  # fmt: skip
CALLS = {
    "advance_on", "commands", "fly", "fly_each", "fly_untethered", "_framed", "_corner", "_push",
}  # compiled code  # fmt: skip


def attributes(node: ast.ClassDef) -> int:
    """What a class's methods set of itself."""
    found = {
        n.attr
        for n in ast.walk(node)
        if isinstance(n, ast.Attribute)
        and isinstance(n.ctx, ast.Store)
        and isinstance(n.value, ast.Name)
        and n.value.id == "self"
    }
    return len(found)


def names(tree: ast.Module) -> list[tuple[str, ast.AST]]:
    """Functions and classes with their names, methods as Class.method."""
    out: list[tuple[str, ast.AST]] = []
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            out.append((node.name, node))
        if isinstance(node, ast.ClassDef):
            out += [
                (f"{node.name}.{m.name}", m) for m in node.body if isinstance(m, ast.FunctionDef | ast.AsyncFunctionDef)
            ]
    return out


def main() -> int:
    """Print what is too large, or needs no exception any more; exit code 1 where there is any."""
    wrong, used = [], set()
    for package in PACKAGES:
        for path in sorted(Path(package).rglob("*.py")):
            if path.name in GENERATED:
                continue
            tree = ast.parse(path.read_text(encoding="utf-8"))
            for name, node in names(tree):
                why = []
                if isinstance(node, ast.ClassDef):
                    if attributes(node) > ATTRIBUTES:
                        why.append(f"{attributes(node)} attributes")
                elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                    lines = (node.end_lineno or 0) - node.lineno + 1
                    given = [
                        a for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs) if a.arg != "self"
                    ]
                    why += [f"{lines} lines"] if lines > LINES else []
                    why += [f"{len(given)} parameters"] if len(given) > PARAMETERS else []
                key = f"{path}:{name}"
                if why and key in LARGE:
                    used.add(key)
                elif why:
                    wrong.append(f"{key}: {', '.join(why)}")
            for call in ast.walk(tree):
                if isinstance(call, ast.Call):
                    given = [a for a in call.args if not isinstance(a, ast.Starred)]
                    who = ast.unparse(call.func)
                    known = who.split(".")[-1] in ROWS | LAYOUTS | CALLS
                    if len(given) > POSITIONAL and not known:
                        wrong.append(f"{path}:{call.lineno}: {who} with {len(given)} positional arguments")
    wrong += [f"{key}: needs no exception any more" for key in sorted(LARGE.keys() - used)]
    print("\n".join(wrong) or f"sizes: nothing larger than allowed but {len(LARGE)} exceptions")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
