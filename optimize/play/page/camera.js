/* The camera's picture in WebGL2: the preview's own picture shader, lit by the skin's irradiance and
   by a ring of distant lights at the sites. */

/* Azimuths of the ring's lights and their elevations above the skin, rad: direct light comes flat
   from the edges, mirrored and scattered light from higher up. */
const AZIMUTHS = 10;
const ELEVATIONS = [0.175, 0.7];
const ROUNDS = 24;

/* Distant lights that explain the colors of the facets at every site: non-negative least squares by
   multiplicative updates (Lee and Seung 2001), from where the last design left off. */
class Ring {
  constructor(normals, cells) {
    this.directions = ELEVATIONS.flatMap((up) => Array.from({ length: AZIMUTHS }, (_, i) => {
      const azimuth = (2 * Math.PI * i) / AZIMUTHS, r = Math.cos(up);
      return [r * Math.sin(azimuth), r * Math.cos(azimuth), -Math.sin(up)];
    }));
    this.directions.push([0, 0, -1]);
    const rows = [...normals, [0, 0, -1]];
    this.see = rows.map((n) => this.directions.map((d) =>
      Math.max(n[0] * d[0] + n[1] * d[1] + n[2] * d[2], 0)));
    this.size = this.directions.length;
    this.faces = normals.length;
    this.gram = this.directions.map((_, i) => this.directions.map((_, j) =>
      this.see.reduce((sum, row) => sum + row[i] * row[j], 0)));
    this.sent = new Float64Array(cells * 3 * this.size).fill(1);
    this.aim = new Float64Array(this.size);
  }

  /* `facets` (site, facet, color) and `flat` (site, color) are unclipped counts at one bend or state. */
  fit(facets, flat) {
    const { size, see, gram, sent, aim, faces } = this;
    for (let cell = 0, at = 0; cell < flat.length; cell++, at += size) {
      const site = Math.floor(cell / 3), c = cell % 3;
      for (let i = 0; i < size; i++) {
        let sum = see[faces][i] * flat[cell];
        for (let k = 0; k < faces; k++) sum += see[k][i] * facets[3 * (site * faces + k) + c];
        aim[i] = sum;
      }
      for (let round = 0; round < ROUNDS; round++)
        for (let i = 0; i < size; i++) {
          let have = 1e-9;
          for (let j = 0; j < size; j++) have += gram[i][j] * sent[at + j];
          sent[at + i] = Math.max((sent[at + i] * aim[i]) / have, 1e-6);
        }
    }
    return sent;
  }
}

