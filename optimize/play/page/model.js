/* Light is linear: transport at direction nodes, superposed; then the metric M (thesis, eq. 4.6)
   and the score S (eq. 4.7) with exact slopes. Axes as in the tables: fiber, node, bend, site, then
   facets and, last, the untouched pad; channels of the camera last. Angles in rad. */

/* The 16-bit tables of the page as numbers. */
function decodeTables(text, tables) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  const whole = new Uint16Array(bytes.buffer), found = {};
  for (const [name, { first, count, step }] of Object.entries(tables))
    found[name] = Float64Array.from(whole.subarray(first, first + count), (v) => v * step);
  return found;
}

/* Polynomials through distinct nodes: barycentric weights (Berrut and Trefethen 2004, eq. 4.2). */
class Nodes {
  constructor(at) {
    this.at = at;
    const span = 4 / (at[at.length - 1] - at[0] || 4);
    this.base = at.map((x, j) => 1 / at.reduce((p, y, i) => (i === j ? p : p * span * (x - y)), 1));
    /* Derivatives at the nodes (eqs. 9.4 and 9.5). */
    this.slopes = at.map((x, i) => at.map((y, j) =>
      i === j ? 0 : this.base[j] / this.base[i] / (x - y)));
    this.slopes.forEach((row, i) => { row[i] = -row.reduce((a, b) => a + b, 0); });
  }

  weights(x) {
    const hit = this.at.findIndex((y) => Math.abs(x - y) < 1e-12);
    if (hit >= 0) return this.at.map((_, j) => (j === hit ? 1 : 0));
    const terms = this.base.map((b, j) => b / (x - this.at[j]));
    const total = terms.reduce((a, b) => a + b, 0);
    return terms.map((t) => t / total);
  }

  slopeWeights(x) {
    const w = this.weights(x);
    return this.at.map((_, j) => w.reduce((sum, wi, i) => sum + wi * this.slopes[i][j], 0));
  }
}

/* What all lamps send to some cells; the rows of lamps that did not turn are kept. A row has the
   cells once, or for each of as many `tints` as channels where the skin's albedo differs by them. */
class Superposition {
  constructor(nodes, table, fibers, tints, response) {
    this.nodes = nodes;
    this.table = table;
    this.fibers = fibers;
    this.tints = tints;
    this.response = response;
    this.channels = response[0].length;
    this.width = table.length / fibers / nodes.at.length;
    this.cells = this.width / tints;
    this.rows = new Float64Array(fibers * this.width);
    this.turned = new Float64Array(fibers).fill(NaN);
    this.total = new Float64Array(this.cells * this.channels);
  }

  mix(fiber, weights, out, start) {
    const { width, table } = this, count = weights.length;
    out.fill(0, start, start + width);
    for (let j = 0; j < count; j++) {
      const weight = weights[j], first = (fiber * count + j) * width;
      if (weight) for (let i = 0; i < width; i++) out[start + i] += weight * table[first + i];
    }
  }

  /* What a lamp's LEDs give to a channel. */
  gain(power, f, c) {
    const leds = this.response.length;
    let sum = 0;
    for (let l = 0; l < leds; l++) sum += power[leds * f + l] * this.response[l][c];
    return sum;
  }

  /* Where the cells of a channel begin in a row. */
  tint(c) { return this.tints > 1 ? c * this.cells : 0; }

  /* Unclipped counts, (cell, channel), for directions and LED powers. */
  sum({ phi, power }) {
    const { cells, width, rows, total, channels } = this;
    total.fill(0);
    for (let f = 0; f < this.fibers; f++) {
      if (phi[f] !== this.turned[f]) {
        this.mix(f, this.nodes.weights(phi[f]), rows, f * width);
        this.turned[f] = phi[f];
      }
      for (let c = 0; c < channels; c++) {
        const p = this.gain(power, f, c), first = f * width + this.tint(c);
        if (p) for (let i = 0; i < cells; i++) total[channels * i + c] += p * rows[first + i];
      }
    }
    return total;
  }
}

