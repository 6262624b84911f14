/* The page's state and its controls. */

const page = JSON.parse(document.getElementById("page").textContent);
const model = new Model(page, decodeTables(document.getElementById("tables").textContent.trim(), page.tables));
const readers = new Readers(model, page.readers), limits = new Limits(page), leds = page.palette.names.length;
const goal = objectiveOf(page.objective, model, readers);
const find = (id) => document.getElementById(id);
const one = (value) => value.toFixed(1);

function designOf({ angles_deg, power }) {
  return { phi: Float64Array.from(angles_deg, (a) => Math.min(a * DEGREE, Math.PI)),
    power: Float64Array.from(power.flat()) };
}
/* S with its parts, and what both readers make of a design. */
function rate(design) {
  const counts = model.light.sum(design);
  return { ...model.rate(counts), ...readers.read(counts) };
}

/* What is climbed: degrees of a reader, where less is better, or S. */
const inDegrees = page.objective !== "score", better = inDegrees ? -1 : 1;
const figureOf = (rated) => rated[page.objective];
const degrees = (value) => `${value.toFixed(2)}°`;
/* Where a figure stands on the bar, %: what ten counts or a tenth of the baseline's degrees are is shown
   however little the optimum gains. */
function place(figure) {
  const [base, best] = [ratings.baseline, ratings.optimum].map(figureOf);
  const span = Math.max(Math.abs(best - base), inDegrees ? base / 10 : 10);
  return Math.min(Math.max(25 + (60 * better * (figure - base)) / span, 0), 100);
}

const known = { baseline: designOf(page.designs.baseline), optimum: designOf(page.designs.optimum) };
const ratings = { baseline: rate(known.baseline), optimum: rate(known.optimum) };
const heights = [...ratings.baseline.metric, ...ratings.optimum.metric];
const heatScale = [Math.min(...heights), Math.max(...heights)];
/* The link's form: 4 bytes of the scene's hash, then 16 bits for the angle and for each power. */
const mark = page.scene.hash.slice(0, 8);

const state = {
  mine: designOf(page.designs.start), show: "mine", selected: 0, bend: 0, shot: 0, touch: page.touches.length - 1,
  center: [0, 0], past: [], future: [], kept: null, climb: null, rated: null,
};
state.kept = copyOf(state.mine);
state.center = page.sites[Math.floor(page.sites.length / 2)].slice();

const shownDesign = () => (state.show === "mine" ? state.mine : known[state.show]);

/* ---- changes, and taking them back ---- */

function edit(change) {
  stop();
  if (state.show !== "mine") [state.mine, state.show] = [copyOf(known[state.show]), "mine"];
  change(state.mine);
  redraw();
}

function same(a, b) {
  return a.phi.every((v, i) => v === b.phi[i]) && a.power.every((v, i) => v === b.power[i]);
}

/* The end of a gesture: one step of undo, and the link. */
function keep() {
  if (same(state.kept, state.mine)) return;
  state.past.push(state.kept);
  state.future = [];
  state.kept = copyOf(state.mine);
  settle();
}

function settle() {
  history.replaceState(null, "", `#${linkOf(state.mine)}`);
  redraw();
  announce();
}

function travel(from, to) {
  if (!from.length) return;
  stop();
  to.push(state.kept);
  state.kept = from.pop();
  [state.mine, state.show] = [copyOf(state.kept), "mine"];
  settle();
}

