/** The page's picture: what the state asks for, lit and drawn when something changes, and only then. */

import { Matrix3, OrbitControls, Vector3, WebGLRenderer } from "three-kit";
import { mapTexture } from "#backdrop";
import { openCamera, placeAsFile, standOf as cameraStand } from "#camera";
import { BEHIND, SHOWN } from "#composite";
import { Detail } from "#detail";
import { lightFunctions } from "#light";
import { coefficientsOf, mapOf, standOf } from "#lights";
import { litTexture } from "#model";
import { Painter } from "#painter";
import { Sides } from "#sides";
import { FilmStage, ModelStage } from "#stage";
import { exposureOf, linearColour } from "#tone";

// Time that looks at rest may take of each frame, so that the page stays at hand.
const BUDGET = 12;

// Distances of the camera that orbiting allows, in radii of the model.
const NEAREST = 0.02;
const FARTHEST = 60;

// Looks that an exposure is measured by.
const MEASURED = 8;

// What panels cover of a picture that is no window's.
const NOTHING = { left: 0, right: 0, top: 0, bottom: 0 };

/** Draws the state. */
export class Viewer {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {object} payload
   * @param {import("#state").State} state
   * @param {import("#lights").Light[]} lights
   * @param {object[]} textures - Of the model, decoded.
   */
  constructor(canvas, payload, state, lights, textures) {
    Object.assign(this, { canvas, payload, state, lights });
    this.renderer = new WebGLRenderer({ canvas, antialias: false, alpha: false, depth: false });
    this.renderer.autoClear = false;
    this.renderer.setClearColor(0, 0);
    this.stage = payload.film ? new FilmStage(payload) : new ModelStage(payload, textures);
    this.painter = new Painter(this.renderer, this.stage);
    this.width = Infinity; // of the window against ringing
    this.covered = NOTHING;
    this.colours = { plain: "#ffffff", light: 0.86, dark: 0.78 };
    this.largest = 0.1;
    this._sides = new Sides(payload);
    this._mapTextures = new Map();
    this._scales = new Map();
    this._detail = new Detail(this.renderer.getContext());
    this._needs = { light: true, view: true, present: true };
    this._listeners = [];
    this._openCamera();
    state.listen((names) => this._hear(names));
  }

  _openCamera() {
    const { payload, state } = this;
    if (payload.film) return;
    this.camera = openCamera(payload.camera, payload.up);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enabled = !payload.camera.locked;
    this.controls.minDistance = NEAREST * this.stage.extent.radius;
    this.controls.maxDistance = FARTHEST * this.stage.extent.radius;
    this.controls.zoomSpeed = 1.2;
    this._followState();
    this.controls.addEventListener("change", () => {
      if (this._isFollowing) return;
      state.set({ eye: this.camera.position.toArray(), target: this.controls.target.toArray() });
    });
  }

  /** Move the camera to where the state has it. */
  _followState() {
    if (!this.camera) return;
    const { eye, target } = this.state.values;
    this._isFollowing = true;
    const file = cameraStand(this.payload.camera, this.stage.extent.middle);
    this.controls.target.copy(target && !this.payload.camera.locked ? new Vector3(...target) : file.target);
    if (eye && !this.payload.camera.locked) {
      this.camera.position.fromArray(eye);
      this.controls.update();
    } else placeAsFile(this.camera, this.payload.camera); // exactly: OrbitControls would round it
    this._isFollowing = false;
  }

  _hear(names) {
    if (names.has("eye") || names.has("target")) this._followState();
    if (["light", "turn", "tilt", "functions", "window", "mode", "compare"].some((name) => names.has(name))) this._needs.light = true;
    this._needs.view ||= [...names].some((name) => name !== "exposure" && name !== "percent");
    this.redraw({});
  }

  /** Call a listener after each picture: `{isDone}`. */
  listen(listener) {
    this._listeners.push(listener);
  }

  /** Draw again when the browser is ready: `light` and `view` say what is another. */
  redraw({ light = false, view = false } = {}) {
    this._needs.light ||= light;
    this._needs.view ||= view || light;
    this._needs.present = true;
    this._request ??= requestAnimationFrame(() => this._frame());
  }

  /** The light that is chosen. */
  get light() {
    return this.lights[this.state.values.light] ?? this.lights[0];
  }

