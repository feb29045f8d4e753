"""Nodes of a glTF file: where its meshes stand, how often, and on which joints.

Source: glTF 2.0, sections 3.5 and 3.7.3; EXT_mesh_gpu_instancing; KHR_node_visibility.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.gltf_accessors import read_accessor
from slepian_prt.scene.formats.gltf_file import Document
from slepian_prt.scene.formats.gltf_json import Entry
from slepian_prt.scene.formats.gltf_transforms import compose

_MOVES = {"translation", "rotation", "scale", "matrix"}


def read_parents(document: Document) -> NDArray[np.int64]:
    """(N,) the parent of each node; -1 for a root.

    Raises
    ------
    UserError
        A node has two parents, or is its own ancestor.
    """
    nodes = document.table("nodes")
    parents = np.full(len(nodes), -1, dtype=np.int64)
    for index, node in enumerate(nodes):
        for child in node.indices("children"):
            place = document.at("nodes", child, node).place
            if parents[child] >= 0:
                raise node.fault(f"has {place} as a child, which node {parents[child]} has already")
            parents[child] = index
    # Whoever is still below someone after as many doublings as the deepest tree needs is in a cycle.
    above = parents.copy()
    for _ in range(len(nodes).bit_length()):
        above = np.where(above >= 0, above[above], -1)
    if (above >= 0).any():
        raise nodes[int(above.max())].fault("is its own ancestor")
    return parents


def place_nodes(document: Document, parents: NDArray[np.int64]) -> NDArray[np.float64]:
    """(N, 4, 4) transforms of the nodes to the space of the file."""
    own, moved = _read_transforms(document)
    placed, done, above = own.copy(), (parents < 0).tolist(), parents.tolist()
    for index in np.flatnonzero(parents >= 0).tolist():
        chain = []
        while not done[index]:
            chain.append(index)
            index = above[index]
        for node in reversed(chain):
            parent = placed[above[node]]
            placed[node] = parent @ own[node] if moved[node] else parent
            done[node] = True
    return placed


def _read_transforms(document: Document) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(N, 4, 4) of each node to its parent, and (N,) whether it says one; files may have millions that do not."""
    every = document.table("nodes")
    moved = np.array([not _MOVES.isdisjoint(node.values) for node in every], dtype=bool)
    result = np.tile(np.eye(4), (len(every), 1, 1))
    nodes = [every[index] for index in np.flatnonzero(moved)]
    zero, one, still = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 1.0)
    translations = [node.numbers("translation", zero) for node in nodes]
    rotations = [node.numbers("rotation", still) for node in nodes]
    scales = [node.numbers("scale", one) for node in nodes]
    for node, rotation in zip(nodes, rotations, strict=True):
        if not any(rotation):
            raise node.fault("has a rotation of zero length")
    out = compose(*(np.reshape(v, (-1, size)) for v, size in ((translations, 3), (rotations, 4), (scales, 3))))
    for index, node in enumerate(nodes):
        if "matrix" in node.values:
            matrix = np.array(node.numbers("matrix", (), 16)).reshape(4, 4).T
            if np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-6:
                raise node.fault(f"has a matrix that is not affine (its last row is {matrix[3].tolist()})")
            out[index] = matrix
    result[moved] = out
    return result, moved


def list_drawn(document: Document, parents: NDArray[np.int64], notes: Counter[str]) -> list[int]:
    """Nodes of the scene that the file shows first, each once; all of them if it names no scene."""
    nodes, scenes = document.table("nodes"), document.table("scenes")
    if scenes:
        index = document.root.integer("scene", 0)
        scene = document.at("scenes", index, Entry(document.path, "the file", {}))
        roots = scene.indices("nodes")
        for root in roots:
            document.at("nodes", root, scene)
        if len(scenes) > 1:
            notes[f"scene {index} of {len(scenes)} is read"] += 1
    else:
        roots = np.flatnonzero(parents < 0).tolist()
    drawn: dict[int, None] = {}
    waiting = roots[::-1]
    while waiting:
        index = waiting.pop()
        shown = nodes[index].extension("KHR_node_visibility")
        if index in drawn:
            continue
        if shown and not shown.flag("visible", True):
            notes["a hidden node left out, with all below it"] += 1
            continue
        drawn[index] = None
        waiting.extend(nodes[index].indices("children")[::-1])
    return list(drawn)


def read_instances(document: Document, node: Entry) -> NDArray[np.float64] | None:
    """(K, 4, 4) transforms of the copies of a mesh, before that of its node; None if there is just the mesh."""
    extension = node.extension("EXT_mesh_gpu_instancing")
    attributes = extension.entry("attributes") if extension else None
    if attributes is None:
        return None
    kinds = {"TRANSLATION": "VEC3", "ROTATION": "VEC4", "SCALE": "VEC3"}
    found = {}
    for name, kind in kinds.items():
        if name in attributes.values:
            found[name] = read_accessor(document, attributes.integer(name), attributes, (kind,)).scaled()
    if not found:
        # Other attributes alone, as numbers of copies at one place.
        return np.eye(4)[None]
    counts = {len(values) for values in found.values()}
    if len(counts) > 1:
        raise attributes.fault(f"has {' and '.join(map(str, sorted(counts)))} instances")
    matrices = compose(**{name.lower(): values for name, values in found.items()})
    if not np.isfinite(matrices).all():
        raise attributes.fault("has an instance whose transform is not finite")
    return matrices


def read_joints(document: Document, node: Entry, placed: NDArray[np.float64]) -> NDArray[np.float64]:
    """(J, 4, 4) what each joint of a node's skin does to a mesh, as the joints stand.

    Raises
    ------
    UserError
        No joints, or fewer inverse bind matrices.
    """
    skin = document.find("skins", node, "skin")
    joints = skin.indices("joints")
    if not joints:
        raise skin.fault("has no joints")
    for joint in joints:
        document.at("nodes", joint, skin)
    matrices = placed[joints]
    if "inverseBindMatrices" not in skin.values:
        return matrices
    inverse = read_accessor(document, skin.integer("inverseBindMatrices"), skin, ("MAT4",)).scaled()
    if len(inverse) < len(joints):
        raise skin.fault(f"has {len(inverse)} inverse bind matrices for {len(joints)} joints")
    bind = inverse[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
    if not np.isfinite(bind).all():
        raise skin.fault("has an inverse bind matrix that is not finite")
    return matrices @ bind


def refuse_empty(document: Document) -> UserError:
    """What to raise if nothing is drawn."""
    scenes = document.table("scenes")
    where = f"scene {document.root.integer('scene', 0)}" if scenes else "the file"
    reason = "shows no triangles" if document.table("meshes") else "has no mesh"
    return UserError(f"{document.path}: {where} {reason}; light needs surfaces, so export it with its triangles")
