// Drawing speed, heading, body and head of one person over time on a canvas: bands, observations, estimate and truth.

const CHART = { left: 52, right: 10, top: 8, bottom: 34, gap: 16, tall: 130 };  // tall: pixels of a panel
const BANDS = [[1.96, 0.18], [1, 0.28]];  // 95 % and ±1σ, and how dark

// The angle without jumps of a turn; what is not known stays so.
function unwrapped(angles) {
  let last = NaN;
  return angles.map((angle) => {
    if (!Number.isFinite(angle)) return NaN;
    last = Number.isFinite(last) ? last + arc(last, angle) : angle;
    return last;
  });
}

// [first, last] of each run of samples that are known and have no hole between them.
function knownRuns(t, values, hole) {
  const runs = [];
  values.forEach((value, i) => {
    if (!Number.isFinite(value)) return;
    const run = runs[runs.length - 1];
    if (run && run[1] === i - 1 && t[i] - t[i - 1] <= hole) run[1] = i; else runs.push([i, i]);
  });
  return runs;
}

// By how many turns a run from `low` to `high` must be moved to be seen between -π and π.
function turnsInSight(low, high) {
  const turns = [];
  for (let k = Math.ceil((-Math.PI - high) / TURN); k <= Math.floor((Math.PI - low) / TURN); k++) turns.push(k);
  return turns;
}

// The quantities of a person that have a panel, from above.
function chartNames(person) {
  const known = (name) => (person[name] || []).some(Number.isFinite);
  return ["speed", "heading", "body", "head"].filter((name) => known(name) || known("seen_" + name));
}

function colourOf(name, theme) { return theme[name] || theme.velocity; }

// The top of the scale of speeds: a round number above all but a few ends of intervals, which a moment of doubt can send far up.
function topSpeed(person) {
  const ends = Array.from(person.speed, (speed, i) => Math.max(speed, person.speed_high[i] || 0)).filter(Number.isFinite).sort((a, b) => a - b);
  const fastest = person.speed.reduce((most, speed) => Math.max(most, speed || 0), 0.1);
  const most = Math.max(ends[Math.floor(0.98 * (ends.length - 1))] || 0, fastest);
  return [0.2, 0.5, 1, 1.5, 2, 3].find((top) => top >= most) || niceStep(most);
}

function panelsOf(names, width, height) {
  const tall = (height - CHART.top - CHART.bottom - CHART.gap * (names.length - 1)) / Math.max(names.length, 1);
  return names.map((name, i) => ({ name, left: CHART.left, right: width - CHART.right, top: CHART.top + i * (tall + CHART.gap), bottom: CHART.top + i * (tall + CHART.gap) + tall }));
}

function timeToScreen(range, width, t) { return CHART.left + (t - range[0]) / (range[1] - range[0]) * (width - CHART.left - CHART.right); }

function screenToTime(range, width, sx) { return range[0] + (sx - CHART.left) / (width - CHART.left - CHART.right) * (range[1] - range[0]); }

// [value, place from 0 at the bottom to 1] of the lines of a panel.
function linesOf(panel) {
  if (panel.name === "speed") return [0, 0.5, 1].map((share) => [+(share * panel.top_speed).toPrecision(3), share]);
  return [-180, -90, 0, 90, 180].map((degrees) => [degrees, degrees / 360 + 0.5]);
}

function drawAxes(ctx, panels, range, width, theme) {
  ctx.font = "12px system-ui, sans-serif"; ctx.lineWidth = 1;
  const bottom = panels[panels.length - 1].bottom, step = niceStep(90 * (range[1] - range[0]) / (width - CHART.left - CHART.right));
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  panels.forEach((panel) => {
    ctx.strokeStyle = theme.grid; ctx.fillStyle = theme.muted; ctx.textAlign = "right"; ctx.textBaseline = "middle";
    ctx.beginPath();
    linesOf(panel).forEach(([value, share]) => {
      const sy = Math.round(panel.bottom - share * (panel.bottom - panel.top)) + 0.5;
      ctx.moveTo(panel.left, sy); ctx.lineTo(panel.right, sy);
      ctx.fillText(String(value).replace("-", "−"), panel.left - 6, sy);
    });
    for (let k = Math.ceil(range[0] / step); k * step <= range[1]; k++) {
      const sx = Math.round(timeToScreen(range, width, k * step)) + 0.5;
      ctx.moveTo(sx, panel.top); ctx.lineTo(sx, panel.bottom);
    }
    ctx.stroke();
    ctx.save(); ctx.translate(11, (panel.top + panel.bottom) / 2); ctx.rotate(-TURN / 4);
    ctx.fillStyle = theme.ink; ctx.textAlign = "center"; ctx.fillText(panel.name + (panel.name === "speed" ? " (m/s)" : " (°)"), 0, 0); ctx.restore();
  });
  ctx.fillStyle = theme.muted; ctx.textAlign = "center"; ctx.textBaseline = "top";
  for (let k = Math.ceil(range[0] / step); k * step <= range[1]; k++) ctx.fillText((k * step).toFixed(digits).replace("-", "−"), timeToScreen(range, width, k * step), bottom + 5);
  ctx.fillStyle = theme.ink; ctx.fillText("time (s)", (CHART.left + width) / 2, bottom + 19);
  ctx.textAlign = "left"; ctx.textBaseline = "alphabetic";
}

