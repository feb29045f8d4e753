"""The command line: parses, calls, prints."""

from __future__ import annotations

import json
import logging
import math
import os
import shlex
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

import slepian_prt
from slepian_prt.errors import UserError

_CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}

scene_argument = click.argument("scene", type=click.Path())
output_option = click.option("-o", "--output", required=True, type=click.Path(), help="Where to write.")
bandlimit_option = click.option(
    "--bandlimit", default=10, show_default=True, help="Highest degree L of the spherical harmonics."
)
samples_option = click.option(
    "--samples", default=1024, show_default=True, help="Rays per vertex, over the hemisphere."
)
effects_option = click.option(
    "--effects",
    default="auto",
    show_default=True,
    metavar="WHICH",
    help="auto, direct, all, none, or some of shadows,interreflection,colour (each needs those before it).",
)
bounces_option = click.option(
    "--bounces", type=int, help="Of light between surfaces.  [default: until what is left is below 0.1 %]"
)
albedo_option = click.option(
    "--albedo", metavar="A|R,G,B", help="Diffuse reflectance of a mesh file.  [default: 1, no interreflection]"
)
view_option = click.option(
    "--view", metavar="CAMERA", help="Of an .xml scene, by id or number: transfer of glossy materials toward it."
)
seed_option = click.option("--seed", default=0, show_default=True, help="The same seed gives the same result.")
clamp_option = click.option("--clamp-negative", is_flag=True, help="Set negative texels of a map to zero.")
rotate_option = click.option(
    "--rotate", default=0.0, show_default=True, metavar="DEG", help="Turn the map about the up axis y."
)


