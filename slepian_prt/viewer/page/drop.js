/** Maps from the reader's own disk: dropped on the page, or chosen. */

import { lightOfFile } from "#lights";

/**
 * @param {import("#viewer").Viewer} viewer
 * @param {(light: object) => void} add - Puts the light on the list.
 * @param {(text: string) => void} report - One sentence where a file is no map.
 */
export function bindDrop(viewer, add, report) {
  const { payload, state, lights } = viewer;
  const [veil, input] = ["veil", "file"].map((id) => document.getElementById(id));
  const open = async (file) => {
    try {
      const { light, notes } = await lightOfFile(file, payload);
      light.name = freeName(light.name, lights);
      lights.push(light);
      add(light);
      for (const note of notes) report(`${note}.`);
      state.set({ light: lights.length - 1, turn: 0, tilt: 0 });
    } catch (error) {
      report(sentence(error.message));
    }
  };
  const holdsFiles = (event) => event.dataTransfer?.types.includes("Files");
  addEventListener("dragover", (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    event.dataTransfer.dropEffect = "copy";
    veil.hidden = false;
  });
  addEventListener("dragleave", (event) => { if (event.relatedTarget === null) veil.hidden = true; });
  addEventListener("drop", (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    veil.hidden = true;
    const [file] = event.dataTransfer.files;
    if (file) open(file);
  });
  input.addEventListener("change", () => {
    const [file] = input.files;
    input.value = "";
    if (file) open(file);
  });
  return { open, ask: () => input.click() };
}

/** A name that no other light has, as links go by names. */
function freeName(name, lights) {
  const taken = new Set(lights.map((light) => light.name));
  let free = name;
  for (let number = 2; taken.has(free); ++number) free = `${name} (${number})`;
  return free;
}

const sentence = (text) => (/[.!?]$/.test(text) ? text : `${text}.`);
