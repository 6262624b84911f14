/* What the builder's limits leave, and the way uphill by a reader's degrees or S: exact slopes turn the
   lamps, 2-opt recolors them, until neither helps. */

/* Relative gain below which a round, or a change of colors, is not worth it. */
const LEAST_GAIN = 1e-4;
/* Changes of colors of which the best is taken, and how many are tried before lamps are turned again. */
const TRIED_AT_ONCE = 12, FIRST_TRIED = 120;

class Limits {
  constructor(page) {
    Object.assign(this, page.limits);
    this.color = page.limits.power;
    /* Lamps of each group, which have one color, or are all off. */
    this.tied = [...new Set(this.ties)].map((group) =>
      [...this.ties.keys()].filter((f) => this.ties[f] === group));
  }

  leads(f) { return this.leading[f] === f; }

  /* Directions, those of mirror images following their leading lamp. */
  mirrored(phi) {
    return phi.map((_, f) => this.reflected[f] ? Math.PI - phi[this.leading[f]] : phi[this.leading[f]]);
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

  /* Lamps that meet a neighbor or a corner in the holder, or whose image does. */
  crowded(phi) {
    const found = new Set();
    this.slack(phi).forEach((slack, i) => {
      if (slack < 0) for (const f of [this.holder.first[i], this.holder.last[i]]) if (f >= 0) found.add(this.leading[f]);
    });
    return new Set([...this.leading.keys()].filter((f) => found.has(this.leading[f])));
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
    const near = this.mirrored(Float64Array.from(phi, (angle, f) => this.nearest(f, angle)));
    const turns = new Float64Array(phi.length);
    let turned = near.slice();
    for (let pass = 0; pass < 16; pass++) {
      const crowded = this.crowded(turned);
      if (!crowded.size) break;
      for (const f of crowded) {
        turns[f] += 1;
        const upright = this.nearest(f, Math.PI / 2);
        turned[f] = this.nearest(f, upright + (1 - turns[f] / 16) * (near[f] - upright));
      }
      turned = this.mirrored(turned);
    }
    return turned;
  }

  /* Whether a coloring (color or OFF per lamp) uses allowed LEDs only, no more than there are and no more
     runs of one color along the ring (lamps that are off neither count nor split one), lights at most one
     lamp of a group that overlaps, keeps to counts and to budgets of current and price, and gives mirror
     images one color. */
  allows(colors) {
    const used = this.counts.map(() => 0), lit = (f) => colors[f] !== OFF;
    const ring = this.ring.filter(lit).map((f) => colors[f]);
    const changes = ring.filter((c, i) => c !== ring.at(i - 1)).length;
    return ring.length <= this.most && Math.max(changes, Math.min(ring.length, 1)) <= this.runs
      && this.groups.every((group) => group.filter(lit).length <= 1)
      && this.tied.every((group) => group.every((f) => colors[f] === colors[group[0]]))
      && this.budgets.every(({ cost, limit }) =>
        colors.reduce((sum, c, f) => sum + (cost[f][c === OFF ? this.color.length : c] ?? 0), 0) <= limit + 1e-6)
      && colors.every((c, f) => c === OFF || (this.allowed[f][c] && ++used[this.led[c]] <= this.counts[this.led[c]]));
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
    const image = this.mirrored(design.phi), off = (f, angle) => Math.abs(angle - design.phi[f]) > 1e-6;
    const turned = colors.map((_, f) => f)
      .filter((f) => off(f, this.nearest(f, design.phi[f])) || off(f, image[f]));
    if (turned.length) said.push(`The scene forbids these directions: fiber ${turned.join(", ")}.`);
    if (!this.allows(colors)) said.push("The scene allows other colors, fewer LEDs, fewer runs of one color, less current or price, one of lamps that overlap, other counts, or one color of mirror images.");
    return said;
  }
}

/* Climbs from a design in small steps; `advance` works for some milliseconds and says whether there
   is more to do, and `doing` what. */
class Climb {
  constructor(model, limits, goal, design) {
    [this.model, this.limits, this.goal] = [model, limits, goal];
    this.design = copyOf(design);
    this.design.phi = limits.settle(design.phi);
    this.fractions = Array.from(design.phi, (_, f) => {
      const c = colorOf(design, f);
      return c === OFF ? 1 : powersOf(design, f)[c] / limits.color[c];
    });
    this.value = goal.value(model.light.sum(this.design));
    this.evaluated = 1;
    this.doing = "";
    this.work = this.run();
  }

  advance(milliseconds) {
    const end = performance.now() + milliseconds;
    while (performance.now() < end) if (this.work.next().done) return false;
    return true;
  }

  * run() {
    do {
      let before;
      do {
        before = this.value;
        if (this.limits.step > 0) yield* this.stepTurns(); else yield* this.turn();
        while (yield* this.recolor(FIRST_TRIED));
      } while (this.gains(this.value, before));
    } while (yield* this.recolor(Infinity));
  }

  gains(value, before) { return value > before + LEAST_GAIN * Math.abs(before); }

  accept(design, value) { [this.design, this.value] = [design, value]; }

