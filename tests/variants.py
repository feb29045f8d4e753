"""The variants of Mitsuba that tests run in: those of ``SLEPIAN_PRT_VARIANT``, or of what works."""

from slepian_prt.renderer.variants import usable_variant

# In colour, differentiable.
VARIANT = usable_variant()


def sibling(kind: str) -> str:
    """Another variant of the same backend: of kind ``ad_mono``, ``ad_spectral``, …"""
    return f"{VARIANT.partition('_')[0]}_{kind}"