  /** Coefficients of it now. */
  get coefficients() {
    const { values } = this.state;
    return coefficientsOf(this.light, values, this.payload, values.window ? this.width : Infinity);
  }

  _relight() {
    this._sides.relight(this.state.values, this.coefficients);
    this._needs.light = false;
  }

  /** The sides as they are lit now: (C K 4) each, with their models of the payload. */
  get sides() {
    const pair = this._sides.pair(this.state.values);
    if (this._needs.light) this._relight();
    return pair.map(({ model, lit }) => ({ model: this.payload.models[model], lit }));
  }

  _scenery(view) {
    const { values } = this.state;
    const kind = { difference: SHOWN.difference, caps: SHOWN.colours }[values.mode] ?? SHOWN.picture;
    return { parts: this._sides.parts(values), split: values.split, kind, view, hasBackdrop: this._setBackdrop() };
  }

  /** Give the backdrop its map, if the state shows it and it is read; else ask for it. */
  _setBackdrop() {
    const { values } = this.state;
    const { light } = this;
    if (values.background !== "map" || !["picture", "split"].includes(values.mode)) return false;
    const texture = this._mapTextures.get(light);
    if (texture === undefined) {
      if (light.map || light.bytes) this._readMap(light);
      return false;
    }
    const { uniforms } = this.stage.backdrop;
    uniforms.map.value = texture;
    uniforms.toMap.value = new Matrix3().fromArray(standOf(light, values, this.payload.up)); // as columns: the inverse
    return true;
  }

  /** Give the canvas so many pixels. */
  _resize(size) {
    if (size[0] !== this.canvas.width || size[1] !== this.canvas.height) this.renderer.setSize(...size, false);
  }

  async _readMap(light) {
    if (this._reading?.has(light)) return;
    (this._reading ??= new Set()).add(light);
    // First the model: its picture need not wait for the map.
    await new Promise((resolve) => { setTimeout(resolve); });
    const map = await mapOf(light);
    this._mapTextures.set(light, mapTexture(map));
    this.redraw({ view: true });
  }

  /** What is drawn, at so many pixels. */
  _view([width, height]) {
    const ratio = width / Math.max(this.canvas.clientWidth, 1);
    const covered = Object.fromEntries(Object.entries(this.covered).map(([side, size]) => [side, size * ratio]));
    return { camera: this.camera, width, height, covered };
  }

  /** Factor that radiance is multiplied by: what suits the light at the file's camera, and stops. */
  get scale() {
    return this.scaleOfLight(this.light) * 2 ** this.state.values.exposure;
  }

  /** What exposes a light as it stands, seen by the file's camera, as Python's pictures are exposed. */
  scaleOfLight(light) {
    if (!this._scales.has(light)) this._scales.set(light, this._measuredScale(light));
    return this._scales.get(light);
  }

  _measuredScale(light) {
    const { payload, state } = this;
    if (light === this.lights[0] && payload.display.scale !== null) return payload.display.scale;
    const model = payload.models[0];
    const texture = litTexture(model);
    texture.image.data.set(lightFunctions(model, light.coefficients));
    const { width, height } = payload.camera ?? payload.film;
    const camera = payload.film ? null : openCamera(payload.camera, payload.up);
    const view = { camera, width, height };
    const parts = [[{ model: 0, lit: texture, lamps: state.values.lamps }]];
    const pixels = this.painter.measure({ parts, split: 1, view, hasBackdrop: false }, MEASURED);
    texture.dispose();
    this._needs.view = true;
    return exposureOf(pixels);
  }

  /** Stops that expose what is seen now as Python would expose such a picture. */
  measureStops() {
    if (this._needs.light) this._relight();
    const parts = this._sides.parts({ ...this.state.values, mode: "picture" });
    const scenery = { parts, split: 1, view: this._view(this.pixels), hasBackdrop: false };
    const scale = exposureOf(this.painter.measure(scenery, MEASURED));
    this.redraw({ view: true });
    return Math.log2(scale / this.scaleOfLight(this.light));
  }

