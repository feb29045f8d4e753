"""Whatever is saved is read, and so is what earlier versions saved."""

import json
import math
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slepian_prt.compression.files.prt_file import load
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.relighting.relight import relight
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import View
from slepian_prt.transport.effects import SIMULATED, Effect
from slepian_prt.transport.transfer import precompute
from slepian_prt.transport.transfer_about import Shapes
from slepian_prt.transport.transfer_file import load_transfer
from tests.conftest import bumpy
from tests.fuzzing.prt_files import pack, unpack
from tests.numerics import assert_exact

EARLIER = Path(__file__).parent / "earlier"

# Files of earlier versions, and the root mean square of red, green and blue that those versions made of them under the
# light of `relit`.
RADIANCE = {
    "first-adapted-coded": (0.303622, 0.263997, 0.299275),
    "first-cpca-float16": (0.304172, 0.264919, 0.300389),
    "first-film": (0.0751705, 0.0577671, 0.0451441),
    "first-group-bent-1": (0.304064, 0.265692, 0.30109),
    "first-prior": (0.304065, 0.265692, 0.30109),
    "first-unused": (0.298403, 0.160212, 0.300353),
    "second-cpca-coded": (0.304302, 0.265083, 0.300642),
    "second-group-bent-2": (0.304072, 0.265585, 0.301082),
    "second-soup": (0.248291, 0.171512, 0.157271),
}


def relit(path):
    """Under coefficients of noise."""
    packed = load(path)
    return relight(packed, np.random.default_rng(1).random((3, (packed.bandlimit + 1) ** 2)))


@pytest.mark.parametrize("name", RADIANCE)
def test_files_of_earlier_versions_give_what_they_gave(name):
    found = np.sqrt((relit(EARLIER / f"{name}.prt").astype(np.float64) ** 2).mean(axis=0))
    np.testing.assert_allclose(found, RADIANCE[name], rtol=5e-6)  # of six digits


@pytest.fixture(scope="module")
def transfer():
    return precompute(bumpy(2), 2, 16)


@pytest.fixture(scope="module")
def packed(transfer):
    return compress(transfer, terms=4, clusters=3, coding="coded")


def saved(packed, folder):
    packed.save(folder / "a.prt")
    return load(folder / "a.prt")


@pytest.mark.parametrize("more", [-1, 3])
def test_predictions_of_wider_or_narrower_caps(more, packed, tmp_path):
    """Wider ones, which warm starts once wrote, hold what is not read."""
    packed.save(tmp_path / "a.prt")
    manifest, arrays = unpack((tmp_path / "a.prt").read_bytes())
    before = relit(tmp_path / "a.prt")
    widest = arrays["coded/prediction"].shape[1]
    arrays["coded/prediction"] = np.pad(arrays["coded/prediction"], ((0, 0), (0, 9)))[:, : widest + more]
    (tmp_path / "b.prt").write_bytes(pack(manifest, arrays))
    if more < 0:
        with pytest.raises(UserError, match="coded/prediction"):
            load(tmp_path / "b.prt")
    else:
        assert_exact(relit(tmp_path / "b.prt"), before, because="the same numbers are read")


def size_of_manifest(path):
    """And what it is packed to."""
    with zipfile.ZipFile(path) as archive:
        member = archive.getinfo("manifest.json")
        return member.file_size, member.compress_size


def test_scenes_of_thousands_of_shapes_that_are_alike(packed, tmp_path):
    """Their manifest is packed to a fiftieth, or less."""
    packed.save(tmp_path / "a.prt")
    manifest, arrays = unpack((tmp_path / "a.prt").read_bytes())
    effects = [Effect("e", SIMULATED, 0.25, 0.125, n // 500, "it is there").as_dict() for n in range(12_000)]
    (tmp_path / "b.prt").write_bytes(pack(json.dumps({**manifest, "effects": effects}, indent=1).encode(), arrays))
    whole, part = size_of_manifest(tmp_path / "b.prt")
    assert whole > (1 << 20) + 32 * part  # which once was too much
    assert len(load(tmp_path / "b.prt").effects) == 12_000
    # As they are written now, all the same.
    same = (Effect(**effects[0]),) * 12_000
    assert len(saved(replace(packed, effects=same), tmp_path).effects) == 12_000
    whole, part = size_of_manifest(tmp_path / "a.prt")
    assert part == whole > 1 << 20


def test_names_that_are_not_utf8(packed, transfer, tmp_path):
    """As earlier versions wrote them, too: bytes of file names that are no text have no character in JSON."""
    packed.save(tmp_path / "a.prt")
    manifest, arrays = unpack((tmp_path / "a.prt").read_bytes())
    manifest |= {"source": "a\udcff\\udcff/\U0001f600.obj", "notes": ["\ud83d"]}
    (tmp_path / "b.prt").write_bytes(pack(manifest, arrays))
    read = load(tmp_path / "b.prt")
    assert (read.source, read.mesh.notes) == ("a\ufffd\\udcff/\U0001f600.obj", ("\ufffd",))
    replace(transfer, source="a\udcff").save(tmp_path / "a.npz")
    assert load_transfer(tmp_path / "a.npz").source == "a\ufffd"


def test_texts_and_numbers_that_no_file_holds(packed, transfer, tmp_path):
    """Longer, or not finite: shortened or left out."""
    far = View("c", np.eye(4).tolist(), 45.0, 8, 8, 0.1, math.inf)
    effect = Effect("e", SIMULATED, math.nan, math.inf, 1, "r" * 70_000)
    odd = {"seconds": {"a": 1.0, "b": math.nan}, "effects": (effect,), "view": far, "source": "s" * 70_000}
    mesh = replace(packed.mesh, name="n" * 70_000, notes=("m" * 70_000,) * 80)
    read = saved(
        replace(packed, mesh=mesh, verified={"black": math.inf, "grey": 0.5}, path_noise=math.nan, **odd), tmp_path
    )
    assert [len(text) for text in (read.mesh.name, read.mesh.notes[0], read.source)] == [1 << 16] * 3
    assert (read.verified, read.path_noise, read.seconds) == ({"grey": 0.5}, None, {"a": 1.0})
    assert (read.effects[0].contribution, read.view.far) == (None, 1e38)
    replace(transfer, noise=math.inf, **odd).save(tmp_path / "a.npz")
    again = load_transfer(tmp_path / "a.npz")
    assert (again.noise, again.seconds, again.view.far) == (None, {"a": 1.0}, 1e38)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"samples": -1}, "samples"),
        ({"seed": 10**5000}, "digits"),
        ({"path_noise": -1.0}, "noise"),
        ({"parts": (Part("a", 0, 3),)}, "parts"),
        ({"lighting": np.full((3, 9), math.nan)}, "environment/lighting"),
        ({"lighting": np.ones((3, 4))}, "shape"),
    ],
)
def test_what_no_reader_would_take_is_told_before_it_is_written(change, told, packed, tmp_path):
    packed.save(tmp_path / "a.prt")
    before = (tmp_path / "a.prt").read_bytes()
    with pytest.raises(UserError, match=told):
        replace(packed, **change).save(tmp_path / "a.prt")
    assert (tmp_path / "a.prt").read_bytes() == before


