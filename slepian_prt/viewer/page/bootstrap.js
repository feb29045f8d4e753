// Starts the page: inflates its modules and runs #main; says why in words where a browser cannot.
// A classic script: browsers that know no modules run it too, and get their sentence.
(function () {
  "use strict";
  var message = document.getElementById("message");

  function say(text) {
    message.textContent = text;
    message.hidden = false;
  }

  function missing() {
    if (!("noModule" in HTMLScriptElement.prototype)) return "JavaScript modules";
    if (typeof DecompressionStream === "undefined") return "DecompressionStream";
    if (!HTMLScriptElement.supports || !HTMLScriptElement.supports("importmap")) return "import maps";
    if (!document.createElement("canvas").getContext("webgl2")) return "WebGL 2";
    return "";
  }

  var lacking = missing();
  if (lacking) {
    say(
      "This page needs " + lacking + ", which this browser does not have" +
        (lacking === "WebGL 2" ? " or has turned off" : "") +
        ". Open it in a current Firefox, Chrome, Edge or Safari.",
    );
    return;
  }

  async function start() {
    var base64 = document.getElementById("modules").textContent.trim();
    var packed = await (await fetchless(base64)).text();
    var sources = JSON.parse(packed);
    var imports = {};
    Object.keys(sources).forEach(function (name) {
      imports[name] = URL.createObjectURL(new Blob([sources[name]], { type: "text/javascript" }));
    });
    var map = document.createElement("script");
    map.type = "importmap";
    map.textContent = JSON.stringify({ imports: imports });
    document.head.append(map);
    await import("#main");
  }

  function fetchless(base64) {
    var bytes = Uint8Array.from(atob(base64), function (letter) {
      return letter.charCodeAt(0);
    });
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")));
  }

  start().catch(function (error) {
    say("The page could not be started: " + (error && error.message ? error.message : error));
  });
})();
