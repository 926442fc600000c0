/**
 * The explorer: the history of a filter, drawn from the numbers that `packing.py` sent once.
 *
 * One module for a notebook (anywidget calls `render`) and for a page without a kernel (`pageModel` below).
 * It reads from top to bottom: unpacking, small helpers, one drawing function a view, the controls.
 * Every drawing function returns the numbers that it drew; `element.explorer.state()` gives them to a test.
 */

// ---------------------------------------------------------------------------------------------- unpacking

const ARRAYS = { f4: Float32Array, i4: Int32Array, i2: Int16Array };
const ONE = 32767; // int16 of a correlation of 1
const ROW = { // numbers a row of each array, see LAYOUT in packing.py
  time: 1, first: 1, ids: 1, landmark: 3, block: 3, axes: 3, triangulated: 3, pose: 4, inset: 14, sigma: 1, correlation: 1, sight: 2,
  sight_ids: 1, sights: 13, path_first: 1, path: 2, path_block: 3, truth: 2, series: 1,
};
/** Row i of an array of a run, or rows i to end. */
const rows = (run, name, i, end = i + 1) => run[name].subarray(ROW[name] * i, ROW[name] * end);
const RADIUS = Math.sqrt(5.991464547107979); // of the 95 % ellipse, in sigmas: chi-square, 2 degrees of freedom

/**
 * Header and bytes to a history: the header, its arrays as typed arrays over the bytes.
 * @param {object} header as `packing.pack` made it
 * @param {DataView} data
 */
function unpack(header, data) {
  // A view may lie at any place of a larger buffer; typed arrays want to begin at a multiple of four.
  const buffer = data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength);
  const get = (at) => at && new ARRAYS[at[0]](buffer, at[1], at[2]);
  const runs = header.runs.map((run) => {
    const arrays = {};
    for (const [key, value] of Object.entries(run)) {
      if (Array.isArray(value) && value[0] in ARRAYS) arrays[key] = get(value);
    }
    const series = run.series.map((s) => ({ ...s, values: get(s.values), low: get(s.low), high: get(s.high) }));
    const bornAt = [0]; // where the landmarks born in each snapshot begin in `triangulated`
    for (const born of run.born) bornAt.push(bornAt[bornAt.length - 1] + born.length);
    return { ...run, ...arrays, series, bornAt, ...matrixPlaces(run, arrays) };
  });
  const truth = { landmark: get(header.truth.landmark), path: get(header.truth.path) };
  const history = { ...header, truth, runs };
  return { ...history, bounds: bounds(history), scale: covarianceScale(runs), cells: largestMatrix(runs) };
}

/** Where the matrix of each snapshot begins: in `sigma` and in `correlation`. */
function matrixPlaces(run, { first, sigma }) {
  if (!sigma) return { matrix: false };
  const sigmaAt = [0], correlationAt = [0], tail = run.rows[1].length;
  for (let i = 0; i + 1 < first.length; i++) {
    const d = 3 * (first[i + 1] - first[i]) + tail;
    sigmaAt.push(sigmaAt[i] + d);
    correlationAt.push(correlationAt[i] + (d * (d + 1)) / 2);
  }
  return { matrix: true, tail, sigmaAt, correlationAt };
}

/** Most landmarks in one snapshot, and rows behind them: the matrix keeps its scale while the state grows. */
function largestMatrix(runs) {
  let landmarks = 0, tail = 0;
  for (const run of runs) {
    for (let i = 0; i + 1 < run.first.length; i++) landmarks = Math.max(landmarks, run.first[i + 1] - run.first[i]);
    tail = Math.max(tail, run.tail || 0);
  }
  return { landmarks, tail };
}

/** Corners of the map, m: all that is estimated or true. Ellipses may be larger. */
function bounds({ runs, truth }) {
  const box = { x0: Infinity, x1: -Infinity, y0: Infinity, y1: -Infinity };
  const add = (x, y) => {
    if (!Number.isFinite(x + y)) return;
    box.x0 = Math.min(box.x0, x); box.x1 = Math.max(box.x1, x);
    box.y0 = Math.min(box.y0, y); box.y1 = Math.max(box.y1, y);
  };
  const addAll = (a, n) => { for (let j = 0; a && j < a.length; j += n) add(a[j], a[j + 1]); };
  if (truth.landmark) addAll(truth.landmark, ROW.truth);
  for (const run of runs) {
    if (!truth.landmark) addAll(run.landmark, ROW.landmark);
    addAll(run.pose, ROW.pose);
    addAll(run.path, ROW.path);
  }
  return box;
}

/** Range of the covariance's colour scale: from the smallest variance to the largest of all runs. */
function covarianceScale(runs) {
  let low = Infinity, high = 0;
  for (const { sigma } of runs) {
    for (const s of sigma || []) {
      if (s > 0) low = Math.min(low, s * s);
      high = Math.max(high, s * s);
    }
  }
  return { low, high };
}

/**
 * All that one snapshot of a run holds, as views into the run's arrays.
 * block: world covariance xx, xy, yy of each landmark. axes: sigmas along its principal axes.
 */
function snapshot(run, i) {
  const a = run.first[i], b = run.first[i + 1];
  const shot = {
    n: b - a, ids: rows(run, "ids", a, b), landmark: rows(run, "landmark", a, b), block: rows(run, "block", a, b),
    axes: rows(run, "axes", a, b), pose: rows(run, "pose", i), inset: rows(run, "inset", i),
    born: run.born[i], retired: run.retired[i],
  };
  if (run.matrix) {
    shot.sigma = run.sigma.subarray(run.sigmaAt[i], run.sigmaAt[i + 1]);
    shot.correlation = run.correlation.subarray(run.correlationAt[i], run.correlationAt[i + 1]);
  }
  return shot;
}

/** Correlation of two rows of a snapshot, from -1 to 1. */
function correlation(shot, row, column) {
  const [r, c] = row < column ? [row, column] : [column, row];
  return shot.correlation[r * shot.sigma.length - (r * (r - 1)) / 2 + c - r] / ONE;
}

/** Covariance of two rows of a snapshot, in the product of their units. */
function covariance(shot, row, column) {
  return correlation(shot, row, column) * shot.sigma[row] * shot.sigma[column];
}

/** The measurements of a snapshot's frame: a list of objects, pixels in px, pulls in m. */
function sights(run, i) {
  if (!run.sights) return [];
  const found = [];
  const [first, end] = rows(run, "sight", i);
  for (let j = first; j < end; j++) {
    const v = rows(run, "sights", j);
    found.push({
      id: run.sight_ids[j], measured: [v[0], v[1]], predicted: [v[2], v[3]], projected: [v[4], v[5]],
      S: [v[6], v[7], v[8]], nis: v[9], accepted: v[10] > 0, pull: [v[11], v[12]],
    });
  }
  return found;
}

/** Names of the rows of a snapshot's matrix. */
function rowName(run, shot, row) {
  if (row >= 3 * shot.n) return `pose ${run.rows[1][row - 3 * shot.n]}`;
  return `landmark ${shot.ids[Math.floor(row / 3)]} ${run.rows[0][row % 3]}`;
}

/** Unit of a row: the pose's turns and turn rates are in rad. */
function rowUnit(run, shot, row) {
  const t = row - 3 * shot.n;
  if (t < 0) return "m";
  return ["m", "m", "m", "rad", "rad", "rad", "m/s", "m/s", "m/s"][t] || "rad/s";
}

// ------------------------------------------------------------------------------------------------ helpers

/** A number as a reader wants it: three significant digits, with a power of ten where zeros would make it long. */
function short(x) {
  if (!Number.isFinite(x)) return "–";
  const size = x && Math.floor(Math.log10(Math.abs(x)));
  if (size > -5 && size < 5) return String(Number(x.toPrecision(3))).replace("-", "−");
  const front = Number((x / 10 ** size).toPrecision(3));
  return `${front === 1 ? "" : `${front}·`.replace("-", "−")}10${superscript(size)}`;
}

/** 1, 2 or 5 times a power of ten: the largest that is not above x. */
function niceBelow(x) {
  const power = 10 ** Math.floor(Math.log10(x));
  return power * [5, 2, 1].find((m) => m * power <= x * 1.0001);
}

/** 1, 2 or 5 times a power of ten: the smallest that is not below x. */
function niceAbove(x) {
  const power = 10 ** Math.floor(Math.log10(x));
  return power * [1, 2, 5, 10].find((m) => m * power >= x * 0.9999);
}

/** Metres with the unit that suits them. */
const metres = (x) => (x < 0.995 ? `${short(100 * x)} cm` : `${short(x)} m`);

/** Half axes (in sigmas 1) and direction of the ellipse of a covariance [[xx, xy], [xy, yy]]. */
function ellipseOf(xx, xy, yy) {
  const middle = (xx + yy) / 2, reach = Math.hypot((xx - yy) / 2, xy);
  return { a: Math.sqrt(Math.max(middle + reach, 0)), b: Math.sqrt(Math.max(middle - reach, 0)),
    angle: 0.5 * Math.atan2(2 * xy, xx - yy) };
}

/** Path of an ellipse around (x, y), px, the y axis of its angle pointing up. Never thinner than a pixel. */
function tracePath(ctx, x, y, ellipse, k) {
  ctx.beginPath();
  ctx.ellipse(x, y, Math.max(RADIUS * k * ellipse.a, 0.6), Math.max(RADIUS * k * ellipse.b, 0.6), -ellipse.angle, 0,
    2 * Math.PI);
}

/** A canvas made ready: as sharp as the screen, empty. Returns its context and its size in CSS pixels. */
function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
  const [W, H] = [Math.round(w * ratio), Math.round(h * ratio)];
  if (canvas.width !== W || canvas.height !== H) [canvas.width, canvas.height] = [W, H];
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, w, h);
  ctx.font = "11px system-ui, sans-serif";
  ctx.textBaseline = "alphabetic";
  ctx.textAlign = "left";
  return { ctx, w, h };
}

/** Text with the background behind it, so that it can be read over lines; pressed together where it is wider than `most`. */
function label(ctx, text, x, y, colour, paper, align = "left", most = undefined) {
  ctx.textAlign = align;
  ctx.lineWidth = 3;
  ctx.lineJoin = "round";
  ctx.strokeStyle = paper;
  ctx.strokeText(text, x, y, most);
  ctx.fillStyle = colour;
  ctx.fillText(text, x, y, most);
  ctx.textAlign = "left";
}

/** Texts of several colours, [text, colour], one after the other, no wider than `most` px. */
function labels(ctx, x, y, look, words, most) {
  const widths = words.map(([text]) => ctx.measureText(text).width), press = Math.min(1, most / widths.reduce((a, b) => a + b));
  words.forEach(([text, colour], j) => {
    label(ctx, text, x, y, colour, look.paper, "left", widths[j] * press);
    x += widths[j] * press;
  });
}

/** #rrggbb to three numbers. */
const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));