  /* Directions by resilient steps along the exact slopes (Riedmiller and Braun 1993): each lamp
     has a step that grows while its slope keeps its sign. There are kinks where facets clip, so the
     best design on the way is kept. */
  * turn() {
    const { model, limits, goal } = this, now = copyOf(this.design), count = now.phi.length;
    const last = new Float64Array(count);
    const step = last.map((_, f) => (limits.leads(f) && limits.low[f][0] < limits.high[f].at(-1) ? 0.03 : 0));
    this.doing = "turning the lamps";
    for (let i = 0; i < 300 && Math.max(...step) > 1e-5; i++) {
      const { value, byCounts } = goal.slopes(model.light.sum(now)), slope = model.along(now, byCounts).phi;
      limits.leading.forEach((lead, f) => {
        if (lead !== f) slope[lead] += limits.reflected[f] ? -slope[f] : slope[f];
      });
      this.evaluated++;
      if (value > this.value) this.accept(copyOf(now), value);
      const old = now.phi.slice();
      for (let f = 0; f < count; f++) {
        const agree = slope[f] * last[f];
        if (slope[f] === 0) { step[f] = 0; continue; }
        step[f] = agree < 0 ? step[f] / 2 : agree > 0 ? Math.min(step[f] * 1.3, 0.2) : step[f];
        last[f] = agree < 0 ? 0 : slope[f];
        if (agree >= 0) now.phi[f] = limits.nearest(f, old[f] + Math.sign(slope[f]) * step[f]);
      }
      now.phi = limits.mirrored(now.phi);
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
    const { model, limits, goal } = this;
    this.doing = "turning the lamps";
    for (let moved = true; moved;) {
      moved = false;
      for (let f = 0; f < this.design.phi.length; f++) for (const way of limits.leads(f) ? [-1, 1] : []) {
        const next = copyOf(this.design);
        next.phi[f] = limits.nearest(f, Math.min(Math.max(next.phi[f] + way * limits.step, 0), Math.PI));
        next.phi = limits.mirrored(next.phi);
        if (next.phi[f] === this.design.phi[f] || limits.crowded(next.phi).size) continue;
        const value = goal.value(model.light.sum(next));
        this.evaluated++;
        if (this.gains(value, this.value)) { this.accept(next, value); moved = true; }
        yield;
      }
    }
  }

  /* The first change of one lamp, or of two, that helps: to another color, or dark, or lit where it was
     dark. Dimmed lamps keep their part of the allowed power. At most so many are tried, in the order that
     the slopes foresee; returns whether one helped. */
  * recolor(most) {
    const { model, limits, goal } = this, { light } = model, { cells, channels, response } = light;
    const counts = Float64Array.from(light.sum(this.design)), rows = light.rows.slice();
    const moves = this.moves(counts), trial = new Float64Array(counts.length);
    let found = null, best = this.value;
    for (let i = 0; i < Math.min(moves.length, most); i++) {
      trial.set(counts);
      for (const { f, c } of moves[i].changes) for (let k = 0; k < channels; k++) {
        const lit = c === OFF ? 0 : this.fractions[f] * limits.color[c] * response[c][k];
        const p = lit - light.gain(this.design.power, f, k), first = f * light.width + light.tint(k);
        if (p) for (let j = 0; j < cells; j++) trial[channels * j + k] += p * rows[first + j];
      }
      const value = goal.value(trial);
      this.evaluated++;
      this.doing = `recoloring, ${i + 1} of ${moves.length} changes`;
      if (this.gains(value, best)) [found, best] = [moves[i], value];
      yield;
      if (found && (i + 1) % TRIED_AT_ONCE === 0) break;
    }
    if (!found) return false;
    const next = copyOf(this.design);
    for (const { f, c } of found.changes) {
      powersOf(next, f).fill(0);
      if (c !== OFF) powersOf(next, f)[c] = this.fractions[f] * limits.color[c];
    }
    this.accept(next, goal.value(light.sum(next)));
    return true;
  }

  /* Allowed changes of one lamp or two, by the gain that the slopes foresee. */
  moves(counts) {
    const { model, limits, design } = this, leds = limits.color.length;
    const slope = model.along(design, this.goal.slopes(counts).byCounts).power;
    const colors = Array.from(design.phi, (_, f) => colorOf(design, f));
    const gain = (f, c) => {
      let foreseen = c === OFF ? 0 : slope[leds * f + c] * this.fractions[f] * limits.color[c];
      for (let l = 0; l < leds; l++) foreseen -= slope[leds * f + l] * powersOf(design, f)[l];
      return foreseen;
    };
    const single = limits.tied.flatMap((group) => [OFF, ...limits.color.keys()]
      .filter((c) => group.some((f) => colors[f] !== c)).map((c) => ({
        group, changes: group.map((f) => ({ f, c })), foreseen: group.reduce((sum, f) => sum + gain(f, c), 0),
      })));
    const found = [];
    single.forEach((one, i) => {
      for (const other of [null, ...single.slice(i + 1)]) {
        if (other && other.group === one.group) continue;
        const changes = other ? [...one.changes, ...other.changes] : one.changes, next = colors.slice();
        for (const { f, c } of changes) next[f] = c;
        if (!limits.allows(next)) continue;
        found.push({ changes, foreseen: one.foreseen + (other ? other.foreseen : 0) });
      }
    });
    return found.sort((a, b) => b.foreseen - a.foreseen);
  }
}
