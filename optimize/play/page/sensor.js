/* The sensor from above: SVG over a canvas of light, every lamp a slider that can be turned. */

const SVG = "http://www.w3.org/2000/svg";
const DEGREE = Math.PI / 180;

function element(name, attributes = {}, parent = null, text = "") {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

function nameOf({ names }, color) { return color === OFF ? "off" : names[color]; }

/* The color of an LED, for the page's style. */
function tint(part, { inks }, color) { part.style.setProperty("--led", color === OFF ? "" : inks[color]); }

/* Linear counts to the screen's 8 bits (IEC 61966-2-1). */
function encode(count, countMax) {
  const x = Math.min(Math.max(count / countMax, 0), 1);
  return Math.round(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055));
}

class SensorView {
  /* `act` has turn(f, phi, ended), recolor(f, color), power(f, change), select(f),
     move(center, ended), and knows shown(), the design, and center() of the touch. */
  constructor(host, page, act) {
    [this.page, this.act, this.host] = [page, act, host];
    const { pad, fibers } = page, reach = this.reach = page.beam;
    const out = Math.max(pad.width / 2, ...fibers.map((f) => Math.abs(f.x))) + 2.1;
    const top = Math.max(...fibers.map((f) => f.y), pad.length / 2) + 2.1;
    const bottom = Math.max(pad.length / 2 + 1.2, ...fibers.map((f) => 2.1 - f.y));
    this.box = { x: -out, y: -top, width: 2 * out, height: top + bottom };
    this.svg = element("svg", { viewBox: `${-out} ${-top} ${2 * out} ${top + bottom}`, role: "group",
      "aria-label": "The sensor from outside, tip up, with its lamps" });
    host.style.aspectRatio = `${2 * out} / ${top + bottom}`;
    this.canvas = document.createElement("canvas");
    [this.canvas.height, this.canvas.width] = page.skinShape;
    this.canvas.setAttribute("aria-hidden", "true");
    host.append(this.canvas, this.svg);
    Object.assign(this.canvas.style, {
      left: `${(100 * (out - pad.width / 2)) / (2 * out)}%`, width: `${(50 * pad.width) / out}%`,
      top: `${(100 * (top - pad.length / 2)) / (top + bottom)}%`,
      height: `${(100 * pad.length) / (top + bottom)}%`,
    });
    const shades = element("defs", {}, this.svg);
    page.palette.names.forEach((name, color) => {
      const shade = element("radialGradient", { id: `beam-${name}`, gradientUnits: "userSpaceOnUse",
        cx: 0, cy: 0, r: reach * 1.25 }, shades);
      for (const [offset, kind] of [[0, "stop"], [1, "stop end"]])
        tint(element("stop", { offset, class: kind }, shade), page.palette, color);
    });
    this.frame();
    this.lamps = fibers.map((fiber, f) => this.lamp(fiber, f));
    this.touch = this.touchMark();
  }

  frame() {
    const { pad, sites } = this.page, [left, tip, right, base] = pad.rims;
    const box = (x, y, width, height) => `M${x} ${y}h${width}v${height}h${-width}Z`;
    if (left + tip + right + base) element("path", { class: "rim", "fill-rule": "evenodd", d:
      box(-pad.width / 2 - left, -pad.length / 2 - tip, left + pad.width + right, tip + pad.length + base)
      + box(-pad.width / 2, -pad.length / 2, pad.width, pad.length) }, this.svg);
    element("rect", { class: "pad", x: -pad.width / 2, y: -pad.length / 2, width: pad.width,
      height: pad.length }, this.svg);
    for (const [x, y] of sites) element("circle", { class: "site", cx: x, cy: -y, r: 0.16 }, this.svg);
    element("text", { class: "edge-name", x: 0, y: pad.length / 2 - 0.5 }, this.svg, "base");
  }

