"""Relight a model of `slepian-prt export --attributes float` in Blender, by the map of its world.

    blender --python relight.py -- model.glb map.hdr [DEGREES]

The colours of the vertices follow the world: whatever image its Environment Texture has, and however its Mapping turns
that about the vertical axis. The formula and the conventions are those of docs/guide/export.md.
"""

import json
import math
import struct
import sys
from pathlib import Path

import bpy
import numpy as np

# The importer of Blender 3.4 wants a name that NumPy 1.24 has not: Debian 12 ships the two together.
if "bool" not in vars(np):
    np.bool = bool

RADIANCE = "Radiance"

# More texels say nothing to so few harmonics.
MAP_WIDTH = 128

# Columns of glTF's axes in Blender's, as its importer turns models: y up becomes z up.
GLTF_TO_BLENDER = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

DTYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Model:
    """An exported file, and the meshes that Blender has made of it.

    Attributes
    ----------
    told : dict
        ``extras`` of the file.
    functions : (C, K, channels, M), zeros : (C, K - 1)
    parts : list of (Blender object, (n, K) numbers, (n, 3) reflectance, (n, 3) radiance of lamps)
    """

    def __init__(self, path):
        content = Path(path).read_bytes()
        (size,) = struct.unpack_from("<I", content, 12)
        self._root, self._binary = json.loads(content[20 : 20 + size]), content[28 + size :]
        self.told = self._root.get("extras", {}).get("slepian_prt", {})
        if self.told.get("kind") != "transfer" or self.told["coefficients"]["in"] == "texture":
            raise SystemExit(f"{path}: is no model of `slepian-prt export --attributes float`; export it so")
        self.functions, self.zeros = self._array("functions"), self._array("zeros")
        before = set(bpy.data.objects)
        bpy.ops.import_scene.gltf(filepath=str(path))
        imported = {_given_name(one.name): one for one in bpy.data.objects if one not in before and one.type == "MESH"}
        nodes = [node for node in self._root["nodes"] if "mesh" in node]
        self.parts = [self._part(node, imported[node["name"][:63]]) for node in nodes]

    def relight(self, light_in):
        """Give all vertices the radiance that they have now.

        Parameters
        ----------
        light_in : callable
            From the rotation (3, 3) of some axes to the world to the coefficients (3, M) of the light in them.
        """
        for thing, numbers, reflectance, lamps in self.parts:
            rotation = np.array(thing.matrix_world.to_3x3().normalized()) @ GLTF_TO_BLENDER
            light = light_in(rotation)
            functions = self.functions.repeat(3 // self.told["channels"], axis=2)
            table = np.einsum("ckdm,dm->ckd", functions.astype(np.float64), light, optimize=True)
            table[:, 0] -= np.einsum("ck,ckd->cd", self.zeros, table[:, 1:])
            own = table[numbers[:, -1].astype(int)]
            radiance = own[:, 0] + np.einsum("vk,vkd->vd", numbers[:, :-1] / 255.0, own[:, 1:])
            colors = np.column_stack([(radiance + lamps) * reflectance, np.ones(len(radiance))])
            attribute = thing.data.attributes[RADIANCE]
            attribute.data.foreach_set("color", np.maximum(colors, 0.0).astype(np.float32).ravel())
            thing.data.update()

    def _part(self, node, thing):
        """What a mesh has, in the order of Blender's vertices: those of all primitives, one after the other."""
        primitives = self._root["meshes"][node["mesh"]]["primitives"]
        names = self.told["coefficients"]["attributes"]
        numbers = [np.hstack([self._accessor(one["attributes"][name]) for name in names]) for one in primitives]
        lamps = [self._attribute(one, "_LAMPS", np.zeros(3)) for one in primitives]
        materials = [self._root["materials"][one["material"]]["pbrMetallicRoughness"] for one in primitives]
        factors = [np.array(material.get("baseColorFactor", [1.0] * 4))[:3] for material in materials]
        colors = [self._attribute(one, "COLOR_0", np.ones(3)) for one in primitives]
        reflectance = [color * factor for color, factor in zip(colors, factors, strict=True)]
        assert sum(map(len, numbers)) == len(thing.data.vertices)
        thing.data.attributes.new(RADIANCE, "FLOAT_COLOR", "POINT")
        for material in thing.data.materials:
            show_radiance(material)
        return thing, *(np.concatenate(values) for values in (numbers, reflectance, lamps))

    def _attribute(self, primitive, name, otherwise):
        """(n, 3) an attribute of a primitive, if it has that."""
        if name in primitive["attributes"]:
            return self._accessor(primitive["attributes"][name])[:, :3]
        return np.tile(otherwise, (self._root["accessors"][primitive["attributes"]["POSITION"]]["count"], 1))

    def _accessor(self, number):
        entry = self._root["accessors"][number]
        values = np.frombuffer(self._view(entry["bufferView"]), DTYPES[entry["componentType"]])
        largest = np.iinfo(values.dtype).max if entry.get("normalized") else 1.0
        return values.reshape(-1, WIDTHS[entry["type"]]) / largest

    def _array(self, name):
        entry = self.told[name]
        return np.frombuffer(self._view(entry["bufferView"]), entry["dtype"]).reshape(entry["shape"])

    def _view(self, number):
        view = self._root["bufferViews"][number]
        return self._binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]