function angleToScreen(panel, angle) { return (panel.top + panel.bottom) / 2 - angle / TURN * (panel.bottom - panel.top); }

function drawSpeed(ctx, panel, person, range, width, theme) {
  const at = (i) => timeToScreen(range, width, person.t[i]);
  const y = (speed) => panel.bottom - speed / panel.top_speed * (panel.bottom - panel.top);
  const trace = (values, first, last, step) => { for (let i = first; i !== last + step; i += step) ctx.lineTo(at(i), y(values[i])); };
  ctx.save();
  ctx.beginPath(); ctx.rect(panel.left, panel.top, panel.right - panel.left, panel.bottom - panel.top); ctx.clip();
  ctx.fillStyle = ctx.strokeStyle = theme.velocity; ctx.lineJoin = "round"; ctx.lineWidth = 2;
  ctx.globalAlpha = 0.22;
  knownRuns(person.t, person.speed_low, person.hole).forEach(([first, last]) => {
    ctx.beginPath(); trace(person.speed_high, first, last, 1); trace(person.speed_low, last, first, -1); ctx.fill();
  });
  ctx.globalAlpha = 1;
  knownRuns(person.t, person.speed, person.hole).forEach(([first, last]) => {
    ctx.beginPath(); trace(person.speed, first, last, 1); ctx.stroke();
    if (first === last) { ctx.beginPath(); ctx.arc(at(first), y(person.speed[first]), 3, 0, TURN); ctx.fill(); }
  });
  ctx.restore();
}

function drawPanel(ctx, panel, person, range, width, theme) {
  const { name } = panel, colour = colourOf(name, theme), angle = unwrapped(person[name]), std = person[name + "_std"];
  const at = (i) => timeToScreen(range, width, person.t[i]);
  ctx.save();
  ctx.beginPath(); ctx.rect(panel.left, panel.top, panel.right - panel.left, panel.bottom - panel.top); ctx.clip();
  ctx.fillStyle = theme.grid; ctx.globalAlpha = 0.6;
  unseenSpans(person.t, person["seen_" + name]).forEach(([from, to]) => {
    const left = timeToScreen(range, width, from);
    ctx.fillRect(left, panel.top, timeToScreen(range, width, to) - left, panel.bottom - panel.top);
  });
  const runs = knownRuns(person.t, angle, person.hole);
  BANDS.forEach(([scale, alpha]) => {
    if (!std.length) return;
    const half = angle.map((_, i) => (Number.isFinite(std[i]) ? Math.min(scale * std[i], Math.PI) : 0));
    ctx.fillStyle = colour; ctx.globalAlpha = alpha;
    runs.forEach(([first, last]) => {
      let low = Infinity, high = -Infinity;
      for (let i = first; i <= last; i++) { low = Math.min(low, angle[i] - half[i]); high = Math.max(high, angle[i] + half[i]); }
      turnsInSight(low, high).forEach((k) => {
        ctx.beginPath();
        for (let i = first; i <= last; i++) ctx.lineTo(at(i), angleToScreen(panel, angle[i] + half[i] + k * TURN));
        for (let i = last; i >= first; i--) ctx.lineTo(at(i), angleToScreen(panel, angle[i] - half[i] + k * TURN));
        ctx.fill();
      });
    });
  });
  ctx.globalAlpha = 0.65; ctx.fillStyle = colour;
  person["seen_" + name].forEach((value, i) => {
    if (!Number.isFinite(value)) return;
    ctx.beginPath(); ctx.arc(at(i), angleToScreen(panel, value), 2.2, 0, TURN); ctx.fill();
  });
  ctx.globalAlpha = 1;
  drawCurve(ctx, panel, person, angle, runs, at, colour, 2, []);
  const truth = unwrapped(person["true_" + name]);
  drawCurve(ctx, panel, person, truth, knownRuns(person.t, truth, person.hole), at, theme.ink, 1.2, [5, 3]);
  ctx.restore();
}

