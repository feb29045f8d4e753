"""What outputs depend on is noticed, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.datasets.fingerprint import fingerprint, settings_digest
from slepian_prt.datasets.jobs import ScanSettings
from slepian_prt.lighting.spectrum import LightPrior
from slepian_prt.scene.named_files import files_behind
from slepian_prt.transport.settings import TransportSettings


@pytest.fixture
def model(tmp_path):
    """Files that name each other, and one that nobody names."""
    (tmp_path / "a.obj").write_text("mtllib my materials.mtl\nusemtl skin\nv 0 0 0\n")
    (tmp_path / "my materials.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd -clamp on Skin.PNG\nmap_bump no.png\n")
    (tmp_path / "skin.png").write_bytes(b"picture")
    (tmp_path / "b.gltf").write_text('{"buffers": [{"uri": "b.bin"}, {"uri": "data:application/octet-stream,x"}]}')
    (tmp_path / "b.bin").write_bytes(b"numbers")
    (tmp_path / "c.xml").write_text('<scene><include filename="d.xml"/><string name="filename" value="a.obj"/></scene>')
    (tmp_path / "d.xml").write_text('<scene><string name="filename" value="skin.png"/></scene>')
    (tmp_path / "other.png").write_bytes(b"picture")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "behind"),
    [
        ("a.obj", ["a.obj", "my materials.mtl", "skin.png"]),
        ("b.gltf", ["b.bin", "b.gltf"]),
        ("c.xml", ["a.obj", "c.xml", "d.xml", "my materials.mtl", "skin.png"]),
        ("none.obj", []),
    ],
)
def test_files_that_are_named(name, behind, model):
    assert sorted(path.name for path in files_behind(model / name)) == behind


def test_files_that_name_each_other_in_a_circle(model):
    (model / "d.xml").write_text('<scene><include filename="c.xml"/></scene>')
    assert len(files_behind(model / "c.xml")) == len(set(files_behind(model / "c.xml"))) == 5


@pytest.mark.parametrize("changed", ["a.obj", "my materials.mtl", "skin.png"])
def test_a_change_of_any_file_is_noticed(changed, model):
    before = fingerprint(model / "a.obj", "settings")
    with (model / changed).open("a") as file:
        file.write("\n")
    assert fingerprint(model / "a.obj", "settings") != before


def test_other_files_do_not_count(model):
    before = fingerprint(model / "a.obj", "settings")
    (model / "other.png").write_bytes(b"another")
    assert fingerprint(model / "a.obj", "settings") == before
    assert fingerprint(model / "a.obj", "others") != before


def test_every_setting_counts():
    """Arrays in them by what they hold; the same settings have the same digest."""
    usual = ScanSettings()
    prior = [LightPrior("map", np.append(np.linspace(1.0, 0.5, 2000), end)) for end in (0.4, 0.4 + 1e-15)]
    changed = [
        usual,
        replace(usual, formats=("pifu",)),
        replace(usual, samples=12),
        replace(usual, kept_order=0),
        replace(usual, transport=TransportSettings(albedo=[0.1, 0.2, 0.3])),
        replace(usual, transport=TransportSettings(parameters={"a": 1})),
        replace(usual, compression=CompressionSettings(tolerance=0.1)),
        *(replace(usual, compression=CompressionSettings(light_prior=one)) for one in prior),
    ]
    digests = [settings_digest(settings) for settings in changed]
    assert len(set(digests)) == len(changed)
    assert digests == [settings_digest(settings) for settings in changed]


def test_another_version_counts(monkeypatch):
    before = settings_digest(ScanSettings())
    monkeypatch.setattr("slepian_prt.datasets.fingerprint.version", lambda _: "0.0.0")
    assert settings_digest(ScanSettings()) != before
