"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from slepian_prt.cli.values import Albedo, LampScale, Names, Parameter, Point, as_dict, as_scales
from slepian_prt.errors import UserError

Decorator = Callable[[Any], Any]


def together(*options: Decorator) -> Decorator:
    """Several options as one decorator."""

    def decorate(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def output_option(what: str = "Where to write.") -> Decorator:
    """Where results are written."""
    return click.option("-o", "--output", required=True, type=click.Path(), help=what)


def environment_option(what: str) -> Decorator:
    """Maps, any number of them."""
    text = f"{what}; may be given several times.  [default: the light of the .xml scene]"
    return click.option("--environment", multiple=True, type=click.Path(), help=text)


def width_option(what: str, default: int) -> Decorator:
    """Width of pictures, checked."""
    text = f"{what}, in pixels.  [default: that of the scene's camera, or {default}]"
    return click.option("--width", type=int, callback=check_width, help=text)


def noise_option(default: float) -> Decorator:
    """Noise of references, checked."""
    text = "Wanted relative noise of the references."
    return click.option("--noise", default=default, show_default=True, callback=check_noise, help=text)


# How pictures are taken: the fields of `Aim`.
camera_options = together(
    click.option(
        "--look-at",
        nargs=2,
        type=Point(),
        metavar="X,Y,Z X,Y,Z",
        help="Where the camera stands, and a point in the middle of the picture.  [default: the scene's camera, or "
        "from the front]",
    ),
    click.option("--fov", type=float, metavar="DEG", help="Angle of view, across the width."),
    click.option(
        "--up",
        type=click.Choice(["y", "z"]),
        help="What is up in the picture, and where the sky of a map is: z for most scans.  [default: y]",
    ),
)

# The same, and how they are shown: the fields of `Finish`.
picture_options = together(
    camera_options,
    click.option(
        "--background",
        metavar="COLOUR|map|transparent",
        help="A name or #rrggbb, or the map behind the model.  [default: transparent, in a film or report white]",
    ),
    click.option(
        "--exposure", type=float, default=0.0, metavar="STOPS", help="Brighter than chosen for the model, or darker."
    ),
)

scene_argument = click.argument("scene", type=click.Path())
file_argument = click.argument("file", type=click.Path())
json_option = click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
effects_option = click.option(
    "--effects",
    default="auto",
    show_default=True,
    metavar="WHICH",
    help="auto, direct, all, none, or some of shadows,interreflection,colour (each needs those before it) and, with "
    "shadows, mirrors,gloss,glass,opacity,transmission,media.",
)
albedo_option = click.option(
    "--albedo",
    type=Albedo(),
    metavar="A|R,G,B",
    help="Diffuse reflectance of a mesh.  [default: that of its materials, textures and vertex colours; where the file "
    "says nothing 1, no interreflection]",
)
seed_option = click.option("--seed", default=0, show_default=True, help="The same seed gives the same result.")
crease_option = click.option(
    "--crease-angle",
    type=float,
    metavar="DEG",
    help="Edges of a mesh file sharper than this are hard, where the file gives no normals.  [default: none is]",
)
parameters_option = click.option(
    "-D",
    "--define",
    "parameters",
    type=Parameter(),
    multiple=True,
    callback=as_dict,
    metavar="NAME=VALUE",
    help="Of an .xml scene: the value of $NAME there; may be given several times.",
)
clamp_option = click.option("--clamp-negative", is_flag=True, help="Set negative texels of a map to zero.")
rotate_option = click.option(
    "--rotate", default=0.0, show_default=True, metavar="DEG", help="Turn the map about the up axis y."
)

fixed_lights_option = click.option(
    "--fixed-lights",
    multiple=True,
    type=LampScale(),
    callback=as_scales,
    metavar="[NAME=]SCALE",
    help="What the light of the scene's lamps, or of that lamp, is multiplied by; may be given several times.  "
    "[default: 1]",
)

# Who shares the work, see `crew_of`; the names are those of Dask's own commands.
crew_options = together(
    click.option("--workers", type=int, metavar="N", help="Share the work among N processes on this machine."),
    click.option("--scheduler", metavar="ADDRESS", help="Share it among the workers of a Dask scheduler."),
    click.option("--scheduler-file", type=click.Path(), help="The same; the file that the scheduler wrote."),
    click.option("--tls-ca-file", type=click.Path(), help="Certificate authority of the scheduler, for TLS."),
    click.option("--tls-cert", type=click.Path(), help="Our certificate."),
    click.option("--tls-key", type=click.Path(), help="Its key.  [default: in the certificate's file]"),
)

# What transport is asked for: the fields of `TransportSettings`.
transport_options = together(
    click.option("--bandlimit", default=10, show_default=True, help="Highest degree L of the spherical harmonics."),
    click.option("--samples", default=1024, show_default=True, help="Rays per vertex, over the hemisphere."),
    effects_option,
    click.option(
        "--bounces", type=int, help="Of light between surfaces.  [default: until what is left is below 0.1 %]"
    ),
    albedo_option,
    click.option(
        "--view", metavar="CAMERA", help="Of an .xml scene, by id or number: transfer of glossy materials toward it."
    ),
    click.option(
        "--smooth/--no-smooth",
        default=True,
        show_default=True,
        help="Take the noise of light by way of mirrors, glass and the like out along the surface.",
    ),
    crease_option,
    parameters_option,
    seed_option,
)

# What is grouped into caps: fields of `CompressionSettings`.
grouping_options = together(
    click.option("--clusters", default=96, show_default=True, help="Number of caps."),
    click.option(
        "--group-by",
        type=Names("group_by"),
        default="normal",
        show_default=True,
        help="Caps of normals, of mean directions of unblocked light, or of patches of the surface.",
    ),
    click.option(
        "--occlusion-classes",
        default=1,
        show_default=True,
        help="Learn separately from so many classes of vertices, from occluded to open.",
    ),
)


def check_width(_context: click.Context, _option: click.Parameter, width: int | None) -> int | None:
    """Raise UserError unless a picture of that width is sensible."""
    if width is not None and not 16 <= width <= 8192:
        raise UserError(f"width must be between 16 and 8192 pixels, not {width}")
    return width


def check_noise(_context: click.Context, _option: click.Parameter, noise: float) -> float:
    """Raise UserError unless it is the relative noise of a reference."""
    if not 0.0 < noise < 1.0:
        raise UserError(f"noise must be a number in (0, 1), not {noise!r}")
    return noise
