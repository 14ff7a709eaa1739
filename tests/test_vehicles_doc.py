"""Every behaviour that is documented has a test that exists, and the page is what its table says."""

import ast
from pathlib import Path

import pytest

from docs.vehicles import HERE, LEFT_OUT, SECTIONS, Row, page

TESTS = Path(__file__).parent
ROWS = [row for rows in SECTIONS.values() for row in rows]


def names(file: str) -> set[str]:
    """`test_x` and `TestY::test_x` of a file."""
    out = set()
    for node in ast.parse((TESTS / file).read_text()).body:
        if isinstance(node, ast.FunctionDef):
            out.add(node.name)
        elif isinstance(node, ast.ClassDef):
            out |= {f"{node.name}::{f.name}" for f in node.body if isinstance(f, ast.FunctionDef)}
    return out


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.what)
def test_each_row_names_a_test_for_each_persona_or_says_why_not(row: Row) -> None:
    for test in (row.px4_test, row.arducopter_test):
        if test.startswith(LEFT_OUT):
            assert len(test) > len(LEFT_OUT) + 10
        else:
            file, _, name = test.partition("::")
            assert name in names(file), test


def test_the_rows_are_those_of_the_firmware_facts() -> None:
    """Sections 2 to 4: eight fields and seven masks, what thrust means, bad input, modes and acks, heartbeat, streams;

    and the position targets that clients send.
    """
    assert [len(rows) for rows in SECTIONS.values()] == [18, 8, 11, 31]
    left_out = sum(t.startswith(LEFT_OUT) for row in ROWS for t in (row.px4_test, row.arducopter_test))
    assert left_out <= 12


def test_the_page_is_what_the_table_writes() -> None:
    assert (HERE / "vehicles.md").read_text() == page()
