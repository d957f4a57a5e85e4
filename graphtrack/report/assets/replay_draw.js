// Drawing one moment of the replay on a canvas. Lengths on the ground are metres, marks are CSS pixels.

function readTheme(element) {
  const style = getComputedStyle(element);
  const theme = {};
  ["body", "head", "velocity", "ink", "muted", "grid", "surface", "accent", "alarm"].forEach((name) => {
    theme[name] = style.getPropertyValue("--" + name).trim();
  });
  return theme;
}

// The smallest of 1, 2, 5 × 10^k metres that is at least `wanted`.
function niceStep(wanted) {
  const decade = Math.pow(10, Math.floor(Math.log10(wanted)));
  return [1, 2, 5, 10].map((m) => m * decade).find((step) => step >= wanted * 0.999);
}

function makeView(bounds, width, height) {
  const scale = Math.min(width / (bounds[2] - bounds[0]), height / (bounds[3] - bounds[1]));
  return { x: (bounds[0] + bounds[2]) / 2, y: (bounds[1] + bounds[3]) / 2, scale, width, height };
}

function toScreen(view, x, y) {
  return [view.width / 2 + (x - view.x) * view.scale, view.height / 2 - (y - view.y) * view.scale];
}

function metres(value, digits) { return value.toFixed(digits).replace("-", "−"); }

function drawGrid(ctx, view, theme) {
  const step = niceStep(70 / view.scale);
  const halfWidth = view.width / 2 / view.scale, halfHeight = view.height / 2 / view.scale;
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  ctx.strokeStyle = theme.grid; ctx.fillStyle = theme.muted; ctx.lineWidth = 1; ctx.font = "11px system-ui, sans-serif";
  ctx.beginPath();
  for (let k = Math.ceil((view.x - halfWidth) / step); k * step <= view.x + halfWidth; k++) {
    const sx = Math.round(toScreen(view, k * step, 0)[0]) + 0.5;
    ctx.moveTo(sx, 0); ctx.lineTo(sx, view.height);
    const label = metres(k * step, digits) + " m";
    if (sx + 3 + ctx.measureText(label).width < view.width) ctx.fillText(label, sx + 3, view.height - 5);
  }
  for (let k = Math.ceil((view.y - halfHeight) / step); k * step <= view.y + halfHeight; k++) {
    const sy = Math.round(toScreen(view, 0, k * step)[1]) + 0.5;
    ctx.moveTo(0, sy); ctx.lineTo(view.width, sy);
    if (sy > 14 && sy < view.height - 22) ctx.fillText(metres(k * step, digits), 4, sy - 3);
  }
  ctx.stroke();
}

// Dashes lie still on the ground, wherever the trail begins: metres walked until each sample.
function alongPath(person) {
  if (!person.along) {
    person.along = new Float64Array(person.x.length);
    for (let i = 1; i < person.x.length; i++) {
      const step = Math.hypot(person.x[i] - person.x[i - 1], person.y[i] - person.y[i - 1]);
      person.along[i] = person.along[i - 1] + (Number.isFinite(step) ? step : 0);
    }
  }
  return person.along;
}

function setDash(ctx, person, width) { ctx.setLineDash(person.dash.map((length) => length * width)); }

// From the sample at `first` to the one at `last`, and on to `now` (screen) if given.
function tracePath(ctx, view, person, xs, ys, first, last, now) {
  let drawing = false, previous = -Infinity, px = NaN, py = NaN;
  ctx.beginPath();
  for (let i = first; i <= last; i++) {
    if (!Number.isFinite(xs[i]) || !Number.isFinite(ys[i])) { drawing = false; continue; }
    const sx = view.width / 2 + (xs[i] - view.x) * view.scale, sy = view.height / 2 - (ys[i] - view.y) * view.scale;
    if (!drawing || person.t[i] - previous > person.hole) ctx.moveTo(sx, sy);
    // Steps of less than a pixel cost time and show nothing.
    else if (i < last && Math.abs(sx - px) < 1 && Math.abs(sy - py) < 1) { previous = person.t[i]; continue; }
    else ctx.lineTo(sx, sy);
    drawing = true; previous = person.t[i]; px = sx; py = sy;
  }
  if (drawing && now) ctx.lineTo(now[0], now[1]);
  ctx.stroke();
}

// [first, last, whether a gap] of the parts of a path between samples, by what was seen.
function trailParts(person, first, last) {
  const parts = [];
  let from = first;
  person.gaps.forEach((gap) => {
    const start = Math.max(indexAt(person.t, gap.from), from), end = Math.min(indexAt(person.t, gap.to), last);
    if (!gap.filled || end <= start) return;
    if (start > from) parts.push([from, start, false]);
    parts.push([start, end, true]);
    from = end;
  });
  if (from < last || !parts.length) parts.push([from, last, false]);
  return parts;
}

