/** The lit functions of what is shown: of the file with as many functions as are chosen, and of what it stands beside. */

import { lightFunctions } from "#light";
import { litTexture } from "#model";

/** Modes in which two pictures are drawn. */
const DOUBLE = new Set(["split", "difference"]);

/** Lit functions (C K 4) with their textures, under the light they were given last. */
export class Sides {
  constructor({ models }) {
    this._models = models;
    const side = (model) => ({ model, texture: litTexture(models[model]), lit: null });
    this._left = side(0);
    this._all = side(0);
    this._other = side(models.length - 1);
  }

  /** Left and right: a side is the number of its model, `lit`, and the texture of that. */
  pair({ compare }) {
    return [this._left, compare === "model" && this._models.length > 1 ? this._other : this._all];
  }

  /** Light what the values show. */
  relight(values, coefficients) {
    const [left, right] = this.pair(values);
    light(left, this._models[0], coefficients, values.functions);
    if (DOUBLE.has(values.mode)) light(right, this._models[right.model], coefficients);
    else right.lit = null;
  }

  /** What the stage shows, for each sum its parts; see `Scenery`. */
  parts(values) {
    const { mode, lamps } = values;
    const [left, right] = this.pair(values).map(({ model, texture }) => ({ model, lit: texture, lamps }));
    if (mode === "caps") return [[{ model: 0 }]];
    if (mode === "split") return [[left, right]];
    return mode === "difference" ? [[left], [right]] : [[left]];
  }
}

function light(side, model, coefficients, functions) {
  side.lit = lightFunctions(model, coefficients, functions);
  side.texture.image.data.set(side.lit);
  side.texture.needsUpdate = true;
}