  lamp(fiber, f) {
    const { edge } = fiber;
    const group = element("g", { class: "lamp", tabindex: 0, role: "slider", "aria-valuemin": 0,
      "aria-valuemax": 180, transform: `translate(${fiber.x} ${-fiber.y})` }, this.svg);
    const beam = element("path", { class: "beam" }, group);
    const stem = element("line", { class: "stem", x1: 0, y1: 0 }, group);
    element("circle", { class: "grip", r: 1.75 }, group);
    const tip = element("circle", { class: "tip", r: 0.42 }, group);
    const reachable = element("circle", { class: "grip", r: 1.3 }, group);
    element("circle", { class: "ring", r: 1.18 }, group);
    const bulb = element("circle", { class: "bulb", r: 0.92 }, group);
    const letter = element("text", { class: "letter", y: 0.39 }, group);
    const flat = Math.hypot(...fiber.inward) > 0.5;
    const [ox, oy] = flat ? [-1.75 * fiber.inward[0], 1.75 * fiber.inward[1]] : [0, 1.75];
    element("text", { class: "number", x: ox, y: oy + 0.3 }, group, String(f));
    const parts = { group, beam, stem, tip, reachable, bulb, letter, edge };
    this.drag(group, (x, y) => {
      const [dx, dy] = [x - fiber.x, y - fiber.y];
      if (!fiber.turns || Math.hypot(dx, dy) < 0.9) return;
      const along = dx * fiber.along[0] + dy * fiber.along[1];
      const inward = dx * fiber.inward[0] + dy * fiber.inward[1];
      const phi = Math.atan2(inward, along);
      this.act.turn(f, phi >= 0 ? phi : along < 0 ? Math.PI : 0, false);
    }, (moved) => (moved ? this.act.turn(f, null, true) : this.act.recolor(f, null)),
    () => this.act.select(f));
    group.addEventListener("focus", () => this.act.select(f));
    group.addEventListener("keydown", (event) => this.key(event, f));
    return parts;
  }

