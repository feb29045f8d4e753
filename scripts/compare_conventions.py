"""Run other tools' own code on coefficients that `sp.convert_sh` made, and say how far the values are off ours.

    scripts/compare_conventions [--sources FOLDER] [--prt]

Each harmonic of ours, one after the other, is converted and evaluated in 200 directions by

    shtools               pyshtools, which the development environment has
    sphericart            installed with pip into a temporary folder
    three                 installed with npm there, run by node: SphericalHarmonics3.getAt and LightProbe
    google                github.com/google/spherical-harmonics, compiled with Eigen; GAMES202's program calls it
    pifu                  github.com/shunsukesaito/PIFu: apps/prt_util.py
    deca                  github.com/yfeng95/DECA: add_SHlight of decalib/utils/renderer.py
    gaussian-splatting    github.com/graphdeco-inria/gaussian-splatting, or a fork: utils/sh_utils.py

The last five are cloned, or found as PIFu, DECA, spherical-harmonics, eigen and gaussian-splatting in FOLDER. What
cannot be had gets a line that says so. Numbers are greatest differences where harmonics reach 0.3 to 1.

With ``--prt``, transfer of PIFu's ``computePRT`` and of ours is compared with ours of 65,536 rays, on a ball under an
occluder; its rays need `rtree`, installed with pip into the temporary folder.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from conventions.own_code import TOOLS, Missing, Workshop
from conventions.pifu_errors import compare_transfer


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sources", type=Path, metavar="FOLDER", help="checkouts of the repositories named above")
    parser.add_argument("--prt", action="store_true", help="errors of PIFu's transfer and of ours")
    options = parser.parse_args()
    worst = 0.0
    with tempfile.TemporaryDirectory(prefix="compare_conventions") as folder:
        workshop = Workshop(Path(folder), options.sources)
        for name, (compare, tolerance) in TOOLS.items():
            try:
                difference = compare(workshop)
            except Missing as missing:
                print(f"{name:20} not compared: {missing}")
                continue
            worst = max(worst, difference / tolerance)
            print(f"{name:20} {difference:.1e}, of {tolerance:.0e} that its constants leave")
        if options.prt:
            compare_transfer(workshop)
    return 1 if worst > 1.0 else 0


if __name__ == "__main__":
    sys.exit(main())
