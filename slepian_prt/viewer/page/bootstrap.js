// Starts the page: inflates its modules and runs #main; says in words why a browser cannot.
// What browsers without modules cannot even parse leaves the sentence that stands in the page from the beginning.
(function () {
  "use strict";
  const message = document.getElementById("message");

  function say(text) {
    message.textContent = text;
    message.hidden = false;
  }

  /** What the page needs and the browser has not, in words; empty if it has all. */
  function missing() {
    if (typeof DecompressionStream === "undefined") return "to unpack gzip by itself";
    if (!HTMLScriptElement.supports || !HTMLScriptElement.supports("importmap")) return "import maps";
    if (!document.createElement("canvas").getContext("webgl2")) return "WebGL 2, which may be turned off";
    return "";
  }

  /** The modules of the page, {name: source}. */
  async function inflateModules() {
    const base64 = document.getElementById("modules").textContent.trim();
    const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return JSON.parse(await new Response(stream).text());
  }

  async function start() {
    const imports = {};
    for (const [name, source] of Object.entries(await inflateModules())) {
      imports[name] = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
    }
    const map = document.createElement("script");
    map.type = "importmap";
    map.textContent = JSON.stringify({ imports });
    document.head.append(map);
    await import("#main");
  }

  const lacking = missing();
  if (lacking) {
    say(`This page needs ${lacking}. Open it in a current Firefox, Chrome, Edge or Safari.`);
    return;
  }
  say("Opening …");
  start().then(
    () => (message.hidden = true),
    (error) => say(`This page could not be opened: ${(error && error.message) || error}`),
  );
})();
