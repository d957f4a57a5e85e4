// Groups, looks and forecasts: decoding, and asking what is at a time. Nothing here touches the page.

const LOOKS = 2, MEMBER_ROOM = 0.4, SHOULDER = 0.25;  // looks of a person at a time; metres about a member; half a person's width

function decodeBehaviour(data, people) {
  const coded = data.behaviour || { groups: [], places: [], has: {} }, { steps } = data;
  data.people.forEach((from, i) => {
    const person = people[i];
    person.group = undelta(from.group, 1); person.groupP = undelta(from.group_p, steps.sure);
    person.looks = Array.from({ length: LOOKS }, (_, k) => ({ target: undelta(from["look_" + k], 1), p: undelta(from["look_p_" + k], steps.sure) }));
    person.fan = { t: undelta(from.fan_t, steps.time) };
    ["x", "y", "50", "90"].forEach((name) => { person.fan[name] = undelta(from["fan_" + name], steps.coarse); });
  });
  const groups = coded.groups.map((from) => ({
    number: from.number, colour: from.colour, hole: from.hole, t: undelta(from.t, steps.time), kind: undelta(from.kind, 1),
    x: undelta(from.x, steps.coarse), y: undelta(from.y, steps.coarse),
  }));
  return { has: coded.has, groups: new Map(groups.map((group) => [group.number, group])), places: coded.places.map(decodePlace), fans: coded.fans || { ahead: [], hold: 0 } };
}

// A place with its middle: of a polygon the mean of its corners.
function decodePlace(coded) {
  const middle = (k) => coded.outline.reduce((sum, corner) => sum + corner[k], 0) / coded.outline.length;
  return { name: coded.name, radius: coded.radius, outline: coded.outline, x: middle(0), y: middle(1) };
}

// The groups of a moment, of people who are there and shown: {group, kind, p, members, centre, radius}. The o-space reaches
// as far as the member who stands nearest to its centre; where the centre is not known, there is none.
function groupsAt(behaviour, present, t) {
  const found = new Map();
  present.forEach(({ person, state, index }) => {
    const group = behaviour.groups.get(person.group[state.nearest]);
    if (!group) return;
    if (!found.has(group)) found.set(group, []);
    found.get(group).push({ person, state, index, p: person.groupP[state.nearest] });
  });
  return [...found].map(([group, members]) => {
    const i = Math.max(indexAt(group.t, t), 0), j = Math.min(i + 1, group.t.length - 1), step = group.t[j] - group.t[i];
    const f = step > 0 && step <= group.hole ? Math.min(Math.max((t - group.t[i]) / step, 0), 1) : 0;
    const centre = [mix(group.x[i], group.x[j], f), mix(group.y[i], group.y[j], f)];
    const near = Math.min(...members.map(({ state }) => Math.hypot(state.x - centre[0], state.y - centre[1])));
    const p = members.reduce((sum, member) => sum + member.p, 0) / members.length;
    return { group, members, p, kind: group.kind[f < 0.5 ? i : j], centre, radius: Math.max(near - SHOULDER, 0.15) };
  });
}

// The convex hull of points, counter-clockwise (Andrew's monotone chain).
function convexHull(points) {
  const sorted = points.slice().sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (ordered) => {
    const chain = [];
    ordered.forEach((point) => {
      const turnsRight = () => {
        const [a, b] = chain.slice(-2);
        return (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]) <= 0;
      };
      while (chain.length > 1 && turnsRight()) chain.pop();
      chain.push(point);
    });
    return chain.slice(0, -1);
  };
  return sorted.length < 3 ? sorted : half(sorted).concat(half(sorted.slice().reverse()));
}

// The hull of circles about the members, metres.
function hullOf(members) {
  const around = [...Array(16)].map((_, k) => [MEMBER_ROOM * Math.cos(k * TURN / 16), MEMBER_ROOM * Math.sin(k * TURN / 16)]);
  return convexHull(members.flatMap(({ state }) => around.map(([dx, dy]) => [state.x + dx, state.y + dy])));
}

function isInside(polygon, x, y) {
  return polygon.reduce((inside, [ax, ay], i) => {
    const [bx, by] = polygon[(i + 1) % polygon.length];
    return ay > y !== by > y && x < ax + (y - ay) * (bx - ax) / (by - ay) ? !inside : inside;
  }, false);
}

// Gaze targets of a person at a sample: {x, y, p, name}, most probable first; absent people are omitted.
function looksOf(behaviour, people, person, state, t) {
  const found = [];
  person.looks.forEach(({ target, p }) => {
    const at = target[state.nearest];
    if (!Number.isFinite(at)) return;
    const other = at < people.length ? stateAt(people[at], t) : behaviour.places[at - people.length];
    if (other) found.push({ x: other.x, y: other.y, p: p[state.nearest], name: at < people.length ? people[at].name : other.name });
  });
  return found;
}

// The forecast that holds at a time: where the person was forecast to be at the times still ahead, with both radii; or null.
function fanAt(behaviour, person, t) {
  const { ahead, hold } = behaviour.fans, { fan } = person, i = indexAt(fan.t, t);
  if (i < 0 || t - fan.t[i] > hold) return null;
  const steps = ahead.map((seconds, k) => ({ at: fan.t[i] + seconds, x: fan.x[i * ahead.length + k], y: fan.y[i * ahead.length + k], half: fan["50"][i * ahead.length + k], most: fan["90"][i * ahead.length + k] }));
  const left = steps.filter((step) => step.at > t + 1e-6 && Number.isFinite(step.x));
  return left.length ? { made: fan.t[i], steps: left } : null;
}

function groupInWords({ group, kind, p }) {
  return (kind === 2 ? "walking together" : "conversing") + " (group " + group.number + (Number.isFinite(p) ? ", " + percent(p) : "") + ")";
}

// What a person does at a time, in words; nothing where nothing is known.
function doingInWords(behaviour, people, i, t) {
  const person = people[i], state = stateAt(person, t);
  if (!state) return "";
  const words = [], group = behaviour.groups.get(person.group[state.nearest]);
  if (group) {
    const [found] = groupsAt(behaviour, [{ person, state, index: i }], t);
    words.push(groupInWords(found));
  } else if (behaviour.has.groups) words.push("alone" + (Number.isFinite(person.groupP[state.nearest]) ? " (" + percent(person.groupP[state.nearest]) + ")" : ""));
  const looks = looksOf(behaviour, people, person, state, t).map((look) => look.name + " (" + percent(look.p) + ")");
  if (looks.length) words.push("looks at " + looks.join(", "));
  const fan = fanAt(behaviour, person, t), last = fan && fan.steps[fan.steps.length - 1];
  if (last) words.push("in " + (last.at - t).toFixed(1) + " s within " + last.most.toFixed(1) + " m of (" + metres(last.x, 1) + ", " + metres(last.y, 1) + ") with 90\u202f%");
  return words.join(" · ");
}

// The group whose hull lies under a point on the ground, in words with its members; the smallest, where hulls overlap.
function groupUnder(behaviour, people, x, y, t) {
  const present = people.map((person, index) => ({ person, index, state: person.shown ? stateAt(person, t) : null })).filter(({ state }) => state);
  const under = groupsAt(behaviour, present, t).filter(({ members }) => isInside(hullOf(members), x, y));
  if (!under.length) return "";
  const found = under.reduce((a, b) => (b.members.length < a.members.length ? b : a));
  return groupInWords(found) + ": " + found.members.map(({ person }) => person.name).join(", ");
}
