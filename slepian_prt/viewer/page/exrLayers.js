// Which of the images in an OpenEXR file is the light: the choice of Python's lighting/formats/exr_layers.py.

import { MapError } from "#mapChecks";

const words = text => new Set(text.split(/\s+/));

// What renderers and compositors call the picture itself.
const BEAUTY = words("beauty c ci color colour combined composite default final hdr hdri master radiance rgb rgba");

// Words of names that are not the whole light: its parts, and what is no light.
const OTHER = words(`albedo alpha ao aov base basecolor bump coat clearcoat coverage debug denoising depth diffuse diff
  direct displacement emission emissive emit flow fog fresnel fuzz gi gloss glossy heat id ids index indirect material
  mask masks matte mattes metallic metalness mist motion n noise noisy normal normals object objects occlusion opacity
  p pos position positions pref reflection reflections refraction refractions roughness samples scatter scattering
  selfillum shadow shadows sheen spec specular ss sss st subsurface thickness trans transmission transmissive transmit
  uv uvs variance vec vector vectors velocity volume z zdepth`);

// Words that tell nothing.
const NEUTRAL = words("layer left pass view");

const COMPONENTS = { r: "R", red: "R", g: "G", green: "G", b: "B", blue: "B" };

/**
 * The image that is the light: red, green and blue (or luminance, where nothing has colours) of one layer of one part,
 * of floating point and not deep. Of several, those with a word for something else in their names and those of the
 * right eye come last; one that is called beauty, rgba, combined or the like, or nothing at all, comes first.
 *
 * @param {object[]} parts Of `readHeaders`.
 * @returns {{part: number, label: string, channels: object[], notes: string[]}}
 * @throws {MapError} No image, or none that is the light rather than another.
 */
export function chooseLayer(parts) {
  const found = parts.flatMap((part, number) => layersOf(part, number, parts.length > 1));
  const coloured = found.filter(layer => layer.channels.length === 3);
  const images = coloured.length ? coloured : found;
  if (!images.length) throw nothingIn(parts);
  images.sort((a, b) => compareRanks(rankOf(b), rankOf(a)));
  let best = images.filter(layer => compareRanks(rankOf(layer), rankOf(images[0])) === 0);
  if (new Set(best.map(layer => layer.part)).size === 1 && !best[0].name) best = best.slice(0, 1);
  const others = images.filter(layer => layer.otherView === images[0].otherView);
  if (best.length > 1 || (isOther(images[0]) && others.length > 1)) {
    const listed = images.map(layer => layer.label).join(", ");
    throw new MapError(`holds several images, and their names do not tell which is the light: ${listed}; keep the `
      + "one that is, or name it beauty");
  }
  const [chosen] = best;
  if (chosen.channels.some(({ sampling }) => sampling[0] !== 1 || sampling[1] !== 1)) {
    throw new MapError(`its colours (${chosen.label}) are subsampled; write them at every texel`);
  }
  const left = images.filter(layer => layer !== chosen).map(layer => layer.label).join(", ");
  const notes = [];
  if (left) notes.push(`holds several images; the light is ${chosen.label}, not ${left}`);
  else if (isOther(chosen)) notes.push(`holds no image but ${chosen.label}, which is taken as the light`);
  return { ...chosen, notes };
}

/** The images of a part, those without a layer first. */
function layersOf(part, number, several) {
  if (part.deep) return [];
  const groups = new Map();
  for (const channel of part.channels) {
    const dot = channel.name.lastIndexOf("."), layer = channel.name.slice(0, Math.max(dot, 0));
    const last = channel.name.slice(dot + 1), component = COMPONENTS[last.toLowerCase()] ?? last;
    if (!groups.has(layer)) groups.set(layer, new Map());
    if (!groups.get(layer).has(component)) groups.get(layer).set(component, channel);
  }
  const found = [];
  for (const [layer, group] of [...groups].sort(([a], [b]) => (a < b ? -1 : 1))) {
    let channels;
    const has = component => group.has(component);
    if (["R", "G", "B"].every(has)) channels = ["R", "G", "B"].map(component => group.get(component));
    else if (has("Y") && !["X", "Z", "RY", "BY"].some(has)) channels = [group.get("Y")];
    else continue;
    if (channels.some(channel => channel.kind === "uint")) continue; // numbers of objects, not colours
    let label = layer ? `layer ${layer}` : several ? "" : channels.map(({ name }) => name).join(", ");
    if (several) label = `part ${number} '${part.name}'${label ? ` ${label}` : ""}`;
    // The name of the only part is that of the file.
    const named = wordsOf(several ? `${part.name} ${layer}` : layer);
    const views = (part.views.length ? part.views : ["left", "right"]).map(view => view.toLowerCase());
    const first = layer.split(".")[0].toLowerCase();
    const view = part.view.toLowerCase() || (views.includes(first) ? first : "");
    const otherView = views.slice(1).includes(view) || named.includes("right");
    found.push({ part: number, name: layer, label, channels, words: named, otherView });
  }
  return found;
}

/** The words of a name in any style, in small letters: ViewLayer.Combined, shadow_matte, rgba2. */
function wordsOf(name) {
  const found = name.match(/[A-Z]+(?![a-z])|[A-Z]?[a-z]+/g) ?? [];
  return found.map(word => word.toLowerCase()).filter(word => !NEUTRAL.has(word));
}

function isOther(layer) {
  return layer.words.some(word => OTHER.has(word) || word.startsWith("crypto"));
}

/** Higher is better: whole light before parts of it, the default view before others, names of a picture first. */
function rankOf(layer) {
  const known = layer.words.filter(word => BEAUTY.has(word)).length;
  return [Number(!isOther(layer)), Number(!layer.otherView), known === layer.words.length ? 2 : known ? 1 : 0];
}

function compareRanks(a, b) {
  return a.map((value, i) => value - b[i]).find(difference => difference !== 0) ?? 0;
}

/** Why there is no image. */
function nothingIn(parts) {
  if (parts.some(part => part.deep)) {
    return new MapError("holds deep data, several samples at each texel; flatten it and write it again");
  }
  const names = parts.flatMap(part => part.channels.map(channel => channel.name));
  if (names.some(name => ["RY", "BY"].includes(name.split(".").at(-1)))) {
    return new MapError("its colours are luminance and subsampled chroma (Y, RY, BY); write it again with R, G and B");
  }
  const listed = names.length ? names.slice(0, 20).join(", ") + (names.length > 20 ? ", …" : "") : "none";
  return new MapError(`has the channels ${listed}, not R, G and B of half or float; write its colours as these`);
}
