// Opens a GLB file with three.js and with gltf-validator: node open_glb.mjs PROGRAMS FILE.glb
// Prints what they found as JSON. PROGRAMS holds node_modules.
import { createRequire } from 'node:module';
import { readFileSync } from 'node:fs';
import { resolve } from 'node:path';
import { pathToFileURL } from 'node:url';

const [programs, file] = process.argv.slice(2).map((path) => resolve(path));
const bytes = readFileSync(file);
const addon = (name) =>
  import(pathToFileURL(`${programs}/node_modules/three/examples/jsm/loaders/${name}.js`));

globalThis.self ??= globalThis;
const { GLTFLoader } = await addon('GLTFLoader');
const { GLTFGaussianSplatLoaderExtension } = await addon('GLTFGaussianSplatLoaderExtension');
const loader = new GLTFLoader();
loader.register((parser) => new GLTFGaussianSplatLoaderExtension(parser));
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const { scene } = await loader.parseAsync(buffer, '');
scene.updateMatrixWorld(true);
const found = {};
scene.traverse((object) => {
  if (!object.isGaussianSplat) return;
  const { attributes } = object.splatGeometry;
  found.matrix = object.matrixWorld.elements;
  found.names = Object.keys(attributes);
  for (const name of ['position', 'covariance', 'color'])
    found[name] = Array.from(attributes[name].array);
});

const validator = createRequire(`${programs}/package.json`)('gltf-validator');
const report = await validator.validateBytes(new Uint8Array(bytes));
const messages = report.issues.messages.map(({ code, severity, message, pointer }) => ({
  code, severity, message, pointer,
}));
console.log(JSON.stringify({ three: found, validator: { version: report.validatorVersion, messages } }));
