"""The languages of the panel: every label has a translation, with the same values, and no text stands there for nothing."""

import ast
import string
import sys
from pathlib import Path

from support.own_process import in_blender
from support.paths import ROOT

SHOWN = {"text", "placeholder", "heading"}


def labels() -> set[str]:
    """The texts of labels, buttons and panels in the source."""
    found = set()
    for path in (ROOT / "addon").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.keyword) and node.arg in SHOWN:
                found |= literals(node.value)
            elif isinstance(node, ast.Assign) and [getattr(name, "id", "") for name in node.targets] == ["bl_label"]:
                found |= literals(node.value)
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "fitting":
                found |= set().union(*map(literals, node.args))
    return {text for text in found if any(letter.isalpha() for letter in text)}


def literals(node: ast.AST) -> set[str]:
    return {node.value} if isinstance(node, ast.Constant) and isinstance(node.value, str) else set()


NOT_YET = {
    "Photos or Result of a Glossy Object",  # Blender shows it only beside other handlers of .json files
    "Asking the Python; the first time this takes half a minute",
    "choose a Python 3.11, 3.12 or 3.13 as Base Python.",
}


def test_the_panel_has_all_its_labels_in_all_languages(package):
    in_blender(check_languages, package)


def check_languages(folder):
    from nep_addon.addon.languages import LANGUAGES
    from nep_addon.backend.engine import progress
    from nep_addon.backend.engine.results import capture_facts

    said = strings()
    first = None
    for language, texts in LANGUAGES.items():
        first = first or texts.keys()
        assert texts.keys() == first, language
        assert labels() - NOT_YET <= texts.keys(), labels() - NOT_YET - texts.keys()
        assert {*progress.texts(), *capture_facts.texts()} <= texts.keys()
        for english, text in texts.items():
            assert fields(english) == fields(text), (language, english)
            assert english in said, f"nobody says: {english}"


def strings() -> set[object]:
    """All constants of the sources: neighbors that Python joins are one string."""
    files = [path for place in ("addon", "backend") for path in (ROOT / place).rglob("*.py")]
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in files if path.parent.name != "languages"]
    return {node.value for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant)}


def fields(text: str) -> list[tuple[str, str]]:
    return sorted((name, how) for _, name, how, _ in string.Formatter().parse(text) if name is not None)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]))