/** Colour table of 511 entries for numbers from -1 to 1 by the five stops of the theme. */
function colourTable(stops) {
  const five = stops.map(rgb), table = [];
  for (let i = 0; i <= 510; i++) {
    const at = (4 * i) / 510, j = Math.min(Math.floor(at), 3), t = at - j;
    table.push(five[j].map((c, k) => Math.round(c + t * (five[j + 1][k] - c))));
  }
  return table;
}
const shade = (table, t) => table[Math.round(255 + 255 * Math.max(-1, Math.min(1, t)))];
const css = ([r, g, b]) => `rgb(${r},${g},${b})`;

/** Symmetric logarithm: x to -1 ... 1, near zero below `low`. */
function symlog(x, { low, high }) {
  return Math.sign(x) * (Math.log10(1 + Math.abs(x) / low) / Math.log10(1 + high / low));
}

/** The background that an element stands on, and whether it is dark. */
function theme(el) {
  const style = getComputedStyle(el);
  let colour = style.getPropertyValue("--jp-layout-color0").trim()
    || style.getPropertyValue("--vscode-editor-background").trim();
  for (let at = el; !colour && at; at = at.parentElement) {
    const back = getComputedStyle(at).backgroundColor;
    if (back && back !== "transparent" && !back.endsWith(", 0)")) colour = back;
  }
  const probe = document.createElement("canvas").getContext("2d");
  probe.fillStyle = colour || "#fff"; // any CSS colour becomes #rrggbb here
  const [r, g, b] = rgb(probe.fillStyle.startsWith("#") ? probe.fillStyle : "#ffffff");
  return { paper: probe.fillStyle, dark: 0.3 * r + 0.59 * g + 0.11 * b < 128 };
}

// -------------------------------------------------------------------------------------------------- views
// Each: (canvas, look, history, ...) -> the numbers that it drew. `look` is what the reader chose and the colours.

/**
 * The map from above: truth, path, landmarks with 95 % ellipses and those of the snapshot before as a faint outline.
 * Around the chosen landmark its correlation with every other. The pose magnified in the corner.
 */
function drawMap(canvas, look, history, run) {
  const { ctx, w, h } = prepare(canvas), c = look.colours;
  const shot = snapshot(run, look.i), before = look.i > 0 ? snapshot(run, look.i - 1) : null;
  const seen = sights(run, look.i), updated = history.stage[look.i];
  const side = look.inset ? insetSide(w) : 0, place = mapPlace(look, history.bounds, w, h, shot.pose, side);
  const X = (x) => w / 2 + place.k * (x - place.x), Y = (y) => h / 2 - place.k * (y - place.y);
  const shown = { k: place.k, magnify: look.magnify, landmarks: [], triangulated: {}, before: 0, lines: 0 };
  const line = (points, step, colour, width) => {
    ctx.beginPath();
    for (let j = 0; j < points.length; j += step) ctx.lineTo(X(points[j]), Y(points[j + 1]));
    ctx.strokeStyle = colour;
    ctx.lineWidth = width;
    ctx.stroke();
  };

  if (history.truth.path) line(history.truth.path, 2, c.faded, 1);
  drawCrosses(ctx, history, seen, X, Y, c);
  const path = pathUpTo(run, history, look.i);
  line(path.points, 2, run.colour, 1.6);
  drawPathEllipses(ctx, run, look, X, Y, place.k, c);
  if (Number.isFinite(shot.pose[0]) && !shot.n) drawSightLines(ctx, history, seen, shot.pose, X, Y, c);

  const stroke = run.ellipse;
  ctx.lineWidth = 1;
  ctx.strokeStyle = c.prior;
  ctx.globalAlpha = 0.75;
  for (let j = 0; before && j < before.n; j++) {
    tracePath(ctx, X(before.landmark[3 * j]), Y(before.landmark[3 * j + 1]),
      ellipseOf(...before.block.subarray(3 * j, 3 * j + 3)), place.k * look.magnify);
    ctx.setLineDash([2, 2]);
    ctx.stroke();
    shown.before++;
  }
  ctx.setLineDash([]);
  ctx.globalAlpha = 1;

  const chosen = shot.ids.indexOf(look.chosen);
  if (chosen >= 0 && run.matrix) shown.lines = drawCorrelationLines(ctx, shot, chosen, X, Y, look);
  const measured = new Set(seen.map((s) => s.id)), numbered = [];
  for (let j = 0; j < shot.n; j++) {
    const id = shot.ids[j], x = X(shot.landmark[3 * j]), y = Y(shot.landmark[3 * j + 1]);
    const ellipse = ellipseOf(...shot.block.subarray(3 * j, 3 * j + 3));
    tracePath(ctx, x, y, ellipse, place.k * look.magnify);
    ctx.strokeStyle = id === look.chosen ? c.measured : updated ? stroke : c.prior;
    ctx.lineWidth = id === look.chosen ? 2.5 : 1.4;
    ctx.stroke();
    ctx.fillStyle = look.ink;
    ctx.beginPath();
    ctx.arc(x, y, 2, 0, 7);
    ctx.fill();
    const alone = shot.born.includes(id) && rows(run, "triangulated", run.bornAt[look.i] + shot.born.indexOf(id));
    if (alone) ring(ctx, x, y, c.accepted);
    if (alone && alone.length) { // the rest of the ellipse is the pose's share
      const needle = ellipseOf(...alone);
      tracePath(ctx, x, y, needle, place.k * look.magnify);
      ctx.setLineDash([3, 2]);
      ctx.stroke();
      ctx.setLineDash([]);
      shown.triangulated[id] = [needle.a, needle.b];
    }
    if (shot.n <= 24 || measured.has(id) || id === look.chosen) numbered.push({ id, x, y });
    shown.landmarks.push({ id, x, y, m: [shot.landmark[3 * j], shot.landmark[3 * j + 1]], axes: [ellipse.a, ellipse.b] });
  }
  if (!shot.n) {
    for (const s of seen) {
      const at = history.ids.indexOf(s.id), x = X(history.truth.landmark[2 * at]), y = Y(history.truth.landmark[2 * at + 1]);
      shown.landmarks.push({ id: s.id, x, y });
      if (s.id === look.chosen) ring(ctx, x, y, c.measured);
      numbered.push({ id: s.id, x, y });
    }
  }
  shown.numbers = drawNumbers(ctx, numbered, look, c.measured, w);
  if (Number.isFinite(shot.pose[0])) drawCar(ctx, X(shot.pose[0]), Y(shot.pose[1]), shot.pose[3], look);
  mapLegend(ctx, look, history, place.k, w, h);
  if (Object.keys(shown.triangulated).length) {
    const words = ["new, dashed: triangulation alone;", "the rest is the pose's share"], lines = w > 360 ? [words.join(" ")] : words;
    lines.forEach((text, line) => label(ctx, text, 6, h - 28 - 13 * (lines.length - 1 - line), c.accepted, look.paper));
  }
  if (run.captions[look.i].startsWith("nothing changes")) label(ctx, "nothing changes in this half-step", 6, h - 28, c.prior, look.paper);
  if (side) {
    shown.inset = drawPoseInset(ctx, look, history, run, { x: w - side - 4, y: 4, side });
  }
  shown.pose = [...shot.pose];
  const [forward, left, heading] = shown.inset ? shown.inset.sigmas : [];
  const [east, north] = [...shot.pose].map((v) => short(Number(v.toFixed(3)))); // to a millimetre
  shown.words = `car at ${east}, ${north} m${shown.inset
    ? `, σ ${metres(forward)} forward, ${metres(left)} left, heading ${short(heading * 180 / Math.PI)}°` : ""}; `
    + `${shown.landmarks.length} landmarks${shot.born.length ? `, new: ${shot.born.join(", ")}` : ""}`;
  return shown;
}

/** The numbers of landmarks, the chosen one first; one that would cover another is left out. Returns their boxes. */
function drawNumbers(ctx, landmarks, look, colour, w) {
  const taken = [];
  for (const { id, x, y } of [...landmarks].sort((a, b) => (b.id === look.chosen) - (a.id === look.chosen))) {
    const wide = ctx.measureText(id).width + 2, left = x < w ? Math.min(x + 4, w - wide) : x + 4;
    const box = { id, left, right: left + wide, top: y - 14, bottom: y - 3 };
    if (taken.some((other) => box.left < other.right && other.left < box.right
                              && box.top < other.bottom && other.top < box.bottom)) continue;
    taken.push(box);
    label(ctx, String(id), left, y - 4, id === look.chosen ? colour : look.ink, look.paper);
  }
  return taken;
}

/** Side of the square in which the pose is magnified, px. */
const insetSide = (w) => (w < 330 ? 92 : 124);

/**
 * Scale k (px per m) and centre of the map: everything, zoomed and moved as the reader chose, or around the car.
 * Everything fits beside the magnified pose or below it, whichever leaves more.
 */
function mapPlace(look, box, w, h, pose, side) {
  const width = Math.max(box.x1 - box.x0, 1), height = Math.max(box.y1 - box.y0, 1);
  const fits = [[side, 0], [0, side]].map(([right, top]) => ({ right, top,
    k: Math.min((w - right - 40) / width, (h - top - 46) / height) }));
  const fit = fits[0].k >= fits[1].k ? fits[0] : fits[1], k = fit.k * look.zoom;
  if (look.follow && Number.isFinite(pose[0])) return { k, x: pose[0], y: pose[1] };
  return { k, x: (box.x0 + box.x1) / 2 + fit.right / 2 / k + look.pan[0], y: (box.y0 + box.y1) / 2 + fit.top / 2 / k + look.pan[1] };
}

/** The estimated path up to snapshot i: its own, or the updated poses so far and the present one. */
function pathUpTo(run, history, i) {
  if (run.path) return { points: rows(run, "path", run.path_first[i], run.path_first[i + 1]) };
  const points = [];
  for (let j = 0; j <= i; j++) {
    if (history.stage[j] || j === i) points.push(run.pose[4 * j], run.pose[4 * j + 1]);
  }
  return { points };
}

/** 95 % ellipses of at most about twenty poses along a path that has its own covariances. */
function drawPathEllipses(ctx, run, look, X, Y, k, c) {
  if (!run.path_block) return;
  const a = run.path_first[look.i], b = run.path_first[look.i + 1], step = Math.max(1, Math.round((b - a) / 20));
  ctx.strokeStyle = c.slam;
  ctx.lineWidth = 1;
  for (let j = b - 1; j >= a; j -= step) {
    tracePath(ctx, X(run.path[2 * j]), Y(run.path[2 * j + 1]), ellipseOf(...rows(run, "path_block", j)),
      k * look.magnify);
    ctx.stroke();
  }
}

