// Decoding the replay's data and asking where a person is at a time. Nothing here touches the page.

const LENGTHS = ["x", "y", "vx", "vy", "major", "minor", "seen_x", "seen_y", "true_x", "true_y"];
const ANGLES = ["tilt", "body", "head", "true_body", "true_head"];
const TURN = 2 * Math.PI;

function undelta(codes, step, n) {
  const values = new Float64Array(n).fill(NaN);
  let last = 0;
  if (codes) codes.forEach((code, i) => { if (code !== null) { last += code; values[i] = last * step; } });
  return values;
}

function decodePerson(coded, steps) {
  const n = coded.t.length;
  const person = { id: coded.id, label: coded.label, colour: coded.colour, hole: coded.hole, seen: coded.seen, shown: true };
  person.t = undelta(coded.t, steps.time, n);
  LENGTHS.forEach((name) => { person[name] = undelta(coded[name], steps.length, n); });
  ANGLES.forEach((name) => { person[name] = undelta(coded[name], steps.angle, n); });
  return person;
}

// Index of the last sample at or before t; -1 before the first.
function indexAt(times, t) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t + 1e-9) low = middle + 1; else high = middle;
  }
  return low - 1;
}

function mix(a, b, f) { return f === 0 ? a : f === 1 ? b : a + f * (b - a); }

// Along the shorter arc: from 170° to -170° goes through 180°.
function mixAngle(a, b, f) {
  const step = (((b - a) % TURN) + 1.5 * TURN) % TURN - TURN / 2;
  return f === 0 ? a : f === 1 ? b : a + f * step;
}

// What is known of a person at time t, or null where the track has not begun, has ended or has a hole.
function stateAt(person, t) {
  const last = person.t.length - 1;
  if (t < person.t[0] - 0.02 || t > person.t[last] + 0.02) return null;
  const i = Math.max(indexAt(person.t, t), 0), j = Math.min(i + 1, last);
  const step = person.t[j] - person.t[i];
  if (step > person.hole && t > person.t[i] + 0.02) return null;
  const f = step > 0 && step <= person.hole ? Math.min(Math.max((t - person.t[i]) / step, 0), 1) : 0;
  const nearest = f < 0.5 ? i : j;
  const state = { index: i, nearest, seen: person.seen === null || person.seen[nearest] === "1" };
  ["x", "y", "vx", "vy", "true_x", "true_y"].forEach((name) => { state[name] = mix(person[name][i], person[name][j], f); });
  ["body", "head", "true_body", "true_head"].forEach((name) => { state[name] = mixAngle(person[name][i], person[name][j], f); });
  ["major", "minor", "tilt", "seen_x", "seen_y"].forEach((name) => { state[name] = person[name][nearest]; });
  return Number.isFinite(state.x) && Number.isFinite(state.y) ? state : null;
}

// [left, bottom, right, top] in metres of all paths, with room for the arrows.
function sceneBounds(people) {
  let left = Infinity, bottom = Infinity, right = -Infinity, top = -Infinity;
  const widen = (xs, ys) => xs.forEach((x, i) => {
    if (!Number.isFinite(x) || !Number.isFinite(ys[i])) return;
    left = Math.min(left, x); right = Math.max(right, x);
    bottom = Math.min(bottom, ys[i]); top = Math.max(top, ys[i]);
  });
  people.forEach((p) => { widen(p.x, p.y); widen(p.true_x, p.true_y); });
  if (left > right) return [-1, -1, 1, 1];
  const margin = Math.max(0.5, 0.05 * Math.max(right - left, top - bottom));
  return [left - margin, bottom - margin, right + margin, top + margin];
}
