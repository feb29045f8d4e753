"""Connected pieces of what edges join."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def connected_pieces(edges: NDArray, count: int) -> NDArray[np.int32]:
    """(count,) number of the connected piece of each vertex, of edges (E, 2)."""
    # Only here: what reads and relights transfer starts without SciPy, which takes a quarter of a second to import.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(edges), dtype=bool), tuple(edges.T)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1])
