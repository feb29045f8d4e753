/** Pictures: quick ones while something moves, and at rest many looks per pixel, as the film's filter weighs them. */

import { DataUtils, WebGLRenderTarget } from "three-kit";
import { compositeMaterial, SHOWN } from "#composite";
import { Passes, pictureMaterial, radianceTarget } from "#passes";
import { ADDING_FRAGMENT } from "#shaders";

// Looks in each direction per pixel of the map behind, at rest: as many as Python takes.
const LOOKS = 3;

/** The sum of frames, each with a weight. */
class Sum {
  constructor(isExact, isSmooth) {
    this.isExact = isExact && !isSmooth;
    // Float32 is not interpolated by all machines.
    this._targets = [0, 1].map(() => radianceTarget({ isExact: this.isExact, isSmooth }));
    this._material = pictureMaterial(ADDING_FRAGMENT, {
      sum: { value: null }, frame: { value: null }, weight: { value: 0 }, first: { value: true },
    });
    this.count = 0;
  }

  get target() {
    return this._targets[0];
  }

  setSize(width, height) {
    for (const target of this._targets) target.setSize(width, height);
  }

  add(passes, frame, weight) {
    const { uniforms } = this._material;
    uniforms.sum.value = this._targets[0].texture;
    uniforms.frame.value = frame;
    uniforms.weight.value = weight;
    uniforms.first.value = this.count === 0;
    passes.draw(this._material, this._targets[1]);
    this._targets.reverse();
    this.count += 1;
  }
}

/**
 * What is painted.
 *
 * @typedef {object} Scenery
 * @property {object[][]} parts - For each sum (two where a difference is shown) what `stage.show` takes, from the left;
 *     two parts share a picture at `split`.
 * @property {number} split - Where the second part begins, 0 to 1.
 * @property {boolean} hasBackdrop
 * @property {number} [kind] - Of `SHOWN`.
 * @property {object} view - What `stage.draw` takes: camera, width, height, covered.
 */

/** Draws scenery, and shows it. */
export class Painter {
  /**
   * @param {import("three-kit").WebGLRenderer} renderer
   * @param {import("#stage").ModelStage} stage
   */
  constructor(renderer, stage) {
    this.renderer = renderer;
    this.stage = stage;
    this.passes = new Passes(renderer);
    this.composite = compositeMaterial();
    // Half floats round a sum of 64 frames by a step of the screen: float32 where it can be drawn into.
    const { isExact } = this.passes;
    // Interpolated only where the canvas has other pixels than the picture: it takes long without a graphics card.
    const { hasDepth = true, isScaled: isSmooth = false } = stage;
    this._sums = [new Sum(isExact, isSmooth), new Sum(isExact, isSmooth)];
    this._frame = radianceTarget({ hasDepth, isSmooth });
    this._rough = [0, 1].map(() => radianceTarget({ hasDepth, isSmooth }));
    this._quick = [0, 1].map(() => radianceTarget({ hasDepth, isSmooth, samples: 4 }));
    this._backdrop = radianceTarget({ isSmooth });
  }

  /** Looks of a finished picture. */
  get looks() {
    return this.stage.antialias.length;
  }

  /** How many of them are in the sum. */
  get done() {
    return this._sums[0].count;
  }

  /** Begin anew: what is shown next is drawn once, with a few samples at edges. */
  restart(scenery) {
    this._scenery = scenery;
    const [width, height] = this.stage.size([scenery.view.width, scenery.view.height]);
    for (const sum of this._sums) sum.count = 0;
    this._size = [width, height];
  }

  /** Draw one quick picture; a rough one has jagged edges. */
  drawQuick(isRough = false) {
    const targets = isRough ? this._rough : this._quick;
    const { parts } = this._scenery;
    for (const [i, part] of parts.entries()) {
      targets[i].setSize(...this._size);
      this._drawParts(part, targets[i], [0, 0]);
    }
    this._drawBackdrop(1);
    this._use(parts.map((_, i) => targets[i].texture));
  }

  /** Add some looks; the picture that is used is that of the sums once they are complete. */
  addLooks(count) {
    const { parts } = this._scenery;
    const last = Math.min(this.done + count, this.looks);
    if (this.done === 0) for (const target of [...this._sums, this._frame]) target.setSize(...this._size);
    for (let look = this.done; look < last; ++look) {
      const [x, y, weight] = this.stage.antialias[look];
      for (const [i, part] of parts.entries()) {
        this._drawParts(part, this._frame, [x, y]);
        this._sums[i].add(this.passes, this._frame.texture, weight);
      }
    }
    if (this.done < this.looks) return;
    this._drawBackdrop(LOOKS);
    this._use(parts.map((_, i) => this._sums[i].target.texture));
  }

  _use(textures) {
    const { uniforms } = this.composite;
    uniforms.radiance.value = textures[0];
    uniforms.other.value = textures[1] ?? textures[0];
    uniforms.backdrop.value = this._backdrop.texture;
    uniforms.kind.value = this._scenery.kind ?? SHOWN.picture;
  }

  _drawParts(parts, target, shift) {
    const [width, height] = this._size;
    const middle = Math.round(width * this._scenery.split);
    target.scissorTest = false;
    this.renderer.setRenderTarget(target);
    this.renderer.clear();
    parts.forEach((part, i) => {
      target.scissorTest = parts.length > 1;
      if (i === 0) target.scissor.set(0, 0, parts.length > 1 ? middle : width, height);
      else target.scissor.set(middle, 0, width - middle, height);
      this.stage.show(this.passes, part);
      this.stage.draw(this.passes, target, this._scenery.view, shift);
    });
    target.scissorTest = false;
  }

  _drawBackdrop(looks) {
    if (!this._scenery.hasBackdrop) return;
    this._backdrop.setSize(...this._size);
    this.stage.drawBackdrop(this.passes, this._backdrop, this._scenery.view, looks);
  }

  /** Put the picture on the canvas, or into a target. */
  present(target = null) {
    this.passes.draw(this.composite, target);
  }

  /**
   * Linear radiance and coverage of some looks at scenery, 4 numbers for each pixel, from the lower left. What was
   * painted has to begin anew.
   */
  measure(scenery, looks = this.looks) {
    this.restart(scenery);
    this.addLooks(looks);
    const [width, height] = this._size;
    const { target, isExact } = this._sums[0];
    const pixels = isExact ? new Float32Array(4 * width * height) : new Uint16Array(4 * width * height);
    this.renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
    const weight = this.stage.antialias.slice(0, this.done).reduce((sum, look) => sum + look[2], 0);
    return Float32Array.from(pixels, (value) => (isExact ? value : DataUtils.fromHalfFloat(value)) / weight);
  }

  /** Bytes of the picture as it is shown, from the top, RGBA, opacity not multiplied. */
  readPicture(width, height) {
    const target = new WebGLRenderTarget(width, height, { depthBuffer: false });
    this.present(target);
    const bytes = new Uint8Array(4 * width * height);
    this.renderer.readRenderTargetPixels(target, 0, 0, width, height, bytes);
    target.dispose();
    const upright = new Uint8ClampedArray(bytes.length);
    for (let row = 0; row < height; ++row) {
      upright.set(bytes.subarray(4 * width * (height - 1 - row), 4 * width * (height - row)), 4 * width * row);
    }
    return upright;
  }
}
