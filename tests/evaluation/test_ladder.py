import numpy as np
import pytest

from slepian_prt.evaluation.ladder import AT_VERTICES, IN_PICTURE, Stage, measure_stages
from slepian_prt.evaluation.metrics import deviation, flip, picture_deviation, relative_mse, relative_rms
from slepian_prt.relighting.drawing.camera import trace_camera
from slepian_prt.relighting.drawing.pictures import Picture
from slepian_prt.scene.loading import open_scene
from tests.conftest import bumpy


def picture(radiance: np.ndarray, alpha: np.ndarray | None = None) -> Picture:
    covered = np.ones(radiance.shape[:2]) if alpha is None else alpha
    return Picture(radiance.astype(np.float32), covered.astype(np.float32))


def test_deviation_by_hand():
    reference = np.zeros((200, 3))
    reference[:, 0] = 2.0
    values = reference.copy()
    values[7, 1] = 3.0  # 1.5 times the RMS
    values[9, 2] = -1.0
    found = deviation(values, reference)
    assert found.error == pytest.approx(np.sqrt(10.0 / 200) / 2.0)
    assert found.error == pytest.approx(relative_rms(values, reference))
    assert found.worst == pytest.approx(1.5)
    assert found.worst_at == [7]
    assert found.percentile_99 == pytest.approx(np.quantile([1.5, 0.5, *[0.0] * 198], 0.99))


def test_nothing_against_nothing():
    assert deviation(np.zeros((4, 3)), np.zeros((4, 3))).error == 0.0
    empty = picture(np.zeros((4, 4, 3)), np.zeros((4, 4)))
    assert picture_deviation(empty, empty) == (0.0, 0.0, 0.0, [])
    assert flip(empty, empty, 1.0) == relative_mse(empty, empty) == 0.0


def test_the_worst_pixel_is_named_by_column_and_row(rng):
    alpha = np.ones((12, 20))
    alpha[:, :3] = 0.0
    reference = picture(rng.random((12, 20, 3)), alpha)
    other = reference.radiance.copy()
    other[5, 17] += 4.0
    other[5, 1] += 40.0  # not covered
    found = picture_deviation(picture(other, alpha), reference)
    assert found.worst_at == [17, 5]


def test_relative_mse_by_hand():
    reference = np.ones((1, 2, 3))
    reference[0, 1] = 10.0
    values = reference * 1.1
    mean = (1.0 + 100.0) / 2.0
    expected = 0.5 * (0.01 / (1.0 + 0.01 * mean) + 1.0 / (100.0 + 0.01 * mean))
    assert relative_mse(picture(values), picture(reference)) == pytest.approx(expected, rel=1e-4)


def test_flip_grows_with_the_difference(rng):
    reference = picture(0.5 * rng.random((32, 32, 3)))
    found = [flip(picture(reference.radiance * factor), reference, 1.0) for factor in (1.0, 1.05, 1.2, 2.0)]
    assert found[0] == 0.0
    assert np.all(np.diff(found) > 0.0)
    assert found[-1] < 1.0
    black, white = picture(np.zeros((32, 32, 3))), picture(np.full((32, 32, 3), 2.0))
    assert flip(white, black, 1.0) > 0.9  # as different as can be


def test_stages_are_held_against_the_same_reference(rng):
    mesh = bumpy(3)
    exact = (0.5 + rng.random((len(mesh.positions), 3))).astype(np.float32)
    with open_scene(mesh) as scene:
        camera = trace_camera(scene, 48)
    stages = [
        Stage("no bandlimit", exact, 0.01, 2.0, None),
        Stage("full", exact * np.float32(1.05), 0.0, 3.0, 242.0),
        Stage("coded", exact * np.float32(1.2), 0.0, 4.0, 3.0),
    ]
    reference = camera.picture(exact * np.float32(1.01))
    errors = measure_stages("sky", reference, 0.02, 7.0, camera, stages)
    drawn = [r for r in errors if r.against == IN_PICTURE]
    known = [r for r in errors if r.against == AT_VERTICES]
    np.testing.assert_allclose([r.error for r in drawn], [0.0, 0.01 / 1.01, 0.04 / 1.01, 0.19 / 1.01], rtol=1e-4)
    np.testing.assert_allclose([r.error for r in known], [0.0, 0.05, 0.2], rtol=1e-4)
    assert [r.seconds for r in drawn] == [7.0, 2.0, 3.0, 4.0]
    assert [r.bytes_per_vertex for r in known] == [None, 242.0, 3.0]
    assert drawn[1].noise == pytest.approx(np.hypot(0.01, 0.02))
    assert drawn[2].noise == 0.02
    assert drawn[1].stage == "no bandlimit, interpolated"
    assert all(r.flip is not None and r.relative_mse is not None for r in drawn)
    assert drawn[3].flip > drawn[2].flip > drawn[1].flip > drawn[0].flip == 0.0
    assert exact[known[2].worst_at[0]].sum() > exact.sum(axis=1).mean()
