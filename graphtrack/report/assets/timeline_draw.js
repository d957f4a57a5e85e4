// Drawing people's lives on a canvas, a row each: bars, gaps, joins, and where identities went wrong.
// TIMELINE.left is as wide as the names, see roomForNames.

const TIMELINE = { left: 52, right: 14, top: 10, bottom: 34 };

const NAME_FONT = "600 12px system-ui, sans-serif";

// Pixels that the names need, to a quarter of the width.
function roomForNames(ctx, people, width) {
  ctx.font = NAME_FONT;
  const widest = people.reduce((most, person) => Math.max(most, ctx.measureText(person.id).width), 0);
  return Math.round(Math.max(52, Math.min(widest + 18, 0.25 * width)));
}

// A name cut to a width, with the context's font.
function cutToWidth(ctx, name, width) {
  if (ctx.measureText(name).width <= width) return name;
  let count = name.length;
  while (count > 1 && ctx.measureText(name.slice(0, count) + "…").width > width) count -= 1;
  return name.slice(0, count) + "…";
}

function rowHeightOf(count) { return count <= 12 ? 24 : count <= 24 ? 18 : 14; }

function drawDiamond(ctx, x, y, size) {
  ctx.beginPath(); ctx.moveTo(x, y - size); ctx.lineTo(x + size, y); ctx.lineTo(x, y + size); ctx.lineTo(x - size, y); ctx.closePath();
}

function drawCross(ctx, x, y, size) {
  ctx.beginPath(); ctx.moveTo(x - size, y - size); ctx.lineTo(x + size, y + size); ctx.moveTo(x + size, y - size); ctx.lineTo(x - size, y + size); ctx.stroke();
}

function drawRing(ctx, x, y, size) { ctx.beginPath(); ctx.arc(x, y, size, 0, TURN); ctx.fill(); ctx.stroke(); }

// A join, filled if it is sure.
function drawJoin(ctx, x, y, size, p, unsure, theme) {
  drawDiamond(ctx, x, y, size);
  ctx.fillStyle = p < unsure ? theme.surface : theme.ink; ctx.strokeStyle = theme.ink; ctx.lineWidth = 1.5;
  ctx.fill(); ctx.stroke();
}

function drawEventBox(ctx, x, y, size, isSwitch, theme) {
  ctx.fillStyle = isSwitch ? theme.alarm : theme.surface; ctx.strokeStyle = theme.alarm; ctx.lineWidth = 1.6;
  ctx.beginPath(); ctx.rect(x - size, y - size, 2 * size, 2 * size); ctx.fill(); ctx.stroke();
}

function drawLife(ctx, person, y, tall, at, scene) {
  const { theme, unsure } = scene, half = Math.round(0.32 * tall);
  ctx.fillStyle = ctx.strokeStyle = person.colour;
  // However short it was, it is to be seen.
  seenParts(person).forEach(([from, to]) => ctx.fillRect(at(from), y - half, Math.max(at(to) - at(from), 2), 2 * half));
  unsureLinks(person, 0.995).forEach(({ from, to, p }) => {
    // Whole pixels: between parts of them the page would shine through.
    const first = Math.round(at(from)), wide = Math.max(Math.round(at(to)) - first, p < unsure ? 3 : 0), left = Math.min(first, Math.round(at(to)) - wide);
    ctx.globalAlpha = 1; ctx.fillStyle = theme.surface; ctx.fillRect(left, y - half, wide, 2 * half);
    ctx.globalAlpha = 0.12 + 0.88 * p * p; ctx.fillStyle = person.colour; ctx.fillRect(left, y - half, wide, 2 * half);
  });
  ctx.globalAlpha = 1;
  person.gaps.forEach((gap) => {
    ctx.lineWidth = gap.filled ? 2.4 : 1.5; ctx.setLineDash(gap.filled ? [2.4, 2.4] : [1.5, 4]); ctx.strokeStyle = person.colour;
    ctx.beginPath(); ctx.moveTo(at(gap.from), y); ctx.lineTo(at(gap.to), y); ctx.stroke();
  });
  ctx.setLineDash([]);
  const size = Math.min(0.28 * tall, 4.5);
  ctx.strokeStyle = theme.ink; ctx.fillStyle = theme.surface; ctx.lineWidth = 1.6;
  drawRing(ctx, at(birthOf(person)), y, size);
  drawCross(ctx, at(deathOf(person)), y, size);
  person.gaps.forEach((gap) => {
    if (!gap.joined) return;
    // Where much is missed for a moment, sure joins would hide the rest.
    drawJoin(ctx, at(gap.to), y, gap.p < unsure ? size + 0.5 : 0.65 * size, gap.p, unsure, theme);
    const words = Number.isFinite(gap.p) ? percent(gap.p) : "", wide = at(gap.to) - at(gap.from);
    ctx.font = "10px system-ui, sans-serif";
    const room = ctx.measureText(words).width + 2 * size + 6;
    if (!words || tall < 14 || wide < room) return;
    const middle = (at(gap.from) + at(gap.to) - size) / 2;
    ctx.fillStyle = theme.surface; ctx.fillRect(middle - room / 2 + size, y - 6, room - 2 * size, 12);
    ctx.fillStyle = theme.ink; ctx.textAlign = "center"; ctx.textBaseline = "middle"; ctx.fillText(words, middle, y + 0.5);
  });
}

