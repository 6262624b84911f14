/* What the builder's limits leave, and the way uphill: exact slopes turn the lamps, 2-opt recolors
   them, until neither helps. */

class Limits {
  constructor(page) {
    Object.assign(this, page.limits);
    this.color = page.limits.power;
  }

  /* Wall (mm) between holes of neighbors beyond the least one, per border, as
     render.geometry.holder has it. */
  slack(phi) {
    const h = this.holder;
    const faces = [0, h.thickness].map((depth) => {
      const at = Array.from(phi, (angle, f) => {
        const sin = Math.max(Math.sin(angle), h.leastSine);
        return { half: h.hole[f] / 2 / sin, place: h.place[f] - (depth * h.turns[f] * Math.cos(angle)) / sin };
      });
      return h.first.map((first, i) => {
        const last = h.last[i];
        const begin = first < 0 ? h.corner[i] - depth : at[first].place + at[first].half;
        const end = last < 0 ? h.corner[i] + depth : at[last].place - at[last].half;
        return end - begin;
      });
    });
    return h.least.map((least, i) => Math.min(faces[0][i], faces[1][i]) - least);
  }

  crowded(phi) {
    const found = new Set();
    this.slack(phi).forEach((slack, i) => {
      if (slack < 0) for (const f of [this.holder.first[i], this.holder.last[i]]) if (f >= 0) found.add(f);
    });
    return found;
  }

  /* The allowed direction next to `angle` for a lamp, whatever its neighbors do. */
  nearest(f, angle) {
    let best = NaN;
    this.low[f].forEach((low, i) => {
      const high = this.high[f][i];
      let near = Math.min(Math.max(angle, low), high);
      if (this.step > 0 && low < high) {
        const lowest = Math.ceil(low / this.step - 1e-9), highest = Math.floor(high / this.step + 1e-9);
        if (lowest > highest) return;
        near = Math.min(Math.max(Math.round(near / this.step), lowest), highest) * this.step;
      }
      near = Math.min(near, Math.PI);
      if (!(Math.abs(near - angle) >= Math.abs(best - angle))) best = near;
    });
    return best;
  }

  /* Allowed directions near `phi`: crowded lamps are turned towards the normal of their edge. */
  settle(phi) {
    const near = Float64Array.from(phi, (angle, f) => this.nearest(f, angle));
    const turns = new Float64Array(phi.length), turned = near.slice();
    for (let pass = 0; pass < 16; pass++) {
      const crowded = this.crowded(turned);
      if (!crowded.size) break;
      for (const f of crowded) {
        turns[f] += 1;
        const upright = this.nearest(f, Math.PI / 2);
        turned[f] = this.nearest(f, upright + (1 - turns[f] / 16) * (near[f] - upright));
      }
    }
    return turned;
  }

  /* Whether a coloring (color or OFF per lamp) uses allowed LEDs only, and no more than there are. */
  allows(colors) {
    const used = this.counts.map(() => 0);
    return colors.every((c, f) => c === OFF || (this.allowed[f][c] && ++used[c] <= this.counts[c]));
  }

  /* What of a design cannot be built, in sentences. */
  problems(design) {
    const said = [], colors = Array.from(design.phi, (_, f) => colorOf(design, f));
    const { first, last } = this.holder;
    this.slack(design.phi).forEach((slack, i) => {
      if (slack >= 0) return;
      const who = [first[i], last[i]].filter((f) => f >= 0);
      said.push(who.length === 2 ? `Fibers ${who[0]} and ${who[1]} meet in the holder.`
        : `Fiber ${who[0]} meets the corner of the holder.`);
    });
    const turned = colors.map((_, f) => f)
      .filter((f) => Math.abs(this.nearest(f, design.phi[f]) - design.phi[f]) > 1e-6);
    if (turned.length) said.push(`The scene forbids these directions: fiber ${turned.join(", ")}.`);
    if (!this.allows(colors)) said.push("The scene allows other colors, or fewer LEDs of one color.");
    return said;
  }
}

/* Climbs from a design in small steps; `advance` works for some milliseconds and says whether there
   is more to do. */
class Climb {
  constructor(model, limits, design) {
    [this.model, this.limits] = [model, limits];
    this.design = copyOf(design);
    this.design.phi = limits.settle(design.phi);
    this.fractions = Array.from(design.phi, (_, f) => {
      const c = colorOf(design, f);
      return c === OFF ? 1 : powersOf(design, f)[c] / limits.color[c];
    });
    this.score = model.rate(model.light.sum(this.design)).score;
    this.evaluated = 1;
    this.work = this.run();
  }

  advance(milliseconds) {
    const end = performance.now() + milliseconds;
    while (performance.now() < end) if (this.work.next().done) return false;
    return true;
  }