  key(event, f) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const turns = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10 };
    const key = event.key, phi = this.act.shown().phi[f];
    if (key in turns) this.act.turn(f, phi + turns[key] * (event.shiftKey ? 5 : 1) * DEGREE, true);
    else if (key === "Home" || key === "End") this.act.turn(f, key === "Home" ? 0 : Math.PI, true);
    else if (key.toLowerCase() === "o") this.act.recolor(f, OFF);
    else if (this.page.palette.letters.includes(key.toUpperCase()))
      this.act.recolor(f, this.page.palette.letters.indexOf(key.toUpperCase()));
    else if (key === " " || key === "Enter") this.act.recolor(f, null);
    else if (key === "+" || key === "-") this.act.power(f, key === "+" ? 0.05 : -0.05);
    else return;
    event.preventDefault();
  }

  touchMark() {
    const group = element("g", { class: "touch", tabindex: 0, role: "application" }, this.svg);
    element("circle", { class: "grip", r: 1.6 }, group);
    const outline = element("path", { class: "outline" }, group);
    let from = null;
    this.drag(group, (x, y) => {
      from ||= { x: x - this.act.center()[0], y: y - this.act.center()[1] };
      this.act.move([x - from.x, y - from.y], false);
    }, () => { from = null; this.act.move(null, true); });
    group.addEventListener("keydown", (event) => {
      const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      if (!(event.key in ways)) return;
      const [dx, dy] = ways[event.key].map((v) => v * (event.shiftKey ? 2 : 0.5));
      const [x, y] = this.act.center();
      this.act.move([x + dx, y + dy], true);
      event.preventDefault();
    });
    return { group, outline };
  }

  /* Pointer drags in mm of the pad (y to the tip); `end` is told whether it moved. */
  drag(target, move, end, begin = () => {}) {
    let start = null, moved = false;
    target.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      event.preventDefault();
      target.focus({ preventScroll: true });
      target.setPointerCapture(event.pointerId);
      [start, moved] = [[event.clientX, event.clientY], false];
      begin();
    });
    target.addEventListener("pointermove", (event) => {
      if (!start) return;
      moved ||= Math.hypot(event.clientX - start[0], event.clientY - start[1]) > 4;
      if (!moved) return;
      const box = this.svg.getBoundingClientRect(), scale = this.box.width / box.width;
      move(this.box.x + (event.clientX - box.left) * scale, -this.box.y - (event.clientY - box.top) * scale);
    });
    for (const name of ["pointerup", "pointercancel"]) target.addEventListener(name, () => {
      if (start) end(moved || name === "pointercancel");
      start = null;
    });
  }

  draw({ design, selected, fullPower, skin, touch, center, countMax }) {
    this.lamps.forEach((lamp, f) => {
      const { fiber, group } = { fiber: this.page.fibers[f], group: lamp.group };
      const color = colorOf(design, f), phi = design.phi[f];
      const [x, y] = [0, 1].map((i) => Math.cos(phi) * fiber.along[i] + Math.sin(phi) * fiber.inward[i]);
      const part = color === OFF ? 0 : powersOf(design, f)[color] / (fullPower[color] || 1);
      const { palette } = this.page, name = nameOf(palette, color);
      const key = `${color} ${phi} ${part} ${f === selected}`;
      if (lamp.key === key) return;
      lamp.key = key;
      const r = this.reach, wide = 0.26;
      const corner = (way) => {
        const [c, s] = [Math.cos(way * wide), Math.sin(way * wide)];
        return [(x * c - y * s) * r * 1.25, -(x * s + y * c) * r * 1.25];
      };
      const [a, b] = [corner(1), corner(-1)];
      lamp.beam.setAttribute("d", `M0 0L${a[0]} ${a[1]}A${r * 1.25} ${r * 1.25} 0 0 1 ${b[0]} ${b[1]}Z`);
      lamp.beam.setAttribute("fill", color === OFF ? "none" : `url(#beam-${name})`);
      lamp.beam.setAttribute("opacity", color === OFF ? 0 : 0.25 + 0.75 * part);
      for (const dot of [lamp.tip, lamp.reachable]) {
        dot.setAttribute("cx", r * x);
        dot.setAttribute("cy", -r * y);
      }
      lamp.stem.setAttribute("x2", r * x);
      lamp.stem.setAttribute("y2", -r * y);
      lamp.letter.textContent = color === OFF ? "–" : palette.letters[color];
      tint(lamp.bulb, palette, color);
      group.setAttribute("class", `lamp ${name}${f === selected ? " selected" : ""}`
        + (fiber.turns ? "" : " fixed"));
      const degrees = Math.round(phi / DEGREE);
      group.setAttribute("aria-label", `Fiber ${f}, ${lamp.edge}`);
      group.setAttribute("aria-valuenow", degrees);
      group.setAttribute("aria-valuetext", `${name}, ${fiber.turns ? `${degrees} degrees` : "fixed"}`
        + (part < 0.995 && color !== OFF ? `, ${Math.round(100 * part)} percent power` : ""));
    });
    this.touch.group.style.display = touch ? "" : "none";
    if (touch) {
      this.touch.group.setAttribute("transform", `translate(${center[0]} ${-center[1]})`);
      this.touch.outline.setAttribute("d", touch.outline);
      this.touch.group.setAttribute("aria-label", `${touch.title} at ${center[0].toFixed(1)}, `
        + `${center[1].toFixed(1)} mm; arrow keys move it`);
    }
    const [rows, columns] = this.page.skinShape, pen = this.canvas.getContext("2d");
    const image = pen.createImageData(columns, rows);
    for (let r = 0; r < rows; r++) for (let i = 0; i < columns; i++) {
      const at = 4 * ((rows - 1 - r) * columns + i);
      for (let c = 0; c < 3; c++) image.data[at + c] = encode(skin[3 * (r * columns + i) + c], countMax);
      image.data[at + 3] = 255;
    }
    pen.putImageData(image, 0, 0);
  }
}
