"""Pixels of a film in a file, by an independent reader of its arrays."""

import zipfile
from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.files import container
from slepian_prt.compression.files.prt_file import load
from slepian_prt.compression.film_compression import compress_film, film_of, noise_of
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.spectrum import falling_prior
from slepian_prt.relighting.relight import relight
from slepian_prt.scene.film import Film, film_mesh, stored_axes
from slepian_prt.sphere.harmonics import degrees
from slepian_prt.transport.transfer import Transfer
from slepian_prt.transport.transfer_file import load_transfer
from tests import format_pixels
from tests.agreement import assert_readers_agree
from tests.conftest import bumpy, random_directions
from tests.fuzzing.prt_files import pack
from tests.numerics import assert_exact, assert_rounded

WIDTH, HEIGHT, BANDLIMIT = 24, 16, 3


def captured(rng, noise=0.05) -> Transfer:
    """A smooth picture with noise, whose first row shows nothing but the background."""
    count = WIDTH * HEIGHT
    axes = random_directions(rng, count)
    axes[:WIDTH] = 0.0
    rows, columns = np.divmod(np.arange(count), WIDTH)
    waves = np.stack([np.cos(0.1 * k * columns + 0.07 * rows) for k in range(16)], axis=1)
    vectors = np.stack([waves * scale for scale in (1.0, 0.7, 0.4)], axis=1)
    vectors += noise * rng.normal(size=vectors.shape)
    vectors[:WIDTH] = 0.0
    background = np.zeros((count, 3), np.float32)
    background[:WIDTH] = 1.0
    background[WIDTH : 2 * WIDTH] = [0.5, 0.25, 0.125]
    axes = stored_axes(axes)
    film = Film(
        name="eye",
        width=WIDTH,
        height=HEIGHT,
        crop=(3, 1),
        size=(40, 30),
        background=background,
        directions=rng.normal(size=(2, 3, 4, 3)).astype(np.float32),
        noise=np.abs(rng.normal(size=count)).astype(np.float32),
        noise_power=3.0 * noise**2 * np.bincount(degrees(BANDLIMIT)) * (1.0 - 1.0 / HEIGHT),
    )
    mesh = film_mesh("eye", WIDTH, HEIGHT, axes)
    return Transfer(vectors.astype(np.float32), axes, mesh, (), BANDLIMIT, 64, 0, (), 0, 0, toward_view=True, film=film)


def test_a_film_comes_back(rng, tmp_path):
    transfer = captured(rng)
    packed = compress(transfer, "none", coding="float32")
    packed.save(tmp_path / "film.prt")
    read = load(tmp_path / "film.prt")
    assert (read.film.width, read.film.height, read.film.crop, read.film.size) == (WIDTH, HEIGHT, (3, 1), (40, 30))
    assert read.film.name == "eye"
    assert_exact(read.film.directions, transfer.film.directions, "stored as they are")
    np.testing.assert_allclose(read.film.background, transfer.film.background, atol=0.5 / 65535 + 1e-7)
    octave = 2.0 ** (1.0 / 16.0)  # half a step of eight to an octave
    ratio = read.film.noise / transfer.film.noise
    assert octave**-1.001 < ratio.min() <= ratio.max() < octave**1.001
    assert_exact(read.film.noise_power, transfer.film.noise_power, "JSON keeps the digits of doubles")
    assert_exact(read.mesh.normals, transfer.axes, "axes are those of the file already")
    assert_exact(read.mesh.positions, transfer.mesh.positions, "told by the size of the film")
    assert_exact(read.mesh.faces, transfer.mesh.faces, "told by the size of the film")
    assert_rounded(read.reconstruct(), transfer.vectors, 4)


def test_a_reader_written_from_the_page_gets_the_same(rng, tmp_path):
    transfer = captured(rng)
    packed = compress(transfer, tolerance=0.1, clusters=8)
    packed.save(tmp_path / "film.prt")
    read, independent = assert_readers_agree(tmp_path / "film.prt")
    assert read.coded is not None
    assert_exact(independent.arrays["mesh/normals"], read.mesh.normals.astype(np.float32), "integers, then IEEE")
    assert_exact(independent.arrays["mesh/positions"], read.mesh.positions, "whole numbers")
    np.testing.assert_allclose(format_pixels.film_background(independent.arrays), read.film.background, rtol=1e-6)
    np.testing.assert_allclose(format_pixels.film_noise(independent.arrays), read.film.noise, rtol=1e-6)


def test_uncompressed_films(rng, tmp_path):
    transfer = captured(rng)
    transfer.save(tmp_path / "film.npz")
    read = load_transfer(tmp_path / "film.npz")
    for name in ("background", "directions", "noise", "noise_power"):
        assert_exact(getattr(read.film, name), getattr(transfer.film, name), "stored as they are")
    assert (read.film.width, read.film.crop, read.film.size) == (WIDTH, (3, 1), (40, 30))
    assert read.at_bandlimit(1).film.noise_power.shape == (2,)


@pytest.mark.parametrize("part", ["axes", "background", "noise", "directions"])
def test_damaged_films_are_refused(part, rng, tmp_path):
    compress(captured(rng), "none", coding="float32").save(tmp_path / "film.prt")
    contents = container.Contents(tmp_path / "film.prt")
    manifest, arrays = contents.manifest, contents.arrays()
    arrays[f"film/{part}"] = arrays[f"film/{part}"][..., :-1]
    (tmp_path / "film.prt").write_bytes(pack(manifest, arrays))
    with pytest.raises(UserError, match="do not fit together"):
        load(tmp_path / "film.prt")


def test_films_are_coded_to_a_third_of_their_noise(rng, tmp_path):
    """The noise is what was put in, and coding adds no more than a twentieth to it."""
    transfer = captured(rng)
    weights = falling_prior(BANDLIMIT).weights[degrees(BANDLIMIT)]
    clean = captured(np.random.default_rng(1), noise=0.0)
    told = noise_of(transfer)
    error = np.linalg.norm((transfer.vectors - clean.vectors) * weights) / np.linalg.norm(clean.vectors * weights)
    assert told == pytest.approx(error, rel=0.05)
    packed = compress_film(transfer)
    coding = np.linalg.norm((packed.reconstruct() - transfer.vectors) * weights)
    assert coding / np.linalg.norm(clean.vectors * weights) < 0.37 * told
    assert packed.noise() == pytest.approx(told, rel=0.02)
    assert packed.bytes_per_vertex < 40.0


def test_a_camera_that_sees_nothing(rng, tmp_path):
    transfer = captured(rng)
    dark = replace(transfer, vectors=np.zeros_like(transfer.vectors))
    compress_film(dark).save(tmp_path / "dark.prt")
    assert not relight(load(tmp_path / "dark.prt"), np.ones((3, 16))).any()
    # What is dark takes no space: less than a coefficient of each pixel would.
    with zipfile.ZipFile(tmp_path / "dark.prt") as parts:
        assert parts.getinfo("coefficients.npy").compress_size < WIDTH * HEIGHT


def test_transfer_of_a_mesh_is_no_film():
    mesh = bumpy(1)
    vectors = np.ones((len(mesh.positions), 1, 16), np.float32)
    with pytest.raises(UserError, match="holds no pixels"):
        film_of(Transfer(vectors, mesh.normals, mesh, (), 3, 1, 0, (), 0, 0))
