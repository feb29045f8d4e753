"""What is done on a card, done on processors: `pytest -p tests.on_device` runs any tests so, without a card.

Tests of what a card does otherwise (blocks of another size) are not for it.
"""

from slepian_prt.renderer import variants

variants.is_on_device = lambda mi: (mi.variant() or "scalar").partition("_")[0] != "scalar"
