/** How many pixels moving pictures have: fewer where a machine is slow, lest they lag behind the pointer. */

// Milliseconds between moving pictures: more are too slow, fewer leave room, and after many more nothing moved.
const SLOW = 34;
const QUICK = 20;
const STILL = 400;

// Part of the pixels across that there are at least, and what is tried first without a graphics card.
const COARSEST = 0.3;
const WITHOUT_CARD = 0.5;

/** A number that follows the time that pictures take. */
export class Detail {
  /** @param {WebGL2RenderingContext} context */
  constructor(context) {
    const info = context.getExtension("WEBGL_debug_renderer_info");
    const name = String(context.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : context.RENDERER));
    this.part = /swiftshader|llvmpipe|software|basic render/i.test(name) ? WITHOUT_CARD : 1;
    this._last = -Infinity;
  }

  /** Tell of a moving picture at a time in milliseconds. */
  step(now) {
    const passed = now - this._last;
    this._last = now;
    if (passed > STILL) return;
    if (passed > SLOW) this.part = Math.max(COARSEST, 0.8 * this.part);
    else if (passed < QUICK) this.part = Math.min(1, 1.1 * this.part);
  }
}
