/* Maps over the sites at one bend: colors of the facets, and M as a heat map with its numbers. */

/* Viridis (van der Walt and Smith 2015) at even steps. */
const VIRIDIS = [[68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
  [31, 158, 137], [53, 183, 121], [110, 206, 88], [181, 222, 43], [253, 231, 37]];

function viridis(part) {
  const x = Math.min(Math.max(part, 0), 1) * (VIRIDIS.length - 1), i = Math.min(Math.floor(x), VIRIDIS.length - 2);
  return VIRIDIS[i].map((v, c) => Math.round(v + (x - i) * (VIRIDIS[i + 1][c] - v)));
}

class SiteMap {
  constructor(canvas, page) {
    [this.canvas, this.page] = [canvas, page];
    const { grid } = page;
    this.tall = Math.min(grid.rows / grid.columns, 2.5);
    canvas.style.aspectRatio = `${grid.columns} / ${this.tall * grid.columns}`;
  }

  /* A pen in cells (column, row from the top), on as many pixels as the screen has. */
  pen() {
    const { canvas, page: { grid } } = this, wide = Math.round(canvas.clientWidth * (window.devicePixelRatio || 1));
    const high = Math.round((wide * this.tall));
    if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
    const pen = canvas.getContext("2d");
    pen.setTransform(wide / grid.columns, 0, 0, high / grid.rows, 0, 0);
    return pen;
  }

  /* Column and row from the top; sites that the camera does not see whole have no number. */
  place(site) {
    const { columns, rows, counted } = this.page.grid, number = counted[site];
    return [number % columns, rows - 1 - Math.floor(number / columns)];
  }

  facets(counts, countMax) {
    const pen = this.pen(), { grid } = this.page, faces = this.page.normals.length;
    pen.fillStyle = "#101114";
    pen.fillRect(0, 0, grid.columns, grid.rows);
    for (let s = 0; s < this.page.sites.length; s++) {
      const [left, top] = this.place(s);
      for (let k = 0; k < faces; k++) {
        const at = 3 * (s * faces + k);
        pen.fillStyle = `rgb(${[0, 1, 2].map((c) => encode(counts[at + c], countMax)).join(",")})`;
        /* Facet k leans by 2 pi k / faces from the tip's direction towards +x. */
        const [from, to] = [k - 0.5, k + 0.52].map((v) => (2 * Math.PI * v) / faces - Math.PI / 2);
        pen.beginPath();
        pen.moveTo(left + 0.5, top + 0.5);
        pen.arc(left + 0.5, top + 0.5, 0.46, from, to);
        pen.fill();
      }
    }
  }

  heat(metric, [low, high]) {
    const pen = this.pen(), { grid } = this.page, pixel = this.canvas.width / grid.columns;
    const tall = this.canvas.height / grid.rows;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const size = Math.min(15 * (window.devicePixelRatio || 1), 0.36 * pixel);
    pen.font = `600 ${size}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    metric.forEach((value, s) => {
      const [left, top] = this.place(s), part = (value - low) / (high - low || 1);
      pen.fillStyle = `rgb(${viridis(part).join(",")})`;
      pen.fillRect(Math.floor(left * pixel), Math.floor(top * tall), Math.ceil(pixel), Math.ceil(tall));
      pen.fillStyle = part < 0.62 ? "#fff" : "#16181d";
      if (size >= 8) pen.fillText(Math.round(value), (left + 0.5) * pixel, (top + 0.52) * tall);
    });
  }
}
