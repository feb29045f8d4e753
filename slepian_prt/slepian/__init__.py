"""Concentrated bases: the spatio-spectral concentration problem on caps and its kernels. Imports no renderer."""