def together(*options: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Several options as one decorator."""

    def decorate(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


# What transport is asked for; the keywords of `Job`.
transport_options = together(
    bandlimit_option, samples_option, effects_option, bounces_option, albedo_option, view_option, seed_option
)

# What is grouped into caps; keywords of `Settings`.
grouping_options = together(
    click.option("--clusters", default=96, show_default=True, help="Number of caps."),
    click.option(
        "--group-by",
        type=click.Choice(["normal", "bent", "surface"]),
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

# How to compress; keywords of `Settings`.
compression_options = together(
    click.option(
        "--basis",
        type=click.Choice(["adapted", "transport", "slepian", "incident", "sh", "direct", "pca", "cpca", "none"]),
        default="adapted",
        show_default=True,
        help="Functions to compress with.",
    ),
    click.option("--tolerance", type=float, help="Wanted relative error.  [default: 0.02]"),
    click.option("--terms", type=int, help="Instead: this many functions in every cap."),
    click.option(
        "--truncate", type=click.Choice(["n_g", "n_ref", "count"]), help="Instead: at the cap's Shannon number."
    ),
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
        type=click.Choice(["coded", "float16", "float32"]),
        help="Coefficients: predicted, rounded, entropy-coded; or plain.  [default: coded; by --terms float32]",
    ),
)


@click.group(context_settings=_CONTEXT)
@click.version_option(slepian_prt.__version__, prog_name="slepian-prt")
def cli() -> None:
    """Compressed precomputed radiance transfer: precompute, relight, and know what compression cost."""


@cli.command()
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def doctor(as_json: bool) -> int:
    """What runs here: Mitsuba, variant, LLVM, cores, speed; and how to mend what does not."""
    from slepian_prt.scene.doctor import examine

    findings = examine()
    healthy = all(finding.ok for finding in findings)
    if as_json:
        click.echo(json.dumps({"ok": healthy, "findings": [finding.as_dict() for finding in findings]}, indent=1))
    else:
        width = max(len(finding.subject) for finding in findings)
        for finding in findings:
            click.echo(f"{'ok ' if finding.ok else '!! '} {finding.subject:<{width}}  {finding.value}")
            if finding.remedy:
                click.echo(f"    {'':<{width}}  -> {finding.remedy}")
    return 0 if healthy else 2


@cli.command()
@click.option("--bandlimit", required=True, type=int, help="Highest degree L, up to 500.")
@click.option("--half-angle", required=True, type=float, metavar="DEG", help="Half-angle of the cap, in degrees.")
@click.option("--kernel", default="slepian", show_default=True, help="slepian, diffuse or phong:EXPONENT.")
@click.option("--epsilon", default=0.01, show_default=True, help="Concentration down to which functions count.")
@click.option("--json", "json_file", type=click.Path(), help="Write all eigenvalues and numbers to this file.")
@click.option("--plot", "plot_file", type=click.Path(), help="Write a plot to this .png.")
def spectrum(
    bandlimit: int, half_angle: float, kernel: str, epsilon: float, json_file: str | None, plot_file: str | None
) -> None:
    """Eigenvalues of the concentration problem on a cap, and the Shannon numbers that estimate their count."""
    from slepian_prt import files
    from slepian_prt.evaluation import spectra

    if not 0.0 <= half_angle <= 180.0:
        raise UserError(f"half-angle must be between 0 and 180 degrees, not {half_angle:g}")
    for path in (json_file, plot_file):
        if path is not None:
            files.check_writable(path)
    if plot_file is not None and Path(plot_file).suffix.lower() != ".png":
        raise UserError(f"{plot_file}: plots are written as .png")
    result = spectra.spectrum(bandlimit, math.radians(half_angle), kernel, epsilon)
    numbers = result.numbers
    click.echo(f"L = {bandlimit}, half-angle {half_angle:g} degrees, {(bandlimit + 1) ** 2} functions, kernel {kernel}")
    click.echo(f"concentrations above {epsilon:g}: {numbers['count']:.0f}")
    for name, text in (
        ("shannon", "Shannon number N"),
        ("n_g", "generalised, N_g (Lessig & Fiume 2010, base-10 logarithms)"),
        ("n_g_natural", "generalised, natural logarithms"),
        ("n_ref", "two-term asymptotics, N_ref"),
    ):
        click.echo(f"{numbers[name]:10.2f}  {text}")
    shown = min(len(result.eigenvalues), 12)
    click.echo(f"first eigenvalues{'' if kernel == 'slepian' else ', relative to the first'} (order m):")
    for value, order in zip(result.eigenvalues[:shown], result.orders[:shown], strict=True):
        click.echo(f"  {value:.10g}  (m = {order:+d})")
    if json_file is not None:
        with files.atomic_output(json_file) as file:
            file.write((json.dumps(result.as_dict(), indent=1) + "\n").encode())
    if plot_file is not None:
        content = spectra.plot_spectrum(result)
        with files.atomic_output(plot_file) as file:
            file.write(content)


@cli.command()
@scene_argument
@output_option
@click.option(
    "--max-error",
    type=float,
    metavar="E",
    help="Choose rays, bandlimit and tolerance: the fastest whose radiance is off by at most E (0.05 is 5 %) under "
    "--environment or light of the --light-prior.",
)
@click.option("--max-seconds", type=float, metavar="S", help="Choose them: the most exact that takes at most S.")
@click.option(
    "--environment",
    multiple=True,
    type=click.Path(),
    help="Map that the goal is about; may be given several times.  [default: the light of the .xml scene]",
)
@transport_options
@compression_options
@grouping_options
@click.pass_context
def precompute(
    context: click.Context,
    scene: str,
    output: str,
    max_error: float | None,
    max_seconds: float | None,
    environment: tuple[str, ...],
    light_prior: tuple[str, ...],
    **options: Any,
) -> None:
    """Precompute the transfer of SCENE (ply, obj, stl, off, glb or Mitsuba xml), compress it, write one file.

    Stopped or killed, the same command goes on from the blocks of vertices that were finished.

    With --max-error or --max-seconds, rays, bandlimit and tolerance are chosen from a pilot, unless they are given, and
    what came of it is verified on vertices held out.
    """
    from slepian_prt import files
    from slepian_prt.accuracy.goal import Goal
    from slepian_prt.compression.settings import CompressionSettings
    from slepian_prt.compression.stream import precompute_compressed
    from slepian_prt.transport.transfer import TransportSettings

    started = time.perf_counter()
    transport = TransportSettings(**_take(options, TransportSettings), albedo=read_albedo(options.pop("albedo")))
    aimed = max_error is not None or max_seconds is not None
    if environment and not aimed:
        raise UserError("--environment says what --max-error and --max-seconds are about; give one of them too")
    settings = CompressionSettings(
        **options, light_prior=None if aimed else read_prior(light_prior, transport.bandlimit)
    )
    settings.check(transport.bandlimit)
    files.check_writable(output, scene)
    if output and Path(output).suffix.lower() != ".prt":
        raise UserError(f"{output}: transfer files end in .prt; name the output so")
    if aimed:
        given = {n: context.get_parameter_source(n) is ParameterSource.COMMANDLINE for n in ("samples", "bandlimit")}
        goal = Goal(
            max_error,
            max_seconds,
            samples=transport.samples if given["samples"] else None,
            bandlimit=transport.bandlimit if given["bandlimit"] else None,
        )
        goal.check()
        packed = _precompute_within(scene, goal, read_light(environment, light_prior), settings, transport, started)
        packed.save(output)
        click.echo(f"{output}: {_described(packed)}; {time.perf_counter() - started:.1f} s in all")
        return
    with progress("transport", "vertices") as (advance, report):
        packed = precompute_compressed(scene, settings, transport, on_plan=print_plan, advance=advance, report=report)
    if transport.bounces is not None and packed.bounces < transport.bounces:
        note(f"--bounces {transport.bounces} has no effect: no light between surfaces is simulated (see the plan)")
    packed.save(output)
    error = settings.expected_error(packed.expected)
    if not settings.by_number and error > 1.01 * settings.asked:
        note(
            f"a tolerance of {settings.asked:g} cannot be met with basis {packed.basis} here; the error is {error:.2g}"
        )
    seconds = packed.seconds
    under = f" under light of {packed.prior}" if packed.prior else ""
    click.echo(
        f"{output}: {_described(packed)}, predicted error {error:.2g}{under}; "
        f"{packed.rays_traced} rays in {seconds['transport']:.1f} s, compressed in {seconds['compress']:.1f} s"
    )


def _described(packed: Any) -> str:
    """What a transfer file holds, in short."""
    return (
        f"{len(packed.mesh.positions)} vertices, {packed.basis}, {packed.terms:.4g} functions of "
        f"{(packed.bandlimit + 1) ** 2} in {len(packed.bases)} caps, {packed.bytes_per_vertex:.2f} bytes per vertex"
    )


def _precompute_within(scene: str, goal: Any, light: Any, settings: Any, transport: Any, started: float) -> Any:
    """Run towards a goal and tell what was foreseen and what came of it."""
    from slepian_prt.accuracy.run import precompute_within

    with progress("transport", "vertices") as (advance, report):
        found = precompute_within(
            scene,
            goal,
            light,
            settings,
            transport,
            started=started,
            on_plan=print_plan,
            on_choice=print_choices,
            advance=advance,
            report=report,
        )
    checked = found.verification
    for name, error, predicted, noise in zip(
        checked.names, checked.error, checked.predicted, checked.noise, strict=True
    ):
        shown = f"{error:.2%}" if error > noise else f"below the noise, {noise:.2%}"
        click.echo(
            f"verified on {checked.vertices} vertices held out, {name}: error {shown} (predicted {predicted:.2%}; "
            f"noise of the reference {noise:.2%})"
        )
    click.echo(f"predicted {checked.predicted_seconds:.1f} s, took {checked.seconds:.1f} s")
    if goal.error is not None and checked.error.max() > goal.error:
        note(f"the error is above the {goal.error:g} that was asked for")
    return found.packed


def _take(options: dict[str, Any], kind: Any) -> dict[str, Any]:
    """Remove and return those options that are fields of a dataclass and need no reading."""
    names = [field.name for field in fields(kind) if field.name in options and field.name != "albedo"]
    return {name: options.pop(name) for name in names}


@cli.command()
@click.argument("file", type=click.Path())
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def info(file: str, as_json: bool) -> None:
    """What a transfer FILE holds, what was simulated, and what error to expect."""
    from slepian_prt.compression.compressed import load

    packed = load(file)
    content: dict[str, Any] = {
        "source": packed.source,
        "vertices": len(packed.mesh.positions),
        "faces": len(packed.mesh.faces),
        "bandlimit": packed.bandlimit,
        "basis": packed.basis,
        "coding": packed.coding,
        "channels": packed.channels,
        "bounces": packed.bounces,
        "camera": None if packed.view is None else packed.view.name,
        "toward_camera": packed.toward_view,
        "clusters": len(packed.bases),
        "terms": packed.terms,
        "bytes_per_vertex": packed.bytes_per_vertex,
        "predicted_error": packed.predicted_error,
        "predicted_relit_error": packed.predicted_relit_error(),
        "light_prior": packed.prior or None,
        "predicted_error_under_prior": packed.predicted_error_under_prior,
        "verified_error": packed.verified or None,
        "samples": packed.samples,
        "seed": packed.seed,
        "rays_traced": packed.rays_traced,
        "seconds": packed.seconds,
        "notes": list(packed.mesh.notes),
        "effects": [effect.as_dict() for effect in packed.effects],
    }
    if as_json:
        click.echo(json.dumps(content, indent=1))
        return
    effects = content.pop("effects")
    content["seconds"] = ", ".join(f"{stage} {value:.2f}" for stage, value in packed.seconds.items())
    content["verified_error"] = ", ".join(f"{name} {error:.4g}" for name, error in packed.verified.items()) or None
    content["notes"] = "; ".join(packed.mesh.notes) or "none"
    for name, value in content.items():
        click.echo(f"{name:<21} {f'{value:.4g}' if isinstance(value, float) else value}")
    del effects
    print_plan(packed.effects)


@cli.command()
@click.argument("file", type=click.Path())
@click.option(
    "--environment",
    multiple=True,
    type=click.Path(),
    help="Map: .exr, .hdr or .png, twice as wide as high; may be given several times.  "
    "[default: the light of the .xml scene]",
)
@rotate_option
@click.option("--turntable", type=int, metavar="N", help="N results, the light turned once about the up axis.")
@click.option("--window", type=click.Choice(["hann", "lanczos"]), help="Damp high degrees, against ringing of suns.")
@click.option(
    "--window-width",
    type=float,
    metavar="L",
    help="Degree that the window ends at.  [default: 0.1 % of vertices negative]",
)
@clamp_option
@click.option("--width", type=int, help="Of a picture, in pixels.  [default: that of the scene's camera, or 800]")
@click.option(
    "--format",
    "kind",
    type=click.Choice(["png", "exr", "npz", "ply"]),
    default="png",
    show_default=True,
    help="Of the files in a folder.",
)
@output_option
def relight(
    file: str,
    environment: tuple[str, ...],
    rotate: float,
    turntable: int | None,
    window: str | None,
    window_width: float | None,
    clamp_negative: bool,
    width: int | None,
    kind: str,
    output: str,
) -> None:
    """Relight a transfer FILE: radiance per vertex (.npz), coloured mesh (.ply) or picture (.png, .exr).

    Several lights (maps, or --turntable) give a folder of such files, one .npz, or a film (.mp4).
    """
    from slepian_prt.compression.compressed import load
    from slepian_prt.relighting.outputs import check_output
    from slepian_prt.relighting.series import Lights, relit_series, write_relit

    lights = Lights(environment, rotate, turntable, window, window_width, clamp_negative)
    lights.check()
    check_width(width)
    check_output(output, file, *environment, several=lights.several)
    packed = load(file)
    series = relit_series(packed, lights, file, note)
    write_relit(output, packed, series, f".{kind}", width, note)
    shone = ", ".join(Path(path).name for path in environment) or "the light of the scene"
    several = f", {len(series.names)} results" if lights.several else ""
    click.echo(f"{output}: {len(packed.mesh.positions)} vertices under {shone}{several}")


@cli.command()
@scene_argument
@click.option(
    "--environment",
    multiple=True,
    type=click.Path(),
    help="Map; may be given several times.  [default: the light of the .xml scene]",
)
@click.option("-o", "--output", required=True, type=click.Path(), help="Folder for report.html, results.json, figures.")
@click.option("--basis", "bases", multiple=True, help="Only these methods; may be given several times.")
@click.option("--terms", "terms", multiple=True, type=int, help="Numbers of functions; may be given several times.")
@transport_options
@grouping_options
@rotate_option
@clamp_option
@click.option("--width", type=int, help="Of the pictures, in pixels.  [default: that of the scene's camera, or 400]")
@click.option("--noise", default=0.01, show_default=True, help="Wanted relative noise of the references.")
@click.option(
    "--sweep",
    "swept",
    type=click.Path(),
    metavar="FILE",
    help="The sweep.json of this scene: its fronts are shown too.",
)
def compare(
    scene: str,
    environment: tuple[str, ...],
    output: str,
    swept: str | None,
    bases: tuple[str, ...],
    terms: tuple[int, ...],
    rotate: float,
    clamp_negative: bool,
    width: int | None,
    noise: float,
    **options: Any,
) -> None:
    """Compare methods on SCENE: errors against full SH and path-traced references, as a report and as JSON.

    The light of adapted+light is the mean spectrum of the maps.
    """
    from slepian_prt.compression.settings import CompressionSettings
    from slepian_prt.evaluation.compare import DEFAULT_TERMS
    from slepian_prt.evaluation.compare import compare as run
    from slepian_prt.evaluation.methods import DEFAULT_METHODS, check_methods
    from slepian_prt.evaluation.report import write_report
    from slepian_prt.evaluation.sweep.results import Sweep
    from slepian_prt.files import check_folder
    from slepian_prt.transport.transfer import TransportSettings

    transport = TransportSettings(**_take(options, TransportSettings), albedo=read_albedo(options.pop("albedo")))
    grouping = CompressionSettings(**options)
    grouping.check(transport.bandlimit)
    check_methods(bases)
    for k in terms:
        CompressionSettings(terms=k).check(transport.bandlimit)
    check_width(width)
    check_folder(output)
    found = None if swept is None else Sweep.read(swept)
    if found is not None and Path(found.source).name != Path(scene).name:
        raise UserError(f"{swept}: is a sweep of {found.source}, not of {scene}; name that of this scene")
    maps = read_maps(environment, clamp_negative, rotate)
    with progress("transport", "vertices") as (advance, report):
        comparison = run(
            scene,
            maps,
            transport=transport,
            grouping=grouping,
            methods=bases or DEFAULT_METHODS,
            terms=terms or DEFAULT_TERMS,
            width=width,
            noise=noise,
            report=report,
            on_plan=print_plan,
            advance=advance,
        )
    page = write_report(comparison, output, "slepian-prt " + shlex.join(sys.argv[1:]), found)
    lights = f"{len(comparison.views)} environment{'s' if len(comparison.views) > 1 else ''}"
    click.echo(f"{page}: {len(comparison.methods)} methods, {lights}, {comparison.seconds:.0f} s")


def _numbers(kind: type, text: str, name: str) -> tuple[Any, ...]:
    """Values with commas between."""
    try:
        return tuple(kind(part) for part in text.split(","))
    except ValueError:
        raise UserError(f"--{name} must be numbers with commas between, not {text!r}") from None


@cli.command()
@scene_argument
@click.option(
    "--environment",
    multiple=True,
    type=click.Path(),
    help="Map; may be given several times.  [default: the light of the .xml scene]",
)
@click.option("-o", "--output", required=True, type=click.Path(), help="Folder for sweep.html, .json, .csv, plots.")
@click.option("--samples", default="64,256,1024", show_default=True, metavar="N,…", help="Rays per vertex.")
@click.option("--bandlimit", default="5,10", show_default=True, metavar="L,…", help="Highest degrees.")
@click.option("--clusters", default="96", show_default=True, metavar="N,…", help="Numbers of caps.")
@click.option("--basis", default="adapted", show_default=True, metavar="NAME,…", help="Functions to compress with.")
@click.option("--tolerance", default="0.2,0.05,0.02", show_default=True, metavar="E,…", help="Of compression.")
@click.option("--bounces", metavar="N,…", help="Of light between surfaces.  [default: until the rest is below 0.1 %]")
@effects_option
@albedo_option
@seed_option
@rotate_option
@clamp_option
@click.option("--noise", default=0.005, show_default=True, help="Wanted relative noise of the references.")
def sweep(
    scene: str,
    environment: tuple[str, ...],
    output: str,
    samples: str,
    bandlimit: str,
    clusters: str,
    basis: str,
    tolerance: str,
    bounces: str | None,
    effects: str,
    albedo: str | None,
    seed: int,
    rotate: float,
    clamp_negative: bool,
    noise: float,
) -> None:
    """Accuracy against time and bytes on SCENE: every combination of settings, measured.

    Stopped or killed, the same command goes on from the settings that were finished.
    """
    from slepian_prt.evaluation.sweep.axes import Axes
    from slepian_prt.evaluation.sweep.report import describe, write_sweep
    from slepian_prt.evaluation.sweep.results import find_setbacks
    from slepian_prt.evaluation.sweep.run import sweep as run
    from slepian_prt.files import check_folder
    from slepian_prt.transport.transfer import TransportSettings

    axes = Axes(
        _numbers(int, samples, "samples"),
        _numbers(int, bandlimit, "bandlimit"),
        _numbers(int, clusters, "clusters"),
        tuple(basis.split(",")),
        _numbers(float, tolerance, "tolerance"),
        (None,) if bounces is None else _numbers(int, bounces, "bounces"),
    )
    axes.check()
    transport = TransportSettings(effects=effects, albedo=read_albedo(albedo), seed=seed)
    check_noise(noise)
    check_folder(output)
    maps = read_maps(environment, clamp_negative, rotate)
    checkpoint = Path(output) / "sweep.partial.jsonl"
    with progress("settings", "settings") as (advance, report):
        found = run(
            scene,
            maps,
            axes,
            transport,
            noise=noise,
            checkpoint=checkpoint,
            report=report,
            advance=advance,
            on_plan=print_plan,
        )
    found = replace(found, command="slepian-prt " + shlex.join(sys.argv[1:]))
    page = write_sweep(found, output)
    for sentence in find_setbacks(found):
        note(sentence)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("environment", "not beaten in time", "error", "seconds", "bytes/vertex"):
        table.add_column(heading, justify="left" if heading in ("environment", "not beaten in time") else "right")
    for row in describe(found):
        table.add_row(
            row["environment"],
            row["setting"],
            f"{row['error']:.1%}",
            f"{row['seconds']:.2g}",
            f"{row['bytes_per_vertex']:.3g}",
        )
    print_table(table)
    click.echo(f"{page}: {len(found.points)} settings")


# --- Terminal --------------------------------------------------------------------------------------------------------


class _Rate(ProgressColumn):
    """Items per second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:,.0f}/s" if task.speed else "", style="progress.data.speed")


