"""Threads of the BLAS that NumPy and SciPy really have, in processes of their own."""

import json
import os
import subprocess
import sys

import pytest

from slepian_prt.machine.threads import _BLAS_VARIABLES

# The count of the user is one that no policy of ours would come to.
BLOCKS = """
import json, random, threading, time
from concurrent.futures import ThreadPoolExecutor
import numpy as np, scipy.linalg
from threadpoolctl import ThreadpoolController, threadpool_limits
from slepian_prt.machine.threads import map_in_threads, one_blas_thread

libraries = [found for found in ThreadpoolController().lib_controllers if found.user_api == "blas"]
counts = lambda: [library.get_num_threads() for library in libraries]
made = np.random.default_rng(0)
left, right = made.normal(size=(8, 700, 441)).astype("f4"), made.normal(size=(441, 500)).astype("f4")

@one_blas_thread()
def product(i):
    seen.extend(counts())
    return (left[i] @ right).tobytes()

def blocks(i):
    chance = random.Random(i)
    found = set()
    for _ in range(20):
        found.add(product(i))
        with one_blas_thread():
            time.sleep(0.002 * chance.random())
            found.add(product(i))
        time.sleep(0.002 * chance.random())
    return found

seen = []
alone = [{product(i)} for i in range(8)]
{users}
before = counts()
with ThreadPoolExecutor(8) as pool:
    together = list(pool.map(blocks, range(8)))
after = counts()
mapped = [{bits} for bits in map_in_threads(product, range(8))]
print(json.dumps([before, after, counts(), sorted(set(seen)), together == alone, mapped == alone]))
"""

# Who sets the number first: threadpoolctl heeds that thread alone as long as it lives.
USERS = {
    "main": "threadpool_limits(3, 'blas')",
    "another": "other = threading.Thread(target=threadpool_limits, args=(3, 'blas')); other.start(); other.join()",
}

COMMAND = """
import json, sys
from slepian_prt.__main__ import main
early = "numpy" in sys.modules
sys.argv = ["slepian-prt", *{arguments!r}]
try:
    main()
except SystemExit as ended:
    status = ended.code
import scipy.linalg
from threadpoolctl import ThreadpoolController
found = [library.get_num_threads() for library in ThreadpoolController().lib_controllers if library.user_api == "blas"]
print()
print(json.dumps([status, early, "numpy" in sys.modules, found]))
"""


def in_child(code: str, **environment: str):
    """What the last line of it says, where nothing limits BLAS but what is given."""
    kept = {name: value for name, value in os.environ.items() if name not in (*_BLAS_VARIABLES, "OMP_NUM_THREADS")}
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=100, env={**kept, **environment}
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


@pytest.mark.slow
@pytest.mark.parametrize("who", USERS)
def test_blocks_of_any_threads_have_one_thread_and_leave_the_number_of_the_user(who):
    before, after, last, within, together, mapped = in_child(BLOCKS.replace("{users}", USERS[who]))
    assert before == after == last == [3] * len(before)
    assert within == [1]
    assert together
    assert mapped


@pytest.mark.slow
def test_the_process_of_a_command_has_one_thread_of_blas(tmp_path):
    path = tmp_path / "triangle.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    arguments = ["precompute", str(path), "--bandlimit", "2", "--samples", "16", "-o", str(tmp_path / "triangle.prt")]
    status, early, late, counts = in_child(COMMAND.format(arguments=arguments), OPENBLAS_NUM_THREADS="2")
    assert (status, early, late) == (0, False, True)
    assert set(counts) == {1}