  * run() {
    for (let before = -Infinity; this.score > before + 1e-6;) {
      before = this.score;
      if (this.limits.step > 0) yield* this.stepTurns(); else yield* this.turn();
      yield* this.recolor();
    }
  }

  accept(design, score) { [this.design, this.score] = [design, score]; }

  /* Directions by resilient steps along the exact slopes (Riedmiller and Braun 1993): each lamp
     has a step that grows while its slope keeps its sign. S has kinks where facets clip, so the
     best design on the way is kept. */
  * turn() {
    const { model, limits } = this, now = copyOf(this.design), count = now.phi.length;
    const step = new Float64Array(count).fill(0.03), last = new Float64Array(count);
    for (let i = 0; i < 300 && Math.max(...step) > 1e-5; i++) {
      const at = model.climbing(now);
      this.evaluated++;
      if (at.score > this.score) this.accept(copyOf(now), at.score);
      const old = now.phi.slice();
      for (let f = 0; f < count; f++) {
        const agree = at.phi[f] * last[f];
        if (at.phi[f] === 0) { step[f] = 0; continue; }
        step[f] = agree < 0 ? step[f] / 2 : agree > 0 ? Math.min(step[f] * 1.3, 0.2) : step[f];
        last[f] = agree < 0 ? 0 : at.phi[f];
        if (agree >= 0) now.phi[f] = limits.nearest(f, old[f] + Math.sign(at.phi[f]) * step[f]);
      }
      /* Neighbors that would meet in the holder stay where they were. */
      for (let crowded = limits.crowded(now.phi), n = 0; crowded.size && n < count; n++) {
        for (const f of crowded) { now.phi[f] = old[f]; step[f] /= 2; last[f] = 0; }
        crowded = limits.crowded(now.phi);
      }
      yield;
    }
  }

  /* Directions on steps: one lamp after the other tries the next step on either side. */
  * stepTurns() {
    const { model, limits } = this;
    for (let moved = true; moved;) {
      moved = false;
      for (let f = 0; f < this.design.phi.length; f++) for (const way of [-1, 1]) {
        const next = copyOf(this.design);
        next.phi[f] = limits.nearest(f, Math.min(Math.max(next.phi[f] + way * limits.step, 0), Math.PI));
        if (limits.crowded(next.phi).size) continue;
        const { score } = model.rate(model.light.sum(next));
        this.evaluated++;
        if (score > this.score + 1e-9) { this.accept(next, score); moved = true; }
        yield;
      }
    }
  }

  /* The best change of one lamp, or of two, as long as one helps: to another color, or dark, or lit
     where it was dark. Dimmed lamps keep their part of the allowed power. */
  * recolor() {
    const { model, limits } = this, { light } = model, { cells, channels, response } = light;
    const choices = [OFF, ...response.keys()], lamps = [...this.fractions.keys()];
    for (;;) {
      const counts = Float64Array.from(light.sum(this.design));
      const colors = Array.from(this.design.phi, (_, f) => colorOf(this.design, f));
      const moves = lamps.flatMap((f) => choices.filter((c) => c !== colors[f]).map((c) => ({ f, c })));
      const trial = new Float64Array(counts.length);
      const change = (out, { f, c }) => {
        const row = light.rows.subarray(f * light.width, (f + 1) * light.width);
        for (let k = 0; k < channels; k++) {
          const lit = c === OFF ? 0 : this.fractions[f] * limits.color[c] * response[c][k];
          const p = lit - light.gain(this.design.power, f, k), first = light.tint(k);
          if (p) for (let i = 0; i < cells; i++) out[channels * i + k] += p * row[first + i];
        }
      };
      let best = null, bestScore = this.score + 1e-6;
      for (let i = 0; i < moves.length; i++) {
        const single = counts.slice();
        change(single, moves[i]);
        for (let j = i; j < moves.length; j++) {
          if (j > i && moves[j].f === moves[i].f) continue;
          const made = j > i ? [moves[i], moves[j]] : [moves[i]];
          const next = colors.slice();
          for (const { f, c } of made) next[f] = c;
          if (limits.allows(next)) {
            trial.set(single);
            if (j > i) change(trial, moves[j]);
            const { score } = model.rate(trial);
            this.evaluated++;
            if (score > bestScore) [best, bestScore] = [made, score];
          }
          yield;
        }
      }
      if (!best) return;
      const next = copyOf(this.design);
      for (const { f, c } of best) {
        powersOf(next, f).fill(0);
        if (c !== OFF) powersOf(next, f)[c] = this.fractions[f] * limits.color[c];
      }
      this.accept(next, model.rate(light.sum(next)).score);
      yield;
    }
  }
}
