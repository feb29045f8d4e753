"""Benchmarks: each line is a median of several runs, beside a limit or a peer measured in the same process."""

from __future__ import annotations

import sys

from benchmarks.accuracy import accuracy
from benchmarks.all_views import all_views
from benchmarks.compression import compression
from benchmarks.files import files
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

BENCHMARKS = {
    "sphere": sphere,
    "startup": startup,
    "compression": compression,
    "files": files,
    "transport": transport,
    "relighting": relighting,
    "runtime": runtime,
    "accuracy": accuracy,
    "paths": paths,
    "pages": pages,
    "page_files": page_files,
    "page_pictures": page_pictures,
    "smoothing": smoothing,
    "all_views": all_views,
    "workers": workers,
    "dragons": dragons,
    "scaling": scaling,
}


def main() -> None:
    wanted = sys.argv[1:] or list(BENCHMARKS)
    unknown = sorted(set(wanted) - set(BENCHMARKS))
    if unknown:
        sys.exit(f"unknown benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}")
    for name in wanted:
        print(f"{name}: {BENCHMARKS[name].__doc__}")
        BENCHMARKS[name]()


if __name__ == "__main__":
    main()