// [from, to] in time of gaps of three samples or more of an angle: from the sample seen before to that seen after.
// Nothing where it was never seen: then there is no detector of it.
function unseenSpans(t, seen) {
  const spans = [];
  let last = -1;
  if (!seen.some(Number.isFinite)) return spans;
  for (let i = 0; i <= seen.length; i++) {
    if (i < seen.length && !Number.isFinite(seen[i])) continue;
    if (i - last > 3) spans.push([t[Math.max(last, 0)], t[Math.min(i, t.length - 1)]]);
    last = i;
  }
  return spans;
}

function drawCurve(ctx, panel, person, angle, runs, at, colour, width, dash) {
  ctx.strokeStyle = ctx.fillStyle = colour; ctx.lineWidth = width; ctx.lineJoin = "round"; ctx.setLineDash(dash);
  runs.forEach(([first, last]) => {
    let low = Infinity, high = -Infinity;
    for (let i = first; i <= last; i++) { low = Math.min(low, angle[i]); high = Math.max(high, angle[i]); }
    turnsInSight(low, high).forEach((k) => {
      ctx.beginPath();
      for (let i = first; i <= last; i++) ctx.lineTo(at(i), angleToScreen(panel, angle[i] + k * TURN));
      ctx.stroke();
      // A line needs two points: what is known at one sample alone would be invisible.
      if (first === last) { ctx.beginPath(); ctx.arc(at(first), angleToScreen(panel, angle[first] + k * TURN), 3, 0, TURN); ctx.fill(); }
    });
  });
  ctx.setLineDash([]);
}

function drawAngles(ctx, width, height, person, range, theme) {
  ctx.clearRect(0, 0, width, height);
  const panels = panelsOf(chartNames(person), width, height);
  if (!panels.length) return;
  panels.forEach((panel) => { panel.top_speed = panel.name === "speed" ? topSpeed(person) : NaN; });
  drawAxes(ctx, panels, range, width, theme);
  panels.forEach((panel) => (panel.name === "speed" ? drawSpeed : drawPanel)(ctx, panel, person, range, width, theme));
}

function drawTimeMark(ctx, width, height, range, t, colour) {
  if (!(t >= range[0] && t <= range[1])) return;
  const sx = timeToScreen(range, width, t);
  ctx.strokeStyle = colour; ctx.lineWidth = 1;
  ctx.beginPath(); ctx.moveTo(sx, CHART.top); ctx.lineTo(sx, height - CHART.bottom); ctx.stroke();
}

// Text description of the chart at a time.
function anglesInWords(person, t) {
  const state = stateAt(person, t), degrees = (angle) => Math.round(angle / TURN * 360).toString().replace("-", "−") + "°";
  if (!state) return t.toFixed(2) + " s: not there (" + person.t[0].toFixed(1) + " to " + person.t[person.t.length - 1].toFixed(1) + " s)";
  const metres = (value) => value.toFixed(2);
  const parts = chartNames(person).map((name) => {
    if (name === "speed") return "speed " + metres(state.speed) + " m/s" + (Number.isFinite(state.speed_low) ? " (95\u202f%: " + metres(state.speed_low) + " to " + metres(state.speed_high) + ")" : "");
    const std = state[name + "_std"], seen = state["seen_" + name], truth = state["true_" + name];
    const extra = [Number.isFinite(seen) ? "observed " + degrees(seen) : "", Number.isFinite(truth) ? "truth " + degrees(truth) : ""].filter(Boolean);
    const value = Number.isFinite(state[name]) ? degrees(state[name]) + (Number.isFinite(std) ? " ± " + degrees(std) : "") : "–";
    return name + " " + value + (extra.length ? " (" + extra.join(", ") + ")" : "");
  });
  return t.toFixed(2) + " s: " + (parts.join(" · ") || "no speed or angle is known");
}