class Model {
  constructor(page, tables) {
    this.page = page;
    this.fibers = page.fibers.length;
    [this.bends, this.sites, this.facets] = [page.bends.length, page.sites.length, page.normals.length];
    this.patches = this.facets + 1;
    this.nodes = new Nodes(page.phi);
    const { response } = page.palette;
    this.channels = response[0].length;
    const made = (table) =>
      new Superposition(this.nodes, table, this.fibers, page.tints, response);
    [this.light, this.skin] = [tables.light, tables.skin].map(made);
    [this.lit, this.slope] = [0, 0].map(() => new Float64Array(this.light.width));
  }

  /* Score, its parts, the map of M (bend, site) and the fraction of clipped facets. */
  rate(counts) {
    const { countMax, ddof, cyclic, lam } = this.page.metric;
    const { bends, sites, facets, patches, channels } = this, metric = new Float64Array(bends * sites);
    const length = new Float64Array(facets), hue = new Float64Array(channels * facets);
    const pairs = cyclic ? facets : facets - 1, step = new Float64Array(pairs);
    let full = 0;
    for (let m = 0; m < metric.length; m++) {
      for (let k = 0; k < facets; k++) {
        const at = channels * (m * patches + k);
        let square = 0, clips = false;
        for (let c = 0; c < channels; c++) {
          const raw = counts[at + c], v = raw < 0 ? 0 : raw > countMax ? countMax : raw;
          clips ||= raw >= countMax;
          hue[channels * k + c] = v;
          square += v * v;
        }
        full += clips;
        length[k] = Math.sqrt(square);
        if (square) for (let c = 0; c < channels; c++) hue[channels * k + c] /= length[k];
      }
      for (let k = 0; k < pairs; k++) {
        const next = k + 1 < facets ? k + 1 : 0;
        let square = 0;
        for (let c = 0; c < channels; c++)
          square += (hue[channels * next + c] - hue[channels * k + c]) ** 2;
        step[k] = Math.sqrt(square);
      }
      metric[m] = evenMean(length, ddof) + lam * evenMean(step, ddof);
    }
    const [bySite, byBend] = this.means(metric), mean = average(metric);
    const parts = { mean, spreadSites: deviation(bySite, ddof), spreadBends: deviation(byBend, ddof) };
    return { score: mean - parts.spreadSites - parts.spreadBends, ...parts, metric,
      clipped: full / (metric.length * facets) };
  }

  means(metric) {
    const bySite = new Float64Array(this.sites), byBend = new Float64Array(this.bends);
    for (let b = 0; b < this.bends; b++)
      for (let s = 0; s < this.sites; s++) {
        bySite[s] += metric[b * this.sites + s] / this.bends;
        byBend[b] += metric[b * this.sites + s] / this.sites;
      }
    return [bySite, byBend];
  }