def _given_name(name):
    """The name without the number that Blender adds to names that are taken."""
    stem, dot, number = name.rpartition(".")
    return stem if dot and len(number) == 3 and number.isdigit() else name


def show_radiance(material):
    """Let a material show the colours of the vertices, times its texture, and nothing else."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    image = next((node.image for node in nodes if node.type == "TEX_IMAGE"), None)
    nodes.clear()
    radiance = nodes.new("ShaderNodeVertexColor")
    radiance.layer_name = RADIANCE
    emission, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    color = radiance.outputs["Color"]
    if image is not None:
        texture, product = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeMixRGB")
        texture.image, product.blend_type, product.inputs["Fac"].default_value = image, "MULTIPLY", 1.0
        links.new(color, product.inputs["Color1"])
        links.new(texture.outputs["Color"], product.inputs["Color2"])
        color = product.outputs["Color"]
    links.new(color, emission.inputs["Color"])
    links.new(emission.outputs["Emission"], output.inputs["Surface"])


def harmonics(bandlimit, directions):
    """(n, (L+1)²) real spherical harmonics: orthonormal, Condon–Shortley phase, polar axis z, index l² + l + m."""
    x, y, z = directions.T
    values = np.empty((len(directions), (bandlimit + 1) ** 2))
    turned, start = np.ones(len(x), dtype=complex), math.sqrt(1.0 / (4.0 * math.pi))
    for m in range(bandlimit + 1):
        if m > 0:
            turned = turned * (x + 1j * y)
            start *= -math.sqrt((2 * m + 1) / (2 * m) * (2 if m == 1 else 1))
        before, now = np.zeros_like(z), np.full_like(z, start)
        for l in range(m, bandlimit + 1):
            values[:, l * l + l - m] = now * turned.imag
            values[:, l * l + l + m] = now * turned.real
            a = math.sqrt((4 * (l + 1) ** 2 - 1) / ((l + 1) ** 2 - m * m))
            b = math.sqrt((l * l - m * m) / (4 * l * l - 1)) if l > m else 0.0
            before, now = now, a * (z * now - b * before)
    return values


def read_map(image):
    """(n, 3) directions of the texels of an image in the space of its texture, and (n, 3) their radiance x area."""
    width, height = image.size
    pixels = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    texels = pixels.reshape(height, width, 4)[:, :, :3].astype(np.float64)  # from the bottom up
    by = max(n for n in range(1, max(width // MAP_WIDTH, 1) + 1) if width % n == 0 and height % n == 0)
    texels = texels.reshape(height // by, by, width // by, by, 3).mean(axis=(1, 3))
    height, width = texels.shape[:2]
    azimuth = (0.5 - (np.arange(width) + 0.5) / width) * 2.0 * math.pi
    edges = np.linspace(-0.5, 0.5, height + 1) * math.pi
    elevation, area = 0.5 * (edges[1:] + edges[:-1]), np.diff(np.sin(edges)) * 2.0 * math.pi / width
    flat, up = np.cos(elevation)[:, None], np.sin(elevation)[:, None]
    directions = np.stack(np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), up), axis=-1)
    return directions.reshape(-1, 3), (texels * area[:, None, None]).reshape(-1, 3)


class World:
    """The map of Blender's world as light; kept until its image is another one."""

    def __init__(self, bandlimit):
        self._bandlimit, self._image, self._map = bandlimit, None, None

    @staticmethod
    def state():
        """The image and how it is turned: a change of either is a change of the light."""
        nodes = bpy.context.scene.world.node_tree.nodes
        image = next((node.image for node in nodes if node.type == "TEX_ENVIRONMENT"), None)
        mapping = next((node for node in nodes if node.type == "MAPPING"), None)
        turn = tuple(mapping.inputs["Rotation"].default_value) if mapping else (0.0, 0.0, 0.0)
        return (None if image is None else image.name), turn

    def light(self, rotation):
        """(3, M) coefficients in axes whose rotation (3, 3) to the world is given."""
        from mathutils import Euler

        name, turn = self.state()
        if name != self._image:
            self._image, self._map = name, read_map(bpy.data.images[name])
        directions, radiance = self._map
        # The texture is looked up where Mapping turns a direction of the world to: p = R w, in rows w = p R.
        world = directions @ np.array(Euler(turn).to_matrix())
        return (harmonics(self._bandlimit, world @ rotation).T @ radiance).T


def set_world(path, degrees):
    """A world with a map, and a Mapping that turns it about the vertical axis."""
    world = bpy.context.scene.world or bpy.data.worlds.new("World")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    coordinates, mapping = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(str(path))
    mapping.inputs["Rotation"].default_value[2] = math.radians(degrees)
    links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], nodes["Background"].inputs["Color"])


def follow(model, world):
    """Relight now, and whenever the world has changed."""
    shown = []

    def update(*_):
        state = world.state()
        if state[0] is not None and shown != [state]:
            shown[:] = [state]
            model.relight(world.light)

    update()
    bpy.app.handlers.depsgraph_update_post.append(update)


def main(arguments):
    """Read the model and the map that are named, and follow the world from now on."""
    if len(arguments) not in (2, 3):
        raise SystemExit("usage: blender --python relight.py -- model.glb map.hdr [DEGREES]")
    set_world(Path(arguments[1]).resolve(), float(arguments[2]) if len(arguments) == 3 else 0.0)
    model = Model(Path(arguments[0]).resolve())
    bpy.context.view_layer.update()
    follow(model, World(model.told["bandlimit"]))


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])