const act = {
  shown: shownDesign,
  center: () => state.center,
  select(f) { if (state.selected !== f) { state.selected = f; redraw(); } },
  turn(f, phi, ended) {
    if (phi !== null && page.fibers[f].turns) edit((design) => { design.phi[f] = Math.min(Math.max(phi, 0), Math.PI); });
    if (ended) keep();
  },
  recolor(f, color) {
    edit((design) => {
      /* After the last LED comes OFF, then the first. */
      const old = colorOf(design, f), next = color === null ? ((old + 2) % (leds + 1)) - 1 : color;
      const powers = powersOf(design, f), part = old === OFF ? 1 : powers[old] / limits.color[old];
      powers.fill(0);
      if (next !== OFF) powers[next] = part * limits.color[next];
    });
    keep();
  },
  power(f, change, ended = true) {
    const c = colorOf(shownDesign(), f);
    if (c === OFF) return;
    const part = powersOf(shownDesign(), f)[c] / limits.color[c];
    act.dim(f, Math.round(100 * (part + change)) / 100, ended);
  },
  /* A part of the allowed power; a lamp that is not off keeps its color. */
  dim(f, part, ended) {
    edit((design) => {
      const c = colorOf(design, f);
      if (c === OFF) return;
      const powers = powersOf(design, f), old = powers[c];
      const next = Math.min(Math.max(part, 0.01), 1) * limits.color[c];
      for (let l = 0; l < leds; l++) powers[l] *= next / old;
    });
    if (ended) keep();
  },
  move(center) {
    const touch = page.touches[state.touch];
    if (!touch || !center) return;
    const half = [page.pad.width / 2, page.pad.length / 2].map((h) => Math.max(h - touch.reach, 0));
    state.center = center.map((v, i) => Math.min(Math.max(v, -half[i]), half[i]));
    redraw();
  },
};

/* ---- uphill ---- */

function climbOn() {
  if (!state.climb) return;
  const { design } = state.climb, more = state.climb.advance(30);
  if (state.climb.design !== design) {
    state.mine = copyOf(state.climb.design);
    redraw();
  }
  const { value, evaluated, doing } = state.climb, reached = inDegrees ? degrees(-value) : one(value);
  find("uphill-said").textContent = `${reached} after ${evaluated.toLocaleString("en")} designs`
    + (more ? `, ${doing}` : "");
  if (more) setTimeout(climbOn);
  else stop("Nothing nearby is better: to turn one lamp, or to recolor, light or darken two, does not help.");
}

function stop(said = "") {
  if (!state.climb) return;
  state.climb = null;
  find("uphill").textContent = "Push uphill";
  if (said) find("uphill-said").textContent += `. ${said}`;
  keep();
}

find("uphill").addEventListener("click", () => {
  if (state.climb) { stop("Stopped."); return; }
  if (state.show !== "mine") [state.mine, state.show] = [copyOf(known[state.show]), "mine"];
  state.climb = new Climb(model, limits, goal, state.mine);
  state.mine = copyOf(state.climb.design);
  redraw();
  find("uphill").textContent = "Stop";
  climbOn();
});

/* ---- links and files ---- */

function linkOf(design) {
  const numbers = [];
  for (let f = 0; f < model.fibers; f++)
    numbers.push(design.phi[f] / Math.PI, ...powersOf(design, f));
  const bytes = [0, 2, 4, 6].map((i) => parseInt(mark.slice(i, i + 2), 16));
  for (const v of numbers) {
    const whole = Math.round(65535 * v);
    bytes.push(whole >> 8, whole & 255);
  }
  return btoa(String.fromCharCode(...bytes)).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}

/* The design of a link; null where the link has none, an error where it is no design of this page. */
function designOfLink(text) {
  if (!text) return null;
  let raw;
  try { raw = atob(text.replaceAll("-", "+").replaceAll("_", "/")); } catch { raw = ""; }
  const bytes = Array.from(raw, (c) => c.charCodeAt(0));
  const hash = bytes.slice(0, 4).map((b) => b.toString(16).padStart(2, "0")).join("");
  const each = 1 + leds;
  if (bytes.length !== 4 + 2 * each * model.fibers) throw new Error("is damaged");
  if (hash !== mark) throw new Error("is for another sensor");
  const value = (i) => (256 * bytes[4 + 2 * i] + bytes[5 + 2 * i]) / 65535;
  const design = { phi: new Float64Array(model.fibers), power: new Float64Array(leds * model.fibers) };
  for (let f = 0; f < model.fibers; f++) {
    design.phi[f] = value(each * f) * Math.PI;
    for (let l = 0; l < leds; l++) design.power[leds * f + l] = value(each * f + 1 + l);
  }
  return design;
}

function openLink() {
  try {
    const design = designOfLink(location.hash.slice(1));
    if (!design) return;
    edit((mine) => Object.assign(mine, design));
    keep();
  } catch (error) {
    find("said").textContent = `The design in the link ${error.message}, so it is left out.`;
  }
}

