"""Damage files of every kind that is read, and say which of them end otherwise than well or in one line.

    scripts/fuzz [N] [--minutes M] [--kinds KIND …] [--first SEED] [--processes P]

Kinds are prt, npz, meshes, maps, journals and scenes. N of each are made (500 by default) or, with ``--minutes``, as
many as there is time for. Each comes of its seed: those that are printed can be made again with ``--first SEED 1``.

Well is what is read and used as a user would, and what is refused with one line. A fault is another exception, what a
library prints, a warning, and a process that dies, hangs or takes 1.5 GiB more. Inputs at fault are kept, and told. It
exits with 1 if there was one.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from random import SystemRandom

sys.path.insert(0, str(Path(__file__).parent.parent))

from tests.fuzzing.run import Findings, prepare, run

KINDS = ("prt", "npz", "meshes", "maps", "journals", "scenes")

# Attempts between two looks at the clock; journals take longest.
_AT_ONCE = {"journals": 40, "scenes": 100}


def main() -> int:
    arguments = _arguments()
    first = SystemRandom().randrange(10**9) if arguments.first is None else arguments.first
    end = None if arguments.minutes is None else time.monotonic() + 60.0 * arguments.minutes
    print(f"seeds from {first} on", flush=True)
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    for kind in arguments.kinds:
        prepare(kind, folder / kind / "seeds")
    counts: dict[str, Counter[str]] = {kind: Counter() for kind in arguments.kinds}
    done = dict.fromkeys(arguments.kinds, 0)

    def attempt(kind: str) -> tuple[str, Findings]:
        size = _AT_ONCE.get(kind, 400)
        if end is None:
            size = min(size, arguments.number - done[kind])
        begin = first + done[kind]
        done[kind] += size
        return kind, run(kind, folder / kind / "seeds", begin, size)

    with ThreadPoolExecutor(arguments.processes) as pool:
        while True:
            wanted = [kind for kind in arguments.kinds if end is not None or done[kind] < arguments.number]
            if not wanted or (end is not None and time.monotonic() > end):
                break
            for kind, findings in pool.map(attempt, wanted):
                counts[kind] += findings.counts
                for fault in findings.faults:
                    print(f"{fault}\n    {folder / kind / f'fault-{kind}-{fault.seed}'}", flush=True)
    print(f"{'kind':10} {'attempts':>9} {'read':>9} {'refused':>9} {'faults':>9}")
    for kind, count in counts.items():
        print(f"{kind:10} {count.total():9,} {count['read']:9,} {count['refused']:9,} {count['fault']:9,}")
    return int(any(count["fault"] for count in counts.values()))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, prog="scripts/fuzz", formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("number", nargs="?", type=int, default=500, metavar="N")
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--first", type=int)
    parser.add_argument("--processes", type=int, default=2)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
