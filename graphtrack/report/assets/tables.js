// Tables: a click on a heading sorts, long ones have a search field and pages, ids of people take the replay to them.

const TABLE_ROWS = 20;

// Sort key of a cell: a number if it is one, else text; a dash sorts last in both directions.
function sortKey(text) {
  const words = text.trim();
  if (words === "–" || words === "") return null;
  const number = Number(words);
  return Number.isNaN(number) ? words.toLowerCase() : number;
}

function compareKeys(a, b, direction) {
  if (a === null || b === null) return (a === null) - (b === null);
  if (typeof a === typeof b) return direction * (typeof a === "number" ? a - b : a.localeCompare(b, undefined, { numeric: true }));
  return typeof a === "number" ? -1 : 1;
}

// The order of rows (lists of cells) by a column; rows that are alike keep their order.
function sortedRows(rows, column, direction) {
  const keyed = rows.map((cells, i) => ({ i, key: sortKey(cells[column]) }));
  return keyed.sort((a, b) => compareKeys(a.key, b.key, direction) || a.i - b.i).map((row) => row.i);
}

// Rows with a number that is, or words that have, what was typed; several with commas. Nothing typed: all.
function filteredRows(rows, words) {
  const terms = words.toLowerCase().split(",").map((term) => term.trim()).filter(Boolean);
  const fits = (cell, term) => (Number.isNaN(Number(cell)) ? cell.toLowerCase().includes(term) : cell.trim() === term);
  return rows.map((_, i) => i).filter((i) => !terms.length || terms.some((term) => rows[i].some((cell) => fits(cell, term))));
}

function makeElement(tag, attributes, ...children) {
  const made = document.createElement(tag);
  Object.entries(attributes).forEach(([name, value]) => made.setAttribute(name, value));
  made.append(...children);
  return made;
}

function startTable(table) {
  const body = table.tBodies[0], lines = [...body.rows], rows = lines.map((line) => [...line.cells].map((cell) => cell.textContent));
  const heads = [...table.tHead.rows[0].cells], words = heads.map((head) => head.textContent);
  // On narrow screens each cell shows its heading.
  lines.forEach((line) => [...line.cells].forEach((cell, i) => { cell.dataset.heading = words[i]; }));
  table.classList.add("told");
  if (lines.length < 2) return null;
  const panel = table.closest(".panel"), scroll = table.closest(".scroll");
  const find = makeElement("input", { type: "search", autocomplete: "off" }), count = makeElement("output", {});
  const earlier = makeElement("button", { type: "button", "aria-label": "Earlier rows" }, "‹");
  const later = makeElement("button", { type: "button", "aria-label": "Later rows" }, "›");
  const tools = makeElement("div", { class: "controls tools" }, makeElement("label", {}, "Find ", find), earlier, count, later);
  let order = rows.map((_, i) => i), sorted = -1, direction = 1, page = 0;

  function visible() {
    const kept = new Set(filteredRows(rows, find.value));
    return order.filter((i) => kept.has(i));
  }
  function fill() {
    const found = visible(), here = pageOf(found.length, TABLE_ROWS, page), shown = new Set(found.slice(here.from, here.to));
    page = here.page;
    lines.forEach((line, i) => { line.hidden = !shown.has(i); });
    // All rows stay in the page, in order: they are printed.
    body.append(...order.map((i) => lines[i]));
    count.textContent = found.length ? here.from + 1 + "–" + here.to + " of " + found.length : "no such row";
    earlier.disabled = page === 0;
    later.disabled = page === here.pages - 1;
    scroll.scrollTop = 0;
  }
  heads.forEach((head, column) => {
    const button = makeElement("button", { type: "button", class: "sort" }, ...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      direction = sorted === column ? -direction : 1;
      sorted = column;
      order = sortedRows(rows, column, direction);
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", direction > 0 ? "ascending" : "descending");
      page = 0;
      fill();
    });
  });
  find.addEventListener("input", () => { page = 0; fill(); });
  earlier.addEventListener("click", () => { page -= 1; fill(); });
  later.addEventListener("click", () => { page += 1; fill(); });
  const paged = pageOf(lines.length, TABLE_ROWS, 0).pages > 1;
  if (paged) { panel.prepend(tools); fill(); }
  return {
    // Turn to the page that the row is on, if the search leaves it.
    turnTo(i) {
      const at = visible().indexOf(i);
      if (at >= 0 && paged) { page = Math.floor(at / TABLE_ROWS); fill(); }
    },
  };
}

// In a table of people: the selected person is highlighted, and each id is a button that selects the person in the replay.
function linkTable(table, turning, crowd, replay) {
  const cells = [...table.tBodies[0].querySelectorAll("td[data-person]")];
  const places = new Map(crowd.people.map((person, i) => [person.id, i]));
  const linked = cells.map((cell) => ({ line: cell.parentElement, index: places.get(cell.textContent), cell }));
  const order = [...table.tBodies[0].rows];
  linked.forEach(({ cell, index }) => {
    if (index === undefined) return;
    const button = makeElement("button", { type: "button", class: "link", title: "Show in the replay" }, cell.textContent);
    button.addEventListener("click", () => replay.visit(index));
    cell.replaceChildren(button);
  });
  let last = -1;
  crowd.onChange(() => {
    linked.forEach(({ line, index }) => line.classList.toggle("chosen", index !== undefined && index === crowd.chosen));
    const mine = linked.find(({ index }) => index !== undefined && index === crowd.chosen);
    if (mine && crowd.chosen !== last && turning) turning.turnTo(order.indexOf(mine.line));
    last = crowd.chosen;
  });
}
