"""What commands work with: ``--variant`` of all that trace, ``--threads`` and ``--max-memory``."""

from __future__ import annotations

from typing import Any

import click

from slepian_prt.cli.options import together


def _choose(context: click.Context, _option: click.Parameter, name: str | None) -> None:
    """For as long as the command runs."""
    if name is not None:
        from slepian_prt.renderer.variants import chosen_variant  # only here: help needs no renderer

        context.with_resource(chosen_variant(name))


def _limit_threads(context: click.Context, _option: click.Parameter, count: Any) -> None:
    if count is None:
        from slepian_prt.machine.threads import thread_count

        thread_count()  # what the variable says, also where nothing comes to ask for it
    else:
        from slepian_prt.renderer.threads import threads_limited

        context.with_resource(threads_limited(count))


def _limit_memory(context: click.Context, _option: click.Parameter, size: str | None) -> None:
    from slepian_prt.machine.memory import limit_given, memory_limited, parse_size

    if size is None:
        limit_given()
    else:
        context.with_resource(memory_limited(parse_size(size, "`max_memory`")))


variant_option = click.option(
    "--variant",
    metavar="NAME",
    callback=_choose,
    expose_value=False,
    help="Of Mitsuba, to trace in: cuda_ad_rgb or llvm_ad_rgb.  [default: that of SLEPIAN_PRT_VARIANT, or CUDA where "
    "there is a device]",
)

threads_option = click.option(
    "--threads",
    metavar="N",
    is_eager=True,  # before Mitsuba starts its own
    callback=_limit_threads,
    expose_value=False,
    help="Work in N threads, in each process.  [default: that of SLEPIAN_PRT_THREADS, or as many as there are cores "
    "that the control group grants]",
)

memory_option = click.option(
    "--max-memory",
    metavar="SIZE",
    is_eager=True,
    callback=_limit_memory,
    expose_value=False,
    help="Take no more memory than that, as 2G or 500M, in each process.  [default: that of SLEPIAN_PRT_MAX_MEMORY, "
    "or what is left]",
)

machine_options = together(variant_option, threads_option, memory_option)
