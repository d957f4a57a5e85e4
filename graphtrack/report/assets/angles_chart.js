// Chart of speed, heading, body and head: selected person, time range, and synchronisation with the replay.

function startAngles(root, crowd, replay) {
  const part = (name) => root.querySelector('[data-part="' + name + '"]');
  const canvas = part("chart"), ctx = canvas.getContext("2d"), who = part("who"), people = crowd.people;
  const charted = people.map((_, i) => i).filter((i) => chartNames(people[i]).length);
  let theme = readTheme(root), index = -1, range = [0, 1], width = 0, height = 0, pointed = NaN, queued = false, painted = false;
  // What changes neither with time nor with the pointer is drawn once.
  const still = document.createElement("canvas");

  if (!charted.length) { root.hidden = true; return; }

  function whole() {
    const t = people[index].t, span = t[t.length - 1] - t[0];
    // A moment alone has no extent: show a second around it.
    range = span > 0 ? [t[0], t[t.length - 1]] : [t[0] - 0.5, t[0] + 0.5];
  }
  function draw() {
    queued = false;
    if (!width || index < 0) return;
    if (!painted) paint();
    ctx.clearRect(0, 0, width, height);
    ctx.drawImage(still, 0, 0, width, height);
    drawTimeMark(ctx, width, height, range, replay.now(), theme.muted);
    drawTimeMark(ctx, width, height, range, pointed, theme.accent);
    part("reading").textContent = anglesInWords(people[index], Number.isFinite(pointed) ? pointed : replay.now());
  }
  function redraw() {
    if (!queued) { queued = true; requestAnimationFrame(draw); }
  }
  function repaint() { painted = false; redraw(); }
  function paint() {
    still.width = canvas.width; still.height = canvas.height;
    const under = still.getContext("2d");
    under.setTransform(ctx.getTransform());
    drawAngles(under, width, height, people[index], range, theme);
    painted = true;
  }
  function resize() {
    const density = window.devicePixelRatio || 1;
    width = canvas.clientWidth; height = canvas.clientHeight;
    canvas.width = Math.round(width * density); canvas.height = Math.round(height * density);
    ctx.setTransform(density, 0, 0, density, 0, 0);
    painted = false;
    draw();
  }
  function show(i) {
    if (i === index || i < 0) return;
    index = i; pointed = NaN;
    whole();
    who.value = people[i].name;
    canvas.style.height = CHART.top + CHART.bottom + chartNames(people[i]).length * (CHART.tall + CHART.gap) - CHART.gap + "px";
    canvas.setAttribute("aria-label", "Speed and orientation of person " + people[i].name + " over time");
    repaint();
  }
  function zoom(factor, sx) {
    const middle = screenToTime(range, width, sx);
    range = range.map((t) => middle + (t - middle) / factor);
    repaint();
  }
  // The buttons keep the replay's time where it is, if it is in sight.
  function zoomAtTime(factor) {
    const now = replay.now(), inside = now >= range[0] && now <= range[1];
    zoom(factor, timeToScreen(range, width, inside ? now : (range[0] + range[1]) / 2));
  }
  function move(by) {
    const at = charted.indexOf(index), next = charted[(Math.max(at, 0) + by + charted.length) % charted.length];
    crowd.choose(next);
  }
  // While one types, only what is meant beyond doubt is taken; at the end, the first that fits.
  function search(done) {
    const words = who.value.trim(), found = words ? findPeople(people, words) : [];
    who.setCustomValidity(words && !found.length ? "Nobody has such a name or id" : "");
    if (found.length === 1 || (done && found.length)) crowd.choose(found[0]);
    else if (done) who.value = people[index].name;
  }

  // The legend holds what there are data for.
  const known = (kind) => people.some((p) => ["heading", "body", "head"].some((name) => p[kind.replace("*", name)].some(Number.isFinite)));
  Object.entries({ "±1σ": "*_std", "95 %": "*_std", observation: "seen_*", "not observed": "seen_*", truth: "true_*" }).forEach(([key, kind]) => {
    root.querySelector('[data-key="' + key + '"]').hidden = !known(kind);
  });
  who.addEventListener("focus", () => who.select());
  who.addEventListener("input", () => search(false));
  who.addEventListener("change", () => search(true));
  part("names").append(...charted.map((i) => Object.assign(document.createElement("option"), { value: people[i].name })));
  part("before").addEventListener("click", () => move(-1));
  part("after").addEventListener("click", () => move(1));
  part("before").disabled = part("after").disabled = charted.length < 2;
  part("closer").addEventListener("click", () => zoomAtTime(1.6));
  part("wider").addEventListener("click", () => zoomAtTime(1 / 1.6));
  part("fit").addEventListener("click", () => { whole(); repaint(); });
  dragCanvas(canvas, {
    moved(dx) { const by = dx * (range[1] - range[0]) / (width - CHART.left - CHART.right); range = range.map((t) => t - by); repaint(); },
    zoomed: (factor, sx) => zoom(factor, sx),
    fit() { whole(); repaint(); },
  });
  canvas.addEventListener("pointermove", (event) => { if (event.pointerType === "mouse") { pointed = screenToTime(range, width, event.offsetX); redraw(); } });
  canvas.addEventListener("pointerleave", () => { pointed = NaN; redraw(); });
  canvas.addEventListener("click", (event) => replay.seek(screenToTime(range, width, event.offsetX)));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { theme = readTheme(root); repaint(); });
  crowd.onChange(() => show(crowd.chosen));
  replay.onTime(redraw);
  // Default before a selection: the person with most data.
  const longest = charted.reduce((best, i) => (people[i].t.length > people[best].t.length ? i : best), charted[0]);
  show(crowd.chosen >= 0 ? crowd.chosen : longest);
  new ResizeObserver(resize).observe(canvas);
}
