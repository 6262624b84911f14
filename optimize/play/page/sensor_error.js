/* The expected error of the sensor reader in closed form, one ridge regression from color and place to
   normal (optimize.readers.sensor_error, which has the derivation). Rows are (bend, site, normal). */

class SensorError {
  constructor(model, camera, facts) {
    const { bends, sites, channels, patches } = model;
    Object.assign(this, facts, { camera, bends, sites, channels, patches });
    [this.weights, this.plane, this.places] = [facts.weights, facts.plane, facts.places]
      .map((v) => Float64Array.from(v));
    this.normals = facts.plane.length / 2 / bends / sites;
    this.rows = bends * sites * this.normals;
    this.terms = 1 + Math.max(...facts.monomials.map(([, , term]) => term));
    this.placeTerms = facts.places.length / sites;
    this.size = this.terms * this.placeTerms;
    /* Each monomial is a lower one times a variable, and its derivatives are lower ones. */
    [this.variable, this.lower] = [new Int32Array(this.terms), new Int32Array(this.terms)];
    for (const [variable, lower, term] of facts.monomials)
      [this.variable[term], this.lower[term]] = [variable, lower];
    this.derivatives = Array.from({ length: channels }, (_, c) => {
      const of = facts.monomials.filter(([variable]) => variable === c);
      return { lower: Int32Array.from(of, (one) => one[1]), term: Int32Array.from(of, (one) => one[2]),
        power: Float64Array.from(of, (one) => one[3]) };
    });
    /* Rows of each site. */
    this.rowsOf = Array.from({ length: sites }, (_, s) => Int32Array.from({ length: bends * this.normals },
      (_, i) => (Math.floor(i / this.normals) * sites + s) * this.normals + (i % this.normals)));
    const { rows, terms, size } = this, array = (count) => new Float64Array(count);
    [this.counts, this.standard] = [0, 0].map(() => array(rows * channels));
    this.features = array(rows * terms);
    this.lowered = array(rows * channels * terms);
    this.deviation = array(rows * channels);
    [this.scale, this.stretched] = [0, 0].map(() => array(channels));
    this.factor = array(size * size);
    [this.missed, this.weighed] = [0, 0].map(() => array(rows * (1 + channels) * 2));
    this.metric = array(3 * rows);
    for (let r = 0; r < rows; r++)
      this.metric.set(sphereMetric(facts.plane[2 * r], facts.plane[2 * r + 1]), 3 * r);
    this.length = array(rows);
    this.noisy = array(terms);
  }

  degrees(colors, gain) { return this.fit(colors, gain); }

  /* Counts of all normals, their monomials and derivatives, and the noise's deviations. */
  look(colors, gain) {
    const { rows, normals, channels, patches, weights, counts, camera, features, terms, lowered } = this;
    const { fullScale } = camera, center = new Float64Array(channels);
    for (let r = 0; r < rows; r++) for (let c = 0; c < channels; c++) {
      const first = Math.floor(r / normals) * patches;
      let sum = 0;
      for (let k = 0; k < patches; k++) sum += weights[r * patches + k] * colors[channels * (first + k) + c];
      counts[r * channels + c] = Math.min(Math.max(sum, 0), fullScale);
      center[c] += counts[r * channels + c] / rows;
    }
    this.scale.fill(0);
    for (let i = 0; i < counts.length; i++) this.scale[i % channels] += (counts[i] - center[i % channels]) ** 2;
    for (let c = 0; c < channels; c++) {
      const scatter = Math.sqrt(this.scale[c] / rows);
      this.stretched[c] = scatter > this.leastDeviation ? 1 : 0;
      this.scale[c] = Math.max(scatter, this.leastDeviation);
    }
    for (let i = 0; i < counts.length; i++)
      this.standard[i] = (counts[i] - center[i % channels]) / this.scale[i % channels];
    for (let r = 0; r < rows; r++) {
      const at = r * terms;
      features[at] = 1;
      for (let t = 1; t < terms; t++) {
        features[at + t] = features[at + this.lower[t]] * this.standard[r * channels + this.variable[t]];
      }
      for (let c = 0; c < channels; c++) {
        const to = (r * channels + c) * terms, { lower, term, power } = this.derivatives[c];
        for (let a = 0; a < term.length; a++) lowered[to + term[a]] = power[a] * features[at + lower[a]];
        this.deviation[r * channels + c] = Math.sqrt(camera.variance(counts[r * channels + c], gain)) / this.scale[c];
      }
    }
  }

