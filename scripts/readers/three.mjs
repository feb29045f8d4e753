// Triangles of mesh files by the loaders of three.js, as they stand at rest: skinned, morphed, instanced.
// A line of JSON {"path", "out"} on standard input gives the file `out` of float64 and a line {"triangles"} or {"refused"}.
import { readFile, writeFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { createInterface } from 'node:readline';
import { dirname, extname, resolve } from 'node:path';
import { fileURLToPath, pathToFileURL } from 'node:url';

const need = createRequire(process.argv[2]); // a file beside the node_modules that hold three
const load = (name) => import(pathToFileURL(resolve(dirname(process.argv[2]), 'node_modules/three', name)));
const THREE = await load('build/three.module.js');
const { GLTFLoader } = await load('examples/jsm/loaders/GLTFLoader.js');
const { OBJLoader } = await load('examples/jsm/loaders/OBJLoader.js');
const { PLYLoader } = await load('examples/jsm/loaders/PLYLoader.js');
const { STLLoader } = await load('examples/jsm/loaders/STLLoader.js');
const { MeshoptDecoder } = await load('examples/jsm/libs/meshopt_decoder.module.js');
await MeshoptDecoder.ready;

globalThis.self = globalThis;
globalThis.ProgressEvent = class { constructor(type, values) { Object.assign(this, values); } };
const fetchElsewhere = globalThis.fetch; // which knows data: but not file:
globalThis.fetch = async (request) => {
    const url = request.url ?? String(request);
    return url.startsWith('file:') ? new Response(await readFile(fileURLToPath(url))) : fetchElsewhere(request);
};
const said = [];
for (const name of ['log', 'warn', 'error']) console[name] = (...words) => said.push(words.join(' '));

// Draco without the workers of a browser.
const draco = await (async () => {
    try { return await need('draco3d').createDecoderModule({}); } catch { return null; }
})();
const dracoLoader = draco && {
    preload() {},
    decodeDracoFile(data, done, ids, types, colorSpace, fail) {
        try {
            const decoder = new draco.Decoder();
            const mesh = new draco.Mesh();
            const bytes = new Int8Array(data);
            const status = decoder.DecodeArrayToMesh(bytes, bytes.length, mesh);
            if (!status.ok()) throw new Error(status.error_msg());
            const geometry = new THREE.BufferGeometry();
            const faces = [];
            const triangle = new draco.DracoInt32Array();
            for (let i = 0; i < mesh.num_faces(); i++) {
                decoder.GetFaceFromMesh(mesh, i, triangle);
                faces.push(triangle.GetValue(0), triangle.GetValue(1), triangle.GetValue(2));
            }
            geometry.setIndex(faces);
            for (const name of Object.keys(ids)) {
                const attribute = decoder.GetAttributeByUniqueId(mesh, ids[name]);
                const values = new draco.DracoFloat32Array();
                decoder.GetAttributeFloatForAllPoints(mesh, attribute, values);
                const array = Float32Array.from({ length: values.size() }, (_, i) => values.GetValue(i));
                geometry.setAttribute(name, new THREE.BufferAttribute(array, attribute.num_components()));
            }
            done(geometry);
        } catch (error) { fail(error); }
    },
};

// Materials and what is only for them, which need a browser.
function strip(document) {
    for (const key of ['materials', 'textures', 'images', 'samplers', 'animations']) delete document[key];
    for (const mesh of document.meshes ?? []) for (const primitive of mesh.primitives ?? []) delete primitive.material;
    const unneeded = /texture|material/i;
    for (const key of ['extensionsRequired', 'extensionsUsed']) {
        if (document[key]) document[key] = document[key].filter((name) => !unneeded.test(name));
    }
    return document;
}

function withoutMaterials(data) {
    if (data.toString('latin1', 0, 4) !== 'glTF') return JSON.stringify(strip(JSON.parse(data.toString())));
    const size = data.readUInt32LE(12);
    const json = Buffer.from(JSON.stringify(strip(JSON.parse(data.toString('utf8', 20, 20 + size).replace(/\0+$/, '')))));
    const padded = Buffer.concat([json, Buffer.alloc(-json.length & 3, ' ')]);
    const rest = data.subarray(20 + size);
    const header = Buffer.alloc(20);
    header.write('glTF');
    [2, 20 + padded.length + rest.length, padded.length, 0x4e4f534a].forEach((n, i) => header.writeUInt32LE(n, 4 + 4 * i));
    const all = Buffer.concat([header, padded, rest]);
    return all.buffer.slice(all.byteOffset, all.byteOffset + all.length);
}

async function parse(path) {
    const data = await readFile(path);
    const buffer = data.buffer.slice(data.byteOffset, data.byteOffset + data.length);
    const kind = extname(path).toLowerCase();
    if (kind === '.obj') return new OBJLoader().parse(data.toString());
    if (kind === '.ply') {
        const geometry = new PLYLoader().parse(buffer);
        if (!geometry.index) throw new Error('no faces'); // it would make triangles of a point cloud
        return new THREE.Mesh(geometry);
    }
    if (kind === '.stl') return new THREE.Mesh(new STLLoader().parse(buffer));
    const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
    if (dracoLoader) loader.setDRACOLoader(dracoLoader);
    const gltf = await loader.parseAsync(withoutMaterials(data), pathToFileURL(path).href.replace(/[^/]*$/, ''));
    if (!gltf.scene) throw new Error('no scene');
    return gltf.scene;
}

function collect(top) {
    const found = [];
    const point = new THREE.Vector3();
    const matrix = new THREE.Matrix4();
    top.updateMatrixWorld(true);
    top.traverseVisible((object) => {
        if (!object.isMesh || !object.geometry.attributes.position) return;
        const { index, attributes } = object.geometry;
        const count = index ? index.count : attributes.position.count;
        for (let copy = 0; copy < (object.isInstancedMesh ? object.count : 1); copy++) {
            matrix.copy(object.matrixWorld);
            if (object.isInstancedMesh) {
                const own = new THREE.Matrix4();
                object.getMatrixAt(copy, own);
                matrix.multiply(own);
            }
            for (let i = 0; i < count - (count % 3); i++) {
                object.getVertexPosition(index ? index.getX(i) : i, point);
                point.applyMatrix4(matrix);
                found.push(point.x, point.y, point.z);
            }
        }
    });
    return Float64Array.from(found);
}

for await (const line of createInterface({ input: process.stdin })) {
    const { path, out } = JSON.parse(line);
    let answer;
    said.length = 0;
    try {
        const numbers = collect(await parse(path));
        await writeFile(out, Buffer.from(numbers.buffer));
        answer = { triangles: numbers.length / 9 };
    } catch (error) {
        answer = { refused: String(error?.message ?? error).split('\n')[0].slice(0, 200) };
    }
    process.stdout.write(JSON.stringify(answer) + '\n');
}
