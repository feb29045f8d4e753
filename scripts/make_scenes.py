"""Makes scenes/: a fluted trefoil knot on a disc, and a sunny sky from Mitsuba's ``sunsky``.

Run by ``scripts/make_scenes``; the results are committed, so that users need not run it.
"""

from pathlib import Path

import numpy as np
import trimesh

from slepian_prt.renderer.variants import mitsuba

SCENES = Path(__file__).parent.parent / "scenes"


def fluted_knot(along: int = 900, around: int = 30) -> trimesh.Trimesh:
    """A tube about the trefoil knot with six twisted flutes; (along * around) vertices."""
    t = np.linspace(0.0, 2.0 * np.pi, along, endpoint=False)
    center = np.column_stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -1.1 * np.sin(3 * t)])
    tangent = np.gradient(np.concatenate([center[-2:], center, center[:2]]), axis=0)[2:-2]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # A frame that turns as little as possible, closed by spreading the angle that is left over the whole curve.
    frame = np.empty_like(center)
    frame[0] = np.cross(tangent[0], [0.0, 0.0, 1.0])
    for i in range(1, along):
        frame[i] = frame[i - 1] - (frame[i - 1] @ tangent[i]) * tangent[i]
    frame /= np.linalg.norm(frame, axis=1, keepdims=True)
    second = np.cross(tangent, frame)
    last = frame[-1] - (frame[-1] @ tangent[0]) * tangent[0]
    gap = np.arctan2(last @ second[0], last @ frame[0])
    phi = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    turn = phi[None, :] + (2.0 * np.pi - gap) * (t / (2.0 * np.pi))[:, None]
    radius = 0.62 * (1.0 + 0.10 * np.cos(6.0 * phi))[None, :, None]
    ring = np.cos(turn)[..., None] * frame[:, None] + np.sin(turn)[..., None] * second[:, None]
    vertices = (center[:, None] + radius * ring).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(along), np.arange(around), indexing="ij")
    a, b = i * around + j, i * around + (j + 1) % around
    c, d = ((i + 1) % along) * around + j, ((i + 1) % along) * around + (j + 1) % around
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    return trimesh.Trimesh(vertices, faces, process=False)


def disc(radius: float, height: float, rings: int = 42, spokes: int = 150) -> trimesh.Trimesh:
    """A flat disc that faces up, fine enough to carry shadows."""
    r = radius * np.arange(1, rings + 1) / rings
    phi = 2.0 * np.pi * np.arange(spokes) / spokes
    x, z = np.outer(r, np.cos(phi)).ravel(), np.outer(r, np.sin(phi)).ravel()
    vertices = np.concatenate([[[0.0, height, 0.0]], np.column_stack([x, np.full(x.size, height), z])])
    faces = [[0, 1 + (k + 1) % spokes, 1 + k] for k in range(spokes)]
    for i in range(rings - 1):
        for k in range(spokes):
            a, b = 1 + i * spokes + k, 1 + i * spokes + (k + 1) % spokes
            faces += [[a, b, a + spokes], [b, b + spokes, a + spokes]]
    return trimesh.Trimesh(vertices, faces, process=False)


def sky(height: int = 256) -> np.ndarray:
    """Radiance of Mitsuba's sun and sky, (H, 2H, 3), for its ``envmap``; a sun 3° wide, of the same power."""
    with mitsuba() as mi:
        import drjit as dr

        emitter = mi.load_dict(
            {
                "type": "sunsky",
                "turbidity": 4.0,
                "sun_direction": [0.75, 0.75, 0.55],
                "sun_aperture": 3.0,
                "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90.0),
            }
        )
        oversampling = 4
        rows = (np.arange(height * oversampling) + 0.5) / oversampling - 0.5
        columns = (np.arange(2 * height * oversampling) + 0.5) / oversampling
        polar, azimuth = np.clip(rows / (height - 1), 0, 1) * np.pi, columns / height * np.pi
        v, u = np.meshgrid(polar, azimuth, indexing="ij")
        directions = np.stack([np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u)])
        si = dr.zeros(mi.SurfaceInteraction3f, v.size)
        si.wi = -mi.Vector3f(directions.reshape(3, -1).astype(np.float32))
        radiance = np.array(emitter.eval(si)).reshape(3, height, oversampling, 2 * height, oversampling)
        return np.moveaxis(radiance.mean(axis=(2, 4)), 0, -1).astype(np.float32)


def main() -> None:
    SCENES.mkdir(exist_ok=True)
    knot = fluted_knot()
    turn = trimesh.transformations.rotation_matrix(np.radians(-18.0), [1, 0, 0])
    knot.apply_transform(turn)
    knot.vertices[:, 1] -= knot.vertices[:, 1].min()
    floor = disc(1.25 * np.abs(knot.vertices[:, [0, 2]]).max(), -0.02)
    scene = trimesh.util.concatenate([knot, floor])
    scene = trimesh.Trimesh(scene.vertices.astype(np.float32), scene.faces, process=False)
    (SCENES / "knot.ply").write_bytes(scene.export(file_type="ply", vertex_normal=False))
    print(f"knot.ply: {len(scene.vertices)} vertices, {len(scene.faces)} faces")
    texels = sky()
    with mitsuba() as mi:
        bitmap = mi.Bitmap(texels).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float16, srgb_gamma=False)
        bitmap.write(str(SCENES / "sky.exr"))
    print(f"sky.exr: {texels.shape[1]} x {texels.shape[0]}, brightest texel {texels.max():.4g}")


if __name__ == "__main__":
    main()
