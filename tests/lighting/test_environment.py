import numpy as np
import OpenEXR
import pytest

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import Environment, about_up, make_environment, read_environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.renderer.variants import bitmap_module, mitsuba
from slepian_prt.sphere.harmonics import num_coefficients, real_sh
from slepian_prt.sphere.quadrature import spherical_fibonacci


def grid_directions(height: int) -> np.ndarray:
    """(H, 2H, 3) directions of the texel centres, as Mitsuba has them."""
    v = np.pi * np.arange(height) / (height - 1)
    u = 2 * np.pi * (np.arange(2 * height) + 0.5) / (2 * height)
    v, u = np.meshgrid(v, u, indexing="ij")
    return np.stack([np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u)], axis=-1)


def mitsuba_radiance(environment: Environment, directions: np.ndarray) -> np.ndarray:
    """(3, n) what Mitsuba's emitter sends from directions (n, 3)."""
    matrix = np.eye(4)
    matrix[:3, :3] = environment.to_world
    with mitsuba() as mi:
        import drjit as dr

        emitter = mi.load_dict(
            {
                "type": "envmap",
                "bitmap": mi.Bitmap(environment.texels),
                "to_world": mi.ScalarTransform4f(matrix.tolist()),
            }
        )
        si = dr.zeros(mi.SurfaceInteraction3f, len(directions))
        si.wi = -mi.Vector3f(directions.T.astype(np.float32))
        return np.array(emitter.eval(si)).reshape(3, -1)


@pytest.mark.parametrize("bandlimit", [0, 3, 10])
def test_bandlimited_maps_are_exact(bandlimit, rng):
    coefficients = rng.normal(size=(3, num_coefficients(bandlimit)))
    texels = np.einsum(
        "hwm,cm->hwc", real_sh(bandlimit, grid_directions(129).reshape(-1, 3)).reshape(129, 258, -1), coefficients
    )
    environment = Environment("exact", texels, np.eye(3))
    np.testing.assert_allclose(project_environment(environment, bandlimit), coefficients, atol=1e-12)


@pytest.mark.parametrize("shape", [(1, 2), (2, 4), (5, 10), (40, 80)])
def test_small_maps_are_projected_as_mitsuba_interpolates_them(shape, rng):
    environment = make_environment(rng.random((*shape, 3))).rotated(37.0)
    directions = spherical_fibonacci(200_000)
    radiance = mitsuba_radiance(environment, directions)
    reference = radiance @ real_sh(5, directions) * (4 * np.pi / len(directions))
    # The Fibonacci set integrates the piecewise bilinear map to a few 1e-4; interpolation is good to (LΔ)²/12.
    np.testing.assert_allclose(project_environment(environment, 5), reference, atol=4e-3)


@pytest.mark.parametrize("rotate", [0.0, 90.0, -33.0])
def test_one_hot_texels_point_where_mitsuba_puts_them(rotate):
    """The centroid of the light, which degree 1 holds, is that of Mitsuba's emitter."""
    height = 33
    # A grid that resolves the wedges at the poles, which a uniform set of directions hardly meets.
    v, u = np.meshgrid(np.pi * (np.arange(400) + 0.5) / 400, 2 * np.pi * (np.arange(800) + 0.5) / 800, indexing="ij")
    directions = np.stack([np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u)], axis=-1).reshape(-1, 3)
    solid_angle = np.sin(v).ravel()
    turn = about_up(rotate)
    rng = np.random.default_rng(4)
    for row, column in zip([0, 32, *rng.integers(1, 32, 12)], rng.integers(0, 66, 14), strict=True):
        texels = np.zeros((height, 2 * height, 3), dtype=np.float32)
        texels[row, column] = 1.0
        environment = make_environment(texels).rotated(rotate)
        ours = project_environment(environment, 10)[0, [3, 1, 2]] * [-1, -1, 1]
        directions_there = directions @ turn.T
        weight = mitsuba_radiance(environment, directions_there)[0]
        theirs = (weight * solid_angle) @ directions_there
        cosine = ours @ theirs / (np.linalg.norm(theirs) * np.linalg.norm(ours))
        assert np.arccos(np.clip(cosine, -1, 1)) < 0.01, (row, column)  # a texel is 0.1 rad


def test_rotation_is_counter_clockwise_about_y():
    texels = np.zeros((64, 128, 3))
    texels[30:34, 62:66] = 1.0  # u = 1/2: toward +z (atan2(x, -z) = π)
    center = project_environment(texels, 1)[0, [3, 1, 2]] * [-1, -1, 1]
    np.testing.assert_allclose(center / np.linalg.norm(center), [0, 0, 1], atol=0.03)
    turned = project_environment(texels, 1, rotate=90.0)[0, [3, 1, 2]] * [-1, -1, 1]
    np.testing.assert_allclose(turned / np.linalg.norm(turned), [1, 0, 0], atol=0.03)  # y x z = x


