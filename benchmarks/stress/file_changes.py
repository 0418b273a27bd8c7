"""Random changes of a file's content: bits, lengths, and values of JSON and text."""

from __future__ import annotations

import json
import math
import random
import re
from collections.abc import Iterator
from typing import Any

CHANGES = {
    "bits": "some bits are turned",
    "bytes": "some bytes are replaced",
    "cut": "the end is missing",
    "longer": "there is more at the end",
    "zeros": "a part is zero",
    "twice": "a part is there twice",
    "length": "a whole number of 2, 4 or 8 bytes is very large",
    "nothing": "the file is empty",
    "value": "a value of JSON or of text is another one",
    "missing": "a value of JSON or a line of text is missing",
}
"""{how a file is changed: what that does}"""
_VALUES: list[Any] = [
    *(
        math.nan,
        math.inf,
        -math.inf,
        1e308,
        -1e308,
        1e-308,
        0,
        -1,
        2**31,
        2**63,
        10**400,
        0.5,
        None,
        True,
        "",
        "text",
        "nan",
    ),
    *([], {}, [[]], [1, 2, 3], "x" * 100_000, "\0", "../../../etc/passwd", "\\\\server\\share\\a.png"),
]
_WORDS = [
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e999",
    "0",
    "-1",
    "",
    "x",
    "9" * 400,
    "1,5",
    "0x10",
    "\u0661",
    "2147483648",
]
_DEEP = 20_000
_BYTES = re.compile(rb"[-+]?[0-9][-+.0-9eE]*")


def changed(content: bytes, change: str, draw: random.Random) -> bytes:
    """The content of a file with a change of CHANGES."""
    data, size = bytearray(content), len(content)
    if change == "nothing" or not size:
        return b""
    if change in ("value", "missing"):
        return _other_json(content, change, draw) or _other_text(content, change, draw)
    start = draw.randrange(size)
    length = 1 + draw.randrange(max(1, min(size - start, 1 + size // 8)))
    if change == "bits":
        for _ in range(1 + draw.randrange(8)):
            data[draw.randrange(size)] ^= 1 << draw.randrange(8)
    elif change == "bytes":
        for _ in range(1 + draw.randrange(8)):
            data[draw.randrange(size)] = draw.randrange(256)
    elif change == "cut":
        del data[start:]
    elif change == "longer":
        data += bytes(1 + draw.randrange(4096)) if draw.random() < 0.5 else draw.randbytes(1 + draw.randrange(64))
    elif change == "zeros":
        data[start : start + length] = bytes(length)
    elif change == "twice":
        data[start:start] = data[start : start + length]
    else:
        at, width = draw.randrange(min(size, 400)), draw.choice([2, 4, 8])
        number = draw.choice([2 ** (8 * width) - 1, 2 ** (8 * width - 1) - 1, 2 ** (8 * width - 2), 2 ** (4 * width)])
        data[at : at + width] = number.to_bytes(width, draw.choice(["little", "big"]))
    return bytes(data)


def _other_json(content: bytes, change: str, draw: random.Random) -> bytes | None:
    """JSON with another value, or without one; None where the content is no JSON."""
    try:
        tree = json.loads(content)
    except ValueError:
        return None
    places = list(_places(tree))
    if not places:
        return b"[" * _DEEP
    holder, key = draw.choice(places)
    if change == "missing":
        del holder[key]
        return json.dumps(tree).encode()
    value = draw.choice([*_VALUES, "deep", "many"])
    if value == "many":
        value = [holder[key]] * 3000
    mark = "the place of the deep value"
    holder[key] = mark if value == "deep" else value
    text = json.dumps(tree)
    return text.replace(json.dumps(mark), "[" * _DEEP + "]" * _DEEP).encode("utf-8", "surrogatepass")


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """(holder, key) of every value in JSON."""
    pairs = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in list(pairs):
        yield tree, key
        yield from _places(value)


def _other_text(content: bytes, change: str, draw: random.Random) -> bytes:
    """Text with another number, or without a line. Other content gets another number, too, where it looks like one."""
    if change == "missing":
        lines = content.split(b"\n")
        del lines[draw.randrange(len(lines))]
        return b"\n".join(lines)
    found = list(_BYTES.finditer(content))
    if not found:
        return content + draw.choice(_WORDS).encode()
    one = draw.choice(found)
    return content[: one.start()] + draw.choice(_WORDS).encode() + content[one.end() :]
