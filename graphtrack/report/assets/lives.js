// Births, deaths, gaps and joins of people, and where identities went wrong. Nothing here touches the page.

function decodeEvents(coded, people) {
  const places = new Map(people.map((person, i) => [person.id, i]));
  const place = (id) => (places.has(id) ? places.get(id) : -1);
  return coded.map(([t, who, before, after, isSwitch, again]) => ({ t, who, before, after, isSwitch: isSwitch === 1, again: again === 1, from: place(before), to: place(after) }));
}

function birthOf(person) { return person.t[0]; }

function deathOf(person) { return person.t[person.t.length - 1]; }

function gapAt(person, t) { return person.gaps.find((gap) => t > gap.from + 1e-6 && t < gap.to - 1e-6) || null; }

// [from, to] of the times between gaps.
function seenParts(person) {
  const parts = [];
  let since = birthOf(person);
  person.gaps.forEach((gap) => {
    // Before a gap that the track begins with there is nothing.
    if (gap.joined || gap.from > birthOf(person) + 1e-3) parts.push([since, gap.from]);
    since = gap.to;
  });
  const last = person.gaps[person.gaps.length - 1];
  if (!last || last.joined || last.to < deathOf(person) - 1e-3) parts.push([since, deathOf(person)]);
  return parts;
}

// {from, to, p} of links from one sample to the next that are not across a gap and less sure than `least`.
function unsureLinks(person, least) {
  const links = [];
  for (let i = 1; i < person.sure.length; i++) {
    const from = person.t[i - 1], to = person.t[i];
    if (!(person.sure[i] < least) || gapAt(person, (from + to) / 2)) continue;
    links.push({ from, to, p: person.sure[i] });
  }
  return links;
}

function leastSure(person) {
  let least = 1;
  for (let i = 1; i < person.sure.length; i++) if (person.sure[i] < least) least = person.sure[i];
  return person.gaps.reduce((low, gap) => (gap.p < low ? gap.p : low), least);
}

function longestGap(person) { return person.gaps.reduce((most, gap) => Math.max(most, gap.to - gap.from), 0); }

// Switches that each of the people had a part in.
function switchCounts(people, events) {
  const counts = people.map(() => 0);
  events.filter((event) => event.isSwitch).forEach((event) => {
    new Set([event.from, event.to]).forEach((i) => { if (i >= 0) counts[i] += 1; });
  });
  return counts;
}

// Indices of the shown people, in the selected order; ties in order of first appearance.
function orderedLives(people, events, order) {
  const counts = switchCounts(people, events);
  const keys = { birth: () => 0, unsure: (i) => leastSure(people[i]), gap: (i) => -longestGap(people[i]), switches: (i) => -counts[i] };
  const rows = people.map((person, i) => ({ i, key: keys[order](i), birth: birthOf(person) })).filter(({ i }) => people[i].shown);
  return rows.sort((a, b) => a.key - b.key || a.birth - b.birth || a.i - b.i).map((row) => row.i);
}

function percent(p) { return (p < 1 && p > 0.995 ? ">99" : p > 0 && p < 0.005 ? "<1" : Math.round(100 * p)) + "\u202f%"; }

function joinInWords(gap) {
  if (!gap.joined) return "not seen again";
  return Number.isFinite(gap.p) ? "joined, " + percent(gap.p) + " sure" : "joined";
}

function eventInWords(event) {
  const again = event.again ? ", found again" : "";
  if (event.isSwitch) return "true person " + event.who + ": " + event.before + " → " + event.after + again;
  return "true person " + event.who + " found again by " + event.after;
}

// Timeline text of a person at a time; `near`: tolerance in seconds for selecting an event.
function lifeInWords(people, i, t, events, near) {
  const person = people[i], birth = birthOf(person), death = deathOf(person);
  const words = [person.name + ", " + birth.toFixed(1) + " to " + death.toFixed(1) + " s"];
  const gap = gapAt(person, t), at = indexAt(person.t, t) + 1;
  if (t < birth) words.push("not born");
  else if (t > death) words.push("gone");
  else if (gap) words.push("gap of " + (gap.to - gap.from).toFixed(1) + " s" + (gap.filled ? ", filled in" : "") + ", " + joinInWords(gap));
  else {
    // Somebody is seen at samples; between two the link from one to the other counts.
    const sure = person.sure[Math.min(at, person.sure.length - 1)];
    words.push("seen" + (at > 0 && at < person.t.length && Number.isFinite(sure) ? ", link " + percent(sure) + " sure" : ""));
    person.gaps.filter((one) => Math.abs(one.to - t) < near && one.joined).forEach((one) => words.push("gap of " + (one.to - one.from).toFixed(1) + " s, " + joinInWords(one)));
  }
  events.filter((event) => (event.from === i || event.to === i) && Math.abs(event.t - t) <= near).forEach((event) => words.push(eventInWords(event)));
  return t.toFixed(1) + " s · " + words.join(" · ");
}

// What the replay marks of a person for a moment: {t, kind, p, index of the sample there}.
function marksOf(person) {
  const marks = [{ t: birthOf(person), kind: "birth" }, { t: deathOf(person), kind: "death" }];
  person.gaps.filter((gap) => gap.joined).forEach((gap) => marks.push({ t: gap.to, kind: "join", p: gap.p }));
  return marks.map((mark) => ({ ...mark, at: Math.max(indexAt(person.t, mark.t), 0) }));
}