def test_transfer_that_no_reader_would_take_is_not_saved(transfer, tmp_path):
    for change in ({"samples": -1}, {"parameters": {"a": math.nan}}, {"vectors": np.full_like(transfer.vectors, 1e30)}):
        with pytest.raises(UserError, match="no file can hold this transfer"):
            replace(transfer, **change).save(tmp_path / "a.npz")
    assert not (tmp_path / "a.npz").exists()


def test_uncompressed_transfer_whose_faces_join_parts(transfer, tmp_path):
    parts = (Part("a", 0, 100), Part("b", 100, 62))
    with pytest.raises(UserError, match="a face joins two parts"):
        replace(transfer, parts=parts).save(tmp_path / "a.npz")
    with pytest.raises(UserError, match="no face may join two parts"):
        compress(replace(transfer, parts=parts), "none")
    transfer.save(tmp_path / "a.npz")
    arrays = dict(np.load(tmp_path / "a.npz"))
    about = json.loads(str(arrays.pop("about")))
    np.savez(tmp_path / "b.npz", about=json.dumps({**about, "parts": [["a", 0, 100], ["b", 100, 62]]}), **arrays)
    with pytest.raises(UserError, match="a face joins two parts"):
        load_transfer(tmp_path / "b.npz")


def test_uncompressed_skies_whose_sun_is_nowhere(transfer):
    shapes = Shapes({"bandlimit": 2, "parts": []})
    shapes.accept("sky_sun", np.array([0.0, 0.6, 0.8, 0.1]))
    for direction in ([0.0, 0.0, 0.0], [0.0, 2.0, 0.0]):
        with pytest.raises(ValueError, match="sky_sun is toward no direction"):
            shapes.accept("sky_sun", np.array([*direction, 0.1]))


def test_seeds_have_128_bits(tmp_path):
    assert saved(compress(precompute(bumpy(0), 1, 16, seed=(1 << 128) - 1), "none"), tmp_path).seed == (1 << 128) - 1
    with pytest.raises(UserError, match=r"seed must be below 2\^128, not a number of 16610 bits"):
        precompute(bumpy(0), 1, 16, seed=10**5000)


TEXTS = st.text(st.characters(), max_size=20)  # with surrogates
NUMBERS = st.floats(-1e300, 1e300) | st.sampled_from([math.nan, math.inf, -math.inf])


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    told=st.fixed_dictionaries(
        {
            "source": TEXTS,
            "prior": TEXTS,
            "seed": st.integers(0, (1 << 128) - 1),
            "bounces": st.integers(0, 1000),
            "seconds": st.dictionaries(TEXTS, NUMBERS, max_size=3),
            "parameters": st.dictionaries(TEXTS, TEXTS, max_size=3),
            "verified": st.dictionaries(TEXTS, NUMBERS, max_size=3),
            "effects": st.lists(st.builds(Effect, TEXTS, TEXTS, NUMBERS, NUMBERS, st.integers(0, 2**62), TEXTS)),
            "path_noise": st.none() | st.floats(0.0, 1e99) | st.sampled_from([math.nan, math.inf]),
        }
    ),
    name=TEXTS,
    notes=st.lists(TEXTS, max_size=3),
)
def test_odd_but_legal_contents_come_back(told, name, notes, packed, transfer, tmp_path):
    told = {**told, "effects": tuple(told["effects"])}
    mesh = replace(packed.mesh, name=name, notes=tuple(notes))
    read = saved(replace(packed, mesh=mesh, **told), tmp_path)
    assert (read.seed, read.bounces, len(read.mesh.notes)) == (told["seed"], told["bounces"], len(notes))
    for found, text in ((read.mesh.name, name), (read.source, told["source"]), (read.prior, told["prior"])):
        assert found.encode() == text.encode("utf-16", "surrogatepass").decode("utf-16", "replace").encode()
    assert read.verified == {
        key.encode("utf-16", "surrogatepass").decode("utf-16", "replace"): value
        for key, value in told["verified"].items()
        if math.isfinite(value)
    }
    traced = {key: told[key] for key in ("source", "seed", "bounces", "seconds", "parameters", "effects")}
    replace(transfer, mesh=mesh, noise=told["path_noise"], **traced).save(tmp_path / "a.npz")
    assert load_transfer(tmp_path / "a.npz").seed == told["seed"]