// A line from the row that lost somebody to the one that has them now; towards a row that is not drawn, a piece of it.
function drawEvent(ctx, event, rowOf, at, height, scene) {
  const { theme, tall } = scene, x = at(event.t), size = Math.min(0.2 * tall, 3.2);
  const from = rowOf(event.from), to = rowOf(event.to), y = (row) => TIMELINE.top + (row + 0.5) * tall;
  if (from === undefined && to === undefined) return;
  if (event.isSwitch) {
    ctx.strokeStyle = theme.alarm; ctx.lineWidth = 1.2;
    const start = y(from === undefined ? to : from), end = from === undefined || to === undefined ? start + 0.5 * tall : y(to);
    ctx.beginPath(); ctx.moveTo(x, start); ctx.lineTo(x, end); ctx.stroke();
    ctx.fillStyle = theme.alarm;
    if (from !== undefined) { ctx.beginPath(); ctx.arc(x, y(from), 2, 0, TURN); ctx.fill(); }
  }
  if (to !== undefined) drawEventBox(ctx, x, y(to), size, event.isSwitch, theme);
}

function drawTimeAxis(ctx, width, height, range, theme) {
  ctx.font = "12px system-ui, sans-serif"; ctx.lineWidth = 1;
  const bottom = height - TIMELINE.bottom, step = niceStep(90 * (range[1] - range[0]) / (width - TIMELINE.left - TIMELINE.right));
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), at = (t) => lifeToScreen(range, width, t);
  ctx.strokeStyle = theme.grid; ctx.fillStyle = theme.muted; ctx.textAlign = "center"; ctx.textBaseline = "top";
  ctx.beginPath();
  for (let k = Math.ceil(range[0] / step); k * step <= range[1]; k++) {
    const sx = Math.round(at(k * step)) + 0.5;
    ctx.moveTo(sx, TIMELINE.top); ctx.lineTo(sx, bottom);
    ctx.fillText((k * step).toFixed(digits).replace("-", "−"), sx, bottom + 5);
  }
  ctx.stroke();
  ctx.fillStyle = theme.ink; ctx.fillText("time (s)", (TIMELINE.left + width - TIMELINE.right) / 2, bottom + 19);
}

function lifeToScreen(range, width, t) { return TIMELINE.left + (t - range[0]) / (range[1] - range[0]) * (width - TIMELINE.left - TIMELINE.right); }

function screenToLife(range, width, sx) { return range[0] + (sx - TIMELINE.left) / (width - TIMELINE.left - TIMELINE.right) * (range[1] - range[0]); }

// scene: {people, rows, events, range, theme, tall, unsure, strong}. `rows` and `strong` hold indices of people.
function drawTimeline(ctx, width, height, scene) {
  const { people, rows, events, range, theme, tall, strong } = scene, at = (t) => lifeToScreen(range, width, t);
  ctx.clearRect(0, 0, width, height);
  rows.forEach((i, row) => {
    if (!strong.includes(i)) return;
    ctx.fillStyle = theme.grid; ctx.fillRect(0, TIMELINE.top + row * tall, width, tall);
  });
  drawTimeAxis(ctx, width, height, range, theme);
  ctx.font = NAME_FONT; ctx.fillStyle = theme.ink; ctx.textAlign = "right"; ctx.textBaseline = "middle";
  rows.forEach((i, row) => ctx.fillText(cutToWidth(ctx, people[i].id, TIMELINE.left - 14), TIMELINE.left - 10, TIMELINE.top + (row + 0.5) * tall));
  ctx.save();
  // Births and switches at the edge are marks that stand out of it.
  ctx.beginPath(); ctx.rect(TIMELINE.left - 6, 0, width - TIMELINE.left - TIMELINE.right + 12, height); ctx.clip();
  rows.forEach((i, row) => drawLife(ctx, people[i], TIMELINE.top + (row + 0.5) * tall, tall, at, scene));
  const places = new Map(rows.map((i, row) => [i, row]));
  events.forEach((event) => drawEvent(ctx, event, (i) => places.get(i), at, height, scene));
  ctx.restore();
  ctx.textAlign = "left"; ctx.textBaseline = "alphabetic";
}
