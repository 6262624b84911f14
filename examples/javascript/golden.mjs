// Run checker.onnx on its golden input with onnxruntime-web and print what comes out.
//
//   npm ci
//   node golden.mjs [MODEL_FOLDER]
//
// In a page, fetch() the two files instead of reading them; the rest is the same.

import { createHash } from "node:crypto";
import { readFile } from "node:fs/promises";
import path from "node:path";
import { fileURLToPath } from "node:url";

import * as ort from "onnxruntime-web";

import { readNpz } from "./npz.mjs";

const INPUTS = ["phi", "power", "bend"];
const OUTPUTS = ["counts", "counts_spread", "background", "metric", "score", "domain_excess"];

const here = path.dirname(fileURLToPath(import.meta.url));
const folder = process.argv[2] ?? path.join(here, "..", "..", "models", "finger20");

async function read(name) {
  try {
    return await readFile(path.join(folder, name));
  } catch (error) {
    console.error(`${path.join(folder, name)} cannot be read (${error.code}): name a model's folder`);
    process.exit(1);
  }
}

// An altered model gives plausible numbers: compare checksums before it is trusted.
const sums = (await read("checker.sha256")).toString("ascii").split("\n");
async function readUnaltered(name) {
  const content = await read(name);
  const expected = sums.find((line) => line.endsWith(name))?.split(/\s+/)[0];
  if (createHash("sha256").update(content).digest("hex") !== expected) {
    console.error(`${path.join(folder, name)} was altered: take a fresh copy of the model`);
    process.exit(1);
  }
  return content;
}

ort.env.wasm.numThreads = 1;
const model = await readUnaltered("checker.onnx");
const file = await readUnaltered("golden.npz");
const session = await ort.InferenceSession.create(new Uint8Array(model));
const golden = readNpz(file.buffer.slice(file.byteOffset, file.byteOffset + file.byteLength));

// phi (batch, fibers) and bend (batch, bends) in rad, power (batch, fibers, 3) in [0, 1].
const feeds = Object.fromEntries(
  INPUTS.map((name) => [name, new ort.Tensor("float32", golden[name].data, golden[name].dims)]),
);
const found = await session.run(feeds);

const [batch, ...axes] = found.counts.dims;
const stride = axes.reduce((product, d) => product * d, 1);
for (let design = 0; design < batch; design += 1) {
  const facet = Array.from(found.counts.data.subarray(design * stride, design * stride + 3));
  console.log(
    `design ${design}: score ${found.score.data[design].toFixed(3)}, ` +
      `domain excess ${found.domain_excess.data[design]}, ` +
      `first facet ${facet.map((c) => c.toFixed(2)).join(" ")}`,
  );
}

let worst = 0;
for (const name of OUTPUTS) {
  const { data } = found[name];
  if (data.length !== golden[name].data.length) throw new Error(`${name} has another shape`);
  // Not Math.max, so that NaN counts as wrong.
  data.forEach((value, i) => {
    const off = Math.abs(value - golden[name].data[i]);
    if (!(off <= worst)) worst = off;
  });
}
console.log(`largest difference from the golden output: ${worst.toPrecision(2)}`);
if (!(worst < 0.01)) {
  console.error("this runtime computes something else");
  process.exit(1);
}
