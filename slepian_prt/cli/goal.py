"""Precompute toward a goal, ``--max-error`` or ``--max-seconds``."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from slepian_prt.cache_folder import work_kept
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.terminal import describe, print_plan, print_table, progress
from slepian_prt.files import KEPT_ORDER

if TYPE_CHECKING:
    from slepian_prt.accuracy.goal import Goal, Light
    from slepian_prt.accuracy.trials import Choice
    from slepian_prt.accuracy.verify import Verification
    from slepian_prt.compression.settings import CompressionSettings
    from slepian_prt.distributed.crew import Crew
    from slepian_prt.transport.settings import TransportSettings


def precompute_toward(
    scene: str,
    output: str,
    goal: Goal,
    light: Light,
    settings: CompressionSettings,
    transport: TransportSettings,
    crew: Crew | None,
    started: float,
    *,
    keep_order: bool,
) -> None:
    """Toward a goal; what was foreseen and what came of it is told."""
    from slepian_prt.accuracy.run import precompute_within

    with work_kept(), progress("transport", "vertices") as (advance, report):
        found = precompute_within(
            scene,
            goal,
            light,
            settings,
            transport,
            started=started,
            on_plan=print_plan,
            on_choice=_print_choices,
            advance=advance,
            report=report,
            crew=crew,
        )
        found.packed.save(output, keep_order=keep_order or found.packed.vertex_count <= KEPT_ORDER)
    print_verification(found.verification, goal)
    say(f"{output}: {describe(found.packed)}; {time.perf_counter() - started:.1f} s in all")


def _print_choices(choices: Sequence[Choice], chosen: Choice, rest: float) -> None:
    """What could be chosen, as a table; the choice is marked."""
    headings = (
        "", "rays", "L", "tolerance", "error of transport", "predicted error", "bytes/vertex, at most",
        "transport", "compression", "in all",
    )  # fmt: skip
    rows = [
        [
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
        ]
        for choice in sorted(choices, key=lambda c: c.seconds)
    ]
    print_table(dict.fromkeys(headings, "right"), rows, spare=("compression", "transport", "error of transport"))


def print_verification(checked: Verification, goal: Goal) -> None:
    """What came of it, a line for each light."""
    for name, inside, black, error, predicted, noise in zip(
        checked.names, *checked.left_out, checked.error, checked.predicted, checked.noise, strict=True
    ):
        shown = f"{error:.2%}" if error > noise else f"below the noise, {noise:.2%}"
        say(
            f"verified on {_counted(checked.vertices, int(inside), int(black))}, {name}: error {shown} (predicted "
            f"{predicted:.2%}; noise of the reference {noise:.2%})"
        )
    say(f"predicted {checked.predicted_seconds:.1f} s, took {checked.seconds:.1f} s")
    if goal.error is not None and checked.error.max() > goal.error:
        note(f"the error is above the {goal.error:g} that was asked for")


def _counted(vertices: int, inside: int, black: int) -> str:
    """How many vertices an error is of, and which are left out of it."""
    shares = [f"{count}, {100.0 * count / max(1, vertices):.3g}%, " for count in (inside, black)]
    left_out = f"{shares[0]}inside other geometry, {shares[1]}black in the reference"
    return f"{vertices - inside - black} of {vertices} vertices held out (left out: {left_out})"
