/* The expected error of the place reader in closed form: the Cramer-Rao bound with a prior, and normals
   of like color taken for each other (optimize.readers.place_error, which has the derivation). */

class PlaceError {
  constructor(model, camera, facts) {
    const { bends, sites, channels, patches } = model;
    Object.assign(this, facts, { camera, cells: bends * sites, channels, patches });
    const normals = (this.normals = facts.plane.length / 2), array = (count) => new Float64Array(count);
    this.metric = Array.from({ length: normals }, (_, n) =>
      sphereMetric(facts.plane[2 * n], facts.plane[2 * n + 1]));
    [this.weights, this.steepness, this.apart] = [facts.weights, facts.steepness, facts.apart]
      .map((v) => Float64Array.from(v));
    this.size = normals * channels;
    [this.counts, this.variance, this.byCounts, this.byVariance] = [0, 0, 0, 0].map(() => array(this.size));
    [this.steep, this.bySteep] = [0, 0].map(() => [array(this.size), array(this.size)]);
    [this.near, this.total, this.far, this.missed] = [0, 0, 0, 0].map(() => array(normals));
    this.alike = array(normals * normals);
  }

  degrees(colors, gain) {
    let total = 0;
    for (let cell = 0; cell < this.cells; cell++) total += this.miss(colors, cell, gain);
    return total / (this.cells * this.normals);
  }

  isDim(count) { return count > 0 && count < this.camera.fullScale; }

  /* The sum of errors in one cell, degrees; keeps what the slopes need. */
  miss(colors, cell, gain) {
    const { normals, channels, patches, counts, variance, steep, weights, steepness: slope, camera } = this;
    const first = channels * cell * patches;
    for (let n = 0; n < normals; n++) for (let c = 0; c < channels; c++) {
      let sum = 0, x = 0, y = 0;
      for (let k = 0; k < patches; k++) {
        const color = colors[first + channels * k + c];
        sum += weights[n * patches + k] * color;
        x += slope[n * patches + k] * color;
        y += slope[(normals + n) * patches + k] * color;
      }
      const at = n * channels + c, count = Math.min(Math.max(sum, 0), camera.fullScale);
      counts[at] = count;
      variance[at] = Math.max(camera.variance(count, gain), camera.rounding);
      [steep[0][at], steep[1][at]] = this.isDim(count) ? [x, y] : [0, 0];
    }
    this.compare();
    let total = 0;
    for (let n = 0; n < normals; n++) {
      const [a, b, d] = this.covariance(n), [xx, xy, yy] = this.metric[n];
      this.near[n] = Math.sqrt((Math.PI / 4) * (a * xx + 2 * b * xy + d * yy)) / DEGREE;
      let all = 0, far = 0, confused = 0;
      for (let m = 0; m < normals; m++) {
        const alike = this.alike[n * normals + m], apart = this.apart[n * normals + m];
        all += alike;
        if (!apart) continue;
        far += alike;
        confused += alike * apart;
      }
      this.total[n] = all;
      this.far[n] = far / all;
      this.missed[n] = (1 - this.far[n]) * this.near[n] + confused / all;
      total += this.missed[n];
    }
    return total;
  }

  /* Of the normal that is told, near the truth: xx, xy, yy. */
  covariance(n) {
    const { channels, variance, steep: [x, y] } = this;
    let [a, b, d] = [this.prior, 0, this.prior];
    for (let at = n * channels; at < (n + 1) * channels; at++) {
      a += x[at] ** 2 / variance[at];
      b += (x[at] * y[at]) / variance[at];
      d += y[at] ** 2 / variance[at];
    }
    const area = a * d - b * b;
    return [d / area, -b / area, a / area];
  }

  /* How alike the colors of all pairs of normals are, 1 for the same. */
  compare() {
    const { normals, channels, counts, variance, alike } = this;
    for (let n = 0; n < normals; n++) for (let m = 0; m <= n; m++) {
      let square = 0;
      for (let c = 0; c < channels; c++) {
        const i = n * channels + c, j = m * channels + c;
        square += (counts[i] - counts[j]) ** 2 / (variance[i] + variance[j]);
      }
      alike[n * normals + m] = alike[m * normals + n] = Math.exp(-square / 2);
    }
  }

  /* Degrees, and their slopes by colors and gain, in reverse mode. */
  slopes(colors, gain) {
    const { cells, normals, channels, patches, camera, counts, byCounts, byVariance, bySteep } = this;
    const byColors = new Float64Array(colors.length), each = cells * normals;
    let [total, byGain] = [0, 0];
    for (let cell = 0; cell < cells; cell++) {
      total += this.miss(colors, cell, gain);
      byCounts.fill(0);
      byVariance.fill(0);
      this.slopesNear(each);
      this.slopesFar(each);
      for (let n = 0; n < normals; n++) for (let c = 0; c < channels; c++) {
        const at = n * channels + c;
        if (!this.isDim(counts[at])) continue;
        const slope = byCounts[at] + byVariance[at] * camera.shot * gain;
        byGain += byVariance[at] * camera.byGain(counts[at], gain);
        for (let k = 0; k < patches; k++)
          byColors[channels * (cell * patches + k) + c] += this.weights[n * patches + k] * slope
            + this.steepness[n * patches + k] * bySteep[0][at]
            + this.steepness[(normals + n) * patches + k] * bySteep[1][at];
      }
    }
    return { degrees: total / each, byColors, byGain };
  }

  slopesNear(each) {
    const { normals, channels, steep: [x, y], variance } = this;
    for (let n = 0; n < normals; n++) {
      const [a, b, d] = this.covariance(n), [xx, xy, yy] = this.metric[n];
      const byTrace = (((1 - this.far[n]) / each) * Math.PI) / 8 / this.near[n] / DEGREE ** 2;
      /* The covariance times the metric times the covariance. */
      const [ax, ay, dx, dy] = [a * xx + b * xy, a * xy + b * yy, b * xx + d * xy, b * xy + d * yy];
      const turned = [ax * a + ay * b, ax * b + ay * d, dx * b + dy * d];
      for (let at = n * channels; at < (n + 1) * channels; at++) {
        const pulled = [turned[0] * x[at] + turned[1] * y[at], turned[1] * x[at] + turned[2] * y[at]];
        for (const i of [0, 1]) this.bySteep[i][at] = (-2 * pulled[i] * byTrace) / variance[at];
        this.byVariance[at] += ((pulled[0] * x[at] + pulled[1] * y[at]) * byTrace) / variance[at] ** 2;
      }
    }
  }

  slopesFar(each) {
    const { normals, channels, counts, variance, alike, apart, near, missed, total } = this;
    const chosen = (n, m) => ((apart[n * normals + m] || near[n]) - missed[n]) / total[n] / each;
    for (let n = 0; n < normals; n++) for (let m = 0; m < n; m++) {
      const pair = -0.5 * (chosen(n, m) + chosen(m, n)) * alike[n * normals + m];
      for (let c = 0; c < channels; c++) {
        const [i, j] = [n * channels + c, m * channels + c];
        const ratio = (counts[i] - counts[j]) / (variance[i] + variance[j]);
        this.byCounts[i] += 2 * pair * ratio;
        this.byCounts[j] -= 2 * pair * ratio;
        this.byVariance[i] -= pair * ratio ** 2;
        this.byVariance[j] -= pair * ratio ** 2;
      }
    }
  }
}