/** True landmarks as crosses; without estimated landmarks they are the known map, those measured drawn darker. */
function drawCrosses(ctx, history, seen, X, Y, c) {
  const truth = history.truth.landmark, measured = new Set(seen.map((s) => s.id));
  for (let j = 0; truth && j < history.ids.length; j++) {
    const x = X(truth[2 * j]), y = Y(truth[2 * j + 1]);
    ctx.strokeStyle = measured.has(history.ids[j]) ? c.expected : c.faded;
    ctx.lineWidth = 1;
    ctx.beginPath();
    ctx.moveTo(x - 3, y); ctx.lineTo(x + 3, y); ctx.moveTo(x, y - 3); ctx.lineTo(x, y + 3);
    ctx.stroke();
  }
}

/** Lines of sight from the car to the known landmarks that it measures. */
function drawSightLines(ctx, history, seen, pose, X, Y, c) {
  const truth = history.truth.landmark;
  ctx.strokeStyle = c.measured;
  ctx.lineWidth = 0.7;
  for (const s of seen) {
    const at = history.ids.indexOf(s.id);
    ctx.beginPath();
    ctx.moveTo(X(pose[0]), Y(pose[1]));
    ctx.lineTo(X(truth[2 * at]), Y(truth[2 * at + 1]));
    ctx.stroke();
  }
}

/** The entry of largest magnitude of the correlation of two landmarks' blocks. */
function strongest(shot, a, b) {
  let found = 0;
  for (let u = 0; u < 3; u++) {
    for (let v = 0; v < 3; v++) {
      const r = correlation(shot, 3 * a + u, 3 * b + v);
      if (Math.abs(r) > Math.abs(found)) found = r;
    }
  }
  return found;
}

/** Lines from the chosen landmark to all others: colour and width by the correlation. Returns how many. */
function drawCorrelationLines(ctx, shot, chosen, X, Y, look) {
  const at = (j) => [X(shot.landmark[3 * j]), Y(shot.landmark[3 * j + 1])];
  let drawn = 0;
  for (let j = 0; j < shot.n; j++) {
    if (j === chosen) continue;
    const r = strongest(shot, chosen, j);
    if (Math.abs(r) < 0.01) continue;
    ctx.strokeStyle = css(shade(look.table, Math.sign(r) * (0.3 + 0.5 * Math.abs(r))));
    ctx.lineWidth = 0.5 + 3 * Math.abs(r);
    ctx.beginPath();
    ctx.moveTo(...at(chosen));
    ctx.lineTo(...at(j));
    ctx.stroke();
    drawn++;
  }
  return drawn;
}

/** A ring around a point: a landmark that is new or chosen. */
function ring(ctx, x, y, colour) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1.8;
  ctx.beginPath();
  ctx.arc(x, y, 6, 0, 7);
  ctx.stroke();
}

/** The car: an arrow head, nose forward; larger than it is. */
function drawCar(ctx, x, y, heading, look) {
  ctx.save();
  ctx.translate(x, y);
  ctx.rotate(-heading);
  ctx.beginPath();
  ctx.moveTo(9, 0); ctx.lineTo(-6, 5); ctx.lineTo(-6, -5); ctx.closePath();
  ctx.fillStyle = look.paper;
  ctx.fill();
  ctx.strokeStyle = look.ink;
  ctx.lineWidth = 1.4;
  ctx.stroke();
  ctx.restore();
}

/** Length bar, what the signs mean, and how far ellipses are enlarged when they are. */
function mapLegend(ctx, look, history, k, w, h) {
  const c = look.colours, length = niceBelow(0.22 * w / k);
  ctx.strokeStyle = look.ink;
  ctx.lineWidth = 1.5;
  ctx.beginPath();
  ctx.moveTo(8, h - 12); ctx.lineTo(8, h - 7); ctx.lineTo(8 + length * k, h - 7); ctx.lineTo(8 + length * k, h - 12);
  ctx.stroke();
  label(ctx, metres(length), 12, h - 11, look.ink, look.paper);
  if (w > 330) {
    const words = `${history.truth.landmark ? "+ true   " : ""}dotted, dashed: before this ${history.unit}`;
    label(ctx, words, w - 6, h - 8, c.expected, look.paper, "right");
  }
  const enlarged = look.magnify > 1 ? `95 % ellipses drawn × ${look.magnify}` : "95 % ellipses";
  ctx.font = look.magnify > 1 ? "bold 12px system-ui, sans-serif" : "11px system-ui, sans-serif";
  label(ctx, enlarged, 6, 13, look.magnify > 1 ? c.rejected : look.ink, look.paper);
  ctx.font = "11px system-ui, sans-serif";
}

/**
 * Scales of the magnified pose in every snapshot, the same for all runs that are shown: half of its side, m, and the
 * half angle, rad, that is drawn as 1 rad. They stay over the run, or step by a factor of ten where nothing could be seen.
 */
function poseScales(runs, stage) {
  const reach = stage.map(() => 0), turn = stage.map(() => 0);
  for (const run of runs) {
    for (let i = 0; i < stage.length; i++) {
      const p = rows(run, "inset", i), away = Math.hypot(p[8], p[9]);
      const largest = RADIUS * Math.max(...[0, 4].map((at) => ellipseOf(p[at], p[at + 1], p[at + 2]).a || 0));
      reach[i] = Math.max(reach[i], 1.1 * largest, away < 8 * largest ? 1.1 * away : 0); // farther: it jumped
      turn[i] = Math.max(turn[i], 1.96 * Math.max(p[3] || 0, p[7] || 0));
    }
  }
  const [half, angle] = [reach, turn].map((all) => ladder(all.map((v, i) => all[stage[i] === 2 ? i - 1 : i]))); // a birth leaves the pose
  return { half, turn: angle };
}

/** A scale for each of the values, none above its scale: that of the largest, or smaller by powers of ten. */
function ladder(values) {
  let scale = niceAbove(Math.max(...values, 1e-6));
  return values.map((v) => {
    while (v > scale * 1.0001) scale *= 10;
    while (v > 0 && v < scale / 16) scale /= 10;
    return scale;
  });
}

/**
 * The pose magnified: its 95 % ellipse and heading, what it came from as a faint outline, the truth, and what each
 * landmark pulled. Forward is up. Origin: where the pose was before this step. The side is said in the corner, in bold
 * with the one before where it changes.
 */
function drawPoseInset(ctx, look, history, run, { x: x0, y: y0, side }) {
  const c = look.colours, p = rows(run, "inset", look.i), seen = sights(run, look.i);
  const now = ellipseOf(p[0], p[1], p[2]), was = ellipseOf(p[4], p[5], p[6]);
  const [half, turn] = [look.scales.half[look.i], look.scales.turn[look.i]], widen = Math.max(Number((1 / turn).toPrecision(3)), 1);
  const [oy, ox] = Math.hypot(p[8], p[9]) > half ? [p[8], p[9]] : [0, 0]; // it jumped: only what is now is shown
  const k = (side - 8) / 2 / half, X = (left) => x0 + side / 2 - k * (left - ox), Y = (forward) => y0 + side / 2 - k * (forward - oy);
  ctx.fillStyle = look.paper;
  ctx.fillRect(x0, y0, side, side);
  ctx.strokeStyle = c.faded;
  ctx.lineWidth = 1;
  ctx.strokeRect(x0 + 0.5, y0 + 0.5, side, side);
  ctx.save();
  ctx.beginPath();
  ctx.rect(x0, y0, side, side);
  ctx.clip();
  // Ellipses are given with x forward, y left; on the screen forward is up: a quarter turn.
  const turned = (e) => ({ ...e, angle: e.angle + Math.PI / 2 });
  wedge(ctx, X(p[9]), Y(p[8]), p[10], Math.min(1.96 * p[3] * widen, 1.5), 0.42 * side, history.stage[look.i] ? run.ellipse : c.prior);
  tracePath(ctx, X(0), Y(0), turned(was), k);
  ctx.strokeStyle = c.prior;
  ctx.lineWidth = 1.2;
  ctx.setLineDash([3, 2]);
  ctx.stroke();
  ctx.setLineDash([]);
  if (history.stage[look.i] === 1) {
    ctx.strokeStyle = c.measured;
    ctx.lineWidth = 1;
    for (const s of seen) {
      ctx.beginPath();
      ctx.moveTo(X(0), Y(0));
      ctx.lineTo(X(s.pull[1]), Y(s.pull[0]));
      ctx.stroke();
    }
  }
  tracePath(ctx, X(p[9]), Y(p[8]), turned(now), k);
  ctx.strokeStyle = history.stage[look.i] ? run.ellipse : c.prior;
  ctx.lineWidth = 2;
  ctx.stroke();
  ctx.fillStyle = look.ink;
  ctx.beginPath();
  ctx.arc(X(p[9]), Y(p[8]), 2, 0, 7);
  ctx.fill();
  const off = Math.hypot(p[11] - p[8], p[12] - p[9]), inside = Math.max(Math.abs(p[11] - oy), Math.abs(p[12] - ox)) < half;
  if (Number.isFinite(off) && inside) {
    const [x, y] = [X(p[12]), Y(p[11])];
    ctx.strokeStyle = c.truth;
    ctx.lineWidth = 1.6;
    ctx.beginPath();
    ctx.moveTo(x - 4, y); ctx.lineTo(x + 4, y); ctx.moveTo(x, y - 4); ctx.lineTo(x, y + 4);
    ctx.stroke();
  }
  ctx.restore();
  const before = Math.max(look.i - 1, 0), [halfBefore, turnBefore] = [look.scales.half[before], look.scales.turn[before]];
  const scale = (text, changed, ...place) => {
    ctx.font = `${changed ? "bold " : ""}11px system-ui, sans-serif`;
    label(ctx, text, ...place);
  };
  if (half === halfBefore) scale(`pose ± ${metres(half)}`, false, x0 + 3, y0 + side - 4, look.ink, look.paper);
  else scale(`± ${metres(half)}, was ± ${metres(halfBefore)}`, true, x0 + 3, y0 + side - 4, c.rejected, look.paper);
  scale(`heading × ${widen}`, turn !== turnBefore, x0 + side - 3, y0 + 12, turn === turnBefore ? c.expected : c.rejected, look.paper, "right");
  ctx.font = "11px system-ui, sans-serif";
  if (Number.isFinite(off) && !inside) {
    label(ctx, `truth ${metres(off)} off`, x0 + side - 3, y0 + 25, c.rejected, look.paper, "right");
  }
  return { half, widen, radius: [RADIUS * k * now.a, RADIUS * k * now.b], sigmas: [Math.sqrt(p[0]), Math.sqrt(p[2]), p[3]], before: [Math.sqrt(p[4]), Math.sqrt(p[6]), p[7]],
    offset: [p[8], p[9]], truth: [p[11], p[12]], axes: [now.a, now.b] };
}

