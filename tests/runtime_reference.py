"""The run-time format as docs/runtime-format.md has it, read by someone who knows nothing else: 30 lines of NumPy.

`relit` is what a vertex shader does with the table that `lit_table` makes for a light.
"""

import numpy as np


def lit_table(functions, zeros, lighting, used=None):
    """(C, K, 3) what a light (3, M) makes of the functions (C, K, channels, M), of which only ``used`` count."""
    caps, count, channels, _ = functions.shape
    used = count if used is None else used
    table = np.zeros((caps, count, 3))
    for colour in range(3):
        table[:, :used, colour] = functions[:, :used, colour % channels].astype(float) @ lighting[colour]
    table[:, 0] -= (zeros[:, : used - 1, None] * table[:, 1:used]).sum(axis=1)
    return table


def relit(vertices, table):
    """(V, 3) radiance of the vertices (V, K) for unit albedo."""
    own = table[vertices[:, -1]]
    return own[:, 0] + np.einsum("vk,vkd->vd", vertices[:, :-1] / 255.0, own[:, 1:])


def transfer_vectors(vertices, functions, zeros):
    """(V, channels, M) the transfer that the bytes stand for."""
    cap = vertices[:, -1]
    coefficients = vertices[:, :-1] / 255.0 - zeros[cap]
    return functions[cap, 0] + np.einsum("vk,vkcm->vcm", coefficients, functions[cap, 1:])
