/** Who is in which cap: vertices in the colour of theirs, borders between caps, edges of faces. */

import { BufferAttribute, BufferGeometry, DoubleSide, GLSL3, Mesh, NoBlending, RawShaderMaterial } from "three-kit";

const VERTEX = `
precision highp float;
precision highp int;
uniform mat4 modelViewMatrix;
uniform mat4 projectionMatrix;
in vec3 position;
in uvec4 caps;
flat out uvec3 capsOfFace;
out vec3 corner;
out vec3 place;
void main() {
  capsOfFace = caps.xyz;
  corner = vec3(caps.w == 0u, caps.w == 1u, caps.w == 2u);
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  place = seen.xyz;
  gl_Position = projectionMatrix * seen;
}
`;

// A place belongs to the cap of the nearest corner of its face; borders and edges are as many pixels wide everywhere.
const FRAGMENT = `
precision highp float;
precision highp int;
uniform sampler2D colours;
uniform float thickness;
flat in uvec3 capsOfFace;
in vec3 corner;
in vec3 place;
out vec4 pixel;

float line(float distance, float width) {
  return 1.0 - smoothstep(width - 0.5, width + 0.5, distance / max(fwidth(distance), 1e-7));
}

void main() {
  if (!gl_FrontFacing) {
    pixel = vec4(0.0);
    return;
  }
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  int nearest = corner.x >= corner.y ? (corner.x >= corner.z ? 0 : 2) : (corner.y >= corner.z ? 1 : 2);
  vec3 colour = texelFetch(colours, ivec2(int(capsOfFace[nearest]), 0), 0).rgb;
  colour *= 0.35 + 0.65 * abs(dot(normal, normalize(place)));
  float edge = max(max(line(corner.x, 0.5), line(corner.y, 0.5)), line(corner.z, 0.5));
  vec3 apart = abs(corner - corner.yzx);
  vec3 differ = vec3(notEqual(capsOfFace, capsOfFace.yzx));
  vec3 between = step(corner.zxy, min(corner, corner.yzx));
  float border = 0.0;
  border = max(border, differ.x * between.x * line(apart.x, thickness));
  border = max(border, differ.y * between.y * line(apart.y, thickness));
  border = max(border, differ.z * between.z * line(apart.z, thickness));
  // Edges fade where faces are smaller than a few pixels.
  float fine = max(max(fwidth(corner.x), fwidth(corner.y)), fwidth(corner.z));
  colour *= 1.0 - 0.45 * edge * clamp(1.2 - 4.0 * fine, 0.0, 1.0);
  pixel = vec4(mix(colour, vec3(0.02), border), 1.0);
}
`;

/**
 * The mesh of caps of a model: faces by themselves, each vertex with the three caps and which corner it is.
 *
 * @param {object} model - Of the payload.
 * @param {object} geometry - Of the payload.
 * @param {import("three-kit").DataTexture} colours - C x 1, linear.
 * @returns {Mesh}
 */
export function buildCaps(model, geometry, colours) {
  const { faces, positions, center } = geometry;
  const corners = new Float32Array(3 * faces.length);
  const caps = new Uint32Array(4 * faces.length);
  const capOf = (vertex) => model.bytes[(vertex + 1) * model.functions - 1];
  for (let i = 0; i < faces.length; ++i) {
    const face = i - (i % 3);
    for (let axis = 0; axis < 3; ++axis) {
      corners[3 * i + axis] = positions[3 * faces[i] + axis];
      caps[4 * i + axis] = capOf(faces[face + axis]);
    }
    caps[4 * i + 3] = i % 3;
  }
  const shape = new BufferGeometry();
  shape.setAttribute("position", new BufferAttribute(corners, 3));
  shape.setAttribute("caps", new BufferAttribute(caps, 4));
  const material = new RawShaderMaterial({
    glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: DoubleSide, blending: NoBlending,
    uniforms: { colours: { value: colours }, thickness: { value: 1.2 } },
  });
  const mesh = new Mesh(shape, material);
  mesh.frustumCulled = false;
  mesh.position.fromArray(center);
  return mesh;
}
