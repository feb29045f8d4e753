/** A captured picture: its pixels are receivers, lit from the run-time format like the vertices of a model. */

import { DataTexture, FloatType, NearestFilter, RGBAFormat } from "three-kit";
import { LOOK_UP, mapUniforms } from "#backdrop";
import { pictureMaterial } from "#passes";
import { radianceSum, wordTexture } from "#receivers";

function dataTexture(data, width, height, format, type) {
  const texture = new DataTexture(data, width, height, format, type);
  texture.minFilter = texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

function filmFragment(count, hasFixed) {
  return `
precision highp float;
precision highp int;
in vec2 at;
uniform sampler2D known;
uniform sampler2D colours;
uniform bool showsCaps;
uniform float lamps;
uniform int rows;
out vec4 pixel;
${radianceSum(count)}
void main() {
  int x = int(gl_FragCoord.x);
  int y = rows - 1 - int(gl_FragCoord.y);
  readWords(ivec2(x, y), rows);
  vec4 here = texelFetch(known, ivec2(x, y), 0);
  vec3 light = radianceOfWords()${hasFixed ? " + lamps * here.rgb" : ""};
  pixel = showsCaps ? texelFetch(colours, ivec2(capOfWords(), 0), 0) * here.a : vec4(light, here.a);
}
`;
}

/** A material that draws the picture of a film. */
export function filmMaterial(model, film, colours) {
  const { width, height, coverage } = film;
  const known = new Float32Array(4 * width * height);
  for (let i = 0; i < width * height; ++i) {
    if (model.fixed) known.set(model.fixed.subarray(3 * i, 3 * i + 3), 4 * i);
    known[4 * i + 3] = coverage[i];
  }
  return pictureMaterial(filmFragment(model.functions, model.fixed !== null), {
    bytes: { value: wordTexture(model, width).texture },
    known: { value: dataTexture(known, width, height, RGBAFormat, FloatType) },
    colours: { value: colours },
    showsCaps: { value: false },
    lit: { value: null },
    lamps: { value: 1 },
    rows: { value: height },
  });
}

// What the pixels show of the map: seen through points of the aperture, in directions that are interpolated on a grid,
// and coloured by what is before it. film_pictures.py does the same.
const FILM_BACKDROP = `
precision highp float;
precision highp int;
uniform sampler2D background;
uniform sampler2D directions;
uniform ivec2 size;
uniform ivec3 grid;
uniform int looks;
out vec4 seen;
${LOOK_UP}

vec3 node(ivec2 place, int look) {
  return texelFetch(directions, ivec2(place.x, place.y + look * grid.y), 0).xyz;
}

vec3 direction(vec2 pixel, int look) {
  vec2 place = pixel / vec2(size) * vec2(grid.xy - 1);
  ivec2 low = clamp(ivec2(floor(place)), ivec2(0), max(grid.xy - 2, 0));
  ivec2 high = min(low + 1, grid.xy - 1);
  vec2 part = place - vec2(low);
  vec3 upper = mix(node(low, look), node(ivec2(high.x, low.y), look), part.x);
  vec3 lower = mix(node(ivec2(low.x, high.y), look), node(high, look), part.x);
  return mix(upper, lower, part.y);
}

void main() {
  vec2 middle = vec2(gl_FragCoord.x, float(size.y) - gl_FragCoord.y);
  vec3 total = vec3(0.0);
  for (int look = 0; look < grid.z; ++look) {
    for (int i = 0; i < looks * looks; ++i) {
      vec2 shift = (vec2(i % looks, i / looks) + 0.5) / float(looks) - 0.5;
      total += lookUp(direction(middle + shift, look));
    }
  }
  vec4 part = texelFetch(background, ivec2(int(gl_FragCoord.x), size.y - 1 - int(gl_FragCoord.y)), 0);
  seen = vec4(part.rgb * total / float(grid.z * looks * looks), 1.0);
}
`;

/** A material that draws the map behind a film. */
export function filmBackdropMaterial(film) {
  const { width, height, background } = film;
  const { looks, rows, columns, values } = film.directions;
  return pictureMaterial(FILM_BACKDROP, {
    ...mapUniforms(),
    background: { value: dataTexture(withFourth(background), width, height, RGBAFormat, FloatType) },
    directions: { value: dataTexture(withFourth(values), columns, rows * looks, RGBAFormat, FloatType) },
    size: { value: [width, height] },
    grid: { value: [columns, rows, looks] },
    looks: { value: 1 },
  });
}

function withFourth(triples) {
  const values = new Float32Array((4 * triples.length) / 3);
  for (let i = 0, j = 0; i < triples.length; i += 3, j += 4) values.set(triples.subarray(i, i + 3), j);
  return values;
}
