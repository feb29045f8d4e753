"""How other tools number, sign, scale and lay out spherical harmonics, and conversion between any two of them."""