/** The magnified pose as a view of its own, where the pose is all that is estimated. */
function drawPose(canvas, look, history, run) {
  const { ctx, w, h } = prepare(canvas), side = Math.min(w - 150, h) - 4, c = look.colours;
  const shown = drawPoseInset(ctx, look, history, run, { x: 2, y: 2, side });
  const words = [[history.stage[look.i] ? "pose, updated" : "pose, predicted", history.stage[look.i] ? run.ellipse : c.prior],
    ["dashed: before this", c.prior], [history.unit, c.prior], ["lines: what each", c.measured], ["landmark pulls", c.measured],
    ["+ truth", c.truth], ["forward is up", look.ink], ["ellipse: 95 %", look.ink], ["sector: heading", look.ink]];
  words.forEach(([text, colour], line) => label(ctx, text, side + 12, 16 + 15 * line, colour, look.paper));
  return { ...shown, words: `${words[0][0]}, forward sigma ${metres(shown.sigmas[0])}, left ${metres(shown.sigmas[1])}` };
}

/** A sector around a heading (0 is up, to the left is positive), half as wide as `half` rad to each side. */
function wedge(ctx, x, y, heading, half, radius, colour) {
  ctx.beginPath();
  ctx.moveTo(x, y);
  ctx.arc(x, y, radius, -Math.PI / 2 - heading - half, -Math.PI / 2 - heading + half);
  ctx.closePath();
  ctx.globalAlpha = 0.25;
  ctx.fillStyle = colour;
  ctx.fill();
  ctx.globalAlpha = 1;
}

/**
 * The joint covariance as a picture: landmarks with their numbers, then the pose's rows, drawn larger and named.
 * Three readings: correlation, covariance on a symmetric logarithmic scale, and what this snapshot changed in it.
 */
function drawMatrix(canvas, look, history, run) {
  const { ctx, w, h } = prepare(canvas), c = look.colours, shot = snapshot(run, look.i);
  const values = readMatrix(run, look), d = shot.sigma.length, n = shot.n;
  const place = matrixPlace(history.cells, w, h), at = (row) => place.at(row, n);
  paintMatrix(ctx, values, n, place, look);
  ctx.strokeStyle = c.faded;
  ctx.lineWidth = 0.5;
  for (let j = 0; j <= n; j++) cross(ctx, place, at(3 * j), at(d));
  ctx.strokeStyle = look.ink;
  ctx.lineWidth = 1.2;
  cross(ctx, place, at(3 * n), at(d));
  const every = Math.ceil(10 / Math.max(3 * place.cell, 0.1));
  const chosen = shot.ids.indexOf(look.chosen);
  ctx.textBaseline = "middle";
  for (let j = 0; j < n; j++) {
    if (j % every && j !== chosen) continue;
    const colour = j === chosen ? c.measured : shot.born.includes(shot.ids[j]) ? c.accepted : look.ink;
    label(ctx, String(shot.ids[j]), place.x - 3, place.y + (at(3 * j) + at(3 * j + 3)) / 2, colour, look.paper, "right");
  }
  for (let t = 0; t < d - 3 * n; t++) {
    label(ctx, run.rows[1][t], place.x - 3, place.y + (at(3 * n + t) + at(3 * n + t + 1)) / 2, look.ink, look.paper, "right");
  }
  ctx.textBaseline = "alphabetic";
  if (chosen >= 0) {
    ctx.strokeStyle = c.measured;
    ctx.lineWidth = 2;
    const a = at(3 * chosen), b = at(3 * chosen + 3);
    ctx.strokeRect(place.x, place.y + a, at(d), b - a);
    ctx.strokeRect(place.x + a, place.y, b - a, at(d));
  }
  drawColourBar(ctx, look, history, w, h);
  const words = `${look.reading} of ${n ? `${n} landmarks and ` : ""}the pose`
    + (chosen < 0 ? "" : `; landmark ${look.chosen}, ${shares(run, shot, chosen)}`);
  return { words, reading: look.reading, d, ids: [...shot.ids], values, place: { x: place.x, y: place.y },
    framed: chosen, centres: Array.from({ length: d }, (_, row) => (at(row) + at(row + 1)) / 2) };
}

/** The chosen landmark's blocks of the matrix, with itself and with the pose, as numbers with names and units. */
function drawBlocks(canvas, look, history, run) {
  const { ctx, w, h } = prepare(canvas), shot = snapshot(run, look.i), at = shot.ids.indexOf(look.chosen);
  const what = { correlation: "correlation", covariance: "covariance", change: "change of the covariance" }[look.reading];
  const units = look.reading === "correlation" ? "" : ` (m²; ${run.rows[1].slice(3, 6).join(", ")}: m · rad)`;
  const words = [`landmark ${look.chosen}: ${what}`, `with itself and the pose${units}`];
  const shown = { id: look.chosen, values: [], words: words.join(" ") };
  if (at < 0) {
    label(ctx, look.chosen < 0 ? "Click a landmark." : `Landmark ${look.chosen} is not in the state now.`, 4, 11, look.ink, look.paper);
    return shown;
  }
  words.forEach((text, line) => label(ctx, text, 4, 11 + 13 * line, look.colours.measured, look.paper, "left", w - 8));
  const all = readMatrix(run, look), d = shot.sigma.length, t = 3 * shot.n, own = [0, 1, 2].map((u) => 3 * at + u);
  const columns = [...own, ...Array.from({ length: 6 }, (_, u) => t + u)], x0 = 20, y0 = 72, cell = (w - x0 - 16) / 9, high = (h - y0 - 4) / 3;
  const name = (row) => (row < t ? run.rows[0][row - own[0]] : run.rows[1][row - t]);
  columns.forEach((column, j) => {
    ctx.save();
    ctx.translate(x0 + cell * (j + 0.5), y0 - 4);
    ctx.rotate(-Math.PI / 4);
    label(ctx, name(column), 0, 0, look.ink, look.paper);
    ctx.restore();
  });
  own.forEach((row, i) => {
    label(ctx, name(row), x0 - 4, y0 + high * (i + 0.6), look.ink, look.paper, "right");
    shown.values.push(columns.map((column) => all[row * d + column]));
    shown.values[i].forEach((value, j) => {
      const strength = Number.isNaN(value) ? 0 : look.toScale(value), gap = j < 3 ? 0 : 2;
      ctx.fillStyle = Number.isNaN(value) ? look.colours.faded : css(shade(look.table, strength));
      ctx.fillRect(x0 + cell * j + gap, y0 + high * i, cell - 1, high - 1);
      ctx.fillStyle = Math.abs(strength) > 0.55 ? "#ffffff" : look.dark && !Number.isNaN(value) ? "#e8e8e8" : "#1a1a1a";
      ctx.font = `${cell < 29 ? 9 : 10}px system-ui, sans-serif`;
      ctx.textAlign = "center";
      const text = Number.isNaN(value) ? "new" : look.reading === "correlation" ? value.toFixed(2) : value ? value.toExponential(0).replace("e+0", "") : "0";
      ctx.fillText(text.replaceAll("-", "−"), x0 + cell * (j + 0.5) + gap, y0 + high * (i + 0.6), cell - 3);
      ctx.font = "11px system-ui, sans-serif";
    });
  });
  ctx.textAlign = "left";
  return shown;
}

/** The numbers that the matrix shows, (d, d) row by row; NaN for a change of rows that are new. */
function readMatrix(run, look) {
  const shot = snapshot(run, look.i), d = shot.sigma.length, values = new Float64Array(d * d);
  const change = look.reading === "change", read = look.reading === "correlation" ? correlation : covariance;
  const before = change && look.i > 0 ? snapshot(run, look.i - 1) : null, from = new Int32Array(d).fill(-1);
  for (let r = 0; before && r < d; r++) {
    const j = r < 3 * shot.n ? before.ids.indexOf(shot.ids[Math.floor(r / 3)]) : before.n;
    from[r] = j < 0 ? -1 : r < 3 * shot.n ? 3 * j + (r % 3) : 3 * before.n + r - 3 * shot.n;
  }
  for (let r = 0; r < d; r++) {
    for (let q = r; q < d; q++) {
      const was = !change ? 0 : from[r] < 0 || from[q] < 0 ? NaN : covariance(before, from[r], from[q]);
      values[r * d + q] = values[q * d + r] = read(shot, r, q) - was;
    }
  }
  return values;
}

/** Where rows stand: landmarks' rows share what the pose's rows, which are named one by one, leave. */
function matrixPlace(cells, w, h) {
  const x = 48, y = 4, below = barBelow(w, h);
  const side = Math.max(Math.min(w - x - (below ? 4 : 58), h - 8 - (below ? 28 : 0)), 40);
  const wide = Math.min(12, (cells.landmarks ? 0.45 : 1) * side / Math.max(cells.tail, 1));
  const tail = cells.landmarks ? wide : side / cells.tail;
  const cell = cells.landmarks ? Math.min((side - tail * cells.tail) / (3 * cells.landmarks), tail) : 0;
  const at = (row, n) => (row <= 3 * n ? row * cell : 3 * n * cell + (row - 3 * n) * tail);
  const rowAt = (px, n) => (px < 3 * n * cell ? Math.floor(px / cell) : 3 * n + Math.floor((px - 3 * n * cell) / tail));
  return { x, y, side, cell, tail, at, rowAt };
}

/** Whether the colour bar stands below the matrix: where beside it would cost more. */
const barBelow = (w, h) => w - 58 < h;

/** The matrix pixel by pixel, enlarged in four pieces: landmarks and pose have cells of different size. */
function paintMatrix(ctx, values, n, place, look) {
  const d = Math.sqrt(values.length), small = document.createElement("canvas");
  [small.width, small.height] = [d, d];
  const image = new ImageData(d, d), unknown = rgb(look.colours.faded);
  for (let j = 0; j < values.length; j++) {
    const colour = Number.isNaN(values[j]) ? unknown : shade(look.table, look.toScale(values[j]));
    image.data.set([...colour, 255], 4 * j);
  }
  small.getContext("2d").putImageData(image, 0, 0);
  ctx.imageSmoothingEnabled = false;
  const pieces = [[0, 3 * n], [3 * n, d]].filter(([a, b]) => b > a);
  for (const [r0, r1] of pieces) {
    for (const [q0, q1] of pieces) {
      const [x, y] = [place.at(q0, n), place.at(r0, n)];
      ctx.drawImage(small, q0, r0, q1 - q0, r1 - r0, place.x + x, place.y + y, place.at(q1, n) - x, place.at(r1, n) - y);
    }
  }
}

/** A horizontal and a vertical line through the matrix at `at`, of this length. */
function cross(ctx, place, at, length) {
  ctx.beginPath();
  ctx.moveTo(place.x, place.y + at); ctx.lineTo(place.x + length, place.y + at);
  ctx.moveTo(place.x + at, place.y); ctx.lineTo(place.x + at, place.y + length);
  ctx.stroke();
}

