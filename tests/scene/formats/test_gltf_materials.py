"""What glTF materials reflect, how their textures lie, and the names of what is not simulated."""

import base64
from pathlib import Path

import numpy as np
import pytest

from slepian_prt.scene.formats.gltf import read_gltf
from tests.numerics import assert_exact, assert_rounded
from tests.scene.formats.gltf_writer import FACES, TETRAHEDRON, Writer

FLAT = np.float32([[0, 0], [1, 0], [0, 1], [0.25, 0.75]])
PNG = b"\x89PNG not decoded here"


@pytest.fixture
def writer():
    """A mesh with two sets of texture coordinates, and an image."""
    writer = Writer()
    writer.node(mesh=writer.mesh(TEXCOORD_0=FLAT, TEXCOORD_1=FLAT * 10))
    writer.add("images", bufferView=writer.view(PNG), mimeType="image/png")
    writer.add("textures", source=0)
    return writer


@pytest.fixture
def read(tmp_path):
    """The part of a file with one material, and the notes."""

    def read(writer, **material):
        writer.json["materials"] = [material]
        writer.primitive()["material"] = 0
        file = read_gltf(writer.write(tmp_path))
        return file.parts[0], file.notes

    return read


def rough(**values):
    return {"pbrMetallicRoughness": values}


def test_factors(writer, read):
    given = rough(baseColorFactor=[0.25, 0.5, 0.75, 0.1], metallicFactor=0.125)
    material = read(writer, name="paint", **given)[0].material
    assert (material.name, material.color, material.metallic) == ("paint", (0.25, 0.5, 0.75), 0.125)
    assert (material.texture, material.metallic_texture, material.not_simulated) == (None, None, ())


def test_defaults(writer, read):
    """A metal unless it says otherwise, once it says anything of what it reflects."""
    part, _ = read(writer, **rough(roughnessFactor=0.5))
    assert (part.material.name, part.material.metallic, part.material.color) == ("material 0", 1.0, (1.0, 1.0, 1.0))
    part, _ = read(writer, name="only a name")
    assert (part.material.metallic, part.material.color) == (0.0, (1.0, 1.0, 1.0))
    assert part.uv is None


def test_textures_and_their_coordinates(writer, read):
    both = rough(baseColorTexture={"index": 0}, metallicRoughnessTexture={"index": 0, "texCoord": 1})
    part, notes = read(writer, **both)
    assert notes == ()
    assert part.material.texture.source == part.material.metallic_texture.source == PNG
    assert part.material.metallic == 1.0
    assert part.uv.dtype == np.float32
    assert_exact(part.uv, FLAT[FACES], "coordinates are copied")
    assert_exact(part.metallic_uv, FLAT[FACES] * 10, "coordinates are copied")
    both["pbrMetallicRoughness"]["metallicRoughnessTexture"]["texCoord"] = 0
    assert read(writer, **both)[0].metallic_uv is None


@pytest.mark.parametrize(
    ("transform", "wanted"),
    [
        ({"offset": [0.5, 2]}, lambda u, v: (u + 0.5, v + 2)),
        ({"scale": [2, -3]}, lambda u, v: (2 * u, -3 * v)),
        # The lower left quadrant of the image, turned clockwise: the extension's own example.
        ({"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}, lambda u, v: (v / 2, 1 - u / 2)),
        # Scale before rotation.
        ({"rotation": np.pi / 2, "scale": [2, 3]}, lambda u, v: (3 * v, -2 * u)),
        ({"texCoord": 1}, lambda u, v: (10 * u, 10 * v)),
    ],
)
def test_texture_transforms(writer, read, transform, wanted):
    info = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    part, _ = read(writer, **rough(baseColorTexture=info, metallicRoughnessTexture={"index": 0}))
    assert_rounded(part.uv, np.stack(wanted(*FLAT.T.astype(float)), axis=1)[FACES].astype("f4"), 4)
    assert_exact(part.metallic_uv, FLAT[FACES], "the other texture has no transform")


def test_quantised_coordinates(writer, read):
    """Integers as they are, to be scaled by the transform of the texture."""
    shorts = (FLAT * 4000).astype("u2")
    writer.primitive()["attributes"]["TEXCOORD_0"] = writer.accessor(shorts)
    info = {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [1 / 4000, 1 / 4000]}}}
    assert_rounded(read(writer, **rough(baseColorTexture=info))[0].uv, FLAT[FACES], 4)


def test_images_beside_the_file_and_in_it(writer, read, tmp_path):
    packed = base64.b64encode(PNG).decode()
    for uri, source in (("sub/a%20b.png", tmp_path / "sub" / "a b.png"), (f"data:image/png;base64,{packed}", PNG)):
        writer.json["images"] = [{"uri": uri, "name": "wood"}]
        texture = read(writer, **rough(baseColorTexture={"index": 0}))[0].material.texture
        assert (texture.name, texture.source) == ("wood", source)


def test_wrap_modes(writer, read):
    names = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
    writer.json["textures"][0]["sampler"] = 0
    for u, first in names.items():
        for v, second in names.items():
            writer.json["samplers"] = [{"wrapS": u, "wrapT": v}]
            texture = read(writer, **rough(baseColorTexture={"index": 0}))[0].material.texture
            assert texture.wrap == (first, second)
    writer.json["samplers"] = [{}]
    assert read(writer, **rough(baseColorTexture={"index": 0}))[0].material.texture.wrap == ("repeat", "repeat")