def test_constant_map_is_the_constant():
    light = project_environment(np.full((64, 128, 3), 2.0), 6)
    np.testing.assert_allclose(light[:, 0], 2.0 * np.sqrt(4 * np.pi), rtol=1e-12)
    np.testing.assert_allclose(light[:, 1:], 0.0, atol=1e-12)


def test_black_map_is_zero():
    assert not project_environment(np.zeros((8, 16, 3)), 4).any()


def write_exr(path, texels, compression, half):
    kind = np.float16 if half else np.float32
    channels = {c: np.ascontiguousarray(texels[..., i].astype(kind)) for i, c in enumerate("RGB")}
    with OpenEXR.File({"compression": compression, "type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(path))


@pytest.mark.parametrize("half", [True, False])
@pytest.mark.parametrize("compression", ["NO", "ZIP", "PIZ", "DWAA", "RLE"])
def test_exr_compressions(compression, half, tmp_path, rng):
    texels = (0.5 + rng.random((32, 64, 3))).astype(np.float32)
    texels = np.repeat(np.repeat(texels[::8, ::8], 8, axis=0), 8, axis=1)  # smooth enough for DWA
    path = tmp_path / "map.exr"
    write_exr(path, texels, getattr(OpenEXR, f"{compression}_COMPRESSION"), half)
    read = read_environment(path).texels
    tolerance = 0.1 if compression == "DWAA" else 1e-3 if half else 0.0
    np.testing.assert_allclose(read, texels, atol=tolerance)


def test_hdr_and_png(tmp_path, rng):
    mi = bitmap_module()
    texels = (0.2 + 0.6 * rng.random((16, 32, 3))).astype(np.float32)
    mi.Bitmap(texels).write(str(tmp_path / "map.hdr"))
    np.testing.assert_allclose(read_environment(tmp_path / "map.hdr").texels, texels, rtol=0.02)
    encoded = mi.Bitmap(texels).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
    encoded.write(str(tmp_path / "map.png"))
    np.testing.assert_allclose(read_environment(tmp_path / "map.png").texels, texels, atol=0.01)


def test_small_negative_texels_are_clamped_and_counted():
    texels = np.ones((16, 32, 3))
    texels[3, 4:7] = -0.001
    environment = make_environment(texels)
    assert environment.clamped == 3
    assert environment.texels.min() == 0.0


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda t: t.__setitem__((3, 4), np.nan), "NaN or infinite, the first in row 3, column 4"),
        (lambda t: t.__setitem__((0, 0), np.inf), "NaN or infinite"),
        (lambda t: t.__setitem__((8, 9), -3394.0), r"negative \(down to -3394\).*`clamp_negative`"),
    ],
)
def test_bad_texels(spoil, message):
    texels = np.ones((16, 32, 3))
    spoil(texels)
    with pytest.raises(UserError, match=message):
        make_environment(texels)


def test_clamping_on_request():
    texels = np.ones((16, 32, 3))
    texels[8, 9] = -3394.0
    assert make_environment(texels, clamp_negative=True).texels.min() == 0.0


@pytest.mark.parametrize("shape", [(16, 16, 3), (32, 16, 3), (16, 33, 3)])
def test_wrong_aspect(shape):
    with pytest.raises(UserError, match="twice as wide as high"):
        make_environment(np.ones(shape))


def test_wrong_rank():
    with pytest.raises(UserError, match="shape"):
        make_environment(np.ones((3, 16, 32, 3)))


@pytest.mark.parametrize("content", [b"", b"garbage"])
def test_unreadable_file(content, tmp_path):
    path = tmp_path / "map.exr"
    path.write_bytes(content)
    with pytest.raises(UserError, match="cannot be read as an environment map") as caught:
        read_environment(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(UserError, match="no such file"):
        read_environment(tmp_path / "nothing.exr")


def test_the_broken_sky_is_refused(data):
    with pytest.raises(UserError, match=r"negative \(down to -3394\)"):
        read_environment(data / "environments" / "negative_sky.exr")
    assert read_environment(data / "environments" / "negative_sky.exr", clamp_negative=True).clamped > 0


@pytest.mark.parametrize("name", ["studio", "courtyard", "interior", "sunrise"])
def test_real_maps_are_taken(name, data):
    environment = read_environment(data / "environments" / f"{name}.exr")
    assert environment.texels.min() >= 0.0
    # Degree 0 is the mean radiance: compare with a plain sum over texels.
    height = len(environment.texels)
    sine = np.sin(np.pi * np.arange(height) / (height - 1))
    mean = (environment.texels.astype(np.float64) * sine[:, None, None]).sum(axis=(0, 1)) / (sine.sum() * 2 * height)
    light = project_environment(environment, 0)[:, 0]
    np.testing.assert_allclose(light, mean * np.sqrt(4 * np.pi), rtol=1e-4)