/** The scale of the matrix, on the right or below, with its unit. */
function drawColourBar(ctx, look, history, w, h) {
  const below = barBelow(w, h), length = below ? w - 60 : Math.min(h - 44, 190), [x, y] = below ? [50, h - 24] : [w - 50, 28];
  const at = (t) => (length * (1 - t)) / 2; // px from the upper or right end
  for (let j = 0; j < length; j++) {
    ctx.fillStyle = css(shade(look.table, 1 - (2 * j) / length));
    if (below) ctx.fillRect(x + length - j, y, 1.5, 8);
    else ctx.fillRect(x, y + j, 10, 1.5);
  }
  ctx.fillStyle = look.ink;
  ctx.textBaseline = "middle";
  for (const v of barTicks(look, history.scale, below ? 1 : 3)) {
    const text = look.reading === "correlation" ? String(v).replace("-", "−") : power(v);
    if (below) label(ctx, text, x + length - at(look.toScale(v)), y + 16, look.ink, look.paper, "center");
    else ctx.fillText(text, x + 13, y + at(look.toScale(v)));
  }
  ctx.textBaseline = "alphabetic";
  if (look.reading === "correlation") return;
  if (below) label(ctx, "m², rad²", x - 4, y + 7, look.ink, look.paper, "right");
  else ["m², rad²,", "m · rad"].forEach((unit, line) => ctx.fillText(unit, x - 6, 10 + 11 * line));
}

/** Numbers to write at the colour bar: of a covariance zero, and n powers of ten to each side. */
function barTicks(look, { low, high }, n) {
  if (look.reading === "correlation") return [1, 0.5, 0, -0.5, -1];
  const powers = [], top = Math.floor(Math.log10(high)), step = Math.max(1, Math.ceil((top - Math.log10(low)) / n));
  for (let p = top; p > Math.log10(low) + 0.7; p -= step) powers.push(10 ** p);
  return [...powers, 0, ...powers.map((v) => -v)];
}

/** A power of ten, or zero, as text. */
const power = (v) => (v === 0 ? "0" : `${v < 0 ? "−" : ""}10${superscript(Math.round(Math.log10(Math.abs(v))))}`);

/** A whole number as raised digits. */
function superscript(n) {
  return [...String(n)].map((d) => (d === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[d])).join("");
}

/**
 * One landmark through time: sigma along its principal axes on a logarithmic scale, its birth, updates and retirement.
 * With two runs the second is dashed. Text: what it shares with the others.
 */
function drawLandmark(canvas, look, history, runs) {
  const { ctx, w, h } = prepare(canvas), c = look.colours, shown = { id: look.chosen, axes: [], events: [] };
  if (look.chosen < 0) {
    label(ctx, "Click a landmark, or choose one in the list.", 10, 24, look.ink, look.paper);
    return shown;
  }
  const lines = runs.map((run) => landmarkThroughTime(run, look.chosen));
  const all = lines.flatMap((l) => l.sigmas.flat()).filter((v) => v > 0);
  if (!all.length) {
    label(ctx, `Landmark ${look.chosen} is not in the state of this run.`, 10, 24, look.ink, look.paper);
    return shown;
  }
  const range = { y0: Math.min(...all), y1: Math.max(...all), log: true };
  const plot = plotArea(ctx, look, history, { x: 44, y: runs[0].matrix ? 32 : 18, w: w - 54, h: h - (runs[0].matrix ? 48 : 34) }, range, "m");
  const hues = [c.predicted, c.mapping, c.slam];
  lines.forEach(({ sigmas }, r) => {
    ctx.setLineDash(r ? [4, 3] : []);
    hues.forEach((colour, axis) => {
      plot.line(sigmas.map((s) => (s ? s[axis] : NaN)), runs[r], colour, 1.6, axis === 0 ? 1.6 : 1.2);
    });
  });
  ctx.setLineDash([]);
  landmarkEvents(ctx, plot, history, runs[0], look, lines[0], shown.events);
  plot.cursor(runs[0], look.i);
  const now = runs.map((run) => snapshot(run, look.i)), at = now.map((s) => s.ids.indexOf(look.chosen));
  shown.axes = now.map((s, r) => (at[r] < 0 ? null : [...s.axes.subarray(3 * at[r], 3 * at[r] + 3)]));
  const words = [[`landmark ${look.chosen}: `, c.measured], ...(shown.axes[0]
    ? shown.axes[0].map((v, axis) => [`${axis ? "" : "σ longest "}${metres(v)}${axis < 2 ? ", " : ""}`, hues[axis]])
    : [["not in the state now", look.ink]])];
  labels(ctx, 4, 11, look, words, w - 8);
  shown.words = words.map(([text]) => text).join("");
  if (at[0] >= 0 && runs[0].matrix) {
    shown.shares = shares(runs[0], now[0], at[0]);
    shown.words += `; ${shown.shares}`;
    label(ctx, shown.shares + (runs.length > 1 ? `; dashed: ${runs[1].name}` : ""), 4, 24, look.ink, look.paper, "left", w - 8);
  }
  return shown;
}

/** What a landmark shares most with: another landmark, and a row of the pose. */
function shares(run, shot, at) {
  let other = -1, most = 0, row = 0, pose = 0;
  for (let j = 0; j < shot.n; j++) {
    const r = j === at ? 0 : strongest(shot, at, j);
    if (Math.abs(r) > Math.abs(most)) [other, most] = [j, r];
  }
  for (let t = 0; t < shot.sigma.length - 3 * shot.n; t++) {
    for (let u = 0; u < 3; u++) {
      const r = correlation(shot, 3 * at + u, 3 * shot.n + t);
      if (Math.abs(r) > Math.abs(pose)) [row, pose] = [t, r];
    }
  }
  const two = (r) => r.toFixed(2).replace("-", "−");
  return `correlation: ${other < 0 ? "" : `landmark ${shot.ids[other]} ${two(most)}, `}pose ${run.rows[1][row]} ${two(pose)}`;
}

/** The three sigmas of a landmark in every snapshot, null where it is not in the state. */
function landmarkThroughTime(run, id) {
  const sigmas = [];
  for (let i = 0; i + 1 < run.first.length; i++) {
    const a = run.first[i], at = run.ids.subarray(a, run.first[i + 1]).indexOf(id);
    sigmas.push(at < 0 ? null : [...rows(run, "axes", a + at)]);
  }
  return { sigmas };
}

/** Marks below the curve: birth, updates (dots; crosses where the gate kept them out) and retirement. */
function landmarkEvents(ctx, plot, history, run, look, { sigmas }, events) {
  const c = look.colours, y = plot.bottom - 4;
  for (let i = 0; i < history.n; i++) {
    const x = plot.X(run.time[i]);
    if (run.born[i].includes(look.chosen)) {
      events.push([i, "born"]);
      ctx.strokeStyle = c.accepted;
      ctx.lineWidth = 1.6;
      ctx.beginPath();
      ctx.arc(x, y, 4, 0, 7);
      ctx.stroke();
    }
    if (run.retired[i].includes(look.chosen)) {
      events.push([i, "retired"]);
      label(ctx, "×", x - 4, y + 4, c.rejected, look.paper);
    }
    if (history.stage[i] !== 1 || !sigmas[i]) continue;
    const s = sights(run, i).find((one) => one.id === look.chosen);
    if (!s) continue;
    events.push([i, s.accepted ? "update" : "kept out"]);
    ctx.fillStyle = s.accepted ? run.ellipse : c.rejected;
    ctx.fillRect(x - 1, y - 1, 2, s.accepted ? 2 : 6);
  }
}

/**
 * Through time: the chosen quantity with its band above, NIS below. Posteriors are lines, predictions faint ticks.
 */
function drawTime(canvas, look, history, runs) {
  const { ctx, w, h } = prepare(canvas), names = runs[0].series.map((s) => s.name), last = names.length - 1;
  const nis = names.indexOf("NIS / landmark");
  const shown = { quantity: look.quantity, values: [], low: [], high: [], nis: [] };
  if (!names.length) return shown;
  const chosen = Math.max(names.indexOf(look.quantity), 0), both = nis >= 0 && nis !== chosen;
  const area = { x: 44, y: 14, w: w - 54, h: both ? h * 0.54 - 14 : h - 32 };
  const plot = drawSeries(ctx, look, history, runs, chosen, area, !both);
  shown.words = `${names[chosen]} ${runs.map((run) => short(run.series[chosen].values[look.i])).join(" and ")}`;
  shown.area = { ...area, x0: plot.x0, x1: plot.x1, range: plot.range };
  runs.forEach(({ series }) => {
    shown.values.push(series[chosen].values[look.i]);
    shown.low.push(series[chosen].low[look.i]);
    shown.high.push(series[chosen].high[look.i]);
    if (nis >= 0) shown.nis.push(series[nis].values[look.i]);
  });
  if (both) drawSeries(ctx, look, history, runs, nis, { x: 44, y: h * 0.54 + 14, w: w - 54, h: h * 0.46 - 32 }, true);
  return shown;
}

/** One quantity of all runs in an area. */
function drawSeries(ctx, look, history, runs, at, area, axis) {
  const c = look.colours, first = runs[0].series[at];
  const range = seriesRange(history, runs.map((run) => run.series[at]));
  const plot = plotArea(ctx, look, history, area, range, "", axis);
  for (const run of runs) {
    const { values, low, high, stair } = run.series[at], hue = runs.length > 1 ? run.colour : c.predicted;
    plot.ticks(history, run, low, high, runs.length > 1 ? run.colour : c.prior);
    ctx.setLineDash([4, 3]);
    plot.line(history.stage.map((stage, i) => (stage ? low[i] : null)), run, runs.length > 1 ? run.colour : c.expected, 1);
    plot.line(history.stage.map((stage, i) => (stage ? high[i] : null)), run, runs.length > 1 ? run.colour : c.expected, 1);
    ctx.setLineDash([]);
    plot.line(history.stage.map((stage, i) => (stage || stair ? values[i] : null)), run, hue, 1.6);
    plot.dot(run.time[look.i], values[look.i], hue);
  }
  plot.cursor(runs[0], look.i);
  const v = runs.map((run) => short(run.series[at].values[look.i])).join(" and ");
  const band = /error/.test(first.name) ? ", dashed: ± 3σ after updates" : first.stair ? ": up predicted, down updated" : Number.isFinite(first.low[first.low.length - 1]) ? ", 95 % band dashed" : "";
  label(ctx, `${first.name}${first.unit ? ` (${first.unit})` : ""}: ${v}${band}`, area.x - 40, area.y - 4, look.ink, look.paper, "left", area.w + 40);
  return plot;
}

