"""Every message has words, in the terminal and in the panel, and its words fit the values that the library gives."""

from __future__ import annotations

import ast
import functools
import string
from pathlib import Path

import pytest

from backend.engine import progress, words
from backend.engine.results import capture_facts
from blender_nep import errors, messages
from blender_nep.batch.progress import STAGE as BATCH
from blender_nep.job.stage_names import CAMERA_SEARCH, StageName
from blender_nep.messages import PARTS, WORDS, Message, Part
from support.paths import ROOT

LIBRARY = ROOT / "blender_nep"


def calls() -> list[tuple[Path, ast.Call, str]]:
    """Every call in the library of something that has a name, and that name."""
    found = []
    for path in sorted(LIBRARY.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                found.append((path, node, node.func.id))
    return found


@functools.cache
def emitted() -> dict[str, set[frozenset[str]]]:
    """{code: the names of its values at each place where the library makes such a message}."""
    found: dict[str, set[frozenset[str]]] = {}
    for path, call, name in calls():
        if name != "Message":
            continue
        where = f"{path.name}:{call.lineno}"
        code = call.args[0]
        assert isinstance(code, ast.Constant), f"{where}: the code must stand there, so that this test can read it"
        values: frozenset[str] = frozenset()
        if len(call.args) > 1:
            values = frozenset(names_of(call.args[1], path, call.lineno))
        found.setdefault(code.value, set()).add(values)
    return found


def names_of(values: ast.expr, path: Path, line: int) -> list[str]:
    """The keys of the dict of values, which stands in the call, or in the assignment above it."""
    if isinstance(values, ast.Name):
        assigned = [
            node
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == values.id and node.lineno <= line
        ]
        values = max(assigned, key=lambda node: node.lineno).value
    assert isinstance(values, ast.Dict), f"{path.name}:{line}: the values must be a dict that this test can read"
    return [ast.literal_eval(key) for key in values.keys]


def placeholders(template: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(template) if name}


def test_every_code_has_words_and_no_words_are_without_a_code():
    codes = set(emitted())
    assert len(codes) > 60
    assert set(WORDS) == codes and set(words.MESSAGES) == codes


@pytest.mark.parametrize("table", [WORDS, words.MESSAGES], ids=["terminal", "panel"])
def test_words_name_the_values_that_the_library_gives(table):
    for code, places in emitted().items():
        for values in places:
            assert placeholders(table[code]) <= values, code
            if table is WORDS:
                assert placeholders(table[code]) == values, code


def sample(name: str):
    """A value as the library gives it under this name."""
    lists = {"names": [f"{n:03d}.exr" for n in range(8)], "parts": [str(Part.VOTES), str(Part.RESIDUAL)]}
    texts = {"reason": Message("reason.metal"), "file": "surface.done.pt"}
    return lists.get(name) or texts.get(name) or {"percent": 0.5, "object_percent": 34.0}.get(name, 2)


def test_words_can_be_filled_in():
    for code in sorted(WORDS):
        message = Message(code, {name: sample(name) for name in placeholders(WORDS[code])})
        said = words.EngineMessage.of(message.to_dict())
        for text in (str(message), said.words()):
            assert text and not set("{}|") & set(text) and "None" not in text, text
        assert said.message == str(message)
        assert said.words("<{}>".format).startswith("<") and said.words("<{}>".format).endswith(">"), code
        if code.split(".")[0] in ("capture", "job", "scene"):
            assert not said.words()[0].islower(), f"{code}: warnings and sentences begin with a capital letter or a number"


def test_parts_have_words_and_are_used():
    used = {
        node.attr
        for path in LIBRARY.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "Part"
        if path != Path(messages.__file__)
    }
    assert used == set(Part.__members__)
    assert set(PARTS) == set(Part) and set(words.PARTS) == set(Part)


def test_the_panel_has_words_for_no_error_that_cannot_be():
    classes = {name: found for name, found in vars(errors).items() if isinstance(found, type)}
    named = {found.name for found in classes.values() if issubclass(found, errors.NepError)}
    for path in LIBRARY.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.count(".") == 1:
                first = node.value.split(".")[0]
                if first in named and node.value.replace(".", "").replace("_", "").isalpha():
                    named.add(node.value)
    named -= set(WORDS)
    assert set(words.ERRORS) - named == {"engine.missing"}, "the last one is said by backend/engine itself"
    assert "output.disk_full" in named and len(named) > 20


def test_the_stages_have_the_same_names_on_both_sides():
    assert list(progress.STAGES) == [*StageName, CAMERA_SEARCH, BATCH]


def test_one_and_many():
    def black(count: int) -> Message:
        return Message("capture.photos_black", {"count": count, "names": [f"{n}.png" for n in range(count)]})

    assert str(black(1)) == "1 photo is black and is left out: 0.png"
    assert str(black(7)) == "7 photos are black and are left out: 0.png, 1.png, 2.png, 3.png, 4.png and 2 more"
    assert words.EngineMessage.of(black(7).to_dict()).words() == str(black(7))


def test_all_that_is_inserted_can_be_translated():
    told = Message("scene.left_out", {"parts": ["unseen light", "irradiance"], "reason": Message("reason.metal")}).to_dict()
    translated = {
        "Left out: {parts:parts}, because {reason}.": "Fort: {parts:parts}, denn {reason}.",
        "the object is metal": "das Objekt ist Metall",
        "diffuse light": "diffuses Licht",
    }
    assert words.EngineMessage.of(told).words(lambda text: translated.get(text, text)) == (
        "Fort: light that no photo shows, diffuses Licht, denn das Objekt ist Metall."
    )


def test_a_message_survives_the_disk():
    message = Message("capture.photos_black", {"count": 1, "names": ["a.png"]})
    assert Message.from_state(message.state()) == message


@pytest.mark.parametrize(
    "told",
    [
        {"code": "scene.of_tomorrow", "values": {"moons": 2}, "message": "it has two moons"},
        {"code": "scene.surroundings", "values": {"pictures": 2}, "message": "it has two moons"},
        {"code": "scene.surroundings", "values": None, "message": "it has two moons"},
        {"code": "scene.sphere_size", "values": {"pixels": "many", "percent": []}, "message": "it has two moons"},
        {"message": "it has two moons"},
        "it has two moons",
    ],
)
def test_an_unknown_message_is_shown_in_the_engines_words(told):
    assert words.EngineMessage.of(told).words() == "It has two moons"


def test_an_unknown_reason_is_shown_in_the_engines_words():
    reason = {"code": "reason.of_tomorrow", "values": {}, "message": "it is Sunday"}
    left_out = {"code": "scene.left_out", "values": {"parts": ["the moons"], "reason": reason}, "message": "-"}
    assert words.EngineMessage.of(left_out).words() == "Left out: the moons, because it is Sunday."


def test_errors_in_the_words_of_the_panel():
    error = errors.OutputError("the disk is full: /a cannot be written", "--resume", "output.disk_full", path="/a").to_dict()
    shown = words.error_words(error["name"], error["values"], error["message"], error["hint"])
    assert shown == ("The disk is full: /a cannot be written", "Free some space, then Resume.")
    assert words.error_words("output", {}, "no", "use --out") == ("No", "Choose another output folder.")
    assert words.error_words("new.failure", {}, "no", "use --out") == ("No", "Use --out")
    assert words.error_words("output.disk_full", {}, "no", "use --out") == ("No", "Free some space, then Resume.")


def test_the_panel_speaks_of_no_command_line():
    assert not [
        text
        for text in (*words.texts(), *progress.texts(), *capture_facts.texts())
        if "--" in text or "transforms.json" in text
    ]
    assert len(set(words.texts())) == len(words.texts())
