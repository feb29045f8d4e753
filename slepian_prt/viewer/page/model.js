/** A model of the payload as three.js meshes, whose vertices are lit by the GPU. */

import {
  BufferAttribute, BufferGeometry, ClampToEdgeWrapping, DataTexture, DoubleSide, FloatType, FrontSide, GLSL3, Group,
  LinearFilter, Mesh, MirroredRepeatWrapping, NearestFilter, NoBlending, RawShaderMaterial, RepeatWrapping, RGBAFormat,
  SRGBColorSpace, Sphere, Texture, Vector3,
} from "three-kit";
import { ReceiverRadiance } from "#receivers";
import { transferFragment, transferVertex } from "#shaders";

const WRAPS = { repeat: RepeatWrapping, clamp: ClampToEdgeWrapping, mirror: MirroredRepeatWrapping };

/**
 * What is drawn of a model.
 *
 * @typedef {object} LitModel
 * @property {Group} group
 * @property {object} uniforms - Shared by its materials: `white`, what `radiance` gives, and `lamps`.
 * @property {ReceiverRadiance} radiance
 */

/**
 * The ball around the vertices of geometries that are used, in the world.
 *
 * @param {object[]} geometries - Of the payload.
 * @returns {{middle: Vector3, radius: number}}
 */
export function ballAround(geometries) {
  const low = new Vector3(Infinity, Infinity, Infinity);
  const high = low.clone().negate();
  const point = new Vector3();
  for (const { center, positions } of geometries) {
    for (let i = 0; i < positions.length; i += 3) {
      point.fromArray(positions, i).add({ x: center[0], y: center[1], z: center[2] });
      low.min(point);
      high.max(point);
    }
  }
  const middle = low.clone().add(high).multiplyScalar(0.5);
  return { middle, radius: Math.max(0.5 * low.distanceTo(high), 1e-30) };
}

/** A texture of K x C lit functions, RGBA float32: what `lightFunctions` gives. */
export function litTexture(model) {
  const { functions: width, caps: height } = model;
  const texture = new DataTexture(new Float32Array(4 * width * height), width, height, RGBAFormat, FloatType);
  texture.minFilter = texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

/**
 * Build what is drawn of a model.
 *
 * @param {object} model - Of the payload.
 * @param {object} geometry - Of the payload.
 * @param {Texture[]} textures - As of `decodeTextures`.
 * @returns {LitModel}
 */
export function buildModel(model, geometry, textures) {
  const uniforms = { white: { value: null }, lamps: { value: 1 } };
  const shape = buildGeometry(model, geometry);
  const materials = [];
  // With a texture anywhere Python multiplies reflectance where it is seen everywhere.
  const perPixel = geometry.uv !== null && geometry.surfaces.some(({ texture }) => texture !== null);
  for (const surface of geometry.surfaces) {
    shape.addGroup(3 * surface.firstFace, 3 * surface.faceCount, materials.length);
    const image = surface.texture === null ? null : textures[surface.texture];
    materials.push(surfaceMaterial(model, geometry, { perPixel, image, isBack: surface.back, uniforms }));
  }
  const mesh = new Mesh(shape, materials);
  mesh.frustumCulled = false;
  mesh.position.fromArray(geometry.center);
  const group = new Group();
  group.add(mesh);
  return { group, uniforms, radiance: new ReceiverRadiance(model) };
}

function buildGeometry(model, geometry) {
  const shape = new BufferGeometry();
  shape.setAttribute("position", new BufferAttribute(geometry.positions, 3));
  shape.setIndex(new BufferAttribute(geometry.faces, 1));
  if (geometry.reflectance) shape.setAttribute("reflectance", new BufferAttribute(geometry.reflectance, 3, true));
  if (geometry.uv) shape.setAttribute("uv", new BufferAttribute(geometry.uv, 2));
  if (model.fixed) shape.setAttribute("fixedRadiance", new BufferAttribute(model.fixed, 3));
  shape.boundingSphere = new Sphere(new Vector3(), Infinity); // never asked for: three would go through all vertices
  return shape;
}

function surfaceMaterial(model, geometry, { perPixel, image, isBack, uniforms }) {
  const kind = {
    perPixel,
    hasTexture: image !== null,
    hasReflectance: geometry.reflectance !== null,
    hasFixed: model.fixed !== null,
  };
  const material = new RawShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: transferVertex(kind),
    fragmentShader: transferFragment(kind),
    side: isBack ? FrontSide : DoubleSide,
    blending: NoBlending,
    uniforms: image === null ? uniforms : { ...uniforms, image: { value: image } },
  });
  if (isBack) {
    // At the same places as their fronts, which hide them but for this step of the depth buffer.
    material.polygonOffset = true;
    material.polygonOffsetUnits = -2;
  }
  return material;
}

/**
 * Decode images, filtered between texels as Python's `texture_lookup` does: linearly, without smaller copies.
 *
 * @param {{bytes: Uint8Array, mime: string, wrap: string[]}[]} textures
 * @returns {Promise<Texture[]>}
 */
export async function decodeTextures(textures) {
  return Promise.all(textures.map(async ({ bytes, mime, wrap }) => {
    const image = await createImageBitmap(new Blob([bytes], { type: mime }), {
      colorSpaceConversion: "none", premultiplyAlpha: "none", imageOrientation: "from-image",
    });
    const texture = new Texture(image);
    texture.colorSpace = SRGBColorSpace;
    texture.flipY = false; // v goes down
    texture.generateMipmaps = false;
    texture.minFilter = texture.magFilter = LinearFilter;
    [texture.wrapS, texture.wrapT] = wrap.map((way) => WRAPS[way]);
    texture.needsUpdate = true;
    return texture;
  }));
}
