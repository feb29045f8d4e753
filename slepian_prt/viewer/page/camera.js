/** Where a picture is taken from: Mitsuba's perspective camera, and how it fits into a window of another shape. */

import { Matrix4, PerspectiveCamera, Vector3 } from "three-kit";

// Of the file's camera, in sines of angles: more roll than this is kept while one orbits.
const ROLLED = 1e-4;

// Of what is seen, in radii: clipping planes leave so much room.
const ROOM = 1.02;

// Part of the farthest distance that is drawn at least, lest the depth buffer loses all precision.
const NEAREST = 1e-4;

/**
 * A camera of the file.
 *
 * @typedef {object} FileCamera
 * @property {number[][]} to_world - (4, 4) with columns left, up, forward, origin.
 * @property {number} fov - Degrees across the width.
 * @property {number} width - Of its film, in pixels.
 * @property {number} height
 * @property {number} near
 */

/**
 * Origin, target and up of a view.
 *
 * @typedef {object} Stand
 * @property {Vector3} eye
 * @property {Vector3} target
 */

/**
 * The stand of the file's camera: its target is on its axis, as far away as the middle of the model.
 *
 * @param {FileCamera} file
 * @param {Vector3} middle
 * @returns {Stand}
 */
export function standOf(file, middle) {
  const [eye, forward] = [column(file, 3), column(file, 2)];
  const away = middle.clone().sub(eye);
  const distance = away.dot(forward);
  return { eye, target: eye.clone().addScaledVector(forward, distance > 0 ? distance : away.length() || 1) };
}

function column(file, number) {
  const vector = new Vector3(...[0, 1, 2].map((row) => file.to_world[row][number]));
  return number === 3 ? vector : vector.normalize();
}

/** The up axis to orbit about: that of the scene, or the camera's own where it is rolled. */
export function orbitAxis(file, up) {
  const axis = up === "z" ? new Vector3(0, 0, 1) : new Vector3(0, 1, 0);
  return Math.abs(column(file, 0).dot(axis)) > ROLLED ? column(file, 1) : axis;
}

/** A three.js camera that stands as the file's does, exactly. */
export function openCamera(file, up) {
  const camera = new PerspectiveCamera();
  camera.up.copy(orbitAxis(file, up));
  camera.fov = (2 * Math.atan(tangents(file)[1]) * 180) / Math.PI; // OrbitControls scales panning by it
  placeAsFile(camera, file);
  return camera;
}

/** Move a camera to where the file's is. */
export function placeAsFile(camera, file) {
  const [left, up, forward] = [0, 1, 2].map((number) => column(file, number));
  const matrix = new Matrix4().makeBasis(left.negate(), up, forward.negate());
  camera.quaternion.setFromRotationMatrix(matrix);
  camera.position.copy(column(file, 3));
  camera.updateMatrixWorld(true);
}

/** Half the extent of the film at distance one: across and down. */
function tangents(file) {
  const across = Math.tan((file.fov * Math.PI) / 360);
  return [across, (across * file.height) / file.width];
}

/**
 * Edges of a picture at distance one: the film fits into what is free of a window, and the rest shows more.
 *
 * @param {FileCamera} file
 * @param {number} width - In any unit.
 * @param {number} height
 * @param {{left: number, right: number, top: number, bottom: number}} [covered] - By panels, in the same unit.
 * @returns {{left: number, right: number, top: number, bottom: number, pixel: number}} `pixel` is the size of one unit.
 */
export function frameOf(file, width, height, covered = { left: 0, right: 0, top: 0, bottom: 0 }) {
  const [across, down] = tangents(file);
  const free = [width - covered.left - covered.right, height - covered.top - covered.bottom];
  const pixel = 2 * Math.max(across / Math.max(free[0], 1), down / Math.max(free[1], 1));
  const x = covered.left + free[0] / 2;
  const y = covered.top + free[1] / 2;
  return { left: -x * pixel, right: (width - x) * pixel, top: y * pixel, bottom: (y - height) * pixel, pixel };
}

/**
 * Set the projection of a camera.
 *
 * @param {PerspectiveCamera} camera
 * @param {ReturnType<typeof frameOf>} frame
 * @param {{middle: Vector3, radius: number, near: number}} extent - A ball around the model, and where the file's
 *     camera begins to see.
 * @param {number[]} [shift] - Of the picture under the pixels, right and down, in units of the frame.
 */
export function project(camera, frame, extent, shift = [0, 0]) {
  const toward = new Vector3(0, 0, -1).applyQuaternion(camera.quaternion);
  const depth = extent.middle.clone().sub(camera.position).dot(toward);
  const far = Math.max(depth + ROOM * extent.radius, 1e-3 * extent.radius);
  const near = Math.max(depth - ROOM * extent.radius, NEAREST * far, Math.min(extent.near, 0.5 * far));
  const [x, y] = [shift[0] * frame.pixel, shift[1] * frame.pixel];
  camera.near = near;
  camera.far = far;
  camera.projectionMatrix.makePerspective(
    (frame.left + x) * near, (frame.right + x) * near, (frame.top - y) * near, (frame.bottom - y) * near, near, far,
  );
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
}
