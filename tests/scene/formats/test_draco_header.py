"""What streams of Draco tell at their beginnings."""

import numpy as np
import pytest

from slepian_prt.scene.formats.draco_header import draco_counts

FACES = np.array([[0, 1, 2], [2, 1, 3], [0, 2, 3]], dtype=np.uint32)


@pytest.mark.parametrize("level", range(0, 11, 2))
@pytest.mark.parametrize("metadata", [False, True])
def test_counts_are_those_that_come_out(level, metadata, rng):
    package = pytest.importorskip("DracoPy")
    points = rng.random((4, 3)).astype(np.float32)
    data = package.encode(points, FACES, compression_level=level, create_metadata=metadata)
    assert draco_counts(data) == (len(package.decode(data).faces), 4)


def test_clouds_of_points_and_beginnings_alone(rng):
    package = pytest.importorskip("DracoPy")
    points = rng.random((4, 3)).astype(np.float32)
    with pytest.raises(ValueError, match="not a triangle mesh"):
        draco_counts(package.encode(points))
    data = package.encode(points, FACES, create_metadata=True)
    ends = next(end for end in range(len(data)) if _is_told(data[:end]))
    assert 12 < ends < len(data)


def _is_told(data: bytes) -> bool:
    try:
        return draco_counts(data) == (3, 4)
    except ValueError:
        return False


@pytest.mark.parametrize(
    "rest",
    [
        b"\xff" * 40,
        b"\0" + b"\1\1a\xff\xff\xff\xff\x0f",  # a value of four gigabytes
        b"\0" + b"\0\1\0" * 1000,  # metadata in metadata
        b"\xff\xff\xff\xff\x0f" + b"\0" * 100,  # of four thousand million attributes
    ],
)
def test_metadata_that_do_not_end(rest):
    with pytest.raises(ValueError, match="Draco"):
        draco_counts(b"DRACO\2\2\1\1\0\x80" + rest)
