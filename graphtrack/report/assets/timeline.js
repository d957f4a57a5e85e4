// The timeline of identities: who stands where, over which time, and how it follows the replay.

function startTimeline(root, crowd, replay, unsure, events) {
  const part = (name) => root.querySelector('[data-part="' + name + '"]');
  const canvas = part("bars"), ctx = canvas.getContext("2d"), tip = part("tip"), order = part("order"), people = crowd.people;
  const size = root.clientWidth < 600 ? 25 : 50;
  const still = document.createElement("canvas");
  let theme = readTheme(root), range = [0, 1], width = 0, height = 0, tall = 14, page = 0, found = [], rows = [], last = -1, queued = false, painted = false;

  // The time in which those on this page were there.
  function whole() {
    const there = rows.length ? rows : people.map((_, i) => i);
    const begin = Math.min(...there.map((i) => birthOf(people[i]))), end = Math.max(...there.map((i) => deathOf(people[i])));
    // A moment alone has no extent: show a second around it.
    range = end > begin ? [begin, end] : [begin - 0.5, begin + 0.5];
  }
  function draw() {
    queued = false;
    if (!width) return;
    if (!painted) paint();
    ctx.clearRect(0, 0, width, height);
    ctx.drawImage(still, 0, 0, width, height);
    const sx = lifeToScreen(range, width, replay.now());
    if (sx < TIMELINE.left - 1 || sx > width - TIMELINE.right + 1) return;
    ctx.strokeStyle = theme.accent; ctx.lineWidth = 1;
    ctx.beginPath(); ctx.moveTo(sx, TIMELINE.top); ctx.lineTo(sx, height - TIMELINE.bottom); ctx.stroke();
  }
  function redraw() {
    if (!queued) { queued = true; requestAnimationFrame(draw); }
  }
  function repaint() { painted = false; redraw(); }
  function paint() {
    still.width = canvas.width; still.height = canvas.height;
    const under = still.getContext("2d");
    under.setTransform(ctx.getTransform());
    drawTimeline(under, width, height, { people, rows, events, range, theme, tall, unsure, strong: [crowd.chosen, crowd.hovered] });
    painted = true;
  }
  function resize() {
    const density = window.devicePixelRatio || 1;
    width = canvas.clientWidth; height = canvas.clientHeight;
    canvas.width = Math.round(width * density); canvas.height = Math.round(height * density);
    TIMELINE.left = roomForNames(ctx, people, width);
    ctx.setTransform(density, 0, 0, density, 0, 0);
    painted = false;
    draw();
  }
  // Who stands on this page, and how tall it is.
  function fill() {
    const here = pageOf(found.length, size, page);
    page = here.page;
    const before = rows.join();
    rows = found.slice(here.from, here.to);
    if (rows.join() !== before) whole();
    tall = rowHeightOf(rows.length);
    canvas.style.height = TIMELINE.top + Math.max(rows.length, 1) * tall + TIMELINE.bottom + "px";
    part("turning").hidden = here.pages === 1;
    part("rows").textContent = found.length ? here.from + 1 + "–" + here.to + " of " + found.length : "nobody";
    part("above").disabled = page === 0;
    part("below").disabled = page === here.pages - 1;
    canvas.setAttribute("aria-label", "When " + countOf(rows.length, "person was", "people were") + " there");
    resize();
  }
  function arrange() { found = orderedLives(people, events, order.value); fill(); }
  function zoom(factor, sx) {
    const middle = screenToLife(range, width, sx);
    range = range.map((t) => middle + (t - middle) / factor);
    repaint();
  }
  function zoomAtTime(factor) {
    const now = replay.now(), inside = now >= range[0] && now <= range[1];
    zoom(factor, lifeToScreen(range, width, inside ? now : (range[0] + range[1]) / 2));
  }
  // Who is in the row under the pointer, and when.
  function under(event) {
    const i = rows[Math.floor((event.offsetY - TIMELINE.top) / tall)];
    return i === undefined ? null : { i, t: screenToLife(range, width, event.offsetX) };
  }
  function wordsAt(at) { return at ? lifeInWords(people, at.i, at.t, events, 6 * (range[1] - range[0]) / (width - TIMELINE.left - TIMELINE.right)) : ""; }
  function tell() { part("story").textContent = crowd.chosen < 0 ? "" : lifeInWords(people, crowd.chosen, replay.now(), events, 0.05); }

  // The legend holds what there is.
  const gaps = people.flatMap((person) => person.gaps), joins = gaps.filter((gap) => gap.joined);
  const there = {
    birth: true, death: true, sure: people.some((person) => unsureLinks(person, 0.995).length), filled: gaps.some((gap) => gap.filled), hole: gaps.some((gap) => !gap.filled),
    join: joins.some((gap) => !(gap.p < unsure)), unsure: joins.some((gap) => gap.p < unsure),
    switch: events.some((event) => event.isSwitch), fragmentation: events.some((event) => event.again && !event.isSwitch),
  };
  Object.entries(there).forEach(([key, known]) => { root.querySelector('[data-key="' + key + '"]').hidden = !known; });
  const orders = { unsure: people.some((person) => leastSure(person) < 1), gap: gaps.length, switches: there.switch };
  Object.entries(orders).forEach(([value, known]) => { if (!known) order.querySelector('[value="' + value + '"]').remove(); });

  order.addEventListener("change", () => { page = 0; arrange(); });
  part("above").addEventListener("click", () => { page -= 1; fill(); });
  part("below").addEventListener("click", () => { page += 1; fill(); });
  part("nearer").addEventListener("click", () => zoomAtTime(1.6));
  part("farther").addEventListener("click", () => zoomAtTime(1 / 1.6));
  part("entire").addEventListener("click", () => { whole(); repaint(); });
  dragCanvas(canvas, {
    moved(dx) { const by = dx * (range[1] - range[0]) / (width - TIMELINE.left - TIMELINE.right); range = range.map((t) => t - by); repaint(); },
    zoomed: (factor, sx) => zoom(factor, sx),
    fit() { whole(); repaint(); },
  });
  canvas.addEventListener("pointermove", (event) => {
    if (event.pointerType === "mouse") placeTip(tip, canvas, event.offsetX, event.offsetY, event.buttons ? "" : wordsAt(under(event)));
  });
  canvas.addEventListener("pointerleave", () => { tip.hidden = true; });
  canvas.addEventListener("click", (event) => {
    const at = under(event);
    if (!at) return;
    replay.seek(at.t);
    crowd.choose(at.i);
  });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { theme = readTheme(root); repaint(); });
  function follow() {
    arrange();
    const at = found.indexOf(crowd.chosen);
    // To the page of who was chosen elsewhere.
    if (crowd.chosen !== last && at >= 0 && !rows.includes(crowd.chosen)) { page = Math.floor(at / size); fill(); }
    last = crowd.chosen;
    tell();
  }
  crowd.onChange(follow);
  replay.onTime(() => { redraw(); tell(); });
  follow();
  new ResizeObserver(resize).observe(canvas);
}