  /* Mean of degrees; keeps what the slopes need. */
  fit(colors, gain) {
    this.look(colors, gain);
    const { rows, sites, channels, terms, size, features, lowered, deviation, plane, factor } = this;
    const right = new Float64Array(2 * size), gram = new Float64Array(terms * terms);
    const taught = new Float64Array(2 * terms);
    factor.fill(0);
    for (let s = 0; s < sites; s++) {
      gram.fill(0);
      taught.fill(0);
      for (const r of this.rowsOf[s]) {
        const at = r * terms, x = plane[2 * r], y = plane[2 * r + 1];
        for (let i = 0; i < terms; i++) {
          const value = features[at + i];
          taught[2 * i] += value * x;
          taught[2 * i + 1] += value * y;
          for (let j = 0; j <= i; j++) gram[i * terms + j] += value * features[at + j];
        }
        for (let c = 0; c < channels; c++) {
          const to = (r * channels + c) * terms, variance = deviation[r * channels + c] ** 2;
          const { term } = this.derivatives[c];
          for (let a = 0; a < term.length; a++) {
            const i = term[a], value = variance * lowered[to + i];
            for (let b = 0; b <= a; b++) gram[i * terms + term[b]] += value * lowered[to + term[b]];
          }
        }
      }
      this.spread(s, taught, right);
      this.addGram(s, gram);
    }
    for (let i = 0; i < size; i++) factor[i * size + i] += this.ridge * rows;
    factorize(factor, size);
    this.weightsAt = this.atSites(solve(factor, size, right));
    return this.miss();
  }

  /* Adds place monomials times the colors' matrix of a site, lower triangle. */
  addGram(s, gram) {
    const { places, placeTerms, terms, size, factor } = this;
    for (let p = 0; p < placeTerms; p++) for (let q = 0; q <= p; q++) {
      const both = places[s * placeTerms + p] * places[s * placeTerms + q];
      for (let i = 0; i < terms; i++) for (let j = 0; j < terms; j++) {
        const value = j <= i ? gram[i * terms + j] : gram[j * terms + i];
        factor[(p * terms + i) * size + q * terms + j] += both * value;
      }
    }
  }

  /* Adds place monomials times what a site has (color term, part of the normal). */
  spread(s, values, sum) {
    const { places, placeTerms } = this;
    for (let p = 0; p < placeTerms; p++) {
      const place = places[s * placeTerms + p], first = p * values.length;
      for (let i = 0; i < values.length; i++) sum[first + i] += place * values[i];
    }
  }

  /* What weights (place and color term, part) are at each site. */
  atSites(weights) {
    const { sites, places, placeTerms, terms } = this, width = 2 * terms;
    const out = new Float64Array(sites * width);
    for (let s = 0; s < sites; s++) for (let p = 0; p < placeTerms; p++)
      for (let i = 0; i < width; i++) out[s * width + i] += places[s * placeTerms + p] * weights[p * width + i];
    return out;
  }

  /* How far each row is off: its bias, then what the noise of each channel does. */
  miss() {
    const { sites, rows, channels, terms, features, lowered, deviation, plane, missed, weightsAt } = this;
    let total = 0;
    for (let s = 0; s < sites; s++) for (const r of this.rowsOf[s]) {
      const first = 2 * s * terms, to = 2 * r * (1 + channels), at = r * terms;
      for (let i = 0; i < 2; i++) {
        let sum = -plane[2 * r + i];
        for (let t = 0; t < terms; t++) sum += features[at + t] * weightsAt[first + 2 * t + i];
        missed[to + i] = sum;
        for (let c = 0; c < channels; c++) {
          const from = (r * channels + c) * terms, { term } = this.derivatives[c];
          sum = 0;
          for (let a = 0; a < term.length; a++) sum += lowered[from + term[a]] * weightsAt[first + 2 * term[a] + i];
          missed[to + 2 * (1 + c) + i] = sum * deviation[r * channels + c];
        }
      }
      this.weigh(r);
      let square = 0;
      for (let i = to; i < to + 2 * (1 + channels); i++) square += this.weighed[i] * missed[i];
      this.length[r] = Math.sqrt(square);
      total += this.length[r];
    }
    return total / rows / DEGREE;
  }

  /* What is missed in a row, by the sphere's metric: bias weighs 1, noise pi / 4. */
  weigh(r) {
    const { channels, metric, missed, weighed } = this, width = 2 * (1 + channels);
    for (let j = r * width; j < (r + 1) * width; j += 2) {
      const part = j > r * width ? Math.PI / 4 : 1;
      weighed[j] = part * (metric[3 * r] * missed[j] + metric[3 * r + 1] * missed[j + 1]);
      weighed[j + 1] = part * (metric[3 * r + 1] * missed[j] + metric[3 * r + 2] * missed[j + 1]);
    }
  }

