// What a reader does with the report of many people, and what is to be seen then. Runs in the page, see test_browser.py.

const click = async (name) => { part(name).click(); await next(); };
const type = async (field, words, kind) => {
  field.value = words;
  field.dispatchEvent(new Event(kind || "input", { bubbles: true }));
  await next();
};
const key = async (which, more) => {
  document.body.dispatchEvent(new KeyboardEvent("keydown", { key: which, bubbles: true, ...more }));
  await next();
};
const names = () => [...document.querySelectorAll(".names li")].map((item) => item.textContent);
const clock = () => parseFloat(part("clock").textContent);
const painted = (canvas) => {
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return data.filter((value, i) => i % 4 === 3 && value > 0).length;
};
const table = [...document.querySelectorAll(".panel table")].find((one) => one.caption.textContent.startsWith("Results"));
const tools = table.closest(".panel").querySelector(".tools input");
const heading = () => table.tHead.rows[0].cells[0];
const rows = () => [...table.tBodies[0].rows].filter((row) => !row.hidden).map((row) => row.cells[0].textContent);

const seen = { names: names(), page: part("page").textContent, tally: part("tally").textContent };
const drawn = () => ["canvas", "chart", "bars"].map((name) => painted(part(name)) > 1000);
for (let tries = 0; tries < 100 && !drawn().every(Boolean); tries += 1) await next();
seen.drawn = drawn();

await click("later"); seen.second = names();
await type(part("find"), "7, 31"); seen.found = names(); seen.foundTally = part("tally").textContent;
await click("only"); seen.only = part("tally").textContent;
await click("nobody"); seen.none = part("tally").textContent; seen.empty = part("clock").textContent;
await click("everybody"); seen.all = part("tally").textContent;

await key("ArrowRight"); seen.on = clock();
await key("ArrowRight", { shiftKey: true }); seen.ten = clock();
await key("ArrowLeft"); seen.back = clock();
await click("onward"); seen.button = clock();

seen.rows = rows();
await type(tools, "walker 5"); seen.rowsFound = rows();
await type(tools, "");
heading().querySelector("button").click();
heading().querySelector("button").click();
await next();
seen.sorted = rows(); seen.aria = heading().getAttribute("aria-sort");

table.tBodies[0].rows[0].querySelector("button.link").click();
await next();
seen.visited = {
  name: part("name").textContent, chart: part("who").value, label: part("chart").getAttribute("aria-label"),
  row: table.querySelector("tr.chosen").cells[0].textContent, hash: location.hash, reading: part("reading").textContent,
};
await type(part("who"), "walker 33", "change"); seen.typed = part("name").textContent;
await click("after"); seen.after = part("who").value;
await key("Escape"); seen.escaped = part("chosen").hidden;

const place = part("canvas").getBoundingClientRect();
const middle = { clientX: place.left + place.width / 2, clientY: place.top + place.height / 2, bubbles: true, pointerType: "mouse" };
part("canvas").dispatchEvent(new PointerEvent("pointermove", middle));
await next();
seen.tip = part("tip").hidden ? null : part("tip").textContent;
part("canvas").dispatchEvent(new PointerEvent("click", middle));
await next();
seen.clicked = part("name").textContent;

seen.lives = part("rows").textContent;
const bars = part("bars").getBoundingClientRect();
// Names stand at the left, a seventh of the width or so.
const row = { clientX: bars.left + 0.56 * bars.width, clientY: bars.top + 10 + 3.5 * 14, bubbles: true };
part("bars").dispatchEvent(new PointerEvent("click", row));
await next();
seen.life = part("name").textContent; seen.lifeClock = clock(); seen.story = part("story").textContent;

const named = (control) => control.textContent.trim() || control.getAttribute("aria-label") || (control.labels && control.labels.length);
seen.unnamed = [...document.querySelectorAll("button, input, select, canvas")].filter((control) => !named(control)).map((control) => control.outerHTML);
return seen;
