"""Benchmarks: each line is a median of several runs, beside a limit or a peer measured in the same process."""

from __future__ import annotations

import argparse
import sys

from benchmarks.accuracy import accuracy
from benchmarks.all_views import all_views
from benchmarks.compression import compression
from benchmarks.datasets import datasets
from benchmarks.dimension import dimension
from benchmarks.files import files
from benchmarks.gpu import gpu
from benchmarks.loaded import loaded
from benchmarks.page_files import page_files
from benchmarks.page_pictures import page_pictures
from benchmarks.pages import pages
from benchmarks.paths import paths
from benchmarks.relighting import relighting
from benchmarks.runtime import runtime
from benchmarks.scaling import scaling
from benchmarks.smoothing import smoothing
from benchmarks.sphere import sphere
from benchmarks.startup import startup
from benchmarks.transport import dragons, transport
from benchmarks.workers import workers

from slepian_prt.errors import UserError
from slepian_prt.renderer.variants import chosen_variant

BENCHMARKS = {
    "sphere": sphere,
    "startup": startup,
    "compression": compression,
    "files": files,
    "transport": transport,
    "relighting": relighting,
    "runtime": runtime,
    "gpu": gpu,
    "accuracy": accuracy,
    "datasets": datasets,
    "dimension": dimension,
    "paths": paths,
    "pages": pages,
    "page_files": page_files,
    "page_pictures": page_pictures,
    "smoothing": smoothing,
    "all_views": all_views,
    "workers": workers,
    "loaded": loaded,
    "dragons": dragons,
    "scaling": scaling,
}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*")
    parser.add_argument("--variant", help="of Mitsuba, to measure in")
    given = parser.parse_args()
    unknown = sorted(set(given.names) - set(BENCHMARKS))
    if unknown:
        sys.exit(f"unknown benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}")
    try:
        with chosen_variant(given.variant):
            for name in given.names or list(BENCHMARKS):
                print(f"{name}: {BENCHMARKS[name].__doc__}")
                BENCHMARKS[name]()
    except UserError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