/** Smallest and largest of what a quantity shows, without letting a few values off the scale hide the rest. */
function seriesRange(history, series) {
  const all = [], bands = [];
  for (const s of series) {
    for (let i = 0; i < history.n; i++) {
      if (!history.stage[i] && !s.stair) continue;
      if (Number.isFinite(s.values[i])) all.push(s.values[i]);
      for (const edge of [s.low[i], s.high[i]]) if (Number.isFinite(edge)) bands.push(edge);
    }
  }
  const values = [...all, ...bands], log = series[0].log;
  if (!values.length) return { y0: -1, y1: 1, log: false };
  if (log) return { y0: Math.min(...values.filter((v) => v > 0)), y1: Math.max(...values), log };
  const y0 = Math.min(...values), y1 = Math.max(...values), room = 0.06 * (y1 - y0 || 1);
  return { y0: y0 < 0 ? y0 - room : Math.min(0, y0), y1: y1 + room, log };
}

/** Axes in an area: time to the right, a quantity upwards. Returns functions that draw in it. */
function plotArea(ctx, look, history, area, range, unit, axis = true) {
  const c = look.colours, time = history.runs[0].time, x0 = time[0], x1 = Math.max(time[history.n - 1], x0 + 1e-6);
  const f = range.log ? Math.log10 : (v) => v, [a, b] = [f(range.y0), Math.max(f(range.y1), f(range.y0) + 1e-9)];
  const X = (t) => area.x + (area.w * (t - x0)) / (x1 - x0);
  const Y = (v) => area.y + area.h - (area.h * (f(v) - a)) / (b - a);
  ctx.lineWidth = 1;
  ctx.textBaseline = "middle";
  for (const v of range.log ? decades(range, area.h / 14) : steps(range.y0, range.y1, Math.max(2, Math.floor(area.h / 22)))) {
    const y = Y(v);
    ctx.strokeStyle = look.grid;
    ctx.lineWidth = 1;
    ctx.beginPath();
    ctx.moveTo(area.x, y); ctx.lineTo(area.x + area.w, y);
    ctx.stroke();
    const inside = Math.min(Math.max(y, area.y + 5), area.y + area.h - (axis ? 0 : 4)); // clear of what is written above and below
    label(ctx, `${short(v)}${unit ? ` ${unit}` : ""}`, area.x - 7, inside, look.ink, look.paper, "right");
  }
  ctx.textBaseline = "alphabetic";
  if (axis) {
    for (const t of steps(x0, x1, Math.floor(area.w / 60))) {
      if (X(t) > area.x + area.w - 60) continue; // there stands the axis' name
      label(ctx, short(t), X(t), area.y + area.h + 13, look.ink, look.paper, "center");
    }
    label(ctx, history.axis, area.x + area.w, area.y + area.h + 13, look.ink, look.paper, "right");
  }
  const clip = (draw) => {
    ctx.save();
    ctx.beginPath();
    ctx.rect(area.x, area.y - 2, area.w + 4, area.h + 4);
    ctx.clip();
    draw();
    ctx.restore();
  };
  return {
    X, x0, x1, range: [range.y0, range.y1], bottom: area.y + area.h,
    /** values by snapshot; null is passed over, NaN breaks the line. */
    line: (values, run, colour, width) => clip(() => {
      ctx.beginPath();
      let on = false;
      values.forEach((v, i) => {
        if (v === null) return;
        if (!Number.isFinite(v)) { on = false; return; }
        ctx[on ? "lineTo" : "moveTo"](X(run.time[i]), Y(v));
        on = true;
      });
      ctx.strokeStyle = colour;
      ctx.lineWidth = width;
      ctx.stroke();
    }),
    /** The band of the predictions: a short faint tick each. */
    ticks: (h, run, low, high, colour) => clip(() => {
      ctx.strokeStyle = colour;
      ctx.globalAlpha = 0.5;
      ctx.lineWidth = 1;
      ctx.beginPath();
      for (let i = 0; i < h.n; i++) {
        if (h.stage[i] || !h.stage[i + 1] || low[i] === low[i + 1]) continue;
        for (const v of [low[i], high[i]]) { ctx.moveTo(X(run.time[i]) - 2, Y(v)); ctx.lineTo(X(run.time[i]) + 2, Y(v)); }
      }
      ctx.stroke();
      ctx.globalAlpha = 1;
    }),
    dot: (t, v, colour) => {
      if (!Number.isFinite(v)) return;
      ctx.fillStyle = colour;
      ctx.beginPath();
      ctx.arc(X(t), Math.max(area.y, Math.min(area.y + area.h, Y(v))), 3, 0, 7);
      ctx.fill();
    },
    cursor: (run, i) => {
      ctx.strokeStyle = c.measured;
      ctx.lineWidth = 1;
      ctx.beginPath();
      ctx.moveTo(X(run.time[i]), area.y); ctx.lineTo(X(run.time[i]), area.y + area.h);
      ctx.stroke();
    },
  };
}

/** Round numbers from low to high, about n of them, two at least. */
function steps(low, high, n) {
  const step = niceAbove((high - low) / Math.max(n, 1)), found = [];
  for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step; v += step) found.push(Math.abs(v) < step / 1e6 ? 0 : v);
  return found.length > 1 || n > 50 ? found : steps(low, high, 2 * Math.max(n, 1));
}

/** At most about n powers of ten in a range, and numbers between them where it spans less than two. */
function decades({ y0, y1 }, n) {
  const found = [], span = y1 / y0, factors = span < 5 ? [1, 1.5, 2, 3, 4, 5, 7] : span < 30 ? [1, 2, 5] : [1], every = Math.ceil(Math.log10(y1 / y0) / n);
  for (let p = Math.floor(Math.log10(y0)); p <= Math.log10(y1); p++) {
    if (p % Math.max(every, 1)) continue;
    for (const m of factors) if (m * 10 ** p >= y0 * 0.999 && m * 10 ** p <= y1 * 1.001) found.push(m * 10 ** p);
  }
  return found;
}

/**
 * The left image with what was measured, and what the filter predicts: drawn several times as far from the measured
 * pixel as it is. Below, the chosen landmark's innovation and the 95 % ellipse of S, magnified.
 */
function drawImage(canvas, look, history, run) {
  const { ctx, w, h } = prepare(canvas), c = look.colours, seen = sights(run, look.i);
  const [width, height] = history.image, k = Math.min((w - 12) / width, (h * 0.52 - 16) / height), x0 = 6, y0 = 16;
  const updated = history.stage[look.i], X = (u) => x0 + k * u, Y = (v) => y0 + k * v;
  const shown = { measured: [], enlarged: 0, chosen: null };
  ctx.strokeStyle = c.faded;
  ctx.lineWidth = 1;
  ctx.strokeRect(x0, y0, k * width, k * height);
  const far = seen.map((s) => RADIUS * ellipseOf(...s.S).a).sort((p, q) => p - q);
  shown.enlarged = far.length ? Math.max(1, niceBelow(28 / k / Math.max(far[far.length >> 1], 1e-3))) : 1;
  ctx.save();
  ctx.beginPath();
  ctx.rect(x0, y0, k * width, k * height);
  ctx.clip();
  for (const s of seen) {
    const [u, v] = s.measured, e = shown.enlarged, place = updated ? s.projected : s.predicted;
    const to = (p) => [X(u + e * (p[0] - u)), Y(v + e * (p[1] - v))];
    const S = ellipseOf(...s.S);
    tracePath(ctx, ...to(s.predicted), { ...S, angle: -S.angle }, k * e);
    ctx.strokeStyle = s.id === look.chosen ? c.measured : c.predicted;
    ctx.lineWidth = s.id === look.chosen ? 2 : 1;
    ctx.stroke();
    ctx.beginPath();
    ctx.moveTo(...to(place));
    ctx.lineTo(X(u), Y(v));
    ctx.strokeStyle = s.accepted ? c.accepted : c.rejected;
    ctx.setLineDash(s.accepted ? [] : [2, 2]);
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.fillStyle = c.measured;
    ctx.beginPath();
    ctx.arc(X(u), Y(v), 2.5, 0, 7);
    ctx.fill();
    shown.measured.push({ id: s.id, x: X(u), y: Y(v), uv: s.measured, predicted: s.predicted, nis: s.nis });
  }
  ctx.restore();
  const words = seen.length ? `left image, predictions × ${shown.enlarged} from the measured pixel` : "left image: nothing was predicted in this frame";
  label(ctx, words, x0, 11, look.ink, look.paper);
  labels(ctx, x0, y0 + k * height + 12, look, [["● measured  ", c.measured], ["○ 95 % of the prediction (S)  ", c.predicted],
    [updated ? "─ what is left  " : "─ innovation  ", c.accepted], ["┄ kept out", c.rejected]], w - 12);
  const one = seen.find((s) => s.id === look.chosen), top = y0 + k * height + 20;
  if (one) shown.chosen = drawInnovation(ctx, look, updated, one, { x: 6, y: top, w: w - 12, h: h - top - 4 });
  else label(ctx, "chosen landmark: not measured in this frame", x0, top + 12, look.ink, look.paper);
  shown.words = `${seen.length} landmarks predicted and measured; ${one ? shown.chosen.words : "the chosen one not"}`;
  return shown;
}

/** One innovation in px: measured at the origin, the prediction with the 95 % ellipse of S, and after the update. */
function drawInnovation(ctx, look, updated, s, area) {
  const c = look.colours, S = ellipseOf(...s.S), r = [s.measured[0] - s.predicted[0], s.measured[1] - s.predicted[1]];
  const reach = Math.max(RADIUS * S.a + Math.hypot(...r), 1e-3), half = niceAbove(1.05 * reach);
  const side = area.h - 2, k = side / 2 / half, cx = area.x + side / 2, cy = area.y + side / 2;
  const X = (u) => cx + k * (u - s.measured[0]), Y = (v) => cy + k * (v - s.measured[1]);
  ctx.strokeStyle = c.faded;
  ctx.lineWidth = 1;
  ctx.strokeRect(area.x, area.y, side, side);
  tracePath(ctx, X(s.predicted[0]), Y(s.predicted[1]), { ...S, angle: -S.angle }, k);
  ctx.strokeStyle = c.predicted;
  ctx.lineWidth = 1.6;
  ctx.stroke();
  const place = updated ? s.projected : s.predicted;
  ctx.beginPath();
  ctx.moveTo(X(place[0]), Y(place[1])); ctx.lineTo(cx, cy);
  ctx.strokeStyle = s.accepted ? c.accepted : c.rejected;
  ctx.stroke();
  const mark = (x, y) => { ctx.beginPath(); ctx.moveTo(x - 4, y - 4); ctx.lineTo(x + 4, y + 4); ctx.moveTo(x - 4, y + 4); ctx.lineTo(x + 4, y - 4); ctx.stroke(); };
  ctx.strokeStyle = c.predicted;
  mark(X(place[0]), Y(place[1]));
  ctx.fillStyle = c.measured;
  ctx.beginPath();
  ctx.arc(cx, cy, 3.5, 0, 7);
  ctx.fill();
  const words = [`landmark ${s.id}, ± ${short(half)} px`, `innovation ${r.map((v) => v.toFixed(1)).join(", ")} px`,
    `S: σ ${short(Math.sqrt(s.S[0]))}, ${short(Math.sqrt(s.S[2]))} px`, `NIS ${short(s.nis)} (4 numbers)`,
    s.accepted ? "accepted" : "kept out by the gate", updated ? "× after the update" : "× predicted"];
  words.forEach((line, j) => label(ctx, line, area.x + side + 10, area.y + 12 + 14 * j, j === 0 ? c.measured : look.ink, look.paper));
  return { words: words.slice(0, 5).join(", "), innovation: r, S: s.S, nis: s.nis, accepted: s.accepted };
}