function strokePath(ctx, view, person, first, last, now, width, colour) {
  ctx.strokeStyle = colour; ctx.lineWidth = width; ctx.lineJoin = "round"; ctx.lineCap = "butt";
  trailParts(person, first, last).forEach(([from, to, gap]) => {
    // What was filled in is dotted, on no dashes.
    if (gap) ctx.setLineDash([width, 1.5 * width]); else setDash(ctx, person, width);
    ctx.lineDashOffset = gap ? 0 : alongPath(person)[from] * view.scale;
    tracePath(ctx, view, person, person.x, person.y, from, to, to === last ? now : null);
  });
  ctx.setLineDash([]);
}

// Everybody's whole path, the fainter the more there are, without the dashes, which many thin lines turn into dust.
function drawPaths(ctx, view, people) {
  const shown = people.filter((p) => p.shown);
  ctx.globalAlpha = shown.length <= 10 ? 0.45 : Math.max(0.16, 1.4 / Math.sqrt(shown.length));
  ctx.lineWidth = 1; ctx.lineJoin = "round";
  shown.forEach((p) => { ctx.strokeStyle = p.colour; tracePath(ctx, view, p, p.x, p.y, 0, p.t.length - 1, null); });
  ctx.globalAlpha = 1;
}

// The whole path of someone the reader points at or has chosen, on a halo in the colour of the ground.
function drawChosenPath(ctx, view, person, theme) {
  const last = person.t.length - 1;
  ctx.strokeStyle = theme.surface; ctx.lineWidth = 6; ctx.globalAlpha = 0.8;
  tracePath(ctx, view, person, person.x, person.y, 0, last, null);
  ctx.globalAlpha = 1;
  strokePath(ctx, view, person, 0, last, null, 2.6, person.colour);
}

function drawArrow(ctx, from, angle, length, width, colour, halo) {
  if (!Number.isFinite(angle)) return;
  const c = Math.cos(angle), s = -Math.sin(angle);
  const tip = [from[0] + c * length, from[1] + s * length];
  const barb = 2.1 * width + 2;
  const at = (along, across) => [tip[0] + along * c - across * s, tip[1] + along * s + across * c];
  // A halo in the colour of the ground keeps crossing arrows apart; among very many it would hide more than it shows.
  const strokes = halo ? [[halo, width + 2.5, 1.4], [colour, width, 0]] : [[colour, width, 0]];
  strokes.forEach(([paint, line, grow]) => {
    ctx.strokeStyle = ctx.fillStyle = paint; ctx.lineWidth = line; ctx.lineCap = "round";
    ctx.beginPath(); ctx.moveTo(...from); ctx.lineTo(...at(-barb, 0)); ctx.stroke();
    ctx.beginPath(); ctx.moveTo(...at(grow, 0)); ctx.lineTo(...at(-barb - grow, 0.62 * barb + grow)); ctx.lineTo(...at(-barb - grow, -0.62 * barb - grow));
    ctx.closePath(); ctx.fill();
  });
}

function drawTruth(ctx, view, state, theme) {
  if (!Number.isFinite(state.true_x)) return;
  const [sx, sy] = toScreen(view, state.true_x, state.true_y);
  ctx.strokeStyle = theme.ink; ctx.lineWidth = 1.2; ctx.setLineDash([3, 2]);
  ctx.beginPath(); ctx.arc(sx, sy, 9, 0, TURN); ctx.stroke();
  ctx.setLineDash([]);
  [["true_body", 25, 2], ["true_head", 19, 1]].forEach(([name, length, line]) => {
    const angle = state[name];
    if (!Number.isFinite(angle)) return;
    ctx.lineWidth = line;
    ctx.beginPath(); ctx.moveTo(sx + 9 * Math.cos(angle), sy - 9 * Math.sin(angle));
    ctx.lineTo(sx + length * Math.cos(angle), sy - length * Math.sin(angle)); ctx.stroke();
  });
}

function sensorColour(scene, person, at) {
  const sensor = scene.sensors[person.sensor[at]];
  return sensor ? sensor.colour : null;
}

