"""Mathematics on the unit sphere: harmonics, rotations, quadrature, caps and regions. Imports no renderer."""
