import json
import re
from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.errors import UserError
from slepian_prt.evaluation.compare import compare
from slepian_prt.evaluation.methods import METHODS
from slepian_prt.evaluation.metrics import error_map, relative_rms
from slepian_prt.evaluation.report import write_report
from slepian_prt.evaluation.sweep.axes import Setting
from slepian_prt.evaluation.sweep.results import Point, Sweep
from slepian_prt.files import check_folder
from slepian_prt.lighting.environment import make_environment
from slepian_prt.relighting.drawing.pictures import Picture
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.viewer.pages import PageWish
from tests.conftest import bumpy

METHOD_FIELDS = {
    "basis",
    "coding",
    "terms",
    "bytes_per_vertex",
    "transfer_error",
    "predicted_error",
    "relit_error",
    "predicted_relit_error",
    "seam_across",
    "seam_within",
    "image_error",
    "compress_seconds",
    "relight_seconds",
}


@pytest.fixture(scope="module")
def comparison(tmp_path_factory):
    import trimesh

    mesh = bumpy(3)
    path = tmp_path_factory.mktemp("scene") / "bumpy & <ball>.ply"  # a name that HTML has to escape
    trimesh.Trimesh(mesh.positions, mesh.faces, process=False).export(path)
    rng = np.random.default_rng(2)
    maps = [make_environment(rng.random((16, 32, 3)) ** 3, name=name) for name in ("first", "second")]
    return compare(
        path,
        maps,
        transport=TransportSettings(bandlimit=4, samples=64),
        grouping=CompressionSettings(clusters=8),
        methods=tuple(METHODS),
        terms=(4, 9, 40),
        width=64,
        noise=0.05,
    )


@pytest.mark.slow
def test_results_have_the_stable_names(comparison):
    results = json.loads(json.dumps(comparison.results()))
    assert results["vertices"] == 642
    assert results["bandlimit"] == 4
    assert results["samples"] == 64
    assert results["clusters"] == 8
    assert results["environments"] == ["first", "second"]
    assert {m["basis"] for m in results["methods"]} == {*METHODS, "none"}
    for method in results["methods"]:
        assert set(method) == METHOD_FIELDS
        assert set(method["relit_error"]) == set(method["image_error"]) == {"first", "second"}
        # 40 is more than the bandlimit has; slepian lacks some functions of it
        assert method["terms"] in (4, 9, 16, 24, 25) or method["coding"] == "coded"
        assert method["predicted_error"] is not None or method["basis"] in ("haar", "hsh", "d3dx")
    assert {stage["environment"] for stage in results["ladder"]} == {"first", "second"}
    assert all({"stage", "error", "seconds"} <= set(stage) for stage in results["ladder"])
    assert all(0 < r["noise"] < 0.2 for r in results["references"].values())


@pytest.mark.slow
def test_full_sh_is_the_end_of_every_curve(comparison):
    full = next(m for m in comparison.methods if m.basis == "none")
    assert full.transfer_error <= 5e-4  # float16
    assert max(full.relit_error.values()) <= 5e-4
    for method in comparison.methods:
        assert method.transfer_error >= full.transfer_error


@pytest.mark.slow
def test_report_needs_nothing_else(comparison, tmp_path):
    page = write_report(comparison, tmp_path / "out", "slepian-prt compare 'a b.ply'")
    html = page.read_text()
    sources = re.findall(r'(?:src|href)="([^"]{0,40})', html)
    assert sources
    assert all(source.startswith("data:") for source in sources)
    assert "http" not in re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]+", "", html)
    assert "bumpy &amp; &lt;ball&gt;.ply" in html
    assert "<ball>" not in html
    for basis in list(METHODS)[:-1]:
        assert f"{basis}, 9 functions" in html
        assert (tmp_path / "out" / f"first_{basis}_error.png").is_file()
    assert "entropy-coded" in html
    assert json.loads((tmp_path / "out" / "results.json").read_text())["vertices"] == 642
    assert not [p for p in (tmp_path / "out").iterdir() if p.name.endswith(".part")]


@pytest.mark.slow
def test_report_links_to_a_page_of_the_model(comparison, tmp_path):
    page = write_report(comparison, tmp_path, "command", viewer=PageWish())
    assert 'href="viewer.html"' in page.read_text()
    assert 'id="payload"' in (tmp_path / "viewer.html").read_text()
    with pytest.raises(UserError, match="is no basis whose files can be viewed"):
        write_report(replace(comparison, compressed=None), tmp_path / "other", "command", viewer=PageWish())
    assert not (tmp_path / "other").exists()


