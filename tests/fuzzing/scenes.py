"""Small Mitsuba scenes as .xml, and damage to them."""

from __future__ import annotations

import random
import re

from tests.fuzzing import mutations

_HEAD = '<scene version="3.0.0">\n'
_WALL = (
    '<shape type="rectangle" id="wall">\n<transform name="to_world">\n<scale value="2"/>\n<rotate x="1" angle="30"/>\n'
    '</transform>\n<bsdf type="diffuse">\n<rgb name="reflectance" value="0.5 0.25 1"/>\n</bsdf>\n</shape>\n'
)
_BODIES = {
    "plain.xml": _WALL,
    "parameters.xml": '<default name="size" value="2"/>\n<default name="kind" value="cube"/>\n<shape type="$kind">\n'
    '<transform name="to_world"><scale value="$size"/></transform>\n<bsdf type="diffuse"/>\n</shape>\n',
    "materials.xml": '<bsdf type="twosided" id="paint">\n<bsdf type="diffuse"/>\n</bsdf>\n<shape type="cube">\n'
    '<ref id="paint"/>\n</shape>\n<shape type="disk">\n<bsdf type="roughconductor"/>\n</shape>\n' + _WALL,
    "lights.xml": _WALL + '<emitter type="constant">\n<rgb name="radiance" value="1"/>\n</emitter>\n'
    '<sensor type="perspective">\n<float name="fov" value="40"/>\n<transform name="to_world">\n'
    '<lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/>\n</transform>\n<film type="hdrfilm">\n'
    '<integer name="width" value="16"/>\n<integer name="height" value="8"/>\n</film>\n</sensor>\n',
    "instances.xml": '<shape type="shapegroup" id="group">\n<shape type="cube">\n<bsdf type="diffuse"/>\n</shape>\n'
    '</shape>\n<shape type="instance">\n<ref id="group"/>\n</shape>\n' + _WALL,
    "included.xml": '<include filename="plain.xml"/>\n<path value="."/>\n<alias id="wall" as="other"/>\n',
}

# Values that break readers: names of files that are none, numbers without end, parameters of parameters.
_VALUES = (
    "", "0", "-1", "nan", "inf", "1e300", "1e-300", "99999999999999999999", "x" * 2000, "$size", "$none", "$$", "1 2",
    "/dev/zero", "/etc/passwd", "..", ".", "none.exr", "included.xml", "rectangle", "sphere", "wall", "&lt;", "a\u0301",
    "dielectric", "envmap", "bitmap", "merge", "true",
)  # fmt: skip

_BOMBS = (
    '<!DOCTYPE a [<!ENTITY b "cc"><!ENTITY d "&b;&b;">]>', "<bsdf type='twosided'>" * 400,
    '<include filename="included.xml"/>', '<shape type="obj"><string name="filename" value="/dev/zero"/></shape>',
)  # fmt: skip

_ATTRIBUTE = re.compile(rb'"[^"\n]*"')


def seeds() -> dict[str, bytes]:
    """Files by name, all valid; included.xml reads plain.xml beside it."""
    return {name: f"{_HEAD}{body}</scene>\n".encode() for name, body in _BODIES.items()}


def mutate(name: str, content: bytes, random: random.Random) -> bytes:
    """A scene, damaged; which kind is drawn."""
    kind = random.random()
    if kind < 0.5:
        for _ in range(random.choice((1, 1, 2))):
            found = list(_ATTRIBUTE.finditer(content))
            if found:
                one = random.choice(found)
                content = content[: one.start() + 1] + random.choice(_VALUES).encode() + content[one.end() - 1 :]
        return content
    if kind < 0.6:
        at = random.choice([match.end() for match in re.finditer(rb">\n", content)] or [0])
        return content[:at] + random.choice(_BOMBS).encode() + content[at:]
    return mutations.mutate(content, random, mutations.TEXT)
