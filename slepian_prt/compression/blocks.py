"""The blocks of a store, read cap by cap."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.checkpoint import Block, Store
from slepian_prt.compression.clustering import Clusters
from slepian_prt.compression.codec.surface import CapSurface, surface_of
from slepian_prt.scene.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Caps:
    """Coefficients of a mesh, cap by cap.

    Attributes
    ----------
    mesh : Mesh
    clusters : Clusters
    widths : (n,)
        Coefficients of a vertex of each cap.
    store : Store
    overrides : dict of int to Block
        Blocks that replace what the store has of their vertices.
    """

    mesh: Mesh
    clusters: Clusters
    widths: NDArray[np.int64]
    store: Store
    overrides: dict[int, Block]

    @cached_property
    def _starts(self) -> dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """For each block, where each cap's vertices begin, and their coefficients."""
        return {number: self._starts_of(block) for number, block in self.store}

    def _starts_of(self, block: Block) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        sizes = np.bincount(self.clusters.index[block.vertices], minlength=len(self.widths))
        return tuple(np.concatenate([[0], np.cumsum(n)]) for n in (sizes, sizes * self.widths))  # type: ignore[return-value]

    def energies(self) -> tuple[float, float]:
        """Sums over all vertices of the squared norms of (weighted) vectors and of what the bases miss."""
        figures = np.zeros((len(self.mesh.positions), 2))
        for block in self._blocks():
            figures[block.vertices] = block.figures[:, 1:]
        total, missed = figures.sum(axis=0)
        return float(total), float(missed)

    def largest(self) -> float:
        """The largest size of a coefficient."""
        return max((float(np.abs(block.coefficients).max(initial=0.0)) for block in self._blocks()), default=0.0)

    def _blocks(self) -> Iterator[Block]:
        """One after the other: together they may not fit in memory."""
        yield from (block for _, block in self.store)
        yield from self.overrides.values()

    def members(self, c: int) -> NDArray[np.float32]:
        """(n, K channels) coefficients of a cap, in the order of its members."""
        members, width = self.clusters.members[c], int(self.widths[c])
        values = np.zeros((members.size, width), dtype=np.float32)
        for number, (vertices, coefficients) in self._starts.items():
            if vertices[c + 1] > vertices[c]:
                found, flat = self.store.part(
                    number,
                    slice(int(vertices[c]), int(vertices[c + 1])),
                    slice(int(coefficients[c]), int(coefficients[c + 1])),
                )
                values[np.searchsorted(members, found)] = flat.reshape(found.size, width)
        for block in self.overrides.values():
            vertices, coefficients = self._starts_of(block)
            found, flat = (
                block.vertices[vertices[c] : vertices[c + 1]],
                block.coefficients[coefficients[c] : coefficients[c + 1]],
            )
            values[np.searchsorted(members, found)] = flat.reshape(found.size, width)
        return values

    def along(self, c: int) -> tuple[NDArray[np.float32], CapSurface]:
        """(n, K channels) coefficients of a cap in the order of coding, with its surface."""
        members = self.clusters.members[c]
        surface = surface_of(self.mesh).cap(members)
        return self.members(c)[np.searchsorted(members, surface.order)], surface