/* What tactilux reads: optimize.design.design_file. */
function designFile(design) {
  const rated = rate(design), half = page.halfWidth, fibers = Array.from(design.phi, (_, f) => f);
  return {
    schema: 2, scene: page.scene.name, scene_hash: page.scene.hash,
    angles_deg: fibers.map((f) => Math.min(design.phi[f] / DEGREE, 180)),
    colors: fibers.map((f) => nameOf(page.palette, colorOf(design, f))),
    power: fibers.map((f) => Array.from(powersOf(design, f))),
    ...page.paletteInFile,
    level: page.level,
    effort: page.effort,
    score: { value: rated.score, interval: [rated.score - half, rated.score + half], mean: rated.mean,
      spread_sites: rated.spreadSites, spread_bends: rated.spreadBends },
    read: { reader_error_deg: rated.sensor, normal_error_deg: rated.place, exposure_factor: rated.factor,
      gain: rated.gain },
    lam: page.metric.lam, exposure: page.metric.exposure, conventions: page.metric.conventions,
    versions: page.versions,
  };
}

find("save").addEventListener("click", () => {
  const text = `${JSON.stringify(designFile(shownDesign()), null, 2)}\n`, link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  link.download = `${page.scene.name}-design.json`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  find("said").textContent = `Saved as ${link.download}: tactilux verify ${link.download} proves it.`;
});

find("share").addEventListener("click", async () => {
  const address = `${location.href.split("#")[0]}#${linkOf(shownDesign())}`;
  history.replaceState(null, "", address);
  try {
    await navigator.clipboard.writeText(address);
    find("said").textContent = "Copied: the link holds this design, for whoever has this page.";
  } catch {
    find("said").textContent = "The address of this page now holds the design: copy it from there.";
  }
});

/* ---- controls ---- */

find("undo").addEventListener("click", () => travel(state.past, state.future));
find("redo").addEventListener("click", () => travel(state.future, state.past));
document.addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z") return;
  if (event.shiftKey) travel(state.future, state.past); else travel(state.past, state.future);
  event.preventDefault();
});
function choices(host, name, titles, chosen) {
  titles.forEach((title, i) => {
    const label = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "radio", name, value: i });
    input.addEventListener("change", () => chosen(i));
    label.append(input, Object.assign(document.createElement("span"), { textContent: title }));
    host.append(label);
  });
  return (i) => { host.querySelectorAll("input")[i].checked = true; };
}
const shows = ["mine", "baseline", "optimum"];
const checkShow = choices(find("show"), "show", ["Yours", "Baseline", "Optimum"], (i) => {
  stop();
  state.show = shows[i];
  redraw();
  announce();
});
// A sensor whose skin has one shape has no choice of it.
const checkBend = page.axis.word === "" ? () => {} : choices(find("bend"), "bend", page.axis.titles,
  (i) => { state.bend = i; redraw(); announce(); });
const checkShot = choices(find("shot"), "shot", Array.from({ length: page.palette.shots }, (_, i) => i + 1),
  (i) => { state.shot = i; redraw(); });
const checkTouch = choices(find("touch"), "touch", [...page.touches.map((t) => t.title), "Nothing"],
  (i) => { state.touch = i; act.move(state.center); redraw(); });
const checkColor = choices(find("color"), "color", [...page.palette.letters, "Off"],
  (i) => act.recolor(state.selected, i < leds ? i : OFF));
find("color").querySelectorAll("label").forEach((label, i) => {
  const color = i < leds ? i : OFF;
  label.className = nameOf(page.palette, color);
  tint(label, page.palette, color);
  label.querySelector("input").setAttribute("aria-label", label.className);
});
for (const [id, change] of [
  ["angle", (value, ended) => act.turn(state.selected, value * DEGREE, ended)],
  ["power", (value, ended) => act.dim(state.selected, value / 100, ended)],
]) {
  find(id).addEventListener("input", (event) => change(Number(event.target.value), false));
  find(id).addEventListener("change", () => keep());
}
for (const [id, way] of [["before", -1], ["after", 1]]) find(id).addEventListener("click", () => {
  act.select((state.selected + way + model.fibers) % model.fibers);
});
/* The camera's picture moves the touch, too. */
{
  const canvas = find("camera");
  let last = null;
  canvas.addEventListener("pointerdown", (event) => {
    last = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!last) return;
    const scale = page.pad.length / canvas.clientHeight;
    act.move([state.center[0] + (event.clientX - last[0]) * scale,
      state.center[1] - (event.clientY - last[1]) * scale]);
    last = [event.clientX, event.clientY];
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { last = null; });
}