  /* Degrees, and their slopes by colors and gain, in reverse mode. */
  slopes(colors, gain) {
    const degrees = this.fit(colors, gain), { sites, rows, channels, terms, size } = this;
    const right = new Float64Array(2 * size), pull = new Float64Array(2 * terms), width = 2 * (1 + channels);
    const byTold = this.weighed.map((v, i) => v / (rows * (this.length[Math.floor(i / width)] || 1)));
    for (let s = 0; s < sites; s++) {
      pull.fill(0);
      for (const r of this.rowsOf[s]) for (let j = 0; j <= channels; j++) {
        const part = this.row(r, j), at = r * width + 2 * j;
        for (let t = 0; t < terms; t++) {
          pull[2 * t] += part[t] * byTold[at];
          pull[2 * t + 1] += part[t] * byTold[at + 1];
        }
      }
      this.spread(s, pull, right);
    }
    /* Through the weights: they solve gram W = right. */
    const adjoint = this.atSites(solve(this.factor, size, right)), slope = new Float64Array(terms);
    const byFeatures = new Float64Array(terms);
    const [byStandard, byDeviation] = [0, 0].map(() => new Float64Array(rows * channels));
    for (let s = 0; s < sites; s++) for (const r of this.rowsOf[s]) {
      byFeatures.fill(0);
      for (let j = 0; j <= channels; j++) {
        this.slopeOfRow(s, r, j, byTold, adjoint, slope);
        if (!j) { byFeatures.set(slope); continue; }
        const c = j - 1, at = r * channels + c, { lower, term, power } = this.derivatives[c];
        for (let a = 0; a < term.length; a++) {
          byDeviation[at] += slope[term[a]] * this.lowered[at * terms + term[a]];
          byFeatures[lower[a]] += power[a] * slope[term[a]] * this.deviation[at];
        }
      }
      for (let at = r * channels; at < (r + 1) * channels; at++) for (const t of this.derivatives[at % channels].term)
        byStandard[at] += byFeatures[t] * this.lowered[at * terms + t];
    }
    return { degrees, ...this.byColors(gain, byStandard, byDeviation) };
  }

  /* Features of a row (j = 0), or their derivatives by a channel times the noise's deviation. */
  row(r, j) {
    const { terms, channels, features, lowered, deviation, noisy } = this;
    if (!j) return features.subarray(r * terms, (r + 1) * terms);
    const at = r * channels + j - 1;
    for (let t = 0; t < terms; t++) noisy[t] = lowered[at * terms + t] * deviation[at];
    return noisy;
  }

  /* Slopes by what `row` has. */
  slopeOfRow(s, r, j, byTold, adjoint, out) {
    const { terms, channels, weightsAt, missed } = this, part = this.row(r, j);
    const first = 2 * s * terms, at = 2 * (r * (1 + channels) + j);
    let [x, y] = [byTold[at], byTold[at + 1]];
    for (let t = 0; t < terms; t++) {
      x -= part[t] * adjoint[first + 2 * t];
      y -= part[t] * adjoint[first + 2 * t + 1];
    }
    for (let t = 0; t < terms; t++) {
      const i = first + 2 * t;
      out[t] = x * weightsAt[i] + y * weightsAt[i + 1] - missed[at] * adjoint[i] - missed[at + 1] * adjoint[i + 1];
    }
  }

  /* Slopes by colors and gain. Brighter colors move their mean, and by x / n their scale, of colors and
     deviations alike. */
  byColors(gain, byStandard, byDeviation) {
    const { rows, channels, patches, weights, counts, standard, deviation, scale, camera } = this;
    const byColors = new Float64Array(this.bends * this.sites * patches * channels);
    const [byMean, byScale] = [0, 0].map(() => new Float64Array(channels));
    for (let i = 0; i < counts.length; i++) {
      const c = i % channels;
      byMean[c] += byStandard[i] / rows;
      byScale[c] += (this.stretched[c] * (byStandard[i] * standard[i] + byDeviation[i] * deviation[i])) / rows;
    }
    let byGain = 0;
    for (let i = 0; i < counts.length; i++) {
      if (counts[i] <= 0 || counts[i] >= camera.fullScale) continue;
      const c = i % channels, r = (i - c) / channels, cell = Math.floor(r / this.normals) * patches;
      const byVariance = byDeviation[i] / (2 * deviation[i] * scale[c] ** 2);
      const byCounts = (byStandard[i] - byMean[c] - byScale[c] * standard[i]) / scale[c];
      const slope = (byCounts + byVariance * camera.shot * gain) / DEGREE;
      byGain += (byVariance * camera.byGain(counts[i], gain)) / DEGREE;
      for (let k = 0; k < patches; k++) byColors[channels * (cell + k) + c] += weights[r * patches + k] * slope;
    }
    return { byColors, byGain };
  }
}

/* Cholesky's factor of a symmetric matrix, in its lower triangle. */
function factorize(matrix, size) {
  for (let i = 0; i < size; i++) for (let j = 0; j <= i; j++) {
    let sum = matrix[i * size + j];
    for (let k = 0; k < j; k++) sum -= matrix[i * size + k] * matrix[j * size + k];
    matrix[i * size + j] = i === j ? Math.sqrt(sum) : sum / matrix[j * size + j];
  }
}

/* The solution for two right sides, (row, 2), from Cholesky's factor. */
function solve(factor, size, right) {
  const out = Float64Array.from(right);
  for (let i = 0; i < size; i++) for (let e = 0; e < 2; e++) {
    let sum = out[2 * i + e];
    for (let k = 0; k < i; k++) sum -= factor[i * size + k] * out[2 * k + e];
    out[2 * i + e] = sum / factor[i * size + i];
  }
  for (let i = size - 1; i >= 0; i--) for (let e = 0; e < 2; e++) {
    let sum = out[2 * i + e];
    for (let k = i + 1; k < size; k++) sum -= factor[k * size + i] * out[2 * k + e];
    out[2 * i + e] = sum / factor[i * size + i];
  }
  return out;
}