@pytest.mark.parametrize("extension", ["EXT_texture_webp", "EXT_texture_avif"])
def test_other_formats_that_can_be_read(writer, read, extension):
    writer.add("images", uri="a.webp")
    writer.json["textures"] = [{"extensions": {extension: {"source": 1}}}]
    source = read(writer, **rough(baseColorTexture={"index": 0}))[0].material.texture.source
    assert isinstance(source, Path)
    assert source.name == "a.webp"
    writer.json["textures"][0]["source"] = 0  # what every reader knows
    assert read(writer, **rough(baseColorTexture={"index": 0}))[0].material.texture.source == PNG


@pytest.mark.parametrize(
    ("texture", "image", "note"),
    [
        ({"extensions": {"KHR_texture_basisu": {"source": 0}}}, {"uri": "a.ktx2"}, "KHR_texture_basisu"),
        ({"source": 0}, {"uri": "a.ktx2"}, "KTX2"),
        ({"source": 0}, {"uri": "data:;base64," + base64.b64encode(b"\xabKTX 20\xbb").decode()}, "KTX2"),
        ({"source": 0}, {"uri": "https://example.com/a.png"}, "not fetched"),
        ({}, {}, "in no format"),
    ],
)
def test_images_that_cannot_be_read(writer, read, texture, image, note):
    """Left out with a note; what a metallic texture says is not known then, and most surfaces are not metal."""
    writer.json["textures"], writer.json["images"] = [texture], [image]
    info = {"index": 0}
    part, notes = read(writer, **rough(baseColorTexture=info, metallicRoughnessTexture=info))
    assert (part.material.texture, part.material.metallic_texture, part.material.metallic) == (None, None, 0.0)
    assert part.uv is None
    assert len(notes) == 1
    assert note in notes[0]


def test_a_texture_without_coordinates(writer, read):
    part, notes = read(writer, **rough(baseColorTexture={"index": 0, "texCoord": 2}, metallicFactor=0))
    assert (part.uv, part.material.texture) == (None, None)
    assert notes == ("a texture left out: mesh 0, primitive 0 has no TEXCOORD_2",)


def extension(name, **values):
    return {"extensions": {name: values}}


@pytest.mark.parametrize(
    ("material", "effects"),
    [
        ({"alphaMode": "OPAQUE"}, ()),
        ({"alphaMode": "MASK"}, ("transparency",)),
        ({"alphaMode": "BLEND", "normalTexture": {"index": 0}}, ("transparency", "normal map")),
        ({"emissiveFactor": [0, 0, 0], "emissiveTexture": {"index": 0}}, ()),
        ({"emissiveFactor": [0, 0.5, 0]}, ("emitted light",)),
        (extension("KHR_materials_transmission", transmissionFactor=0.5), ("transmission",)),
        (extension("KHR_materials_transmission"), ()),
        (extension("KHR_materials_volume", thicknessFactor=1), ("transmission",)),
        (extension("KHR_materials_clearcoat", clearcoatFactor=1), ("clearcoat",)),
        (extension("KHR_materials_sheen", sheenColorFactor=[0, 0, 0.1]), ("sheen",)),
        (extension("KHR_materials_iridescence", iridescenceFactor=1), ("iridescence",)),
        (extension("KHR_materials_ior", ior=1.4), ()),
    ],
)
def test_effects_that_are_not_simulated(writer, read, material, effects):
    assert read(writer, **material)[0].material.not_simulated == effects


def test_specular_glossiness(writer, read):
    """c = diffuse (1 - max specular); a specular texture, or no word on it, leaves the diffuse colour."""
    name = "KHR_materials_pbrSpecularGlossiness"
    values = {"diffuseFactor": [0.5, 1, 0.25, 1], "diffuseTexture": {"index": 0}}
    part, notes = read(writer, **extension(name, **values), **rough(metallicFactor=1))
    assert (part.material.color, part.material.metallic, notes) == ((0.5, 1, 0.25), 0.0, ())
    assert part.material.texture.source == PNG
    assert_exact(part.uv, FLAT[FACES], "coordinates are copied")
    part, _ = read(writer, **extension(name, **values, specularFactor=[0.25, 0.5, 0]))
    assert part.material.color == (0.25, 0.5, 0.125)
    part, notes = read(writer, **extension(name, **values, specularGlossinessTexture={"index": 0}))
    assert part.material.color == (0.5, 1, 0.25)
    assert "specular texture" in notes[0]


def test_unlit(writer, read):
    part, notes = read(writer, **rough(baseColorFactor=[0.5, 0.5, 0.5, 1]), **extension("KHR_materials_unlit"))
    assert (part.material.color, part.material.metallic) == ((0.5, 0.5, 0.5), 0.0)
    assert "is unlit" in notes[0]


def test_materials_are_shared(writer, tmp_path):
    """Parts of one material have the same object, and materials of one texture, so that it is decoded once."""
    writer.json["materials"] = [rough(baseColorTexture={"index": 0})]
    writer.primitive()["material"] = 0
    writer.node(mesh=0)
    mesh = writer.mesh(TETRAHEDRON, TEXCOORD_0=FLAT)
    writer.primitive(mesh)["material"] = 0
    writer.node(mesh=mesh)
    writer.json["materials"].append(rough(baseColorTexture={"index": 0}, baseColorFactor=[0, 0, 1, 1]))
    writer.node(mesh=writer.mesh(TETRAHEDRON, TEXCOORD_0=FLAT))
    writer.primitive(2)["material"] = 1
    first, second, third, other = (part.material for part in read_gltf(writer.write(tmp_path)).parts)
    assert first is second is third
    assert other is not first
    assert other.texture is first.texture