/* ---- drawing ---- */

const sensor = new SensorView(find("sensor"), page, act);
const facetMap = new SiteMap(find("facets"), page), heatMap = new SiteMap(find("heat"), page);
const camera = new Camera(find("camera"), page);
find("camera").style.aspectRatio = `${page.camera.columns} / ${page.camera.rows}`;
find("no-camera").hidden = Boolean(camera.gl);
[find("low").textContent, find("high").textContent] = heatScale.map(Math.round);

let waiting = 0;
function redraw() { waiting ||= requestAnimationFrame(() => { waiting = 0; draw(); }); }

/* What the shot that is shown sees of a design at one bend or state, in unclipped counts (the skin: irradiance), as red,
   green and blue of a screen. */
function seen(design, bend, touch, center) {
  const { display, shots } = page.palette, channels = shots * display.length, own = state.shot * display.length;
  const at = (values, size) => {
    const out = new Float64Array(3 * size), first = channels * bend * size + own;
    for (let i = 0; i < size; i++) for (let k = 0; k < 3; k++) for (let c = 0; c < display.length; c++)
      out[3 * i + k] += values[first + channels * i + c] * display[c][k];
    return out;
  };
  const { sites, patches } = model, light = at(model.light.sum(design), sites * patches);
  return {
    facets: light.filter((_, i) => Math.floor(i / 3) % patches !== patches - 1),
    flat: light.filter((_, i) => Math.floor(i / 3) % patches === patches - 1),
    skin: at(model.skin.sum(design), page.skinShape[0] * page.skinShape[1]),
    bend: page.bends[bend], shape: Math.min(bend, page.skins.length - 1), touch, center,
  };
}

function draw() {
  const design = shownDesign(), { countMax } = page.metric, touch = page.touches[state.touch];
  const rated = (state.rated = rate(design));
  const scene = seen(design, state.bend, touch, state.center);
  sensor.draw({ design, selected: state.selected, fullPower: limits.color, skin: scene.skin, touch,
    center: state.center, countMax: (countMax * Math.PI * page.pad.index ** 2) / page.camera.albedo });
  facetMap.facets(scene.facets, countMax);
  heatMap.heat(rated.metric.subarray(state.bend * model.sites, (state.bend + 1) * model.sites), heatScale);
  drawCamera(scene);
  drawScore(design, rated);
  drawControls(design);
}

function drawCamera(scene) {
  const canvas = find("camera"), wide = Math.round(canvas.clientWidth * Math.min(window.devicePixelRatio || 1, 2));
  const high = Math.round((wide * page.camera.rows) / page.camera.columns);
  if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
  camera.draw(scene);
}

function drawScore(design, rated) {
  const half = page.halfWidth, gain = figureOf(rated) - figureOf(ratings.baseline), write = inDegrees ? degrees : one;
  /* S alone has an interval. */
  const least = inDegrees ? 0.005 : 0.05, sure = inDegrees ? least : 2 * half;
  find("figure-sensor").textContent = degrees(rated.sensor);
  find("figure-place").textContent = degrees(rated.place);
  find("figure-score").textContent = one(rated.score);
  find("interval").textContent = `${one(rated.score - half)} to ${one(rated.score + half)}`;
  find("gain").textContent = Math.abs(gain) < least ? "as the baseline"
    : `${gain > 0 ? "+" : "−"}${write(Math.abs(gain))} against the baseline`;
  find("gain").className = better * gain > sure ? "better" : better * gain < -sure ? "worse" : "";
  find("mean").textContent = one(rated.mean);
  find("spread-sites").textContent = one(rated.spreadSites);
  if (page.axis.word !== "") find("spread-bends").textContent = one(rated.spreadBends);
  find("marker").style.left = `${place(figureOf(rated))}%`;
  find("band").hidden = inDegrees;
  find("band").style.left = `${place(rated.score - half)}%`;
  find("band").style.width = `${place(rated.score + half) - place(rated.score - half)}%`;
  const said = limits.problems(design), colors = new Set(Array.from(design.phi, (_, f) => colorOf(design, f)));
  if (colors.size === 1 && (colors.has(OFF) || (design.phi.length > 1 && !page.palette.oneHue))) said.push(colors.has(OFF)
    ? "All lamps are off."
    : "One color lights everything: S may like it, but nobody can read azimuths from it.");
  if (rated.clipped > page.clipped) said.push(`At the scene's exposure ${(100 * rated.clipped).toFixed(0)} % of `
    + "the facets saturate the camera.");
  const shown = said.slice(0, 3).join(" ") + (said.length > 3 ? ` And ${said.length - 3} more.` : "");
  if (find("problems").textContent !== shown) find("problems").textContent = shown;
}