// ----------------------------------------------------------------------------------------------- controls

const STYLE = `
.vx { --vx-ink: var(--jp-ui-font-color0, #1a1a1a); --vx-edge: var(--jp-border-color1, #bbb); --vx-focus: #1a73e8;
  font: 13px var(--jp-ui-font-family, system-ui, sans-serif); color: var(--vx-ink); max-width: 1100px; position: relative; }
.vx[data-theme=dark] { --vx-ink: var(--jp-ui-font-color0, #eee); --vx-edge: var(--jp-border-color1, #666);
  --vx-focus: #8ab4f8; color-scheme: dark; }
.vx[data-theme=light] { color-scheme: light; }
.vx-bar { display: flex; flex-wrap: wrap; gap: 3px 10px; align-items: center; margin: 2px 0; }
.vx-bar label { display: inline-flex; gap: 6px; align-items: center; white-space: nowrap; }
.vx button, .vx select { font: inherit; color: inherit; background: transparent; border: 1px solid var(--vx-edge);
  border-radius: 3px; min-width: 26px; min-height: 24px; padding: 0 5px; cursor: pointer; }
.vx option { color: var(--vx-ink); background: Canvas; }
.vx input[type=range] { flex: 1; min-width: 80px; margin: 0; accent-color: var(--vx-focus); }
.vx-bar label.vx-slider { flex: 1 1 180px; max-width: 380px; }
.vx-readout { min-width: 11.5em; font-variant-numeric: tabular-nums; }
.vx select { max-width: 170px; }
.vx input[type=checkbox] { margin: 0; accent-color: var(--vx-focus); }
.vx :focus-visible { outline: 2px solid var(--vx-focus); outline-offset: 1px; }
.vx-views { display: grid; gap: 6px; grid-template-columns: repeat(12, 1fr); }
.vx-view { margin: 0; min-width: 0; position: relative; }
.vx-view canvas { display: block; width: 100%; height: 100%; border-radius: 3px; touch-action: pan-y; }
.vx-name { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
.vx-title { position: absolute; left: 6px; right: 102px; top: 16px; font-weight: 600; line-height: 1.1;
  pointer-events: none; } /* it ends before the magnified pose */
.vx-tip { position: absolute; pointer-events: none; z-index: 5; padding: 2px 6px; border-radius: 3px; font-size: 12px;
  border: 1px solid var(--vx-edge); white-space: nowrap; display: none; }
.vx-caption { min-height: 2.5em; margin: 3px 0 0; line-height: 1.25; }
`;

const SPEEDS = [1, 3, 8, 20]; // half-steps a second
const MOVES = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: 10, PageDown: -10, Home: -Infinity, End: Infinity };
const BOTH = 2;

/** The model of a page without a kernel: header and data stand in the page, and nothing is sent anywhere. */
export function pageModel() {
  const header = JSON.parse(document.getElementById("header").textContent);
  const bytes = Uint8Array.from(atob(document.getElementById("data").textContent.trim()), (ch) => ch.charCodeAt(0));
  const values = { header, data: new DataView(bytes.buffer), half_step: header.start, landmark: header.landmark, show: header.show };
  return { get: (key) => values[key], set: (key, value) => { values[key] = value; }, save_changes() {}, on() {}, off() {} };
}

/**
 * An element with attributes and children. JupyterLab and Notebook 7 look at keys before the page does, and leave those
 * alone that go to an element with this mark; it must be on the very element that has the focus.
 */
function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  element.setAttribute("data-lm-suppress-shortcuts", "true");
  for (const [key, value] of Object.entries(attributes)) {
    if (key in element && key !== "list") element[key] = value;
    else element.setAttribute(key, value);
  }
  element.append(...children);
  return element;
}

/** A select with its label. options: [value, text] pairs. */
function choice(text, options, value, change) {
  // Named by itself: the text of the label around it has all the options in it.
  const select = make("select", { ariaLabel: text, onchange: () => change(select.value) });
  for (const [v, words] of options) select.append(make("option", { value: v, textContent: words }));
  select.value = value;
  return { box: make("label", {}, text, select), select };
}

/**
 * Show an explorer in an element. anywidget calls it for every view of the widget.
 * @param {{model: object, el: HTMLElement}} where
 * @returns {function} that takes it away again
 */