  /** Uniforms of the last pass, for a canvas or a picture of its own. */
  _setComposite({ width, height, covered = NOTHING, behind }) {
    const { uniforms } = this.painter.composite;
    const { mode, background } = this.state.values;
    const isPlain = mode === "difference" || mode === "caps";
    const plain = isPlain || !background.startsWith("#") ? this.colours.plain : background;
    uniforms.scale.value = this.scale;
    uniforms.plain.value.fromArray(linearColour(plain));
    uniforms.surround.value.fromArray([1, 3, 5].map((at) => parseInt(this.colours.plain.slice(at, at + 2), 16) / 255));
    uniforms.light.value.setScalar(this.colours.light);
    uniforms.dark.value.setScalar(this.colours.dark);
    uniforms.square.value = Math.max(8, Math.round(width / 120));
    uniforms.behind.value = behind ?? this._behind();
    uniforms.largest.value = this.largest;
    uniforms.window.value.fromArray(this._window(width, height, covered));
  }

  _behind() {
    const { background } = this.state.values;
    if (background === "transparent") return BEHIND.checker;
    if (background !== "map") return BEHIND.plain;
    if (!this._setBackdrop()) return BEHIND.plain;
    return this.payload.film ? BEHIND.film : BEHIND.map;
  }

  /** Where the picture lies in the canvas, from the lower left, as parts of it. */
  _window(width, height, covered) {
    if (!this.payload.film) return [0, 0, 1, 1];
    const { left, right, top, bottom } = covered;
    const free = [width - left - right, height - top - bottom];
    const zoom = Math.min(free[0] / this.payload.film.width, free[1] / this.payload.film.height);
    const size = [this.payload.film.width * zoom, this.payload.film.height * zoom].map(Math.round);
    const corner = [left + (free[0] - size[0]) / 2, bottom + (free[1] - size[1]) / 2].map(Math.round);
    return [corner[0] / width, corner[1] / height, size[0] / width, size[1] / height];
  }

  _frame() {
    this._request = undefined;
    if (this.isLost || this.pixels === undefined) return;
    const begin = performance.now();
    const isNew = this._needs.light || this._needs.view;
    if (isNew) this._drawMoving(begin);
    else this._drawResting(begin);
    const isDone = !isNew && this.painter.done === this.painter.looks;
    if (isDone) this._resize(this.pixels);
    if (isNew || isDone || this._needs.present) {
      const size = [this.canvas.width, this.canvas.height];
      this._setComposite(this._view(size));
      this.painter.present();
    }
    this._needs.present = false;
    if (!isDone) this._request ??= requestAnimationFrame(() => this._frame());
    for (const listener of this._listeners) listener({ isNew, isDone });
  }

  _drawMoving(now) {
    if (this._needs.light) this._relight();
    void this.scale; // may measure, which paints
    this._detail.step(now);
    const size = this.pixels.map((pixels) => Math.max(2, Math.round(pixels * this._detail.part)));
    this._resize(size);
    this._needs.view = false;
    this._isResting = false;
    this.painter.restart(this._scenery(this._view(size)));
    this.painter.drawQuick(this._detail.part < 1);
  }

  /** Add looks while there is time; until they are complete the last picture stays. */
  _drawResting(begin) {
    if (!this._isResting) this.painter.restart(this._scenery(this._view(this.pixels)));
    this._isResting = true;
    while (this.painter.done < this.painter.looks) {
      this.painter.addLooks(1);
      if (performance.now() > begin + BUDGET) break;
    }
  }

  /**
   * A finished picture of the state at a size of its own, whatever the canvas is.
   *
   * @param {{width: number, height: number, camera?: import("three-kit").PerspectiveCamera}} size
   * @returns {Promise<ImageData>} Opacity is not multiplied.
   */
  async takePicture({ width, height }) {
    if (this.state.values.background === "map" && (this.light.bytes || this.light.map)) {
      const map = await mapOf(this.light);
      if (!this._mapTextures.has(this.light)) this._mapTextures.set(this.light, mapTexture(map));
    }
    if (this._needs.light) this._relight();
    void this.scale;
    const view = { camera: this.camera, width, height };
    this.painter.restart(this._scenery(view));
    this.painter.addLooks(this.painter.looks);
    const behind = this.state.values.background === "transparent" ? BEHIND.transparent : undefined;
    this._setComposite({ width, height, behind });
    const bytes = this.painter.readPicture(width, height);
    this.redraw({ view: true });
    return new ImageData(bytes, width, height);
  }
}
