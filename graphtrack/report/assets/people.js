// Visibility and selection of people: one state for the replay, the list, the charts and the tables, without page access.

function createCrowd(people) {
  const listeners = [];
  const tell = () => listeners.forEach((listener) => listener());
  const crowd = {
    people,
    chosen: -1,
    hovered: -1,
    onChange(listener) { listeners.push(listener); },
    show(indices, on) { indices.forEach((i) => { people[i].shown = on; }); tell(); },
    showOnly(indices) {
      const kept = new Set(indices);
      people.forEach((p, i) => { p.shown = kept.has(i); });
      tell();
    },
    // Who is chosen is shown, else nothing could be seen of them; -1 is nobody.
    choose(i) {
      crowd.chosen = i;
      if (i >= 0) people[i].shown = true;
      tell();
    },
    // By name, or by the number that a name stands for.
    indexOf(id) {
      const at = people.findIndex((p) => p.id === id);
      return at < 0 ? people.findIndex((p) => p.number === id) : at;
    },
  };
  return crowd;
}

// Indices of those whose name or number is, or whose label has, what was typed; several with commas. Nothing typed: everybody.
function findPeople(people, words) {
  const terms = words.toLowerCase().split(",").map((term) => term.trim()).filter(Boolean);
  const all = people.map((_, i) => i);
  if (!terms.length) return all;
  const found = new Set();
  terms.forEach((term) => {
    const exact = all.filter((i) => [people[i].id, people[i].name, people[i].number].some((name) => name.toLowerCase() === term));
    const near = () => all.filter((i) => people[i].number.startsWith(term) || people[i].name.toLowerCase().includes(term));
    (exact.length ? exact : near()).forEach((i) => found.add(i));
  });
  return all.filter((i) => found.has(i));
}

// The page nearest to the wanted one, of things of which `size` stand on each: from and to as in slice.
// A few more stand on the last page: nobody turns a page for them.
function pageOf(count, size, wanted) {
  const few = Math.ceil(size / 5), pages = Math.max(Math.ceil((count - few) / size), 1);
  const page = Math.min(Math.max(wanted, 0), pages - 1);
  return { page, pages, from: page * size, to: page === pages - 1 ? count : (page + 1) * size };
}

function countOf(n, word, words) { return n + " " + (n === 1 ? word : words); }