function drawControls(design) {
  const f = state.selected, color = colorOf(design, f), fiber = page.fibers[f];
  const part = color === OFF ? 0 : powersOf(design, f)[color] / limits.color[color];
  const degrees = design.phi[f] / DEGREE;
  find("lamp-name").textContent = `Fiber ${f}, ${fiber.edge}`;
  checkColor(color === OFF ? leds : color);
  checkShow(shows.indexOf(state.show));
  find("angle").value = degrees;
  find("angle").disabled = !fiber.turns;
  find("angle-said").textContent = `${degrees.toFixed(0)}°`;
  find("power").value = Math.round(100 * part);
  find("power").disabled = color === OFF;
  find("power-said").textContent = color === OFF ? "off" : `${Math.round(100 * part)} %`;
  find("undo").disabled = !state.past.length;
  find("redo").disabled = !state.future.length;
}

let pause = 0;
const IN_STATE = { "": "", bend: " at this bend", state: " in this state" };
function announce() {
  clearTimeout(pause);
  pause = setTimeout(() => {
    const rated = state.rated, base = ratings.baseline;
    const metric = rated.metric.subarray(state.bend * model.sites, (state.bend + 1) * model.sites);
    find("spoken").textContent = `Sensor reader ${degrees(rated.sensor)}, place reader ${degrees(rated.place)}, `
      + `score ${one(rated.score)}; baseline ${degrees(base.sensor)}, ${degrees(base.place)}, ${one(base.score)}.`;
    find("heat").setAttribute("aria-label", `Metric M over the sites, from ${Math.round(Math.min(...metric))} `
      + `to ${Math.round(Math.max(...metric))} counts${IN_STATE[page.axis.word]}`);
  }, 300);
}

const ends = [ratings.baseline, ratings.optimum].map((rated) => place(figureOf(rated)));
document.querySelector(".meter").classList.toggle("apart", Math.abs(ends[1] - ends[0]) > 30);
for (const name of ["baseline", "optimum"])
  document.querySelector(`.tick.${name}`).style.left = `${place(figureOf(ratings[name]))}%`;
checkBend(0);
checkShot(0);
checkTouch(state.touch);
openLink();
draw();
announce();
window.addEventListener("hashchange", openLink);
new ResizeObserver(redraw).observe(document.body);

/* For programs: score and degrees of a design as this page has them. */
window.tactilux = {
  rate: (angles_deg, power) => rate(designOf({ angles_deg, power })),
  design: () => designFile(shownDesign()),
  /* Whether lamps may have these colors, -1 for off. */
  allows: (colors) => limits.allows(colors),
  /* Slopes of the objective by directions, per rad, and by the power of LEDs. */
  slopes: (angles_deg, power) => {
    const design = designOf({ angles_deg, power }), { byCounts } = goal.slopes(model.light.sum(design));
    const { phi, power: byPower } = model.along(design, byCounts);
    return { phi: Array.from(phi), power: Array.from(byPower) };
  },
  climbing: () => Boolean(state.climb),
  /* The camera's picture as a PNG in a data URL, of a touch (its number) at a place in mm. */
  picture: (touch, bend, center, width, height) => {
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    new Camera(canvas, page).draw(seen(shownDesign(), bend, page.touches[touch], center));
    return canvas.toDataURL();
  },
};
