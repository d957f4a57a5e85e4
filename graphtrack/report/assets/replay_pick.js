// Who is under the pointer: a person of this moment first, then the nearest path. Nothing here touches the page.

const NEAR_PERSON = 14, NEAR_PATH = 7;  // CSS pixels; a finger gets twice that

function distanceToSegment(px, py, ax, ay, bx, by) {
  const dx = bx - ax, dy = by - ay, square = dx * dx + dy * dy;
  const f = square > 0 ? Math.min(Math.max(((px - ax) * dx + (py - ay) * dy) / square, 0), 1) : 0;
  return [Math.hypot(px - ax - f * dx, py - ay - f * dy), f];
}

// Metres from (x, y) to a path between two times, and when the person was there: [Infinity, NaN] where there is no path.
function nearestOnPath(person, x, y, since, until) {
  let best = Infinity, when = NaN;
  const end = indexAt(person.t, until);
  for (let i = Math.max(indexAt(person.t, since), 0); i < end; i++) {
    if (person.t[i + 1] - person.t[i] > person.hole) continue;
    const [distance, f] = distanceToSegment(x, y, person.x[i], person.y[i], person.x[i + 1], person.y[i + 1]);
    if (distance < best) { best = distance; when = mix(person.t[i], person.t[i + 1], f); }
  }
  return [best, when];
}

// {index, time} of the person at the point (x, y) on the ground, or null. `trail`: seconds of it that are drawn; `everything`:
// whether whole paths are; `reach`: how many metres a pixel is, times the size of the pointer.
function pickPerson(people, x, y, now, trail, everything, reach) {
  let best = null, least = NEAR_PERSON * reach;
  people.forEach((person, index) => {
    const state = person.shown ? stateAt(person, now) : null;
    const distance = state ? Math.hypot(state.x - x, state.y - y) : Infinity;
    if (distance < least) { least = distance; best = { index, time: now }; }
  });
  if (best) return best;
  least = NEAR_PATH * reach;
  people.forEach((person, index) => {
    if (!person.shown) return;
    const here = stateAt(person, now) !== null;
    if (!here && !everything) return;
    const [distance, time] = everything ? nearestOnPath(person, x, y, -Infinity, Infinity) : nearestOnPath(person, x, y, now - trail, now);
    if (distance < least) { least = distance; best = { index, time }; }
  });
  return best;
}
