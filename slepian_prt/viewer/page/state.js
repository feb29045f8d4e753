/** What is chosen on the page, and its text in the address: a link shows what its sender saw. */

/**
 * Values as they are at first.
 *
 * @param {object} payload
 * @returns {object} By name: `light` (number of a light), `turn`, `tilt` (degrees), `exposure` (stops), `background`
 *   (map, transparent, or #rrggbb), `functions`, `mode` (picture, split, difference, caps), `compare` (functions,
 *   model), `split` (0 to 1), `window` (boolean), `lamps`, `percent` (largest difference on the scale, or 0 to choose),
 *   `eye`, `target` (3 numbers each; null for the file's camera).
 */
export function firstValues(payload) {
  return {
    light: 0,
    turn: payload.display.turn,
    tilt: 0,
    exposure: payload.display.exposure,
    background: payload.display.background,
    functions: payload.models[0].functions,
    mode: "picture",
    compare: payload.models.length > 1 ? "model" : "functions",
    split: 0.5,
    window: false,
    lamps: 1,
    percent: 0,
    eye: null,
    target: null,
  };
}

/** Values, and who wants to know when they change. */
export class State {
  constructor(values) {
    this.values = { ...values };
    this.first = { ...values };
    this._listeners = [];
  }

  /** Change some; listeners get the names of those that are different now. */
  set(changes) {
    const changed = Object.keys(changes).filter((name) => !same(this.values[name], changes[name]));
    if (changed.length === 0) return;
    Object.assign(this.values, changes);
    const names = new Set(changed);
    for (const listener of this._listeners) listener(names, this.values);
  }

  listen(listener) {
    this._listeners.push(listener);
  }
}

function same(one, other) {
  return one === other || (Array.isArray(one) && Array.isArray(other) && one.every((x, i) => x === other[i]));
}

// Of camera positions: digits that are told.
const DIGITS = 6;

const number = (low, high) => ({
  write: (value) => String(Math.round(value * 1000) / 1000),
  read: (text) => (text.trim() !== "" && Number.isFinite(+text) ? Math.min(high, Math.max(low, +text)) : undefined),
});
const choice = (...values) => ({ write: String, read: (text) => (values.includes(text) ? text : undefined) });
const point = {
  write: (value) => value.map((x) => String(+x.toPrecision(DIGITS))).join(","),
  read: (text) => {
    const value = text.split(",").map(Number);
    return value.length === 3 && value.every(Number.isFinite) ? value : undefined;
  },
};

/** How each value is written; lights go by their names. */
function codecs(lights, functions) {
  return {
    light: {
      write: (value) => lights[value].name,
      read: (text) => {
        const found = lights.findIndex(({ name }) => name === text);
        return found < 0 ? undefined : found;
      },
    },
    turn: number(-180, 180),
    tilt: number(-90, 90),
    exposure: number(-20, 20),
    background: {
      write: String,
      read: (text) => (/^(map|transparent|#[0-9a-f]{6})$/.test(text) ? text : undefined),
    },
    functions: {
      write: String,
      read: (text) => (/^\d+$/.test(text) ? Math.min(functions, Math.max(1, +text)) : undefined),
    },
    mode: choice("picture", "split", "difference", "caps"),
    compare: choice("functions", "model"),
    split: number(0, 1),
    window: { write: (value) => (value ? "on" : "off"), read: (text) => text === "on" },
    lamps: number(0, 4),
    percent: number(0, 100),
    eye: point,
    target: point,
  };
}

/** The text of what is not as it was at first. */
export function hashOf(state, lights) {
  const all = codecs(lights, state.first.functions);
  const parts = Object.entries(all)
    .filter(([name]) => state.values[name] !== null && !same(state.values[name], state.first[name]))
    .map(([name, { write }]) => `${name}=${encodeURIComponent(write(state.values[name]))}`);
  return parts.join("&");
}

/**
 * What a text says; the rest is as at first, and what is no value is left out.
 *
 * @returns {{values: object, unknown: string[]}} `unknown` are names of lights that are not here.
 */
export function valuesOf(hash, state, lights) {
  const all = codecs(lights, state.first.functions);
  const values = { ...state.first };
  const unknown = [];
  for (const [name, text] of new URLSearchParams(hash.replace(/^#/, ""))) {
    const value = all[name]?.read(text);
    if (value !== undefined) values[name] = value;
    else if (name === "light") unknown.push(text);
  }
  return { values, unknown };
}

// Browsers refuse many changes of the address in a short time.
const PAUSE = 300;

/** Keep the address as the state is, and the state as an address that is entered. */
export function bindHash(state, lights, report) {
  let timer = 0;
  let written = null;
  const write = () => {
    written = hashOf(state, lights);
    history.replaceState(null, "", written ? `#${written}` : location.pathname + location.search);
  };
  const read = () => {
    const hash = location.hash.replace(/^#/, "");
    if (hash === written) return;
    const { values, unknown } = valuesOf(hash, state, lights);
    state.set(values);
    for (const name of unknown) report(`The link is of the light “${name}”, which this page does not hold.`);
  };
  if (location.hash.length > 1) read();
  state.listen(() => {
    clearTimeout(timer);
    timer = setTimeout(write, PAUSE);
  });
  addEventListener("hashchange", read);
}