// The observations of a sample and of the others at its time, in the colours of their sensors, with 95 % of their ellipses.
function drawObservations(ctx, view, person, nearest, scene, size) {
  samplesTogether(person, nearest).forEach((at) => {
    if ((person.seen !== null && person.seen[at] !== "1") || !Number.isFinite(person.seen_x[at])) return;
    const [ox, oy] = toScreen(view, person.seen_x[at], person.seen_y[at]), colour = sensorColour(scene, person, at) || scene.theme.ink;
    if (Number.isFinite(person.seen_major[at])) {
      ctx.strokeStyle = colour; ctx.lineWidth = 1; ctx.setLineDash([3, 2]);
      ctx.beginPath(); ctx.ellipse(ox, oy, person.seen_major[at] * view.scale, person.seen_minor[at] * view.scale, -person.seen_tilt[at], 0, TURN); ctx.stroke();
      ctx.setLineDash([]);
    }
    ctx.strokeStyle = scene.theme.surface; ctx.fillStyle = colour; ctx.lineWidth = 1;
    ctx.beginPath(); ctx.arc(ox, oy, 3.2 * size, 0, TURN); ctx.fill(); ctx.stroke();
  });
}

// Fields of view in the colours of their sensors; those that were learned are dashed.
function drawViews(ctx, view, sensors) {
  sensors.filter((one) => one.outline).forEach((one) => {
    traceOutline(ctx, view, one.outline);
    ctx.strokeStyle = ctx.fillStyle = one.colour; ctx.lineWidth = 1.4; ctx.setLineDash(one.learned ? [6, 4] : []);
    ctx.globalAlpha = 0.05; ctx.fill(); ctx.globalAlpha = 0.8; ctx.stroke(); ctx.globalAlpha = 1; ctx.setLineDash([]);
  });
}

// `size` shrinks the symbols in crowds; `strong`: the hovered or selected person.
function drawPerson(ctx, view, person, state, scene, size, strong) {
  const { layers, theme, time, trail } = scene, here = toScreen(view, state.x, state.y), halo = size < 0.8 ? null : theme.surface;
  if (layers.ellipse && Number.isFinite(state.major)) {
    ctx.beginPath();
    ctx.ellipse(here[0], here[1], state.major * view.scale, state.minor * view.scale, -state.tilt, 0, TURN);
    ctx.fillStyle = person.colour; ctx.globalAlpha = 0.18; ctx.fill();
    ctx.strokeStyle = person.colour; ctx.globalAlpha = 0.9; ctx.lineWidth = 1; ctx.stroke(); ctx.globalAlpha = 1;
  }
  const since = Math.max(indexAt(person.t, time - trail), 0);
  if (layers.truth) {
    ctx.strokeStyle = theme.ink; ctx.lineWidth = 1; ctx.setLineDash([4, 3]); ctx.globalAlpha = 0.6;
    if (layers.trail) tracePath(ctx, view, person, person.true_x, person.true_y, since, state.index, null);
    ctx.setLineDash([]); ctx.globalAlpha = 1;
    drawTruth(ctx, view, state, theme);
  }
  if (layers.trail) strokePath(ctx, view, person, since, state.index, here, 2.2, person.colour);
  if (layers.observation) drawObservations(ctx, view, person, state.nearest, scene, size);
  if (layers.body) drawArrow(ctx, here, state.body, 32 * size, 4 * size, theme.body, halo);
  if (layers.velocity) drawVelocity(ctx, view, state, here, theme);
  if (layers.head) drawArrow(ctx, here, state.head, 24 * size, 2.4 * size, theme.head, halo);
  if (strong) {
    ctx.beginPath(); ctx.arc(here[0], here[1], 11, 0, TURN);
    ctx.strokeStyle = theme.accent; ctx.lineWidth = 2.5; ctx.stroke();
  }
  ctx.beginPath(); ctx.arc(here[0], here[1], 5.5 * size, 0, TURN);
  ctx.fillStyle = state.seen ? person.colour : theme.surface;
  ctx.strokeStyle = state.seen ? sensorColour(scene, person, state.nearest) || theme.surface : person.colour; ctx.lineWidth = state.seen ? 1.5 : 2.5 * size;
  ctx.fill(); ctx.stroke();
}

// Ids, each where it covers none that is there already: in a crowd the rest are named when one points at them.
function drawLabels(ctx, view, present, theme) {
  const taken = [];
  ctx.font = "600 12px system-ui, sans-serif"; ctx.lineWidth = 3; ctx.strokeStyle = theme.surface; ctx.fillStyle = theme.ink;
  ctx.lineJoin = "round";
  present.forEach(({ person, state, strong }) => {
    const [sx, sy] = toScreen(view, state.x, state.y), width = ctx.measureText(person.id).width;
    const left = sx + 8 + width > view.width && sx > 8 + width ? sx - 8 - width : sx + 8;  // at the right border
    const box = [left, sy + 7, left + width, sy + 19];
    if (!strong && taken.some((other) => box[0] < other[2] && other[0] < box[2] && box[1] < other[3] && other[1] < box[3])) return;
    taken.push(box);
    ctx.strokeText(person.id, left, sy + 17); ctx.fillText(person.id, left, sy + 17);
  });
}

