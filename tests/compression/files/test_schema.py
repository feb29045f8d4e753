"""What files hold is checked in one place: whatever does not fit is one UserError, and takes no memory or time."""

import contextlib
import copy
import io
import json
import math
import random
import tracemalloc
import zipfile
from functools import partial

import numpy as np
import pytest

from slepian_prt.compression.codec import lanes
from slepian_prt.compression.files import stored_transfer
from slepian_prt.compression.files.array_schema import ARRAYS
from slepian_prt.compression.files.container import Contents
from slepian_prt.compression.files.manifest import LARGEST_BANDLIMIT, read_manifest
from slepian_prt.compression.files.prt_file import load
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.export.model import export_model
from slepian_prt.machine.memory import memory_limited
from slepian_prt.relighting.factors import all_factors
from slepian_prt.relighting.relight import relight
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.scene.view import look_matrix
from slepian_prt.transport import settings
from slepian_prt.transport.transfer import precompute
from slepian_prt.viewer.pages import save_page
from tests.conftest import bumpy
from tests.fuzzing.prt_files import mutate, npy, pack, unpack
from tests.numerics import assert_exact

KINDS = {
    "coded": {"tolerance": 0.005, "clusters": 6},
    "axes": {"basis": "cpca", "terms": 5, "clusters": 5, "coding": "coded"},
    "float32": {"basis": "transport", "terms": 6, "clusters": 6, "coding": "float32"},
    "float16": {"basis": "adapted", "terms": 6, "clusters": 6, "coding": "float16"},
    "none": {"basis": "none"},
    "classes": {"tolerance": 0.1, "clusters": 6, "group_by": "bent", "occlusion_classes": 2},
    "exact": {"tolerance": 0.05, "clusters": 4, "exact_mesh": True},
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The content of a file of each kind."""
    transfer, found = precompute(bumpy(2), 5, 64), {}
    for name, options in KINDS.items():
        path = tmp_path_factory.mktemp("schema") / f"{name}.prt"
        compress(transfer, **options).save(path, keep_order=True)
        found[name] = path.read_bytes()
    return found


def refused(content: bytes, path, match: str | None = None) -> None:
    """Reading it, or what is in it, is one line of ours."""
    path.write_bytes(content)
    with pytest.raises(UserError, match=match) as told:
        used(path)
    assert "\n" not in str(told.value)


def used(path) -> None:
    packed = load(path)
    relight(packed, np.ones((3, (packed.bandlimit + 1) ** 2)))


def test_the_schema_and_the_settings_allow_the_same_bandlimits():
    assert LARGEST_BANDLIMIT == settings.LARGEST_BANDLIMIT


@pytest.mark.parametrize("kind", KINDS)
def test_another_bandlimit_or_number_of_channels_does_not_fit(kind, files, tmp_path):
    manifest, arrays = unpack(files[kind])
    for change in ({"bandlimit": 4}, {"bandlimit": 6}, {"channels": 3}):
        refused(pack(manifest | change, arrays), tmp_path / "a.prt", "do not fit together")
    fewer = {name: manifest[name][:-1] for name in ("expected_lost", "expected_total")}
    refused(pack(manifest | {"bandlimit": 4} | fewer, arrays), tmp_path / "a.prt", "do not fit together")


OPTIONAL = {"mesh/order", "mean/zonal", "mesh/normal_ways", "clusters/kinds", "mesh/normals", "basis/mean"}


def test_arrays_that_are_missing_or_of_another_type_or_shape(files, tmp_path):
    """Each in a file of one kind that has it, of a type and number of axes."""
    seen = set()
    for content in files.values():
        manifest, arrays = unpack(content)
        assert set(arrays) <= {row.name for row in ARRAYS}
        new = {name: array for name, array in arrays.items() if (name, array.dtype, array.ndim) not in seen}
        seen |= {(name, array.dtype, array.ndim) for name, array in new.items()}
        _spoil_each(new, manifest, arrays, tmp_path / "a.prt")
    assert len(seen) > 25


def _spoil_each(new, manifest, arrays, path):
    for name, array in new.items():
        others = [array.astype(np.float64 if array.dtype != np.float64 else np.int64), array[None], array[..., :-1]]
        if array.shape[0] > 1 or array.ndim == 1:
            others.append(array[:-1])
        if name not in ("caps/terms", "mesh/draco", "coded/prediction"):  # which may be longer
            others.append(np.zeros((*array.shape[:-1], array.shape[-1] + 1), array.dtype))
        for other in others:
            refused(pack(manifest, {**arrays, name: other}), path, "do not fit together")
        if name not in OPTIONAL and not name.startswith(("basis/", "radial/")):
            less = {key: value for key, value in arrays.items() if key != name}
            refused(pack({**manifest, "arrays": list(less)}, less), path)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30])
def test_floats_that_are_not_finite_or_out_of_range(value, files, tmp_path):
    seen = set()
    for content in files.values():
        manifest, arrays = unpack(content)
        for name, array in arrays.items():
            if array.dtype.kind == "f" and name not in seen:
                with np.errstate(over="ignore"):
                    refused(pack(manifest, {**arrays, name: np.full_like(array, value)}), tmp_path / "a.prt", name)
                seen.add(name)
    assert len(seen) >= 6


def test_caps_that_hold_no_vertex(files, tmp_path):
    """Whatever other caps of as many functions hold."""
    manifest, arrays = unpack(files["classes"])
    arrays = {name: array for name, array in arrays.items() if name not in ("coded/words", "coded/bits", "coded/lanes")}
    table = np.zeros_like(arrays["coded/caps"])
    index = np.zeros_like(arrays["clusters/index"])
    names = {"arrays": list(arrays)}
    (tmp_path / "a.prt").write_bytes(pack(manifest | names, {**arrays, "coded/caps": table, "clusters/index": index}))
    used(tmp_path / "a.prt")
    sizes = [len(part.functions) for part in all_factors(load(tmp_path / "a.prt"))]
    assert sizes[0] > 0
    assert not any(sizes[1:])  # so that it takes no time


def test_more_caps_than_vertices(files, tmp_path):
    """Preparing 20,000 caps of bandlimit 50 takes minutes: the mesh has to be as large."""
    manifest, arrays = unpack(files["coded"])
    vertices = sum(count * sides for _, _, count, sides in manifest["parts"])
    refused(pack(manifest | {"caps": vertices + 1}, arrays), tmp_path / "a.prt", f"caps of {vertices} vertices")


def places(value, path=()):
    """Where all values of a manifest are."""
    yield path
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(min(len(value), 2)):
            yield from places(value[key], (*path, key))


def test_no_value_of_a_manifest_can_be_anything(files, tmp_path):
    """Of another type, missing, negative, huge, not finite: refused, or read as it stands."""
    manifest, arrays = unpack(files["coded"])
    path, free = tmp_path / "a.prt", 0
    for place in list(places(manifest))[1:]:
        for value in (None, "x", -1, 2**63, 1e300, math.nan, [], {}, [[]]):
            spoilt = copy.deepcopy(manifest)
            holder = spoilt
            for key in place[:-1]:
                holder = holder[key]
            holder[place[-1]] = value
            with contextlib.suppress(ValueError):  # most are refused without any array
                read_manifest(json.dumps(spoilt).encode())
                path.write_bytes(pack(spoilt, arrays))
                load(path)
                free += 1
    assert free < 250  # text, seconds and the like


@pytest.mark.parametrize("name", ["bandlimit", "caps", "coding", "parts", "mesh", "expected_lost", "name", "effects"])
def test_keys_that_are_missing(name, files, tmp_path):
    manifest, arrays = unpack(files["coded"])
    del manifest[name]
    refused(pack(manifest, arrays), tmp_path / "a.prt", name)


def test_json_that_is_deep_long_or_none(files, tmp_path):
    manifest, arrays = unpack(files["coded"])
    text = pack(manifest, {})
    with zipfile.ZipFile(io.BytesIO(text)) as archive:
        good = archive.read("manifest.json")
    for spoilt in (
        b"[" * 300_000,
        good[:-1] + b', "more": ' + b'{"a":' * 100_000 + b"1" + b"}" * 100_001,
        good + b" " * (1 << 27),
        b"null",
        b"\xff",
        good.replace(b'"bumpy"', b'"\\ud80"'),
    ):
        refused(pack(spoilt, arrays), tmp_path / "a.prt", "damaged|do not fit")


def of_equal_parts(manifest, count):
    """A manifest of so many triangles."""
    triangle = {"vertices": 3, "faces": 1, "sides": 1, "shift": 0, "first": [0, 0, 0], "draco": 0, "loose": 3}
    triangle |= {"loose_faces": 1, "landmarks": [[0, 1, 2], [0, 1, 2]]}
    mesh = manifest["mesh"] | {"pieces": [triangle] * count}
    return manifest | {"parts": [["leaf", 3 * k, 3, 1] for k in range(count)], "mesh": mesh}


def test_manifests_of_very_many_equal_parts_are_read(files, tmp_path):
    """Which deflate 80 times."""
    manifest, _ = unpack(files["coded"])
    path, many = tmp_path / "a.prt", of_equal_parts(manifest, 12_000)
    path.write_bytes(pack(json.dumps(many, indent=1).encode(), {}))
    assert len(Contents(path).manifest["parts"]) == 12_000
    with memory_limited(1 << 20), pytest.raises(UserError, match="memory"):
        Contents(path)


VIEW = {"name": "eye", "to_world": np.eye(4).tolist(), "fov": 40.0, "width": 64, "height": 48, "near": 0.1, "far": 9.0}

VIEWS = {
    "behind": {"near": -1.0},
    "swapped": {"near": 5.0, "far": 1.0},
    "endless": {"far": 1e300},
    "flat": {"fov": 1e-300},
    "around": {"fov": 179.9999999},
    "large": {"width": 65536, "height": 65536},
    "singular": {"to_world": np.zeros((4, 4)).tolist()},
    "huge": {"to_world": np.full((4, 4), 1e300).tolist()},
    "scaled": {"to_world": np.diag([2.0, 2.0, 2.0, 1.0]).tolist()},
    "sheared": {"to_world": [[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
    "projective": {"to_world": np.diag([1.0, 1.0, 1.0, 0.0]).tolist()},
}


@pytest.mark.parametrize("name", VIEWS)
def test_views_that_make_no_camera(name, files, tmp_path):
    manifest, arrays = unpack(files["coded"])
    refused(pack(manifest | {"view": VIEW | VIEWS[name]}, arrays), tmp_path / "a.prt", "view")


def test_views_at_the_edges(files, tmp_path):
    manifest, arrays = unpack(files["coded"])
    turn = np.eye(4, dtype=np.float32)
    turn[:3, :3] = np.float32(look_matrix(np.zeros(3), np.array([1.0, 2.0, 3.0]), "y")[:3, :3])
    for change in ({"far": 1e38}, {"near": 1e-30}, {"to_world": turn.tolist()}, {"width": 65536, "height": 4096}):
        (tmp_path / "a.prt").write_bytes(pack(manifest | {"view": VIEW | change}, arrays))
        assert load(tmp_path / "a.prt").view is not None


def test_more_functions_of_an_order_than_there_are(files, tmp_path):
    """Six of order 5, of which bandlimit 5 has one."""
    manifest, arrays = unpack(files["float32"])
    orders = arrays["radial/order"]
    for order in (5, -5, 0):
        spoilt = {**arrays, "radial/order": np.full_like(orders, order)}
        refused(pack(manifest, spoilt), tmp_path / "a.prt", "radial")
    counts, count = arrays["radial/count"], 8  # of order 0, all the same, which bandlimit 5 has six of
    assert counts.max() <= 36
    first = np.zeros(6, arrays["radial/values"].dtype)
    first[0] = 1.0
    same = {
        "radial/count": np.array([count], np.uint16),
        "radial/family": np.zeros(manifest["caps"], np.uint16),
        "radial/order": np.zeros(count, np.int16),
        "radial/repeats": np.packbits([0] + [1] * (count - 1)),
        "radial/values": first,
    }
    refused(pack(manifest, {**arrays, **same}), tmp_path / "a.prt", "more functions of an order than there are")


@pytest.mark.slow
def test_meshes_that_float32_does_not_hold(tmp_path):
    """Files have them, and relight them to numbers; pages and models are of float32."""
    mesh = bumpy(1)
    for scale, holds in ((1e36, True), (1e45, False)):
        large = make_mesh(scale * mesh.positions, mesh.faces, name="large")
        compress(precompute(large, 1, 16), clusters=2).save(tmp_path / "a.prt")
        used(tmp_path / "a.prt")
        packed = load(tmp_path / "a.prt")
        writers = {"a.html": partial(save_page, transfer=packed), "a.glb": partial(export_model, packed)}
        for name, write in writers.items():
            with contextlib.nullcontext() if holds else pytest.raises(UserError, match="too large to draw"):
                write(path=tmp_path / name)


def test_means_that_are_larger_than_vectors(files, tmp_path):
    """Squares of 2^64 are not finite in float32, which pages and models found too late."""
    manifest, arrays = unpack(files["coded"])
    for value in (2.0**64, -(2.0**47)):
        spoilt = {**arrays, "mean/zonal": np.full_like(arrays["mean/zonal"], value)}
        refused(pack(manifest, spoilt), tmp_path / "a.prt", "mean/zonal")


def test_transfer_whose_squares_float32_does_not_hold(files, tmp_path):
    manifest, arrays = unpack(files["float32"])
    large = {**arrays, "coefficients": np.full_like(arrays["coefficients"], 2.0**63)}
    (tmp_path / "a.prt").write_bytes(pack(manifest, large))
    with pytest.raises(UserError, match="too large for float32"):
        export_model(load(tmp_path / "a.prt"), tmp_path / "a.glb")


# --- Memory and time -------------------------------------------------------------------------------------------------


def peak_of(content: bytes, path) -> int:
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(UserError):
            used(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_what_is_not_expected_is_not_read(files, tmp_path):
    """Members that inflate to ten megabytes: in other shapes, behind their end, or beside what is wanted."""
    manifest, arrays = unpack(files["coded"])
    used_by = {}
    path = tmp_path / "a.prt"
    path.write_bytes(files["coded"])
    used(path)  # tables that are made once
    zeros = bytes(10**7)
    for name in arrays:
        other = npy(np.zeros(1, np.uint8)).replace(b"(1,), }        ", b"(10000000,), } ")[:-1] + zeros
        used_by[name] = peak_of(pack(manifest, {**arrays, name: other}), path)
    for name in ("coded/words", "mesh/draco"):
        used_by[f"{name}, longer"] = peak_of(pack(manifest, {**arrays, name: npy(arrays[name]) + zeros}), path)
    assert max(used_by.values()) < 5 * 10**6, used_by


def test_a_member_of_more_than_the_directory_says(files, tmp_path):
    manifest, arrays = unpack(files["coded"])
    buffer = io.BytesIO(pack(manifest, {**arrays, "mesh/draco": npy(arrays["mesh/draco"]) + bytes(10**8)}))
    content, wanted = bytearray(buffer.getvalue()), len(npy(arrays["mesh/draco"]))
    for mark, place in ((b"PK\3\4", 22), (b"PK\1\2", 24)):
        at = 0
        while (at := content.find(mark, at)) >= 0:
            if b"mesh/draco.npy" in content[at : at + 64]:
                content[at + place : at + place + 4] = wanted.to_bytes(4, "little")
            at += 4
    assert peak_of(bytes(content), tmp_path / "a.prt") < 2 * 10**7


def test_directories_that_are_long_and_members_of_the_same_name(files, tmp_path):
    buffer = io.BytesIO(files["coded"])
    with zipfile.ZipFile(buffer, "a") as archive:
        for number in range(20_000):
            archive.writestr(f"{number:060}", b"")
    assert peak_of(buffer.getvalue(), tmp_path / "a.prt") < 10**7
    buffer = io.BytesIO(files["coded"])
    with zipfile.ZipFile(buffer, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("manifest.json", b"{}")
    refused(buffer.getvalue(), tmp_path / "a.prt", "two members of the same name")


def test_claims_that_no_memory_holds_are_refused_before_it_is_taken(files, tmp_path, monkeypatch):
    """A manifest of ten million times as many vertices as there are, all of it consistent."""
    manifest, arrays = unpack(files["coded"])
    count = 10**9
    manifest["parts"][0][2] = manifest["mesh"]["pieces"][0]["vertices"] = count
    path = tmp_path / "a.prt"
    assert peak_of(pack(manifest, arrays), path) < 10**7
    with pytest.raises(UserError, match="memory"):
        used(path)
    path.write_bytes(files["coded"])
    monkeypatch.setattr(stored_transfer, "_OF_VERTEX", 1 << 20)
    with memory_limited(1 << 20), pytest.raises(UserError, match=r"needs about .* of memory"):
        used(path)


def test_draco_is_not_asked_for_other_numbers_of_faces_than_the_manifest_tells(files, tmp_path):
    manifest, arrays = unpack(files["coded"])
    draco = arrays["mesh/draco"]
    for begin in (
        b"DRACO\2\2\1\1\0\0\0\xa2\1\xff\xff\xff\xff\x0f",
        b"DRACO\2\2\0",
        b"PLY",
        b"DRACO\2\2\1\1\0\0\0\xff\xff\xff\xff\xff",
    ):
        spoilt = draco.copy()
        spoilt[: len(begin)] = np.frombuffer(begin, np.uint8)
        refused(pack(manifest, {**arrays, "mesh/draco": spoilt}), tmp_path / "a.prt", "mesh/draco")


@pytest.mark.slow
def test_lanes_of_very_different_lengths_are_read_apart(monkeypatch):
    """The same symbols; and no memory for steps in which lanes have nothing to do."""
    rng = np.random.default_rng(3)
    table = lanes.ModelTable(np.full((1, 2), lanes.WHOLE // 2))
    counts = np.array([20_000, 3000, 0, 5])
    drawn = rng.integers(0, 2, counts.sum())
    caps = [
        lanes.encode_lanes([lanes.Symbols(counts[c : c + 1], np.zeros_like(own), own)], np.array([number]), table)[0]
        for c, (own, number) in enumerate(zip(np.split(drawn, np.cumsum(counts)[:-1]), (1, 3000, 2, 1), strict=True))
    ]
    tracemalloc.start()
    reader = lanes.LaneReader(caps, table)
    found = reader.read(counts, np.zeros_like(drawn))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    reader.check_end()
    assert_exact(found, drawn, because="integers")
    assert peak < 60 * counts.sum() + 3 * 10**6


@pytest.mark.parametrize("seed", range(20))
def test_whatever_is_done_to_a_file(seed, files, tmp_path):
    """Read and relit, or one line of ours."""
    chance = random.Random(seed)
    path = tmp_path / "a.prt"
    path.write_bytes(mutate(files[chance.choice(list(files))], chance))
    with memory_limited(1 << 30), contextlib.suppress(UserError):
        used(path)
