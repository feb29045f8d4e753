"""Files have an order of their own, and keep that of their source if they are asked to."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.files import container
from slepian_prt.compression.files.prt_file import load
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy
from tests.fuzzing.prt_files import pack
from tests.numerics import assert_exact, assert_rounded

WAYS = ({"tolerance": 0.05}, {"terms": 6}, {"tolerance": 0.05, "group_by": "bent"}, {"basis": "none"})


@pytest.fixture(scope="module")
def transfer():
    return precompute(bumpy(3), bandlimit=4, samples=64)


def lamps(vertices: int) -> FixedLights:
    light = np.random.default_rng(0).random((1, vertices, 3)).astype(np.float32) * 2.0**-3
    return FixedLights(("lamp",), ("point",), np.ones((1, 3)), light, light[:, ::-1].copy(), np.zeros((1, 3)))


@pytest.mark.parametrize("way", WAYS, ids=str)
def test_loading_and_saving_again_gives_the_same_bytes(way, transfer, tmp_path):
    packed = replace(compress(transfer, clusters=6, **way), fixed=lamps(642))
    for keep in (False, True):
        packed.save(tmp_path / "one.prt", keep_order=keep)
        read = load(tmp_path / "one.prt")
        read.save(tmp_path / "two.prt", keep_order=keep)
        assert (tmp_path / "one.prt").read_bytes() == (tmp_path / "two.prt").read_bytes()
        order = np.arange(642) if keep else packed.stored.order
        assert_rounded(read.reconstruct(), packed.reconstruct()[order], terms=2 * 25, size=1.0)
        assert_exact(read.clusters.index, packed.clusters.index[order], because="integers")
        np.testing.assert_allclose(read.fixed.bounced, packed.fixed.bounced[:, order], rtol=2.0**-11)
    # A file that kept the order can be written without, and the other way round nothing is known.
    load(tmp_path / "one.prt").save(tmp_path / "without.prt")
    packed.save(tmp_path / "plain.prt")
    assert (tmp_path / "without.prt").read_bytes() == (tmp_path / "plain.prt").read_bytes()


def test_exact_meshes_keep_their_bits(transfer, tmp_path):
    packed = compress(transfer, tolerance=0.05, clusters=6, exact_mesh=True)
    packed.save(tmp_path / "exact.prt", keep_order=True)
    read = load(tmp_path / "exact.prt")
    assert_exact(read.mesh.positions, transfer.mesh.positions, because="bits are kept")
    assert_exact(read.mesh.normals, transfer.mesh.normals.astype(np.float32), because="bits of float32 are kept")
    assert_rounded(read.reconstruct(), packed.reconstruct(), terms=2 * 25, size=1.0)


def test_clusters_that_were_made_on_the_source_are_those_of_the_file(transfer, tmp_path):
    """Readers tell by the normals of the file which site is nearest; those of the source may be nearer to another."""
    from slepian_prt.compression.clustering import cluster_axes

    clusters = cluster_axes(transfer.mesh.normals, 200)
    packed = compress(transfer, tolerance=0.05, clusters=clusters)
    packed.save(tmp_path / "sites.prt", keep_order=True)
    assert_exact(load(tmp_path / "sites.prt").clusters.index, packed.clusters.index, because="integers")
    assert_rounded(load(tmp_path / "sites.prt").reconstruct(), packed.reconstruct(), terms=2 * 25, size=1.0)


def test_the_size_of_a_file_is_what_its_parts_add_up_to(transfer, tmp_path):
    packed = replace(compress(transfer, tolerance=0.05, clusters=6), fixed=lamps(642))
    before = packed.bytes_per_vertex, packed.mesh_bytes_per_vertex, packed.file_bytes_per_vertex
    packed.save(tmp_path / "a.prt")
    read = load(tmp_path / "a.prt")
    assert (read.bytes_per_vertex, read.mesh_bytes_per_vertex, read.file_bytes_per_vertex) == before
    size = (tmp_path / "a.prt").stat().st_size
    assert read.file_bytes_per_vertex * 642 == pytest.approx(size, rel=1e-12)
    arrays = container.Contents(tmp_path / "a.prt").arrays()
    assert sum(before[:2]) * 642 < size - sum(arrays[name].nbytes for name in arrays if name.startswith("fixed")) / 2


@pytest.mark.parametrize(
    "spoil", [lambda order: order[:-1], lambda order: np.zeros_like(order), lambda order: order + 1]
)
def test_orders_that_are_none(spoil, transfer, tmp_path):
    from slepian_prt.compression.stored_mesh.stored import pack_order

    packed = compress(transfer, tolerance=0.1, clusters=2)
    packed.save(tmp_path / "a.prt")
    contents = container.Contents(tmp_path / "a.prt")
    manifest, arrays = contents.manifest, contents.arrays()
    arrays |= pack_order(spoil(packed.stored.order), packed.mesh)
    (tmp_path / "b.prt").write_bytes(pack({**manifest, "arrays": list(arrays)}, arrays))
    with pytest.raises(UserError, match="do not fit together"):
        load(tmp_path / "b.prt").reconstruct()