// One second long on the ground: the arrow ends where the person would be in a second.
function drawVelocity(ctx, view, state, here, theme) {
  const speed = Math.hypot(state.vx, state.vy);
  if (speed * view.scale > 6) drawArrow(ctx, here, Math.atan2(state.vy, state.vx), speed * view.scale, 2, theme.velocity, theme.surface);
}

// Births, deaths and joins, and switches with both ids, for a moment after they happened.
function drawMarks(ctx, view, scene) {
  const { people, layers, theme, time, linger } = scene, fresh = (t) => t <= time + 1e-6 && time < t + linger;
  const place = (person, at) => toScreen(view, person.x[at], person.y[at]);
  if (layers.lives) {
    people.filter((person) => person.shown).forEach((person) => marksOf(person).filter((mark) => fresh(mark.t)).forEach((mark) => {
      const [sx, sy] = place(person, mark.at);
      ctx.strokeStyle = theme.ink; ctx.fillStyle = "transparent"; ctx.lineWidth = 2;
      if (mark.kind === "birth") drawRing(ctx, sx, sy, 10);
      else if (mark.kind === "death") drawCross(ctx, sx, sy, 6);
      else drawJoin(ctx, sx, sy - 13, 5, mark.p, scene.unsure, theme);
    }));
  }
  if (!layers.events) return;
  ctx.font = "600 12px system-ui, sans-serif"; ctx.lineJoin = "round";
  scene.events.filter((event) => event.to >= 0 && people[event.to].shown && fresh(event.t)).forEach((event) => {
    const person = people[event.to], [sx, sy] = place(person, Math.max(indexAt(person.t, event.t), 0));
    ctx.strokeStyle = theme.alarm; ctx.lineWidth = 2; ctx.strokeRect(sx - 10, sy - 10, 20, 20);
    if (!event.isSwitch) return;
    const words = event.before + " → " + event.after;
    ctx.strokeStyle = theme.surface; ctx.lineWidth = 3; ctx.strokeText(words, sx + 12, sy - 8);
    ctx.fillStyle = theme.alarm; ctx.fillText(words, sx + 12, sy - 8);
  });
}

function markSize(count) { return count <= 12 ? 1 : Math.max(0.6, Math.sqrt(12 / count)); }

// The image under the paths, faint: the paths have to stand out.
function drawGround(ctx, view, ground) {
  const [left, right, bottom, top] = ground.extent, [x0, y0] = toScreen(view, left, top), [x1, y1] = toScreen(view, right, bottom);
  ctx.globalAlpha = 0.55; ctx.drawImage(ground.image, x0, y0, x1 - x0, y1 - y0); ctx.globalAlpha = 1;
}

// scene: {people, layers, theme, time, trail, backdrop, strong, unsure, events, behaviour, sensors, ground, linger}. `strong` holds the indices of those to be made plain.
// Returns how many people are there.
function drawMoment(ctx, view, scene) {
  ctx.clearRect(0, 0, view.width, view.height);
  if (scene.layers.background && scene.ground && scene.ground.image.complete) drawGround(ctx, view, scene.ground);
  drawGrid(ctx, view, scene.theme);
  if (scene.layers.views) drawViews(ctx, view, scene.sensors);
  if (scene.backdrop) ctx.drawImage(scene.backdrop, 0, 0, view.width, view.height);
  const present = [];
  scene.people.forEach((person, index) => {
    const strong = scene.strong.includes(index), state = person.shown ? stateAt(person, scene.time) : null;
    if (strong && person.shown) drawChosenPath(ctx, view, person, scene.theme);
    if (state) present.push({ person, state, strong, index });
  });
  // Those to be made plain are drawn over the others, but their ids take their places first.
  present.sort((a, b) => a.strong - b.strong);
  const size = markSize(present.length);
  drawBehaviour(ctx, view, scene, present);
  present.forEach(({ person, state, strong }) => drawPerson(ctx, view, person, state, scene, strong ? 1 : size, strong));
  drawMarks(ctx, view, scene);
  if (scene.layers.label) drawLabels(ctx, view, present.slice().reverse(), scene.theme);
  return present.length;
}
