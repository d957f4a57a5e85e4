// Unpacking and decoding the replay's data, and asking where a person is at a time. Nothing here touches the page.

const LENGTHS = ["x", "y", "vx", "vy", "speed_low", "speed_high", "major", "minor", "seen_x", "seen_y", "seen_major", "seen_minor", "true_x", "true_y"];
const ANGLES = ["tilt", "seen_tilt", "heading", "heading_std", "seen_heading", "true_heading", "body", "head", "body_std", "head_std", "seen_body", "seen_head", "true_body", "true_head"];
const TURN = 2 * Math.PI;

// Base64 of zlib of JSON → parsed JSON.
async function unpack(text) {
  const letters = atob(text.trim()), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return JSON.parse(await new Response(plain).text());
}

// A channel that is known nowhere stays empty: what is read from it is undefined, which is not finite either.
function undelta(codes, step) {
  const values = new Float64Array(codes ? codes.length : 0).fill(NaN);
  let last = 0;
  if (codes) codes.forEach((code, i) => { if (code !== null) { last += code; values[i] = last * step; } });
  return values;
}

// Python's tuples, with names. p: how sure it is that who was seen again is the same; NaN where that is not known.
function decodeGaps(coded) {
  return (coded || []).map(([from, to, filled, joined, p]) => ({ from, to, filled: filled === 1, joined: joined === 1, p: p === null ? NaN : p }));
}

function decodePerson(coded, steps) {
  const person = { id: coded.id, number: coded.number, label: coded.label, colour: coded.colour, dash: coded.dash, hole: coded.hole, seen: coded.seen, shown: true };
  person.name = coded.id + (coded.label ? " " + coded.label : "");
  person.t = undelta(coded.t, steps.time);
  LENGTHS.forEach((name) => { person[name] = undelta(coded[name], steps.length); });
  ANGLES.forEach((name) => { person[name] = undelta(coded[name], steps.angle); });
  person.speed = person.vx.map((vx, i) => Math.hypot(vx, person.vy[i]));
  person.sure = undelta(coded.sure, steps.sure);
  person.sensor = undelta(coded.sensor, 1);
  person.gaps = decodeGaps(coded.gaps);
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

// All times at which anybody has a sample, ascending, each once.
function sampleTimes(people) {
  const all = new Float64Array(people.reduce((n, p) => n + p.t.length, 0));
  let end = 0;
  people.forEach((p) => { all.set(p.t, end); end += p.t.length; });
  all.sort();
  return all.filter((t, i) => i === 0 || t > all[i - 1]);
}

// The time one frame on (direction 1) or back (-1): that of the next sample of anybody. From a sample, what lies within
// half a frame of it is passed over: cameras that are a few milliseconds apart take one frame at the same time.
function stepTime(times, frame, now, direction) {
  const last = times.length - 1, at = indexAt(times, now + 5e-4);
  const guard = at >= 0 && Math.abs(times[at] - now) < 1e-3 ? frame / 2 : 1e-3;
  if (direction > 0) return times[Math.min(indexAt(times, now + guard) + 1, last)];
  const before = indexAt(times, now - guard);
  return times[Math.max(before, 0)];
}

function mix(a, b, f) { return f === 0 ? a : f === 1 ? b : a + f * (b - a); }

// The shorter way from one angle to another: from 170° to -170° it is 20°.
function arc(a, b) { return (((b - a) % TURN) + 1.5 * TURN) % TURN - TURN / 2; }

function mixAngle(a, b, f) { return f === 0 ? a : f === 1 ? b : a + f * arc(a, b); }

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
  ["x", "y", "vx", "vy", "speed", "speed_low", "speed_high", "true_x", "true_y"].forEach((name) => { state[name] = mix(person[name][i], person[name][j], f); });
  ["heading", "body", "head", "true_body", "true_head"].forEach((name) => { state[name] = mixAngle(person[name][i], person[name][j], f); });
  ["major", "minor", "tilt", "seen_x", "seen_y", "heading_std", "body_std", "head_std", "seen_body", "seen_head"].forEach((name) => { state[name] = person[name][nearest]; });
  return Number.isFinite(state.x) && Number.isFinite(state.y) ? state : null;
}

// Indices of the samples at the time of one: those of several sensors.
function samplesTogether(person, at) {
  let first = at, last = at;
  while (first > 0 && person.t[at] - person.t[first - 1] < 5e-4) first--;
  while (last + 1 < person.t.length && person.t[last + 1] - person.t[at] < 5e-4) last++;
  return Array.from({ length: last - first + 1 }, (_, k) => first + k);
}

// [left, bottom, right, top] in metres of all paths and places, with room for the arrows.
function sceneBounds(people, places) {
  let left = Infinity, bottom = Infinity, right = -Infinity, top = -Infinity;
  const widen = (xs, ys) => xs.forEach((x, i) => {
    if (!Number.isFinite(x) || !Number.isFinite(ys[i])) return;
    left = Math.min(left, x); right = Math.max(right, x);
    bottom = Math.min(bottom, ys[i]); top = Math.max(top, ys[i]);
  });
  people.forEach((p) => { widen(p.x, p.y); widen(p.true_x, p.true_y); });
  places.forEach((place) => place.outline.forEach(([x, y]) => widen([x - place.radius, x + place.radius], [y - place.radius, y + place.radius])));
  if (left > right) return [-1, -1, 1, 1];
  const margin = Math.max(0.5, 0.05 * Math.max(right - left, top - bottom));
  return [left - margin, bottom - margin, right + margin, top + margin];
}