@contextmanager
def progress(name: str, unit: str) -> Iterator[tuple[Callable[[int, int], None], Callable[[str], None]]]:
    """A bar with rate and time left on a terminal; nothing in a pipe.

    Yields advance(done now, total), and tell(text), which names what is done before or after on a line of its own.
    """
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        _Rate(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = None

        def advance(done: int, total: int) -> None:
            nonlocal task
            if task is None:
                task = bar.add_task(name, total=total)
            bar.advance(task, done)

        def report(what: str) -> None:
            if console.is_terminal:
                if task is not None:
                    bar.update(task, visible=False)
                console.print(Text(what, style="dim"))

        yield advance, report


def print_plan(effects: Sequence[Any]) -> None:
    """The effects plan as a table."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("effect", "verdict", "contribution", "cost", "reason"):
        table.add_column(heading, justify="right" if heading in ("contribution", "cost") else "left")
    for effect in effects:
        amount = "unknown" if effect.contribution is None else f"{effect.contribution:.3f}"
        if effect.confidence:
            amount += f" ± {effect.confidence:.3f}"
        table.add_row(effect.name, effect.verdict, amount, _rays(effect.rays), effect.reason)
    print_table(table)


def print_choices(choices: Sequence[Any], chosen: Any, rest: float) -> None:
    """What could be chosen, as a table; the choice is marked."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    headings = (
        "", "rays", "L", "tolerance", "error of transport", "predicted error", "bytes/vertex, at most",
        "transport", "compression", "in all",
    )  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right")
    for choice in sorted(choices, key=lambda c: c.seconds):
        table.add_row(
            "→" if choice is chosen else "",
            str(choice.samples),
            str(choice.bandlimit),
            f"{choice.tolerance:.3g}",
            f"{choice.transport_error.max():.2%}",
            f"{choice.worst:.2%} ± {choice.worst * choice.spread:.2%}",
            f"{choice.coded.bytes_per_vertex:.2g}",
            f"{choice.transport_seconds:.1f} s",
            f"{choice.coded.seconds:.1f} s",
            f"{rest + choice.seconds:.1f} s",
        )
    print_table(table)


