/** The settings: what stands in the panel changes the state, and follows it. */

import { addLightChoice, fillLights } from "#lightChoices";

const find = (id) => document.getElementById(id);

const degrees = (value) => `${Math.round(value)}°`;
const signed = (value, digits) => `${value > 0 ? "+" : value < 0 ? "−" : ""}${Math.abs(value).toFixed(digits)}`;

/**
 * Tie the controls to the state.
 *
 * @param {import("#viewer").Viewer} viewer
 * @param {Record<string, () => void>} actions - Of the buttons, by their ids.
 * @returns {{addLight: (light: object) => void}}
 */
export function bindPanel(viewer, actions) {
  const { payload, state, lights } = viewer;
  const count = payload.models[0].functions;
  find("functions").max = count;
  bindRange(state, "turn", degrees);
  bindRange(state, "tilt", degrees);
  bindRange(state, "exposure", (value) => `${signed(value, 2)} EV`);
  bindRange(state, "functions", (value) => `${value} of ${count}`);
  bindRange(state, "lamps", (value) => `× ${value.toFixed(2)}`);
  find("lamps-row").hidden = !payload.models[0].fixed;
  bindSwitch(state, "window");
  bindRadios(state, "mode");
  bindBackground(viewer);
  bindChoices(state, "compare", comparisons(payload));
  find("compare-row").hidden = payload.models.length < 2;
  bindChoices(state, "percent", null, Number);
  fillLights(viewer);
  for (const [id, action] of Object.entries(actions)) find(id).addEventListener("click", action);
  bindFold(viewer);
  fillStatistics(payload);
  if (payload.film || payload.camera.locked) find("home").hidden = true;
  if (payload.film) find("drag-row").hidden = true;
  const follow = () => {
    const { mode } = state.values;
    find("percent-row").hidden = mode !== "difference";
  };
  state.listen(follow);
  follow();
  return { addLight: (light) => addLightChoice(viewer, light, lights.length - 1) };
}

function comparisons({ models }) {
  const [first, second] = models;
  const pairs = [["functions", "fewer functions and all"]];
  if (second) pairs.unshift(["model", `${first.label} and ${second.label}`]);
  return pairs;
}

function bindRange(state, name, text) {
  const input = find(name);
  const output = input.parentElement.querySelector("output");
  const show = () => {
    const value = state.values[name];
    input.value = value;
    output.textContent = text(value);
    input.setAttribute("aria-valuetext", text(value));
  };
  input.addEventListener("input", () => state.set({ [name]: +input.value }));
  state.listen((names) => { if (names.has(name)) show(); });
  show();
}

function bindSwitch(state, name) {
  const input = find(name);
  input.checked = state.values[name];
  input.addEventListener("change", () => state.set({ [name]: input.checked }));
  state.listen(() => { input.checked = state.values[name]; });
}

function bindRadios(state, name) {
  const inputs = [...find(name).querySelectorAll("input")];
  const show = () => { for (const input of inputs) input.checked = input.value === state.values[name]; };
  for (const input of inputs) input.addEventListener("change", () => state.set({ [name]: input.value }));
  state.listen(show);
  show();
}

function bindChoices(state, name, pairs, convert = String) {
  const select = find(name);
  for (const [value, text] of pairs ?? []) select.append(new Option(text, value));
  const show = () => { select.value = String(state.values[name]); };
  select.addEventListener("change", () => state.set({ [name]: convert(select.value) }));
  state.listen(show);
  show();
}

function bindBackground({ state, lights }) {
  const inputs = Object.fromEntries([...find("background").querySelectorAll("input")].map((one) => [one.value, one]));
  const colour = find("colour");
  let plain = state.values.background.startsWith("#") ? state.values.background : "#ffffff";
  const show = () => {
    const { background, light } = state.values;
    const isPlain = background.startsWith("#");
    if (isPlain) plain = background;
    inputs[isPlain ? "plain" : background].checked = true;
    inputs.map.disabled = !lights.some(({ bytes, map }) => bytes || map);
    find("colour-row").hidden = !isPlain;
    colour.value = plain;
    void light;
  };
  for (const [value, input] of Object.entries(inputs)) {
    input.addEventListener("change", () => state.set({ background: value === "plain" ? plain : value }));
  }
  colour.addEventListener("input", () => state.set({ background: colour.value }));
  state.listen(show);
  show();
}

/** Fold the panel away; the picture moves to the middle of what is free. */
function bindFold(viewer) {
  const [panel, button] = [find("panel"), find("fold")];
  const isPhone = matchMedia("(max-width: 640px)");
  const set = (isFolded) => {
    panel.classList.toggle("folded", isFolded);
    button.setAttribute("aria-expanded", String(!isFolded));
    cover(viewer);
  };
  button.addEventListener("click", () => set(!panel.classList.contains("folded")));
  set(isPhone.matches);
  isPhone.addEventListener("change", () => cover(viewer));
}

/** Tell the viewer what of the canvas the panel covers. */
export function cover(viewer) {
  const panel = find("panel");
  const box = panel.getBoundingClientRect();
  const isSheet = box.width > 0.9 * innerWidth;
  const isFolded = panel.classList.contains("folded");
  const covered = { left: 0, right: 0, top: 0, bottom: 0 };
  if (isSheet) covered.bottom = box.height;
  else if (!isFolded) covered.right = innerWidth - box.left;
  viewer.covered = covered;
  viewer.redraw({ view: true });
}

function fillStatistics({ statistics, notes, camera, film, generator }) {
  const place = find("statistics").querySelector("div");
  for (const [title, rows] of [...statistics, ["Page", [["Made by", generator]]]]) {
    const heading = document.createElement("h3");
    const list = document.createElement("dl");
    heading.textContent = title;
    for (const [label, text] of rows) {
      const [term, description] = ["dt", "dd"].map((tag) => document.createElement(tag));
      term.textContent = label;
      description.textContent = text;
      list.append(term, description);
    }
    place.append(heading, list);
  }
  const remarks = [...notes];
  if (camera?.locked) remarks.unshift("This is light toward the file's camera: it is drawn from there only.");
  if (film) remarks.unshift("This is a captured picture: drag on it to turn its light.");
  for (const text of remarks) {
    const item = document.createElement("li");
    item.textContent = text;
    find("notes").append(item);
  }
}
