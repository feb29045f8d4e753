"""Options of ``slepian-prt precompute`` alone."""

from __future__ import annotations

import click

from slepian_prt.cli.options import clamp_option, environment_option, together
from slepian_prt.cli.values import Names
from slepian_prt.files import KEPT_ORDER

# How to compress: fields of `CompressionSettings`.
compression_options = together(
    click.option(
        "--basis",
        type=Names("basis"),
        default="adapted",
        show_default=True,
        help="Functions to compress with.",
    ),
    click.option("--tolerance", type=float, help="Wanted relative error.  [default: 0.02]"),
    click.option("--terms", type=int, help="Instead: this many functions in every cap."),
    click.option("--truncate", type=Names("truncate"), help="Instead: at the cap's Shannon number."),
    click.option("--epsilon", type=float, help="Concentration that --truncate counts down to.  [default: 0.01]"),
    click.option(
        "--light-prior",
        multiple=True,
        metavar="1/(l+1)|MAP",
        help="Errors count under light of such a spectrum: falling, or that of a map; maps may be given several times.",
    ),
    click.option(
        "--refine/--no-refine",
        default=None,
        help="Principal axes inside the coefficients of each cap.  [default: where it makes the file smaller]",
    ),
    click.option(
        "--coding",
        type=Names("coding"),
        help="Coefficients: predicted, rounded, entropy-coded; or plain.  [default: coded; by --terms float32]",
    ),
    click.option(
        "--exact-mesh",
        is_flag=True,
        default=False,
        help="Positions and albedo to the bit, normals in float32.  [default: to 1/65535 of the model, 0.25 degrees]",
    ),
)

keep_order_option = click.option(
    "--keep-order",
    is_flag=True,
    help="Vertices in the order of SCENE, not in that of the file, which is 2 bytes smaller for each; always for up "
    f"to {KEPT_ORDER:,} vertices.",
)

goal_options = together(
    click.option(
        "--max-error",
        type=float,
        metavar="E",
        help="Choose rays, bandlimit and tolerance: the fastest whose radiance is off by at most E (0.05 is 5 %) under "
        "--environment or light of the --light-prior.",
    ),
    click.option("--max-seconds", type=float, metavar="S", help="Choose them: the most exact that takes at most S."),
    environment_option("Map that the goal is about"),
    clamp_option,
)