@pytest.mark.slow
def test_report_shows_a_sweep(comparison, tmp_path):
    setting = Setting(64, 5, 96, "adapted", 0.05)
    points = (Point(setting, {"first": 0.1}, {"first": 0.1}, 2.0, 1.0, 0.0, 1.0, 0.1, 0.01),)
    sweep = Sweep("ball.ply", 642, ("first",), {"first": 0.01}, points, {}, (), "slepian-prt sweep ball.ply")
    alone = write_report(comparison, tmp_path / "alone", "command").read_text()
    both = write_report(comparison, tmp_path / "both", "command", sweep).read_text()
    assert "slepian-prt sweep</code>" in alone
    assert "slepian-prt sweep ball.ply" in both
    assert "Relative error under first against seconds" in both
    assert both.count("data:image/png") == alone.count("data:image/png") + 2


def test_relative_rms():
    assert relative_rms(np.array([3.0, 4.0]), np.array([0.0, 5.0])) == pytest.approx(np.sqrt(10) / 5)
    assert relative_rms(np.zeros(3), np.zeros(3)) == 0.0
    assert relative_rms(np.ones(3), np.zeros(3)) == np.inf


def test_error_map_is_relative_to_the_mean_and_blank_outside():
    alpha = np.array([[1.0, 1.0, 0.0]], dtype=np.float32)
    reference = Picture(np.array([[[2, 2, 2], [4, 4, 4], [0, 0, 0]]], dtype=np.float32), alpha)
    picture = Picture(reference.radiance + np.float32(0.3), alpha)
    errors = error_map(picture, reference)
    np.testing.assert_allclose(errors[0, :2], 0.1, rtol=1e-5)
    assert np.isnan(errors[0, 2])


def test_folder_checks(tmp_path):
    check_folder(tmp_path / "new" / "deeper")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="is not a folder"):
        check_folder(tmp_path / "file")


CORNER = """<scene version="3.0.0">
  <sensor type="perspective" id="eye"><float name="fov" value="40"/><transform name="to_world">
    <lookat origin="3, 2.5, 4" target="0, 0.4, -0.3" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="72"/><integer name="height" value="54"/></film></sensor>
  <emitter type="constant"><rgb name="radiance" value="1, 1.5, 2"/></emitter>
  <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/></transform>
    <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.8, 0.8"/></bsdf></bsdf></shape>
  <shape type="rectangle" id="wall"><transform name="to_world"><translate y="1" z="-1"/></transform>
    <bsdf type="twosided"><bsdf type="{material}"><rgb name="{reflectance}" value="0.9, 0.2, 0.1"/></bsdf></bsdf>
  </shape>
</scene>"""


@pytest.mark.slow
@pytest.mark.parametrize("view", [None, "eye"])
def test_a_mitsuba_scene_in_its_own_light(view, tmp_path):
    """Its emitter and camera are used, and the references follow what transfer follows: bounces, or gloss."""
    material = ("diffuse", "reflectance") if view is None else ("roughplastic", "diffuse_reflectance")
    path = tmp_path / "corner.xml"
    path.write_text(CORNER.format(material=material[0], reflectance=material[1]))
    result = compare(
        path, (), transport=TransportSettings(6, 512, view=view), terms=(9,), methods=("adapted",), noise=0.03
    )
    assert [view.environment.name for view in result.views] == ["scene"]
    assert result.views[0].full.radiance.shape == (54, 72, 3)
    assert result.transfer.bounces > 0
    assert result.results()["toward_camera"] == (view is not None)
    full = [error for error in result.ladder if error.stage.startswith("full SH")]
    for stage in full:
        # Constant light needs no bandlimit: what is left is noise, interpolation, and at the outline pixels of both.
        assert stage.error < stage.noise + 0.04


def test_a_scene_without_light_of_its_own(tmp_path):
    path = tmp_path / "dark.xml"
    path.write_text('<scene version="3.0.0"><shape type="sphere"><bsdf type="diffuse"/></shape></scene>')
    with pytest.raises(UserError, match="no distant light of its own"):
        compare(path, ())
    with pytest.raises(UserError, match="no light: name a map"):
        compare(tmp_path / "mesh.ply", ())
