/** Passes over a whole picture, and the targets that they are drawn into. */

import {
  BufferAttribute, BufferGeometry, Camera, FloatType, GLSL3, HalfFloatType, LinearFilter, Mesh, NearestFilter,
  NoBlending, RawShaderMaterial, RGBAFormat, Scene, WebGLRenderTarget,
} from "three-kit";
import { PICTURE_VERTEX } from "#shaders";

/** A material that is drawn over a whole picture. */
export function pictureMaterial(fragmentShader, uniforms) {
  return new RawShaderMaterial({
    glslVersion: GLSL3, vertexShader: PICTURE_VERTEX, fragmentShader, uniforms,
    blending: NoBlending, depthTest: false, depthWrite: false,
  });
}

/** Draws materials over whole targets. */
export class Passes {
  /** @param {import("three-kit").WebGLRenderer} renderer */
  constructor(renderer) {
    this.renderer = renderer;
    // Whether float32 can be drawn into.
    this.isExact = renderer.extensions.has("EXT_color_buffer_float");
    const triangle = new BufferGeometry();
    triangle.setAttribute("position", new BufferAttribute(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]), 3));
    this._mesh = new Mesh(triangle);
    this._mesh.frustumCulled = false;
    this._scene = new Scene();
    this._scene.matrixWorldAutoUpdate = false;
    this._scene.add(this._mesh);
    this._camera = new Camera();
  }

  /** Draw a material into a target, or to the canvas where that is null. */
  draw(material, target) {
    this._mesh.material = material;
    this.renderer.setRenderTarget(target);
    this.renderer.render(this._scene, this._camera);
  }
}

/**
 * A target of linear radiance and coverage.
 *
 * @param {object} kind
 * @param {boolean} [kind.isExact] - In float32 rather than float16.
 * @param {number} [kind.samples] - Of each pixel.
 * @param {boolean} [kind.hasDepth]
 * @param {boolean} [kind.isSmooth] - Whether it is interpolated where it is looked up.
 */
export function radianceTarget({ isExact = false, samples = 0, hasDepth = false, isSmooth = true } = {}) {
  const filter = isSmooth ? LinearFilter : NearestFilter;
  return new WebGLRenderTarget(1, 1, {
    format: RGBAFormat, type: isExact ? FloatType : HalfFloatType, samples, depthBuffer: hasDepth, generateMipmaps: false,
    minFilter: filter, magFilter: filter, stencilBuffer: false,
  });
}
