"""The option ``--variant`` of all commands that trace."""

from __future__ import annotations

import click


def _choose(context: click.Context, _option: click.Parameter, name: str | None) -> None:
    """For as long as the command runs."""
    if name is not None:
        from slepian_prt.renderer.variants import chosen_variant  # only here: help needs no renderer

        context.with_resource(chosen_variant(name))


variant_option = click.option(
    "--variant",
    metavar="NAME",
    callback=_choose,
    expose_value=False,
    help="Of Mitsuba, to trace in: cuda_ad_rgb or llvm_ad_rgb.  [default: that of SLEPIAN_PRT_VARIANT, or CUDA where "
    "there is a device]",
)
