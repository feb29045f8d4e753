"""What Mitsuba says of a scene that it cannot load, as one line for the user."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from slepian_prt.errors import UserError

# Characters of a reason, which may quote a value of the scene that is as long as one likes.
_LONGEST = 400

# "[parser.cpp:1718] " and "[FileStream] ": where in Mitsuba's own source, which says nothing to the user.
_SOURCE = re.compile(r"\[\w+\.(?:cpp|h):\d+\] ")
_CLASS = re.compile(r"\[[A-Z]\w+\] ")

# Where in the scene: each file that was included adds one, and the last is that of the mistake.
_PLACE = re.compile(
    r'(?:^|(?<=: ))(?:At|Error while loading|While loading) (?:dictionary node "(?P<node>[^"]*)"'
    r"|(?P<place>(?P<file>.+?) \(line (?P<line>\d+), col \d+\))): "
)
_NODE = re.compile(r"^\[(?P<node>[^\]]*)\]:? ")
_PLUGIN = re.compile(r'^failed to instantiate (?P<kind>\w+) plugin of type "(?P<plugin>[^"]*)": (?P<why>.*)')
_ABSENT = re.compile(
    r'.*?"(?P<name>[^"]*)": (?:I/O error while attempting to open file: No such file.*|file not found|file does not '
    r"exist)"
)
_UNDEFINED = re.compile(r"undefined parameter: \$(?P<name>\w*)")
_UNUSED = re.compile(r"^Found unused parameters: ")
_NAMED = re.compile(r"- (?:\w+ \"|\$)(?P<name>\w+)")

# What Mitsuba writes, and what it means; the last, which nothing else fits, is passed on.
_MEANINGS: tuple[tuple[str, str], ...] = (
    (r'Found \d+ unreferenced \w+ in \w+ plugin of type "([^"]*)": (.*)', r"'\1' has no property {names}"),
    (r'Property "(\w+)" cannot be found', r"its property '\1' is missing"),
    (r'Plugin "([^"]*)".* (?:not|could not be) found', r"Mitsuba has no such plugin in the variant {variant}"),
    (r'unresolved reference to "([^"]*)".*', r"nothing has the id '\1' that is referred to"),
    (r'duplicate ID: "([^"]*)" \(previous was at .*?\(line (\d+), col \d+\)\)', r"the id '\1' is that of line \2 too"),
    (r'"([^"]*)": read \d+ out of \d+ bytes', r"\1: is damaged, it ends too early"),
    (r'Could not map "([^"]*)" to memory', r"\1: the file is empty, or cannot be read"),
    (r"Storing new normals in a Mesh that didn't have normals.*", r"it has no faces"),
    (r"std::bad_cast", r"the type or id of something is no string"),
    (r"Bitmap: Unknown file format", r"no picture that Mitsuba can read"),
    (r"Exceeded maximum include recursion.*", r"files include each other in a circle"),
    (r".*Nested instancing is not permitted", r"an instance may not hold instances"),
    (r'Parsing of XML file "[^"]*" failed: (.*) \((line \d+), col \d+\)', r"\2: \1"),
    (r'Error while loading XML file "[^"]*": (.*)', r"\1"),
)


class _Place(NamedTuple):
    """Where in a scene something is wrong.

    Attributes
    ----------
    shown : str
        For the message; empty where Mitsuba does not know.
    key : str
        As Mitsuba writes it.
    """

    shown: str
    key: str


def load_failure(
    error: Exception,
    origin: str,
    variant: str,
    file_at: Callable[[str], str | None] = lambda _: None,
    *,
    in_dict: bool = False,
) -> UserError:
    """Why a scene cannot be loaded, from what Mitsuba raised.

    Parameters
    ----------
    error : Exception
    origin : str
        Path of the scene, or what it is called.
    variant : str
        Of Mitsuba.
    file_at : callable
        Gives the file that is named at a place of the scene, as Mitsuba writes the place.
    in_dict : bool
        Whether the scene is a dict, of which Mitsuba puts keys into brackets.
    """
    text = " ".join(_SOURCE.sub("", str(error)).split()) or type(error).__name__
    place, said = _split(text, origin, in_dict=in_dict)
    if undefined := _UNDEFINED.search(said):
        name, where = undefined["name"], f" ({place.shown})" if place.shown else ""
        wanted = f"parameters={{'{name}': …}}"
        return UserError(f"{origin}: its parameter ${name}{where} has no value; give `{wanted}`")
    plugin = _PLUGIN.match(said)
    why = _meaning(plugin["why"] if plugin else said, variant)
    if plugin:
        file = file_at(place.key)
        named = f" {file}:" if file and Path(file).name not in why else ""
        kind = "" if plugin["kind"] in ("unknown", plugin["plugin"]) else f"{plugin['kind']} "
        why = f"{kind}'{plugin['plugin']}':{named} {why}"
    where = f"{place.shown}: " if place.shown else ""
    if len(why) > _LONGEST:
        why = f"{why[: _LONGEST - 100]} … {why[-97:]}"
    return UserError(f"{origin}: Mitsuba cannot load the scene ({where}{why}); correct it there")


def unused_parameters(error: Exception) -> list[str]:
    """Names of the parameters that Mitsuba found no use for; none if it complains of something else."""
    text = " ".join(_SOURCE.sub("", str(error)).split())
    return _NAMED.findall(text) if _UNUSED.match(text) else []


def _split(text: str, origin: str, *, in_dict: bool) -> tuple[_Place, str]:
    """Where it is, and what is said of it."""
    if places := list(_PLACE.finditer(text)):
        last = places[-1]
        said = text[last.end() :].removeprefix("while processing <include>: ")
        if last["node"] is not None:
            return _Place("" if last["node"] == "root" else f"'{last['node']}'", ""), said
        file = "" if last["file"] == origin else f"{last['file']}, "
        return _Place(f"{file}line {last['line']}", last["place"]), said
    if in_dict and (node := _NODE.match(text)):
        return _Place(f"'{node['node']}'", ""), text[node.end() :]
    return _Place("", ""), text


def _meaning(said: str, variant: str) -> str:
    said = _CLASS.sub("", said).rstrip("!. ")
    if absent := _ABSENT.match(said):
        return f"{absent['name']}: no such file"
    for pattern, meaning in _MEANINGS:
        if match := re.fullmatch(pattern, said):
            names = ", ".join(f"'{name}'" for name in _NAMED.findall(said))
            return match.expand(meaning.format(names=names, variant=variant))
    return said
