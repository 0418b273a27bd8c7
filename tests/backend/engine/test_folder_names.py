"""Names of objects: the engine and Blender's Python accept the same ones."""

import random
from pathlib import Path

import pytest

from backend.engine import folder_names as blenders
from blender_nep.batch.names import object_name
from blender_nep.safety import folder_names as engines

GOOD = ("vase", "vase-2", "große_Vase", "con_old", "console", "vase 100% #2 é", "花瓶", "a.b", "com10", "x" * 200)
BAD = (
    *("", ".", "..", "../victim", "/etc", "a/b", "a\\b", "C:", "C:\\a", "a:b", ".hidden", "a.", "a ", "a\n", "a\0", "\x7f"),
    *("nul", "NUL.txt", "con.tar.gz", "Com1", "lpt9.x", "com¹", "conin$", "aux .x", "a*", 'a"', "a|b", "<a>", "a?"),
    *("x" * 201, "é" * 101, "\ud800", None, 7, ["a"]),
)


@pytest.mark.parametrize("name", GOOD)
def test_names_of_folders(name):
    assert engines.is_folder_name(name) and blenders.is_folder_name(name)


@pytest.mark.parametrize("name", BAD, ids=ascii)
def test_names_that_are_none_of_a_folder(name):
    assert not engines.is_folder_name(name) and not blenders.is_folder_name(name)


def test_both_sides_agree_and_the_engine_makes_only_such_names():
    draw, letters = random.Random(0), [*"aXé花𐍈. -_/\\:*<>|?\"'$\n\t\x7f", "con", "nul", "com1", "..", "\ud800", "gallery"]
    for _ in range(5000):
        name = "".join(draw.choices(letters, k=draw.choice((1, 2, 3, 5, 60))))
        assert engines.is_folder_name(name) == blenders.is_folder_name(name)
        made = object_name(Path("/captures") / name.replace("/", ""), {"con", "object"})
        assert engines.is_folder_name(made), (name, made)
