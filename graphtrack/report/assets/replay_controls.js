// The replay's controls: time, speed, layers, zoom, keyboard and the address (#t=5.0&person=12&play=0&speed=2).

function startReplay(root, crowd, frame, unsure, events, behaviour, sensors, background) {
  const part = (name) => root.querySelector('[data-part="' + name + '"]');
  const canvas = part("canvas"), ctx = canvas.getContext("2d");
  const slider = part("time"), playButton = part("play"), clock = part("clock"), speed = part("speed"), trail = part("trail");
  const people = crowd.people, listeners = [];
  const begin = Math.min(...people.map((p) => p.t[0])), end = Math.max(...people.map((p) => p.t[p.t.length - 1]));
  const bounds = sceneBounds(people, behaviour.places), backdrop = document.createElement("canvas");
  const layers = {};
  let theme = readTheme(root), view = null, time = begin, playing = false, stamp = null, queued = false, times = null, painted = false;

  const ground = background ? { image: new Image(), extent: background.extent } : null;
  if (ground) { ground.image.onload = () => redraw(); ground.image.src = background.image; }

  slider.min = 0; slider.max = Math.max(end - begin, 0); slider.step = "any";
  [slider, playButton, part("back"), part("onward")].forEach((control) => { control.disabled = end <= begin; });

  function draw() {
    queued = false;
    if (!view) return;
    if (layers.paths && !painted) paintBackdrop();
    const strong = [crowd.chosen, crowd.hovered].filter((i) => i >= 0);
    const scene = { people, layers, theme, time, trail: Number(trail.value), backdrop: layers.paths ? backdrop : null, strong, unsure, events, behaviour, sensors, ground, linger: Math.max(1, 3 * frame) };
    const present = drawMoment(ctx, view, scene);
    slider.value = time - begin;
    clock.textContent = time.toFixed(2) + " s of " + end.toFixed(2) + " s · " + countOf(present, "person", "people");
    slider.setAttribute("aria-valuetext", time.toFixed(2) + " seconds");
    listeners.forEach((listener) => listener(time));
  }
  function redraw() {
    if (!queued) { queued = true; requestAnimationFrame(draw); }
  }
  // All paths change with the view and with the shown people, not with time.
  function repaint() { painted = false; redraw(); }
  function paintBackdrop() {
    backdrop.width = canvas.width; backdrop.height = canvas.height;
    const under = backdrop.getContext("2d");
    under.setTransform(ctx.getTransform());
    drawPaths(under, view, people);
    painted = true;
  }
  function seek(t) {
    time = Math.min(Math.max(t, begin), end);
    redraw();
  }
  function step(direction, count) {
    times = times || sampleTimes(people);
    let t = time;
    for (let k = 0; k < count; k++) t = stepTime(times, frame, t, direction);
    seek(t);
  }
  function writeAddress() {
    // Not while playing: browsers slow a page down that changes its address many times a second.
    if (playing) return;
    const person = crowd.chosen < 0 ? "" : "&person=" + encodeURIComponent(people[crowd.chosen].id);
    const address = "#t=" + time.toFixed(2) + (speed.value === "1" ? "" : "&speed=" + speed.value) + person;
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
    painted = false;
    draw();
  }
  function zoom(factor, sx, sy) {
    // The point of the ground under (sx, sy) stays where it is.
    const dx = (sx - view.width / 2) / view.scale, dy = (view.height / 2 - sy) / view.scale;
    view = { ...view, x: view.x + dx * (1 - 1 / factor), y: view.y + dy * (1 - 1 / factor), scale: view.scale * factor, moved: true };
    repaint();
  }
  // The buttons bring the chosen person, if there, to the middle; else what is in the middle stays.
  function zoomAtMiddle(factor) {
    const state = crowd.chosen < 0 ? null : stateAt(people[crowd.chosen], time);
    if (state) view = { ...view, x: state.x, y: state.y };
    zoom(factor, view.width / 2, view.height / 2);
  }
  function fit() { view = makeView(bounds, view.width, view.height); repaint(); }
  function readAddress() {
    const wanted = new URLSearchParams(location.hash.slice(1));
    if (wanted.has("speed") && [...speed.options].some((o) => o.value === wanted.get("speed"))) speed.value = wanted.get("speed");
    if (wanted.has("person")) crowd.choose(crowd.indexOf(wanted.get("person")));
    if (wanted.has("t") && Number.isFinite(Number(wanted.get("t")))) seek(Number(wanted.get("t")));
    if (wanted.has("play")) setPlaying(wanted.get("play") === "1");
  }

  root.querySelectorAll("[data-layer]").forEach((box) => {
    const apply = () => { layers[box.dataset.layer] = box.checked; redraw(); };
    layers[box.dataset.layer] = box.checked;
    box.addEventListener("change", apply);
  });
  playButton.addEventListener("click", () => setPlaying(!playing));
  part("back").addEventListener("click", () => { step(-1, 1); writeAddress(); });
  part("onward").addEventListener("click", () => { step(1, 1); writeAddress(); });
  slider.addEventListener("input", () => seek(begin + Number(slider.value)));
  slider.addEventListener("change", writeAddress);
  trail.addEventListener("change", redraw);
  speed.addEventListener("change", writeAddress);
  part("closer").addEventListener("click", () => zoomAtMiddle(1.4));
  part("wider").addEventListener("click", () => zoomAtMiddle(1 / 1.4));
  part("fit").addEventListener("click", fit);
  crowd.onChange(() => { writeAddress(); repaint(); });

  dragCanvas(canvas, {
    moved(dx, dy) { view = { ...view, x: view.x - dx / view.scale, y: view.y + dy / view.scale, moved: true }; repaint(); },
    zoomed: zoom,
    fit,
  });
  const pointer = startPointing(part("tip"), canvas, crowd, {
    ground: (sx, sy) => [view.x + (sx - view.width / 2) / view.scale, view.y + (view.height / 2 - sy) / view.scale],
    behaviour,
    moment: () => ({ time, trail: Number(trail.value), everything: layers.paths, reach: 1 / view.scale, layers }),
    redraw,
    seek,
  });

  document.addEventListener("keydown", (event) => {
    const at = event.target;
    // Controls keep their own keys; on the slider, on buttons (but for space) and elsewhere the keys are the replay's.
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const own = "input, select, textarea, a, summary, [contenteditable], .scroll" + (event.key === " " ? ", button" : "");
    if (at !== slider && at.closest && at.closest(own)) return;
    const count = event.shiftKey ? 10 : 1;
    const actions = { " ": () => setPlaying(!playing), ArrowLeft: () => step(-1, count), ArrowRight: () => step(1, count) };
    if (at === slider || at === canvas) Object.assign(actions, { Home: () => seek(begin), End: () => seek(end) });
    if (event.key === "Escape" && crowd.chosen >= 0) { crowd.choose(-1); return; }
    if (!actions[event.key] || end <= begin) return;
    event.preventDefault();
    actions[event.key]();
  });
  document.addEventListener("keyup", (event) => { if (event.key.startsWith("Arrow")) writeAddress(); });

  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", () => { theme = readTheme(root); repaint(); });
  window.addEventListener("hashchange", readAddress);
  canvas.addEventListener("pointerleave", pointer.leave);
  new ResizeObserver(resize).observe(canvas);
  resize();
  const linked = location.hash.includes("t=");
  readAddress();
  if (linked) root.scrollIntoView();  // a link to a moment means the replay
  return {
    seek,
    now: () => time,
    onTime(listener) { listeners.push(listener); listener(time); },
    // To a moment and a place at which the person is there, if these are none.
    visit(i) {
      crowd.choose(i);
      if (!stateAt(people[i], time)) seek(people[i].t[0]);
      const state = stateAt(people[i], time), [sx, sy] = state ? toScreen(view, state.x, state.y) : [0, 0];
      if (state && (sx < 0 || sy < 0 || sx > view.width || sy > view.height)) view = { ...view, x: state.x, y: state.y };
      repaint();
      root.scrollIntoView({ block: "nearest" });
    },
  };
}
