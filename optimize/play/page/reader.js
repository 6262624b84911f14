/* What a design is worth in degrees: a lookup that knows the colors of all normals at its site takes
   the nearest one to what a camera with noise sees (optimize.reconstruction, normal_error). */

const READ_TILTS = 24, READ_AZIMUTHS = 72, READ_NOISE = 1, FULL_WELL = 10000;
const MOST_NORMALS = 64, ALL_NORMALS = 2000;

/* Random numbers that are the same for all designs (mulberry32), even in [0, 1). */
function* evenNumbers(seed) {
  for (let a = seed; ;) {
    a = (a + 0x6d2b79f5) | 0;
    let t = Math.imul(a ^ (a >>> 15), 1 | a);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    yield ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  }
}

class Reader {
  constructor(model) {
    this.model = model;
    const [x, y] = model.page.normals[0], count = model.facets;
    this.slope = Math.hypot(x, y);
    this.orders = [1, 2, 3].filter((order) => order <= Math.max(Math.floor((count - 1) / 2), 1));
    this.grid = [];
    for (let i = 0; i < READ_TILTS; i++) for (let j = 0; j < READ_AZIMUTHS; j++)
      this.grid.push([i / (READ_TILTS - 1), (2 * Math.PI * j) / READ_AZIMUTHS]);
    this.samples = Math.max(4, Math.min(MOST_NORMALS, Math.floor(ALL_NORMALS / (model.sites * model.bends))));
  }

  normal([tilt, azimuth]) {
    const x = this.slope * tilt * Math.sin(azimuth), y = this.slope * tilt * Math.cos(azimuth);
    return [x, y, Math.sqrt(1 - x * x - y * y)];
  }

  /* Counts of any normal within the cone of a site: harmonics of its facets, the untouched pad in the
     middle. */
  colors(facets, flat, first, channels, at) {
    const count = this.model.facets, out = [];
    for (let c = 0; c < channels; c++) {
      let mean = 0;
      for (let k = 0; k < count; k++) mean += facets[first + channels * k + c] / count;
      const waves = this.orders.map((order) => {
        let cosine = 0, sine = 0;
        for (let k = 0; k < count; k++) {
          const turn = (2 * Math.PI * order * k) / count, value = facets[first + channels * k + c];
          cosine += (2 / count) * Math.cos(turn) * value;
          sine += (2 / count) * Math.sin(turn) * value;
        }
        return [order, cosine, sine];
      });
      out.push(at.map(([tilt, azimuth]) => {
        let sum = flat[c] + tilt * tilt * (mean - flat[c]);
        for (const [order, cosine, sine] of waves)
          sum += tilt ** order * (cosine * Math.cos(order * azimuth) + sine * Math.sin(order * azimuth));
        return Math.min(Math.max(sum, 0), 255);
      }));
    }
    return out;
  }

  /* Mean angle between shown and read normals, degrees. */
  error(design) {
    const { model } = this, { sites, bends, channels, facets: count } = model;
    const { countMax } = model.page.metric, clip = (v) => Math.min(Math.max(v, 0), countMax);
    const light = Float64Array.from(model.light.sum(design), clip);
    const flat = Float64Array.from(model.flat.sum(design), clip);
    const random = evenNumbers(9), even = () => random.next().value;
    const normal = () => Math.sqrt(-2 * Math.log(1 - even())) * Math.cos(2 * Math.PI * even());
    let total = 0;
    for (let m = 0; m < sites * bends; m++) {
      const shown = Array.from({ length: this.samples }, () => [Math.sqrt(even()), 2 * Math.PI * even()]);
      const all = this.colors(light, flat.subarray(channels * m, channels * (m + 1)), channels * m * count,
        channels, [...this.grid, ...shown]);
      for (let s = 0; s < shown.length; s++) {
        const seen = all.map((values) => {
          const v = values[this.grid.length + s];
          const noisy = v + Math.sqrt(READ_NOISE ** 2 + (v * 255) / FULL_WELL) * normal();
          return Math.min(Math.max(Math.round(noisy), 0), 255);
        });
        let best = Infinity, read = 0;
        for (let g = 0; g < this.grid.length; g++) {
          let far = 0;
          for (let c = 0; c < channels; c++) far += (all[c][g] - seen[c]) ** 2;
          if (far < best) [best, read] = [far, g];
        }
        const [a, b] = [this.normal(shown[s]), this.normal(this.grid[read])];
        total += 2 * Math.asin(Math.min(Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]) / 2, 1));
      }
    }
    return total / (sites * bends * this.samples) / DEGREE;
  }
}
