"""Programs that Blender starts open no console windows on Windows."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
STARTS = {"Popen", "run", "call", "check_call", "check_output"}


def starts_of(path: Path) -> list[ast.Call]:
    """The calls of `subprocess` in a file that start a program."""
    calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    named = [call for call in calls if isinstance(call.func, ast.Attribute) and isinstance(call.func.value, ast.Name)]
    return [call for call in named if call.func.value.id == "subprocess" and call.func.attr in STARTS]


@pytest.mark.parametrize("folder", ["addon", "backend"])
def test_no_program_opens_a_window(folder):
    found = [(path, call) for path in sorted((ROOT / folder).rglob("*.py")) for call in starts_of(path)]
    assert found or folder == "addon"
    opens = [
        f"{path.relative_to(ROOT)}:{call.lineno}"
        for path, call in found
        if "creationflags" not in {keyword.arg for keyword in call.keywords}
    ]
    assert not opens, "without CREATE_NO_WINDOW"