function render({ model, el }) {
  const root = make("div", { className: "vx", role: "group" });
  root.setAttribute("aria-label", "filter explorer");
  el.append(make("style", { textContent: STYLE }), root);

  let history = unpack(model.get("header"), model.get("data")), timer = 0, saving = 0, views = [], shown = {};
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const look = {
    i: model.get("half_step"), chosen: model.get("landmark"), show: model.get("show"), magnify: 1, zoom: 1, pan: [0, 0],
    follow: false, reading: "correlation", quantity: history.quantity, speed: SPEEDS[calm ? 0 : 1],
  };

  // --- the parts of the page
  const button = (text, name, press) => make("button", { type: "button", textContent: text, title: name, ariaLabel: name,
    onclick: press });
  const play = button("Play", "play (space)", () => toggle());
  const slider = make("input", { type: "range", ariaLabel: history.unit, min: 0, max: history.n - 1, oninput: () => go(+slider.value) });
  const readout = make("span", { className: "vx-readout" }); // no <output>: a reader would hear it beside the caption
  const caption = make("p", { className: "vx-caption", role: "status" });
  const tip = make("div", { className: "vx-tip" });
  const grid = make("div", { className: "vx-views" });
  const speed = choice("speed", SPEEDS.map((s) => [s, `${s}/s`]), look.speed, (v) => { look.speed = +v; if (timer) { stop(); start(); } });
  const magnify = choice("ellipses", [1, 3, 10, 30].map((m) => [m, `× ${m}`]), 1, (v) => { look.magnify = +v; draw(); });
  const follow = make("input", { type: "checkbox", onchange: () => { look.follow = follow.checked; if (look.follow && look.zoom === 1) look.zoom = 3; draw(); } });
  const reading = choice("matrix", [["correlation", "correlation"], ["covariance", "covariance"], ["change", "what this changed"]],
    look.reading, (v) => { look.reading = v; draw(); });
  let landmark, quantity, which;
  const zoom = (factor) => { look.zoom = factor ? Math.min(60, Math.max(0.3, look.zoom * factor)) : 1; if (!factor) look.pan = [0, 0]; draw(); };

  /** Everything that depends on which runs there are; again when the kernel sends others. */
  function build() {
    slider.max = history.n - 1;
    look.i = Math.max(0, Math.min(look.i, history.n - 1));
    const runs = history.runs, some = runs[0];
    quantity = choice("below", some.series.map((s) => [s.name, s.name]), look.quantity, (v) => { look.quantity = v; draw(); });
    landmark = choice("landmark", [[-1, "none"], ...history.ids.map((id) => [id, id])], look.chosen, (v) => choose(+v));
    which = choice("show", [...runs.map((run, r) => [r, run.name]), [BOTH, "side by side"]], look.show, (v) => { look.show = +v; arrange(); save(); });
    const steps = [button("|◀", "first (Home)", () => go(0)), button("◀", "back (←)", () => go(look.i - 1)), play,
      button("▶", "forward (→)", () => go(look.i + 1)), button("▶|", "last (End)", () => go(history.n - 1))];
    root.replaceChildren(
      make("div", { className: "vx-bar" }, ...steps, make("label", { className: "vx-slider" }, history.unit, slider), readout, speed.box,
        ...(runs.length > 1 ? [which.box] : [])),
      make("div", { className: "vx-bar" }, magnify.box, make("label", {}, follow, "follow the car"),
        make("span", {}, button("−", "zoom out the map", () => zoom(1 / 1.5)), " ", button("+", "zoom in the map", () => zoom(1.5)), " ",
          button("fit", "show the whole map", () => zoom(0))),
        ...(some.matrix ? [reading.box] : []), landmark.box, ...(some.series.length > 2 ? [quantity.box] : [])),
      grid, caption, tip);
    arrange();
  }

  /** Which views there are and how wide, by the data and the width of the page. */
  function arrange() {
    const two = look.show === BOTH && history.runs.length > 1, wide = root.clientWidth >= 640;
    const all = history.runs, drawn = two ? all : [all[Math.min(look.show, all.length - 1)]], some = drawn[0];
    const top = wide ? 286 : 250, low = wide ? 166 : 170;
    const list = [];
    look.scales = poseScales(drawn, history.stage);
    const known = Number.isFinite(rows(some, "inset", history.n - 1)[0]); // the pose's covariance
    look.apart = known && !two && !some.first[some.first.length - 1];
    look.inset = known && !look.apart;
    const add = (kind, name, run, columns, height) => list.push({ kind, name, run, columns: wide ? columns : 12, height });
    for (const run of drawn) {
      const [a, b] = two ? (root.clientWidth >= 860 ? [3, 3] : [6, 6]) : [7, 5];
      if (look.apart) add("pose", "pose", run, 6, top);
      else add("map", `map, ${run.name}`, run, a, top);
      if (two && root.clientWidth < 860) continue;
      if (run.matrix && run.first[run.first.length - 1] > 0) add("matrix", `joint covariance, ${run.name}`, run, b, top);
      else if (run.sights) add("image", `left image, ${run.name}`, run, look.apart ? 6 : b, top);
    }
    if (two && root.clientWidth < 860) drawn.forEach((run) => run.matrix && add("matrix", `joint covariance, ${run.name}`, run, 6, 220));
    if (some.first[some.first.length - 1] > 0) add("landmark", "one landmark through time", drawn, !two && some.matrix ? 4 : 6, low);
    else if (some.matrix) add("matrix", "covariance of the pose", some, look.apart ? 4 : 6, low + 20);
    if (look.apart) add("map", `map, ${some.name}`, some, 4, low + 20);
    const blocks = !two && some.matrix && !look.apart;
    if (blocks) add("blocks", "blocks of the chosen landmark", some, 4, low);
    if (some.series.length) add("time", "errors through time", drawn, look.apart || blocks ? 4 : 6, low + (some.first[some.first.length - 1] > 0 ? 0 : 20));
    views = list.map(({ kind, name, run, columns, height }) => {
      const canvas = make("canvas", { tabIndex: 0, role: "img", ariaLabel: name });
      const box = make("figure", { className: "vx-view" }, canvas);
      box.style.gridColumn = `span ${columns}`;
      box.style.height = `${height}px`;
      if (two && kind === "map") box.append(make("span", { className: "vx-title", textContent: run.name }));
      listen(canvas, kind, run);
      return { kind, run, canvas, name };
    });
    grid.replaceChildren(...views.map((view) => view.canvas.parentElement));
    draw();
  }

  // --- drawing
  /** The colours of the theme, and of each run in it. */
  function recolour() {
    const { paper, dark } = theme(el), colours = history.colours[dark ? "dark" : "light"];
    root.dataset.theme = dark ? "dark" : "light";
    tip.style.background = paper;
    Object.assign(look, { paper, dark, colours, ink: dark ? "#e8e8e8" : "#1a1a1a", grid: dark ? "#3a3a3a" : "#e4e4e4",
      table: colourTable(colours.scale) });
    const several = history.runs.length > 1;
    history.runs.forEach((run) => {
      run.colour = several ? colours[run.role] : colours.posterior;
      run.ellipse = run.colour;
    });
  }

  /** Draw all views of the present snapshot. */
  function draw() {
    look.toScale = look.reading === "correlation" ? (v) => v : (v) => symlog(v, history.scale);
    shown = { map: [], matrix: [], image: [] };
    for (const { kind, run, canvas, name } of views) {
      if (!canvas.clientWidth) continue;
      if (canvas.nextSibling) canvas.nextSibling.style.color = run.colour; // the run's name on its map
      const paint = { map: drawMap, pose: drawPose, blocks: drawBlocks, matrix: drawMatrix, image: drawImage, landmark: drawLandmark, time: drawTime }[kind];
      const numbers = paint(canvas, look, history, run);
      canvas.ariaLabel = numbers.words ? `${name}: ${numbers.words}` : name;
      if (kind in shown) shown[kind].push(numbers);
      else shown[kind] = numbers;
    }
    const runs = look.show === BOTH ? history.runs : [history.runs[Math.min(look.show, history.runs.length - 1)]];
    slider.value = look.i;
    slider.setAttribute("aria-valuetext", history.labels[look.i]);
    readout.textContent = history.labels[look.i];
    const words = runs.map((run) => (runs.length > 1 ? `${run.name}: ` : "") + run.captions[look.i]);
    caption.textContent = `${history.labels[look.i]}: ${words.join(". ")}.`;
    play.textContent = timer ? "Pause" : "Play";
    play.ariaLabel = play.title = timer ? "pause (space)" : "play (space)";
    landmark.select.value = look.chosen;
    root.dataset.step = look.i;
  }

  // --- moving
  /** Show snapshot i, or the nearest there is. */
  function go(i) {
    look.i = Math.max(0, Math.min(history.n - 1, i));
    draw();
    save();
  }

  function choose(id) {
    look.chosen = id;
    draw();
    save();
  }

  function start() {
    if (look.i === history.n - 1) look.i = 0;
    caption.setAttribute("aria-live", "off"); // a screen reader could not follow
    timer = setInterval(() => (look.i < history.n - 1 ? go(look.i + 1) : stop()), 1000 / look.speed);
    draw();
  }

  function stop() {
    clearInterval(timer);
    timer = 0;
    caption.setAttribute("aria-live", "polite");
    draw();
  }

  const toggle = () => (timer ? stop() : start());

  /** Let Python know, a moment later: no key waits for the kernel. */
  function save() {
    clearTimeout(saving);
    saving = setTimeout(() => {
      model.set("half_step", look.i);
      model.set("landmark", look.chosen);
      model.set("show", look.show);
      model.save_changes();
    }, 200);
  }

  /** Keys work wherever the focus is inside; the notebook never sees them. */
  function onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.key === "Tab" || event.key === "Escape") return;
    event.stopPropagation();
    if (event.target.tagName === "SELECT") return;
    if (event.key in MOVES) go(look.i + MOVES[event.key]);
    else if (event.key === " " && !["BUTTON", "INPUT"].includes(event.target.tagName)) toggle();
    else if (event.key === " " && event.target === slider) toggle();
    else if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 1.5 : 1 / 1.5);
    else return;
    event.preventDefault();
  }

  /** Mouse and touch on a view. */
  function listen(canvas, kind, run) {
    const at = (event) => { const r = canvas.getBoundingClientRect(); return [event.clientX - r.left, event.clientY - r.top]; };
    const say = (text, event) => {
      tip.style.display = text ? "block" : "none";
      if (!text) return;
      const r = root.getBoundingClientRect();
      tip.textContent = text;
      tip.style.left = `${Math.min(event.clientX - r.left + 12, r.width - tip.offsetWidth - 4)}px`;
      tip.style.top = `${event.clientY - r.top + 14}px`;
    };
    const mine = () => views.filter((v) => v.kind === kind).findIndex((v) => v.canvas === canvas);
    const nearest = (points, [x, y]) => {
      let best = null, reach = 14;
      for (const p of points) { const d = Math.hypot(p.x - x, p.y - y); if (d < reach) [best, reach] = [p, d]; }
      return best;
    };
    const cell = ([x, y]) => {
      const shot = snapshot(run, look.i), d = shot.sigma.length, place = matrixPlace(history.cells, canvas.clientWidth, canvas.clientHeight);
      const row = place.rowAt(y - place.y, shot.n), column = place.rowAt(Math.max(x - place.x, 0), shot.n);
      return row >= 0 && row < d && column >= 0 && column < d ? { shot, row, column, d } : null;
    };
    let from = null;
    canvas.onpointerdown = (event) => { if (kind === "map") from = { at: at(event), pan: [...look.pan], moved: false }; };
    canvas.onpointermove = (event) => {
      const p = at(event);
      if (from && event.buttons) {
        const [dx, dy] = [p[0] - from.at[0], p[1] - from.at[1]], k = shown.map[mine()].k;
        if (Math.hypot(dx, dy) > 4) {
          from.moved = true;
          look.pan = [from.pan[0] - dx / k, from.pan[1] + dy / k];
          if (look.follow) { look.follow = follow.checked = false; }
          draw();
        }
        return;
      }
      if (kind === "map" || kind === "image") {
        const hit = nearest(kind === "map" ? shown.map[mine()].landmarks : shown.image[mine()].measured, p);
        canvas.style.cursor = hit ? "pointer" : kind === "map" ? "grab" : "default";
        say(hit && (hit.axes ? `landmark ${hit.id}: σ ${metres(hit.axes[0])}, ${metres(hit.axes[1])}` : `landmark ${hit.id}${"nis" in hit ? `: NIS ${short(hit.nis)}` : ""}`), event);
      } else if (kind === "matrix") {
        const hit = cell(p);
        canvas.style.cursor = hit ? "crosshair" : "default";
        say(hit && entryText(run, hit, shown.matrix[mine()]), event);
      }
    };
    canvas.onpointerleave = () => { from = null; say(""); };
    canvas.onclick = (event) => {
      const p = at(event);
      if (kind === "map" && !(from && from.moved)) choose(nearest(shown.map[mine()].landmarks, p)?.id ?? look.chosen);
      else if (kind === "image") choose(nearest(shown.image[mine()].measured, p)?.id ?? look.chosen);
      else if (kind === "matrix") { const hit = cell(p); if (hit && hit.row < 3 * hit.shot.n) choose(hit.shot.ids[Math.floor(hit.row / 3)]); }
      else if (kind === "time" || kind === "landmark") go(snapshotAt(canvas, p[0]));
      from = null;
    };
    canvas.addEventListener("wheel", (event) => {
      if (kind !== "map" || (document.activeElement !== canvas && !event.ctrlKey)) return; // else the page scrolls
      event.preventDefault();
      zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2);
    }, { passive: false });
  }

  /** The updated snapshot nearest to a place on the time axis. */
  function snapshotAt(canvas, x) {
    const time = history.runs[0].time, share = (x - 44) / (canvas.clientWidth - 54);
    const t = time[0] + share * (time[history.n - 1] - time[0]);
    let best = look.i, reach = Infinity;
    for (let i = 0; i < history.n; i++) {
      if (history.stage[i] && Math.abs(time[i] - t) < reach) [best, reach] = [i, Math.abs(time[i] - t)];
    }
    return best;
  }

  // --- life
  const recheck = () => { recolour(); draw(); };
  let width = 0;
  const resize = new ResizeObserver(() => {
    if (root.clientWidth === width) return; // a caption of more lines changes nothing
    width = root.clientWidth;
    recolour(); // only now, in the page, is it known what stands behind
    arrange();
  });
  const themes = new MutationObserver(() => { recheck(); setTimeout(recheck, 500); }); // its style sheet may come later
  const scheme = window.matchMedia("(prefers-color-scheme: dark)");
  const fromKernel = () => {
    if (model.get("data") !== onData.last) { onData(); return; }
    if (model.get("half_step") === look.i && model.get("landmark") === look.chosen && model.get("show") === look.show) return;
    clearTimeout(saving);
    Object.assign(look, { i: model.get("half_step"), chosen: model.get("landmark") });
    if (look.show !== model.get("show")) { look.show = model.get("show"); which.select.value = look.show; arrange(); } else draw();
  };
  const onData = () => {
    onData.last = model.get("data");
    history = unpack(model.get("header"), model.get("data"));
    look.i = model.get("half_step"); // the same frame; another run may have more half-steps
    recolour();
    build();
  };
  onData();
  root.addEventListener("keydown", onKey);
  resize.observe(root);
  themes.observe(document.body, { attributes: true });
  themes.observe(document.documentElement, { attributes: true });
  scheme.addEventListener("change", recheck);
  model.on("change", fromKernel);
  root.explorer = { go, choose, state: () => plain({ i: look.i, label: history.labels[look.i], chosen: look.chosen,
    show: look.show, caption: caption.textContent, playing: timer > 0, theme: root.dataset.theme, colours: look.colours,
    paper: look.paper, ...shown }) };
  return () => {
    clearInterval(timer);
    clearTimeout(saving);
    resize.disconnect();
    themes.disconnect();
    scheme.removeEventListener("change", recheck);
    model.off("change", fromKernel);
  };
}

/** Numbers as a test can read them: typed arrays as lists, what is not finite as null. */
const plain = (value) => JSON.parse(JSON.stringify(value, (_, v) => (ArrayBuffer.isView(v) ? [...v] : v)));

/** The two names of an entry of the matrix and its value. */
function entryText(run, { shot, row, column, d }, shown) {
  const value = shown.values[row * d + column], names = `${rowName(run, shot, row)} · ${rowName(run, shot, column)}`;
  if (Number.isNaN(value)) return `${names}: new`;
  if (shown.reading === "correlation") return `${names}: ${value.toFixed(2)}`;
  const units = [rowUnit(run, shot, row), rowUnit(run, shot, column)];
  const unit = units[0] === units[1] ? (units[0].includes("/") ? `(${units[0]})²` : `${units[0]}²`) : units.join(" · ");
  return `${names}: ${value.toExponential(2)} ${unit}`;
}

export default { render };