  /* S and its exact slopes by counts (optimize.scoring.score_gradient). */
  scoreSlopes(counts) {
    const rated = this.rate(counts);
    const { countMax, ddof, cyclic, lam } = this.page.metric;
    const { bends, sites, facets, patches, channels } = this;
    const [bySite, byBend] = this.means(rated.metric);
    const one = evenMeanSlopes(bySite, ddof), two = evenMeanSlopes(byBend, ddof);
    const slopes = new Float64Array(counts.length), pairs = cyclic ? facets : facets - 1;
    const length = new Float64Array(facets), hue = new Float64Array(channels * facets);
    const step = new Float64Array(pairs), flow = new Float64Array(channels * pairs);
    const byHue = new Float64Array(channels * facets);
    for (let b = 0, m = 0; b < bends; b++) for (let s = 0; s < sites; s++, m++) {
      const weight = one[s] / bends + two[b] / sites - 1 / (bends * sites), first = channels * m * patches;
      for (let k = 0; k < facets; k++) {
        let square = 0;
        for (let c = 0; c < channels; c++) {
          const at = channels * k + c;
          hue[at] = Math.min(Math.max(counts[first + at], 0), countMax);
          square += hue[at] ** 2;
        }
        length[k] = Math.sqrt(square);
        if (square) for (let c = 0; c < channels; c++) hue[channels * k + c] /= length[k];
      }
      for (let k = 0; k < pairs; k++) {
        const next = (k + 1) % facets;
        let square = 0;
        for (let c = 0; c < channels; c++) {
          const at = channels * k + c;
          flow[at] = hue[channels * next + c] - hue[at];
          square += flow[at] ** 2;
        }
        step[k] = Math.sqrt(square);
      }
      const byLength = evenMeanSlopes(length, ddof), byStep = evenMeanSlopes(step, ddof);
      byHue.fill(0);
      for (let k = 0; k < pairs; k++) for (let c = 0; c < channels; c++) {
        const pull = (lam * byStep[k] * flow[channels * k + c]) / (step[k] || 1);
        byHue[channels * ((k + 1) % facets) + c] += pull;
        byHue[channels * k + c] -= pull;
      }
      for (let k = 0; k < facets; k++) {
        let along = 0;
        for (let c = 0; c < channels; c++) along += byHue[channels * k + c] * hue[channels * k + c];
        for (let c = 0; c < channels; c++) {
          const at = channels * k + c, raw = counts[first + at];
          if (raw <= 0 || raw >= countMax) continue;
          slopes[first + at] = weight
            * (byLength[k] * hue[at] + (byHue[at] - along * hue[at]) / (length[k] || 1));
        }
      }
    }
    return { value: rated.score, byCounts: slopes };
  }

  /* Slopes by directions (per rad) and by the power of each LED, from those by counts. */
  along({ phi, power }, byCounts) {
    const { light, channels, fibers } = this, { response } = light, leds = response.length;
    const found = { phi: new Float64Array(fibers), power: new Float64Array(leds * fibers) };
    for (let f = 0; f < fibers; f++) {
      light.mix(f, this.nodes.weights(phi[f]), this.lit, 0);
      light.mix(f, this.nodes.slopeWeights(phi[f]), this.slope, 0);
      for (let c = 0; c < channels; c++) {
        const first = light.tint(c);
        let [byGain, byTurn] = [0, 0];
        for (let i = 0; i < light.cells; i++) {
          byGain += this.lit[first + i] * byCounts[channels * i + c];
          byTurn += this.slope[first + i] * byCounts[channels * i + c];
        }
        found.phi[f] += light.gain(power, f, c) * byTurn;
        for (let l = 0; l < leds; l++) found.power[leds * f + l] += response[l][c] * byGain;
      }
    }
    return found;
  }
}

function average(values) {
  let sum = 0;
  for (const v of values) sum += v;
  return sum / values.length;
}

/* Standard deviation in two passes, divided by n - ddof. */
function deviation(values, ddof) {
  const mean = average(values);
  let sum = 0;
  for (const v of values) sum += (v - mean) ** 2;
  return Math.sqrt(sum / (values.length - ddof));
}

function evenMean(values, ddof) { return average(values) - deviation(values, ddof); }

function evenMeanSlopes(values, ddof) {
  const mean = average(values), spread = deviation(values, ddof) || 1;
  return Float64Array.from(values, (v) =>
    1 / values.length - (v - mean) / ((values.length - ddof) * spread));
}

/* Designs: phi (fiber) rad, power (fiber, LED) 0 to 1. A lamp's color is its strongest LED. */
const OFF = -1;
function powersOf({ phi, power }, f) {
  const leds = power.length / phi.length;
  return power.subarray(leds * f, leds * (f + 1));
}
function colorOf(design, f) {
  const powers = powersOf(design, f), best = Math.max(...powers);
  return best > 0 ? powers.indexOf(best) : OFF;
}
function copyOf({ phi, power }) {
  return { phi: Float64Array.from(phi), power: Float64Array.from(power) };
}
