"""Two transfers on one page: which receivers of one are those of the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.scene.view import View
from slepian_prt.viewer.comparison import check_pair, label_pair, matching_receivers
from tests.conftest import bumpy, sphere
from tests.numerics import assert_exact
from tests.viewer.tiny import tiny, tiny_film, traced


def test_the_same_mesh_with_other_numbers_is_found():
    mesh = bumpy(2)
    rng = np.random.default_rng(5)
    order = rng.permutation(len(mesh.positions))
    rank = np.argsort(order)
    extent = np.ptp(mesh.positions, axis=0).max()
    moved = mesh.positions[order] + rng.uniform(-0.5, 0.5, mesh.positions.shape) * extent / 65535
    other = sp.make_mesh(moved, np.roll(rng.permutation(rank[mesh.faces]), 1, axis=1))
    assert_exact(matching_receivers(mesh, other), rank, "whole numbers")


def test_the_same_numbers_stay():
    mesh = bumpy(1)
    assert_exact(matching_receivers(mesh, mesh), np.arange(len(mesh.positions)), "whole numbers")


def test_another_mesh_is_none():
    mesh = bumpy(2)
    assert matching_receivers(mesh, sphere(2)) is None
    assert matching_receivers(mesh, bumpy(1)) is None


def test_a_picture_is_not_compared_with_a_model():
    with pytest.raises(UserError, match="`compare_with` is a model and the file a picture of 6 x 4 pixels"):
        check_pair(tiny_film(), tiny())
    check_pair(tiny_film(), tiny_film())


def test_two_models_are_not_compared():
    moved = replace(tiny().mesh, positions=tiny().mesh.positions + [3.0, 0.0, 0.0])
    with pytest.raises(UserError, match="whose size or place is not that of"):
        check_pair(tiny(), replace(tiny(), mesh=moved))
    check_pair(tiny(), replace(tiny(), mesh=replace(moved, positions=1.05 * tiny().mesh.positions)))


def test_labels_tell_two_apart():
    more = sp.compress(traced(), "none", clusters=3, coding="float16")
    assert label_pair(tiny(), more, ("adapted", "pca")) == ("adapted", "pca")
    first, other = label_pair(tiny(), more, ("full SH", "full SH"))
    assert first == f"full SH, {tiny().file_bytes_per_vertex:.3g} bytes"
    assert other == f"full SH, {more.file_bytes_per_vertex:.3g} bytes"
    assert first != other
    assert label_pair(tiny(), tiny(), ("a", "a"))[0].endswith("bytes (the file)")


def test_light_toward_one_camera_is_not_compared_with_that_toward_another():
    eyes = [view_from(x) for x in (1.0, 2.0)]
    first, other = (replace(tiny(), view=eye, toward_view=True) for eye in eyes)
    check_pair(first, first)
    check_pair(first, replace(other, toward_view=False))
    with pytest.raises(UserError, match="`compare_with` is light toward another camera"):
        check_pair(first, other)


def view_from(x: float) -> View:
    matrix = np.eye(4)
    matrix[0, 3] = x
    return View("eye", matrix.tolist(), 40.0, 8, 6, 0.1, 10.0)