class Camera {
  constructor(canvas, page) {
    [this.canvas, this.page] = [canvas, page];
    this.gl = canvas.getContext("webgl2", { antialias: false });
    this.programs = new Map();
    this.ring = new Ring(page.normals, page.sites.length);
    /* Every place of the grid takes the light of the counted site next to it. */
    const { columns, rows, spacing, first } = page.grid;
    this.nearest = Array.from({ length: columns * rows }, (_, p) => {
      const [x, y] = [first[0] + (p % columns) * spacing, first[1] + Math.floor(p / columns) * spacing];
      const away = page.sites.map((site) => Math.hypot(site[0] - x, site[1] - y));
      return away.indexOf(Math.min(...away));
    });
    if (!this.gl) return;
    const { gl } = this, vertices = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, vertices);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 3, -1, -1, 3]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    this.textures = {
      light: this.texture(0, gl.TEXTURE_2D), ring: this.texture(1, gl.TEXTURE_2D_ARRAY),
      skins: page.skins.map(({ surface }) => surface && this.surface(surface)),
    };
  }

  texture(unit, kind) {
    const { gl } = this, made = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, made);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(kind, name, gl.CLAMP_TO_EDGE);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(kind, name, gl.LINEAR);
    return made;
  }

  surface({ steps, texels }) {
    const { gl } = this, made = this.texture(2, gl.TEXTURE_2D);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, steps, steps, 0, gl.RGBA, gl.FLOAT, new Float32Array(texels));
    return made;
  }

  /* One program per touch and bend: curvature and number of faces are constants in it. */
  program(touch, bend) {
    const key = `${touch ? touch.name : ""} ${bend}`;
    if (!this.programs.has(key)) this.programs.set(key, this.build(touch, bend));
    return this.programs.get(key);
  }

  build(touch, bend) {
    const { gl, page } = this, kappa = bend / page.pad.length, curved = page.skins[0].surface;
    const fragment = ["#version 300 es", "precision highp float;", "precision highp sampler2D;",
      "precision highp sampler2DArray;", "#define SOFT_RADIUS 1.0",
      page.pad.bond ? "#define BONDED" : "", curved ? "#define CURVED" : "",
      page.shader.paths, curved ? page.shader.skin : "",
      bend > 0 ? `#define BENT\n#define kappa ${Math.max(kappa, 1e-5).toExponential(12)}` : "",
      page.camera.fisheye ? "#define FISHEYE" : "",
      touch ? `#define FACES ${touch.planes.length}` : "", `#define RING ${this.ring.size}`,
      page.shader.relief, page.shader.sight, `
      uniform vec2 size;
      uniform float albedo;
      out vec4 pixel;
      void main() {
        Seen seen;
        pixel = vec4(0.0);
        if (!look(2.0 * gl_FragCoord.xy / size - 1.0, seen)) return;
        vec3 light = relief(seen.position, seen.facing, seen.facet, seen.from_body);
        float scale = albedo / 3.14159265 * seen.passed / (refractive_index * refractive_index);
        vec3 x = clamp(scale * light, 0.0, 1.0);
        pixel.a = 1.0;
        pixel.rgb = mix(12.92 * x, 1.055 * pow(x, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x));
      }`].join("\n");
    const program = gl.createProgram();
    const vertex = "#version 300 es\nin vec2 corner;\nvoid main() { gl_Position = vec4(corner, 0.0, 1.0); }";
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
        throw new Error(`the camera's shader does not compile: ${gl.getShaderInfoLog(shader)}`);
    }
    gl.bindAttribLocation(program, 0, "corner");
    gl.linkProgram(program);
    return { program, at: (name) => gl.getUniformLocation(program, name) };
  }

  /* Draws one bend or state. `skin` (row, column, color), `facets` and `flat` are unclipped counts;
     `shape` is the number of the skin among those of the page. */
  draw({ skin, facets, flat, bend, shape, touch, center }) {
    const { gl, page, canvas } = this;
    if (!gl || gl.isContextLost()) return;
    const { program, at } = this.program(touch, bend);
    gl.useProgram(program);
    const [rows, columns] = page.skinShape, size = this.ring.size;
    gl.activeTexture(gl.TEXTURE0);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, columns, rows, 0, gl.RGBA, gl.FLOAT, withAlpha(skin));
    const sent = this.ring.fit(facets, flat), places = this.nearest.length;
    const texels = new Float32Array(4 * places * size);
    for (let p = 0; p < places; p++) for (let i = 0; i < size; i++) for (let c = 0; c < 3; c++)
      texels[4 * (i * places + p) + c] = sent[(3 * this.nearest[p] + c) * size + i];
    gl.activeTexture(gl.TEXTURE1);
    gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.RGBA16F, page.grid.columns, page.grid.rows, size, 0,
      gl.RGBA, gl.FLOAT, texels);
    if (this.textures.skins[shape]) {
      gl.activeTexture(gl.TEXTURE2);
      gl.bindTexture(gl.TEXTURE_2D, this.textures.skins[shape]);
    }
    const { thickness, surface } = page.skins[shape], { camera, pad } = page, half = [pad.width / 2, pad.length / 2];
    const place = center || [0, 0];
    gl.uniform1i(at("skin_light"), 0);
    gl.uniform1i(at("ring"), 1);
    gl.uniform1i(at("skin"), 2);
    gl.uniform1f(at("thickness"), thickness);
    gl.uniform1f(at("refractive_index"), pad.index);
    if (pad.bond) {
      gl.uniform1f(at("bond"), pad.bond.height);
      gl.uniform1f(at("window_index"), pad.bond.window_index);
    }
    gl.uniform1f(at("albedo"), camera.albedo / page.metric.countMax);
    gl.uniform1f(at("longest_shadow"), touch ? page.shadow * touch.size : 0);
    gl.uniform2f(at("size"), canvas.width, canvas.height);
    gl.uniform2fv(at("half_view"), camera.half_view);
    gl.uniform3fv(at("camera"), camera.place);
    ["leftward", "upward", "ahead"].forEach((name, i) => gl.uniform3fv(at(name), camera.axes[i]));
    gl.uniform1f(at("pivot"), camera.pivot);
    gl.uniform2fv(at("half_pad"), half);
    gl.uniform2fv(at("skin_half"), half);
    gl.uniform3f(at("site_first"), place[0], place[1], thickness);
    gl.uniform2f(at("site_step"), 1, 1);
    gl.uniform2f(at("site_count"), 1, 1);
    gl.uniform2fv(at("ring_first"), page.grid.first);
    gl.uniform2f(at("ring_step"), page.grid.spacing, page.grid.spacing);
    gl.uniform2f(at("ring_count"), page.grid.columns, page.grid.rows);
    gl.uniform3fv(at("ring_direction"), this.ring.directions.flat());
    if (touch) gl.uniform4fv(at("facet_planes"), touch.planes.flat());
    if (touch && surface) gl.uniform3fv(at("touch_frame"), skinFrame(pad, surface, place).flat());
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

/* The skin at a place of the pad: position, across, towards the tip, out of the pad; bilinear. */
function skinFrame(pad, { steps, texels }, [x, y]) {
  const [u, v] = [x / pad.width, y / pad.length].map((at) => (at + 0.5) * (steps - 1));
  const [i, j] = [u, v].map((at) => Math.min(Math.max(Math.floor(at), 0), steps - 2));
  const at = (row, column, c) => texels[4 * (row * steps + column) + c];
  const [nx, ny, nz, height] = [0, 1, 2, 3].map((c) =>
    (1 - v + j) * ((1 - u + i) * at(j, i, c) + (u - i) * at(j, i + 1, c))
    + (v - j) * ((1 - u + i) * at(j + 1, i, c) + (u - i) * at(j + 1, i + 1, c)));
  const length = Math.hypot(nx, ny, nz), out = [-nx / length, -ny / length, -nz / length];
  const wide = Math.hypot(out[0], out[2]), across = [out[2] / wide, 0, -out[0] / wide];
  const tip = [out[1] * across[2] - out[2] * across[1], out[2] * across[0] - out[0] * across[2],
    out[0] * across[1] - out[1] * across[0]];
  return [[x, y, height], across, tip, out];
}

/* RGB as RGBA, below the end of half floats. */
function withAlpha(values) {
  const out = new Float32Array((values.length / 3) * 4);
  for (let i = 0; i < values.length / 3; i++)
    for (let c = 0; c < 3; c++) out[4 * i + c] = Math.min(values[3 * i + c], 60000);
  return out;
}
