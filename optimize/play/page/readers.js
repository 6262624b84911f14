/* What a design is worth in degrees, by both readers at the design's own exposure, with exact slopes
   (optimize.readers.camera_model, optimize.search.reader_objective). Colors are counts (bend, site,
   facet or pad, channel). */

class CameraModel {
  constructor(facts) { Object.assign(this, facts); }

  /* Variance of noise and rounding, counts squared. */
  variance(count, gain) {
    if (count >= this.fullScale) return 0;
    return (this.read * gain) ** 2 + Math.max(count, 0) * this.shot * gain + this.rounding;
  }

  /* The slope of `variance` by the gain. */
  byGain(count, gain) { return 2 * this.read ** 2 * gain + this.shot * count; }

  /* Factor over the scene's exposure at which few colors saturate, and the camera's gain. */
  exposed(counts) {
    const rank = Math.ceil((1 - this.saturated) * counts.length) - 1;
    const brightest = Float64Array.from(counts).sort()[rank];
    const factor = brightest > 0 ? this.fullScale / brightest : 1;
    const time = Math.min(factor, this.longest) / this.shots, enough = factor / time;
    if (!this.gains.length) return { factor, gain: enough, brightest };
    /* The least that is enough; what is darker than the greatest allows stays dark. */
    const gain = this.gains.find((step) => step >= enough * (1 - 1e-12)) ?? this.gains.at(-1);
    return { factor: Math.min(factor, gain * time), gain, brightest };
  }
}

/* The sphere's metric over the parts of a normal along x and y: xx, xy, yy. */
function sphereMetric(x, y) {
  const square = 1 - x * x - y * y;
  return [1 + (x * x) / square, (x * y) / square, 1 + (y * y) / square];
}

class Readers {
  constructor(model, { camera, sensor, place }) {
    this.camera = new CameraModel(camera);
    this.errors = { sensor: new SensorError(model, this.camera, sensor),
      place: new PlaceError(model, this.camera, place) };
  }

  exposed(counts) {
    const found = this.camera.exposed(counts);
    return { ...found, colors: Float64Array.from(counts, (v) => found.factor * Math.max(v, 0)) };
  }

  /* Degrees by which each reader misses normals, and the exposure. */
  read(counts) {
    const { colors, factor, gain } = this.exposed(counts), { sensor, place } = this.errors;
    return { sensor: sensor.degrees(colors, gain), place: place.degrees(colors, gain), factor, gain };
  }

  degrees(name, counts) {
    const { colors, gain } = this.exposed(counts);
    return this.errors[name].degrees(colors, gain);
  }

  /* Degrees, and their slopes by counts at the scene's exposure. */
  slopes(name, counts) {
    const { colors, factor, gain, brightest } = this.exposed(counts);
    const { degrees, byColors, byGain } = this.errors[name].slopes(colors, gain);
    const { gains, longest, shots, fullScale } = this.camera;
    let byFactor = gain > shots * (1 + 1e-12) && !gains.length ? (byGain * shots) / longest : 0;
    for (let i = 0; i < counts.length; i++) byFactor += byColors[i] * counts[i];
    for (let i = 0; i < counts.length; i++) byColors[i] *= factor;
    /* The exposure is full scale over the count that decides it, unless the camera cannot reach it. */
    const reached = factor * brightest > (1 - 1e-9) * fullScale || fullScale < longest * brightest;
    if (brightest > 0 && reached) byColors[counts.indexOf(brightest)] -= (byFactor * factor) / brightest;
    return { degrees, byCounts: byColors };
  }
}

/* What is climbed: minus the degrees of a reader, or S; slopes are by counts. */
function objectiveOf(name, model, readers) {
  if (name === "score") return { value: (counts) => model.rate(counts).score,
    slopes: (counts) => model.scoreSlopes(counts) };
  return {
    value: (counts) => -readers.degrees(name, counts),
    slopes: (counts) => {
      const { degrees, byCounts } = readers.slopes(name, counts);
      return { value: -degrees, byCounts: byCounts.map((v) => -v) };
    },
  };
}
