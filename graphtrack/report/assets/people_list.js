// The list of people: a box to show each, a button to choose them, a search field and pages, so that hundreds fit.

const SVG = "http://www.w3.org/2000/svg";

// A piece of the person's path and the dot at its end.
function personKey(person) {
  const svg = document.createElementNS(SVG, "svg");
  const parts = [
    ["line", { x1: 0, y1: 8, x2: 24, y2: 8, stroke: person.colour, "stroke-width": 2.4, "stroke-dasharray": person.dash.map((d) => 2.4 * d).join(" ") || "none" }],
    ["circle", { cx: 19, cy: 8, r: 5, fill: person.colour }],
  ];
  svg.setAttribute("class", "key"); svg.setAttribute("viewBox", "0 0 24 16"); svg.setAttribute("aria-hidden", "true");
  parts.forEach(([name, attributes]) => {
    const child = document.createElementNS(SVG, name);
    Object.entries(attributes).forEach(([key, value]) => child.setAttribute(key, value));
    svg.append(child);
  });
  return svg;
}

function personItem(crowd, i, visit) {
  const person = crowd.people[i], item = document.createElement("li"), box = document.createElement("input"), name = document.createElement("button");
  box.type = "checkbox"; box.checked = person.shown; box.setAttribute("aria-label", "Show person " + person.name);
  box.addEventListener("change", () => crowd.show([i], box.checked));
  name.type = "button"; name.title = person.name; name.setAttribute("aria-pressed", String(crowd.chosen === i));
  const words = document.createElement("span");
  words.textContent = person.name;
  name.append(personKey(person), words);
  name.addEventListener("click", () => { if (crowd.chosen === i) crowd.choose(-1); else visit(i); });
  item.append(box, name);
  return item;
}

function startPeople(root, crowd, replay) {
  const part = (name) => root.querySelector('[data-part="' + name + '"]');
  const list = part("list"), find = part("find"), people = crowd.people;
  const size = root.clientWidth < 600 ? 12 : 24;
  // As wide as the longest name asks for, within reason.
  const letters = Math.max(...people.map((p) => p.name.length));
  list.style.setProperty("--name", Math.min(Math.max(5 + 0.55 * letters, 7), 18) + "rem");
  let page = 0, found = findPeople(people, "");

  function fill() {
    const here = pageOf(found.length, size, page), kept = focused();
    page = here.page;
    list.replaceChildren(...found.slice(here.from, here.to).map((i) => personItem(crowd, i, replay.visit)));
    if (kept) kept();
    part("pager").hidden = here.pages === 1;
    part("page").textContent = found.length ? here.from + 1 + "–" + here.to + " of " + found.length : "nobody";
    part("earlier").disabled = page === 0;
    part("later").disabled = page === here.pages - 1;
    const shown = people.filter((p) => p.shown).length;
    part("tally").textContent = (find.value.trim() ? found.length + " found, " : "") + shown + " of " + people.length + " shown";
    part("only").disabled = !found.length;
    // All controls of one selected person.
    const chosen = people[crowd.chosen];
    part("chosen").hidden = !chosen;
    if (!chosen) return;
    part("name").textContent = "Person " + chosen.name;
    part("extent").textContent = chosen.t[0].toFixed(1) + " to " + chosen.t[chosen.t.length - 1].toFixed(1) + " s";
  }
  // Rebuilt elements would lose the keyboard focus: store it, and restore it afterwards.
  function focused() {
    const at = [...list.querySelectorAll("input, button")].indexOf(document.activeElement);
    return at < 0 ? null : () => { const now = list.querySelectorAll("input, button")[at]; if (now) now.focus(); };
  }

  find.addEventListener("input", () => { found = findPeople(people, find.value); page = 0; fill(); });
  part("everybody").addEventListener("click", () => crowd.show(people.map((_, i) => i), true));
  part("nobody").addEventListener("click", () => crowd.showOnly([]));
  part("only").addEventListener("click", () => crowd.showOnly(found));
  part("earlier").addEventListener("click", () => { page -= 1; fill(); });
  part("later").addEventListener("click", () => { page += 1; fill(); });
  part("start").addEventListener("click", () => replay.seek(people[crowd.chosen].t[0]));
  part("alone").addEventListener("click", () => crowd.showOnly([crowd.chosen]));
  part("clear").addEventListener("click", () => crowd.choose(-1));
  // Few people need no search.
  part("search").hidden = part("only").hidden = people.length <= 12;
  crowd.onChange(fill);
  fill();
}

// What the chosen person does at the replay's time, for those who have no pointer to hover with.
function tellDoing(output, crowd, replay, behaviour) {
  const tell = () => { output.textContent = crowd.chosen < 0 ? "" : doingInWords(behaviour, crowd.people, crowd.chosen, replay.now()); };
  crowd.onChange(tell);
  replay.onTime(tell);
}
