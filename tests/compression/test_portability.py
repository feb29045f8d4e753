"""Files decode to the same integers, and choose the same entropy contexts, whatever the processor."""

import json
import os
import subprocess
import sys

import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

from slepian_prt.compression.decoder import coded_along_principal_axes
from slepian_prt.compression.stream import compress
from slepian_prt.transport.transfer import precompute
from tests.conftest import ROOT, bumpy
from tests.numerics import assert_rounded

# Kernels of OpenBLAS, which takes them by this name, and what a processor needs to run them.
KERNELS = {"Prescott": "SSE3", "Haswell": "AVX2", "Zen": "AVX2", "SkylakeX": "AVX512F"}

# Decodes a file, all caps together, and codes what comes out again; prints digests of integers, and rows of axes.
CODE = """
import hashlib, json, sys
import threadpoolctl
from slepian_prt.compression.codec import cap_stream, caps, encoding
from slepian_prt.compression.codec.surface import surface_of
from slepian_prt.compression.files.prt_file import load

integers, contexts = hashlib.sha256(), hashlib.sha256()
read = cap_stream.CapsReader.symbols
def symbols(reader, counts, models):
    contexts.update(counts.tobytes() + models.astype("<i8").tobytes())
    return read(reader, counts, models)
cap_stream.CapsReader.symbols = symbols

packed, axes = load(sys.argv[1]), []
integers.update(packed.mesh.positions.tobytes() + packed.mesh.normals.tobytes())  # IEEE operations, one by one
tuning, rows = packed.coded.tuning, surface_of(packed.mesh.receivers).rows(packed.clusters.members)
components = [basis.count * packed.channels for basis in packed.bases]
decoded = caps.decode_caps(packed.coded.caps, components, rows, tuning)
for cap in decoded:
    integers.update(cap.multiples.tobytes())
    axes.append(None if cap.axes is None else cap.axes.tolist())
values = [cap.values(tuning.step) for cap in decoded]
for again in encoding.encode_caps(values, rows, tuning, principal_axes=[False] * len(values)):
    contexts.update(again.content.lanes.words.tobytes() + again.content.bits.tobytes())
kernels = {library.get("architecture") for library in threadpoolctl.threadpool_info()} - {None}
print(json.dumps([integers.hexdigest(), contexts.hexdigest(), axes, sorted(kernels)]))
"""


def decoded(path, **environment: str) -> tuple[str, str, list, list[str]]:
    """Digests of the integers and of the choice of contexts, axes of the caps, and the kernels that ran."""
    plain = {k: v for k, v in os.environ.items() if k not in ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES")}
    command = [sys.executable, "-W", "error", "-c", CODE, str(path)]
    run = subprocess.run(command, capture_output=True, text=True, env=plain | environment, cwd=ROOT, check=False)
    assert run.returncode == 0, run.stderr
    return tuple(json.loads(run.stdout))


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("portable") / "bumpy.prt"
    packed = compress(precompute(bumpy(4), bandlimit=5, samples=64), tolerance=0.01, clusters=4)
    assert set(coded_along_principal_axes(packed)) == {True, False}
    packed.save(path)
    return path


@pytest.fixture(scope="module")
def here(file):
    """As this processor decodes when it is left alone."""
    return decoded(file)


def assert_same(found, here) -> None:
    assert found[:2] == here[:2]
    for one, other in zip(found[2], here[2], strict=True):
        assert (one is None) == (other is None)
        if one is not None:
            # Gram-Schmidt of rows of K numbers, K of them: backward stable, and the rows are all but orthonormal.
            assert_rounded(one, other, terms=len(one[0]) ** 2, size=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", KERNELS)
def test_under_another_kernel_of_openblas(kernel, file, here, record_property):
    if not __cpu_features__.get(KERNELS[kernel]):
        pytest.skip(f"{kernel} needs {KERNELS[kernel]}, which this processor has not")
    found = decoded(file, OPENBLAS_CORETYPE=kernel)
    record_property("kernel that ran", found[3])
    if kernel == "Prescott" and here[3] and __cpu_features__["AVX2"]:
        # Others may be the processor's own, or go by another's name; this one is neither.
        assert found[3] != here[3], "OpenBLAS took no notice of OPENBLAS_CORETYPE"
    assert_same(found, here)


@pytest.mark.slow
@pytest.mark.parametrize("kept", [0, 1])
def test_with_fewer_instructions_in_numpy(kept, file, here):
    """None of what numpy chooses by processor, and only the first of it."""
    there = [feature for feature in __cpu_dispatch__ if __cpu_features__[feature]]
    if len(there) <= kept:
        pytest.skip(f"numpy chooses among {len(there)} sets of instructions on this processor")
    assert_same(decoded(file, NPY_DISABLE_CPU_FEATURES=" ".join(there[kept:])), here)
