// The replay's controls: time, speed, layers, people, zoom, keyboard and the address (#t=5.0&play=0&speed=2).

function startReplay(root, data) {
  const part = (name) => root.querySelector('[data-part="' + name + '"]');
  const canvas = part("canvas"), ctx = canvas.getContext("2d");
  const slider = part("time"), playButton = part("play"), clock = part("clock"), speed = part("speed"), trail = part("trail");
  const people = data.people.map((coded) => decodePerson(coded, data.steps));
  const begin = Math.min(...people.map((p) => p.t[0])), end = Math.max(...people.map((p) => p.t[p.t.length - 1]));
  const bounds = sceneBounds(people);
  const layers = {};
  let theme = readTheme(root), view = null, time = begin, playing = false, stamp = null, queued = false;

  slider.min = 0; slider.max = Math.max(end - begin, 0); slider.step = "any";
  slider.disabled = playButton.disabled = end <= begin;

  function draw() {
    queued = false;
    const present = drawMoment(ctx, view, people, layers, theme, time, Number(trail.value));
    slider.value = time - begin;
    clock.textContent = time.toFixed(2) + " s of " + end.toFixed(2) + " s · " + present + (present === 1 ? " person" : " people");
    slider.setAttribute("aria-valuetext", time.toFixed(1) + " seconds");
  }
  function redraw() {
    if (!queued) { queued = true; requestAnimationFrame(draw); }
  }
  function seek(t) {
    time = Math.min(Math.max(t, begin), end);
    redraw();
  }
  function writeAddress() {
    // Not while playing: browsers slow a page down that changes its address many times a second.
    const address = "#t=" + time.toFixed(2) + (speed.value === "1" ? "" : "&speed=" + speed.value);
    try { history.replaceState(null, "", address); } catch (error) { /* some embedded viewers forbid it */ }
  }
  function setPlaying(on) {
    if (end <= begin) return;
    if (on && time >= end) time = begin;
    playing = on; stamp = null;
    playButton.textContent = on ? "❚❚ Pause" : "▶ Play";
    if (on) requestAnimationFrame(tick); else { writeAddress(); redraw(); }
  }
  function tick(now) {
    if (!playing) return;
    // A hidden tab gets no frames: after it comes back, go on from where it was.
    if (stamp !== null) time = Math.min(time + Math.min((now - stamp) / 1000, 0.25) * Number(speed.value), end);
    stamp = now;
    draw();
    if (time >= end) setPlaying(false); else requestAnimationFrame(tick);
  }
  function resize() {
    const width = canvas.clientWidth, height = canvas.clientHeight, density = window.devicePixelRatio || 1;
    if (!width || !height) return;
    canvas.width = Math.round(width * density); canvas.height = Math.round(height * density);
    ctx.setTransform(density, 0, 0, density, 0, 0);
    const fitted = makeView(bounds, width, height);
    view = view && view.moved ? { ...view, width, height } : fitted;
    draw();
  }
  function zoom(factor, sx, sy) {
    // The point of the ground under (sx, sy) stays where it is.
    const dx = (sx - view.width / 2) / view.scale, dy = (view.height / 2 - sy) / view.scale;
    view = { ...view, x: view.x + dx * (1 - 1 / factor), y: view.y + dy * (1 - 1 / factor), scale: view.scale * factor, moved: true };
    redraw();
  }
  function fit() { view = makeView(bounds, view.width, view.height); redraw(); }
  function readAddress() {
    const wanted = new URLSearchParams(location.hash.slice(1));
    if (wanted.has("speed") && [...speed.options].some((o) => o.value === wanted.get("speed"))) speed.value = wanted.get("speed");
    if (wanted.has("t") && Number.isFinite(Number(wanted.get("t")))) seek(Number(wanted.get("t")));
    if (wanted.has("play")) setPlaying(wanted.get("play") === "1");
  }

  root.querySelectorAll("[data-layer]").forEach((box) => {
    const apply = () => { layers[box.dataset.layer] = box.checked; redraw(); };
    layers[box.dataset.layer] = box.checked;
    box.addEventListener("change", apply);
  });
  const personBoxes = [...root.querySelectorAll("[data-person]")];
  personBoxes.forEach((box, i) => {
    people[i].shown = box.checked;
    box.addEventListener("change", () => { people[i].shown = box.checked; redraw(); });
  });
  [["everybody", true], ["nobody", false]].forEach(([name, on]) => part(name).addEventListener("click", () => {
    personBoxes.forEach((box, i) => { box.checked = people[i].shown = on; });
    redraw();
  }));
  playButton.addEventListener("click", () => setPlaying(!playing));
  slider.addEventListener("input", () => seek(begin + Number(slider.value)));
  slider.addEventListener("change", writeAddress);
  trail.addEventListener("change", redraw);
  speed.addEventListener("change", () => { if (!playing) writeAddress(); });
  part("closer").addEventListener("click", () => zoom(1.4, view.width / 2, view.height / 2));
  part("wider").addEventListener("click", () => zoom(1 / 1.4, view.width / 2, view.height / 2));
  part("fit").addEventListener("click", fit);

  let held = null;
  canvas.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "mouse" || event.button !== 0) return;  // a finger scrolls the page
    held = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    view = { ...view, x: view.x - (event.clientX - held[0]) / view.scale, y: view.y + (event.clientY - held[1]) / view.scale, moved: true };
    held = [event.clientX, event.clientY];
    redraw();
  });
  ["pointerup", "pointercancel"].forEach((name) => canvas.addEventListener(name, () => { held = null; }));
  canvas.addEventListener("dblclick", fit);
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey) return;  // a plain wheel scrolls the page
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 300), event.offsetX, event.offsetY);
  }, { passive: false });

  document.addEventListener("keydown", (event) => {
    const at = event.target;
    // Controls keep their own keys; on the slider and elsewhere the keys are the replay's.
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    if (at !== slider && at.closest && at.closest("input, select, textarea, button, a, summary, [contenteditable], .scroll, .plot")) return;
    const step = event.shiftKey ? 1 : 0.1;
    const actions = {
      " ": () => setPlaying(!playing), ArrowLeft: () => seek(time - step), ArrowRight: () => seek(time + step),
    };
    if (at === slider || at === canvas) Object.assign(actions, { Home: () => seek(begin), End: () => seek(end) });
    if (!actions[event.key] || end <= begin) return;
    event.preventDefault();
    actions[event.key]();
  });
  document.addEventListener("keyup", (event) => { if (event.key.startsWith("Arrow") && !playing) writeAddress(); });

  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", () => { theme = readTheme(root); redraw(); });
  window.addEventListener("hashchange", readAddress);
  new ResizeObserver(resize).observe(canvas);
  resize();
  readAddress();
  if (location.hash.includes("t=")) root.scrollIntoView();  // a link to a moment means the replay
  return { seek };
}
