/** What is drawn: the models of a file seen by a camera, or the pixels of a captured film. */

import { DataTexture, FloatType, NearestFilter, RGBAFormat, Scene } from "three-kit";
import { aimBackdrop, backdropMaterial } from "#backdrop";
import { frameOf, project } from "#camera";
import { buildCaps } from "#caps";
import { capColours } from "#colours";
import { filmBackdropMaterial, filmMaterial } from "#film";
import { ballAround, buildModel } from "#model";

function colourTexture(count) {
  const texture = new DataTexture(capColours(count), count, 1, RGBAFormat, FloatType);
  texture.minFilter = texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

/**
 * Models before a camera.
 *
 * `show` chooses what `draw` draws: the number of a model with a texture of lit functions, or its caps.
 */
export class ModelStage {
  constructor(payload, textures) {
    this._payload = payload;
    this.extent = { ...ballAround(payload.geometries), near: payload.camera.near };
    this.antialias = payload.antialias;
    this.backdrop = backdropMaterial();
    this._scene = new Scene();
    this._models = payload.models.map((model) => buildModel(model, payload.geometries[model.geometry], textures));
    this._caps = [];
  }

  /** Pixels of a picture for a canvas of so many. */
  size(canvas) {
    return canvas;
  }

  /**
   * @param {import("#passes").Passes} passes
   * @param {{model: number, lit?: DataTexture, lamps?: number}} what - Without `lit` its caps.
   */
  show(passes, { model, lit, lamps = 1 }) {
    this._scene.clear();
    if (lit === undefined) {
      this._scene.add(this._capsOf(model));
      return;
    }
    const { group, uniforms, radiance } = this._models[model];
    uniforms.white.value = radiance.under(passes, lit);
    uniforms.lamps.value = lamps;
    this._scene.add(group);
  }

  _capsOf(number) {
    const model = this._payload.models[number];
    this._caps[number] ??= buildCaps(model, this._payload.geometries[model.geometry], colourTexture(model.caps));
    return this._caps[number];
  }

  /** Draw what is shown into a target that is cleared and set; `shift` is of the picture under the pixels. */
  draw(passes, target, view, shift) {
    project(view.camera, frameOf(this._payload.camera, view.width, view.height, view.covered), this.extent, shift);
    passes.renderer.setRenderTarget(target);
    passes.renderer.render(this._scene, view.camera);
  }

  /** Draw the map behind. */
  drawBackdrop(passes, target, view, looks) {
    const frame = frameOf(this._payload.camera, view.width, view.height, view.covered);
    aimBackdrop(this.backdrop.uniforms, view.camera, frame, [view.width, view.height]);
    this.backdrop.uniforms.looks.value = looks;
    passes.draw(this.backdrop, target);
  }
}

/** The pixels of a film; those of a second file are lit instead of the first's where they are compared. */
export class FilmStage {
  constructor(payload) {
    const { film, models } = payload;
    this._film = film;
    this.antialias = [[0, 0, 1]];
    this.isScaled = true;
    this.hasDepth = false;
    this.backdrop = filmBackdropMaterial(film);
    this._materials = models.map((model) => filmMaterial(model, film, colourTexture(model.caps)));
    this._shown = this._materials[0];
  }

  size() {
    return [this._film.width, this._film.height];
  }

  show(passes, { model, lit, lamps = 1 }) {
    this._shown = this._materials[model];
    const { uniforms } = this._shown;
    uniforms.showsCaps.value = lit === undefined;
    if (lit !== undefined) uniforms.lit.value = lit;
    uniforms.lamps.value = lamps;
  }

  draw(passes, target) {
    passes.draw(this._shown, target);
  }

  drawBackdrop(passes, target, view, looks) {
    this.backdrop.uniforms.looks.value = looks;
    passes.draw(this.backdrop, target);
  }
}
