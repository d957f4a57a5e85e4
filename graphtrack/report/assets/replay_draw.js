// Drawing one moment of the replay on a canvas. Lengths on the ground are metres, marks are CSS pixels.

function readTheme(element) {
  const style = getComputedStyle(element);
  const theme = {};
  ["body", "head", "velocity", "ink", "muted", "grid", "surface"].forEach((name) => {
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
    ctx.fillText(metres(k * step, digits) + " m", sx + 3, view.height - 5);
  }
  for (let k = Math.ceil((view.y - halfHeight) / step); k * step <= view.y + halfHeight; k++) {
    const sy = Math.round(toScreen(view, 0, k * step)[1]) + 0.5;
    ctx.moveTo(0, sy); ctx.lineTo(view.width, sy);
    if (sy > 14 && sy < view.height - 22) ctx.fillText(metres(k * step, digits), 4, sy - 3);
  }
  ctx.stroke();
}

function drawTrail(ctx, view, person, xs, ys, upTo, since, now) {
  let drawing = false, previous = -Infinity;
  ctx.beginPath();
  for (let i = Math.max(indexAt(person.t, since), 0); i <= upTo; i++) {
    if (!Number.isFinite(xs[i]) || !Number.isFinite(ys[i])) { drawing = false; continue; }
    const [sx, sy] = toScreen(view, xs[i], ys[i]);
    if (drawing && person.t[i] - previous <= person.hole) ctx.lineTo(sx, sy); else ctx.moveTo(sx, sy);
    drawing = true; previous = person.t[i];
  }
  if (drawing && now) ctx.lineTo(...toScreen(view, now[0], now[1]));
  ctx.stroke();
}

function drawArrow(ctx, from, angle, length, width, colour, halo) {
  if (!Number.isFinite(angle)) return;
  const c = Math.cos(angle), s = -Math.sin(angle);
  const tip = [from[0] + c * length, from[1] + s * length];
  const barb = 2.1 * width + 2;
  const at = (along, across) => [tip[0] + along * c - across * s, tip[1] + along * s + across * c];
  // A halo in the colour of the ground keeps crossing arrows apart.
  [[halo, width + 2.5, 1.4], [colour, width, 0]].forEach(([paint, line, grow]) => {
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

function drawPerson(ctx, view, person, state, layers, theme, t, trailSeconds) {
  const here = toScreen(view, state.x, state.y);
  ctx.lineJoin = "round";
  if (layers.ellipse && Number.isFinite(state.major)) {
    ctx.beginPath();
    ctx.ellipse(here[0], here[1], state.major * view.scale, state.minor * view.scale, -state.tilt, 0, TURN);
    ctx.fillStyle = person.colour; ctx.globalAlpha = 0.18; ctx.fill();
    ctx.strokeStyle = person.colour; ctx.globalAlpha = 0.9; ctx.lineWidth = 1; ctx.stroke(); ctx.globalAlpha = 1;
  }
  if (layers.truth) {
    ctx.strokeStyle = theme.ink; ctx.lineWidth = 1; ctx.setLineDash([4, 3]); ctx.globalAlpha = 0.6;
    if (layers.trail) drawTrail(ctx, view, person, person.true_x, person.true_y, state.index, t - trailSeconds, null);
    ctx.setLineDash([]); ctx.globalAlpha = 1;
    drawTruth(ctx, view, state, theme);
  }
  if (layers.trail) {
    ctx.strokeStyle = person.colour; ctx.lineWidth = 2.2;
    drawTrail(ctx, view, person, person.x, person.y, state.index, t - trailSeconds, [state.x, state.y]);
  }
  if (layers.observation && state.seen && Number.isFinite(state.seen_x)) {
    const [ox, oy] = toScreen(view, state.seen_x, state.seen_y);
    ctx.strokeStyle = theme.surface; ctx.fillStyle = theme.ink; ctx.lineWidth = 1;
    ctx.beginPath(); ctx.arc(ox, oy, 3.2, 0, TURN); ctx.fill(); ctx.stroke();
  }
  if (layers.body) drawArrow(ctx, here, state.body, 32, 4, theme.body, theme.surface);
  if (layers.velocity) drawVelocity(ctx, view, state, here, theme);
  if (layers.head) drawArrow(ctx, here, state.head, 24, 2.4, theme.head, theme.surface);
  ctx.beginPath(); ctx.arc(here[0], here[1], 5.5, 0, TURN);
  ctx.fillStyle = state.seen ? person.colour : theme.surface;
  ctx.strokeStyle = state.seen ? theme.surface : person.colour; ctx.lineWidth = state.seen ? 1.5 : 2.5;
  ctx.fill(); ctx.stroke();
  if (layers.label) {
    const text = String(person.id);
    ctx.font = "600 12px system-ui, sans-serif"; ctx.lineWidth = 3; ctx.strokeStyle = theme.surface; ctx.fillStyle = theme.ink;
    ctx.strokeText(text, here[0] + 8, here[1] + 17); ctx.fillText(text, here[0] + 8, here[1] + 17);
  }
}

// One second long on the ground: the arrow ends where the person would be in a second.
function drawVelocity(ctx, view, state, here, theme) {
  const speed = Math.hypot(state.vx, state.vy);
  if (speed * view.scale > 6) drawArrow(ctx, here, Math.atan2(state.vy, state.vx), speed * view.scale, 2, theme.velocity, theme.surface);
}

function drawMoment(ctx, view, people, layers, theme, t, trailSeconds) {
  ctx.clearRect(0, 0, view.width, view.height);
  drawGrid(ctx, view, theme);
  let present = 0;
  people.forEach((person) => {
    const state = person.shown ? stateAt(person, t) : null;
    if (!state) return;
    present += 1;
    drawPerson(ctx, view, person, state, layers, theme, t, trailSeconds);
  });
  return present;
}