def print_table(table: Table) -> None:
    """To standard output; in a pipe as wide as it needs."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=200)
    console.print(table)


def _rays(count: int) -> str:
    """A number of rays to two digits."""
    for size, unit in ((10**9, "G"), (10**6, "M"), (10**3, "k")):
        if count >= size:
            return f"{count / size:.2g} {unit}rays" if count < 10 * size else f"{count / size:.0f} {unit}rays"
    return f"{count} rays" if count else "none"


def read_albedo(text: str | None) -> list[float] | None:
    """One number or three with commas between; None stays None."""
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise UserError(f"--albedo must be one number between 0 and 1, or three as R,G,B; not {text!r}") from None


def read_prior(given: tuple[str, ...], bandlimit: int) -> Any:
    """The light prior that is named: 1/(l+1), or maps; None if there is none."""
    from slepian_prt.lighting.environment import read_environment
    from slepian_prt.lighting.projection import project_environment
    from slepian_prt.lighting.spectrum import FALLING, falling_prior, measured_prior

    if not given:
        return None
    if "" in given:
        raise UserError(f"--light-prior is empty; give {FALLING} or a map")
    if FALLING in given:
        if len(given) > 1:
            raise UserError(f"--light-prior is either {FALLING} or maps, not both")
        return falling_prior(bandlimit)
    maps = [read_environment(path, clamp_negative=True) for path in given]
    return measured_prior(
        [project_environment(light, bandlimit) for light in maps], bandlimit, ", ".join(light.name for light in maps)
    )


def read_light(environment: Sequence[str], light_prior: Sequence[str]) -> Any:
    """What a goal is about."""
    from slepian_prt.accuracy.run import Light
    from slepian_prt.lighting.spectrum import FALLING

    if "" in light_prior or (FALLING in light_prior and len(light_prior) > 1):
        read_prior(tuple(light_prior), 0)  # says what is wrong
    known = () if FALLING in light_prior else tuple(read_maps(light_prior, True, 0.0))
    named = ", ".join(light.name for light in known) if known else "".join(light_prior)
    return Light(tuple(read_maps(environment, True, 0.0)), named, known)


def read_maps(paths: Sequence[str], clamp_negative: bool, rotate: float) -> list[Any]:
    """The environments that are named; what was mended in them is noted."""
    from slepian_prt.lighting.environment import check_names, read_environment

    check_names(paths)
    maps = [read_environment(path, clamp_negative=clamp_negative).rotated(rotate) for path in paths]
    for path, light in zip(paths, maps, strict=True):
        if light.clamped:
            note(f"{path}: {light.clamped} negative texels set to zero")
    return maps


def note(text: str) -> None:
    """A remark on standard error."""
    click.echo(f"note: {text}", err=True)


def check_width(width: int | None) -> None:
    """Raise UserError unless a picture of that width is sensible."""
    if width is not None and not 16 <= width <= 8192:
        raise UserError(f"width must be between 16 and 8192 pixels, not {width}")


def check_noise(noise: float) -> None:
    """Raise UserError unless references can be that exact."""
    if not (math.isfinite(noise) and noise > 0.0):
        raise UserError(f"noise must be a positive number, not {noise!r}")


class _Notes(logging.Handler):
    """Remarks of the library on standard error, each once."""

    def __init__(self) -> None:
        super().__init__()
        self._made: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if text not in self._made:
            self._made.add(text)
            note(text)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; exit 0, or 2 for a user's mistake with one line about it, or 1 for a fault of ours."""
    log = logging.getLogger("slepian_prt")
    log.setLevel(logging.INFO)
    log.addHandler(_Notes())
    sys.exit(_run(arguments))


def _run(arguments: Sequence[str] | None) -> int:
    try:
        outcome = cli.main(args=arguments, prog_name="slepian-prt", standalone_mode=False)
        return outcome if isinstance(outcome, int) else 0
    except UserError as error:
        return _fail(2, str(error))
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return 0
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "slepian-prt"
        return _fail(2, f"{error.format_message().rstrip('.')}; see {command} --help")
    except click.ClickException as error:
        return _fail(2, error.format_message())
    except (KeyboardInterrupt, click.Abort):
        return _fail(130, "interrupted; nothing was written")
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - so that the flush at exit is quiet too
        return 0
    except MemoryError:
        return _fail(1, "out of memory; try a lower --bandlimit or fewer --samples")
    except Exception as error:
        if os.environ.get("SLEPIAN_PRT_DEBUG"):
            traceback.print_exc()
        reason = " ".join(str(error).split())
        return _fail(
            1, f"internal error, {type(error).__name__}: {reason} (SLEPIAN_PRT_DEBUG=1 shows where; please report it)"
        )


def _fail(code: int, message: str) -> int:
    click.echo(f"slepian-prt: {message}", err=True)
    return code


if __name__ == "__main__":
    main()
