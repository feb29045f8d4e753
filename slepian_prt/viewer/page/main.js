import { readPayload } from "#payload";

const begin = performance.now();
globalThis.payload = await readPayload(document.getElementById("payload").textContent);
document.body.append(`read in ${Math.round(performance.now() - begin)} ms`);
