"""What an .xml scene holds, looked at before Mitsuba parses it, and the files that scenes name.

Mitsuba's own parser dies of deep nesting, and reads pipes, devices and what `<include>` and `$name` multiply for ever;
its reader of pictures dies of some headers. None of that is in any scene that is meant to be looked at.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from slepian_prt.errors import UserError
from slepian_prt.lighting.formats.sizes import picture_size
from slepian_prt.lighting.map_rows import check_size
from slepian_prt.machine.file_content import read_content
from slepian_prt.machine.memory import check_memory

# Elements within elements, files that include each other (Mitsuba has 15), files in all, and characters of a value.
_DEEPEST, _DEEPEST_INCLUDE, _MOST_FILES, _LONGEST = 100, 15, 1000, 1 << 16

# Of memory for each byte of .xml, and for each texel of a picture, which Mitsuba keeps as three or four floats.
_BYTES, _TEXEL = 10, 16

_PARAMETER = re.compile(r"(?<!\\)\$(\w+)")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)

# Who looks for pictures in the files that it names.
_PICTURES = ("bitmap", "envmap", "projector")


@dataclass
class _Look:
    """What is known of a scene so far: values of parameters, folders where files are looked for, and what was seen."""

    parameters: dict[str, str]
    folders: list[Path]
    files: int = 0
    found: dict[tuple[str, int], Path | None] = field(default_factory=dict)


def inspect_xml(path: Path, parameters: Mapping[str, str]) -> None:
    """Look at a scene and all that it includes.

    Raises
    ------
    UserError
        XML that is malformed or nested deeply, a document type (entities are never expanded), files that include each
        other in a circle, values that parameters make very long, and files that are pipes or devices.
    """
    _inspect(path, path, _Look(dict(parameters), [path.parent]), 0)


def _inspect(origin: Path, path: Path, look: _Look, depth: int) -> None:
    look.files += 1
    if depth > _DEEPEST_INCLUDE or look.files > _MOST_FILES:
        reason = "files include each other in a circle" if depth > _DEEPEST_INCLUDE else f"over {_MOST_FILES} files"
        raise UserError(f"{origin}: Mitsuba cannot load the scene ({reason}); correct it there")
    content = read_content(path)
    check_memory(_BYTES * len(content), f"{path}: to parse it", "make it smaller")
    # Many have rows of hyphens in comments, which XML does not allow.
    content = _COMMENT.sub(lambda comment: re.sub(rb"[^\n]", b" ", comment[0]), content)
    reader = _Reader(origin, path, look, depth)
    reader.parse(content)


class _Reader:
    """Handlers of one file's elements."""

    def __init__(self, origin: Path, path: Path, look: _Look, depth: int) -> None:
        self.origin, self.path, self.look, self.depth = origin, path, look, depth
        self.nested, self.known_encoding = 0, True
        self.parser = expat.ParserCreate()

    def parse(self, content: bytes) -> None:
        try:
            content.decode("utf-8")
        except UnicodeDecodeError:  # of comments alone; others are refused
            if b"encoding" not in content[:200] and content[:2] not in (b"\xff\xfe", b"\xfe\xff"):
                self.parser = expat.ParserCreate("iso-8859-1")
                self.known_encoding = False
        self.parser.StartElementHandler = self.begin
        self.parser.EndElementHandler = self.end
        self.parser.StartDoctypeDeclHandler = self.refuse_type
        try:
            self.parser.Parse(content, True)
        except expat.ExpatError as error:
            line = error.lineno if content.strip() else 1
            raise self.fault(f"its XML is malformed: {expat.ErrorString(error.code)}", line) from None

    def fault(self, reason: str, line: int | None = None) -> UserError:
        file = "" if self.path == self.origin else f"{self.path}, "
        line = self.parser.CurrentLineNumber if line is None else line
        return UserError(
            f"{self.origin}: Mitsuba cannot load the scene ({file}line {line}: {reason}); correct it there"
        )

    def refuse_type(self, *_: object) -> None:
        raise self.fault("a scene has no document type; remove the DOCTYPE, with its entities")

    def end(self, _: str) -> None:
        self.nested -= 1

    def begin(self, name: str, attributes: dict[str, str]) -> None:
        self.nested += 1
        if self.nested > _DEEPEST:
            raise self.fault(f"elements stand more than {_DEEPEST} deep in each other")
        given = {key: self.expand(value) for key, value in attributes.items()}
        if name == "default" and "name" in given:
            self.look.parameters.setdefault(given["name"], given.get("value", ""))
        elif name == "path":
            self.look.folders += [folder / given.get("value", "") for folder in self.look.folders[:1]]
        elif name == "include":
            found = self.find(given.get("filename", ""))
            if found is not None and stat.S_ISREG(found.stat().st_mode):  # else Mitsuba says what is wrong
                _inspect(self.origin, found, self.look, self.depth + 1)
        elif name == "string":
            self.find(given.get("value", ""))
        elif "filename" in given:
            self.find(given["filename"])

    def expand(self, value: str) -> str:
        """An attribute with the values of its parameters, which were expanded when they were given."""
        if not self.known_encoding and not value.isascii():
            raise self.fault("its text is not UTF-8, and it names no other encoding; save it as UTF-8")
        if "$" not in value:
            return value
        known = self.look.parameters
        length = len(value) + sum(len(known.get(name, "")) for name in _PARAMETER.findall(value))
        if length > _LONGEST:
            raise self.fault(f"its parameters make a value of {length} characters")
        return _PARAMETER.sub(lambda match: known.get(match[1], match[0]), value)

    def find(self, name: str) -> Path | None:
        """The file of that name, or None; UserError for a pipe or a device."""
        key = name, len(self.look.folders)
        if key not in self.look.found:
            try:
                self.look.found[key] = find_regular(name, self.look.folders)
            except UserError as error:
                raise self.fault(str(error)) from None
        return self.look.found[key]


def find_regular(name: str, folders: list[Path]) -> Path | None:
    """The file of that name in one of some folders, or where it says; None if there is none.

    Raises
    ------
    UserError
        It is a pipe or a device.
    """
    for folder in [*folders, Path()]:
        try:
            mode = os.stat(folder / name).st_mode
        except (OSError, ValueError):
            continue
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise UserError(f"{name}: is a pipe or a device, and a file is wanted")
        return folder / name
    return None


def check_named_files(mi: Any, state: Any, fault: Any) -> None:
    """Look at the files that a parsed scene names, before plugins read them.

    Parameters
    ----------
    mi : Mitsuba, with the scene's folders in its file resolver
    state : Mitsuba's parsed scene
    fault : callable
        Makes the error of a node and a reason.

    Raises
    ------
    UserError
        A pipe or a device; a picture without texels, or of more than there is memory for.
    """
    resolver = mi.file_resolver()
    for node in state.nodes:
        if "filename" not in node.props:
            continue
        name = str(node.props["filename"])
        try:
            found = find_regular(str(resolver.resolve(name)), [])
            if found is not None and found.is_file() and node.props.plugin_name() in _PICTURES:
                size = picture_size(found)
                if size is not None:
                    check_size(name, *size)
                    check_memory(_TEXEL * size[0] * size[1], f"{name}: its picture", "make it smaller")
        except UserError as error:
            raise fault(node, str(error)) from None
