"""Albedo of vertices against integrals of the texture times the hat function of the vertex."""

import io
import logging

import numpy as np
import pytest
from PIL import Image

from slepian_prt.scene.formats.parts import Material, MeshPart, Texture
from slepian_prt.scene.reflectance.albedo import decode_textures, effects_left_out, texture_lost, vertex_albedo

ROUNDING = 2e-6  # sums of 16 x 6 terms up to 1 in float32


def image(codes: np.ndarray, name: str = "t", wrap=("repeat", "repeat")) -> Texture:
    file = io.BytesIO()
    Image.fromarray(codes.astype(np.uint8)).save(file, "PNG")
    return Texture(name, file.getvalue(), wrap)


def grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A unit square of n x n cells, each cut along the same diagonal: the middle vertices have six faces."""
    t = np.linspace(0.0, 1.0, n + 1)
    x, y = np.meshgrid(t, t, indexing="ij")
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]), faces


def square(n: int, material: Material | None, **others) -> MeshPart:
    """A grid with the image upright on it, in the convention of `MeshPart`: v runs down."""
    positions, faces = grid(n)
    uv = (positions[:, :2] * [1.0, -1.0] + [0.0, 1.0])[faces].astype(np.float32)
    return MeshPart("square", positions, faces, uv=uv, material=material, **others)


def albedo_of(part: MeshPart) -> tuple[np.ndarray, float]:
    return vertex_albedo(part, decode_textures([part]))


def linear(codes) -> np.ndarray:
    c = np.asarray(codes) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def with_hats(part: MeshPart, values: np.ndarray, *, per_side: int) -> np.ndarray:
    """Brute force: ∫ λ f / ∫ λ over the faces around each vertex, f constant on texels, by many small triangles.

    The number of points per side is no multiple of the one that the code looks at.
    """
    n = per_side
    up = [(3 * i + 1, 3 * j + 1) for i in range(n) for j in range(n - i)]
    down = [(3 * i + 2, 3 * j + 2) for i in range(n) for j in range(n - i - 1)]
    first = np.array(up + down) / (3.0 * n)
    weights = np.column_stack([1.0 - first.sum(axis=1), first])
    corner = part.positions[part.faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    total, hats = np.zeros((len(part.positions), values.shape[2])), np.zeros(len(part.positions))
    for barycentric in weights:
        uv = np.einsum("fkc,k->fc", part.uv.astype(np.float64), barycentric)
        column, row = ((uv[:, axis] % 1.0 * values.shape[1 - axis]).astype(int) for axis in (0, 1))
        for k in range(3):
            np.add.at(total, part.faces[:, k], (area * barycentric[k])[:, None] * values[row, column])
            np.add.at(hats, part.faces[:, k], area * barycentric[k])
    return total / hats[:, None]


@pytest.mark.parametrize("squares", [2, 5, 64])
def test_a_checkerboard_on_a_grid(squares):
    """Vertices between coarse squares see parts of them; of fine ones the mean."""
    size = 320 if squares != 64 else 256
    board = (np.add.outer(*[np.arange(size) * squares // size] * 2) % 2)[:, :, None] * np.array([255, 128, 0])
    part = square(10, Material("m", texture=image(board, wrap=("clamp", "clamp"))))
    albedo, metallic = albedo_of(part)
    expected = with_hats(part, linear(board), per_side=23)
    # Looked at in 16 pieces a face: an edge of a square is blurred over two pieces, each 1/4 of a side. A hat function
    # changes by no more than 1/2 over them, on 1/4 of the faces' area.
    np.testing.assert_allclose(albedo, expected, atol=0.05 if squares != 64 else 0.02)
    assert np.sqrt(np.mean((albedo - expected) ** 2)) < 0.015
    assert metallic == 0.0


def test_noise_on_a_grid(rng):
    """Twenty texels a cell, and no direction or place of its own."""
    codes = rng.integers(0, 256, (160, 160, 3))
    part = square(8, Material("m", texture=image(codes)))
    albedo, _ = albedo_of(part)
    expected = with_hats(part, linear(codes), per_side=47)
    # A hat function covers 1,200 texels, weighed with variance 1/2: by chance 0.3/√600 about the mean.
    spread = np.std(expected[np.abs(part.positions[:, :2] - 0.5).max(axis=1) < 0.49], axis=0)
    assert np.sqrt(np.mean((albedo - expected) ** 2)) < 0.6 * spread.mean()
    # A single texel under the vertex would be 25 times as far from it as chance.
    assert np.abs(albedo - expected).max() < 0.06


def test_the_image_is_upright_and_not_mirrored():
    """White on the top left quarter."""
    codes = np.zeros((8, 8, 3))
    codes[:4, :4] = 255
    part = square(8, Material("m", texture=image(codes, wrap=("clamp", "clamp"))))
    white = albedo_of(part)[0][:, 0] > 0.9
    x, y = part.positions[:, 0], part.positions[:, 1]
    np.testing.assert_allclose(part.positions[white], part.positions[(x < 0.45) & (y > 0.55)])


@pytest.mark.parametrize("n", [1, 7])
def test_constant_textures_are_exact(n):
    color, code = (0.5, 0.25, 1.0), 188
    part = square(n, Material("m", color=color, texture=image(np.full((5, 3, 3), code))))
    np.testing.assert_allclose(
        albedo_of(part)[0], np.tile(np.array(color) * linear(code), ((n + 1) ** 2, 1)), rtol=1e-6
    )


def test_vertex_colours_are_a_factor():
    part = square(2, Material("m", color=(0.5, 1.0, 1.0)), colors=np.tile(np.float32([0.5, 0.25, 2.0]), (9, 1)))
    albedo, _ = albedo_of(part)
    np.testing.assert_allclose(albedo, np.tile([0.25, 0.25, 1.0], (9, 1)), rtol=1e-7)  # nothing reflects more than 1
    bare = square(1, None, colors=np.eye(4, 3, dtype=np.float32))
    np.testing.assert_allclose(albedo_of(bare)[0], np.eye(4, 3), rtol=1e-7)


def test_metal_by_factor_and_by_texture():
    """Its blue channel counts, linear, times the factor; red and green are other things."""
    half = Material("m", color=(0.8, 0.6, 0.4), metallic=0.25)
    albedo, metallic = albedo_of(square(3, half))
    np.testing.assert_allclose(albedo, np.tile([0.6, 0.45, 0.3], (16, 1)), rtol=1e-6)
    assert metallic == 0.25
    codes = np.zeros((16, 16, 3))
    codes[..., 0], codes[:, 8:, 2] = 255, 153
    mixed = Material("m", metallic=0.5, metallic_texture=image(codes, wrap=("clamp", "clamp")))
    albedo, metallic = albedo_of(square(16, mixed))
    x = square(16, None).positions[:, 0]
    np.testing.assert_allclose(albedo[x < 0.4], 1.0, atol=ROUNDING)
    np.testing.assert_allclose(albedo[x > 0.6], 1.0 - 0.5 * 153 / 255, atol=ROUNDING)
    assert metallic == pytest.approx(0.5 * 0.5 * 153 / 255, abs=1e-6)


def test_metal_with_coordinates_of_its_own():
    codes = np.zeros((1, 2, 3))
    codes[0, 1] = 255
    part = square(1, Material("m", metallic=1.0, metallic_texture=image(codes)))
    left = np.full((2, 3, 2), 0.25, dtype=np.float32)
    np.testing.assert_allclose(albedo_of(MeshPart(**{**vars(part), "metallic_uv": left}))[0], 1.0, atol=ROUNDING)
    np.testing.assert_allclose(albedo_of(MeshPart(**{**vars(part), "metallic_uv": left + 0.5}))[0], 0.0, atol=ROUNDING)


def test_metal_does_not_mix_with_colour_before_it_is_averaged():
    """White metal in black paint: the mean of the product, 0, not the product of the means, 1/4."""
    stripes = np.repeat(np.arange(64)[None, :, None] % 2 * 255, 3, axis=2).repeat(64, axis=0)
    part = square(64, Material("m", texture=image(stripes), metallic=1.0, metallic_texture=image(stripes)))
    interior = np.abs(part.positions[:, :2] - 0.5).max(axis=1) < 0.49
    assert albedo_of(part)[0][interior].max() < 0.2


def test_one_image_for_colour_and_metal():
    """Linear for the one, sRGB for the other, though it is one texture."""
    both = image(np.full((2, 2, 3), 128))
    albedo, metallic = albedo_of(square(1, Material("m", texture=both, metallic=1.0, metallic_texture=both)))
    np.testing.assert_allclose(albedo, linear(128) * (1 - 128 / 255), rtol=1e-5)
    assert metallic == pytest.approx(128 / 255, rel=1e-6)


def test_a_texture_of_a_coarse_and_a_fine_part_is_kept_fine(rng):
    """Whichever comes first: two triangles under all of an image must not blur it for a grid."""
    shared = image(np.repeat(rng.integers(0, 2, (16, 16, 1)) * 255, 3, axis=2).repeat(4, axis=0).repeat(4, axis=1))
    coarse, fine = (square(n, Material("m", texture=shared)) for n in (1, 64))
    alone, _ = albedo_of(fine)
    for parts in ((coarse, fine), (fine, coarse)):
        np.testing.assert_allclose(vertex_albedo(fine, decode_textures(parts))[0], alone, atol=ROUNDING)


def test_what_cannot_be_used_is_remarked_on_once_and_counts_as_white(tmp_path, caplog):
    lost, damaged = Texture("lost.png", tmp_path / "lost.png"), Texture("bad.png", b"\x89PNG\r\n\x1a\nrubbish")
    parts = [square(1, Material(f"m{k}", (0.5, 0.5, 0.5), texture)) for k, texture in enumerate((lost, damaged, lost))]
    with caplog.at_level(logging.INFO):
        textures = decode_textures(parts)
        for part in parts:
            np.testing.assert_allclose(vertex_albedo(part, textures)[0], 0.5)
    remarks = [record.getMessage() for record in caplog.records]
    assert len(remarks) == 2
    assert remarks[0].startswith("texture lost.png: there is no file")
    assert all(remark.endswith("; it counts as white") for remark in remarks)


def test_a_lost_texture_of_metal_does_not_blacken_the_model(tmp_path, caplog):
    lost = Material("m", metallic=1.0, metallic_texture=Texture("lost.png", tmp_path / "lost.png"))
    with caplog.at_level(logging.INFO):
        albedo, metallic = albedo_of(square(1, lost))
    np.testing.assert_allclose(albedo, 1.0)
    assert metallic == 0.0
    assert "counts as not metallic" in caplog.text


def test_a_texture_without_coordinates_is_left_out_with_a_remark(caplog):
    part = square(1, Material("m", (0.5, 0.5, 0.5), image(np.zeros((2, 2, 3)))))
    with caplog.at_level(logging.INFO):
        albedo, _ = albedo_of(MeshPart(**{**vars(part), "uv": None}))
    np.testing.assert_allclose(albedo, 0.5)
    assert "has no coordinates" in caplog.text


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_coordinates_that_are_rubbish(bad):
    part = square(2, Material("m", texture=image(np.full((4, 4, 3), 188))))
    part.uv[3, 1] = bad
    with np.errstate(all="raise"):
        np.testing.assert_allclose(albedo_of(part)[0], linear(188), rtol=1e-5)


def test_vertices_that_no_face_uses():
    part = square(1, Material("m", texture=image(np.full((2, 2, 3), 255))))
    loose = MeshPart(**{**vars(part), "positions": np.concatenate([part.positions, [[9.0, 9.0, 9.0]]])})
    albedo, _ = albedo_of(loose)
    np.testing.assert_allclose(albedo[:4], 1.0, atol=ROUNDING)
    assert np.isfinite(albedo).all()


# --- What is not simulated -------------------------------------------------------------------------------------------


def plain(name: str, *effects: str, metallic: float = 0.0) -> MeshPart:
    return square(1, Material(name, metallic=metallic, not_simulated=effects))


def names(parts, metallic) -> tuple[str, ...]:
    return tuple(row.name for row in effects_left_out(parts, metallic))


def test_effects_name_no_more_than_three_materials():
    parts = [plain(name, "transparency") for name in ("glass", "leaf", "glass", "veil")]
    assert names(parts, [0.0] * 4) == ("transparency of materials 'glass', 'leaf', 'veil'",)
    parts.append(plain("mist", "transparency", "normal map"))
    assert names(parts, [0.0] * 5) == (
        "transparency of 4 materials ('glass', 'leaf', 'veil', …)",
        "normal map of material 'mist'",
    )


def test_materials_without_a_name():
    assert names([plain("", "normal map")], [0.0]) == ("normal map of a material without a name",)
    assert names([plain("", "normal map"), plain("a", "normal map")], [0.0, 0.0]) == ("normal map of material 'a'",)
    assert names([square(1, None)], [0.0]) == ()


def test_the_share_of_metal_is_that_of_the_surface():
    """A quarter: one square in four, though each has as many vertices; and the one that is mostly metal is named."""
    parts = [plain("steel", metallic=1.0), *(plain(f"paint {k}") for k in range(3))]
    (row,) = effects_left_out(parts, [1.0, 0.0, 0.0, 0.0])
    assert row.name == "metallic reflection of material 'steel'"
    assert row.share == pytest.approx(0.25, rel=1e-12)
    assert effects_left_out(parts, [0.0] * 4) == ()
    (row,) = effects_left_out(parts, [0.2] * 4)
    assert row.name == "metallic reflection"
    assert row.share == pytest.approx(0.2, rel=1e-12)
    assert effects_left_out(parts, [0.005] * 4) == ()


# --- What vertices lose ----------------------------------------------------------------------------------------------


def test_lost_is_what_interpolation_misses():
    """A step over one square, against a dense grid of points of its two triangles."""
    codes = np.zeros((64, 64, 3))
    codes[:, 32:] = 255
    part = square(1, Material("step", texture=image(codes, wrap=("clamp", "clamp"))))
    textures = decode_textures([part])
    albedo, _ = vertex_albedo(part, textures)
    x, y = np.meshgrid(*[(np.arange(500) + 0.5) / 500] * 2, indexing="ij")
    held = albedo[:, 0].reshape(2, 2)  # by x, then y
    lower = held[0, 0] + x * (held[1, 0] - held[0, 0]) + y * (held[1, 1] - held[1, 0])
    upper = held[0, 0] + y * (held[0, 1] - held[0, 0]) + x * (held[1, 1] - held[0, 1])
    step = np.where(x > 0.5, 1.0, 0.0)
    expected = np.sqrt(np.mean((step - np.where(x > y, lower, upper)) ** 2) / np.mean(step**2))
    # Texels next to the step are interpolated: 1/64 of the square is between.
    np.testing.assert_allclose(texture_lost(part, textures, albedo), expected, rtol=0.03)
    assert expected > 0.2


def test_nothing_is_lost_without_a_texture_or_of_one_that_is_flat():
    plain = square(2, Material("plain", (0.3, 0.6, 0.2)))
    assert texture_lost(plain, decode_textures([plain]), vertex_albedo(plain, {})[0]) == 0.0
    flat = square(2, Material("flat", texture=image(np.full((8, 8, 3), 128))))
    textures = decode_textures([flat])
    assert texture_lost(flat, textures, vertex_albedo(flat, textures)[0]) < ROUNDING


def test_what_is_lost_is_a_row_of_the_plan():
    parts = [square(1, Material(name)) for name in ("a", "b")]
    (row,) = effects_left_out(parts, [0.0, 0.0], [0.3, 0.01])
    assert row.name == "texture between vertices of material 'a'"
    assert (round(row.share, 12), row.verdict) == (0.3, "gathered")
    assert effects_left_out(parts, [0.0, 0.0], [0.04, 0.01]) == ()
